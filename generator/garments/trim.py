"""Trim: lines drawn on the fronts of a shirt, for pin tucks and for the placket of a front with buttons.

Pin tucks are sewn into the cloth before the panel is cut, as tailors do: the panel has the shape of the tucked cloth,
and each tuck is its line of stitching. Its fold, a few millimetres of cloth, is finer than a mesh can show, and is
neither drawn nor draped. Lines end ``MARGIN`` inside the outline, so that they divide no seam.
"""

from dataclasses import dataclass, replace
from math import copysign

import numpy as np

from gcd_dataset.curves import LINE
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Detail, Zone, number_word
from gcd_dataset.generator.garments.front import FrontDesign
from gcd_dataset.generator.garments.space import Design, choice, real
from gcd_dataset.generator.pattern import Component, Piece, Stroke
from gcd_dataset.records import LineRole

MARGIN = 1.0  # cm from the ends of a line to the outline, or to a pocket
BUTTONHOLE = (0.25, 0.75)  # ends of a buttonhole, as shares of the way from the centre front to the placket's fold


@dataclass(frozen=True)
class TrimDesign(Design):
    """Lines on the fronts of a shirt; sampling draws none unless an overlay names them."""

    tucks: int | None = choice(None, 2, 3, 4, 5, 6, None, weights=(0, 0, 0, 0, 0, 1))
    """Number of pin tucks on each front of a straight shirt."""
    spread: float = real(0.6, 0.4, 0.9)
    """Width of the tucked part of a front, as a fraction of the width from centre or button stand to the shoulder's
    end."""
    length: float = real(0.5, 0.3, 1.0)
    """Depth of the tucks' lower ends, all at one height, as a fraction of the front's height above the hem; they end
    above a pocket."""
    buttonholes: int | None = choice(None, 4, 5, 6, 7, 8, 9, None, weights=(0, 0, 0, 0, 0, 0, 1))
    """Number of buttonholes of a front with buttons, on a placket as wide as its stand; evenly over the closed part of
    the upper front, beside the centre front, as lines may not cross."""


def with_trim(whole: Component, design: TrimDesign, front: FrontDesign) -> Component:
    """The garment with lines on its fronts; ``design``: as ``GarmentDesign.worn_trim``.

    Raises ``PatternError`` for pin tucks without room.
    """
    if design.tucks:
        fronts = [whole.piece(f"{side}_ftorso") for side in ("right", "left")]
        pockets = [line.start[1] for piece in fronts for line in piece.lines if line.name.startswith("pocket_")]
        lowest = max(pockets, default=0.0) + MARGIN
        for piece in fronts:
            whole = whole.with_piece(_with_tucks(piece, design, stand=front.extension, lowest=lowest))
    if design.buttonholes:
        upper = whole.piece(f"{front.over.value}_ftorso")
        whole = whole.with_piece(_with_placket(upper, design.buttonholes, front))
    return whole


def _with_tucks(piece: Piece, design: TrimDesign, *, stand: float, lowest: float) -> Piece:
    """A front with its tucks, outside the placket of width ``stand`` and above the height ``lowest`` [cm]."""
    (end, _), count = piece.outline.run("shoulder")[0].start, design.tucks or 0
    first = copysign(stand, end)
    places = [first + (number + 1) / count * design.spread * (end - first) for number in range(count)]
    cloth = [_cloth(piece, x) for x in places]
    hem, top = max(low for low, _ in cloth), min(high for _, high in cloth)
    low = max(top - design.length * (top - hem), lowest)
    if top - low < MARGIN:
        raise PatternError(f"panel {piece.name} has {top - low:.1f} cm of room for pin tucks: leave trim.tucks out")
    lines = (
        Stroke((x, high), (x, low), LINE, f"tuck{number}", LineRole.STITCH)
        for number, (x, (_, high)) in enumerate(zip(places, cloth, strict=True))
    )
    return replace(piece, lines=(*piece.lines, *lines))


def _with_placket(piece: Piece, count: int, front: FrontDesign) -> Piece:
    """The upper front with the fold of its placket and with its buttonholes."""
    (centre,) = (line for line in piece.lines if line.name == "centre")
    x, (_, low), (_, high) = centre.start[0], *sorted((centre.start, centre.end), key=lambda end: end[1])
    inwards = copysign(front.extension, piece.outline.run("side")[-1].end[0])
    hem, top = _cloth(piece, x + inwards)
    fold = Stroke((x + inwards, top), (x + inwards, hem), LINE, "placket", LineRole.FOLD)
    closed = 1.0 - front.open_top - front.open_hem
    heights = (high - (front.open_top + (k + 0.5) / count * closed) * (high - low) for k in range(count))
    start, end = (x + share * inwards for share in BUTTONHOLE)
    holes = (Stroke((start, y), (end, y), LINE, f"buttonhole{k}", LineRole.PLACEMENT) for k, y in enumerate(heights))
    return replace(piece, lines=(*piece.lines, fold, *holes))


def _cloth(piece: Piece, x: float) -> tuple[float, float]:
    """The heights between which a line ``x`` cm from the centre lies ``MARGIN`` inside a front, from the hem up."""
    a = piece.outline.points()
    b = np.roll(a, -1, axis=0)
    met = (a[:, 0] <= x) != (b[:, 0] <= x)
    a, b = a[met], b[met]
    heights = np.sort(a[:, 1] + (x - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]))
    return float(heights[0]) + MARGIN, float(heights[1]) - MARGIN


def trim_details(design: TrimDesign) -> tuple[Detail, ...]:
    """Tucks and placket in words; ``design``: as ``GarmentDesign.worn_trim``."""
    details = []
    if design.tucks:
        details.append(Detail(Zone.BODY, (f"{number_word(2 * design.tucks)} pin tucks on the front",)))
    if design.buttonholes:
        details.append(Detail(Zone.BODY, (f"a placket with {number_word(design.buttonholes)} buttonholes",)))
    return tuple(details)
