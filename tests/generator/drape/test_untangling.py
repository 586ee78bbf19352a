"""The untangling phase: implicit steps that separate cloth that crosses itself at rest."""

from itertools import pairwise

import numpy as np
import pytest
import warp as wp
from jaxtyping import Float

from gcd_dataset.generator.drape import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.kernels import untangling as kernels
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.outcome import untangle
from gcd_dataset.generator.drape.solver import Solver
from tests.helpers import SIZE, far_ball, joined, patch

LYING = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]])
CORNER_FIRST = np.array([[0.1, 0.1], [0.7, -0.7], [0.7, 0.7]])
CONFIG = DrapeConfig(untangling_steps=60)


def pierced() -> DrapeJob:
    """A sheet that the corner of another sheet pierces."""
    sheet = patch(12, 12, origin=(-6.0, 94.0, 0.0))
    return DrapeJob(joined(sheet, patch(6, 6, place=CORNER_FIRST, origin=(0.0, 100.0, -1.7))), far_ball(), SIZE)


def clean() -> DrapeJob:
    """Two sheets 3 cm apart."""
    lower = patch(8, 8, place=LYING, origin=(-4.0, 100.0, 4.0))
    return DrapeJob(joined(lower, patch(8, 8, place=LYING, origin=(-4.0, 103.0, 4.0))), far_ball(), SIZE)


def solver_of(*jobs: DrapeJob) -> Solver:
    return Solver(build_model(list(jobs), CONFIG, "cpu"), CONFIG)


def untangled(*jobs: DrapeJob) -> list[Float[np.ndarray, "v 3"]]:
    """The positions of each garment after the phase; garments without crossings skip it."""
    solver = solver_of(*jobs)
    untangle(solver, solver.self_crossings() > 0)
    x = solver.state.x.numpy()
    return [x[a:b].copy() for a, b in pairwise(solver.model.topology.vertex_offset)]


def test_a_corner_leaves_the_sheet_that_it_pierces() -> None:
    solver = solver_of(pierced())
    assert solver.self_crossings()[0] > 3
    untangle(solver, np.ones(1, bool))
    assert solver.self_crossings()[0] == 0


def test_garments_without_crossings_keep_their_positions() -> None:
    moved, still = untangled(pierced(), clean())
    assert still.tobytes() == np.float32(clean().box_mesh.vertices).tobytes()
    assert (moved != np.float32(pierced().box_mesh.vertices)).any()


def test_a_garment_gets_the_same_bytes_alone_and_in_a_batch() -> None:
    alone = untangled(pierced())[0]
    for x in untangled(clean(), pierced(), pierced())[1:]:
        assert x.tobytes() == alone.tobytes()


def test_untangling_never_adds_crossings() -> None:
    solver = solver_of(pierced())
    before = solver.self_crossings()[0]
    for steps in (1, 2, 5):
        solver = Solver(solver.model, DrapeConfig(untangling_steps=steps))
        untangle(solver, np.ones(1, bool))
        assert solver.self_crossings()[0] <= before


def test_pushes_of_crossings_sum_to_zero() -> None:
    """Edge and face get opposite forces."""
    solver = solver_of(pierced())
    m, s = solver.model, solver.state
    phase = kernels.Untangling()
    phase.crossing_stiffness, phase.crossing_move = 0.5, 1.0
    bvh, roots = solver.refitted_bvh()
    counts = wp.zeros(1, dtype=int, device="cpu")
    inputs = [m.cloth, bvh, roots, phase, wp.ones(1, dtype=int, device="cpu"), s.x]
    solver.launch(kernels.push_crossings, m.n_edges, inputs, [counts, s.push])
    push = s.push.numpy()[:, :3].astype(np.int64)
    assert counts.numpy()[0] == solver.self_crossings()[0]
    assert np.abs(push).sum() > 0
    assert np.abs(push.sum(axis=0)).max() <= 5 * len(push)  # each term is rounded to units of 6e-8 cm


@pytest.mark.parametrize("seed", range(3))
def test_the_matrix_is_symmetric_and_positive_definite(seed: int) -> None:
    """Also with compressed springs: the conjugate gradient method needs both properties."""
    solver = solver_of(clean())
    m, s = solver.model, solver.state
    x = s.x.numpy()
    s.x.assign(x + np.random.default_rng(seed).normal(0.0, 0.1, x.shape).astype(np.float32))
    phase = kernels.Untangling()
    phase.step = 1.0 / 120.0
    active = wp.ones(1, dtype=int, device="cpu")
    solve = kernels.Solve()
    for name in ("residual", "move", "direction", "image"):
        setattr(solve, name, wp.zeros(m.n_vertices, dtype=wp.vec3, device="cpu"))
    solve.diagonal, solve.product = (wp.zeros(m.n_vertices, dtype=float, device="cpu") for _ in range(2))
    solve.inverse = wp.zeros(m.n_vertices, dtype=wp.mat33, device="cpu")
    s.push.zero_()
    solver.launch(kernels.assemble, m.n_vertices, [m.worlds, m.cloth, m.rows, phase, active, s.x], [s.push, solve])
    columns = []
    for unit in np.eye(3 * m.n_vertices, dtype=np.float32):
        solve.direction.assign(unit.reshape(-1, 3))
        solver.launch(kernels.multiply, m.n_vertices, [m.cloth, m.rows, active, s.x], [solve])
        columns.append(solve.image.numpy().ravel().copy())
    matrix = np.stack(columns, axis=1).astype(float)
    assert np.abs(matrix - matrix.T).max() < 1e-4 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min() > 0.0
