"""Collars, sewn to a neckline: turtleneck, lapel, hood."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from math import atan2, hypot, pi, sin

from gcd_dataset.curves import Point, Quadratic
from gcd_dataset.generator.garments.description import Tag
from gcd_dataset.generator.garments.skirt import band, sector
from gcd_dataset.generator.garments.space import Design, choice, flag, integer, real
from gcd_dataset.generator.pattern import Component, Interface, Outline, Piece, s_shaped_cubic
from gcd_dataset.generator.pattern.piece import Vector
from gcd_dataset.records import Measurements

# GarmentCode draws at 10 and 0 cm; its files truncate the pivot, which moves the hood up to 1 cm down and back.
RAISED, SET_BACK = 9.6, 0.4  # cm above and behind the shoulder
FORWARD = 1.2  # shoulder to the hood's opening, forward, over half the neckline's width, GarmentCode
OVER_CROWN = 0.5  # height of the hood above ``height`` over half the neckline's width, GarmentCode
BACK_OF_HEAD = Quadratic((0.2, -0.5))  # edge frame, from crown to nape, GarmentCode
LEVEL: Point = (1.0, 0.0)


def with_hood(size: Measurements, half: Component, *, depth: float, length: float) -> Component:
    """The right half of an upper body with the right half of a hood sewn to its neckline.

    ``depth``: length of the top edge, as a fraction of half the neckline's width; ``length``: height of the hood, as a
    fraction of nape to crown.
    """
    front_neck, back_neck = (half.piece(name) for name in ("right_ftorso", "right_btorso"))
    outline = hood_outline(
        _extent(front_neck), front_neck.outline.length("neck"), _extent(back_neck), back_neck.outline.length("neck"),
        top=depth, height=length * size.head_l,
    )  # fmt: skip
    half_width, _ = _extent(back_neck)
    piece = Piece("right_hood", outline, rotation=(0.0, -pi / 2, 0.0))
    piece = piece.at(-half_width, size.height - size.head_l + RAISED, -SET_BACK)
    return (
        Component.of(half, piece)
        .sewn(front_neck.along("neck"), piece.along("front_neck"))
        .sewn(back_neck.along("neck"), piece.against("back_neck"))
        .offering(**half.interfaces, hood_centre=piece.along("top", "back"))
    )


def _extent(piece: Piece) -> Point:
    """Width and depth of half a neckline [cm]."""
    neck = piece.outline.run("neck")
    return abs(neck[-1].end[0] - neck[0].start[0]), abs(neck[-1].end[1] - neck[0].start[1])


def hood_outline(
    front: Point, front_length: float, back: Point, back_length: float, *, top: float, height: float
) -> Outline:
    """The outline: from the nape along the neckline to the throat, up the opening, and back over the head.

    ``front``, ``back``: width and depth of the shirt's half necklines [cm]; ``front_length``, ``back_length``: lengths
    of their edges [cm]; ``top``: length of the top edge, as a fraction of half the neckline's width; ``height``: height
    over the shoulder, without ``OVER_CROWN`` [cm]. Both neck edges are nearly level at their ends. They meet near
    the origin, the shoulder: ``s_shaped_cubic`` may move the end of the back's edge along its chord.
    """
    half_width = back[0]
    back_neck = s_shaped_cubic((-back[0], -back[1]), (0.0, 0.0), tangent=LEVEL, length=back_length)
    front_neck = s_shaped_cubic(back_neck.end, (front[0], -front[1]), tangent=LEVEL, length=front_length)
    opening, crown = FORWARD * half_width, height + OVER_CROWN * half_width
    return (
        Outline.start(*back_neck.start)
        .curve(*back_neck.end, back_neck.curve, name="back_neck")
        .curve(*front_neck.end, front_neck.curve, name="front_neck")
        .line(opening, crown, name="opening")
        .line(opening - top * half_width, crown, name="top")
        .curve(*back_neck.start, BACK_OF_HEAD, name="back")
    )


TURTLENECK_OUT = 10.0  # cm: z of the front, and -z of the back, before sewing, GarmentCode
LAPEL_FRONT, LAPEL_BACK = 35.0, -10.0  # cm: z of front and back before sewing, GarmentCode
LAPEL_EDGE = Quadratic((0.7, 0.2))  # edge frame, from the lower tip to the upper, GarmentCode
LOW, WIDE, ROOMY = 4, 6, 1.4  # cm, depth of low and wide collars; ``hood_depth`` of a roomy hood
LYING = (pi / 2, pi / 4, 0.0)  # rad: rotation of a collar that lies on the shoulders, GarmentCode


class Collar(Enum):
    """Kind of collar, by GarmentCode's name."""

    TURTLENECK = "Turtle"
    LAPEL = "SimpleLapel"
    HOOD = "Hood2Panels"


@dataclass(frozen=True)
class CollarDesign(Design):
    """A collar, or none."""

    style: Collar | None = choice(None, *Collar, None, keep=0.6)
    """Kind of collar, or none; the neckline is then a plain edge."""
    depth: int = integer(7, 2, 8)
    """Height of a turtleneck or lapel [cm]."""
    lapel_standing: bool = flag(False)
    """Whether a lapel stands up at the nape; otherwise it lies round the neck."""
    hood_depth: float = real(1.0, 1.0, 2.0, keep=0.6)
    """Length of the hood's top edge, as a fraction of half the neckline's width."""
    hood_length: float = real(1.0, 1.0, 1.5, keep=0.6)
    """Height of the hood, as a fraction of nape to crown."""


