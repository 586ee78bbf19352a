"""The four curve types of a pattern edge and their geometry in the panel's plane.

Control points are kept in the *edge frame* of the specification format: for an edge from ``S`` to ``E``, the pair
``(a, b)`` stands for ``S + a e + b n`` with ``e = E - S`` and ``n = (-e_y, e_x)``, the left normal of the same length.
Control points therefore move with the end points. An arc keeps its radius in centimetres.

>>> quarter = Arc(radius=10.0, large=False, right=True)
>>> round(curve_length((0, 0), (10, 10), quarter), 4)
15.708
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import asin, atan2, hypot, pi, sqrt
from typing import ClassVar, TypeAlias

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import PatternError

__all__ = [
    "LINE", "Arc", "Cubic", "Curve", "Line", "Point", "Quadratic", "curve_length", "curve_points", "curve_tangents",
    "from_frame", "mirrored", "reflection", "reversed_curve", "sample_curve", "to_frame",
]  # fmt: skip

Point: TypeAlias = tuple[float, float]

QUADRATURE_NODES, QUADRATURE_WEIGHTS = np.polynomial.legendre.leggauss(24)
LARGEST_RADIUS = 1000.0  # cm; a flatter arc is fitted as a cubic
STRAIGHT = 0.2  # cm; an edge is straight if its points are this close to the chord
ARC_TOLERANCE = 1e-6  # relative rounding error by which a radius may be under half the chord


@dataclass(frozen=True, slots=True)
class Line:
    """A straight edge."""

    kind: ClassVar[str] = "line"


@dataclass(frozen=True, slots=True)
class Quadratic:
    """A quadratic Bézier curve; the control point is in the edge frame."""

    control: Point
    kind: ClassVar[str] = "quadratic"


@dataclass(frozen=True, slots=True)
class Cubic:
    """A cubic Bézier curve; both control points are in the edge frame."""

    control0: Point
    control1: Point
    kind: ClassVar[str] = "cubic"


@dataclass(frozen=True, slots=True)
class Arc:
    """A circular arc of ``radius`` cm.

    ``large``: longer than a half circle. ``right``: bulges to the right of the direction of travel, y pointing up, so
    that the travel runs counter-clockwise about the centre.
    """

    radius: float
    large: bool
    right: bool
    kind: ClassVar[str] = "circle"


Curve: TypeAlias = Line | Quadratic | Cubic | Arc
LINE = Line()


def curve_points(start: Point, end: Point, curve: Curve, t: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Points [cm] at curve parameters ``t`` in [0, 1]: Bézier parameter, or share of an arc's angle.

    Raises ``PatternError`` for an arc whose radius does not span its chord.
    """
    t = np.asarray(t, float)
    if isinstance(curve, Arc):
        centre, angle0, sweep = arc_centre(start, end, curve)
        angles = angle0 + sweep * t
        return centre + curve.radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = control_points(start, end, curve)
    while len(points) > 1:  # de Casteljau
        points = [(1 - t)[:, None] * p + t[:, None] * q for p, q in pairwise(points)]
    return points[0] + np.zeros((len(t), 2))


