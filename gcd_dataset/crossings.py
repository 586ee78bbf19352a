"""Where the outline of a panel meets itself, other than in a corner.

Nearly all edges are proved innocent by their hulls, four points a curve stays between; only the others are sampled
and searched. Points are complex numbers here, since a turn is then a product.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import numpy as np
import shapely
from jaxtyping import Bool, Complex, Float, Int

from gcd_dataset.curves import Arc, Cubic, Curve, Line, Quadratic, curve_points
from gcd_dataset.records import Panel

__all__ = ["Crossing", "edge_hulls", "find_crossings"]

TOUCH = 0.01  # cm: how far from a corner two edges of it may still touch; further off they cross
SAMPLING = 0.15  # cm between the points that stand for a curve when crossings are looked for, on the average
FEW = 64  # edges of a panel up to which all pairs are compared at once, the quickest way; more are swept
AT_ONCE = 1 << 19  # pairs of edges that are compared at once: 30 MB
MOST_TOLD = 100  # crossings of one panel; nobody reads more
APART = 1e-6  # cm between two boxes, rad between two sectors: more than rounding


@dataclass(frozen=True, slots=True)
class Crossing:
    """A place where an edge meets another, or itself."""

    edge: int
    other: int
    """The same as ``edge`` where it meets itself."""
    place: tuple[float, float]
    """[cm]; of an edge that meets itself, its start."""


def edge_hulls(panel: Panel) -> Complex[np.ndarray, "e 4"]:
    """Four points of the panel's plane [cm] for each edge, the first and last its ends, whose hull holds the edge.

    A Bézier curve has its control points, as a cubic; an arc the tangents at its ends and in its middle. The arcs'
    radii must span their chords.
    """
    corners = (panel.vertices @ [1, 1j]).tolist()
    return np.array([_hull(corners[edge.start], corners[edge.end], edge.curve) for edge in panel.edges], complex)


def find_crossings(
    panels: Sequence[Panel], hulls: Sequence[Complex[np.ndarray, "e 4"]], lengths: Sequence[Sequence[float]]
) -> Iterator[tuple[int, Crossing]]:
    """For each panel, by its number: edges that cross or touch themselves; then pairs that do, other than in a corner
    they share. Of one panel no more than ``MOST_TOLD``.

    ``hulls`` are the panels' ``edge_hulls``, ``lengths`` those of their edges [cm]. All panels are proved innocent
    together; only what is left is looked at one by one.
    """
    for number, alone, pairs in _suspects(hulls):
        for crossing in islice(_searched(panels[number], alone, pairs, lengths[number]), MOST_TOLD):
            yield number, crossing


def _searched(
    panel: Panel, alone: Int[np.ndarray, " a"], pairs: Int[np.ndarray, "p 2"], lengths: Sequence[float]
) -> Iterator[Crossing]:
    """The suspects that cross or touch themselves, then the pairs that do, other than in a corner they share."""
    indices = np.unique(np.concatenate([alone, pairs.ravel()])).tolist()
    lines = dict(zip(indices, (_polyline(panel, index, lengths) for index in indices), strict=True))
    for index in alone.tolist():
        if not lines[index].is_simple:
            yield Crossing(index, index, panel.edge_ends(index)[0])
    table = np.array([lines.get(index) for index in range(len(panel.edges))], object)
    met = pairs[shapely.intersects(table[pairs[:, 0]], table[pairs[:, 1]])]
    for i, j in met.tolist():
        points = shapely.get_coordinates(shapely.intersection(lines[i], lines[j]))
        far = points[_distance_to(points, _shared_corners(panel, i, j)) > TOUCH]
        if len(far):
            yield Crossing(i, j, (float(far[0, 0]), float(far[0, 1])))


# --------------------------------------------------------------------------------------------------------------- proofs


def _hull(start: complex, end: complex, curve: Curve) -> tuple[complex, complex, complex, complex]:
    chord = end - start
    match curve:
        case Quadratic((a, b)):  # as a cubic: two thirds of the way to the control point
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


def _suspects(
    hulls: Sequence[Complex[np.ndarray, "e 4"]],
) -> Iterator[tuple[int, Int[np.ndarray, " a"], Int[np.ndarray, "p 2"]]]:
    """The panels that are not proved innocent: number, edges that may meet themselves, pairs that may meet."""
    if not hulls:
        return
    edges, sizes = np.concatenate(hulls), [len(panel) for panel in hulls]
    first = np.cumsum([0, *sizes])
    alone = np.flatnonzero(~_monotone(edges))
    one, other = _near_pairs(edges, sizes, first[:-1].tolist())
    follower = np.concatenate(
        [start + np.roll(np.arange(size), -1) for start, size in zip(first[:-1], sizes, strict=True)]
    )
    apart = _sectors_apart(edges, edges[follower])
    meet = ~((follower[one] == other) & apart[one]) & ~((follower[other] == one) & apart[other])
    of_panel = np.searchsorted(first, one[meet], side="right") - 1
    order = np.argsort(of_panel, kind="stable")
    pairs = np.stack([one[meet], other[meet]], axis=1)[order]
    cuts = np.searchsorted(of_panel[order], np.arange(len(sizes) + 1))
    ends = np.searchsorted(alone, first)
    for number in np.flatnonzero((np.diff(cuts) > 0) | (np.diff(ends) > 0)).tolist():
        own = slice(*cuts[number : number + 2])
        yield number, alone[slice(*ends[number : number + 2])] - first[number], pairs[own] - first[number]


def _near_pairs(
    hulls: Complex[np.ndarray, "e 4"], sizes: Sequence[int], first: Sequence[int]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """All pairs of edges of one panel whose bounding boxes touch, in order; panels begin at ``first``."""
    found, few, count = [], [np.empty((2, 0), int)], 0
    for size, start in zip(sizes, first, strict=True):
        if size > FEW:
            found.append(_swept(hulls[start : start + size]) + start)
            continue
        few.append(_pairs_of(size) + start)
        count += few[-1].shape[1]
        if count > AT_ONCE:
            found.append(_touching(hulls, np.concatenate(few, axis=1)))
            few, count = [np.empty((2, 0), int)], 0
    one, other = np.concatenate([*found, _touching(hulls, np.concatenate(few, axis=1))], axis=1)
    return one, other


def _touching(hulls: Complex[np.ndarray, "e 4"], pairs: Int[np.ndarray, "2 n"]) -> Int[np.ndarray, "2 m"]:
    return pairs[:, ~_boxes_apart(hulls, pairs[0], pairs[1])]


@lru_cache(maxsize=FEW)
def _pairs_of(size: int) -> Int[np.ndarray, "2 n"]:
    """All pairs of ``size`` edges."""
    return np.stack(np.triu_indices(size, k=1))


def _swept(hulls: Complex[np.ndarray, "e 4"]) -> Int[np.ndarray, "2 n"]:
    """The pairs of edges of a panel whose bounding boxes touch, in order: a sweep along that axis which parts more."""
    low = [part.min(axis=1) for part in (hulls.real, hulls.imag)]
    high = [part.max(axis=1) for part in (hulls.real, hulls.imag)]
    orders = [np.argsort(part, kind="stable") for part in low]
    ahead = [
        np.searchsorted(low[axis][order], high[axis][order] + APART, side="right") - 1 - np.arange(len(hulls))
        for axis, order in enumerate(orders)
    ]
    axis = int(ahead[1].sum() < ahead[0].sum())
    order, counts = orders[axis], ahead[axis]
    found = []
    for rows in np.split(np.arange(len(hulls)), _cuts(counts)):
        row = np.repeat(rows, counts[rows])
        step = np.arange(len(row)) - np.repeat(np.cumsum(counts[rows]) - counts[rows], counts[rows])
        one, other = order[row], order[row + 1 + step]
        found.append(np.sort(_touching(hulls, np.stack([one, other])), axis=0))
    pairs = np.concatenate(found, axis=1)
    return pairs[:, np.lexsort(pairs[::-1])]


def _cuts(counts: Int[np.ndarray, " e"]) -> Int[np.ndarray, " c"]:
    """Where to cut a sweep so that its pieces have about ``AT_ONCE`` pairs."""
    return np.flatnonzero(np.diff(np.cumsum(counts) // AT_ONCE)) + 1


def _monotone(hulls: Complex[np.ndarray, "e 4"]) -> Bool[np.ndarray, " e"]:
    """Which edges always go on towards their end, and so cannot come back to themselves."""
    legs = np.diff(hulls, axis=1)
    return ((legs * (hulls[:, -1:] - hulls[:, :1]).conj()).real >= 0).all(axis=1)


def _boxes_apart(
    hulls: Complex[np.ndarray, "e 4"], one: Int[np.ndarray, " n"], other: Int[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Which pairs of edges have bounding boxes that do not touch."""
    apart = np.zeros(len(one), bool)
    for part in (hulls.real, hulls.imag):
        low, high = part.min(axis=1), part.max(axis=1)
        apart |= (low[one] > high[other] + APART) | (low[other] > high[one] + APART)
    return apart


