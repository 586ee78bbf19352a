"""Divide a panel along its lines into regions without lines, and fill each.

Lines and outline are a planar graph of sampled points; its bounded faces, traced with the cloth on their left, are the
regions. Where a line ends inside the panel, or lies apart from the outline, bridges between nearest points make every
region a simple polygon.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil, isclose

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gcd_dataset.curves import signed_area
from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.triangulate import Filling, Fillings, fill_outline

Segment = tuple[int, int]
SAME_AREA = 1e-6  # relative: of all regions together, and of the outline
BETWEEN = np.array([[1.0 - 1e-6, 1e-6], [1e-6, 1.0 - 1e-6]])  # weights of the ends: a bridge without its own ends


def fill_regions(
    points: Float[np.ndarray, "n 2"],
    outline: int,
    lines: Sequence[Int[np.ndarray, " m"]],
    spacing: float,
    cache: Fillings,
) -> Filling:
    """The points, then seeds [cm], and triangles with the winding of the outline; segments of the lines are edges.

    ``outline``: number of points of the loop, which come first; ``lines``: the points of each line. Raises
    ``MeshError`` where a line crosses the outline or another line.
    """
    segments: list[Segment] = [(k, (k + 1) % outline) for k in range(outline)]
    segments += [(a, b) for line in lines for a, b in pairwise(line.tolist())]
    points, segments = _bridged(points, segments, spacing)
    area, loops = signed_area(points[:outline]), list(_regions(points, segments))
    odd = next((loop for loop in loops if not shapely.Polygon(points[loop]).is_valid), None)
    if odd is not None or not isclose(sum(signed_area(points[loop]) for loop in loops), abs(area), rel_tol=SAME_AREA):
        raise _crossing(points[lines[0][0] if odd is None else odd[0]])
    turned, found, faces = area < 0.0, [points], []
    size = len(points)
    for loop in loops:
        loop = loop[::-1] if turned else loop
        filled, triangles = fill_outline(points[loop], spacing, cache)
        number = np.concatenate([loop, np.arange(size, size + len(filled) - len(loop))])
        found.append(filled[len(loop) :])
        faces.append(number[triangles])
        size += len(filled) - len(loop)
    return np.concatenate(found), np.concatenate(faces)


def _regions(points: Float[np.ndarray, "n 2"], segments: list[Segment]) -> Iterator[Int[np.ndarray, " m"]]:
    """The bounded faces of a connected planar graph, each as its points counter-clockwise."""
    both = np.array(segments + [(b, a) for a, b in segments])
    step = points[both[:, 1]] - points[both[:, 0]]
    order = np.lexsort((np.arctan2(step[:, 1], step[:, 0]), both[:, 0]))
    place, first = np.argsort(order), np.searchsorted(both[order, 0], np.arange(len(points) + 1))
    back = (np.arange(len(both)) + len(segments)) % len(both)
    start = both[back, 0]
    size = first[start + 1] - first[start]
    onward = order[first[start] + (place[back] - first[start] - 1) % size]  # the next one clockwise from the way back
    seen = np.zeros(len(both), bool)
    for side in range(len(both)):
        loop, at = [], side
        while not seen[at]:
            seen[at] = True
            loop.append(int(both[at, 0]))
            at = int(onward[at])
        if loop and signed_area(points[loop]) > 0.0:
            yield np.array(loop)


def _bridged(
    points: Float[np.ndarray, "n 2"], segments: list[Segment], spacing: float
) -> tuple[Float[np.ndarray, "m 2"], list[Segment]]:
    """Points and segments with bridges, so that every region is a simple polygon."""
    while True:
        count = len(points)
        ends = np.array(segments)
        graph = coo_array((np.ones(len(ends)), ends.T), shape=(count, count))
        _, part = connected_components(graph, directed=False)
        if part.any():  # not connected to the outline's first point
            inside, others = np.flatnonzero(part == part[part != 0][0]), np.flatnonzero(part == 0)
        else:
            divided = next((cut for loop in _regions(points, segments) if (cut := _pinch(points, loop))), None)
            if divided is None:
                return points, segments
            inside, others = divided
        a, b = _nearest(points, segments, inside, others)
        pieces = ceil(float(np.linalg.norm(points[b] - points[a])) / spacing - 1e-9)  # rounding adds none
        share = np.arange(1, pieces)[:, None] / pieces
        points = np.concatenate([points, (1.0 - share) * points[a] + share * points[b]])
        segments = segments + list(pairwise([a, *range(count, len(points)), b]))


def _pinch(
    points: Float[np.ndarray, "n 2"], loop: Int[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " l"]] | None:
    """The farthest point of the longest detour of a loop from a point that it visits twice, and the points off the way.

    ``None`` for a loop that visits no point twice.
    """
    at: dict[int, int] = {}
    detour, root = loop[:0], -1
    for place, point in enumerate(loop.tolist()):
        if point in at:
            around = loop[at[point] + 1 : place], np.concatenate([loop[: at[point]], loop[place + 1 :]])
            shorter = min(around, key=len)
            detour, root = (shorter, point) if len(shorter) > len(detour) else (detour, root)
        at[point] = place
    if root < 0:
        return None
    tip = detour[np.linalg.norm(points[detour] - points[root], axis=1).argmax()]
    return np.array([tip]), np.setdiff1d(loop, [*detour, root])


def _nearest(
    points: Float[np.ndarray, "n 2"],
    segments: list[Segment],
    inside: Int[np.ndarray, " k"],
    others: Int[np.ndarray, " l"],
) -> Segment:
    """The nearest pair of a point inside and one of the others with no segment between them."""
    apart = np.linalg.norm(points[inside][:, None] - points[others], axis=2)
    tree = shapely.STRtree(shapely.linestrings(points[np.array(segments)]))
    for place in np.argsort(apart, axis=None, kind="stable"):
        row, column = np.unravel_index(int(place), apart.shape)
        a, b = int(inside[row]), int(others[column])
        between = BETWEEN @ points[[a, b]]
        if not len(tree.query(shapely.LineString(between), "intersects")):
            return a, b
    raise _crossing(points[inside[0]])


def _crossing(point: Float[np.ndarray, "2"]) -> MeshError:
    x, y = point.tolist()
    return MeshError(f"a line near ({x:.2f}, {y:.2f}) cm meets the outline or another line: part them")
