"""The outcome of each drape of a batch, and its figures: crossings, stretch, frames.

An explicit substep moves each vertex on its own, and the neighbours of a vertex that crosses a layer pull it back. An
implicit step moves whole layers: crossing edges and faces are pushed along the gradient of the intersection contour
(Volino and Magnenat-Thalmann, SIGGRAPH 2006), and the conjugate gradient method solves for the displacement of all
vertices. The positions of garments without self-crossings do not change.
"""

import weakref
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import warp as wp
from jaxtyping import Bool, Float

from gcd_dataset.generator.device import Resumable, launch_lock
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.holds import fell, find_keepers, off_body
from gcd_dataset.generator.drape.kernels import untangling as kernels
from gcd_dataset.generator.drape.kernels.place import NOT_COUNTED
from gcd_dataset.generator.drape.kernels.world import DIVERGED, DONE, RUNNING
from gcd_dataset.generator.drape.solver import CROSSING_COUNTS, SELF_CROSSINGS, Solver
from gcd_dataset.generator.quality import quantiles
from gcd_dataset.records import Drape, Outcome

STEP = 1.0 / 120.0  # s
ITERATIONS = 10  # conjugate gradient iterations in each step; 20 iterations untangle no more garments
POLL_EVERY = 10  # steps between two reads of ``active`` from the device

# See ``kernels.untangling.Untangling``. Tried on the 25 of 128 garments that crossed themselves at rest: crossing
# stiffness 1.0, crossing move 0.6 cm and largest move 0.5 cm untangle 13 of them in 20 steps; 0.1, 3 cm and 1 cm
# untangle 22 in 60 steps.
CROSSING_STIFFNESS = 0.1
CROSSING_MOVE = 3.0  # cm
POINT_STIFFNESS = 0.5
EDGE_STIFFNESS = 0.1
BODY_STIFFNESS = 1.0
BODY_GRIP = 0.3
MAX_MOVE = 1.0  # cm


def untangle(solver: Solver, worlds: Bool[np.ndarray, " w"]) -> Resumable[None]:
    """Move the cloth of each given world until it has no self-crossings, at most ``config.untangling_steps`` steps.

    Each world ends in the state with the fewest crossings, which may be its first.
    """
    with launch_lock:
        phase = solver.untangling = solver.untangling or _Phase(solver)
        phase.begin(worlds)
    for number in range(1, solver.config.untangling_steps + 1):
        wp.capture_launch(phase.graph)
        if number % POLL_EVERY == 0:
            [active] = yield from solver.mirror.fetch(phase.active)
            if not active.any():
                break
    with launch_lock:
        phase.end()


