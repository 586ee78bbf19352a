"""Nearest points on the surface of a mesh, its subdivision, and data kept as long as their body."""

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Self, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, Record

Derived = TypeVar("Derived")


def kept_per_body(compute: Callable[[Body], Derived]) -> Callable[[Body], Derived]:
    """``compute``, called once for each ``Body`` object; its result is dropped with the body."""
    kept: dict[int, tuple[weakref.ref[Body], Derived]] = {}

    @wraps(compute)
    def found(body: Body) -> Derived:
        known = kept.get(id(body))
        if known is not None and known[0]() is body:
            return known[1]
        result, key = compute(body), id(body)
        kept[key] = weakref.ref(body, lambda _: kept.pop(key, None)), result
        return result

    return found


def near(vertices: Float[np.ndarray, "v 3"], points: Float[np.ndarray, "n 3"], radius: float) -> Bool[np.ndarray, " v"]:
    """Whether each vertex is within a radius of one of the points [cm]."""
    return cKDTree(points).query(vertices, distance_upper_bound=radius)[0] < radius


LONGEST_EDGE = 6.0  # cm; longer edges are halved, so that the centroid of a near triangle is near
MAX_TRIANGLES = 300_000  # after subdivision; slivers a metre long would give millions
CANDIDATES = 8  # triangles with the nearest centroids, whose distances are computed exactly


@dataclass(frozen=True, eq=False)
class Nearest(Record):
    """The nearest points of a surface to query points."""

    points: Float[np.ndarray, "n 3"]
    """Points on the surface [cm]."""
    faces: Int[np.ndarray, " n"]
    """The face of the mesh that each lies on."""
    normals: Float[np.ndarray, "n 3"]
    """Unit normal of that face, by its winding."""
    distances: Float[np.ndarray, " n"]
    """From the query points [cm]."""
    on_skin: Bool[np.ndarray, " n"]
    """Whether that face is skin; ``False``: a patch over a hole."""


@dataclass(frozen=True, eq=False)
class SkinSurface(Record):
    """Triangles with a k-d tree over their centroids."""

    corners: Float[np.ndarray, "t 3 3"]
    owners: Int[np.ndarray, " t"]
    """The face of the mesh that each triangle is a piece of."""
    normals: Float[np.ndarray, "t 3"]
    on_skin: Bool[np.ndarray, " t"]
    tree: cKDTree

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "f 3"],
        patched: Bool[np.ndarray, " f"] | None = None,
    ) -> Self:
        """The surface of a mesh [cm]; ``patched`` marks patches over holes. Faces without area are dropped."""
        fine, pieces, owners = subdivide_long_edges(vertices, faces, LONGEST_EDGE)
        corners = fine[pieces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double_area = np.linalg.norm(normals, axis=1)
        kept = double_area > 1e-12
        corners, owners = corners[kept], owners[kept]
        on_skin = np.ones(len(owners), bool) if patched is None else ~patched[owners]
        return cls(corners, owners, normals[kept] / double_area[kept, None], on_skin, cKDTree(corners.mean(axis=1)))

    def nearest(self, points: Float[np.ndarray, "n 3"]) -> Nearest:
        """The nearest point of the surface to each query point."""
        from trimesh.triangles import closest_point  # imported here: drawn patterns need no trimesh, which takes 0.4 s

        near = self.tree.query(points, k=min(CANDIDATES, len(self.corners)))[1].reshape(len(points), -1)
        triangles = self.corners[near].reshape(-1, 3, 3)
        on = closest_point(triangles, points.repeat(near.shape[1], axis=0)).reshape(*near.shape, 3)
        distances = np.linalg.norm(on - points[:, None], axis=2)
        best = distances.argmin(axis=1)
        row = np.arange(len(points))
        chosen = near[row, best]
        return Nearest(
            on[row, best], self.owners[chosen], self.normals[chosen], distances[row, best], self.on_skin[chosen]
        )


def subdivide_long_edges(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], longest: float
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "g 3"], Int[np.ndarray, " g"]]:
    """The mesh with edges longer than ``longest`` [cm] halved repeatedly, and the original face of each piece.

    Old vertices keep their numbers. ``longest`` is raised to keep within ``MAX_TRIANGLES``.
    """
    corners = vertices[faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    while (4.0 ** np.ceil(np.log2(np.maximum(sides / longest, 1.0)))).sum() > max(MAX_TRIANGLES, len(faces)):
        longest *= 2
    if sides.max(initial=0.0) <= longest:
        return vertices, faces, np.arange(len(faces))
    from trimesh.remesh import subdivide_to_size

    return subdivide_to_size(vertices, faces, longest, return_index=True)


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
    split, inside = marks > 0, marks[face_edges] == 2
    entries = [
        _vertex_rule(faces, marked, edges, n_vertices),
        # New vertices, from their edge's ends: 3/8 each inside the marked part, 1/2 each on its boundary; and 1/8 from
        # each corner opposite an edge inside.
        (np.repeat(added[split], 2), edges[split].ravel(), np.repeat(np.where(marks[split] == 2, 3 / 8, 1 / 2), 2)),
        (added[face_edges[inside]], np.roll(faces, 1, axis=1)[inside], np.full(inside.sum(), 1 / 8)),
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
