"""Circle skirts: two ring sectors, or halves of an off-centre ring. Panels ``skirt_front`` and ``skirt_back``."""

from dataclasses import replace
from math import hypot, pi, sqrt

from gcd_dataset.curves import Arc
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Description, Detail, Place, Setting
from gcd_dataset.generator.garments.flare_skirt import (
    FlareSkirtDesign,
    HemCutDesign,
    flare_nouns,
    flare_skirt_length,
    flare_tag,
)
from gcd_dataset.generator.garments.garment import Cutting, SimpleBottom
from gcd_dataset.generator.garments.panel_shapes import sector
from gcd_dataset.generator.garments.skirt import SHORTEST, hem_ring, waist_ring
from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke, cut_end, cut_into, notch
from gcd_dataset.records import Measurements

LEAST_HEM = 0.01  # share of the hem: a cut with less hem beside it moves to the side seam, GarmentCode
VISIBLE_CUT = 3.0  # cm: descriptions leave out a shallower cut
CUT_SIDES = ((0.4, "right"), (0.6, "middle"))  # largest share of the hem, from the wearer's right, of each name
CUT_REMEDIES = ("cut.depth-", "cut.width-", "cut.place")
FRONT, BACK = 15.0, -15.0  # cm: z of front and back before sewing, GarmentCode


def circle_skirt(size: Measurements, design: FlareSkirtDesign, cutting: Cutting) -> Component:
    """Front and back of equal size, at least 5 cm long; offers the rings ``top`` and ``bottom``.

    Both tops have the same length although the front and the back of the waist differ: gathers shift the side seams to
    the sides of the waist.
    """
    length = max(cutting.length, SHORTEST)
    half = sector("skirt", 0.5 * girth_at_rise(size, cutting.rise), pi * design.suns, length)
    return _sewn(size, half, half, design.cut, length, cutting.suffix)


def asymmetric_circle_skirt(size: Measurements, design: FlareSkirtDesign, cutting: Cutting) -> Component:
    """A full circle of cloth with the waist cut off centre; the back is ``cutting.length`` long, at least 5 cm.

    Offers the rings ``top`` and ``bottom``. Raises ``PatternError`` for a hem cut into the waist or a side.
    """
    length = max(cutting.length, SHORTEST)
    radius, front_length = girth_at_rise(size, cutting.rise) / (2 * pi), design.asymm.front_length * length
    front, back = _half_ring(radius, front_length, length), _half_ring(radius, length, front_length)
    skirt = _sewn(size, front, back, design.cut, length, cutting.suffix)
    for piece in skirt.pieces if design.cut.add else ():
        _require_uncut_waist(piece, radius)
    return skirt


def _sewn(size: Measurements, front: Piece, back: Piece, cut: HemCutDesign, length: float, suffix: str) -> Component:
    """Front and back, placed, with their hem cut, and sewn at the sides."""
    front = replace(front, name=f"skirt_front{suffix}").at(0, size.waist_level, FRONT)
    back = replace(back, name=f"skirt_back{suffix}").at(0, size.waist_level, BACK)
    if cut.add:
        front, back = _with_hem_cut(front, back, cut, length)
    return (
        Component.of(front, back)
        .sewn(front.along("right"), back.along("right"))
        .sewn(front.along("left"), back.along("left"))
        .offering(top=waist_ring(size, front, back), bottom=hem_ring(front, back))
    )


def _half_ring(radius: float, near: float, far: float) -> Piece:
    """Half of a disk with a round hole off its centre.

    ``near`` and ``far``: width of the ring in the middle of this half and of the other half [cm].
    The origin is the middle between the ends of its ``top``. Edges are named as in ``band``.
    """
    outer = radius + 0.5 * (near + far)
    centre = 0.5 * (far - near)  # height of the disk's centre over the hole's centre
    side = sqrt(outer**2 - centre**2)
    outline = (
        Outline.start(-radius, 0)
        .line(-side, 0, name="right")
        .curve(side, 0, Arc(outer, large=near > far, right=True), name="bottom")
        .line(radius, 0, name="left")
        .curve(-radius, 0, Arc(radius, large=False, right=False), name="top")
    )
    return Piece("skirt", outline)


