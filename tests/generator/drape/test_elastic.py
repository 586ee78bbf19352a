"""Stretch and bending against their energies and physical laws; fabrics behave as measured."""

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.optimize import brentq

from benchmarks.cloth_tests import LEVEL, Grain, bending_length, cantilever, hold_fast, strip, strip_job
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import (
    FABRICS,
    Bending,
    DrapeConfig,
    DrapeJob,
    Fabric,
    Tensile,
    draw_fabric,
    fabric_named,
)
from gcd_dataset.generator.drape.config import GRAVITY
from gcd_dataset.generator.drape.fabrics import MEASURED, shear_stiffness
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import make, produce
from gcd_dataset.generator.pipeline import sample_fabric
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import BoxMesh
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.codec import decode_sample, encode_sample
from tests.generator.drape.probes import elastic_kernel
from tests.generator.drape.reference import bending_energy, stretch_energy
from tests.helpers import SIZE, far_ball, patch

FABRIC = Fabric(tensile=50.0, bending=2e-5)
GRAINED = Fabric(tensile=Tensile(60.0, 30.0, 12.0), bending=Bending(3e-5, 1e-5))

fabrics = pytest.mark.parametrize("fabric", [FABRIC, GRAINED], ids=["isotropic", "grained"])


def irregular_patch(rng: np.random.Generator) -> BoxMesh:
    """A patch with vertices off the grid, flat and in space."""
    mesh = patch(4, 3, spacing=1.3)
    uv = mesh.uv + 0.2 * rng.standard_normal(mesh.uv.shape)
    return replace(mesh, uv=uv, vertices=np.pad(uv, ((0, 0), (0, 1))))


def force_on(mesh: BoxMesh, x: np.ndarray, fabric: Fabric, *, sewn: float = 1.0) -> np.ndarray:
    """The kernel's elastic force at positions ``x``, with a share of the sewing done [g cm/s²]."""
    model = build_model([DrapeJob(mesh, far_ball(), SIZE, fabric)], DrapeConfig(), "cpu")
    at = wp.array(x.astype(np.float32), dtype=wp.vec3, device="cpu")
    force = wp.empty_like(at)
    wp.launch(elastic_kernel, dim=len(x), inputs=[model.rows, sewn, at], outputs=[force], device="cpu")
    return np.asarray(force.numpy())


def test_compressed_cloth_spreads_only_after_half_of_the_sewing() -> None:
    """Until then springs that start shorter than flat are at rest, and springs that start longer pull."""
    flat = patch(1, 1, spacing=2.0)
    for scale, at_rest in ((0.5, True), (1.5, False)):
        start = np.asarray(flat.vertices * scale, np.float32)
        force = force_on(replace(flat, vertices=start), start, FABRIC, sewn=0.5)
        assert (np.abs(force).max() < 1.0) == at_rest


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


def require_gradient(mesh: BoxMesh, x: np.ndarray, fabric: Fabric) -> None:
    """The force at ``x`` is the negative gradient of the energy."""
    gradient = gradient_of(lambda at: stretch_energy(mesh, at, fabric) + bending_energy(mesh, at, fabric), x)
    assert np.linalg.norm(force_on(mesh, x, fabric) + gradient) < 2e-3 * np.linalg.norm(gradient)


@fabrics
def test_force_is_the_negative_gradient_of_the_energy(fabric: Fabric) -> None:
    rng = np.random.default_rng(1)
    mesh = irregular_patch(rng)
    require_gradient(mesh, mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape), fabric)


@fabrics
@pytest.mark.parametrize("sheets", [3, pytest.param(5, marks=pytest.mark.long)])
def test_sheets_sewn_along_one_edge_follow_their_energy(sheets: int, fabric: Fabric) -> None:
    """The first two faces of an edge form its hinge; all add to its spring. A vertex has more faces than edges."""
    rng = np.random.default_rng(6)
    sheet = patch(4, 2, spacing=1.2)
    n = len(sheet.uv) - 5
    others = [np.where(sheet.faces > 4, sheet.faces + k * n, sheet.faces) for k in range(sheets)]
    flat = np.concatenate([sheet.uv, *(sheet.uv[5:] for _ in range(sheets - 1))])
    book = replace(
        sheet,
        vertices=np.pad(flat, ((0, 0), (0, 1))),
        faces=np.concatenate(others),
        uv=flat,
        corners=np.concatenate(others),
        uv_vertex=np.arange(len(flat)),
        panel_id=np.repeat(np.arange(sheets), len(sheet.faces)),
        panel_names=tuple("abcde"[:sheets]),
        panel_labels=("",) * sheets,
    )
    require_gradient(book, book.vertices + 0.2 * rng.standard_normal(book.vertices.shape), fabric)


