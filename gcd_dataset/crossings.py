"""Self-intersections of panel outlines: edges that meet anywhere but in a shared corner.

The broad phase clears nearly all edges by their hulls, four points each; the narrow phase samples the remaining edges
and intersects the polylines. Points are complex numbers here, since a rotation is then a product.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import shapely
from jaxtyping import Bool, Complex, Float, Int

from gcd_dataset.curves import Arc, Cubic, Curve, Line, Quadratic, curve_points
from gcd_dataset.records import Panel

TOUCH = 0.01  # cm: edges that meet within this distance of a shared corner do not cross
SAMPLING = 0.15  # cm: mean spacing of the points that sample a curve
MOST_CROSSINGS = 100  # reported for one panel
APART = 1e-6  # gap [cm between boxes, rad between sectors]: a smaller one may be a rounding error


@dataclass(frozen=True, slots=True)
class Crossing:
    """An intersection of an edge with another edge, or with itself."""

    edge: int
    other: int
    """Number of the other edge; ``edge`` itself for an edge that crosses itself."""
    point: tuple[float, float]
    """Position in the panel's plane [cm]; for an edge that crosses itself, its start."""


def edge_hulls(panel: Panel) -> Complex[np.ndarray, "e 4"]:
    """Four points in the panel's plane [cm] for each edge; their convex hull contains the edge.

    The first and the last point are the edge's ends. The inner two of a Bézier curve are its control points as a cubic;
    of an arc, the points where its middle tangent meets the tangents at its ends. Every arc's radius must span its
    chord.
    """
    corners = (panel.vertices @ [1, 1j]).tolist()
    return np.array([_hull(corners[edge.start], corners[edge.end], edge.curve) for edge in panel.edges], complex)


def find_crossings(
    panels: Sequence[Panel], hulls: Sequence[Complex[np.ndarray, "e 4"]], lengths: Sequence[Sequence[float]]
) -> Iterator[tuple[int, Crossing]]:
    """(panel number, crossing), panel by panel: first edges that meet themselves, then pairs of edges.

    ``hulls``: ``edge_hulls`` of each panel; ``lengths``: edge lengths of each panel [cm]. The broad phase runs over all
    panels together. Yields at most ``MOST_CROSSINGS`` for one panel.
    """
    for number, singles, pairs in _broad_phase(hulls):
        for crossing in islice(_narrow_phase(panels[number], singles, pairs, lengths[number]), MOST_CROSSINGS):
            yield number, crossing


def _narrow_phase(
    panel: Panel, singles: Int[np.ndarray, " a"], pairs: Int[np.ndarray, "p 2"], lengths: Sequence[float]
) -> Iterator[Crossing]:
    """Crossings among the candidates: edges that meet themselves, then pairs that meet outside a shared corner."""
    indices = np.unique(np.concatenate([singles, pairs.ravel()])).tolist()
    lines = dict(zip(indices, (_polyline(panel, index, lengths) for index in indices), strict=True))
    for index in singles.tolist():
        if not lines[index].is_simple:
            yield Crossing(index, index, panel.edge_ends(index)[0])
    table = np.array([lines.get(index) for index in range(len(panel.edges))], object)
    meeting = pairs[shapely.intersects(table[pairs[:, 0]], table[pairs[:, 1]])]
    for i, j in meeting.tolist():
        points = shapely.get_coordinates(shapely.intersection(lines[i], lines[j]))
        one, other = panel.edges[i], panel.edges[j]
        corners = panel.vertices[sorted({one.start, one.end} & {other.start, other.end})]
        nearest = np.linalg.norm(points[:, None] - corners[None], axis=2).min(axis=1, initial=np.inf)
        far = points[nearest > TOUCH]
        if len(far):
            yield Crossing(i, j, (float(far[0, 0]), float(far[0, 1])))


def _hull(start: complex, end: complex, curve: Curve) -> tuple[complex, complex, complex, complex]:
    chord = end - start
    match curve:
        case Quadratic((a, b)):  # degree elevation to a cubic
            lift = 2 / 3 * complex(a, b) * chord
            return start, start + lift, end - 2 / 3 * chord + lift, end
        case Cubic((a0, b0), (a1, b1)):
            return start, start + complex(a0, b0) * chord, start + complex(a1, b1) * chord, end
        case Arc(radius, large, right):
            half = float(np.arcsin(min(0.5 * abs(chord) / radius, 1.0)))
            quarter = 0.5 * (np.pi - half if large else half)
            leg = radius * np.tan(quarter) * chord / abs(chord)
            turn = np.exp((-2j if right else 2j) * quarter)
            return start, start + leg * turn, end - leg / turn, end
        case _:
            return start, start + chord / 3, end - chord / 3, end


