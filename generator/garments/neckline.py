"""Necklines: half shapes, from the shoulder down to the centre, cut into the corner between the two."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import hypot

from gcd_dataset.curves import Arc
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.space import Design, choice, real
from gcd_dataset.generator.garments.trunk import blend
from gcd_dataset.generator.pattern import Stroke
from gcd_dataset.records import Measurements

__all__ = ["Neckline", "NecklineDesign", "neckline", "neckline_width"]

SHOULDER_LEFT = 1.0  # cm beside a neckline of full width, GarmentCode


class Neckline(Enum):
    """The necklines there are."""

    CIRCLE = "CircleNeckHalf"
    V = "VNeckHalf"


@dataclass(frozen=True)
class NecklineDesign(Design):
    """Shape and size of the opening for the neck."""

    f_collar: Neckline = choice(Neckline.CIRCLE, *Neckline, keep=0.4)
    """In front."""
    b_collar: Neckline = choice(Neckline.CIRCLE, *Neckline, keep=0.8)
    """At the back."""
    width: float = real(0.2, -0.5, 1.0, keep=0.4)
    """-1 closed, 0 as wide as the neck, 1 as wide as the shoulders allow."""
    fc_depth: float = real(0.4, 0.3, 2.0, keep=0.3)
    """In front, as a fraction of shoulder to bust."""
    bc_depth: float = real(0.0, 0.0, 2.0, keep=0.4)
    """At the back, as a fraction of shoulder to bust."""


def neckline_width(size: Measurements, design: NecklineDesign) -> float:
    """Full width of the opening at the shoulders [cm]."""
    if design.width < 0:
        return blend(0.0, size.neck_w, 1 + design.width)
    return blend(size.neck_w, size.sleeve_balance - 2 * SHOULDER_LEFT, design.width)


def neckline(kind: Neckline, half_width: float, depth: float) -> tuple[Stroke, ...]:
    """Half a neckline, from the shoulder to the centre [cm]. Raises ``PatternError`` for one that does not go down."""
    if depth <= 0.0:
        raise PatternError(f"a neckline of {2 * half_width:.2f} cm is wider than the shirt: narrow collar.width")
    return DRAWINGS[kind](half_width, depth)


def v_neck(half_width: float, depth: float) -> tuple[Stroke, ...]:
    """A straight line from the shoulder to the centre."""
    return (Stroke((0.0, 0.0), (half_width, -depth), name="neck"),)


def circle_neck(half_width: float, depth: float) -> tuple[Stroke, ...]:
    """Half the arc through both shoulders and the lowest point: chords of half width, radius ``(h² + d²) / 2d``."""
    radius = hypot(half_width, depth) ** 2 / (2 * depth)
    return (Stroke((0.0, 0.0), (half_width, -depth), Arc(radius, large=False, right=True), name="neck"),)


DRAWINGS: Mapping[Neckline, Callable[[float, float], tuple[Stroke, ...]]] = {
    Neckline.CIRCLE: circle_neck,
    Neckline.V: v_neck,
}
"""The drawing of each, from half width and depth [cm]."""
