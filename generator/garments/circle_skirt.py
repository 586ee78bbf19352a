"""Flared skirts: of one circle, level or tilted, and of many panels; they share their section of a design."""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import atan, atan2, cos, degrees, hypot, pi, sin, sqrt, tan

from gcd_dataset.curves import Arc
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Description, Detail, Setting, Tag, Zone, number_word
from gcd_dataset.generator.garments.garment import BottomGarment, Cutting
from gcd_dataset.generator.garments.skirt import (
    SHORTEST,
    across,
    hem_ring,
    sector,
    sewn_at_sides,
    skirt_length,
    skirt_panel,
    waist_ring,
)
from gcd_dataset.generator.garments.space import Design, choice, flag, integer, part, real
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke, cut_end, cut_into, notch
from gcd_dataset.records import Measurements

VERY_FULL = 1.5  # suns
CIRCLES = ((0.375, Tag.A_LINE), (0.75, Tag.HALF_CIRCLE))  # upper bounds of a skirt's suns


@dataclass(frozen=True)
class PanelSkirtDesign(Design):
    """The division of a flared skirt into panels."""

    n_panels: int = integer(4, 4, 15)
    """Number of equal panels round the body."""
    panel_curve: float = choice(0, -0.35, -0.25, -0.15, 0, 0.15, 0.25, 0.35, 0.45)
    """Bulge of each panel's hem: sagitta over chord, positive outwards."""


@dataclass(frozen=True)
class HemCutDesign(Design):
    """A triangular cut in the hem."""

    add: bool = flag(False, keep=0.6)
    """Whether the hem of a circle skirt has the cut."""
    depth: float = real(0.5, 0.05, 0.95, keep=0.6)
    """Depth of the cut, as a fraction of the skirt's length."""
    width: float = real(0.1, 0.05, 0.4)
    """Width of the cut at the hem, as a fraction of the skirt's length."""
    place: float = real(-0.5, -1.0, 1.0)
    """Centre of the cut: if positive, in the front, as a fraction of its hem from the wearer's right; if negative, in
    the back, as a fraction of its hem from the wearer's left."""


@dataclass(frozen=True)
class AsymmetricSkirtDesign(Design):
    """A circle skirt with its waist cut off centre."""

    front_length: float = real(0.5, 0.1, 0.9, keep=0.5)
    """Length at the middle of the front, as a fraction of the length behind."""


