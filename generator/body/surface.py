"""Nearest-point queries on the surface of a triangle mesh."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.records import Record

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

    fine, pieces, owners = subdivide_to_size(vertices, faces, longest, return_index=True)
    return fine, pieces, owners
