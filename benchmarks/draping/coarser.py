"""Meshes of fewer vertices, as scans have them."""

import numpy as np
from scipy.sparse import csr_matrix

from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.meshedges import mesh_edges

BIN = 0.25  # cm: edges within a bin collapse in random order, so that many collapse per round

_Mesh = tuple[np.ndarray, np.ndarray]  # vertices, faces


def coarser(vertices: np.ndarray, faces: np.ndarray, count: int) -> _Mesh:
    """The mesh simplified to ``count`` vertices on its surface, by collapsing the shortest edges.

    An edge may collapse if its ends share exactly two neighbours, which keeps the topology (Dey et al., 1999); each
    round collapses the locally shortest edges.
    """
    surface = SkinSurface.of(vertices, faces)
    while len(vertices) > count:
        collapsing = _shortest_around(vertices, faces)[: len(vertices) - count]
        moved, target = vertices.copy(), np.arange(len(vertices))
        moved[collapsing[:, 0]] = vertices[collapsing].mean(axis=1)
        target[collapsing[:, 1]] = collapsing[:, 0]
        # Keep edges whose collapse would flip a face; collapsing edges are far apart, so one edge flips a face.
        flipped = np.unique(faces[_flipped(vertices, moved[target], faces, target)])
        collapsing = collapsing[~np.isin(collapsing, flipped).any(axis=1)]
        if not len(collapsing):
            break
        target = np.arange(len(vertices))
        target[collapsing[:, 1]] = collapsing[:, 0]
        vertices = vertices.copy()
        vertices[collapsing[:, 0]] = surface.nearest(vertices[collapsing].mean(axis=1)).points
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        used, renumbered = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], renumbered.reshape(-1, 3)
    return vertices, faces


def _shortest_around(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Collapsible edges that are shorter than all others near their ends, shortest first."""
    edges = mesh_edges(faces).ends
    size = len(vertices)
    graph = csr_matrix((np.ones(len(edges)), edges.T), shape=(size, size))
    graph = graph + graph.T
    common = np.asarray(graph[edges[:, 0]].multiply(graph[edges[:, 1]]).sum(axis=1)).ravel()
    edges = np.random.default_rng(0).permutation(edges[common == 2])
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    edges = edges[np.argsort(np.round(length / BIN), kind="stable")]
    rank = np.arange(len(edges), dtype=float)
    least = np.full(size, np.inf)
    for end in edges.T:
        np.minimum.at(least, end, rank)
    first, second = graph.nonzero()
    wider = least.copy()
    np.minimum.at(wider, first, least[second])
    return edges[(wider[edges] == rank[:, None]).all(axis=1)]


def _flipped(before: np.ndarray, after: np.ndarray, faces: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether each remaining face is flipped by a collapse."""
    normals = [np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]) for p in (before, after)]
    moved = target[faces]
    stays = (moved != np.roll(moved, 1, axis=1)).all(axis=1)
    return stays & (np.einsum("fi,fi->f", *normals) <= 0)
