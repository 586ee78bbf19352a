"""Trousers: panels ``pant_f_r``, ``pant_b_r`` and their mirror images, with or without cuffs.

A leg panel is drawn from the outer end of its hem up the side seam, over the hip to the waist, across to the centre,
down into the crotch and back along the inside leg.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot

import numpy as np

from gcd_dataset.curves import LINE, Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.cuff import Cuff, PantsCuffDesign, cuff, cuff_words, skirt_share
from gcd_dataset.generator.garments.description import UNGATHERED, Description, Detail, Setting, Tag, Zone
from gcd_dataset.generator.garments.garment import BottomGarment, Ring
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.skirt import length_below_waist
from gcd_dataset.generator.garments.space import Design, part, real
from gcd_dataset.generator.garments.trunk import (
    Quarter,
    back_quarter,
    drawn_rise,
    front_quarter,
    waist_front,
)
from gcd_dataset.generator.pattern import Component, Outline, Piece, backwards, cut_into, dart, tangent_quadratic
from gcd_dataset.records import Measurements

CROTCH_EASE = 5.0  # cm added to thigh girth minus half the hips, GarmentCode
FRONT_CROTCH = 0.25  # extent of the front's crotch beyond the centre, as a fraction of the front's hip, GarmentCode
BACK_RAISE = 1.1  # height from hips to waist at the back over the height at the front, GarmentCode
CENTRE_STRAIGHT = 0.45  # of hips to waist: height at which the centre seam begins to curve into the crotch, GarmentCode
INSIDE_DROP = 1.5  # highest position of the hem's inner end, in crotch heights below the hips, GarmentCode
INSIDE_SHIFT = 2.0  # cm across from the crotch to the inner end of a straight leg's hem, GarmentCode
HEM_FULLNESS, INSIDE_FULLNESS = 0.75, 0.3  # bend of side seam and inside leg, of their chords, GarmentCode
DART_DEPTH = 0.8  # dart leg over hips to waist, GarmentCode
SHORTEST_LEG = 0.2  # least length of the leg without its cuff, as a fraction of hips to floor, GarmentCode
CENTRE_GAP, FRONT, BACK = 0.5, 25.0, -20.0  # cm from the axis: crotch, front panel, back panel; GarmentCode
WIDE_LEG, FLARED_LEG, TAPERED_LEG = 1.3, 1.07, 0.88  # limits of ``width`` and of ``flare`` for words
CUFF_GAP = 5.0  # cm between leg and cuff before sewing, GarmentCode
LEG_LEVELS = (0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9, 1.0)  # heights as fractions of the crotch's height
LEG_GIRTHS = (0.40, 0.49, 0.61, 0.65, 0.71, 0.83, 0.94, 1.0)  # over leg_circ: means of this package's bodies, ± 0.05
UP: Point = (0.0, 1.0)
DOWN: Point = (0.0, -1.0)
INWARDS: Point = (1.0, 0.0)


@dataclass(frozen=True)
class PantsDesign(Design):
    """Trousers from the hips or the waist."""

    length: float = real(0.3, 0.2, 0.9)
    """Depth of the hem below the hips as worn, with or without a waistband, as a fraction of hips to floor;
    cuffs included."""
    width: float = real(1.0, 1.0, 1.5, keep=0.5)
    """Width of the crotch, as a fraction of the smallest possible width."""
    flare: float = real(1.0, 0.5, 1.2, keep=0.3)
    """Girth of the hem over a straight leg's; each of the four hem ends moves by a quarter of the change."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    cuff: PantsCuffDesign = part(PantsCuffDesign)


def pants(size: Measurements, design: PantsDesign, *, rise: float, mends: frozenset[Mend] = ALL_MENDS) -> Component:
    """Two legs sewn at the crotch; offers the ring ``top``."""
    right = _leg(size, design, rise, mends)
    left = right.mirrored("_r", "_l")
    return (
        Component.of(right, left)
        .sewn(right.interface("front_crotch"), left.interface("front_crotch"))
        .sewn(right.interface("back_crotch"), left.interface("back_crotch"))
        .offering(
            top=right.interface("front_top")
            + backwards(left.interface("front_top"))
            + left.interface("back_top")
            + backwards(right.interface("back_top"))
        )
    )