def _broad_phase(
    hulls: Sequence[Complex[np.ndarray, "e 4"]],
) -> Iterator[tuple[int, Int[np.ndarray, " a"], Int[np.ndarray, "p 2"]]]:
    """Panels with candidates: panel number, edges that may meet themselves, pairs of edges that may meet."""
    if not hulls:
        return
    edges, sizes = np.concatenate(hulls), [len(panel) for panel in hulls]
    first = np.cumsum([0, *sizes])
    singles = np.flatnonzero(~_monotone(edges))
    one, other = _near_pairs(edges, sizes)
    follower = np.concatenate(
        [start + np.roll(np.arange(size), -1) for start, size in zip(first[:-1], sizes, strict=True)]
    )
    apart = _sectors_apart(edges, edges[follower])
    meet = ~((follower[one] == other) & apart[one]) & ~((follower[other] == one) & apart[other])
    of_panel = np.searchsorted(first, one[meet], side="right") - 1
    order = np.argsort(of_panel, kind="stable")
    pairs = np.stack([one[meet], other[meet]], axis=1)[order]
    cuts = np.searchsorted(of_panel[order], np.arange(len(sizes) + 1))
    single_cuts = np.searchsorted(singles, first)
    for number in np.flatnonzero((np.diff(cuts) > 0) | (np.diff(single_cuts) > 0)).tolist():
        panel_singles = singles[slice(*single_cuts[number : number + 2])]
        panel_pairs = pairs[slice(*cuts[number : number + 2])]
        yield number, panel_singles - first[number], panel_pairs - first[number]


def _near_pairs(
    hulls: Complex[np.ndarray, "e 4"], sizes: Sequence[int]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """All pairs of edges of one panel with touching bounding boxes, in order."""
    # Panels side by side: one tree serves all.
    aside = np.repeat(np.arange(len(sizes)), sizes) * (np.ptp(hulls.real) + 1.0)
    x, y = hulls.real + aside[:, None], hulls.imag
    boxes = shapely.box(x.min(axis=1), y.min(axis=1), x.max(axis=1) + APART, y.max(axis=1) + APART)
    pairs = shapely.STRtree(boxes).query(boxes)
    pairs = pairs[:, pairs[0] < pairs[1]]
    one, other = pairs[:, np.lexsort(pairs[::-1])]
    return one, other


def _monotone(hulls: Complex[np.ndarray, "e 4"]) -> Bool[np.ndarray, " e"]:
    """Whether each edge advances along its chord throughout, by its hull, and so cannot meet itself."""
    legs = np.diff(hulls, axis=1)
    return ((legs * (hulls[:, -1:] - hulls[:, :1]).conj()).real >= 0).all(axis=1)


def _sectors_apart(before: Complex[np.ndarray, "e 4"], after: Complex[np.ndarray, "e 4"]) -> Bool[np.ndarray, " e"]:
    """Whether consecutive edges lie in disjoint sectors round their common corner, so that they meet only there."""
    with np.errstate(all="ignore"):  # a chord of almost no length gives NaN, which compares as not apart
        middle_before, half_before = _sector(before[:, ::-1])
        middle_after, half_after = _sector(after)
        between = np.abs(np.angle(middle_before / middle_after))
    convex = np.maximum(half_before, half_after) < 0.5 * np.pi
    return convex & (between > half_before + half_after + APART)


def _sector(hulls: Complex[np.ndarray, "e 4"]) -> tuple[Complex[np.ndarray, " e"], Float[np.ndarray, " e"]]:
    """The sector that a hull spans, seen from its first point: middle direction (unit complex), half angle [rad]."""
    chord = hulls[:, 3] - hulls[:, 0]
    angles = np.angle((hulls[:, 1:] - hulls[:, :1]) / chord[:, None])
    low, high = angles.min(axis=1), angles.max(axis=1)
    return chord / np.abs(chord) * np.exp(0.5j * (low + high)), 0.5 * (high - low)


def _polyline(panel: Panel, index: int, lengths: Sequence[float]) -> shapely.LineString:
    """An edge as a polyline, sampled finely enough for ``TOUCH``."""
    curve, ends = panel.edges[index].curve, panel.edge_ends(index)
    if isinstance(curve, Line):
        return shapely.LineString(ends)
    points = curve_points(*ends, curve, np.linspace(0.0, 1.0, max(9, int(np.ceil(lengths[index] / SAMPLING)) + 1)))
    points[0], points[-1] = ends
    return shapely.LineString(points)
