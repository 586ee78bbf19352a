"""Circle skirts: two sectors of a ring, or halves of a ring cut off centre, ``skirt_front`` and ``skirt_back``."""

from dataclasses import dataclass, replace
from math import hypot, pi, sqrt

from gcd_dataset.curves import Arc
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.panel_skirt import PanelSkirtDesign
from gcd_dataset.generator.garments.ring import sector
from gcd_dataset.generator.garments.skirt import SHORTEST, hem_ring, length_below_waist, waist_ring
from gcd_dataset.generator.garments.space import Design, flag, part, real
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke, cut_end, cut_into, notch
from gcd_dataset.records import Measurements

__all__ = [
    "AsymmetricSkirtDesign",
    "FlareSkirtDesign",
    "HemCutDesign",
    "asymmetric_circle_skirt",
    "circle_skirt",
    "flare_skirt_length",
]

LEAST_HEM = 0.01  # of the hem: a cut that leaves less beside it begins at the side seam, GarmentCode
FRONT, BACK = 15.0, -15.0  # cm before and behind the axis, GarmentCode


@dataclass(frozen=True)
class HemCutDesign(Design):
    """A triangular cut in the hem."""

    add: bool = flag(False, keep=0.6)
    depth: float = real(0.5, 0.05, 0.95, keep=0.6)
    """As a fraction of the skirt's length."""
    width: float = real(0.1, 0.05, 0.4)
    """At the hem, as a fraction of the skirt's length."""
    place: float = real(-0.5, -1.0, 1.0)
    """Fraction of the hem's length at which it is centred: of the front's, from the wearer's right, if positive; else
    of the back's, from her left."""


@dataclass(frozen=True)
class AsymmetricSkirtDesign(Design):
    """A circle skirt cut off centre."""

    front_length: float = real(0.5, 0.1, 0.9, keep=0.5)
    """At the middle of the front, as a fraction of the length behind."""


@dataclass(frozen=True)
class FlareSkirtDesign(Design):
    """A skirt cut from circles of cloth, or of panels that widen downwards."""

    length: float = real(0.2, -0.2, 0.95)
    """Below the hips, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    suns: float = real(0.75, 0.1, 1.95)
    """How many full circles the front and the back together are cut from."""
    skirt_many_panels: PanelSkirtDesign = part(PanelSkirtDesign, key="skirt-many-panels")
    asymm: AsymmetricSkirtDesign = part(AsymmetricSkirtDesign)
    cut: HemCutDesign = part(HemCutDesign)


def circle_skirt(
    size: Measurements, design: FlareSkirtDesign, *, rise: float, length: float, tag: str = ""
) -> Component:
    """Front and back of equal size, ``length`` [cm] from top to hem, at least 5 cm; offers ``top``, ``bottom`` [rings].

    The tops are equal although front and back of the waist are not: their gathers shift the seams to where the
    waist's sides are.
    """
    length = max(length, SHORTEST)
    half = sector("skirt", 0.5 * girth_at_rise(size, rise), pi * design.suns, length)
    return _sewn(size, half, half, design.cut, length, tag)


def asymmetric_circle_skirt(
    size: Measurements, design: FlareSkirtDesign, *, rise: float, length: float, tag: str = ""
) -> Component:
    """A full circle of cloth whose waist is cut off centre, ``length`` [cm] long behind, at least 5 cm.

    Offers ``top`` and ``bottom`` [rings]. Raises ``PatternError`` for a hem cut that opens the waist or a side.
    """
    length = max(length, SHORTEST)
    radius, before = girth_at_rise(size, rise) / (2 * pi), design.asymm.front_length * length
    front, back = _half_ring(radius, before, length), _half_ring(radius, length, before)
    skirt = _sewn(size, front, back, design.cut, length, tag)
    for piece in skirt.pieces if design.cut.add else ():
        _require_uncut_waist(piece, radius)
    return skirt


def flare_skirt_length(size: Measurements, design: FlareSkirtDesign, *, rise: float) -> float:
    """From the top to the hem along the cloth [cm]; behind, where the front is shorter."""
    return max(length_below_waist(size, design.length, rise=rise), SHORTEST)


def _sewn(size: Measurements, front: Piece, back: Piece, cut: HemCutDesign, length: float, tag: str) -> Component:
    """Front and back hung, cut and sewn at the sides."""
    front = replace(front, name=f"skirt_front{tag}").at(0, size.waist_level, FRONT)
    back = replace(back, name=f"skirt_back{tag}").at(0, size.waist_level, BACK)
    if cut.add:
        front, back = _with_hem_cut(front, back, cut, length)
    return (
        Component.of(front, back)
        .sewn(front.along("right"), back.along("right"))
        .sewn(front.along("left"), back.along("left"))
        .offering(top=waist_ring(size, front, back), bottom=hem_ring(front, back))
    )


def _half_ring(radius: float, own: float, other: float) -> Piece:
    """Half of a disk with a round hole off its centre: ``own`` cm of cloth in the middle, ``other`` in the other half.

    Hangs from the origin, the middle between the ends of its ``top``; its sides are named as on a ``band``.
    """
    outer = radius + 0.5 * (own + other)
    centre = 0.5 * (other - own)  # of the disk, over that of the hole
    side = sqrt(outer**2 - centre**2)
    outline = (
        Outline.start(-radius, 0)
        .line(-side, 0, name="right")
        .curve(side, 0, Arc(outer, large=own > other, right=True), name="bottom")
        .line(radius, 0, name="left")
        .curve(-radius, 0, Arc(radius, large=False, right=False), name="top")
    )
    return Piece("skirt", outline)


def _require_uncut_waist(piece: Piece, hole: float) -> None:
    """Raise ``PatternError`` where the tip of a cut lies in the hole of a half ring, or over its sides."""
    for x, y in (stroke.end for stroke in piece.outline.strokes if stroke.name == "hem_cut.0"):
        if y >= 0 or hypot(x, y) <= hole:
            ways = "lower flare-skirt.cut.depth, or raise flare-skirt.asymm.front_length"
            raise PatternError(
                f"{piece.name}: the tip of the hem cut, at ({x:.1f}, {y:.1f}) cm, is off the cloth: {ways}"
            )


def _with_hem_cut(front: Piece, back: Piece, cut: HemCutDesign, length: float) -> tuple[Piece, Piece]:
    """Front and back, the cut in one of them, moved inwards where it would run over the end of the hem."""
    shape = notch(cut.width * length, cut.depth * length, name="hem_cut")
    if cut.place > 0:
        return _with_cut(front, shape, cut.width * length, cut.place), back
    return front, _with_cut(back, shape, cut.width * length, 1 + cut.place)


def _with_cut(piece: Piece, shape: tuple[Stroke, ...], width: float, place: float) -> Piece:
    """The piece with a shape cut into its hem, centred at a fraction of its length from the wearer's right."""
    hem = piece.outline.length("bottom")
    at, least = place * hem, 0.5 * width + LEAST_HEM * hem
    if at < least:
        return replace(piece, outline=cut_end(piece.outline, "bottom", shape, last=False))
    if at > hem - least:
        return replace(piece, outline=cut_end(piece.outline, "bottom", shape, last=True))
    return replace(piece, outline=cut_into(piece.outline, "bottom", shape, at=at))
