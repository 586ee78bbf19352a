"""Necklines: half shapes from the shoulder down to the centre, to cut into the corner between the two edges."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum
from itertools import pairwise
from math import hypot, pi, radians, sin, tan

from gcd_dataset.curves import Arc, Cubic, Curve, Point, Quadratic
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.collar import STYLES, Collar, CollarDesign
from gcd_dataset.generator.garments.description import Tag
from gcd_dataset.generator.garments.space import Design, choice, flag, integer, part, real
from gcd_dataset.generator.garments.trunk import blend
from gcd_dataset.generator.pattern import Stroke
from gcd_dataset.records import EdgeRole, Measurements

SHOULDER_LEFT = 1.0  # cm of shoulder beside a neckline of full width, GarmentCode
CENTRE_LEFT = 1.0  # cm of centre edge under the deepest neckline, GarmentCode
CURVY = Cubic((0.4, 0.3), (0.8, -0.3))  # edge frame, from shoulder to centre, GarmentCode
CURVY_FLIPPED = Cubic((0.4, -0.3), (0.8, 0.3))
DEPTHS = ((1.3, "plunging "), (0.85, "deep "))  # least drop, over the depth of the bust line, of each word
BACK_DEPTHS = ((1.2, "very low "), (0.6, "low "))
WIDE = 0.6  # least ``width`` of a wide neckline
HARDLY_CURVED = 0.2  # distance of a Bézier neckline's control point from its chord, of the chord
LAPEL_BEZIER = (0.5, 0.3)  # control point of a Bézier neckline under a lapel, GarmentCode


class Neckline(Enum):
    """Shape of half a neckline, by GarmentCode's name."""

    CIRCLE = "CircleNeckHalf"
    CURVY = "CurvyNeckHalf"
    V = "VNeckHalf"
    SQUARE = "SquareNeckHalf"
    TRAPEZOID = "TrapezoidNeckHalf"
    ARC = "CircleArcNeckHalf"
    BEZIER = "Bezier2NeckHalf"


@dataclass(frozen=True)
class NecklineDesign(Design):
    """Shape and size of the opening for the neck."""

    f_collar: Neckline = choice(Neckline.CIRCLE, *Neckline, keep=0.4)
    """Shape in front."""
    b_collar: Neckline = choice(Neckline.CIRCLE, *Neckline, keep=0.8)
    """Shape at the back."""
    width: float = real(0.2, -0.5, 1.0, keep=0.4)
    """Width of the opening; -1: closed; 0: as wide as the neck; 1: as wide as the shoulders allow."""
    fc_depth: float = real(0.4, 0.3, 2.0, keep=0.3)
    """Depth in front, as a fraction of shoulder to bust."""
    bc_depth: float = real(0.0, 0.0, 2.0, keep=0.4)
    """Depth at the back, as a fraction of shoulder to bust."""
    fc_angle: int = integer(95, 70, 110)
    """In front: slope of a trapezoid's sides, or angle of an arc [degrees]."""
    bc_angle: int = integer(95, 70, 110)
    """The same angle at the back [degrees]."""
    f_bezier_x: float = real(0.3, 0.05, 0.95, keep=0.4)
    """In front: position of a Bézier neckline's control point along its chord, as a fraction of the chord."""
    f_bezier_y: float = real(0.55, 0.05, 0.95, keep=0.4)
    """In front: distance of the control point from the chord, as a fraction of the chord."""
    b_bezier_x: float = real(0.15, 0.05, 0.95, keep=0.4)
    """At the back: position of the control point along the chord, as a fraction of the chord."""
    b_bezier_y: float = real(0.1, 0.05, 0.95, keep=0.4)
    """At the back: distance of the control point from the chord, as a fraction of the chord."""
    f_flip_curve: bool = flag(False, keep=0.8)
    """In front: whether a curvy, arc or Bézier neckline bulges the other way."""
    b_flip_curve: bool = flag(False, keep=0.8)
    """The same flag for the back."""
    component: CollarDesign = part(CollarDesign)