def test_edges_between_held_vertices_are_taped() -> None:
    """Taped edges are ten times as stiff."""
    plain = patch(4, 4)
    taped = replace(plain, labels={"lower_interface": np.arange(20, 25)})
    wide = plain.vertices * [1.1, 1.0, 1.0]
    pulls = [force_on(mesh, wide, FABRIC)[:, 0] for mesh in (plain, taped)]
    own = FABRIC.membrane * 0.5 * 0.1  # spring of one face: stiffness × area / length² × 10 % of 1 cm
    assert pulls[1][20] - pulls[0][20] == pytest.approx(9 * own, rel=1e-3)
    assert np.abs(pulls[1] - pulls[0])[:20].max() < 1e-2 * own


@fabrics
def test_elastic_forces_conserve_momentum_and_angular_momentum(fabric: Fabric) -> None:
    rng = np.random.default_rng(2)
    mesh = irregular_patch(rng)
    x = np.asarray(mesh.vertices + 0.3 * rng.standard_normal(mesh.vertices.shape))
    force = force_on(mesh, x, fabric)
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-5 * scale
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-4 * scale


WOVEN = Fabric(tensile=Tensile(90.0, 50.0, 20.0), bending=Bending(4e-5, 1.5e-5))


def tension(mesh: BoxMesh, fabric: Fabric, strain: np.ndarray) -> np.ndarray:
    """(2, 2) mean tension of a uniformly strained sheet [N/m], from the forces on its vertices."""
    flat = mesh.uv @ (np.eye(2) + strain)
    force = force_on(mesh, np.pad(flat, ((0, 0), (0, 1))), fabric)[:, :2]
    out, back = (mesh.uv[mesh.corners[:, k]] - mesh.uv[mesh.corners[:, 0]] for k in (1, 2))
    area = 0.5 * np.abs(out[:, 0] * back[:, 1] - out[:, 1] * back[:, 0]).sum()
    return np.asarray(-(force.T @ mesh.uv) / area / 1e3)


def stiffnesses(mesh: BoxMesh, fabric: Fabric) -> Tensile:
    """Tensile stiffness of a sheet pulled along warp, weft and bias, with its other sides free."""
    small = 2e-3
    strains = [np.array(e) * small for e in ([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 0.5], [0.5, 0]])]
    found = [(tension(mesh, fabric, s) - tension(mesh, fabric, -s)) / (2 * small) for s in strains]
    compliance = np.linalg.inv(np.stack([[t[0, 0], t[1, 1], 0.5 * (t[0, 1] + t[1, 0])] for t in found], axis=1))
    pulls = {"warp": [0.0, 1.0, 0.0], "weft": [1.0, 0.0, 0.0], "bias": [0.5, 0.5, 0.5]}
    return Tensile(**{name: float(1 / (np.array(p) @ compliance @ np.array(p))) for name, p in pulls.items()})


@pytest.mark.parametrize("fabric", [WOVEN, FABRICS["interlock"], FABRICS["polyester_woven"].softened()])
@pytest.mark.parametrize("spacing", [1.0, 2.5])
def test_a_sheet_has_the_tensile_stiffness_of_its_fabric_on_any_mesh(fabric: Fabric, spacing: float) -> None:
    sheet = strip(15.0, 13.0, spacing)
    assert stiffnesses(sheet, fabric) == pytest.approx(tuple(fabric.pull), rel=1e-3)
    uneven = sheet.uv + 0.08 * spacing * np.random.default_rng(1).standard_normal(sheet.uv.shape)
    assert stiffnesses(replace(sheet, uv=uneven), fabric) == pytest.approx(tuple(fabric.pull), rel=1e-3)


