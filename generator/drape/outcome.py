"""How a drape ended: at rest, through the body, through itself, or on the floor."""

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.holds import held_from_below
from gcd_dataset.records import Outcome

__all__ = ["judge", "slid_off"]


def judge(
    job: DrapeJob,
    vertices: Float[np.ndarray, "v 3"],
    config: DrapeConfig,
    *,
    running: bool,
    diverged: bool,
    overfull: bool,
    self_crossings: int,
    body_crossings: int,
    stretch_p99: float,
) -> Outcome:
    """The first of the failures that applies, gravest first; else settled."""
    if diverged or not np.isfinite(vertices).all():
        return Outcome.DIVERGED
    if overfull:
        return Outcome.OVERFULL
    if slid_off(job, vertices):
        return Outcome.SLID_OFF
    if running:
        return Outcome.NOT_SETTLED
    if body_crossings > config.max_body_crossings:
        return Outcome.THROUGH_BODY
    if self_crossings > config.max_self_crossings:
        return Outcome.THROUGH_ITSELF
    if stretch_p99 > config.max_stretch:
        return Outcome.OVERSTRETCHED
    return Outcome.SETTLED


def slid_off(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> bool:
    """Whether the edge that keeps the garment up hangs far below where it was held."""
    ids, lowest = held_from_below(job)
    return len(ids) > 0 and bool(vertices[ids, 1].mean() < lowest)
