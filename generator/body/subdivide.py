"""One level of Loop subdivision on a part of a mesh, as a sparse matrix."""

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import csr_matrix

from gcd_dataset.meshedges import mesh_edges


def refine(
    faces: Int[np.ndarray, "f 3"], marked: Bool[np.ndarray, " f"], n_vertices: int
) -> tuple[csr_matrix, Int[np.ndarray, "g 3"]]:
    """Subdivide the marked faces: the matrix (w, v) from old to new vertices, and the new faces.

    Old vertices keep their numbers. Weights after C. Loop, Smooth Subdivision Surfaces Based on Triangles (1987); on
    the boundary of the marked part vertices stay and edges are halved, so that a closed mesh stays closed.
    """
    edges, face_edges, _ = mesh_edges(faces)
    marks = np.bincount(face_edges[marked].ravel(), minlength=len(edges))
    added = np.full(len(edges), -1)
    added[marks > 0] = n_vertices + np.arange((marks > 0).sum())
    entries = [
        _vertex_rule(faces, marked, edges, n_vertices),
        _edge_ends_rule(edges, marks, added),
        _edge_opposites_rule(faces, face_edges, marks, added),
    ]
    rows, columns, weights = (np.concatenate(part) for part in zip(*entries, strict=True))
    shape = (n_vertices + (marks > 0).sum(), n_vertices)
    return csr_matrix((weights, (rows, columns)), shape=shape), _split(faces, added[face_edges])


_Entries = tuple[np.ndarray, np.ndarray, np.ndarray]  # rows, columns, weights


def _vertex_rule(faces: np.ndarray, marked: np.ndarray, edges: np.ndarray, n_vertices: int) -> _Entries:
    """Old vertices: smoothed towards their neighbours if all faces around them are marked, else unchanged."""
    inner = np.zeros(n_vertices, bool)
    inner[faces[marked]] = True
    inner[faces[~marked]] = False
    valence = np.maximum(np.bincount(edges.ravel(), minlength=n_vertices), 1)
    pull = np.where(inner, (5 / 8 - (3 / 8 + np.cos(2 * np.pi / valence) / 4) ** 2) / valence, 0.0)
    ends = np.concatenate([edges, edges[:, ::-1]])
    ends = ends[inner[ends[:, 0]]]
    diagonal = np.arange(n_vertices)
    return (
        np.concatenate([diagonal, ends[:, 0]]),
        np.concatenate([diagonal, ends[:, 1]]),
        np.concatenate([1 - valence * pull, pull[ends[:, 0]]]),
    )


def _edge_ends_rule(edges: np.ndarray, marks: np.ndarray, added: np.ndarray) -> _Entries:
    """New vertices, weights of their edge's ends: 3/8 each inside the marked part, 1/2 each on its boundary."""
    split = marks > 0
    share = np.where(marks[split] == 2, 3 / 8, 1 / 2)
    return np.repeat(added[split], 2), edges[split].ravel(), np.repeat(share, 2)


def _edge_opposites_rule(faces: np.ndarray, face_edges: np.ndarray, marks: np.ndarray, added: np.ndarray) -> _Entries:
    """New vertices inside the marked part: weight 1/8 for each corner opposite their edge."""
    inside = marks[face_edges] == 2
    return added[face_edges[inside]], np.roll(faces, 1, axis=1)[inside], np.full(inside.sum(), 1 / 8)


def _split(faces: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Each face split into 1 to 4 by the new vertices on its edges, ``middle`` (f, 3); -1: no new vertex."""
    count = (middle >= 0).sum(axis=1)
    pieces = [faces[count == 0]]
    (a, b, c), (ab, bc, ca) = faces[count == 3].T, middle[count == 3].T
    pieces += [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    (a, b, c), (ab, _, _) = _rotated(faces[count == 1], middle[count == 1], first=middle[count == 1] >= 0)
    pieces += [np.stack(t, axis=1) for t in ((a, ab, c), (ab, b, c))]
    (a, b, c), (_, bc, ca) = _rotated(faces[count == 2], middle[count == 2], first=middle[count == 2] < 0)
    pieces += [np.stack(t, axis=1) for t in ((a, b, bc), (a, bc, ca), (ca, bc, c))]
    return np.concatenate(pieces)


def _rotated(faces: np.ndarray, middle: np.ndarray, *, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners and new vertices rotated so that the edge marked in ``first`` comes first; one row for each corner."""
    turn = (first.argmax(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turn, axis=1).T, np.take_along_axis(middle, turn, axis=1).T