def curve_tangents(start: Point, end: Point, curve: Curve, t: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Derivatives of ``curve_points`` with respect to ``t`` [cm]."""
    t = np.asarray(t, float)
    if isinstance(curve, Arc):
        _, angle0, sweep = arc_centre(start, end, curve)
        angles = angle0 + sweep * t
        return curve.radius * sweep * np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    points = control_points(start, end, curve)
    degree = len(points) - 1
    steps = [degree * (q - p) for p, q in pairwise(points)]
    while len(steps) > 1:
        steps = [(1 - t)[:, None] * p + t[:, None] * q for p, q in pairwise(steps)]
    return steps[0] + np.zeros((len(t), 2))


def curve_length(start: Point, end: Point, curve: Curve) -> float:
    """Arc length [cm]: exact for lines and arcs, by 24-point Gauss–Legendre quadrature for Bézier curves."""
    if isinstance(curve, Line):
        return hypot(end[0] - start[0], end[1] - start[1])
    if isinstance(curve, Arc):
        return float(curve.radius * abs(arc_centre(start, end, curve)[2]))
    return _bezier_length((start[0], start[1]), (end[0], end[1]), curve)


@lru_cache(maxsize=4096)  # drawing, sewing and checking measure the same edge
def _bezier_length(start: Point, end: Point, curve: Quadratic | Cubic) -> float:
    nodes = 0.5 * (QUADRATURE_NODES + 1)
    speed = np.linalg.norm(curve_tangents(start, end, curve, nodes), axis=1)
    return float(0.5 * QUADRATURE_WEIGHTS @ speed)


def sample_curve(start: Point, end: Point, curve: Curve, count: int) -> Float[np.ndarray, "n 2"]:
    """``count`` points equally spaced by arc length [cm], both ends included and exact."""
    t = _shares(count)
    if isinstance(curve, Quadratic | Cubic):
        t = _equal_arc_length(start, end, curve, t)
    points = curve_points(start, end, curve, t)
    points[0], points[-1] = start, end
    return points


@lru_cache(maxsize=1024)
def _shares(count: int) -> Float[np.ndarray, " n"]:
    """``count`` numbers from 0 to 1, not to be written to."""
    shares = np.linspace(0.0, 1.0, count)
    shares.flags.writeable = False
    return shares


def _equal_arc_length(
    start: Point, end: Point, curve: Quadratic | Cubic, shares: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Curve parameters at the given shares of the arc length."""
    knots = _shares(max(129, 2 * len(shares) + 1))
    speed = np.linalg.norm(curve_tangents(start, end, curve, knots), axis=1)
    middle = np.linalg.norm(curve_tangents(start, end, curve, 0.5 * (knots[1:] + knots[:-1])), axis=1)
    steps = (speed[1:] + 4 * middle + speed[:-1]) / 6 * np.diff(knots)  # Simpson's rule
    reached = np.concatenate([[0.0], np.cumsum(steps)])
    if reached[-1] == 0.0:
        return shares
    return np.interp(shares * reached[-1], reached, knots)


def reversed_curve(curve: Curve) -> Curve:
    """The same curve, from its end to its start."""
    match curve:
        case Quadratic((a, b)):
            return Quadratic((1 - a, -b))
        case Cubic((a0, b0), (a1, b1)):
            return Cubic((1 - a1, -b1), (1 - a0, -b0))
        case Arc(radius, large, right):
            return Arc(radius, large, not right)
        case _:
            return curve


def mirrored(curve: Curve) -> Curve:
    """The curve of the mirrored edge: same direction of travel, bulging to the other side."""
    match curve:
        case Quadratic((a, b)):
            return Quadratic((a, -b))
        case Cubic((a0, b0), (a1, b1)):
            return Cubic((a0, -b0), (a1, -b1))
        case Arc(radius, large, right):
            return Arc(radius, large, not right)
        case _:
            return curve


def reflection(start: Sequence[float], end: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The reflection in the line through two points, as an affine matrix."""
    along = np.subtract(end, start)
    x, y = along / np.linalg.norm(along)
    turn = np.array([[x * x - y * y, 2 * x * y], [2 * x * y, y * y - x * x]])
    return np.block([[turn, (np.asarray(start) - turn @ start)[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])


def from_frame(start: Point, end: Point, relative: Point) -> Point:
    """Edge frame to panel plane [cm]."""
    ex, ey = end[0] - start[0], end[1] - start[1]
    a, b = relative
    return (start[0] + a * ex - b * ey, start[1] + a * ey + b * ex)


def to_frame(start: Point, end: Point, absolute: Point) -> Point:
    """Panel plane [cm] to edge frame. Raises ``PatternError`` for an edge without length."""
    ex, ey = end[0] - start[0], end[1] - start[1]
    square = ex * ex + ey * ey
    if square == 0.0:
        raise PatternError(f"edge from {tuple(start)} to {tuple(end)} has no length: move one of its ends")
    dx, dy = absolute[0] - start[0], absolute[1] - start[1]
    return ((dx * ex + dy * ey) / square, (dy * ex - dx * ey) / square)


def control_points(start: Point, end: Point, curve: Line | Quadratic | Cubic) -> list[Float[np.ndarray, "2"]]:
    """Ends and control points of a line or Bézier curve in the panel plane [cm]."""
    match curve:
        case Quadratic(control):
            inner = [from_frame(start, end, control)]
        case Cubic(control0, control1):
            inner = [from_frame(start, end, control0), from_frame(start, end, control1)]
        case _:
            inner = []
    return [np.asarray(p, float) for p in (start, *inner, end)]


def signed_area(loop: Float[np.ndarray, "n 2"]) -> float:
    """Area of a closed polyline, positive if it runs counter-clockwise [cm²]."""
    x, y = loop.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def arc_centre(start: Point, end: Point, arc: Arc) -> tuple[Float[np.ndarray, "2"], float, float]:
    """Centre [cm], angle of the start as seen from the centre [rad], and signed sweep [rad] of an arc.

    Raises ``PatternError`` if the radius is under half the chord.
    """
    along, across = end[0] - start[0], end[1] - start[1]
    chord = hypot(along, across)
    if chord == 0.0 or arc.radius < 0.5 * chord * (1 - ARC_TOLERANCE):
        raise PatternError(f"arc of radius {arc.radius:.6g} cm cannot span a chord of {chord:.6g} cm")
    side = 1.0 if arc.right != arc.large else -1.0  # side of the chord with the centre; +1: left
    height = side * sqrt(max(arc.radius**2 - 0.25 * chord**2, 0.0)) / chord
    x, y = 0.5 * (start[0] + end[0]) - height * across, 0.5 * (start[1] + end[1]) + height * along
    half = asin(min(0.5 * chord / arc.radius, 1.0))
    turn = 2 * (pi - half) if arc.large else 2 * half
    angle0 = atan2(start[1] - y, start[0] - x)
    return np.array([x, y]), angle0, turn if arc.right else -turn


def fitted_curve(points: Float[np.ndarray, "n 2"]) -> Curve:
    """The curve through points: a line if within ``STRAIGHT``, else the closer of cubic and arc; ends are kept."""
    start, end = points[0], points[-1]
    t = np.linspace(0, 1, len(points))[:, None]
    straight = (1 - t) * start + t * end
    if np.linalg.norm(points - straight, axis=1).max() < STRAIGHT or np.hypot(*(end - start)) == 0.0:
        return LINE
    cubic, cubic_miss = _fitted_cubic(points, straight, t)
    arc, arc_miss = _fitted_arc(points)
    return arc if arc is not None and arc_miss < cubic_miss else cubic


def _fitted_cubic(points: np.ndarray, straight: np.ndarray, t: np.ndarray) -> tuple[Cubic, float]:
    """A cubic by least squares over equal parameter steps, and its largest error at a point [cm]."""
    basis = np.concatenate([3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t)], axis=1)
    # Offset of the control points from the thirds of the chord.
    bend = np.linalg.lstsq(basis, points - straight, rcond=None)[0]
    start, end = points[0], points[-1]
    ends = (start[0], start[1]), (end[0], end[1])
    controls = start + np.array([[1.0], [2.0]]) / 3 * (end - start) + bend
    miss = np.linalg.norm(points - straight - basis @ bend, axis=1).max()
    return Cubic(*(to_frame(*ends, (x, y)) for x, y in controls.tolist())), float(miss)


def _fitted_arc(points: np.ndarray) -> tuple[Arc | None, float]:
    """A circular arc by algebraic least squares (Kåsa 1976), and its largest error at a point [cm]."""
    system = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
    x, y, rest = np.linalg.lstsq(system, np.sum(points**2, axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(rest + x * x + y * y, 0.0)))
    spokes = points - [x, y]
    miss = float(np.abs(np.linalg.norm(spokes, axis=1) - radius).max())
    before, after = spokes[:-1], spokes[1:]
    turns = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.sum(before * after, axis=1)).sum()
    if not np.hypot(*(points[-1] - points[0])) / 2 < radius < LARGEST_RADIUS:
        return None, miss
    return Arc(radius, large=bool(abs(turns) > np.pi), right=bool(turns > 0)), miss
