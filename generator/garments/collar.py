"""Collars, sewn to a neckline: turtleneck, lapel, hood."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from math import atan2, hypot, pi, sin

from gcd_dataset.curves import Quadratic
from gcd_dataset.generator.garments.hood import with_hood
from gcd_dataset.generator.garments.panel_shapes import band, sector
from gcd_dataset.generator.garments.space import Design, choice, flag, integer, real
from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.generator.pattern import Component, Interface, Outline, Piece
from gcd_dataset.generator.pattern.piece import Vector
from gcd_dataset.records import Measurements

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
    depth: int = integer(7, 2, 8)
    """Height of a turtleneck or lapel [cm]."""
    lapel_standing: bool = flag(False)
    """Whether a lapel stands up at the nape; otherwise it lies round the neck."""
    hood_depth: float = real(1.0, 1.0, 2.0, keep=0.6)
    """Length of the hood's top edge, as a fraction of half the neckline's width."""
    hood_length: float = real(1.0, 1.0, 1.5, keep=0.6)
    """Height of the hood, as a fraction of nape to crown."""


STYLES: Mapping[Collar, Tag] = {
    Collar.TURTLENECK: Tag.TURTLENECK,
    Collar.LAPEL: Tag.LAPEL,
    Collar.HOOD: Tag.HOODED,
}
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
    return half if design.style is None else COLLARS[design.style](size, design, half)


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


def hood(size: Measurements, design: CollarDesign, half: Component) -> Component:
    """The half with half a hood."""
    return with_hood(size, half, depth=design.hood_depth, length=design.hood_length)


COLLARS: Mapping[Collar, Callable[[Measurements, CollarDesign, Component], Component]] = {
    Collar.TURTLENECK: turtleneck,
    Collar.LAPEL: lapel,
    Collar.HOOD: hood,
}
"""Functions that sew a collar to the right half of an upper body."""
