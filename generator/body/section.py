"""Plane sections of a mesh, and the lengths of tapes round them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from gcd_dataset.generator.body.limbs import UP
from gcd_dataset.records import Body, BodyPart

CROSSED = np.array(
    [[-1, -1, -1], [0, 1, 2], [1, 2, 0], [2, 1, 0], [2, 0, 1], [1, 0, 2], [0, 2, 1], [-1, -1, -1]], np.int8
)
"""Row: bit set of the corners above the plane. Entries: the corner cut off, then the others, in section order."""
PLACE_KEY = np.array([73856093, 19349663, 83492791])  # of points in 1e-6 cm, as one number: sorted many times as fast
ROUNDING = 1e-9  # cm², of the turn between two sides of a hull
DIRECTIONS = 48  # widths averaged for a rough girth; the tape at its best level is within 0.01 cm of the best


def section(vertices: Float[np.ndarray, "v d"], faces: Int[np.ndarray, "f 3"], axis: int, level: float) -> np.ndarray:
    """The section of the faces with the plane ``coordinate[axis] = level``: segments (s, 2, d).

    Segments are directed consistently: the first points of a closed section are all of its points. Columns beyond the
    coordinates are interpolated.
    """
    above = (vertices[:, axis] > level).take(faces)
    a, b, c = above.T
    cut = np.flatnonzero((a != b) | (a != c))
    corners = faces[cut[:, None], CROSSED[above[cut] @ [1, 2, 4]]]
    crossing = _crossing(vertices, corners[:, :1].repeat(2), corners[:, 1:].ravel(), axis, level)
    return crossing.reshape(-1, 2, vertices.shape[1])


def section_points(
    vertices: Float[np.ndarray, "v 3"], edges: Int[np.ndarray, "e 2"], axis: int, levels: Float[np.ndarray, " l"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Intersections of the edges with several parallel planes, plane by plane, and the level of each point."""
    heights = vertices[:, axis]
    a, b = heights.take(edges).T
    low, high = np.minimum(a, b), np.maximum(a, b)
    near = np.flatnonzero((low <= levels.max()) & (high > levels.min()))
    row, cut = np.nonzero((low[near] <= levels[:, None]) & (high[near] > levels[:, None]))
    start, end = edges[near[cut]].T
    at = levels[row]
    return _crossing(vertices, start, end, axis, at), at


def _crossing(
    vertices: np.ndarray, start: np.ndarray, end: np.ndarray, axis: int, level: np.ndarray | float
) -> Float[np.ndarray, "n 3"]:
    a, b = vertices.take(start, axis=0), vertices.take(end, axis=0)
    share = (level - a[:, axis]) / (b[:, axis] - a[:, axis])
    return a + share[:, None] * (b - a)


def clipped(
    segments: Float[np.ndarray, "s 2 3"], normal: Sequence[float] | np.ndarray, origin: np.ndarray
) -> Float[np.ndarray, "t 2 3"]:
    """The segments clipped to the half space on the side of ``normal``."""
    side = np.einsum("sei,i->se", segments, normal) - np.dot(origin, normal)
    inside = side >= 0
    cut = np.flatnonzero(inside[:, 0] != inside[:, 1])
    share = side[cut, 0] / (side[cut, 0] - side[cut, 1])
    result = segments.copy()
    result[cut, inside[cut, 0].astype(int)] = segments[cut, 0] + share[:, None] * (segments[cut, 1] - segments[cut, 0])
    return result[inside[:, 0] | inside[:, 1]]


def girth(points: Float[np.ndarray, "n 2"]) -> float:
    """Length of a tight tape round the points: the perimeter of their convex hull."""
    return float(np.hypot(*_hull_sides(points).T).sum())


def tape(points: Float[np.ndarray, "n 2"], facing: tuple[float, float], *, over: float = 0.0) -> float:
    """Length of the sides of the tight tape with outward normal · ``facing`` > ``over``."""
    sides = _hull_sides(points)
    lengths = np.hypot(*sides.T)
    return float(lengths[sides @ [facing[1], -facing[0]] > over * lengths].sum())


def _hull_sides(points: np.ndarray) -> Float[np.ndarray, "h 2"]:
    """The sides of the convex hull as vectors, clockwise: outward normals are to their left.

    By GEOS, three times as fast as Qhull. Of some points GEOS 3.14 returns a polygon that is not convex: then by Qhull.
    """
    corners = shapely.get_coordinates(shapely.convex_hull(shapely.linestrings(points)))
    sides = corners[1:] - corners[:-1]
    (x, y), (u, v) = sides.T, np.concatenate([sides[1:], sides[:1]]).T
    if (x * v - y * u > ROUNDING).any():
        corners = points[ConvexHull(points).vertices[::-1]]
        sides = np.concatenate([corners[1:], corners[:1]]) - corners
    return sides


