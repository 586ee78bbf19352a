"""The poncho: a rectangle or a circle of cloth with a neck opening. Panels ``poncho_front`` and ``poncho_back``.

Front and back are sewn, not folded, along shoulders and arms: the seams of a rectangle follow the shoulders' slope.
"""

from dataclasses import dataclass
from enum import Enum
from math import tan

from gcd_dataset.curves import Arc
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Description, Detail, Place
from gcd_dataset.generator.garments.garment import SimpleUpper
from gcd_dataset.generator.garments.neckline import Neckline
from gcd_dataset.generator.garments.overgarment import NeckHole, both_halves, neck_hole, placed_at_neck, right_neck
from gcd_dataset.generator.garments.space import Design, choice, real
from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.generator.pattern import Component, Outline, Piece
from gcd_dataset.records import Measurements


class PonchoShape(Enum):
    """Shape of the cloth."""

    RECTANGLE = "Rectangle"
    CIRCLE = "Circle"


@dataclass(frozen=True)
class PonchoDesign(Design):
    """A poncho."""

    shape: PonchoShape = choice(PonchoShape.RECTANGLE, *PonchoShape)
    length: float = real(1.2, 0.8, 2.0)
    """Length from the nape to the hem, as a fraction of nape to waist."""
    width: float = real(0.65, 0.45, 0.9)
    """Width of a rectangle, as a fraction of the span from wrist to wrist."""
    neck: float = real(1.3, 1.1, 1.7)
    """Girth of the neck opening, as a fraction of the base of the neck."""
    neckline: Neckline = choice(Neckline.CIRCLE, Neckline.CIRCLE, Neckline.V)
    """Shape of the opening in front; it is round behind."""


def poncho(size: Measurements, design: PonchoDesign) -> Component:
    """Front and back of the same shape, sewn over the shoulders and along the arms. Offers no interface."""
    hole = neck_hole(size, design.neck)
    half = _right_half(size, design, hole)
    front_outline = both_halves(half, right_neck(hole, design.neckline, front=True))
    back_outline = both_halves(half, right_neck(hole, Neckline.CIRCLE, front=False))
    front = placed_at_neck(Piece("poncho_front", front_outline), size, hole, front=True)
    back = placed_at_neck(Piece("poncho_back", back_outline), size, hole, front=False)
    return (
        Component.of(front, back)
        .sewn(front.along("shoulder"), back.along("shoulder"))
        .sewn(front.along("left_shoulder"), back.along("left_shoulder"))
    )


def _right_half(size: Measurements, design: PonchoDesign, hole: NeckHole) -> Outline:
    """The right half: from the side of the neck along the arm, down the side, and along the hem to the middle."""
    low = hole.back + design.length * size.waist_line
    start = Outline.start(-hole.half_width, 0)
    if design.shape is PonchoShape.CIRCLE:
        return start.line(-low, 0, name="shoulder").curve(0, -low, Arc(low, large=False, right=True), name="hem")
    wide = design.width * (0.5 * size.shoulder_w + size.arm_length)
    sunk = tan(size.shoulder_incl) * (wide - hole.half_width)
    if sunk >= low:
        raise PatternError(f"a poncho {low:.1f} cm long ends {sunk:.1f} cm down its shoulder: raise poncho.length")
    return start.line(-wide, -sunk, name="shoulder").line(-wide, -low, name="side").line(0, -low, name="hem")


def _describe(design: PonchoDesign) -> Description:
    shape = "round" if design.shape is PonchoShape.CIRCLE else "rectangular"
    neck = "a V-neckline" if design.neckline is Neckline.V else "a round neckline"
    detail = Detail(Place.NECK, (neck,), main=True)
    return Description((f"{shape} poncho",), (), (detail,), tags=(Tag.PONCHO, Tag.SLEEVELESS))


PONCHO = SimpleUpper(
    name="Poncho",
    section="poncho",
    design=PonchoDesign,
    weight=0,
    carries=False,
    cut=poncho,
    description_of=_describe,
    length_of=lambda size, design: design.length * size.waist_line,
)