def cuff_and_leg_girth(size: Measurements, design: PantsDesign, rise: float) -> tuple[float, float]:
    """Girth of a leg's cuff, and largest girth of the leg inside its band or skirt's top [cm]; 0 without a cuff."""
    if design.cuff.type is None:
        return 0.0, 0.0
    length = _cuff_length(size, design)
    gathers = design.cuff.top_ruffle / (design.cuff.skirt_ruffle if design.cuff.type is Cuff.SKIRT else 1.0)
    girth = _hem_girth(size, design, rise, design.length * size.leg_length - length) / max(gathers, 1.0)
    skirt = skirt_share(design.cuff)
    hem, crotch = (1 - design.length) * size.leg_length, size.leg_length - size.crotch_hip_diff
    levels = np.linspace(hem + skirt * length, hem + length, 9) / crotch
    return girth, float(np.interp(levels, LEG_LEVELS, LEG_GIRTHS).max()) * size.leg_circ


def _leg(size: Measurements, design: PantsDesign, rise: float, mends: frozenset[Mend]) -> Component:
    """The right leg; offers the edges that meet the left leg or the waistband."""
    top = drawn_rise(size, rise)
    below_hips = length_below_waist(size, design.length, rise=rise - top) - _cuff_length(size, design)
    ahead, behind = _quarters(size, design, top, mends)
    front = _panel("pant_f_r", size, design, ahead, below_hips).moved((0, 0, FRONT))
    back = _panel("pant_b_r", size, design, behind, below_hips).moved((0, 0, BACK))
    leg = (
        Component.of(front, back)
        .sewn(front.along("outside", "hip"), back.along("outside") + back.along("hip", ruffle=BACK_RAISE))
        .sewn(front.along("inside"), back.along("inside"))
        .offering(
            front_top=front.along("top", ruffle=ahead.waist / (0.5 * waist_front(size))),
            back_top=back.along("top", ruffle=behind.waist / (0.5 * size.waist_back_width)),
            front_crotch=front.along("centre", "crotch"),
            back_crotch=back.along("centre", "crotch"),
            hem=front.against("hem") + back.along("hem"),
        )
    )
    for piece, quarter in ((front, ahead), (back, behind)):
        for sewn in quarter.darts:
            leg = leg.sewn(piece.along(f"{sewn.name}.0"), piece.against(f"{sewn.name}.1"))
    return leg if design.cuff.type is None else _with_cuff(size, design, leg, design.cuff.type)


def _with_cuff(size: Measurements, design: PantsDesign, leg: Component, kind: Cuff) -> Component:
    """The right leg and its cuff, placed under the inner end of the hem."""
    girth = leg.length("hem") / design.cuff.top_ruffle
    placed = cuff("pant_r", girth, _cuff_length(size, design), kind, design.cuff)
    placed = placed.placed_by("top", leg, "hem", gap=CUFF_GAP)
    inwards = leg.points("hem")[:, 0].max() - placed.points("top")[:, 0].max()
    placed = placed.moved((float(inwards), 0, 0))
    sewn = Component.of(leg, placed).sewn(leg.interface("hem"), placed.interface("top"), gathered=True)
    return sewn.offering(**{name: edges for name, edges in leg.interfaces.items() if name != "hem"})


def _cuff_length(size: Measurements, design: PantsDesign) -> float:
    """Length by which the cuff shortens the leg [cm]; 0 without a cuff."""
    if design.cuff.type is None:
        return 0.0
    return min(design.cuff.cuff_len, design.length - SHORTEST_LEG) * size.leg_length


def _quarters(
    size: Measurements, design: PantsDesign, rise: float, mends: frozenset[Mend] = ALL_MENDS
) -> tuple[Quarter, Quarter]:
    """Front and back of one leg.

    Raises ``PatternError`` for legs so thin relative to the hips that no crotch is left for the back.
    """
    front = front_quarter(size, rise, mends, leg=DART_DEPTH)
    front = front._replace(crotch=FRONT_CROTCH * front.hips)
    crotch = design.width * (size.leg_circ - 0.5 * size.hips + CROTCH_EASE) - front.crotch
    if crotch <= 0:
        raise PatternError(
            f"trousers: legs of {size.leg_circ:.1f} cm and hips of {size.hips:.1f} cm leave {crotch:.1f} cm of crotch "
            "to the back: raise pants.width"
        )
    leg = DART_DEPTH * (BACK_RAISE * rise * size.hips_line)
    return front, back_quarter(size, rise, mends, raise_=BACK_RAISE, leg=leg)._replace(crotch=crotch)


def _panel(name: str, size: Measurements, design: PantsDesign, quarter: Quarter, leg: float) -> Piece:
    """The front or the back of the right leg, its crotch beside the wearer's axis and its waist at the rise."""
    outline = _outline(size, design, quarter, leg)
    for drawn in quarter.darts:
        at = quarter.hips - quarter.lean - drawn.from_centre
        outline = cut_into(outline, "top", dart(drawn.width, drawn.leg, name=drawn.name), at=at)
    crotch_level = size.waist_level - quarter.height - size.crotch_hip_diff
    x, y = outline.edge("crotch").end
    return Piece(name, outline).at(-CENTRE_GAP - x, crotch_level - y, 0)