@pytest.mark.parametrize("grain", ["warp", "weft"])
def test_a_hanging_strip_stretches_by_its_weight_along_the_grain(grain: Grain) -> None:
    """A strip of length L held at its top grows by rho g L² / (2 E)."""
    fabric, length = Fabric(tensile=Tensile(40.0, 25.0, 15.0), bending=1e-6), 30.0
    down = {"warp": [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], "weft": [[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]]}[grain]
    size = (5.0, length) if grain == "warp" else (length, 5.0)
    mesh = strip(*size, 1.0, orientation=np.array(down))
    height = mesh.vertices[:, 1]
    top, bottom = height > height.max() - 1e-6, height < height.min() + 1e-6
    x = settled(mesh, fabric, top, seconds=1.2)
    long = np.ptp(height)
    grown = x[top, 1].mean() - x[bottom, 1].mean() - long
    stiffness = 1e3 * getattr(fabric.pull, grain)
    assert grown == pytest.approx(fabric.mass * GRAVITY * long**2 / (2 * stiffness), rel=0.05)


def test_a_strip_held_at_both_ends_hangs_as_a_catenary() -> None:
    mesh = strip(40.0, 4.0, 1.0)
    span, x = 28.0, mesh.vertices[:, 0]
    ends = np.abs(x) > np.abs(x).max() - 1e-6
    slack = np.array(mesh.vertices)
    slack[:, 0] *= span / np.ptp(x)
    slack[:, 1] -= 10.0 * (1 - (x / x.max()) ** 2)
    found = settled(replace(mesh, vertices=slack), FABRICS["gcd_soft"], ends, seconds=2.0)
    length = np.linalg.norm(np.diff(found[np.isclose(mesh.uv[:, 1], mesh.uv[:, 1].max())], axis=0), axis=1).sum()
    tight = brentq(lambda a: 2 * a * np.sinh(span / (2 * a)) - length, 3.0, 100.0)
    expected = LEVEL + tight * (np.cosh(found[:, 0] / tight) - np.cosh(span / (2 * tight)))
    assert np.abs(found[:, 1] - expected).max() < 0.03 * (LEVEL - found[:, 1].min())


def settled(mesh: BoxMesh, fabric: Fabric, held: np.ndarray, *, seconds: float) -> np.ndarray:
    """Positions after ``seconds``, with some vertices held [cm]."""
    config = DrapeConfig(sewing_time=1e-4, held_time=1e6, max_frames=10_000, damping=8.0)
    solver = Solver(build_model([strip_job(mesh, fabric)], config, "cpu"), config)
    hold_fast(solver.model, held)
    solver.run_for(seconds)
    return np.asarray(solver.state.x.numpy().astype(float))


@pytest.mark.parametrize("fabric", [WOVEN, FABRICS["denim"]], ids=["made_up", "denim"])
@pytest.mark.parametrize("grain", ["warp", "weft"])
@pytest.mark.parametrize("spacing", [1.0, 2.0])
def test_a_strip_over_an_edge_has_its_bending_length(fabric: Fabric, grain: Grain, spacing: float) -> None:
    """On meshes whose edges are no longer than the bending length."""
    expected = bending_length(fabric, grain)
    if expected >= spacing:
        assert cantilever(fabric, grain, spacing=spacing) == pytest.approx(expected, rel=0.05)


def test_a_softened_fabric_has_limited_stiffness_in_each_direction() -> None:
    wool = FABRICS["wool_light"]
    soft = wool.softened(500.0)
    assert soft.pull == pytest.approx((84.0, 84.0, 84.0))
    assert replace(soft, tensile=wool.tensile) == wool
    assert wool.softened(1e6) == wool
    assert Fabric(tensile=300.0).softened(500.0) == Fabric(tensile=100.0)
    for fabric in FABRICS.values():
        assert max(fabric.softened().pull) <= 500.0 * fabric.density * (1 + 1e-9)
    # With its shear kept instead, the bias of this cloth became 16 % softer than measured.
    polyester = FABRICS["polyester_woven"]
    assert polyester.softened().pull.bias == polyester.pull.bias < 500.0 * polyester.density < polyester.pull.warp


