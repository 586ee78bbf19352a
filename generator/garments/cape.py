"""The cape: a sector of a circle round the neck. Panels ``right_cape_front``, ``left_cape_front`` and ``cape_back``.

Its shoulder seams follow the shoulders and then bend down over the arms, so that a half circle lies as smoothly as a
full one.
"""

from dataclasses import dataclass
from math import pi

from gcd_dataset.curves import Arc, Point
from gcd_dataset.generator.garments.description import Description, Detail, Place, Words
from gcd_dataset.generator.garments.garment import SimpleUpper
from gcd_dataset.generator.garments.neckline import Neckline
from gcd_dataset.generator.garments.overgarment import (
    NeckHole,
    both_halves,
    neck_hole,
    placed_at_neck,
    right_neck,
    with_shoulder,
)
from gcd_dataset.generator.garments.space import Design, real
from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.generator.pattern import Component, Outline, Piece
from gcd_dataset.records import Measurements

HALF_CIRCLE = 0.75  # of a circle: below, descriptions call the cape half a circle


@dataclass(frozen=True)
class CapeDesign(Design):
    """A cape."""

    length: float = real(1.1, 0.7, 2.2)
    """Length from the nape to the hem, as a fraction of nape to waist."""
    circle: float = real(0.75, 0.5, 1.0)
    """Angle of front and back together, as a fraction of a full circle."""
    neck: float = real(1.15, 1.05, 1.5)
    """Girth of the neck opening, as a fraction of the base of the neck."""
    closed: float = real(0.2, 0.1, 1.0)
    """Sewn length of the front opening from the neck down, as a fraction of the whole."""


def cape(size: Measurements, design: CapeDesign) -> Component:
    """Two fronts and a back, sewn over the shoulders and down the front. Offers no interface."""
    hole = neck_hole(size, design.neck)
    front = placed_at_neck(Piece("right_cape_front", _right_front(size, design, hole)), size, hole, front=True)
    half = _to_hem(size, design, hole)
    back_outline = both_halves(half, right_neck(hole, Neckline.CIRCLE, front=False))
    back = placed_at_neck(Piece("cape_back", back_outline), size, hole, front=False)
    right = Component.of(front)
    left = right.mirrored("right", "left")
    mirror = left.piece("left_cape_front")
    return (
        Component.of(right, left, back)
        .sewn(front.along("closing"), mirror.along("closing"))
        .sewn(front.along("shoulder", "side"), back.along("shoulder", "side"))
        .sewn(mirror.along("shoulder", "side"), back.against("left_shoulder", "left_side"))
    )


def _right_front(size: Measurements, design: CapeDesign, hole: NeckHole) -> Outline:
    """The right front: from the side of the neck down the shoulder to the hem, and up the middle to the throat."""
    neck, drawn = right_neck(hole, Neckline.CIRCLE, front=True), _to_hem(size, design, hole)
    closed_to = -hole.front + design.closed * (drawn.pen[1] + hole.front)
    if design.closed < 1:
        drawn = drawn.line(0, closed_to, name="opening")
    return drawn.line(0, -hole.front, name="closing").then(*(stroke.reversed() for stroke in reversed(neck)))


def _to_hem(size: Measurements, design: CapeDesign, hole: NeckHole) -> Outline:
    """An open half outline: from the right side of the neck down the shoulder, and along the hem to the middle."""
    low, fall = hole.back + design.length * size.waist_line, 0.5 * pi * (1 - design.circle)
    drawn = with_shoulder(Outline.start(-hole.half_width, 0), size, fall=fall, length=low)
    return drawn.curve(0, -low, _level_arc(drawn.pen, low), name="hem")


def _level_arc(side: Point, low: float) -> Arc:
    """The hem from the side seam to the middle, ``low`` cm under the origin, where it is level."""
    wide, deep = -side[0], low + side[1]
    return Arc((wide**2 + deep**2) / (2 * deep), large=False, right=True)


def _describe(design: CapeDesign) -> Description:
    noun = "half-circle cape" if design.circle < HALF_CIRCLE else "circle cape"
    if design.closed >= 1:
        front: Words = ("a front sewn shut from neck to hem",)
    elif design.closed < 0.5:
        front = ("a front that is open below the neck", "a front opening")
    else:
        front = ("a front that is open towards the hem",)
    return Description((noun,), (), (Detail(Place.BODY, front, main=True),), tags=(Tag.CAPE, Tag.SLEEVELESS))


CAPE = SimpleUpper(
    name="Cape",
    section="cape",
    design=CapeDesign,
    weight=0,
    carries=False,
    cut=cape,
    description_of=_describe,
    length_of=lambda size, design: design.length * size.waist_line,
)
