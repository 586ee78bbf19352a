"""Principal stretches of known deformations, and grades of drapes."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.generator.quality import MAX_STRETCH, grade_of, principal_stretches, strain_of
from gcd_dataset.records import Drape, Grade, Outcome, Strain
from tests.helpers import joined, patch

AT_REST = Drape(np.zeros((0, 3)), Outcome.SETTLED, 10, 0, 0, 1.0, 1.1)
LOOSE = Strain((1.1, 0.9), ((1.1, 0.9),))


def test_a_stretched_sheet_has_the_stretches_of_its_axes() -> None:
    sheet = patch(5, 5)
    flat = np.asarray(sheet.vertices, float)
    stretches = principal_stretches(sheet, flat * [1.3, 0.8, 1.0])
    assert stretches[:, 0] == pytest.approx(1.3)
    assert stretches[:, 1] == pytest.approx(0.8)


def test_shear_stretches_by_the_singular_values() -> None:
    """[[1, k], [0, 1]] has singular values s and 1/s."""
    sheet, k = patch(4, 4), 0.5
    flat = np.asarray(sheet.vertices, float)
    stretches = principal_stretches(sheet, np.stack([flat[:, 0] + k * flat[:, 1], flat[:, 1], flat[:, 2]], axis=1))
    expected = np.linalg.svd([[1.0, k], [0.0, 1.0]])[1]
    assert stretches == pytest.approx(np.broadcast_to(expected, stretches.shape))


def test_rotation_and_folding_do_not_stretch() -> None:
    sheet = patch(6, 6)
    flat = np.asarray(sheet.vertices, float)
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
