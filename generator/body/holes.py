"""Holes in a triangle mesh: their rims, and patches over them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist

from gcd_dataset.records import BodyPart, Record

MAX_PAIRWISE = 2000  # points of a rim; with more, its width is the diagonal of its bounding box


@dataclass(frozen=True, eq=False)
class Holes(Record):
    """The holes of a mesh, each closed by a fan of triangles."""

    rims: Int[np.ndarray, "r 2"]
    """Boundary edges, directed as in their face."""
    hole_of_rim: Int[np.ndarray, " r"]
    """The hole of each boundary edge."""
    centres: Float[np.ndarray, "h 3"]
    """Mean of each rim's vertices [cm]."""
    widths: Float[np.ndarray, " h"]
    """Largest distance across each hole [cm]."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> "Holes":
        """The holes of a mesh, one for each connected rim."""
        edges, uses = half_edges_of(faces)
        rims = edges[uses == 1]
        if not len(rims):
            return cls(rims, np.empty(0, int), np.empty((0, 3)), np.empty(0))
        corners, ends = np.unique(rims, return_inverse=True)
        ends = ends.reshape(-1, 2)
        graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(corners), len(corners)))
        count, hole = connected_components(graph, directed=False)
        points = [vertices[corners[hole == number]] for number in range(count)]
        centres = np.stack([each.mean(axis=0) for each in points])
        return cls(rims, hole[ends[:, 0]], centres, np.array([_width(each) for each in points]))

    def patches(self, first: int) -> Int[np.ndarray, "r 3"]:
        """Triangles from the rims to the centres, numbered from ``first`` on; wound like the adjacent faces."""
        return np.concatenate([self.rims[:, ::-1], first + self.hole_of_rim[:, None]], axis=1)


@dataclass(frozen=True, eq=False)
class VisibleSkin(Record):
    """The visible skin of bodies with the same faces: internal parts removed, and their openings closed."""

    faces: Int[np.ndarray, "g 3"]
    """Triangles of the body's vertices, then patches, which also use the centres of the openings."""
    parts: UInt8[np.ndarray, " g"]
    """``BodyPart`` of each face."""
    rims: tuple[Int[np.ndarray, " r"], ...]
    """The vertices on the rim of each opening."""

    @classmethod
    def of(cls, faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> "VisibleSkin":
        """The visible skin of a mesh with the ``BodyPart`` of each vertex."""
        skin = faces[~(parts == BodyPart.INTERNAL.value)[faces].any(axis=1)]
        openings = Holes.of(np.zeros((len(parts), 3)), skin)
        whole = np.concatenate([skin, openings.patches(len(parts))])
        # A face takes the part of at least two of its corners; for a patch these are corners on the rim.
        a, b, c = np.concatenate([parts, np.full(len(openings.centres), BodyPart.HEAD.value)])[whole].T
        rims = tuple(np.unique(openings.rims[openings.hole_of_rim == hole]) for hole in range(len(openings.centres)))
        return cls(whole, np.where(b == c, b, a).astype(np.uint8), rims)

    def points(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "w 3"]:
        """The vertices that ``faces`` refer to: a body's, then the centres of its openings [cm]."""
        return np.concatenate([vertices, *(vertices[rim].mean(axis=0, keepdims=True) for rim in self.rims)])


def half_edges_of(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, "s 2"], Int[np.ndarray, " s"]]:
    """The three directed edges of each face (s = 3 f), and the number of faces on each, in either direction."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    low, high = np.sort(edges, axis=1).astype(np.int64).T
    _, edge, uses = np.unique((low << 32) + high, return_inverse=True, return_counts=True)
    return edges, uses[edge.ravel()]


def _width(points: np.ndarray) -> float:
    if len(points) > MAX_PAIRWISE:
        return float(np.linalg.norm(np.ptp(points, axis=0)))
    return float(pdist(points).max(initial=0.0))
