"""Curved start: bent panels keep their lengths, stay outside the body, on their side and in their layer."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.generator.drape.arrange import arrange
from gcd_dataset.generator.drape.limbs import limbs_of
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import Body, BodyPart, BoxMesh, Outcome, Panel, Pattern, Placement
from tests.generator.dressing.test_openings import tube
from tests.helpers import SIZE, body_from

RADIUS = 14.0
HALF_GIRTH = np.pi * (RADIUS + 2.0)  # of the ellipse on which ``arrange`` wraps the innermost panels


@pytest.fixture(scope="module")
def barrel() -> Body:
    """A trunk with circular cross sections."""
    cylinder = trimesh.creation.cylinder(radius=RADIUS, height=SIZE.waist_level, sections=64)
    cylinder.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    cylinder.apply_translation([0.0, SIZE.waist_level / 2, 0.0])
    return body_from(cylinder.subdivide().subdivide())


def box_mesh(wide: float, *, label: str = "leg") -> BoxMesh:
    """A front and a back panel, 40 cm tall, sewn at the sides."""
    pattern = tube(wide, 40.0, y=60.0)
    return build_box_mesh(replace(pattern, panels=tuple(replace(p, label=label) for p in pattern.panels)), spacing=2.0)


def side_lengths(points: np.ndarray, mesh: BoxMesh) -> np.ndarray:
    """Edge lengths of the faces without a seam vertex [cm]."""
    faces = mesh.faces[(mesh.faces >= mesh.n_seam_vertices).all(axis=1)]
    return np.asarray(np.linalg.norm(points[faces] - points[np.roll(faces, 1, axis=1)], axis=2))


def test_a_bent_panel_keeps_its_lengths_and_stays_outside(barrel: Body) -> None:
    mesh = box_mesh(HALF_GIRTH)
    start = arrange(mesh, barrel)
    assert np.allclose(side_lengths(start, mesh), side_lengths(np.asarray(mesh.vertices), mesh), rtol=5e-3)
    distance = np.hypot(start[:, 0], start[:, 2])
    assert distance.min() > RADIUS + 1.0
    assert distance.max() < RADIUS + 3.5
    assert np.allclose(start[:, 1], mesh.vertices[:, 1])  # heights stay


def test_seams_begin_nearly_closed(barrel: Body) -> None:
    """Cut for the girth, the side edges meet; flat, they hang 40 cm apart."""
    mesh = box_mesh(HALF_GIRTH)
    seam = mesh.faces[(mesh.faces < mesh.n_seam_vertices).any(axis=1)]

    def longest(points: np.ndarray) -> float:
        return float(np.linalg.norm(points[seam] - points[np.roll(seam, 1, axis=1)], axis=2).max())

    assert longest(np.asarray(mesh.vertices)) > 20.0
    assert longest(arrange(mesh, barrel)) < 4.0


@pytest.mark.parametrize("wide", [30.0, HALF_GIRTH, 90.0, 200.0])
def test_each_panel_stays_in_front_or_behind(barrel: Body, wide: float) -> None:
    mesh = box_mesh(wide)
    start, free = arrange(mesh, barrel), np.arange(len(mesh.vertices)) >= mesh.n_seam_vertices
    assert (np.sign(start[free, 2]) == np.sign(mesh.vertices[free, 2])).all()
    assert (start[free, 0] * mesh.vertices[free, 0] > -1e-9).all()


def test_overlapping_panels_stay_flat(barrel: Body) -> None:
    inner = tube(HALF_GIRTH, 40.0, y=60.0)
    outer = [replace(_further(panel, 1.5), name=f"outer_{panel.name}") for panel in inner.panels]
    mesh = build_box_mesh(Pattern("layers", (*inner.panels, *outer), inner.seams), spacing=2.0)
    assert np.allclose(arrange(mesh, barrel), mesh.vertices, atol=1e-9)


def test_a_bodice_stays_outside_the_band_below_it(barrel: Body) -> None:
    band = tube(HALF_GIRTH, 20.0, y=60.0)
    bodice = [replace(_raised(_further(panel, 1.5), 18.0), name=f"bodice_{panel.name}") for panel in band.panels]
    mesh = build_box_mesh(Pattern("layers", (*band.panels, *bodice), band.seams), spacing=2.0)
    start = arrange(mesh, barrel)
    distance = np.hypot(start[:, 0], start[:, 2])
    by_panel = [distance[np.unique(mesh.faces[mesh.panel_id == i])] for i in range(4)]
    assert np.median(by_panel[2]) > np.median(by_panel[0]) + 1.0
    assert np.median(by_panel[3]) > np.median(by_panel[1]) + 1.0


def test_a_level_panel_stays_flat(barrel: Body) -> None:
    level = replace(
        tube(30.0, 30.0).panels[0], placement=Placement(np.array([0, 120.0, 0]), np.array([np.pi / 2, 0, 0]))
    )
    mesh = build_box_mesh(Pattern("collar", (level,), ()), spacing=2.0)
    assert np.allclose(arrange(mesh, barrel), mesh.vertices, atol=1e-9)


def test_limbs_contain_their_part_and_point_away_from_the_trunk() -> None:
    arm = trimesh.creation.cylinder(radius=4.0, segment=[[20, 130, 0], [60, 90, 0]], sections=32)
    trunk = trimesh.creation.box(
        extents=[36, 140, 20], transform=trimesh.transformations.translation_matrix([0, 70, 0])
    )
    dense = trunk.subdivide().subdivide()
    both = trimesh.util.concatenate([dense, arm])
    parts = np.repeat([BodyPart.TRUNK.value, BodyPart.LEFT_ARM.value], [len(dense.vertices), len(arm.vertices)])
    limbs = limbs_of(Body(np.asarray(both.vertices), np.asarray(both.faces), parts.astype(np.uint8)))
    assert set(limbs) == {BodyPart.TRUNK, BodyPart.LEFT_ARM}
    assert np.allclose(limbs[BodyPart.LEFT_ARM].axis, [np.sqrt(0.5), -np.sqrt(0.5), 0.0], atol=1e-6)
    for limb in limbs.values():
        across, _, forward = limb.local(limb.skin).T
        assert np.hypot(across / limb.wide, forward / limb.deep).max() == pytest.approx(1.0)


def test_a_body_without_a_trunk_is_refused(barrel: Body) -> None:
    with pytest.raises(BodyError, match="no trunk"):
        limbs_of(replace(barrel, parts=np.full(len(barrel.vertices), BodyPart.HEAD.value, np.uint8)))


def test_a_skirt_with_a_curved_start_settles(barrel: Body) -> None:
    mesh = box_mesh(HALF_GIRTH + 2.0)
    held = {"lower_interface": np.flatnonzero(mesh.vertices[:, 1] > 99.9)}
    config = DrapeConfig(curved_start=True, max_frames=200)
    lifted = replace(mesh, vertices=mesh.vertices + [0.0, SIZE.waist_level - 100.0, 0.0], labels=held)
    [drape] = drape_batch([DrapeJob(lifted, barrel, SIZE)], config, device="cpu")
    assert drape.outcome in (Outcome.SETTLED, Outcome.SLID_OFF)  # only friction keeps it on a barrel
    assert (drape.self_crossings, drape.body_crossings) == (0, 0)


def _further(panel: Panel, times: float) -> Panel:
    x, y, z = panel.placement.translation
    return replace(panel, placement=Placement(np.array([x, y, times * z]), panel.placement.rotation))


def _raised(panel: Panel, by: float) -> Panel:
    return replace(panel, placement=Placement(panel.placement.translation + [0.0, by, 0.0], panel.placement.rotation))