STYLES: Mapping[Collar, Tag] = {Collar.TURTLENECK: Tag.TURTLENECK, Collar.LAPEL: Tag.LAPEL, Collar.HOOD: Tag.HOODED}
"""The tag of each collar."""


def collar_words(design: CollarDesign, *, near_neck: bool) -> tuple[str, ...]:
    """Noun phrases for a collar; ``near_neck``: whether its neckline lies close round the neck."""
    match design.style:
        case None:
            return ()
        case Collar.HOOD:
            return ("a hood",) if design.hood_depth < ROOMY else ("a roomy hood",)
        case Collar.LAPEL:
            wide = "wide " if design.depth >= WIDE else "narrow " if design.depth <= LOW else ""
            return (f"{wide}lapels", f"a {wide}lapel collar") if not design.lapel_standing else (
                f"{wide}lapels rising to a standing collar at the nape",)  # fmt: skip
        case Collar.TURTLENECK:
            if not near_neck:
                return ("a standing collar round a wide neckline",)
            return ("a low standing collar",) if design.depth <= LOW else ("a turtleneck", "a turtleneck collar")


def with_collar(size: Measurements, design: CollarDesign, half: Component) -> Component:
    """The right half of an upper body with the right half of its collar, if any, sewn to the neckline.

    Appends the centre edges of the collar to the interfaces ``front_centre`` and ``back_centre``.
    """
    match design.style:
        case None:
            return half
        case Collar.TURTLENECK:
            return turtleneck(size, design, half)
        case Collar.LAPEL:
            return lapel(size, design, half)
        case Collar.HOOD:
            return with_hood(size, half, depth=design.hood_depth, length=design.hood_length)


def turtleneck(size: Measurements, design: CollarDesign, half: Component) -> Component:
    """The half with two rectangles, as long as the front and the back of the neckline."""
    front_neck, back_neck = _neck_lengths(half)
    level = size.height - size.head_l + design.depth
    front = band("right_collar_front", front_neck, design.depth).at(-0.5 * front_neck, level, TURTLENECK_OUT)
    back = band("right_collar_back", back_neck, design.depth).at(-0.5 * back_neck, level, -TURTLENECK_OUT)
    return (
        Component.of(half, front, back)
        .sewn(front.along("right"), back.along("right"))
        .sewn(half.piece("right_ftorso").along("neck"), front.along("bottom"))
        .sewn(half.piece("right_btorso").along("neck"), back.along("bottom"))
        .offering(**half.interfaces)
        .offering(
            front_centre=half.interface("front_centre") + front.along("left"),
            back_centre=half.interface("back_centre") + back.along("left"),
        )
    )


def lapel(size: Measurements, design: CollarDesign, half: Component) -> Component:
    """The half with a lapel in front, its wrong side out, and a standing or lying collar behind.

    The shirt stays sewn at the front; the lapels are not sewn to each other.
    """
    level = size.height - size.head_l + 2 * design.depth
    front_neck, back_neck = _neck_lengths(half)
    front = _lapel_front(front_neck, design.depth).at(-2 * design.depth, level, LAPEL_FRONT)
    draw = _standing_back if design.lapel_standing else _round_back
    back, to_neck, to_front = draw(half.piece("right_btorso"), design.depth, (-back_neck, level, LAPEL_BACK))
    return (
        Component.of(half, front, back)
        .sewn(front.against("top"), to_front)
        .sewn(half.piece("right_ftorso").along("neck"), front.along("neck"))
        .sewn(half.piece("right_btorso").along("neck"), to_neck)
        .offering(**half.interfaces)
        .offering(back_centre=half.interface("back_centre") + back.along("left"))
    )


def _lapel_front(neck: float, depth: float) -> Piece:
    """The lapel: from the tip along the shoulder seam, down the neckline, and back along the free edge."""
    outline = (
        Outline.start(0, 0)
        .line(depth, 0, name="top")
        .line(depth, -neck, name="neck")
        .curve(0, 0, LAPEL_EDGE, name="edge")
    )
    return Piece("right_collar_front", outline)


def _standing_back(torso: Piece, depth: float, position: Vector) -> tuple[Piece, Interface, Interface]:
    """A band, its interface to the neckline (from the shoulder), and its interface to the lapel (from the neckline)."""
    piece = band("right_collar_back", torso.outline.length("neck"), depth).at(*position)
    return piece, piece.along("bottom"), piece.against("right")


def _round_back(torso: Piece, depth: float, position: Vector) -> tuple[Piece, Interface, Interface]:
    """A ring sector round the arc of the neckline, and the same two interfaces as ``_standing_back``."""
    neck = torso.outline.edge("neck")
    width, drop = abs(neck.chord[0]), abs(neck.chord[1])
    turn = 2 * atan2(drop, width)  # an arc turns by twice the angle between its chord and its level end
    piece = replace(sector("right_collar_back", neck.length, turn, depth), rotation=LYING)
    # GarmentCode computes the shoulder end with the piece's x axis turned towards y; readers of its files rotate the
    # piece about that end with x turned towards z. The offset keeps the shoulder end at GarmentCode's position.
    offset = 0.5 * hypot(width, drop) * sin(LYING[1])
    x, y, z = position
    return piece.at(x, y - offset, z - offset), piece.against("top"), piece.along("right")


def _neck_lengths(half: Component) -> tuple[float, float]:
    """Lengths of half a neckline, in front and behind [cm]."""
    front, back = (half.piece(name).outline.length("neck") for name in ("right_ftorso", "right_btorso"))
    return front, back
