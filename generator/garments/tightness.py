"""Rings of cloth round the body, and how far each must stretch.

A ring is a closed line of cloth: a seam or hem round the trunk, a skirt's cloth round both legs, the end of a sleeve or
of a trouser leg. The parts of a garment hang one under the other: a band under a long shirt is worn at the hips,
although it is drawn for the waist.

Cloth is also a load that hangs from shoulder seams or rests on the hips. Both limits depend on a fabric's tensile
stiffness over its density alone. The default fabric has the largest ratio that the drape simulates, so the figures hold
for every fabric.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import nan, pi
from typing import NamedTuple

from gcd_dataset.generator.garments.assembly import bottom_rise, parts
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.garment import Ring
from gcd_dataset.generator.garments.sewable import girth_of_cloth
from gcd_dataset.generator.garments.trunk import girth_at_rise, girth_below_waist
from gcd_dataset.generator.garments.upper import Shirt
from gcd_dataset.generator.garments.waistband import band_rise
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Closure, Measurements

# Of 52 draped shirts the hem hung 3.0 cm lower than drawn, quartiles 1.4 and 4.5: cloth gives under its weight, and
# the shoulders of a shirt are wider than the wearer's. Of 16 fitted shirts, 0.5 cm.
SHIRT_SINKS = 3.0  # cm
WIDER_WAIST = "lower waistband.width, or widen the part below"
LARGER = "choose a larger size"
WIDER_HEM = "raise waistband.waist or shirt.flare, or shorten shirt.length"


def rings(size: Measurements, design: GarmentDesign, wearer: Measurements | None = None) -> Iterator[Ring]:
    """The rings round the trunk, and the rings of the bottom: see ``BottomGarment.rings``.

    ``wearer``: measures of the body inside the rings of a garment cut for ``size``; default: ``size``.
    """
    yield from trunk_rings(size, design, wearer)
    if design.meta.bottom is not None:
        yield from design.meta.bottom.garment.rings(size, design, bottom_rise(design), wearer)


def trunk_rings(size: Measurements, design: GarmentDesign, wearer: Measurements | None = None) -> Iterator[Ring]:
    """The seams between the parts, a straight shirt at the hips, and the hem of a garment without a bottom.

    On another ``wearer`` also the rings that fit the body of ``size`` by construction: see ``_fitted_rings``. A shirt
    with an open front makes no ring but the seam to a bottom: it opens the waistband.
    """
    body = wearer or size
    hung = _hung(size, design, body)
    is_open = design.front.closure is Closure.OPEN and bool(design.halves())
    for (above, hem), (below, _) in list(pairwise(hung))[is_open and design.opens_band() :]:
        cloth = min(above.length("bottom"), below.length("top"))
        yield Ring("a waist seam", cloth, girth_below_waist(body, hem), WIDER_WAIST)
    if wearer is not None:
        yield from _fitted_rings(size, design, wearer, hung[0][0])
    if is_open:
        return  # the front gives way
    yield from _shirt_over_hips(size, design, hung[0][1], body)
    last, hem = hung[-1]
    if design.meta.bottom is None and "bottom" in last.interfaces:
        yield Ring("a hem", last.length("bottom"), girth_below_waist(body, hem), WIDER_HEM)


def _fitted_rings(size: Measurements, design: GarmentDesign, wearer: Measurements, first: Component) -> Iterator[Ring]:
    """A shirt at the bust, the top of a bottom without upper, trousers at the hips; ``first``: the uppermost part."""
    upper = design.meta.upper.garment if design.meta.upper else None
    if isinstance(upper, Shirt) and design.front.closure is not Closure.OPEN:
        widths = [1.0 if upper.fitted else half[0].width for half in design.halves()]
        yield Ring("a shirt at the bust", size.bust * sum(widths) / len(widths), wearer.bust, LARGER)
    if upper is None and "top" in first.interfaces:
        yield Ring("a top edge", first.length("top"), girth_below_waist(wearer, _top_depth(wearer, design)), LARGER)
    if design.meta.bottom is not None and design.meta.bottom.garment.legs:
        yield Ring("trousers at the hips", size.hips, wearer.hips, LARGER)


def _shirt_over_hips(size: Measurements, design: GarmentDesign, hem: float, wearer: Measurements) -> Iterator[Ring]:
    """The cloth of a straight shirt at the wearer's hips, if its hem hangs lower, ``hem`` cm below the waist."""
    garment = design.meta.upper.garment if design.meta.upper else None
    if not isinstance(garment, Shirt) or garment.fitted or hem <= wearer.hips_line:
        return
    # Of the side, from the shoulder down.
    share = (wearer.waist_line + wearer.hips_line) / (wearer.waist_line + hem)
    halves = [half[0] for half in design.halves()]
    widths = [0.5 * size.bust * half.width * (1.0 + share * (half.flare - 1.0)) for half in halves]
    cloth = sum(widths) * (2 / len(widths))
    yield Ring("a shirt", cloth, wearer.hips, WIDER_HEM)


