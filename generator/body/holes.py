"""Holes in a skin: their rims, and patches over them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist

from gcd_dataset.records import BodyPart, Record

__all__ = ["Holes", "VisibleSkin", "half_edges_of"]

MANY = 2000  # points of a rim, of which no more are compared pair by pair


@dataclass(frozen=True, eq=False)
class Holes(Record):
    """Rims of a skin that is open, and a fan of triangles over each."""

    rims: Int[np.ndarray, "r 2"]
    """Sides that only one face has, as it runs along them."""
    hole: Int[np.ndarray, " r"]
    """Which hole each side is of."""
    middles: Float[np.ndarray, "h 3"]
    """Mean of each rim's points [cm]."""
    widths: Float[np.ndarray, " h"]
    """Largest distance across each [cm]."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> "Holes":
        """The holes of a skin, one for each piece of rim that hangs together."""
        sides, times = half_edges_of(faces)
        rims = sides[times == 1]
        if not len(rims):
            return cls(rims, np.empty(0, int), np.empty((0, 3)), np.empty(0))
        corners, ends = np.unique(rims, return_inverse=True)
        ends = ends.reshape(-1, 2)
        graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(corners), len(corners)))
        count, hole = connected_components(graph, directed=False)
        points = [vertices[corners[hole == number]] for number in range(count)]
        middles = np.stack([each.mean(axis=0) for each in points])
        return cls(rims, hole[ends[:, 0]], middles, np.array([_width(each) for each in points]))

    def patches(self, first: int) -> Int[np.ndarray, "r 3"]:
        """Triangles from the rims to the middles, which are vertices from ``first`` on; they look as the skin does."""
        return np.concatenate([self.rims[:, ::-1], first + self.hole[:, None]], axis=1)


@dataclass(frozen=True, eq=False)
class VisibleSkin(Record):
    """What is to be seen of bodies with the same faces: nothing internal, and what opens there is closed."""

    faces: Int[np.ndarray, "g 3"]
    """Triangles of the body's vertices, and after them of the middles of the openings."""
    parts: UInt8[np.ndarray, " g"]
    """``BodyPart`` of each face."""
    rims: tuple[Int[np.ndarray, " r"], ...]
    """The vertices round each opening."""

    @classmethod
    def of(cls, faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> "VisibleSkin":
        """The skin of a body whose vertices are of these parts."""
        skin = faces[~(parts == BodyPart.INTERNAL.value)[faces].any(axis=1)]
        openings = Holes.of(np.zeros((len(parts), 3)), skin)
        whole = np.concatenate([skin, openings.patches(len(parts))])
        # Two corners of a patch are of the skin round the opening, and decide what it is.
        a, b, c = np.concatenate([parts, np.full(len(openings.middles), BodyPart.HEAD.value)])[whole].T
        rims = tuple(np.unique(openings.rims[openings.hole == hole]) for hole in range(len(openings.middles)))
        return cls(whole, np.where(b == c, b, a).astype(np.uint8), rims)

    def points(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "w 3"]:
        """A body's vertices, and the middles of its openings [cm]."""
        return np.concatenate([vertices, *(vertices[rim].mean(axis=0, keepdims=True) for rim in self.rims)])


def half_edges_of(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, "s 2"], Int[np.ndarray, " s"]]:
    """The three sides of each face as it runs along them, and how many faces have each, either way."""
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    low, high = np.sort(sides, axis=1).astype(np.int64).T
    _, side, times = np.unique((low << 32) + high, return_inverse=True, return_counts=True)
    return sides, times[side.ravel()]


def _width(points: np.ndarray) -> float:
    if len(points) > MANY:
        return float(np.linalg.norm(np.ptp(points, axis=0)))
    return float(pdist(points).max(initial=0.0))
