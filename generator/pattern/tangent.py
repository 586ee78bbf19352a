"""Quadratic curves with given end tangents: hips, crotches, flared legs.

A side seam from the hem at (0, 0) to the hip at (2, 20), vertical at the hip:

>>> side = tangent_quadratic((0.0, 0.0), (2.0, 20.0), end_tangent=(0.0, 1.0), at=0.75)
>>> along, across = side.control  # in the edge frame
>>> round(along, 2), round(across, 4)
(0.75, -0.0249)
"""

from collections.abc import Mapping
from math import atan2, cos, degrees, hypot, sin

import numpy as np

from gcd_dataset.curves import Point, Quadratic
from gcd_dataset.errors import PatternError

ARMS: Mapping[float, tuple[tuple[float, ...], tuple[float, ...]]] = {
    0.5: (
        (0, 6, 8, 10, 12, 16, 20, 31.5, 32, 32.5, 33.5, 37.5, 47.5, 55.5, 63.5, 71, 79, 86.5, 93.5, 100),
        (0.5, 0.5, 0.505, 0.518, 0.543, 0.609, 0.638, 0.686, 1.27, 1.225, 1.425, 1.62, 1.353, 1.209, 1.128, 1.1, 1.118,
         1.176, 1.272, 1.408),
    ),
    0.25: (
        (0, 10, 16, 22, 22.5, 23, 24, 29.5, 32.5, 38, 38.5, 39, 40.5, 46.5, 53.5, 59.5, 66, 72.5, 79.5, 87, 92.5, 100),
        (0.25, 0.251, 0.259, 0.274, 0.402, 0.367, 0.456, 0.659, 0.719, 0.785, 1.503, 1.35, 1.474, 1.517, 1.324, 1.202,
         1.113, 1.059, 1.031, 1.031, 1.054, 1.114),
    ),
    0.7: (
        (0, 6, 10, 16, 27.5, 28, 28.5, 29.5, 31.5, 50, 60, 70, 79, 85, 90.5, 95.5, 100),
        (0.7, 0.702, 0.708, 0.732, 0.821, 1.385, 1.269, 1.4, 1.522, 1.276, 1.204, 1.211, 1.285, 1.376, 1.495, 1.642,
         1.815),
    ),
}  # fmt: skip
"""Start of the control point on the chord [chords] to (angles between tangent and chord [degrees], arms [chords]).

GarmentCode prescribes only the tangent: its minimiser starts with the control point on the chord and moves it along
the tangent. The table holds the control arm where the minimiser stops, for the three starts that garments use. At small
angles the point hardly moves; at some larger angles the arm jumps.
"""


def tangent_quadratic(
    start: Point, end: Point, *, start_tangent: Point | None = None, end_tangent: Point | None = None, at: float = 0.5
) -> Quadratic:
    """The curve between two points [cm] with a given tangent at its start, at its end, or at both.

    With two tangents the control point is their intersection. With one tangent the control point lies on the tangent,
    about as far from its end as the point at the share ``at`` of the chord: 0.5 for a tangent at the start, 0.75 or 0.3
    for a tangent at the end (the shares in ``ARMS``).
    Raises ``PatternError`` for tangents that do not cross between the ends.
    """
    leaves, reaches = (_from_chord(start, end, tangent) for tangent in (start_tangent, end_tangent))
    if leaves is not None and reaches is not None:
        return Quadratic(_crossing(leaves, reaches))
    if leaves is not None:
        arm = _arm(at, leaves)
        return Quadratic((arm * cos(leaves), arm * sin(leaves)))
    if reaches is not None:
        arm = _arm(1 - at, reaches)
        return Quadratic((1 - arm * cos(reaches), -arm * sin(reaches)))
    raise PatternError("a curve with given tangents needs one: give start_tangent or end_tangent")


def _from_chord(start: Point, end: Point, tangent: Point | None) -> float | None:
    """The angle from the chord to a direction [rad]."""
    if tangent is None:
        return None
    x, y = end[0] - start[0], end[1] - start[1]
    if hypot(x, y) == 0.0:
        raise PatternError("a curve with given tangents needs two ends, not one point twice")
    return atan2(x * tangent[1] - y * tangent[0], x * tangent[0] + y * tangent[1])


def _arm(start: float, angle: float) -> float:
    """Length of the control arm [chords] for a tangent at an angle to the chord [rad]; ``start``: key of ``ARMS``."""
    angles, arms = ARMS[round(start, 2)]
    return float(np.interp(abs(degrees(angle)), angles, arms))


def _crossing(leaves: float, reaches: float) -> Point:
    """Intersection of the two tangents in the edge frame: ahead of the start and behind the end."""
    bend = sin(leaves - reaches)
    if bend == 0.0 or -sin(reaches) / bend <= 0.0 or sin(leaves) / bend <= 0.0:
        raise PatternError(
            f"tangents at {degrees(leaves):.0f} and {degrees(reaches):.0f} degrees to the chord do not cross between "
            "the ends of a curve: make its ends further apart"
        )
    arm = -sin(reaches) / bend
    return (arm * cos(leaves), arm * sin(leaves))
