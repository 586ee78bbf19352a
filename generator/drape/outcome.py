"""The outcome of each drape of a batch, and its figures: crossings, stretch, frames."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import launch_lock, to_host
from gcd_dataset.generator.drape.holds import fell, find_keepers, off_body
from gcd_dataset.generator.drape.kernels.world import DIVERGED, DONE, STOPPED
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drape.untangling import untangle
from gcd_dataset.records import Drape, Outcome

KEEPS_CROSSINGS = (Outcome.SETTLED, Outcome.THROUGH_BODY, Outcome.THROUGH_ITSELF, Outcome.OVERSTRETCHED)
"""Outcomes of garments that came to rest on the body, with crossings or without."""


def collect(solver: Solver, jobs: Sequence[DrapeJob], worlds: Sequence[int]) -> list[Drape]:
    """The drapes of some worlds of a batch; ``jobs[k]`` was draped in ``worlds[k]``."""
    if not worlds:
        return []
    state, topology = solver.state, solver.model.topology
    overfull = to_host(state.contacts.overfull)  # read now: the searches below may overflow their lists too
    chosen = np.isin(np.arange(solver.model.n_worlds), worlds)
    if solver.config.untangling_steps:
        with launch_lock:
            crossing = (solver.self_crossings(chosen) > 0) & (to_host(state.status) == DONE)
        if crossing.any():
            untangle(solver, crossing)
    with launch_lock:
        if solver.config.exact_finish:
            solver.leave_skin(chosen)
        solver.round_positions(chosen)
        self_crossings, body_crossings = solver.self_crossings(chosen), solver.body_crossings(chosen)
        body_through = solver.body_through(chosen)
        stretches = solver.stretches()
    x, status, frames = (to_host(array) for array in (state.x, state.status, state.frames))
    drapes = []
    for job, w in zip(jobs, worlds, strict=True):
        vertices = np.array(x[topology.vertex_offset[w] : topology.vertex_offset[w + 1]], np.float32)
        median, p99 = np.percentile(stretches[topology.edge_offset[w] : topology.edge_offset[w + 1]], [50, 99])
        drape = Drape(
            vertices=vertices,
            outcome=Outcome.SETTLED,
            frames=int(frames[w]),
            self_crossings=int(self_crossings[w]),
            body_crossings=int(body_crossings[w]),
            stretch_median=float(median),
            stretch_p99=float(p99),
            body_through=int(body_through[w]),
        )
        outcome, reason = _judge(job, drape, solver.config, int(status[w]), overfull=bool(overfull[w]))
        drapes.append(replace(drape, outcome=outcome, reason=reason))
    return drapes


def _judge(job: DrapeJob, drape: Drape, config: DrapeConfig, status: int, *, overfull: bool) -> tuple[Outcome, str]:
    """The most serious failure that applies, ``SETTLED`` without any; and its ``Drape.reason``."""
    if status == DIVERGED or not np.isfinite(drape.vertices).all():
        return Outcome.DIVERGED, ""
    if overfull:
        return Outcome.OVERFULL, ""
    if reason := fell(job, drape.vertices):
        return Outcome.FELL, reason
    if reason := slid_off(job, drape.vertices) or off_body(job, drape.vertices):
        return Outcome.SLID_OFF, reason
    failures = {
        Outcome.NOT_SETTLED: status != DONE,
        Outcome.THROUGH_BODY: drape.body_crossings > config.max_body_crossings,
        Outcome.THROUGH_ITSELF: drape.self_crossings > config.max_self_crossings,
        Outcome.OVERSTRETCHED: drape.stretch_p99 > config.max_stretch,
    }
    return next((outcome for outcome, applies in failures.items() if applies), Outcome.SETTLED), ""


def crosses(drape: Drape) -> bool:
    """Whether a garment at rest crosses itself or the body, so that another drape may end with fewer crossings."""
    return drape.outcome in KEEPS_CROSSINGS and _crossings(drape) > 0


def best_of(drapes: Sequence[Drape]) -> Drape:
    """The settled drape with the fewest crossings, or else the drape at rest with the fewest, or else the first.

    Of drapes with equally many crossings the earliest.
    """
    return min(drapes, key=lambda drape: (*_failure(drape), _crossings(drape)))


def _failure(drape: Drape) -> tuple[bool, bool]:
    return drape.outcome not in KEEPS_CROSSINGS, drape.outcome is not Outcome.SETTLED


def _crossings(drape: Drape) -> int:
    """Crossing edges of all kinds: of cloth with cloth, of cloth with the body, of the body with cloth."""
    return drape.self_crossings + drape.body_crossings + drape.body_through


def slid_worlds(solver: Solver, jobs: Mapping[int, DrapeJob]) -> set[int]:
    """The worlds whose drape was stopped because the garment slid off; ``jobs``: the jobs of the worlds in question."""
    stopped = [w for w in np.flatnonzero(to_host(solver.state.status) == STOPPED).tolist() if w in jobs]
    if not stopped:
        return set()
    x, first = to_host(solver.state.x), solver.model.topology.vertex_offset
    return {w for w in stopped if slid_off(jobs[w], x[first[w] : first[w + 1]])}


def slid_off(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> str:
    """How the keepers have slid: a sentence if their mean height is below ``find_keepers``'s level; else empty."""
    ids, lowest = find_keepers(job)
    height = vertices[ids, 1].mean() if len(ids) else np.inf
    return f"the edge that holds it lies at {height:.0f} cm, below {lowest:.0f} cm" if height < lowest else ""