def contour_length(segments: Float[np.ndarray, "s 2 3"]) -> float:
    """Length of a section along the skin, into hollows."""
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def loops(segments: Float[np.ndarray, "s 2 3"]) -> Int[np.ndarray, " s"]:
    """Number of the connected loop of each segment."""
    ends = _points_of(segments)
    size = int(ends.max(initial=0)) + 1
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(size, size))
    return connected_components(graph, directed=False)[1][ends[:, 0]]


def loose_ends(segments: Float[np.ndarray, "s 2 3"]) -> Bool[np.ndarray, " s"]:
    """Whether each segment is on a branch that ends nowhere, as an extension beyond the line of a buttoned front.

    A curve without branches has none, whether it is closed or not.
    """
    ends, loose = _points_of(segments), np.zeros(len(segments), bool)
    degree = np.bincount(ends.ravel(), minlength=1)
    if degree.max() <= 2:
        return loose
    loop = loops(segments)
    branched = np.isin(loop, loop[(degree[ends] > 2).any(axis=1)])
    while (ending := branched & ~loose & (degree[ends] == 1).any(axis=1)).any():
        loose |= ending
        degree -= np.bincount(ends[ending].ravel(), minlength=len(degree))
    return loose


def _points_of(segments: Float[np.ndarray, "s 2 3"]) -> Int[np.ndarray, "s 2"]:
    """The number of the point at both ends of each segment."""
    places = np.round(1e6 * segments.reshape(-1, 3)).astype(np.int64)
    return np.unique(places @ PLACE_KEY, return_inverse=True)[1].reshape(-1, 2)


def rough_girths(points: Float[np.ndarray, "n 2"], group: Float[np.ndarray, " n"]) -> Float[np.ndarray, " g"]:
    """Approximate girth of each group of consecutive points by Cauchy's formula: π times the mean width."""
    angle = (np.arange(DIRECTIONS // 2) + 0.5) * 2 * np.pi / DIRECTIONS
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
    reach = directions @ points.T.astype(np.float32)
    starts = np.flatnonzero(np.concatenate([[True], group[1:] != group[:-1]])[: len(group)])
    # A row for each direction, contiguous in memory; opposite directions have equal widths.
    widths = np.maximum.reduceat(reach, starts, axis=1) - np.minimum.reduceat(reach, starts, axis=1)
    return widths.sum(axis=0, dtype=float) * 2 * np.pi / DIRECTIONS


Skin = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]  # vertices and faces of parts of a body


def skin_of(body: Body, *parts: BodyPart) -> Skin:
    own = np.isin(body.parts, [part.value for part in parts])
    a, b, c = body.faces.T
    return np.asarray(body.vertices[own], float), (np.cumsum(own) - 1)[body.faces[own[a] & own[b] & own[c]]]


@dataclass(frozen=True, eq=False)
class Plane:
    """The plane of a tape."""

    centre: Float[np.ndarray, "3"]
    """A point inside the part of the body that the tape goes round [cm]."""
    normal: Float[np.ndarray, "3"]
    skin: Skin | None = None
    """The parts of the body that the tape goes round."""
    on_arm: bool = False
    beside: Float[np.ndarray, "3"] | None = None
    """A point that the cloth must not go round: inside the other leg."""
    reach: tuple[float, ...] = ()
    """How far from it cloth is looked for that goes all round: below an armhole, above a sloping hem [cm]."""

    @cached_property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """Columns: the normal, and two unit vectors in the plane."""
        across = unit(np.cross(self.normal, np.eye(3)[np.abs(self.normal).argmin()]))
        return np.stack([self.normal, across, np.cross(self.normal, across)], axis=1)

    @property
    def as_cut(self) -> Self:
        """The plane for cloth as cut: trousers are cut upright."""
        return self if self.on_arm else replace(self, normal=UP)

    def moved(self, by: float) -> Self:
        """The plane moved along its normal [cm]."""
        return replace(self, centre=self.centre + by * self.normal)

    def girth(self) -> float:
        """Length of a tape round the skin [cm]; NaN where there is none."""
        assert self.skin is not None
        vertices, faces = self.skin
        cut = section((vertices - self.centre) @ self.frame, faces, 0, 0.0)
        return girth(cut.reshape(-1, 3)[:, 1:]) if len(cut) else np.nan


def unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return vector / np.linalg.norm(vector)
