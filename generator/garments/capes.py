"""Capes and ponchos: garments that hang from the shoulders, cut from circles or rectangles.

Drawings begin at the right side of the neck, ``(-half_width, 0)``, where neck and shoulder meet, and are placed with
that point on the body; x = 0 is the wearer's middle.

The shoulder seams of a cape follow the shoulders and then bend down over the arms, so that a half circle lies as
smoothly as a full one.

Front and back of a poncho are sewn, not folded, along shoulders and arms: the seams of a rectangle follow the
shoulders' slope.
"""

from dataclasses import dataclass, replace
from enum import Enum
from math import cos, pi, sin, tan

from gcd_dataset.curves import Arc, Point, Quadratic, to_frame
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Description, Detail, Tag, Words, Zone
from gcd_dataset.generator.garments.garment import SimpleUpper
from gcd_dataset.generator.garments.neckline import Neckline, NecklineDesign, neckline_shape
from gcd_dataset.generator.garments.space import Design, choice, real
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke, chain_from
from gcd_dataset.records import EdgeRole, Measurements

NECK_WIDTH = 0.8  # straight width of the neck over neck_w, which is measured round the back of the neck
FRONT_DROP, BACK_DROP = 0.42, 0.1  # depth of throat and of nape below the sides of the neck, over neck_w
FRONT, BACK = 30.0, -25.0  # cm: z of front and back before sewing


@dataclass(frozen=True, slots=True)
class NeckHole:
    """The opening for the neck [cm]."""

    half_width: float
    front: float
    """Depth in front."""
    back: float
    """Depth behind."""


def neck_hole(size: Measurements, ease: float) -> NeckHole:
    """The opening for the base of the neck, enlarged by the factor ``ease``."""
    around = ease * size.neck_w
    return NeckHole(0.5 * NECK_WIDTH * around, FRONT_DROP * around, BACK_DROP * around)


def right_neck(hole: NeckHole, kind: Neckline, *, front: bool) -> tuple[Stroke, ...]:
    """The right half of the neckline, from the side of the neck to the middle."""
    design = NecklineDesign(f_collar=kind, b_collar=kind)
    depth = hole.front if front else hole.back
    drawn = neckline_shape(design, front=front, half_width=hole.half_width, depth=depth)
    named = (replace(stroke, name="neck", label=EdgeRole.RIGHT_COLLAR) for stroke in drawn)
    return chain_from((-hole.half_width, 0.0), *named)


def with_shoulder(outline: Outline, size: Measurements, *, fall: float, length: float) -> Outline:
    """The outline with a shoulder seam added: straight from the neck along the shoulder, then a curve to the hem.

    ``length``: length of the whole seam [cm]; ``fall``: slope of its end below the horizontal [rad], which also limits
    the slope along the shoulder.
    """
    slope, (x, y) = min(size.shoulder_incl, fall), outline.pen
    shoulder = min((0.5 * size.shoulder_w + x) / cos(slope), 0.5 * length)
    end, bend = (
        _point_towards_right((x, y), slope, shoulder),
        _point_towards_right((x, y), slope, 0.5 * (shoulder + length)),
    )
    hem = _point_towards_right(bend, fall, 0.5 * (length - shoulder))
    return outline.line(*end, name="shoulder").curve(*hem, Quadratic(to_frame(end, hem, bend)), name="side")


def front_or_back(
    name: str, right: Outline, size: Measurements, hole: NeckHole, *, front: bool, neckline: Neckline = Neckline.CIRCLE
) -> Piece:
    """A whole front or back, placed at the neck, from its right half, drawn from the neck to the middle of the hem.

    Edges of the mirror image have the prefix ``left_``.
    """
    neck = right_neck(hole, neckline, front=front)
    left = [replace(stroke.mirrored(), name=f"left_{stroke.name}").reversed() for stroke in reversed(right.strokes)]
    left_neck = [replace(stroke.mirrored(), label=EdgeRole.LEFT_COLLAR) for stroke in neck]
    whole = right.then(*left, *left_neck, *(stroke.reversed() for stroke in reversed(neck)))
    return placed_at_neck(Piece(name, whole), size, hole, front=front)


def placed_at_neck(piece: Piece, size: Measurements, hole: NeckHole, *, front: bool) -> Piece:
    """The piece placed with the sides of its neckline at the sides of the neck."""
    level = size.height - size.head_l - hole.half_width * tan(size.shoulder_incl)
    return piece.at(0, level, FRONT if front else BACK)