@dataclass(frozen=True)
class LeftNecklineDesign(Design):
    """The left half of a neckline that differs from the right one; both have the same depth."""

    f_collar: Neckline = choice(Neckline.CIRCLE, *Neckline, keep=0.4)
    """Shape of the left half in front."""
    b_collar: Neckline = choice(Neckline.CIRCLE, *Neckline, keep=0.8)
    """Shape of the left half at the back."""
    width: float = real(0.5, 0.0, 1.0, keep=0.4)
    """Width of the left half: 0: as wide as the neck; 1: as wide as the shoulders allow."""
    fc_angle: int = integer(95, 70, 110)
    """In front: slope of a trapezoid's left side, or angle of a left arc [degrees]."""
    bc_angle: int = integer(95, 70, 110)
    """The same angle at the back [degrees]."""
    f_bezier_x: float = real(0.5, 0.05, 0.95, keep=0.4)
    """In front: position of a left Bézier half's control point along its chord, as a fraction of the chord."""
    f_bezier_y: float = real(0.3, 0.05, 0.95)
    """In front: distance of the control point from the chord, as a fraction of the chord."""
    b_bezier_x: float = real(0.5, 0.05, 0.95, keep=0.4)
    """At the back: position of the control point along the chord, as a fraction of the chord."""
    b_bezier_y: float = real(0.3, 0.05, 0.95)
    """At the back: distance of the control point from the chord, as a fraction of the chord."""
    f_flip_curve: bool = flag(False, keep=0.8)
    """In front: whether a curvy, arc or Bézier left half bulges the other way."""
    b_flip_curve: bool = flag(False, keep=0.8)
    """The same flag for the back."""

    def beside(self, right: NecklineDesign) -> NecklineDesign:
        """The complete design of the left neckline: depths from the right one, no collar."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return NecklineDesign(**values, fc_depth=right.fc_depth, bc_depth=right.bc_depth)


def neckline_words(design: NecklineDesign, strokes: Sequence[Stroke], *, drop: float) -> tuple[str, ...]:
    """Nouns for the neckline in front, without article, from half of it as drawn.

    ``drop``: depth of its lowest point under the shoulder's outer end, over the depth of the bust line.
    """
    depth = next((word for least, word in DEPTHS if drop >= least), "")
    wide = "wide " if design.width >= WIDE else ""
    return tuple(
        f"{depth}{wide}{shape} neckline".replace("V neckline", "V-neckline") for shape in _shape(design, strokes)[1]
    )


def neckline_tag(design: NecklineDesign, strokes: Sequence[Stroke]) -> Tag:
    """The tag of a neckline: its collar, or its shape in front, from half of it as drawn."""
    style = design.component.style
    return _shape(design, strokes)[0] if style is None else STYLES[style]


def back_neckline_words(design: NecklineDesign, *, drop: float) -> tuple[str, ...]:
    """Noun phrases for the neckline behind, if it is low: see ``neckline_words``."""
    depth = next((word for least, word in BACK_DEPTHS if drop >= least), "")
    shape = {Neckline.V: "V-shaped ", Neckline.SQUARE: "square "}.get(design.b_collar, "")
    return (f"a {depth}{shape}back", f"a {depth}{shape}back neckline") if depth else ()


def _shape(design: NecklineDesign, strokes: Sequence[Stroke]) -> tuple[Tag, tuple[str, ...]]:
    """Tag and adjectives of the front as drawn: sides of a trapezoid may meet, and flipped arcs bulge inwards."""
    flipped = design.f_flip_curve
    match design.f_collar:
        case Neckline.CIRCLE:
            return (Tag.ROUND_NECK, ("round", "scoop"))
        case Neckline.ARC:
            return (Tag.CURVED_NECK, ("inward-curving",)) if flipped else (Tag.ROUND_NECK, ("round",))
        case Neckline.CURVY:
            return (Tag.CURVED_NECK, ("curved V",) if flipped else ("U-shaped",))
        case Neckline.V:
            return (Tag.V_NECK, ("V",))
        case Neckline.SQUARE:
            return (Tag.SQUARE_NECK, ("square",))
        case Neckline.TRAPEZOID if len(strokes) > 1:
            return (Tag.SQUARE_NECK, ("trapezoid", "angled square"))
        case Neckline.TRAPEZOID:
            return (Tag.V_NECK, ("V",))
        case Neckline.BEZIER:
            if design.f_bezier_y < HARDLY_CURVED:
                return (Tag.CURVED_NECK, ("softly curved V",))
            return (Tag.CURVED_NECK, ("inward-curving",) if flipped else ("curved",))


def worn_neckline(design: NecklineDesign) -> NecklineDesign:
    """The neckline adapted to its collar: round for turtlenecks and hoods, round at the back for lapels.

    A Bézier neckline under a lapel has the control point ``LAPEL_BEZIER`` whatever the design, as in GarmentCode.
    """
    match design.component.style:
        case None:
            return design
        case Collar.LAPEL:
            x, y = LAPEL_BEZIER
            return replace(design, b_collar=Neckline.CIRCLE, f_bezier_x=x, f_bezier_y=y)
        case Collar.TURTLENECK | Collar.HOOD:
            return replace(design, f_collar=Neckline.CIRCLE, b_collar=Neckline.CIRCLE)


def neckline_width(size: Measurements, design: NecklineDesign) -> float:
    """Full width of the opening at the shoulders [cm]."""
    if design.width < 0:
        return blend(0.0, size.neck_w, 1 + design.width)
    return blend(size.neck_w, size.sleeve_balance - 2 * SHOULDER_LEFT, design.width)


def neckline_width_parameter(size: Measurements, full_width: float) -> float:
    """The ``width`` of a design for a full width at the shoulders [cm]: the inverse of ``neckline_width``."""
    over = full_width - size.neck_w
    return over / size.neck_w if over < 0 else over / (size.sleeve_balance - 2 * SHOULDER_LEFT - size.neck_w)


def neckline_drop(size: Measurements, design: NecklineDesign, *, front: bool, room: float) -> float:
    """Depth of the lowest point under the shoulder's outer end [cm]; ``room``: from that level to the hem."""
    depth = design.fc_depth if front else design.bc_depth
    return min(depth * size.drawn_bust_line, room - CENTRE_LEFT)


