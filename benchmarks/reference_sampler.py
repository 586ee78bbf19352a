"""GarmentCode's sampler, reimplemented from its rules: distributions and reject tests.

Each parameter is drawn independently; a design that fails a test is redrawn as a whole. Patterns are ours, with
GarmentCode's faults left in.
"""

from collections.abc import Sequence

import numpy as np

from gcd_dataset.errors import PatternError
from gcd_dataset.faults import Rule, check_pattern
from gcd_dataset.generator.garments import draw_garment
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.rules import LIGHT_LENGTH, LIGHT_SUNS, garment_length, is_flared, is_gathered
from gcd_dataset.generator.garments.space import DesignSpace, draw
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.records import Measurements

SPACE = DesignSpace.declared(GarmentDesign)
FLOOR_SLACK = 1.0  # cm by which a garment may be longer than from the neck to the floor
THIN_BAND = 0.25


def reference_design(rng: np.random.Generator) -> GarmentDesign:
    """A design drawn like GarmentCode's, before any test."""
    return draw(SPACE, rng)


def reject_reason(design: GarmentDesign, sizes: Sequence[Measurements]) -> str:
    """The first test of GarmentCode's sampler that a design fails; empty if it is accepted."""
    if design.meta.upper is None and design.meta.bottom is None:
        return "empty"
    if _slides(design):
        return "ruffles on a loose belt"
    if _is_heavy(design):
        return "heavy flare"
    return next((reason for size in sizes if (reason := _unfit(design, size))), "")


def _slides(design: GarmentDesign) -> bool:
    loose = design.meta.wb is None or design.waistband.waist > 1
    return design.meta.upper is None and is_gathered(design) and design.skirt.ruffle > 1 and loose


def _is_heavy(design: GarmentDesign) -> bool:
    band = design.waistband
    thin = design.meta.wb is None or band.waist > 1 or band.width <= THIN_BAND
    levels = design.meta.bottom is Bottom.LEVELS
    length = design.levels_skirt.length if levels else design.flare_skirt.length
    heavy = length > LIGHT_LENGTH or design.flare_skirt.suns > LIGHT_SUNS
    return design.meta.upper is None and is_flared(design) and thin and heavy


def _unfit(design: GarmentDesign, size: Measurements) -> str:
    if garment_length(size, design, frozenset()) > size.height - size.head_l + FLOOR_SLACK:
        return "too long"
    try:
        faults = check_pattern(draw_garment(size, design, mends=frozenset()))
    except PatternError:
        return "cannot be drawn"
    return "crosses itself" if any(fault.rule is Rule.SELF_CROSSING for fault in faults) else ""
