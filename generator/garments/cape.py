"""The cape: a part of a circle round the neck, ``right_cape_front``, its mirror image, and ``cape_back``.

Shoulder seams follow the shoulders and then fall over the arms, so that half a circle lies as smoothly as a whole one.
"""

from dataclasses import dataclass
from math import pi

from gcd_dataset.curves import Arc, Point
from gcd_dataset.generator.garments.garment import SimpleUpper
from gcd_dataset.generator.garments.neckline import Neckline
from gcd_dataset.generator.garments.overgarment import NeckHole, both_halves, hung, neck_hole, right_neck, with_shoulder
from gcd_dataset.generator.garments.space import Design, real
from gcd_dataset.generator.pattern import Component, Outline, Piece
from gcd_dataset.records import Measurements

__all__ = ["CAPE", "CapeDesign", "cape"]


@dataclass(frozen=True)
class CapeDesign(Design):
    """A cape."""

    length: float = real(1.1, 0.7, 2.2)
    """From the nape to the hem, as a fraction of nape to waist."""
    circle: float = real(0.75, 0.5, 1.0)
    """How much of a full circle front and back together are cut from."""
    neck: float = real(1.15, 1.05, 1.5)
    """Opening for the neck, as a fraction of the neck's base."""
    closed: float = real(0.2, 0.1, 1.0)
    """How far down from the neck the front is closed, as a fraction of its middle."""


def cape(size: Measurements, design: CapeDesign) -> Component:
    """Two fronts and a back, sewn over the shoulders and at the front; nothing is sewn to its hem."""
    hole = neck_hole(size, design.neck)
    front = hung(Piece("right_cape_front", _right_front(size, design, hole)), size, hole, front=True)
    half = _to_hem(size, design, hole)
    behind = both_halves(half, right_neck(hole, Neckline.CIRCLE, front=False))
    back = hung(Piece("cape_back", behind), size, hole, front=False)
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
    """From the side of the neck down the shoulder to the hem, and up the middle to the throat."""
    neck, drawn = right_neck(hole, Neckline.CIRCLE, front=True), _to_hem(size, design, hole)
    closed_to = -hole.front + design.closed * (drawn.pen[1] + hole.front)
    if design.closed < 1:
        drawn = drawn.line(0, closed_to, name="opening")
    return drawn.line(0, -hole.front, name="closing").then(*(stroke.reversed() for stroke in reversed(neck)))


def _to_hem(size: Measurements, design: CapeDesign, hole: NeckHole) -> Outline:
    """From the right side of the neck down the shoulder, and along the hem to the middle."""
    low, fall = hole.back + design.length * size.waist_line, 0.5 * pi * (1 - design.circle)
    drawn = with_shoulder(Outline.start(-hole.half_width, 0), size, fall=fall, length=low)
    return drawn.curve(0, -low, _level_arc(drawn.pen, low), name="hem")


def _level_arc(side: Point, low: float) -> Arc:
    """The hem from the side seam, level where it reaches the middle ``low`` cm under the start."""
    wide, deep = -side[0], low + side[1]
    return Arc((wide**2 + deep**2) / (2 * deep), large=False, right=True)


CAPE = SimpleUpper(
    name="Cape",
    section="cape",
    design=CapeDesign,
    weight=0,
    carries=False,
    cut=cape,
    length_of=lambda size, design: design.length * size.waist_line,
)
