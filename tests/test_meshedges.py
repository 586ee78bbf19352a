"""Edges of triangle meshes."""

import numpy as np
import trimesh

from gcd_dataset.meshedges import mesh_edges


def test_edges_are_those_that_trimesh_finds() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2)
    edges = mesh_edges(sphere.faces)
    expected = np.sort(sphere.edges_unique, axis=1)
    assert (edges.ends == expected[np.lexsort(expected.T[::-1])]).all()
    assert (edges.counts == 2).all()
    assert len(sphere.vertices) - len(edges.ends) + len(sphere.faces) == 2  # Euler's formula


def test_faces_know_their_edges() -> None:
    faces = np.array([[4, 0, 9], [0, 4, 2]], np.uint16)
    edges = mesh_edges(faces)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    assert (edges.ends[edges.of_faces] == np.sort(sides, axis=2)).all()
    assert edges.counts[edges.of_faces].tolist() == [[2, 1, 1], [2, 1, 1]]


def test_no_faces_have_no_edges() -> None:
    edges = mesh_edges(np.zeros((0, 3), int))
    assert (edges.ends.shape, edges.of_faces.shape, edges.counts.shape) == ((0, 2), (0, 3), (0,))