def _outline(size: Measurements, design: PantsDesign, quarter: Quarter, leg: float) -> Outline:
    """The panel without darts; the hem of a straight leg begins at the origin, the hips are ``leg`` cm above."""
    waist, fork = leg + quarter.height, (quarter.hips + quarter.crotch, leg - size.crotch_hip_diff)
    hip, side = (0.0, leg), (quarter.lean, waist)
    centre = (quarter.hips, leg + CENTRE_STRAIGHT * quarter.height)
    hem, inside = _hem(size, design, quarter, leg)
    flare = -hem[0]
    down_inside = (flare, inside[1] - fork[1])
    side_seam = LINE if flare == 0 else tangent_quadratic(hem, hip, end_tangent=UP, at=HEM_FULLNESS)
    return (
        Outline.start(*hem)
        .curve(*hip, side_seam, name="outside")
        .curve(*side, tangent_quadratic(hip, side, start_tangent=UP), name="hip")
        .line(quarter.hips, waist, name="top")
        .line(*centre, name="centre")
        .curve(*fork, tangent_quadratic(centre, fork, start_tangent=DOWN, end_tangent=INWARDS), name="crotch")
        .curve(*inside, tangent_quadratic(fork, inside, end_tangent=down_inside, at=INSIDE_FULLNESS), name="inside")
        .close(name="hem")
    )


def _hem(size: Measurements, design: PantsDesign, quarter: Quarter, leg: float) -> tuple[Point, Point]:
    """The outer and the inner end of a panel's hem."""
    flare = 0.25 * size.leg_circ * (design.flare - 1)
    inner = quarter.hips + quarter.crotch - INSIDE_SHIFT + flare
    return (-flare, 0.0), (inner, min(0.0, leg - INSIDE_DROP * size.crotch_hip_diff))


def _hem_girth(size: Measurements, design: PantsDesign, rise: float, leg: float) -> float:
    """Girth of a leg's hem, ``leg`` cm below the hips [cm]."""
    ends = (_hem(size, design, quarter, leg) for quarter in _quarters(size, design, rise))
    return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in ends)


def _rings(size: Measurements, design: PantsDesign, rise: float, wearer: Measurements) -> Iterator[Ring]:
    """The ring of a leg's hem; none for a leg with a cuff."""
    if design.cuff.type is not None:
        return
    crotch = wearer.leg_length - wearer.crotch_hip_diff
    hem_level = (1 - design.length * (size.leg_length / wearer.leg_length)) * wearer.leg_length
    leg = float(np.interp(min(hem_level / crotch, 1.0), LEG_LEVELS, LEG_GIRTHS)) * wearer.leg_circ
    hem = _hem_girth(size, design, rise, design.length * size.leg_length)
    yield Ring("a trouser leg", hem, leg, "raise pants.flare")


def _describe(setting: Setting, design: PantsDesign) -> Description:
    """Trousers; ``captions`` calls short ones shorts."""
    if design.width >= WIDE_LEG:
        traits = (("wide-leg",),)
    elif design.flare > FLARED_LEG:
        traits = (("flared",),)
    else:
        traits = (("tapered",),) if design.flare < TAPERED_LEG else (("straight-leg",),)
    if design.cuff.type is None:
        return Description(("trousers",), traits, tags=(Tag.TROUSERS,))
    gathers = setting.cuffs.get("right", UNGATHERED)
    words = cuff_words(design.cuff.type, _cuff_length(setting.size, design), gathers, limb="leg")
    return Description(("trousers",), traits, (Detail(Zone.HEM, words, main=True),), tags=(Tag.TROUSERS, Tag.CUFFS))


PANTS = BottomGarment(
    name="Pants",
    section="pants",
    design=PantsDesign,
    mends=frozenset({Mend.FOLDED_DART}),
    cut=lambda size, design, cutting: pants(size, design, rise=cutting.rise, mends=cutting.mends),
    length_of=lambda size, design, rise: length_below_waist(size, design.length, rise=rise),
    description_of=_describe,
    legs=True,
    rings_of=lambda size, design, rise, length, wearer: _rings(size, design, rise, wearer),
    cuffs=cuff_and_leg_girth,
    widened_by="flare",
    remedies=("cuff.top_ruffle-", "flare+", "cuff.cuff_len", "cuff.skirt_flare-"),
    always_sewable=lambda design: design.cuff.type is None,
)
