"""Principal stretches of known deformations, grades of drapes, and points sampled on surfaces."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.quality import (
    MAX_STRETCH,
    grade_of,
    grade_of_outfit,
    principal_stretches,
    sample_surface,
    strain_of,
)
from gcd_dataset.records import Drape, Grade, Layer, Outcome, Outfit, Pattern, Strain, WornGarment
from tests.helpers import joined, patch

AT_REST = Drape(np.zeros((0, 3)), Outcome.SETTLED, 10, 0, 0, 1.0, 1.1)
LOOSE = Strain((1.1, 0.9), ((1.1, 0.9),))


def test_principal_stretches_of_a_stretched_a_sheared_and_a_folded_sheet() -> None:
    sheet = patch(5, 5)
    flat = np.asarray(sheet.vertices, float)
    stretches = principal_stretches(sheet, flat * [1.3, 0.8, 1.0])
    assert stretches[:, 0] == pytest.approx(1.3)
    assert stretches[:, 1] == pytest.approx(0.8)
    # [[1, k], [0, 1]] has singular values s and 1/s.
    k = 0.5
    stretches = principal_stretches(sheet, np.stack([flat[:, 0] + k * flat[:, 1], flat[:, 1], flat[:, 2]], axis=1))
    expected = np.linalg.svd([[1.0, k], [0.0, 1.0]])[1]
    assert stretches == pytest.approx(np.broadcast_to(expected, stretches.shape))
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert principal_stretches(sheet, flat @ turn.T + 7.0) == pytest.approx(1.0)


def test_each_panel_has_its_own_stretch() -> None:
    mesh = joined(patch(5, 5), patch(5, 5, origin=(20.0, 100.0, 0.0)))
    points = np.array(mesh.vertices, float)
    points[len(points) // 2 :] *= 1.6
    strain = strain_of(mesh, points)
    assert strain is not None
    assert [largest for largest, _ in strain.panels] == pytest.approx([1.0, 1.6])
    assert strain_of(mesh, np.full_like(points, np.nan)) is None


@pytest.mark.parametrize(
    ("change", "strain", "grade"),
    [
        ({}, LOOSE, Grade.CLEAN),
        ({"self_crossings": 1}, LOOSE, Grade.PAPER),
        ({"body_crossings": 1}, LOOSE, Grade.PAPER),
        ({"body_through": 1}, LOOSE, Grade.PAPER),
        ({}, Strain((1.2, 0.9), ((1.1, 0.9), (MAX_STRETCH + 0.1, 0.9))), Grade.PAPER),
        ({"outcome": Outcome.OVERSTRETCHED}, LOOSE, Grade.PAPER),
        ({"outcome": Outcome.SLID_OFF}, LOOSE, Grade.FAILED),
        ({"outcome": Outcome.THROUGH_ITSELF}, LOOSE, Grade.FAILED),
    ],
)
def test_grades(change: dict[str, object], strain: Strain, grade: Grade) -> None:
    drape = replace(AT_REST, **change)  # type: ignore[arg-type]
    assert grade_of(drape, strain) is grade


@pytest.mark.parametrize(
    ("change", "layer", "grade"),
    [
        ({}, Layer(0, 1, 0, 200, 0.005), Grade.CLEAN),
        ({}, Layer(0, 1, 1, 200, 0.0), Grade.PAPER),
        ({}, Layer(0, 1, 0, 200, 0.0051), Grade.PAPER),
        ({"self_crossings": 1}, Layer(0, 1, 0, 200, 0.0), Grade.PAPER),
        ({"outcome": Outcome.NOT_SETTLED}, Layer(0, 1, 0, 200, 0.0), Grade.FAILED),
        (None, Layer(0, 1, 0, 0, 0.0), Grade.FAILED),
    ],
)
def test_an_outfit_is_as_good_as_its_worst_garment_and_layer(
    change: dict[str, object] | None, layer: Layer, grade: Grade
) -> None:
    clean = replace(AT_REST, strain=LOOSE)
    outer = None if change is None else replace(clean, **change)  # type: ignore[arg-type]
    shirt, coat = (WornGarment(Pattern("", (), ()), drape=drape) for drape in (clean, outer))
    assert grade_of_outfit(Outfit((shirt, coat), (layer,))) is grade


def test_points_of_a_ball_lie_on_it_with_outward_normals() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    sampled = sample_surface(np.asarray(ball.vertices), np.asarray(ball.faces), 500, np.random.default_rng(0))
    points, normals = sampled[:, :3], sampled[:, 3:]
    assert np.abs(np.linalg.norm(points, axis=1) - 10.0).max() < 0.05
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (np.einsum("ij,ij->i", points / 10.0, normals) > 0.99).all()


def test_points_are_spread_by_area_in_any_slice() -> None:
    """A triangle with three times the area of another gets three quarters of the points."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 1, 5]], float)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    points = sample_surface(vertices, faces, 4000, np.random.default_rng(1))[:, :3]
    assert abs((points[:400, 2] > 1).mean() - 0.75) < 0.08
    large = points[points[:, 2] > 1]
    assert len(large) == 3000
    assert np.allclose(large.mean(axis=0), [1.0, 1 / 3, 5.0], atol=0.05)  # uniform: the mean is the centroid
