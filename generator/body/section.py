"""Plane sections of a mesh and the tape laid round them."""

from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

__all__ = ["clipped", "contour_length", "girth", "loops", "rough_girths", "section", "section_points", "tape"]

TURNED = np.array(
    [[-1, -1, -1], [0, 1, 2], [1, 2, 0], [2, 1, 0], [2, 0, 1], [1, 0, 2], [0, 2, 1], [-1, -1, -1]], np.int8
)
"""The corner that a plane cuts off, then those of the other side in the section's direction; by the corners above."""
DIRECTIONS = 48  # widths a rough girth is averaged over: picks a level whose tape is at most 0.01 cm off the best


def section(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], axis: int, level: float) -> np.ndarray:
    """Where the plane ``coordinate[axis] = level`` cuts the faces: segments (s, 2, 3).

    Segments run the same way round, so the first points of a closed section are all of its points.
    """
    above = (vertices[:, axis] > level).take(faces)
    a, b, c = above.T
    cut = np.flatnonzero((a != b) | (a != c))
    corners = faces[cut[:, None], TURNED[above[cut] @ [1, 2, 4]]]
    crossing = _crossing(vertices, corners[:, :1].repeat(2), corners[:, 1:].ravel(), axis, level)
    return crossing.reshape(-1, 2, 3)


def section_points(
    vertices: Float[np.ndarray, "v 3"], edges: Int[np.ndarray, "e 2"], axis: int, levels: Float[np.ndarray, " l"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Where several parallel planes cut the edges, plane by plane, and the level of each point."""
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
    """What lies of the segments on the side of a plane that ``normal`` points to."""
    side = np.einsum("sei,i->se", segments, normal) - np.dot(origin, normal)
    kept = side >= 0
    cut = np.flatnonzero(kept[:, 0] != kept[:, 1])
    share = side[cut, 0] / (side[cut, 0] - side[cut, 1])
    moved = segments.copy()
    moved[cut, kept[cut, 0].astype(int)] = segments[cut, 0] + share[:, None] * (segments[cut, 1] - segments[cut, 0])
    return moved[kept[:, 0] | kept[:, 1]]


def girth(points: Float[np.ndarray, "n 2"]) -> float:
    """Length of a tape drawn tight round the points: the perimeter of their convex hull."""
    return float(np.hypot(*_tight(points).T).sum())


def tape(points: Float[np.ndarray, "n 2"], facing: tuple[float, float], *, over: float = 0.0) -> float:
    """Length of that part of the tight tape whose outward normal · ``facing`` is greater than ``over``."""
    sides = _tight(points)
    lengths = np.hypot(*sides.T)
    return float(lengths[sides @ [facing[1], -facing[0]] > over * lengths].sum())


def _tight(points: np.ndarray) -> Float[np.ndarray, "h 2"]:
    """The sides of the convex hull, clockwise: their outward normals are a quarter turn to the left."""
    corners = shapely.get_coordinates(shapely.convex_hull(shapely.linestrings(points)))
    return corners[1:] - corners[:-1]


def contour_length(segments: Float[np.ndarray, "s 2 3"]) -> float:
    """Length of a section as it is, hollows included."""
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def loops(segments: Float[np.ndarray, "s 2 3"]) -> Int[np.ndarray, " s"]:
    """The loop that each segment of a section is part of."""
    ends = np.unique(np.round(segments.reshape(-1, 3), 6), axis=0, return_inverse=True)[1].reshape(-1, 2)
    size = int(ends.max(initial=0)) + 1
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(size, size))
    return connected_components(graph, directed=False)[1][ends[:, 0]]


def rough_girths(points: Float[np.ndarray, "n 2"], group: Float[np.ndarray, " n"]) -> Float[np.ndarray, " g"]:
    """Girth of every group of consecutive points by Cauchy's formula: π times the mean width. Quick, for a search."""
    angle = (np.arange(DIRECTIONS // 2) + 0.5) * 2 * np.pi / DIRECTIONS
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
    reach = directions @ points.T.astype(np.float32)
    starts = np.flatnonzero(np.concatenate([[True], group[1:] != group[:-1]])[: len(group)])
    # One direction's reach lies side by side in memory, and opposite directions share it.
    widths = np.maximum.reduceat(reach, starts, axis=1) - np.minimum.reduceat(reach, starts, axis=1)
    return widths.sum(axis=0, dtype=float) * 2 * np.pi / DIRECTIONS
