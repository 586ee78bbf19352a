"""Rings of cloth round the body, and how far each must stretch.

A ring is a closed line of cloth: a seam or hem round the trunk, a skirt's cloth round both legs, the end of a sleeve or
of a trouser leg. The parts of an outfit hang one under the other: a band under a long shirt is worn at the hips,
although it is drawn for the waist.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import nan
from typing import NamedTuple

from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.garment import Ring
from gcd_dataset.generator.garments.outfit import bottom_rise, parts
from gcd_dataset.generator.garments.trunk import girth_below_waist
from gcd_dataset.generator.garments.waistband import band_rise
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements

__all__ = ["rings", "tightest_ring"]


WIDER_WAIST = "lower waistband.width, or widen the part below"
WIDER_HEM = "raise waistband.waist or shirt.flare, or shorten shirt.length"


class _Hung(NamedTuple):
    """A part of an outfit, and the depth of its lower end below the waist [cm]."""

    part: Component
    bottom: float


def tightest_ring(size: Measurements, design: OutfitDesign) -> Ring | None:
    """The ring that has to stretch most; ``None`` for an outfit without rings. Raises ``PatternError`` as ``parts``."""
    return max(rings(size, design), key=lambda ring: ring.stretch, default=None)


def rings(size: Measurements, design: OutfitDesign) -> Iterator[Ring]:
    """The rings round the trunk, and the rings of the bottom: see ``BottomGarment.rings``."""
    hung, bottom = _hung(size, design), design.meta.bottom
    for above, below in pairwise(hung):
        cloth = min(above.part.length("bottom"), below.part.length("top"))
        yield Ring("a waist seam", cloth, girth_below_waist(size, above.bottom), WIDER_WAIST)
    last = hung[-1]
    if bottom is not None:
        yield from bottom.garment.rings(size, design, bottom_rise(design))
    elif "bottom" in last.part.interfaces:
        yield Ring("a hem", last.part.length("bottom"), girth_below_waist(size, last.bottom), WIDER_HEM)


def _hung(size: Measurements, design: OutfitDesign) -> tuple[_Hung, ...]:
    """The parts from the top down, each hung under the part above it; the first hangs where it is drawn.

    A bottom has depth NaN: no ring depends on the depth of its hem.
    """
    meta, rise = design.meta, bottom_rise(design)
    if meta.upper:
        depths = [0.0, meta.upper.garment.length(size, design) - size.waist_line]
    else:
        top = band_rise(design.waistband, rise) + design.waistband.width if meta.wb else rise
        depths = [(1 - top) * size.hips_line]
    if meta.wb:
        depths.append(depths[-1] + design.waistband.width * size.hips_line)
    if meta.bottom:
        depths.append(nan)
    return tuple(_Hung(part, bottom) for part, bottom in zip(parts(size, design), depths[1:], strict=True))
