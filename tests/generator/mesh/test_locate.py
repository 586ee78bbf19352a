"""Point location."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from gcd_dataset.generator.mesh.coarse import barycentric, locate


def scattered(seed: int) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(seed).uniform(0.0, 20.0, (120, 2))
    return points, Delaunay(points).simplices


@pytest.mark.parametrize("cell", [0.3, 1.0, 50.0])
def test_the_triangle_holds_the_point(cell: float) -> None:
    """Means of three corners with positive weights lie in that triangle, and in no other."""
    points, faces = scattered(0)
    rng = np.random.default_rng(1)
    triangle = rng.integers(len(faces), size=500)
    shares = rng.dirichlet(np.ones(3), size=500)
    queries = np.einsum("nk,nkd->nd", shares, points[faces[triangle]])
    assert (locate(points, faces, queries, cell) == triangle).all()
    assert pytest.approx(shares, abs=1e-6) == barycentric(points, faces[triangle], queries).T


def test_a_point_beside_a_triangle_gets_it() -> None:
    points, faces = np.array([(0.0, 0.0), (4.0, 0.0), (0.0, 4.0), (40.0, 40.0)]), np.array([(0, 1, 2), (1, 3, 2)])
    assert locate(points, faces, np.array([(1.0, -0.01), (30.0, 60.0)]), 1.0).tolist() == [0, 1]


def test_no_points_need_no_triangles() -> None:
    points, faces = scattered(2)
    assert locate(points, faces, np.zeros((0, 2)), 1.0).shape == (0,)
