"""Rings of cloth round the body, and how far each must stretch.

A ring is a closed line of cloth: a seam or hem round the trunk, a skirt's cloth round both legs, the end of a sleeve or
of a trouser leg. The parts of an outfit hang one under the other: a band under a long shirt is worn at the hips,
although it is drawn for the waist.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import nan
from typing import NamedTuple

from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.garment import Ring
from gcd_dataset.generator.garments.outfit import bottom_rise, parts
from gcd_dataset.generator.garments.trunk import girth_below_waist
from gcd_dataset.generator.garments.upper import Shirt
from gcd_dataset.generator.garments.waistband import band_rise
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements

# Of 52 draped shirts the hem hung 3.0 cm lower than drawn, quartiles 1.4 and 4.5: cloth gives under its weight, and
# the shoulders of a shirt are wider than the wearer's. Of 16 fitted shirts, 0.5 cm.
SHIRT_SINKS = 3.0  # cm
WIDER_WAIST = "lower waistband.width, or widen the part below"
WIDER_HEM = "raise waistband.waist or shirt.flare, or shorten shirt.length"


class _Hung(NamedTuple):
    """A part of an outfit, and the depth of its lower end below the waist [cm]."""

    part: Component
    bottom: float


def tightest_ring(size: Measurements, design: GarmentDesign) -> Ring | None:
    """The ring that has to stretch most; ``None`` for an outfit without rings. Raises ``PatternError`` as ``parts``."""
    return max(rings(size, design), key=lambda ring: ring.stretch, default=None)


def rings(size: Measurements, design: GarmentDesign) -> Iterator[Ring]:
    """The rings round the trunk, and the rings of the bottom: see ``BottomGarment.rings``."""
    yield from trunk_rings(size, design)
    if design.meta.bottom is not None:
        yield from design.meta.bottom.garment.rings(size, design, bottom_rise(design))


def trunk_rings(size: Measurements, design: GarmentDesign) -> Iterator[Ring]:
    """The seams between the parts, a straight shirt at the hips, and the hem of an outfit without a bottom."""
    hung = _hung(size, design)
    for above, below in pairwise(hung):
        cloth = min(above.part.length("bottom"), below.part.length("top"))
        yield Ring("a waist seam", cloth, girth_below_waist(size, above.bottom), WIDER_WAIST)
    yield from _shirt_over_hips(size, design, hung[0].bottom)
    last = hung[-1]
    if design.meta.bottom is None and "bottom" in last.part.interfaces:
        yield Ring("a hem", last.part.length("bottom"), girth_below_waist(size, last.bottom), WIDER_HEM)


def _shirt_over_hips(size: Measurements, design: GarmentDesign, hem: float) -> Iterator[Ring]:
    """The cloth of a straight shirt at the hips, if its hem hangs lower, ``hem`` cm below the waist."""
    garment = design.meta.upper.garment if design.meta.upper else None
    if not isinstance(garment, Shirt) or garment.fitted or hem <= size.hips_line:
        return
    share = (size.waist_line + size.hips_line) / (size.waist_line + hem)  # of the side, from the shoulder down
    halves = [half[0] for half in design.halves()]
    widths = [0.5 * size.bust * half.width * (1.0 + share * (half.flare - 1.0)) for half in halves]
    cloth = sum(widths) * (2 / len(widths))
    yield Ring("a shirt", cloth, size.hips, WIDER_HEM)


def _hung(size: Measurements, design: GarmentDesign) -> tuple[_Hung, ...]:
    """The parts from the top down, each hung under the part above it; the first hangs where it is drawn.

    A bottom has depth NaN: no ring depends on the depth of its hem.
    """
    meta, rise = design.meta, bottom_rise(design)
    if meta.upper:
        hem = meta.upper.garment.length(size, design) - size.waist_line
        depths = [0.0, hem if meta.upper.garment.at_waist else hem + SHIRT_SINKS]
    else:
        top = band_rise(design.waistband, rise) + design.waistband.width if meta.wb else rise
        depths = [(1 - top) * size.hips_line]
    if meta.wb:
        depths.append(depths[-1] + design.waistband.width * size.hips_line)
    if meta.bottom:
        depths.append(nan)
    return tuple(_Hung(part, bottom) for part, bottom in zip(parts(size, design), depths[1:], strict=True))