def _sectors_apart(before: Complex[np.ndarray, "e 4"], after: Complex[np.ndarray, "e 4"]) -> Bool[np.ndarray, " e"]:
    """Whether edges and those that follow them lie in two sectors round their common corner."""
    with np.errstate(all="ignore"):  # chords of nearly no length give NaN, which no sector holds
        middle_before, half_before = _sector(before[:, ::-1])
        middle_after, half_after = _sector(after)
        between = np.abs(np.angle(middle_before / middle_after))
    convex = np.maximum(half_before, half_after) < 0.5 * np.pi
    return convex & (between > half_before + half_after + APART)


def _sector(hulls: Complex[np.ndarray, "e 4"]) -> tuple[Complex[np.ndarray, " e"], Float[np.ndarray, " e"]]:
    """Middle direction, as a number on the unit circle, and half angle [rad] of hulls seen from their first point."""
    chord = hulls[:, 3] - hulls[:, 0]
    angles = np.angle((hulls[:, 1:] - hulls[:, :1]) / chord[:, None])
    low, high = angles.min(axis=1), angles.max(axis=1)
    return chord / np.abs(chord) * np.exp(0.5j * (low + high)), 0.5 * (high - low)


# --------------------------------------------------------------------------------------------------------------- search


def _polyline(panel: Panel, index: int, lengths: Sequence[float]) -> shapely.LineString:
    """An edge as a shapely line, finely enough for ``TOUCH``."""
    curve, ends = panel.edges[index].curve, panel.edge_ends(index)
    if isinstance(curve, Line):
        return shapely.LineString(ends)
    points = curve_points(*ends, curve, np.linspace(0.0, 1.0, max(9, int(np.ceil(lengths[index] / SAMPLING)) + 1)))
    points[0], points[-1] = ends
    return shapely.LineString(points)


def _shared_corners(panel: Panel, i: int, j: int) -> Float[np.ndarray, "n 2"]:
    one, other = panel.edges[i], panel.edges[j]
    return panel.vertices[sorted({one.start, one.end} & {other.start, other.end})]


def _distance_to(points: Float[np.ndarray, "n 2"], corners: Float[np.ndarray, "c 2"]) -> Float[np.ndarray, " n"]:
    """Distance of each point to the nearest corner [cm]; infinite without corners."""
    if not len(corners):
        return np.full(len(points), np.inf)
    return np.linalg.norm(points[:, None] - corners[None], axis=2).min(axis=1)