class _Phase:
    """The buffers of the phase, and the launches of one step as a graph."""

    def __init__(self, solver: Solver) -> None:
        model, device = solver.model, solver.model.device
        self._solver: Solver = weakref.proxy(solver)  # a cycle would keep the buffers of both until a collection
        self._parameters = _parameters()
        self.active, self._crossings, self._improved, self._least = (
            wp.zeros(model.n_worlds, dtype=int, device=device) for _ in range(4)
        )
        self._best = wp.empty_like(solver.state.x)
        self._solve = _new_solve(model.n_vertices, model.n_worlds, device)
        self.graph = solver.captured(self._step)

    def begin(self, worlds: Bool[np.ndarray, " w"]) -> None:
        """Begin with the cloth of the given worlds: ``active`` is 1 where it still has self-crossings."""
        self.active.assign(worlds.astype(np.int32))
        self._least.fill_(NOT_COUNTED)
        wp.copy(self._best, self._solver.state.x)
        self._solver.state.push.zero_()

    def _step(self) -> None:
        """Count the self-crossings, then move the cloth of the worlds that have any."""
        self._count_crossings()
        solver, solve = self._solver, self._solve
        m, s = solver.model, solver.state
        solver.find_contacts_of(self.active)
        threads = 1 if m.device == "cpu" else 1024
        inputs = [m.worlds, s.contacts, self._parameters, threads, self.active, s.x]
        solver.launch(kernels.push_contacts_apart, (m.n_worlds, threads), inputs, [s.push])
        inputs = [m.worlds, m.cloth, m.rows, self._parameters, self.active, s.x]
        solver.launch(kernels.assemble, m.n_vertices, inputs, [s.push, solve])
        self._sum_products()
        solver.launch(kernels.begin_solve, m.n_worlds, [self.active], [solve])
        for _ in range(ITERATIONS):
            solver.launch(kernels.multiply, m.n_vertices, [m.cloth, m.rows, self.active, s.x], [solve])
            self._sum_products()
            solver.launch(kernels.find_step_length, m.n_worlds, [self.active], [solve])
            solver.launch(kernels.advance, m.n_vertices, [m.cloth, self.active], [solve])
            self._sum_products()
            solver.launch(kernels.find_conjugate_share, m.n_worlds, [self.active], [solve])
            solver.launch(kernels.update_direction, m.n_vertices, [m.cloth, self.active], [solve])
        inputs = [m.worlds, m.cloth, self._parameters, self.active, solve]
        solver.launch(kernels.move_cloth, m.n_vertices, inputs, [s.x])

    def end(self) -> None:
        """Count the crossings of the last step's result, and restore the positions with the fewest crossings."""
        self._count_crossings()
        wp.copy(self._solver.state.x, self._best)

    def _count_crossings(self) -> None:
        solver = self._solver
        m, s = solver.model, solver.state
        bvh, roots = solver.refitted_bvh()
        self._crossings.zero_()
        inputs = [m.cloth, bvh, roots, self._parameters, self.active, s.x]
        solver.launch(kernels.push_crossings, m.n_edges, inputs, [self._crossings, s.push])
        outputs = [self.active, self._least, self._improved]
        solver.launch(kernels.compare_crossings, m.n_worlds, [self._crossings], outputs)
        solver.launch(kernels.store_improved, m.n_vertices, [m.cloth, self._improved, s.x], [self._best])

    def _sum_products(self) -> None:
        m = self._solver.model
        size = (m.n_worlds, int(kernels.PARTIAL_SUMS))
        self._solver.launch(kernels.sum_products, size, [m.worlds, self.active], [self._solve])


def _parameters() -> kernels.Untangling:
    parameters = kernels.Untangling()
    parameters.step, parameters.max_move = STEP, MAX_MOVE
    parameters.crossing_stiffness, parameters.crossing_move = CROSSING_STIFFNESS, CROSSING_MOVE
    parameters.point_stiffness, parameters.edge_stiffness = POINT_STIFFNESS, EDGE_STIFFNESS
    parameters.body_stiffness, parameters.body_grip = BODY_STIFFNESS, BODY_GRIP
    return parameters


def _new_solve(vertices: int, worlds: int, device: str) -> kernels.Solve:
    solve = kernels.Solve()
    for name in ("residual", "move", "direction", "image"):
        setattr(solve, name, wp.zeros(vertices, dtype=wp.vec3, device=device))
    for name in ("diagonal", "product"):
        setattr(solve, name, wp.zeros(vertices, dtype=float, device=device))
    solve.inverse = wp.zeros(vertices, dtype=wp.mat33, device=device)
    solve.partial = wp.zeros((worlds, int(kernels.PARTIAL_SUMS)), dtype=float, device=device)
    solve.norm, solve.factor = (wp.zeros(worlds, dtype=float, device=device) for _ in range(2))
    return solve


KEEPS_CROSSINGS = (Outcome.SETTLED, Outcome.THROUGH_BODY, Outcome.THROUGH_ITSELF, Outcome.OVERSTRETCHED)
"""Outcomes of garments that came to rest on the body, with crossings or without."""


FINISHES = 5  # most times that cloth moves off the skin: each time by a share of its distance from other cloth
OVER_CLOTH = 15  # the same for cloth over a worn garment: a hem stands out further than a finger