def _point_towards_right(start: Point, sinking: float, length: float) -> Point:
    """The point ``length`` cm towards the wearer's right, along a line of slope ``sinking`` [rad]."""
    return start[0] - length * cos(sinking), start[1] - length * sin(sinking)


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
    """Sewn part of the front edge from the neck down, as a fraction of the whole (``Seam.closed``)."""


def cape(size: Measurements, design: CapeDesign) -> Component:
    """Two fronts and a back, sewn over the shoulders and down the front. Offers no interface."""
    hole = neck_hole(size, design.neck)
    front = placed_at_neck(Piece("right_cape_front", _right_front(size, design, hole)), size, hole, front=True)
    back = front_or_back("cape_back", _to_hem(size, design, hole), size, hole, front=False)
    right = Component.of(front)
    left = right.mirrored("right", "left")
    mirror = left.piece("left_cape_front")
    return (
        Component.of(right, left, back)
        .sewn(front.along("centre"), mirror.along("centre"), closed=(1.0 - design.closed, 1.0))
        .sewn(front.along("shoulder", "side"), back.along("shoulder", "side"))
        .sewn(mirror.along("shoulder", "side"), back.against("left_shoulder", "left_side"))
    )


def _right_front(size: Measurements, design: CapeDesign, hole: NeckHole) -> Outline:
    """The right front: from the side of the neck down the shoulder to the hem, and up the middle to the throat."""
    neck, drawn = right_neck(hole, Neckline.CIRCLE, front=True), _to_hem(size, design, hole)
    return drawn.line(0, -hole.front, name="centre").then(*(stroke.reversed() for stroke in reversed(neck)))


def _to_hem(size: Measurements, design: CapeDesign, hole: NeckHole) -> Outline:
    """An open half outline: from the right side of the neck down the shoulder, and along the hem to the middle."""
    low, fall = hole.back + design.length * size.waist_line, 0.5 * pi * (1 - design.circle)
    drawn = with_shoulder(Outline.start(-hole.half_width, 0), size, fall=fall, length=low)
    wide, deep = -drawn.pen[0], low + drawn.pen[1]
    arc = Arc((wide**2 + deep**2) / (2 * deep), large=False, right=True)  # level in the middle
    return drawn.curve(0, -low, arc, name="hem")


def _describe_cape(design: CapeDesign) -> Description:
    noun = "half-circle cape" if design.circle < HALF_CIRCLE else "circle cape"
    if design.closed >= 1:
        front: Words = ("a front sewn shut from neck to hem",)
    elif design.closed < 0.5:
        front = ("a front that is open below the neck", "a front opening")
    else:
        front = ("a front that is open towards the hem",)
    return Description((noun,), (), (Detail(Zone.BODY, front, main=True),), tags=(Tag.CAPE, Tag.SLEEVELESS))


CAPE = SimpleUpper(
    name="Cape",
    section="cape",
    design=CapeDesign,
    weight=0,
    carries=False,
    cut=cape,
    description_of=_describe_cape,
    length_of=lambda size, design: design.length * size.waist_line,
)


class PonchoShape(Enum):
    """Shape of the cloth."""

    RECTANGLE = "Rectangle"
    CIRCLE = "Circle"


@dataclass(frozen=True)
class PonchoDesign(Design):
    """A poncho."""

    shape: PonchoShape = choice(PonchoShape.RECTANGLE, *PonchoShape)
    """Shape of the cloth, front and back together."""
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
    front = front_or_back("poncho_front", half, size, hole, front=True, neckline=design.neckline)
    back = front_or_back("poncho_back", half, size, hole, front=False)
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


def _describe_poncho(design: PonchoDesign) -> Description:
    shape = "round" if design.shape is PonchoShape.CIRCLE else "rectangular"
    neck = "a V-neckline" if design.neckline is Neckline.V else "a round neckline"
    detail = Detail(Zone.NECK, (neck,), main=True)
    return Description((f"{shape} poncho",), (), (detail,), tags=(Tag.PONCHO, Tag.SLEEVELESS))


PONCHO = SimpleUpper(
    name="Poncho",
    section="poncho",
    design=PonchoDesign,
    weight=0,
    carries=False,
    cut=poncho,
    description_of=_describe_poncho,
    length_of=lambda size, design: design.length * size.waist_line,
)
