"""Shortest paths on surfaces with known geodesics."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.body.geodesic import GeodesicGraph


def test_a_geodesic_of_a_ball() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    start, end = int(ball.vertices[:, 1].argmax()), int(ball.vertices[:, 0].argmax())
    angle = np.arccos(ball.vertices[start] @ ball.vertices[end] / 100.0)
    graph = GeodesicGraph.over(np.asarray(ball.faces), start, end, points_per_edge=3)
    assert graph.length(ball.vertices) == pytest.approx(10.0 * angle, rel=0.005)


def test_a_path_over_a_flat_sheet_is_straight_across_edges() -> None:
    x, y = np.meshgrid(np.arange(11.0), np.arange(8.0))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(88)], axis=1)
    cell = np.array([11 * j + i for j in range(7) for i in range(10)])
    faces = np.concatenate([np.stack([cell, cell + 1, cell + 12], 1), np.stack([cell, cell + 12, cell + 11], 1)])
    graph = GeodesicGraph.over(faces, 0, 87, points_per_edge=4)
    assert graph.length(vertices) == pytest.approx(np.hypot(10.0, 7.0), rel=0.005)
    assert graph.without_detours(vertices, least=0.8).length(vertices) == pytest.approx(
        graph.length(vertices), rel=1e-9
    )
    path = graph.path(vertices)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(graph.length(vertices))
