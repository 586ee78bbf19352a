"""Where the outline of a panel meets itself, other than in a corner.

Nearly all edges are proved innocent by their hulls, four points a curve stays between; only the others are sampled
and searched. Points are complex numbers here, since a turn is then a product.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain

import numpy as np
import shapely
from jaxtyping import Bool, Complex, Float, Int

from gcd_dataset.curves import Arc, Cubic, Curve, Line, Quadratic, curve_points
from gcd_dataset.records import Panel

__all__ = ["Crossing", "edge_hulls", "find_crossings"]

TOUCH = 0.01  # cm: how far from a corner two edges of it may still touch; further off they cross
SAMPLING = 0.15  # cm between the points that stand for a curve when crossings are looked for, on the average
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
    they share.

    ``hulls`` are the panels' ``edge_hulls``, ``lengths`` those of their edges [cm]. All panels are proved innocent
    together; only what is left is looked at one by one.
    """
    for number, alone, pairs in _suspects(hulls):
        panel = panels[number]
        lines = {index: _polyline(panel, index, lengths[number]) for index in {*alone, *chain.from_iterable(pairs)}}
        for index in alone:
            if not lines[index].is_simple:
                yield number, Crossing(index, index, panel.edge_ends(index)[0])
        for i, j in pairs:
            points = shapely.get_coordinates(shapely.intersection(lines[i], lines[j]))
            far = points[_distance_to(points, _shared_corners(panel, i, j)) > TOUCH]
            if len(far):
                yield number, Crossing(i, j, (float(far[0, 0]), float(far[0, 1])))


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


def _suspects(hulls: Sequence[Complex[np.ndarray, "e 4"]]) -> Iterator[tuple[int, list[int], list[tuple[int, int]]]]:
    """The panels that are not proved innocent: number, edges that may meet themselves, pairs that may meet."""
    if not hulls:
        return
    edges, sizes = np.concatenate(hulls), [len(panel) for panel in hulls]
    first = np.cumsum([0, *sizes[:-1]])
    alone = np.flatnonzero(~_monotone(edges))
    one, other = (np.concatenate(side) for side in zip(*map(_pairs, sizes, first.tolist()), strict=True))
    follower = np.concatenate([start + np.roll(np.arange(size), -1) for start, size in zip(first, sizes, strict=True)])
    meet = ~_boxes_apart(edges, one, other)
    apart = _sectors_apart(edges, edges[follower])
    meet &= ~((follower[one] == other) & apart[one]) & ~((follower[other] == one) & apart[other])
    number_of = np.repeat(np.arange(len(sizes)), sizes)
    suspects: dict[int, tuple[list[int], list[tuple[int, int]]]] = {}
    for index in alone.tolist():
        number = int(number_of[index])
        suspects.setdefault(number, ([], []))[0].append(index - int(first[number]))
    for i, j in zip(one[meet].tolist(), other[meet].tolist(), strict=True):
        number = int(number_of[i])
        start = int(first[number])
        suspects.setdefault(number, ([], []))[1].append((i - start, j - start))
    for number in sorted(suspects):
        yield number, *suspects[number]


def _pairs(size: int, first: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """All pairs of the edges of a panel of ``size``, numbered from ``first`` on."""
    one, other = _pairs_of(size)
    return one + first, other + first


@lru_cache(maxsize=256)
def _pairs_of(size: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    one, other = np.triu_indices(size, k=1)
    return one, other


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
