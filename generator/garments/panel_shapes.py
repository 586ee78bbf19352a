"""Panel shapes of waistbands, gathered skirts and circle skirts: rectangles, trapezoids and ring sectors."""

from math import cos, pi, sin

from gcd_dataset.curves import Arc
from gcd_dataset.generator.pattern import Outline, Piece

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
