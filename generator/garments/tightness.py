"""Rings of cloth that must stretch to go round the body inside them.

A ring is a closed line of cloth: a seam or hem round the trunk, a skirt's cloth round both legs, the end of a sleeve or
of a trouser leg. The parts of an outfit hang one under the other, so a band under a long shirt is worn at the hips
although it was drawn for the waist.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.garment import Ring
from gcd_dataset.generator.garments.outfit import bottom_rise, parts
from gcd_dataset.generator.garments.trunk import girth_below_waist
from gcd_dataset.generator.garments.waistband import band_rise
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements

__all__ = ["rings", "tightest_ring"]


class _Hung(NamedTuple):
    """A part of an outfit with the depth of its ends below the waist [cm]."""

    part: Component
    top: float
    bottom: float


def tightest_ring(size: Measurements, design: OutfitDesign) -> Ring | None:
    """The ring that has to stretch most; ``None`` for an outfit without rings. Raises ``PatternError`` as ``parts``."""
    return max(rings(size, design), key=lambda ring: ring.stretch, default=None)


def rings(size: Measurements, design: OutfitDesign) -> Iterator[Ring]:
    """The rings round the trunk, and those that the records of the garments name."""
    hung = _hung(size, design)
    for above, below in pairwise(hung):
        cloth = min(above.part.length("bottom"), below.part.length("top"))
        yield Ring("a waist seam", cloth, girth_below_waist(size, above.bottom), "widen the part below it")
    last = hung[-1]
    bottom = design.meta.bottom
    if bottom is not None:
        yield from bottom.garment.rings(size, design, bottom_rise(design))
    elif "bottom" in last.part.interfaces:
        remedy = "widen waistband.waist or shirt.flare, or shorten shirt.length"
        yield Ring("a hem", last.part.length("bottom"), girth_below_waist(size, last.bottom), remedy)


def _hung(size: Measurements, design: OutfitDesign) -> tuple[_Hung, ...]:
    """The parts from the top down; without an upper the first begins where it was drawn, else under the upper."""
    meta, rise = design.meta, bottom_rise(design)
    band = design.waistband.width * size.hips_line if meta.wb else 0.0
    depth = 0.0
    hung = []
    for number, part in enumerate(parts(size, design)):
        if number == 0 and meta.upper:
            depth = meta.upper.garment.length(size, design) - size.waist_line
            hung.append(_Hung(part, 0.0, depth))
            continue
        if number == 0:
            top_rise = band_rise(design.waistband, rise) + design.waistband.width if meta.wb else rise
            depth = (1 - top_rise) * size.hips_line
        hung.append(_Hung(part, depth, depth + band))
        depth, band = depth + band, 0.0
    return tuple(hung)
