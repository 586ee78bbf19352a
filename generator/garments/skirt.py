"""Functions for skirts of a front and a back, as wide at the top as the body and sewn at the sides.

Pieces are drawn symmetrically about x = 0, with the middle of their ``top`` at the origin; ``right`` is the wearer's.
"""

from math import cos, pi, sin
from typing import Protocol

from gcd_dataset.curves import Arc
from gcd_dataset.generator.garments.trunk import waist_front
from gcd_dataset.generator.pattern import Component, Interface, Outline, Piece, backwards
from gcd_dataset.records import Measurements

STRAIGHT = 1e-3  # rad: a narrower sector is drawn as a rectangle


def band(name: str, width: float, height: float) -> Piece:
    """A rectangle [cm] below the origin, which is the middle of its ``top``.

    Its ``right`` side is the wearer's right when the piece hangs in front of the wearer.
    """
    half = 0.5 * width
    outline = (
        Outline.start(-half, -height)
        .line(half, -height, name="bottom")
        .line(half, 0, name="left")
        .line(-half, 0, name="top")
        .close(name="right")
    )
    return Piece(name, outline)


def skirt_panel(
    name: str, width: float, length: float, *, flare: float, ruffle: float = 1.0, bottom_cut: float = 0.0
) -> Piece:
    """A trapezoid below the origin, which is the middle of its ``top``. Edges are named as in ``band``.

    The top is ``ruffle`` times ``width``, the width after gathering [cm]; ``flare`` is added to each side of the hem
    [cm]. Below a height of ``bottom_cut`` over the hem [cm] the sides are named ``right_slit`` and ``left_slit``.
    """
    top = 0.5 * ruffle * width
    hem, slit = top + flare, top + flare * (1 - bottom_cut / length)
    outline = Outline.start(-hem, -length)
    if bottom_cut > 0:
        outline = outline.line(-slit, bottom_cut - length, name="right_slit")
    outline = outline.line(-top, 0, name="right").line(top, 0, name="top")
    if bottom_cut > 0:
        outline = outline.line(slit, bottom_cut - length, name="left").line(hem, -length, name="left_slit")
    else:
        outline = outline.line(hem, -length, name="left")
    return Piece(name, outline.close(name="bottom"))


def sector(name: str, top: float, angle: float, height: float) -> Piece:
    """A ring sector: ``top`` is the length of its upper arc, ``height`` its width [cm], ``angle`` its opening [rad].

    The origin is the middle between the ends of its top. Edges are named as in ``band``. With a negative angle the
    piece narrows downwards, and its arcs bulge upwards instead of sagging.
    """
    turn, sags = abs(angle), angle > 0
    if turn < STRAIGHT:
        return band(name, top, height)
    upper = top / turn
    lower = upper + height if sags else upper - height
    half_top, half_bottom, drop = upper * sin(turn / 2), lower * sin(turn / 2), height * cos(turn / 2)
    outline = (
        Outline.start(-half_top, 0)
        .line(-half_bottom, -drop, name="right")
        .curve(half_bottom, -drop, Arc(lower, turn > pi, right=sags), name="bottom")
        .line(half_top, 0, name="left")
        .curve(-half_top, 0, Arc(upper, turn > pi, right=not sags), name="top")
    )
    return Piece(name, outline)


SHORTEST = 5.0  # cm: the shortest skirt, GarmentCode


def length_below_waist(size: Measurements, below_hips: float, *, rise: float) -> float:
    """Length [cm] from a top at ``rise`` (0 hips, 1 waist) to the hem; ``below_hips``: of hips to floor."""
    return rise * size.hips_line + below_hips * size.leg_length


class HasLength(Protocol):
    """The parameters of a skirt."""

    @property
    def length(self) -> float:
        """Length below the hips, as a share of the leg."""


def skirt_length(size: Measurements, design: HasLength, rise: float) -> float:
    """Length from the top to the hem along the cloth [cm]; along the back if the front is shorter."""
    return max(length_below_waist(size, design.length, rise=rise), SHORTEST)


def sewn_at_sides(front: Piece, back: Piece) -> Component:
    """Front and back, sewn to each other along ``right`` and ``left``."""
    sewn = Component.of(front, back).sewn(front.along("right"), back.along("right"))
    return sewn.sewn(front.along("left"), back.along("left"))


def waist_ring(size: Measurements, front: Piece, back: Piece) -> Interface:
    """The ring of both tops, gathered so that the side seams meet the sides of the waist."""
    front_ruffle = front.outline.length("top") / waist_front(size)
    back_ruffle = back.outline.length("top") / size.waist_back_width
    return across(front, "top", ruffle=front_ruffle) + backwards(across(back, "top", ruffle=back_ruffle))


def hem_ring(front: Piece, back: Piece) -> Interface:
    """The ring of both hems."""
    return across(front, "bottom") + backwards(across(back, "bottom"))


def across(piece: Piece, edge: str, *, ruffle: float = 1.0) -> Interface:
    """An edge walked from the wearer's right to the left, whatever its drawing direction."""
    run = piece.outline.run(edge)
    if run[0].start[0] < run[-1].end[0]:
        return piece.along(edge, ruffle=ruffle)
    return piece.against(edge, ruffle=ruffle)