def _require_uncut_waist(piece: Piece, hole: float) -> None:
    """Raise ``PatternError`` for a cut whose tip lies in the hole of a half ring, or over its sides."""
    for x, y in (stroke.end for stroke in piece.outline.strokes if stroke.name == "hem_cut.0"):
        if y >= 0 or hypot(x, y) <= hole:
            remedy = "lower flare-skirt.cut.depth, or raise flare-skirt.asymm.front_length"
            raise PatternError(
                f"{piece.name}: the tip of the hem cut, at ({x:.1f}, {y:.1f}) cm, is off the cloth: {remedy}"
            )


def _with_hem_cut(front: Piece, back: Piece, cut: HemCutDesign, length: float) -> tuple[Piece, Piece]:
    """Front and back with the cut in one of them, moved inwards if it would run over the end of the hem."""
    shape = notch(cut.width * length, cut.depth * length, name="hem_cut")
    if cut.place > 0:
        return _with_cut(front, shape, cut.width * length, cut.place), back
    return front, _with_cut(back, shape, cut.width * length, 1 + cut.place)


def _with_cut(piece: Piece, shape: tuple[Stroke, ...], width: float, share: float) -> Piece:
    """The piece with a shape cut into its hem, centred at a share of the hem's length from the wearer's right."""
    hem = piece.outline.length("bottom")
    at, least = share * hem, 0.5 * width + LEAST_HEM * hem
    if at < least:
        return replace(piece, outline=cut_end(piece.outline, "bottom", shape, last=False))
    if at > hem - least:
        return replace(piece, outline=cut_end(piece.outline, "bottom", shape, last=True))
    return replace(piece, outline=cut_into(piece.outline, "bottom", shape, at=at))


def _uncut(design: FlareSkirtDesign) -> FlareSkirtDesign:
    return replace(design, cut=replace(design.cut, add=False))


def _describe(setting: Setting, design: FlareSkirtDesign) -> Description:
    cut = _cut_details(setting, design)
    return Description(flare_nouns(design), (), cut, tags=(flare_tag(design), *_cut_tags(cut)))


def _describe_asymmetric(setting: Setting, design: FlareSkirtDesign) -> Description:
    nouns = ("off-centre circle skirt", "circle skirt cut off centre")
    hem = ("a hem that is longer behind than in front", "a high-low hem")
    cut = _cut_details(setting, design)
    tags = (Tag.CIRCLE, Tag.ASYMMETRIC, *_cut_tags(cut))
    return Description(nouns, (), (Detail(Place.HEM, hem, main=True), *cut), tags=tags)


def _cut_details(setting: Setting, design: FlareSkirtDesign) -> tuple[Detail, ...]:
    """The hem cut, unless it is too shallow to see."""
    length = max(flare_skirt_length(setting.size, design, setting.rise), SHORTEST)
    if not design.cut.add or design.cut.depth * length < VISIBLE_CUT:
        return ()
    where = "front" if design.cut.place > 0 else "back"
    share = design.cut.place if design.cut.place > 0 else 1 + design.cut.place  # from the wearer's right
    side = next((name for most, name in CUT_SIDES if share <= most), "left")
    deep = "deep " if design.cut.depth > 0.5 else ""
    at = f"in the middle of the {where} hem" if side == "middle" else f"on the {side} of the {where} hem"
    words = (f"a {deep}triangular notch {at}", f"a {deep}V-shaped cut {at}")
    return (Detail(Place.HEM, words, main=True, sided=side != "middle"),)


def _cut_tags(cut: tuple[Detail, ...]) -> tuple[Tag, ...]:
    return (Tag.SLIT,) if cut else ()


CIRCLE_SKIRT = SimpleBottom(
    name="SkirtCircle",
    section="flare-skirt",
    design=FlareSkirtDesign,
    cut=circle_skirt,
    length_of=flare_skirt_length,
    description_of=_describe,
    without_slits=_uncut,
    flared=True,
    fullness_parameter="suns",
    always_sewable=lambda design: not design.cut.add,
    remedies=CUT_REMEDIES,
)

ASYMMETRIC_CIRCLE_SKIRT = SimpleBottom(
    name="AsymmSkirtCircle",
    section="flare-skirt",
    design=FlareSkirtDesign,
    cut=asymmetric_circle_skirt,
    length_of=flare_skirt_length,
    description_of=_describe_asymmetric,
    without_slits=_uncut,
    flared=True,
    remedies=CUT_REMEDIES,
)
