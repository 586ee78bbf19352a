"""Stretch and bending forces, compared with their energies and with physical laws."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from gcd_dataset.generator.drape import Bending, DrapeConfig, DrapeJob, Fabric, Tensile
from gcd_dataset.generator.drape.model import ClothModel, build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.records import BoxMesh
from tests.generator.drape.probes import elastic_kernel
from tests.generator.drape.reference import bending_energy, stretch_energy
from tests.helpers import SIZE, far_ball, patch

FABRIC = Fabric(tensile=50.0, bending=2e-5)
GRAINED = Fabric(tensile=Tensile(60.0, 30.0, 12.0), bending=Bending(3e-5, 1e-5))
STILL_AIR = DrapeConfig(sewing_time=1e-6, damping=0.0, sewing_damping=0.0, max_speed=1e9)

fabrics = pytest.mark.parametrize("fabric", [FABRIC, GRAINED], ids=["isotropic", "grained"])


def irregular_patch(rng: np.random.Generator) -> BoxMesh:
    """A patch with vertices off the grid, flat and in space."""
    mesh = patch(4, 3, spacing=1.3)
    uv = mesh.uv + 0.2 * rng.standard_normal(mesh.uv.shape)
    return replace(mesh, uv=uv, vertices=np.pad(uv, ((0, 0), (0, 1))))


def force_on(model: ClothModel, x: np.ndarray) -> np.ndarray:
    """The kernel's elastic force at positions ``x`` after sewing [g cm/s²]."""
    at = wp.array(x.astype(np.float32), dtype=wp.vec3, device="cpu")
    force = wp.empty_like(at)
    wp.launch(elastic_kernel, dim=len(x), inputs=[model.rows, 1.0, at], outputs=[force], device="cpu")
    return np.asarray(force.numpy())


def test_compressed_cloth_spreads_only_after_half_of_the_sewing() -> None:
    """Until then springs that start shorter than flat are at rest, and springs that start longer pull."""
    flat = patch(1, 1, spacing=2.0)
    for scale, at_rest in ((0.5, True), (1.5, False)):
        start = np.asarray(flat.vertices * scale, np.float32)
        job = DrapeJob(replace(flat, vertices=start), far_ball(), SIZE, FABRIC)
        model = build_model([job], DrapeConfig(), "cpu")
        at, force = (wp.array(start, dtype=wp.vec3, device="cpu") for _ in range(2))
        wp.launch(elastic_kernel, dim=len(start), inputs=[model.rows, 0.5, at], outputs=[force], device="cpu")
        assert (np.abs(force.numpy()).max() < 1.0) == at_rest


def gradient_of(energy: Callable[[np.ndarray], float], x: np.ndarray) -> np.ndarray:
    """The gradient, by central differences."""
    gradient, step = np.zeros_like(x), 1e-5
    for i in range(len(x)):
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[i, axis] += step
            behind[i, axis] -= step
            gradient[i, axis] = (energy(ahead) - energy(behind)) / (2 * step)
    return gradient


@fabrics
def test_force_is_the_negative_gradient_of_the_energy(fabric: Fabric) -> None:
    rng = np.random.default_rng(1)
    mesh = irregular_patch(rng)
    model = build_model([DrapeJob(mesh, far_ball(), SIZE, fabric)], STILL_AIR, "cpu")
    x = np.asarray(mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape))

    def energy(at: np.ndarray) -> float:
        return stretch_energy(mesh, at, fabric) + bending_energy(mesh, at, fabric)

    gradient = gradient_of(energy, x)
    force = force_on(model, x)
    assert np.linalg.norm(force + gradient) < 2e-3 * np.linalg.norm(gradient)


