"""Rectangles, trapezes and ring sectors: what waistbands, gathered skirts and circle skirts are cut from."""

from math import cos, pi, sin

from gcd_dataset.curves import Arc
from gcd_dataset.generator.pattern import Outline, Piece

__all__ = ["band", "sector", "skirt_panel"]

STRAIGHT = 1e-3  # rad: a sector of less is drawn as a rectangle


def band(name: str, width: float, height: float) -> Piece:
    """A rectangle [cm] that hangs down from the origin, the middle of its ``top``.

    The ``right`` side is the wearer's when the piece hangs in front of her.
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
    """A trapeze that hangs down from the origin, the middle of its ``top``; its sides are named as on a ``band``.

    The top is ``ruffle`` times as long as ``width`` [cm], what it is gathered to; each side of the hem stands out by
    ``flare`` [cm]. Below ``bottom_cut`` [cm over the hem] the sides are named ``right_slit`` and ``left_slit``.
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
    """A ring sector whose ``top`` is an arc of that length [cm], opening downwards by ``angle`` [rad].

    It hangs down from the origin, the middle between the ends of its top; sides are named as on a ``band``. With a
    negative angle the piece narrows downwards, and its arcs bulge up instead of sagging.
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