def test_the_solver_softens_fabrics_up_to_the_limit_of_its_options() -> None:
    sheet, wool = strip(6.0, 6.0, 1.0), FABRICS["wool_light"]
    usual = build_model([strip_job(sheet, wool)], DrapeConfig(), "cpu")
    stiff = build_model([strip_job(sheet, wool)], DrapeConfig(stiffest=1e9), "cpu")
    assert stiff.worlds.numpy()["dt"][0] < 0.3 * usual.worlds.numpy()["dt"][0]


def test_every_named_fabric_has_a_source() -> None:
    assert len(FABRICS) >= 10
    for name, fabric in FABRICS.items():
        assert fabric_named(name) is fabric
        assert fabric.source or name == "default"
        assert 0.3 < bending_length(fabric, "warp") < 5.0  # cm: from the limpest cloth to the stiffest
    assert fabric_named("default") == Fabric()


def test_a_fabric_without_published_thickness_says_which_is_assumed() -> None:
    """The cloths of Wang et al. for which no class of thickness was published."""
    assumed = [name for name, fabric in FABRICS.items() if "thickness: not published" in fabric.source]
    assert assumed == ["interlock", "ponte_roma"]
    for name in assumed:
        figure = re.search(r"thickness: not published; ([\d.]+) cm is assumed, the least", FABRICS[name].source)
        assert figure
        assert float(figure[1]) == FABRICS[name].thickness == DrapeConfig().layer_gap


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"density": 0.0}, "density is 0.0"),
        ({"bending": Bending(1e-5, -1e-5)}, "bending is"),
        ({"layer_friction": -0.1}, "layer_friction is -0.1"),
        ({"tensile": Tensile(100.0, 50.0, 400.0)}, "on the bias is 400.0 N/m: .* below 194"),
    ],
)
def test_an_impossible_fabric_is_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Fabric(**wrong)  # type: ignore[arg-type]


SKIRTS = Overlay.from_dict({"meta": {"upper": "none", "bottom": "PencilSkirt"}})  # they come to rest soon
SMALL = MakeConfig(resolution=10.0, points=16, picture=0, device="cpu", fabric="random", on_fail="keep", design=SKIRTS)


def figures(fabric: Fabric) -> np.ndarray:
    return np.array([fabric.density, fabric.thickness, *fabric.pull[:2], shear_stiffness(fabric.pull), *fabric.bend])


def test_random_fabrics_stay_within_the_measurements_and_fill_them() -> None:
    drawn = np.log([figures(draw_fabric(rng(3, index, Stage.FABRIC))) for index in range(200)])
    measured = np.log([figures(FABRICS[name]) for name in MEASURED])
    low, high = measured.min(axis=0), measured.max(axis=0)
    assert (drawn >= low - 1e-9).all()
    assert (drawn <= high + 1e-9).all()
    assert (np.ptp(drawn, axis=0) > 0.9 * (high - low)).all()


def test_a_random_fabric_lies_between_two_measured_ones() -> None:
    fabric = draw_fabric(rng(3, 5, Stage.FABRIC))
    ends = [FABRICS[name] for name in MEASURED if name in fabric.source]
    assert len(ends) >= 2
    place = float(fabric.source.split()[1])
    pairs = [(a, b) for a in ends for b in ends if a is not b]
    between = [(1 - place) * np.log(figures(a)) + place * np.log(figures(b)) for a, b in pairs]
    assert min(np.abs(np.log(figures(fabric)) - figure).max() for figure in between) < 1e-3


def test_a_random_fabric_is_draped_recorded_and_stored() -> None:
    first, second = produce(5, range(2), SMALL)
    for index, sample in enumerate((first, second)):
        assert sample.fabric is not None
        assert sample.fabric.name == "random"
        expected = sample_fabric(5, index, "random")
        assert sample.fabric.parameters["density"] == expected.density
        assert as_fabric(sample.fabric.parameters) == asdict(expected)
        assert decode_sample(encode_sample(sample)).fabric == sample.fabric
    assert first.fabric != second.fabric
    assert make(5, 1, SMALL) == second
    denim = make(5, 1, replace(SMALL, fabric="denim"))
    assert denim.fabric is not None
    assert denim.pattern == second.pattern
    assert as_fabric(denim.fabric.parameters) == asdict(FABRICS["denim"])


def as_fabric(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in parameters.items()}
