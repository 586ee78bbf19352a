"""The untangling phase: implicit steps that remove the self-crossings of garments at rest.

An explicit substep moves each vertex on its own, and the neighbours of a vertex that crosses a layer pull it back. An
implicit step moves whole layers: crossing edges and faces are pushed along the gradient of the intersection contour
(Volino and Magnenat-Thalmann, SIGGRAPH 2006), and the conjugate gradient method solves for the displacement of all
vertices. The positions of garments without self-crossings do not change.
"""

import numpy as np
import warp as wp
from jaxtyping import Bool

from gcd_dataset.generator.drape.device import launch_lock, to_host
from gcd_dataset.generator.drape.kernels import untangling as kernels
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drape.state import NOT_COUNTED

STEP = 1.0 / 120.0  # s
ITERATIONS = 10  # conjugate gradient iterations in each step; 20 iterations untangle no more garments
POLL_EVERY = 10  # steps between two reads of ``active`` from the device, each of which waits for it

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


def untangle(solver: Solver, worlds: Bool[np.ndarray, " w"]) -> None:
    """Move the cloth of each given world until it has no self-crossings, at most ``config.untangling_steps`` steps.

    Each world ends in the state with the fewest crossings, which may be its first.
    """
    with launch_lock:
        phase = _Phase(solver, worlds)
        step = solver.captured(phase.step)
    for number in range(1, solver.config.untangling_steps + 1):
        wp.capture_launch(step)
        if number % POLL_EVERY == 0 and not to_host(phase.active).any():
            break
    with launch_lock:
        phase.end()


class _Phase:
    """The buffers of the phase, and the launches of one step."""

    def __init__(self, solver: Solver, worlds: Bool[np.ndarray, " w"]) -> None:
        model, device = solver.model, solver.model.device
        self._solver, self._parameters = solver, _parameters()
        self.active = wp.array(worlds.astype(np.int32), dtype=int, device=device)
        """(w) 1 where the cloth of a given world still has self-crossings."""
        self._crossings, self._improved = (wp.zeros(model.n_worlds, dtype=int, device=device) for _ in range(2))
        self._least = wp.full(model.n_worlds, NOT_COUNTED, dtype=int, device=device)
        self._best = wp.clone(solver.state.x)
        self._solve = _new_solve(model.n_vertices, model.n_worlds, device)
        solver.state.push.zero_()

    def step(self) -> None:
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
