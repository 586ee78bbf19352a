"""Strokes: drawn edges, each with two end points of its own; edges of a finished panel share corners.

>>> side = Stroke((0.0, 0.0), (0.0, 30.0), name="side")
>>> [round(part.length, 3) for part in side.split([0.25])]
[7.5, 22.5]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import cos, hypot, pi, sin
from typing import Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import (
    LINE,
    QUADRATURE_NODES,
    QUADRATURE_WEIGHTS,
    Arc,
    Cubic,
    Curve,
    Line,
    Point,
    Quadratic,
    curve_length,
    curve_points,
    curve_tangents,
    from_frame,
    mirrored,
    reversed_curve,
    to_frame,
)
from gcd_dataset.errors import PatternError
from gcd_dataset.records import EdgeRole, LineRole

OUTLINE_SAMPLES = np.linspace(0.0, 1.0, 17)  # curve parameters, for the extent of an outline
SWEPT_AREA = {
    1: ((0, 1, 1 / 2),),
    2: ((0, 1, 1 / 3), (1, 2, 1 / 3), (0, 2, 1 / 6)),
    3: ((0, 1, 3 / 10), (0, 2, 3 / 20), (0, 3, 1 / 20), (1, 2, 3 / 20), (1, 3, 3 / 20), (2, 3, 3 / 10)),
}
"""Bézier degree to (i, j, weight): ½ ∫ (x dy - y dx) as a sum of cross products of control points i and j."""
ARC_LENGTH_TOLERANCE = 1e-9  # as a fraction of the stroke's length
ARC_LENGTH_STEPS = 20  # most steps of Newton's method


@dataclass(frozen=True, slots=True)
class Stroke:
    """An edge in the plane of its piece [cm], drawn from ``start`` to ``end``."""

    start: Point
    end: Point
    curve: Curve = LINE
    name: str = ""
    """Name in the drawing; the parts of a divided stroke keep it."""
    label: EdgeRole | LineRole | str = ""
    """Role of the edge in a drape, or of a line; empty for none."""
    angle: float = 0.0
    """Rest angle of a fold [degrees], see ``InnerLine``."""

    @property
    def length(self) -> float:
        """Arc length [cm]."""
        return curve_length(self.start, self.end, self.curve)

    @property
    def chord(self) -> Point:
        """The vector from start to end [cm]."""
        return (self.end[0] - self.start[0], self.end[1] - self.start[1])

    @property
    def swept_area(self) -> float:
        """Signed area swept by the line from the origin to the stroke, by Green's theorem [cm²]."""
        if isinstance(self.curve, Line):  # most strokes
            return 0.5 * _cross(self.start, self.end)
        if isinstance(self.curve, Arc):
            turn = self.length / self.curve.radius
            segment = 0.5 * self.curve.radius**2 * (turn - sin(turn))
            return 0.5 * _cross(self.start, self.end) + (segment if self.curve.right else -segment)
        points = self.control_points()
        weights = SWEPT_AREA[len(points) - 1]
        return sum(weight * _cross(points[i], points[j]) for i, j, weight in weights)

    def points(self) -> Float[np.ndarray, "n 2"]:
        """Points along the stroke, ends included, dense enough for a bounding box [cm]."""
        if isinstance(self.curve, Line):
            return np.array([self.start, self.end])
        return _extent_points(self.start, self.end, self.curve)

    def bounds(self) -> tuple[Point, Point]:
        """Lower left and upper right corner of the bounding box of ``points`` [cm]."""
        if not isinstance(self.curve, Line):
            return _bounds(self.start, self.end, self.curve)
        (x0, y0), (x1, y1) = self.start, self.end
        return (min(x0, x1), min(y0, y1)), (max(x0, x1), max(y0, y1))

    def at(self, t: float) -> Point:
        """The point at curve parameter ``t`` [cm]."""
        if not isinstance(self.curve, Arc):
            return _at(self.control_points(), t)
        x, y = curve_points(self.start, self.end, self.curve, np.array([t]))[0]
        return (float(x), float(y))

    def velocity(self, t: float) -> Point:
        """Derivative with respect to the curve parameter at ``t`` [cm]."""
        if not isinstance(self.curve, Arc):
            points = self.control_points()
            degree = len(points) - 1
            return _at([(degree * (q[0] - p[0]), degree * (q[1] - p[1])) for p, q in pairwise(points)], t)
        x, y = curve_tangents(self.start, self.end, self.curve, np.array([t]))[0]
        return (float(x), float(y))

    def parameter(self, share: float) -> float:
        """The curve parameter at a share of the arc length, by Newton's method.

        Raises ``PatternError`` for a curve that stops or turns back.
        """
        if share in (0.0, 1.0) or isinstance(self.curve, Line | Arc):
            return share
        total, t = self.length, share
        for _ in range(ARC_LENGTH_STEPS):
            missing = share * total - self._length_to(t)
            if abs(missing) <= ARC_LENGTH_TOLERANCE * total:
                return t
            t = min(max(t + missing / hypot(*self.velocity(t)), 0.0), 1.0)
        raise PatternError(f"edge {self.name}: no point at {share:.3f} of its length: the curve stops or turns back")

    def _length_to(self, t: float) -> float:
        nodes = 0.5 * t * (QUADRATURE_NODES + 1)
        speed = np.linalg.norm(curve_tangents(self.start, self.end, self.curve, nodes), axis=1)
        return float(0.5 * t * QUADRATURE_WEIGHTS @ speed)

    def split(self, shares: Sequence[float]) -> tuple[Self, ...]:
        """The parts between the given shares of the arc length, in drawing order, with the stroke's name and label."""
        return self.split_at([self.parameter(share) for share in shares])

    def split_at(self, parameters: Sequence[float]) -> tuple[Self, ...]:
        """The parts between the given curve parameters, in drawing order, with the stroke's name and label."""
        parts, rest, done = [], self, 0.0
        for t in parameters:
            part, rest = rest._divided((t - done) / (1 - done))
            parts.append(part)
            done = t
        return (*parts, rest)

    def _divided(self, t: float) -> tuple[Self, Self]:
        middle = self.at(t)
        if isinstance(self.curve, Arc):
            turn = self.length / self.curve.radius
            first, second = (replace(self.curve, large=turn * share > pi) for share in (t, 1 - t))
            return self._drawn(self.start, middle, first), self._drawn(middle, self.end, second)
        points = self.control_points()
        head, tail = [points[0]], [points[-1]]
        while len(points) > 1:
            points = _between(points, t)
            head.append(points[0])
            tail.append(points[-1])
        return self.through(head), self.through(tail[::-1])

    def control_points(self) -> list[Point]:
        """Start, control points and end [cm]. Raises ``PatternError`` for an arc, which has no control points."""
        match self.curve:
            case Line():
                inner: list[Point] = []
            case Quadratic(control):
                inner = [from_frame(self.start, self.end, control)]
            case Cubic(control0, control1):
                inner = [from_frame(self.start, self.end, control0), from_frame(self.start, self.end, control1)]
            case Arc():
                raise PatternError(f"edge {self.name}: an arc has no control points")
        return [self.start, *inner, self.end]

    def through(self, points: Sequence[Point]) -> Self:
        """The same edge as the line or Bézier curve with these ends and control points [cm]."""
        start, end = points[0], points[-1]
        inner = [to_frame(start, end, point) for point in points[1:-1]]
        match inner:
            case []:
                curve: Curve = LINE
            case [control]:
                curve = Quadratic(control)
            case [control0, control1]:
                curve = Cubic(control0, control1)
            case _:
                raise PatternError(f"edge {self.name}: {len(points)} control points are more than a cubic's four")
        return self._drawn(start, end, curve)

    def called(self, name: str, label: EdgeRole | str) -> Self:
        """The same stroke with another name and label."""
        return type(self)(self.start, self.end, self.curve, name, label)

    def reversed(self) -> Self:
        """The same stroke, drawn from its end to its start."""
        return self._drawn(self.end, self.start, reversed_curve(self.curve))

    def mirrored(self) -> Self:
        """The mirror image about the y axis, drawn in the same order."""
        start, end = (-self.start[0], self.start[1]), (-self.end[0], self.end[1])
        return self._drawn(start, end, mirrored(self.curve))

    def upside_down(self) -> Self:
        """The mirror image about the x axis, drawn in the same order."""
        return self.mirrored().rotated(pi)

    def moved(self, by: Point) -> Self:
        """Shifted by a vector [cm]."""
        start, end = _shift(self.start, by), _shift(self.end, by)
        return self._drawn(start, end, self.curve)

    def rotated(self, angle: float, about: Point = (0.0, 0.0)) -> Self:
        """Turned counter-clockwise about a point [rad]."""
        start, end = rotate(self.start, angle, about), rotate(self.end, angle, about)
        return self._drawn(start, end, self.curve)

    def _drawn(self, start: Point, end: Point, curve: Curve) -> Self:
        """Same as ``replace(self, start=…, end=…, curve=…)``, three times as fast."""
        return type(self)(start, end, curve, self.name, self.label, self.angle)


