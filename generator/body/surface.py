"""The skin of a mesh as a surface: its nearest point to any point, whatever its triangles."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.records import Record

__all__ = ["Nearest", "SkinSurface", "divided"]

LONGEST = 6.0  # cm: longer edges are halved first, so that a near triangle has a near middle
MOST = 300_000  # triangles that a mesh may be divided into for that; slivers of a metre would be millions
CANDIDATES = 8  # triangles by the distance of their middles


@dataclass(frozen=True, eq=False)
class Nearest(Record):
    """Where a surface comes nearest to some points."""

    points: Float[np.ndarray, "n 3"]
    """On the surface [cm]."""
    faces: Int[np.ndarray, " n"]
    """The triangle each lies on."""
    normals: Float[np.ndarray, "n 3"]
    """Of that triangle, unit length, as the mesh winds it."""
    distances: Float[np.ndarray, " n"]
    """[cm]"""
    real: Bool[np.ndarray, " n"]
    """Whether it is skin, and no patch over a hole."""


@dataclass(frozen=True, eq=False)
class SkinSurface(Record):
    """Triangles with a tree over their middles."""

    corners: Float[np.ndarray, "t 3 3"]
    owners: Int[np.ndarray, " t"]
    """The face of the mesh that each triangle is a piece of."""
    normals: Float[np.ndarray, "t 3"]
    real: Bool[np.ndarray, " t"]
    tree: cKDTree

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "f 3"],
        patched: Bool[np.ndarray, " f"] | None = None,
    ) -> Self:
        """The surface of a mesh, of which some faces are patches; triangles without area are left out."""
        fine, pieces, owners = divided(vertices, faces, LONGEST)
        corners = fine[pieces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double_area = np.linalg.norm(across, axis=1)
        solid = double_area > 1e-12
        corners, owners = corners[solid], owners[solid]
        real = np.ones(len(owners), bool) if patched is None else ~patched[owners]
        return cls(corners, owners, across[solid] / double_area[solid, None], real, cKDTree(corners.mean(axis=1)))

    def nearest(self, points: Float[np.ndarray, "n 3"]) -> Nearest:
        """The nearest point of the surface to each point."""
        near = self.tree.query(points, k=min(CANDIDATES, len(self.corners)))[1].reshape(len(points), -1)
        triangles = self.corners[near].reshape(-1, 3, 3)
        on = trimesh.triangles.closest_point(triangles, points.repeat(near.shape[1], axis=0)).reshape(*near.shape, 3)
        distances = np.linalg.norm(on - points[:, None], axis=2)
        best = distances.argmin(axis=1)
        row = np.arange(len(points))
        chosen = near[row, best]
        return Nearest(
            on[row, best], self.owners[chosen], self.normals[chosen], distances[row, best], self.real[chosen]
        )


def divided(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], longest: float
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "g 3"], Int[np.ndarray, " g"]]:
    """The mesh with edges of at most ``longest`` [cm], halved where they were longer, and the face each piece is of.

    Old vertices keep their numbers. Edges may be longer where there would be more than ``MOST`` triangles.
    """
    corners = vertices[faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    while (4.0 ** np.ceil(np.log2(np.maximum(sides / longest, 1.0)))).sum() > max(MOST, len(faces)):
        longest *= 2
    if sides.max(initial=0.0) <= longest:
        return vertices, faces, np.arange(len(faces))
    fine, pieces, owners = trimesh.remesh.subdivide_to_size(vertices, faces, longest, return_index=True)
    return fine, pieces, owners
