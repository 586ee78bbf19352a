"""The hood: two panels, ``right_hood`` and its mirror image ``left_hood``, one on each side of the head."""

from math import pi

from gcd_dataset.curves import Point, Quadratic
from gcd_dataset.generator.pattern import Component, Outline, Piece, s_shaped_cubic
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