def half_neckline(
    size: Measurements, design: NecklineDesign, *, front: bool, shoulder: float, room: float
) -> tuple[Stroke, ...]:
    """The right half of a neckline, from the shoulder at the origin down to the centre.

    ``shoulder``: width of the half panel at the level of the shoulder's outer end; ``room``: height of that level over
    the hem at the centre [cm]. Raises ``PatternError`` for a neckline wider than the shirt.
    """
    half_width = 0.5 * neckline_width(size, design)
    depth = neckline_drop(size, design, front=front, room=room) + tan(size.shoulder_incl) * (shoulder - half_width)
    if depth <= 0.0:
        raise PatternError(f"a neckline of {2 * half_width:.2f} cm is wider than the shirt: narrow collar.width")
    strokes = neckline_shape(design, front=front, half_width=half_width, depth=depth)
    return tuple(stroke.called("neck", EdgeRole.RIGHT_COLLAR) for stroke in strokes)


def neckline_shape(design: NecklineDesign, *, front: bool, half_width: float, depth: float) -> tuple[Stroke, ...]:
    """The strokes of a half neckline from the origin to ``(half_width, -depth)`` [cm]."""
    kind = design.f_collar if front else design.b_collar
    flip = design.f_flip_curve if front else design.b_flip_curve
    angle = radians(design.fc_angle if front else design.bc_angle)
    end = (half_width, -depth)
    match kind:
        case Neckline.CIRCLE:
            # Half of the arc through both shoulders and the lowest point, level there. Both halves of a neckline deeper
            # than ``half_width`` form more than half a circle, wider than the shoulder points.
            return _curve(end, Arc((half_width**2 + depth**2) / (2 * depth), large=False, right=True))
        case Neckline.CURVY:
            return _curve(end, CURVY_FLIPPED if flip else CURVY)
        case Neckline.V:
            return _lines(end)
        case Neckline.SQUARE:
            return _lines((0.0, -depth), end)
        case Neckline.TRAPEZOID:
            corner = -depth / tan(angle)
            return _lines((corner, -depth), end) if corner < half_width else _lines(end)
        case Neckline.ARC:
            return _curve(end, Arc(hypot(*end) / (2 * sin(0.5 * angle)), large=angle > pi, right=not flip))
        case Neckline.BEZIER:
            x, y = (design.f_bezier_x, design.f_bezier_y) if front else (design.b_bezier_x, design.b_bezier_y)
            return _curve(end, Quadratic((x, y if flip else -y)))


def _curve(end: Point, curve: Curve) -> tuple[Stroke, ...]:
    return (Stroke((0.0, 0.0), end, curve),)


def _lines(*corners: Point) -> tuple[Stroke, ...]:
    return tuple(Stroke(start, end) for start, end in pairwise(((0.0, 0.0), *corners)))
