"""The outcome of each drape of a batch, and its figures: crossings, stretch, frames."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import launch_lock, to_host
from gcd_dataset.generator.drape.holds import fell, find_keepers, off_body
from gcd_dataset.generator.drape.kernels.world import DIVERGED, DONE
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drape.untangling import untangle
from gcd_dataset.records import Drape, Outcome

__all__ = ["collect", "slid_off"]


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
        outcome = _judge(job, drape, solver.config, int(status[w]), overfull=bool(overfull[w]))
        drapes.append(replace(drape, outcome=outcome))
    return drapes


def _judge(job: DrapeJob, drape: Drape, config: DrapeConfig, status: int, *, overfull: bool) -> Outcome:
    """The most serious failure that applies; ``SETTLED`` without any."""
    if status == DIVERGED or not np.isfinite(drape.vertices).all():
        return Outcome.DIVERGED
    if overfull:
        return Outcome.OVERFULL
    if fell(job, drape.vertices):
        return Outcome.FELL
    if slid_off(job, drape.vertices) or off_body(job, drape.vertices):
        return Outcome.SLID_OFF
    if status != DONE:
        return Outcome.NOT_SETTLED
    if drape.body_crossings > config.max_body_crossings:
        return Outcome.THROUGH_BODY
    if drape.self_crossings > config.max_self_crossings:
        return Outcome.THROUGH_ITSELF
    if drape.stretch_p99 > config.max_stretch:
        return Outcome.OVERSTRETCHED
    return Outcome.SETTLED


def slid_off(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> bool:
    """Whether the mean height of the keepers is below the level at which the garment has slid off."""
    ids, lowest = find_keepers(job)
    return len(ids) > 0 and bool(vertices[ids, 1].mean() < lowest)
