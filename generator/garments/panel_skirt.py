"""The panelled skirt (GarmentCode's ``SkirtManyPanels``): panels ``skirt_panel_0``, … round the body."""

from dataclasses import replace
from itertools import pairwise
from math import atan, atan2, cos, degrees, pi, sin, tan

from gcd_dataset.curves import Arc
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Description, Detail, Place, Setting, number_word
from gcd_dataset.generator.garments.flare_skirt import FlareSkirtDesign, flare_nouns, flare_skirt_length, flare_tag
from gcd_dataset.generator.garments.garment import Cutting, SimpleBottom
from gcd_dataset.generator.garments.panel_shapes import skirt_panel
from gcd_dataset.generator.garments.skirt import SHORTEST, across
from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.pattern import Component, Piece
from gcd_dataset.records import Measurements


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


def _describe(setting: Setting, design: FlareSkirtDesign) -> Description:
    count, curve = number_word(design.skirt_many_panels.n_panels), design.skirt_many_panels.panel_curve
    (noun,) = flare_nouns(design)
    details = [Detail(Place.LOWER, ("seams from top to hem between the panels",))]
    if curve:
        words = ("a scalloped hem",) if curve > 0 else ("a hem arched upwards on each panel",)
        details.append(Detail(Place.HEM, words, main=True))
    nouns = (f"{count}-panel {noun}", f"{noun} of {count} panels")
    return Description(nouns, (), tuple(details), tags=(Tag.PANELLED, flare_tag(design)))


PANEL_SKIRT = SimpleBottom(
    name="SkirtManyPanels",
    section="flare-skirt",
    design=FlareSkirtDesign,
    cut=panel_skirt,
    length_of=flare_skirt_length,
    description_of=_describe,
    flared=True,
    fullness_parameter="suns",
    remedies=("skirt-many-panels.panel_curve", "suns+"),
)