def chain_from(start: Point, *strokes: Stroke) -> tuple[Stroke, ...]:
    """The strokes in their order, moved together so that the first begins at ``start``."""
    by = (start[0] - strokes[0].start[0], start[1] - strokes[0].start[1])
    return tuple(stroke.moved(by) for stroke in strokes)


def rotate(point: Point, angle: float, about: Point = (0.0, 0.0)) -> Point:
    """A point turned counter-clockwise about another [rad]."""
    x, y = point[0] - about[0], point[1] - about[1]
    return (about[0] + cos(angle) * x - sin(angle) * y, about[1] + sin(angle) * x + cos(angle) * y)


@lru_cache(maxsize=1024)  # Component.placed_by asks twice: for all strokes of a component, and for its interface
def _extent_points(start: Point, end: Point, curve: Curve) -> Float[np.ndarray, "n 2"]:
    points = curve_points(start, end, curve, OUTLINE_SAMPLES)
    points.flags.writeable = False
    return points


@lru_cache(maxsize=1024)  # likewise
def _bounds(start: Point, end: Point, curve: Curve) -> tuple[Point, Point]:
    points = _extent_points(start, end, curve)
    (low_x, low_y), (high_x, high_y) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return (low_x, low_y), (high_x, high_y)


def _between(points: Sequence[Point], t: float) -> list[Point]:
    """One round of de Casteljau's construction."""
    return [((1 - t) * p[0] + t * q[0], (1 - t) * p[1] + t * q[1]) for p, q in pairwise(points)]


def _at(points: Sequence[Point], t: float) -> Point:
    """The point of a Bézier curve at a parameter."""
    while len(points) > 1:
        points = _between(points, t)
    return points[0]


def _cross(a: Point, b: Point) -> float:
    return a[0] * b[1] - a[1] * b[0]


def _shift(point: Point, by: Point) -> Point:
    return (point[0] + by[0], point[1] + by[1])
