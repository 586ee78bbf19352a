"""Coordinates on flat cloth: distances along edges, borders, and harmonic functions."""

import numpy as np
import pytest

from gcd_dataset.generator.dressing.flat_cloth import FlatCloth
from gcd_dataset.records import BoxMesh
from tests.helpers import patch


def strip() -> tuple[BoxMesh, FlatCloth]:
    """A strip of 12 cm by 5 cm."""
    mesh = patch(12, 5)
    return mesh, FlatCloth.of(mesh, np.ones(len(mesh.faces), bool))


def test_a_harmonic_function_between_the_ends_of_a_strip_is_linear() -> None:
    """Up to 0.003: the cotangent weights of right angles are 0, and are raised to ``LEAST_WEIGHT``."""
    mesh, cloth = strip()
    along = mesh.uv[:, 0]
    ends = np.flatnonzero((along == along.min()) | (along == along.max()))
    values = cloth.harmonic(ends, (along[ends] > along.mean()).astype(float))
    assert values == pytest.approx((along - along.min()) / np.ptp(along), abs=0.003)


def test_a_harmonic_function_keeps_the_bounds_of_its_border() -> None:
    _, cloth = strip()
    border = cloth.border
    assert len(border) == 2 * (12 + 5)
    values = cloth.harmonic(border, np.sin(np.arange(len(border))))
    assert np.abs(values).max() == pytest.approx(np.abs(np.sin(np.arange(len(border)))).max())


def test_distances_run_along_edges() -> None:
    mesh, cloth = strip()
    corner = int(np.argmin(mesh.uv.sum(axis=1)))
    distance = cloth.distance_from(np.array([corner]))
    straight = np.linalg.norm(mesh.uv - mesh.uv[corner], axis=1)
    assert (distance >= straight - 1e-9).all()
    on_side = mesh.uv[:, 1] == mesh.uv[corner, 1]
    assert distance[on_side] == pytest.approx(straight[on_side])
    assert cloth.area == pytest.approx(60.0)
