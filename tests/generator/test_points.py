"""Sampled points lie on the surface and are uniform by area."""

import numpy as np
import trimesh

from gcd_dataset.generator.quality import sample_surface


def test_points_of_a_ball_lie_on_it_with_outward_normals() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    sampled = sample_surface(np.asarray(ball.vertices), np.asarray(ball.faces), 500, np.random.default_rng(0))
    points, normals = sampled[:, :3], sampled[:, 3:]
    assert np.abs(np.linalg.norm(points, axis=1) - 10.0).max() < 0.05
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (np.einsum("ij,ij->i", points / 10.0, normals) > 0.99).all()


def test_points_are_spread_by_area() -> None:
    """A triangle with three times the area of another gets three quarters of the points."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 1, 5]], float)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    points = sample_surface(vertices, faces, 4000, np.random.default_rng(1))[:, :3]
    large = points[points[:, 2] > 1]
    assert len(large) == 3000
    assert np.allclose(large.mean(axis=0), [1.0, 1 / 3, 5.0], atol=0.05)  # uniform: the mean is the centroid


def test_any_slice_of_the_points_is_spread_like_all_of_them() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 1, 5]], float)
    points = sample_surface(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 4000, np.random.default_rng(1))
    assert abs((points[:400, 2] > 1).mean() - 0.75) < 0.08