@fabrics
def test_three_sheets_sewn_along_one_edge_follow_their_energy(fabric: Fabric) -> None:
    """The first two faces of an edge with three form its hinge; all three add to its spring."""
    rng = np.random.default_rng(6)
    sheet = patch(2, 1, spacing=1.2)
    others = [np.where(sheet.faces > 2, sheet.faces + shift, sheet.faces) for shift in (0, 3, 6)]
    flat = np.concatenate([sheet.uv, *(sheet.uv[3:] for _ in range(2))])
    book = replace(
        sheet,
        vertices=np.pad(flat, ((0, 0), (0, 1))),
        faces=np.concatenate(others),
        uv=flat,
        corners=np.concatenate(others),
        uv_vertex=np.arange(len(flat)),
        panel_id=np.repeat([0, 1, 2], len(sheet.faces)),
        panel_names=("one", "two", "three"),
        panel_labels=("", "", ""),
    )
    model = build_model([DrapeJob(book, far_ball(), SIZE, fabric)], STILL_AIR, "cpu")
    x = np.asarray(book.vertices + 0.2 * rng.standard_normal(book.vertices.shape))
    gradient = gradient_of(lambda at: stretch_energy(book, at, fabric) + bending_energy(book, at, fabric), x)
    assert np.linalg.norm(force_on(model, x) + gradient) < 2e-3 * np.linalg.norm(gradient)


def test_edges_between_held_vertices_are_taped() -> None:
    """Taped edges are ten times as stiff."""
    plain = patch(4, 4)
    top = np.arange(20, 25)
    taped = replace(plain, labels={"lower_interface": top})
    wide = plain.vertices * [1.1, 1.0, 1.0]
    pulls = []
    for mesh in (plain, taped):
        job = DrapeJob(mesh, far_ball(), SIZE, FABRIC)
        pulls.append(force_on(build_model([job], STILL_AIR, "cpu"), wide)[:, 0])
    own = FABRIC.membrane * 0.5 * 0.1  # spring of one face: stiffness × area / length² × 10 % of 1 cm
    assert pulls[1][20] - pulls[0][20] == pytest.approx(9 * own, rel=1e-3)
    assert np.abs(pulls[1] - pulls[0])[:20].max() < 1e-2 * own


@fabrics
def test_elastic_forces_conserve_momentum_and_angular_momentum(fabric: Fabric) -> None:
    rng = np.random.default_rng(2)
    mesh = irregular_patch(rng)
    model = build_model([DrapeJob(mesh, far_ball(), SIZE, fabric)], STILL_AIR, "cpu")
    x = np.asarray(mesh.vertices + 0.3 * rng.standard_normal(mesh.vertices.shape))
    force = force_on(model, x)
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-5 * scale
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-4 * scale


@fabrics
def test_flat_cloth_is_at_rest_in_any_orientation(fabric: Fabric) -> None:
    mesh = irregular_patch(np.random.default_rng(3))
    turned, _ = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))
    model = build_model([DrapeJob(mesh, far_ball(), SIZE, fabric)], STILL_AIR, "cpu")
    at_rest = force_on(model, mesh.vertices @ turned.T)
    stretched = force_on(model, 1.05 * mesh.vertices @ turned.T)
    assert np.abs(at_rest).max() < 1e-2 * np.abs(stretched).max()


@pytest.mark.parametrize("spacing", [1.0, 2.0])
def test_a_hanging_strip_stretches_by_its_own_weight(spacing: float) -> None:
    """A strip of length L held at its top grows by rho g L² / (2 E) on any mesh."""
    length, level = 40.0, SIZE.waist_level
    rows, columns = int(length / spacing), int(4 / spacing)
    top = np.arange(columns + 1) + rows * (columns + 1)
    mesh = patch(columns, rows, spacing=spacing, origin=(0, level - length, 0), labels={"lower_interface": top})
    fabric = Fabric(density=0.2, tensile=20.0)
    config = DrapeConfig(sewing_time=0.01, held_time=100.0, max_frames=10_000, damping=12.0)
    solver = Solver(build_model([DrapeJob(mesh, far_ball(), SIZE, fabric)], config, "cpu"), config)
    solver.run_for(1.2)
    x = solver.state.x.numpy()
    grown = x[top, 1].mean() - x[: columns + 1, 1].mean() - length
    expected = fabric.mass * 981.0 * length**2 / (2 * fabric.membrane)
    assert grown == pytest.approx(expected, rel=0.12)
