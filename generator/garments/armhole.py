"""Armholes: shapes from the underarm up to the shoulder, to cut into the corner between side and shoulder."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import Enum

from gcd_dataset.curves import Cubic
from gcd_dataset.generator.pattern import Outline, Stroke
from gcd_dataset.records import EdgeRole

CURVE = Cubic((0.2, -0.35), (0.5, -0.2))  # edge frame, from underarm to shoulder, GarmentCode


class Armhole(Enum):
    """Shape of an armhole, by GarmentCode's name."""

    SQUARE = "ArmholeSquare"
    ANGLE = "ArmholeAngle"
    CURVE = "ArmholeCurve"


def armhole(kind: Armhole, width: float, depth: float, *, corner: float) -> tuple[Stroke, ...]:
    """The edge from the underarm at (0, 0) to the shoulder, ``width`` inwards and ``depth`` upwards [cm].

    ``corner``: position of the corner of an angled armhole, as a fraction of its width and height.
    """
    drawn = DRAWINGS[kind](width, depth, corner)
    return tuple(replace(stroke, name="armhole", label=EdgeRole.RIGHT_ARMHOLE) for stroke in drawn.strokes)


def _square(width: float, depth: float, corner: float) -> Outline:
    return Outline.start(0, 0).line(width, 0).line(width, depth)


def _angle(width: float, depth: float, corner: float) -> Outline:
    return Outline.start(0, 0).line((1 - corner) * width, corner * depth).line(width, depth)


def _curve(width: float, depth: float, corner: float) -> Outline:
    return Outline.start(0, 0).curve(width, depth, CURVE)


DRAWINGS: Mapping[Armhole, Callable[[float, float, float], Outline]] = {
    Armhole.SQUARE: _square,
    Armhole.ANGLE: _angle,
    Armhole.CURVE: _curve,
}
"""Drawing functions of width [cm], depth [cm] and corner."""