def collect(solver: Solver, jobs: Sequence[DrapeJob], worlds: Sequence[int]) -> Resumable[list[Drape]]:
    """The drapes of some worlds of a batch; ``jobs[k]`` was draped in ``worlds[k]``."""
    if not worlds:
        return []
    state, model, fetch = solver.state, solver.model, solver.mirror.fetch
    with launch_lock:
        finished = np.isin(np.arange(model.n_worlds), worlds)
        chosen = solver.chosen(finished)
        counts = solver.counted(SELF_CROSSINGS, chosen)
    # Read ``overfull`` now: the searches below may overflow their lists too. Copies, since they fetch as well.
    fetched = yield from fetch(counts, state.contacts.overfull, state.status, state.frames)
    crossings, overfull, status, frames = map(np.array, fetched)
    in_motion = np.isin(np.arange(model.n_worlds), list(solver.moving))
    worn = (status == DONE) | ((status == RUNNING) & in_motion)
    crossing = (crossings > 0) & worn
    if solver.config.untangling_steps and crossing.any():
        yield from untangle(solver, crossing)
    most = np.zeros(model.n_worlds, int)
    most[list(worlds)] = [OVER_CLOTH if job.under else FINISHES for job in jobs]
    touched, counts, through = finished, np.zeros((len(CROSSING_COUNTS), model.n_worlds), int), None
    for number in range(1, 1 + (int(most.max()) if solver.config.exact_finish else 1)):
        with launch_lock:
            if solver.config.exact_finish:
                solver.leave_skin(chosen, through)
            solver.round_positions(chosen)
            *found, through = [solver.counted(k, chosen, refit=k is SELF_CROSSINGS) for k in CROSSING_COUNTS]
            results = [*found, through, solver.stretches(), state.x]
        *fresh, stretches, x = yield from fetch(*results)
        counts = np.where(touched, fresh, counts)
        self_crossings, body_crossings, body_through = counts
        touched = (body_crossings + body_through > 0) & (body_crossings <= solver.config.max_body_crossings)
        touched &= worn & (number < most)
        if not touched.any():
            break
        chosen = solver.chosen(touched)
    drapes = []
    for job, w in zip(jobs, worlds, strict=True):
        vertices = np.array(x[model.vertices[w]], np.float32)
        stretch_median, stretch_p99 = quantiles(stretches[model.edges[w]], 0.5, 0.99)
        drape = Drape(
            vertices=vertices,
            outcome=Outcome.SETTLED,
            frames=int(frames[w]),
            self_crossings=int(self_crossings[w]),
            body_crossings=int(body_crossings[w]),
            stretch_median=stretch_median,
            stretch_p99=stretch_p99,
            body_through=int(body_through[w]),
        )
        moved = solver.moving.get(w)
        if moved and np.isfinite(vertices).all():
            drape = replace(drape, vertices=moved.undone(vertices))
        outcome, reason = _judge(job, drape, solver.config, int(status[w]), overfull=bool(overfull[w]))
        drapes.append(replace(drape, vertices=vertices, outcome=outcome, reason=reason))
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

    def order(drape: Drape) -> tuple[bool, bool, int]:
        return drape.outcome not in KEEPS_CROSSINGS, drape.outcome is not Outcome.SETTLED, _crossings(drape)

    return min(drapes, key=order)


def _crossings(drape: Drape) -> int:
    """Crossing edges of all kinds: of cloth with cloth, of cloth with the body, of the body with cloth."""
    return drape.self_crossings + drape.body_crossings + drape.body_through


def slid_off(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> str:
    """How the keepers have slid: a sentence if their mean height is below ``find_keepers``'s level; else empty."""
    ids, lowest = find_keepers(job)
    height = vertices[ids, 1].mean() if len(ids) else np.inf
    return f"the edge that holds it lies at {height:.0f} cm, below {lowest:.0f} cm" if height < lowest else ""