@dataclass(frozen=True)
class FlareSkirtDesign(Design):
    """A skirt cut from circles of cloth, or of panels that widen downwards."""

    length: float = real(0.2, -0.2, 0.95)
    """Depth of the hem below the hips as worn, with or without a waistband, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    suns: float = real(0.75, 0.1, 1.95)
    """Number of full circles that front and back together are cut from."""
    skirt_many_panels: PanelSkirtDesign = part(PanelSkirtDesign, key="skirt-many-panels")
    asymm: AsymmetricSkirtDesign = part(AsymmetricSkirtDesign)
    cut: HemCutDesign = part(HemCutDesign)


def flare_tag(design: FlareSkirtDesign) -> Tag:
    """The tag of a flared skirt by its share of a circle."""
    return next((tag for most, tag in CIRCLES if design.suns < most), Tag.CIRCLE)


def flare_nouns(design: FlareSkirtDesign) -> tuple[str, ...]:
    """Names of a flared skirt by its share of a circle: the tag, and for over a circle and a half its fullness."""
    tag = flare_tag(design)
    if tag is Tag.A_LINE:
        return ("A-line skirt",)
    return ("very full circle skirt",) if design.suns >= VERY_FULL else (tag.value,)


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
        shape = notch(cut.width * length, cut.depth * length, name="hem_cut")
        if cut.place > 0:
            front = _with_cut(front, shape, cut.width * length, cut.place)
        else:
            back = _with_cut(back, shape, cut.width * length, 1 + cut.place)
    return sewn_at_sides(front, back).offering(top=waist_ring(size, front, back), bottom=hem_ring(front, back))


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


def _with_cut(piece: Piece, shape: tuple[Stroke, ...], width: float, share: float) -> Piece:
    """The piece with a shape cut into its hem, centred at a share of the hem from the wearer's right.

    A cut that would run over the end of the hem is moved inwards.
    """
    hem = piece.outline.length("bottom")
    at, least = share * hem, 0.5 * width + LEAST_HEM * hem
    if at < least:
        return replace(piece, outline=cut_end(piece.outline, "bottom", shape, last=False))
    if at > hem - least:
        return replace(piece, outline=cut_end(piece.outline, "bottom", shape, last=True))
    return replace(piece, outline=cut_into(piece.outline, "bottom", shape, at=at))


def _describe_circle(setting: Setting, design: FlareSkirtDesign) -> Description:
    cut = _cut_details(setting, design)
    return Description(flare_nouns(design), (), cut, tags=(flare_tag(design), *([Tag.SLIT] if cut else [])))


def _describe_asymmetric(setting: Setting, design: FlareSkirtDesign) -> Description:
    nouns = ("off-centre circle skirt", "circle skirt cut off centre")
    hem = ("a hem that is longer behind than in front", "a high-low hem")
    cut = _cut_details(setting, design)
    tags = (Tag.CIRCLE, Tag.ASYMMETRIC, *([Tag.SLIT] if cut else []))
    return Description(nouns, (), (Detail(Zone.HEM, hem, main=True), *cut), tags=tags)


def _cut_details(setting: Setting, design: FlareSkirtDesign) -> tuple[Detail, ...]:
    """The hem cut, unless it is too shallow to see."""
    length = skirt_length(setting.size, design, setting.rise)
    if not design.cut.add or design.cut.depth * length < VISIBLE_CUT:
        return ()
    where = "front" if design.cut.place > 0 else "back"
    share = design.cut.place if design.cut.place > 0 else 1 + design.cut.place  # from the wearer's right
    side = next((name for most, name in CUT_SIDES if share <= most), "left")
    deep = "deep " if design.cut.depth > 0.5 else ""
    at = f"in the middle of the {where} hem" if side == "middle" else f"on the {side} of the {where} hem"
    words = (f"a {deep}triangular notch {at}", f"a {deep}V-shaped cut {at}")
    return (Detail(Zone.HEM, words, main=True, sided=side != "middle"),)


CIRCLE_SKIRT = BottomGarment(
    name="SkirtCircle",
    section="flare-skirt",
    design=FlareSkirtDesign,
    cut=circle_skirt,
    length_of=skirt_length,
    description_of=_describe_circle,
    without_slits=lambda design: replace(design, cut=replace(design.cut, add=False)),
    flared=True,
    fullness_parameter="suns",
    always_sewable=lambda design: not design.cut.add,
    remedies=CUT_REMEDIES,
)

ASYMMETRIC_CIRCLE_SKIRT = replace(
    CIRCLE_SKIRT,
    name="AsymmSkirtCircle",
    cut=asymmetric_circle_skirt,
    description_of=_describe_asymmetric,
    fullness_parameter="",
    always_sewable=lambda design: False,
)


def panel_skirt(size: Measurements, design: FlareSkirtDesign, cutting: Cutting) -> Component:
    """Panels sewn to a ring, each at least 5 cm high; ``suns`` sets the length of all hems as for a circle skirt.

    Offers the ring ``top``.
    """
    count = design.skirt_many_panels.n_panels
    length, share = max(cutting.length, SHORTEST), 1 / count
    top, flare = share * girth_at_rise(size, cutting.rise), share * pi * design.suns * length
    panel = _with_bent_hem(skirt_panel("skirt_panel", top, length, flare=flare), design.skirt_many_panels.panel_curve)
    panels = [
        _placed_in_ring(replace(panel, name=f"skirt_panel_{index}"), index, count).moved((0, size.waist_level, 0))
        for index in range(count)
    ]
    skirt = Component.of(*panels)
    for before, after in pairwise((*panels, panels[0])):
        skirt = skirt.sewn(before.against("left"), after.along("right"))
    return skirt.offering(top=tuple(section for panel in panels for section in across(panel, "top")))


def _with_bent_hem(panel: Piece, bulge: float) -> Piece:
    """The panel with an arc as its hem; ``bulge`` is sagitta over chord, positive outwards.

    Raises ``PatternError`` for a hem that bends inwards over the sides or the top.
    """
    if not bulge:
        return panel
    hem, side = panel.outline.edge("bottom"), panel.outline.edge("right").chord
    chord, bend, corner = abs(hem.chord[0]), 2 * atan(2 * abs(bulge)), atan2(side[1], side[0])
    if bulge < 0 and (bend >= corner or -bulge * chord >= side[1]):
        figures = f"bends inwards by {degrees(bend):.0f} degrees between sides that stand at {degrees(corner):.0f}"
        raise PatternError(f"the hem of a skirt panel {figures}: raise flare-skirt.skirt-many-panels.panel_curve")
    radius = (1 + 4 * bulge**2) / (8 * abs(bulge)) * chord
    arc = Arc(radius, large=False, right=bulge < 0)  # the hem is drawn from left to right of the wearer
    return replace(panel, outline=panel.outline.with_strokes((hem,), (replace(hem, curve=arc),)))


def _placed_in_ring(panel: Piece, index: int, count: int) -> Piece:
    """The upright panel at its place in a ring, which begins at the wearer's right and continues over the front.

    As in GarmentCode: the ring's radius is the inradius of a regular polygon of the hems; the right corner of a panel's
    top lies on the ring, and the panel's middle faces outwards.
    """
    away = panel.outline.length("bottom") / (2 * tan(pi / count))
    half = 0.5 * panel.outline.length("top")
    facing, turn = atan2(-away, half), 2 * pi * index / count
    x, z = half * cos(facing) - away, -half * sin(facing)
    around = (x * cos(turn) + z * sin(turn), z * cos(turn) - x * sin(turn))
    return replace(panel.at(around[0], 0, around[1]), rotation=(0, facing + turn, 0))


def _describe_panels(setting: Setting, design: FlareSkirtDesign) -> Description:
    count, curve = number_word(design.skirt_many_panels.n_panels), design.skirt_many_panels.panel_curve
    (noun,) = flare_nouns(design)
    details = [Detail(Zone.LOWER, ("seams from top to hem between the panels",))]
    if curve:
        words = ("a scalloped hem",) if curve > 0 else ("a hem arched upwards on each panel",)
        details.append(Detail(Zone.HEM, words, main=True))
    nouns = (f"{count}-panel {noun}", f"{noun} of {count} panels")
    return Description(nouns, (), tuple(details), tags=(Tag.PANELLED, flare_tag(design)))


PANEL_SKIRT = BottomGarment(
    name="SkirtManyPanels",
    section="flare-skirt",
    design=FlareSkirtDesign,
    cut=panel_skirt,
    length_of=skirt_length,
    description_of=_describe_panels,
    flared=True,
    fullness_parameter="suns",
    remedies=("skirt-many-panels.panel_curve", "suns+"),
)
