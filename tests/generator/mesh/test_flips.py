"""Constrained Delaunay: missing segments are recovered by edge flips."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.flips import restore_segments
from tests.generator.mesh.shapes import areas, directed_edges, undirected_edges

SLIT = np.array([(0, 0), (6, 0), (6, 2), (2, 2.1), (6, 2.2), (6, 4), (0, 4)], float)
"""A slit 0.2 cm wide. Its sides are not edges of the Delaunay triangulation: the points across are nearer."""


def triangles(points: np.ndarray) -> np.ndarray:
    faces = Delaunay(points).simplices
    return np.where(areas(points, faces)[:, None] < 0, faces[:, ::-1], faces)


def loop_of(n: int) -> np.ndarray:
    """The next point of each on a loop of n points."""
    return np.roll(np.arange(n), -1)


def has_segments(faces: np.ndarray, n: int) -> bool:
    edges, _ = undirected_edges(faces)
    loop = np.sort(np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1), axis=1)
    return set(map(tuple, loop.tolist())) <= set(map(tuple, edges.tolist()))


def dense_slit(random: np.random.Generator) -> tuple[np.ndarray, int]:
    """Random points, and a polygon through some of them with sides close to others."""
    border = SLIT + random.uniform(-0.02, 0.02, SLIT.shape)
    inside = random.uniform(0.05, 1.9, (40, 2)) * [3.0, 1.0]
    return np.concatenate([border, inside, inside + [0.0, 2.15]]), len(border)


@pytest.mark.parametrize("seed", range(8))
def test_every_segment_is_an_edge_afterwards(seed: int) -> None:
    points, n = dense_slit(np.random.default_rng(seed))
    before = triangles(points)
    assert not has_segments(before, n)
    after = restore_segments(points, before, loop_of(n))
    assert has_segments(after, n)
    assert (areas(points, after) > 0).all()
    assert areas(points, after).sum() == pytest.approx(areas(points, before).sum())
    assert len(np.unique(directed_edges(after), axis=0)) == 3 * len(after)  # no face lies on another


@pytest.mark.parametrize("seed", range(8))
def test_all_edges_except_segments_are_delaunay(seed: int) -> None:
    """The two angles opposite every other edge add up to at most half a turn."""
    points, n = dense_slit(np.random.default_rng(seed))
    faces = restore_segments(points, triangles(points), loop_of(n))
    opposite = {(int(f[k]), int(f[k - 2])): int(f[k - 1]) for f in faces for k in range(3)}
    for (u, v), apex in opposite.items():
        if (v, u) in opposite and not (max(u, v) < n and (v - u) % n in (1, n - 1)):
            assert angle(points, u, apex, v) + angle(points, u, opposite[v, u], v) <= np.pi + 1e-6


def angle(points: np.ndarray, a: int, apex: int, b: int) -> float:
    to_a, to_b = points[a] - points[apex], points[b] - points[apex]
    return float(np.arccos(to_a @ to_b / np.linalg.norm(to_a) / np.linalg.norm(to_b)))


def test_a_triangulation_with_all_segments_is_unchanged() -> None:
    points = np.array([(0, 0), (2, 0), (2, 1.1), (0, 1)], float)
    faces = triangles(points)
    assert restore_segments(points, faces, loop_of(4)) is faces


def test_a_point_on_a_segment_is_an_error() -> None:
    """The outline 0-1-2-3 runs through its own corner 3 on the way from 0 to 1."""
    points = np.array([(0, 0), (4, 0), (2, 3), (2, 0), (2, -3)], float)
    with pytest.raises(MeshError, match=r"the outline touches itself near \(0.00, 0.00\) cm"):
        restore_segments(points, triangles(points), loop_of(4))
