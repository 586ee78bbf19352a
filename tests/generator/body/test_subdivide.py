"""Loop subdivision of a part of a mesh."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.body.surface import refine


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_refined_closed_mesh_stays_closed_and_keeps_its_vertices(share: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    marked = np.random.default_rng(0).random(len(ball.faces)) < share
    matrix, faces = refine(np.asarray(ball.faces), marked, len(ball.vertices))
    finer = trimesh.Trimesh(matrix @ ball.vertices, faces, process=False)
    assert finer.is_watertight
    assert finer.is_winding_consistent
    assert finer.volume == pytest.approx(ball.volume, rel=0.02)
    assert np.abs(finer.vertices[: len(ball.vertices)] - ball.vertices).max() < 0.1
    assert len(faces) >= len(ball.faces) + 3 * marked.sum()


def test_every_new_vertex_is_a_weighted_mean() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    matrix, _ = refine(np.asarray(ball.faces), np.ones(len(ball.faces), bool), len(ball.vertices))
    assert matrix @ np.ones(len(ball.vertices)) == pytest.approx(np.ones(matrix.shape[0]))
    assert matrix.shape[0] == len(ball.vertices) + len(ball.edges_unique)


def test_a_flat_sheet_is_refined_evenly() -> None:
    """In a regular flat lattice Loop's weights keep the plane and put new vertices at the midpoints of edges."""
    rows = np.array([(i + 0.5 * j, j * np.sqrt(3) / 2) for j in range(7) for i in range(7)])
    vertices = np.column_stack([rows, np.zeros(49)])
    cell = np.array([7 * j + i for j in range(6) for i in range(6)])
    faces = np.concatenate([np.stack([cell, cell + 1, cell + 7], 1), np.stack([cell + 1, cell + 8, cell + 7], 1)])
    inner = ((vertices[faces].mean(axis=1)[:, 1] > 1.5) & (vertices[faces].mean(axis=1)[:, 1] < 3.5)).nonzero()[0]
    marked = np.zeros(len(faces), bool)
    marked[inner[len(inner) // 2]] = True
    matrix, _ = refine(faces, marked, 49)
    face = faces[marked][0]
    middles = (vertices[face] + vertices[np.roll(face, -1)]) / 2
    assert {tuple(p) for p in (matrix @ vertices)[49:].round(9)} == {tuple(p) for p in middles.round(9)}