def _hung(size: Measurements, design: GarmentDesign, wearer: Measurements) -> list[tuple[Component, float]]:
    """The parts from the top down, with the depth of their lower ends below the wearer's waist [cm].

    Each part is hung under the part above it; the first hangs where it is drawn.
    A bottom has depth NaN: no ring depends on the depth of its hem.
    """
    meta = design.meta
    if meta.upper:
        hem = meta.upper.garment.length(size, design) - wearer.waist_line
        depths = [0.0, hem if meta.upper.garment.at_waist else hem + SHIRT_SINKS]
    else:
        depths = [_top_depth(wearer, design)]
    if meta.wb:
        depths.append(depths[-1] + design.waistband.width * size.hips_line)
    if meta.bottom:
        depths.append(nan)
    return list(zip(parts(size, design), depths[1:], strict=True))


def _top_depth(wearer: Measurements, design: GarmentDesign) -> float:
    """Depth of the top of a garment without upper below the waist [cm]."""
    rise = bottom_rise(design)
    top = band_rise(design.waistband, rise) + design.waistband.width if design.meta.wb else rise
    return (1 - top) * wearer.hips_line


GRAVITY = 9.81  # m/s²
STIFFNESS = 500.0  # N·m/kg: tensile stiffness over density of the default fabric, ``drape.fabrics.STIFFEST``
FRICTION = 0.5  # Coulomb coefficient of cloth against skin, as in ``Fabric``
M2 = 1e-4  # m² per cm²
STRAPS_GIVE = 1.4  # largest stretch at shoulder seams: a panel of a clean garment is stretched by 1.5 at most
# Of the flared skirts alone and strapless dresses among 1,000 sampled garments, all eight that slid off carried more
# than this height of cloth holds.
GRIP = 0.5  # height of the cloth that grips the hips, as a share of waist to hips
STRAPLESS_RISE = 0.6  # lowest place of a strapless dress's waist seam, as a rise: 8 cm lower its top bares the breasts
SHOULDERS = frozenset({"shoulder", "left_shoulder"})


class HipLoad(NamedTuple):
    """The cloth of a garment that hangs from the hips, and the most that they hold [m²]."""

    cloth: float
    held: float

    @property
    def slides(self) -> bool:
        """Whether the hips hold less than hangs from them."""
        return self.cloth > self.held


def strap_stretch(size: Measurements, design: GarmentDesign) -> float:
    """Stretch of the cloth at the shoulder seams under the weight of the garment; 1 for one without shoulder seams.

    A strap of width w [m] that carries an area A [m²] is stretched by A · density · g / (w · stiffness). All seams
    share the weight, and none rests on the hips: the worst case. Raises ``PatternError`` as ``parts``.
    """
    drawn = parts(size, design)
    # All shoulder edges of the upper: twice its shoulder seams.
    width = sum(edge.length for piece in drawn[0].pieces for edge in piece.outline.strokes if edge.name in SHOULDERS)
    return 1.0 + _area(drawn) * GRAVITY / (STIFFNESS * 0.01 * width) if width else 1.0


def hip_load(size: Measurements, design: GarmentDesign) -> HipLoad | None:
    """The load on the hips of a flared skirt that does not hang from shoulders; ``None`` for any other garment.

    Trousers hang from the crotch; pencil and gathered skirts touch the hips all round, and did not slide.

    A ring of cloth with a rest length of L that slides to the hips is stretched by e = hips / L - 1. A cloth h high,
    ``GRIP`` of waist to hips, pulls with T = stiffness · h · e and presses on the hips with 2π T in all, of which
    friction holds 2π μ T. The hips' girth is that of the cloth round them, ``girth_of_cloth``. A strapless dress must
    be held above the hips, at ``STRAPLESS_RISE``.
    Raises ``PatternError`` as ``parts``.
    """
    bottom = design.meta.bottom
    if bottom is None or not _is_off_shoulders(design):
        return None
    if not any(part.flared for part in (bottom.garment, *bottom.garment.parts(design))):
        return None
    drawn = parts(size, design)
    tops = [part.length("top") for part in drawn if "top" in part.interfaces]
    hems = [part.length("bottom") for part in drawn[:-1] if "bottom" in part.interfaces]
    held_at = girth_at_rise(size, STRAPLESS_RISE) if design.meta.upper else size.hips
    stretch = max(girth_of_cloth(held_at) / min(tops + hems) - 1.0, 0.0)
    grip = 0.01 * GRIP * size.hips_line  # m
    return HipLoad(_area(drawn), 2 * pi * FRICTION * STIFFNESS * grip * stretch / GRAVITY)


def _is_off_shoulders(design: GarmentDesign) -> bool:
    """Whether no part of the garment hangs from a shoulder."""
    upper = design.meta.upper
    if upper is None:
        return True
    garment = upper.garment
    halves = design.halves()
    return isinstance(garment, Shirt) and garment.fitted and bool(halves) and all(half[0].strapless for half in halves)


def _area(drawn: tuple[Component, ...]) -> float:
    """Area of the cloth [m²]."""
    return M2 * sum(abs(piece.outline.area) for part in drawn for piece in part.pieces)
