"""Designs by chance, drawn so that hardly any has to be turned down.

What a design may not do to a usual body is kept out where the parameter is drawn; ``rules.py`` catches the rest, on
the body that is really dressed.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np

from gcd_dataset.generator.garments.circle_skirt import CircleSkirtDesign
from gcd_dataset.generator.garments.neckline import Neckline, NecklineDesign
from gcd_dataset.generator.garments.outfit import Bottom, MetaDesign, OutfitDesign, Upper
from gcd_dataset.generator.garments.rules import LIGHT_LENGTH, LIGHT_SUNS, has_firm_band
from gcd_dataset.generator.garments.shirt import ShirtDesign
from gcd_dataset.generator.garments.sleeve import SleeveDesign
from gcd_dataset.generator.garments.space import draw, from_dict, to_dict
from gcd_dataset.generator.garments.waistband import WaistbandDesign

__all__ = ["design_from_dict", "design_to_dict", "draw_neckline", "sample_design"]

OUTFITS = (
    (Upper.SHIRT, None),
    (None, Bottom.CIRCLE_SKIRT),
    (Upper.SHIRT, Bottom.CIRCLE_SKIRT),
)  # a third each, as in the paper

# Nape to waist, waist to hips and hips to floor as fractions of nape to floor, of bodies with a long trunk.
NAPE_TO_WAIST, WAIST_TO_HIPS = 0.27, 0.18
HIPS_TO_FLOOR = 1 - NAPE_TO_WAIST - WAIST_TO_HIPS

# Of bodies with narrow shoulders over a wide chest, as fractions of shoulder to bust.
NECK, SHOULDERS, CHEST, NAPE_TO_WAIST_OVER_BUST, CENTIMETRE = 0.85, 1.45, 1.25, 1.6, 0.05
SHOULDER_SLOPE = 0.43
WIDE_OPEN = SHOULDERS - 2 * CENTIMETRE

JOINED_SHIRT = (0.8, 1.3)  # shirt.length at which a band or skirt is sewn on: near the waist, where it is as wide
SNUG_BAND = (1.0, 1.1)  # waistband.waist that hips hold up without a shirt
SHORT_SLEEVE = (0.1, 0.5)  # sleeve.length
ARMHOLE = (0.0, 0.5)  # sleeve.connecting_width: deeper ones reach the hem of a short shirt


def sample_design(rng: np.random.Generator) -> OutfitDesign:
    """A random outfit that most bodies can wear."""
    upper, bottom = OUTFITS[int(rng.integers(len(OUTFITS)))]
    meta = MetaDesign(upper, draw(MetaDesign, rng).wb, bottom)
    waistband = draw(WaistbandDesign, rng, within={} if upper else {"waist": SNUG_BAND})
    shirt = draw(ShirtDesign, rng, within={"length": JOINED_SHIRT} if bottom or meta.wb else {})
    collar = draw_neckline(rng, shirt)
    sleeve = draw(SleeveDesign, rng, within={"length": SHORT_SLEEVE, "connecting_width": ARMHOLE})
    chosen = OutfitDesign(meta, waistband, shirt, collar, sleeve)
    return replace(chosen, flare_skirt=draw(CircleSkirtDesign, rng, within=_skirt(chosen)))


def design_to_dict(design: OutfitDesign) -> dict[str, Any]:
    """The design as nested plain values, under GarmentCode's names."""
    return to_dict(design)


def design_from_dict(values: Mapping[str, Any]) -> OutfitDesign:
    """The design of nested plain values; what is not named keeps its default.

    Raises ``ConfigError`` with the path of a name that no parameter has, or of a value that it cannot take.

    >>> design_from_dict({"meta": {"upper": None, "bottom": "SkirtCircle"}, "flare-skirt": {"suns": 1}}).meta.bottom
    <Bottom.CIRCLE_SKIRT: 'SkirtCircle'>
    """
    return from_dict(OutfitDesign, values)


def _skirt(design: OutfitDesign) -> dict[str, tuple[float, float]]:
    """The lengths and widths of skirt that stay above the floor and on the body, under the rest of the outfit."""
    above = design.shirt.length if design.meta.upper else 1.0
    band = design.waistband.width if design.meta.wb else 0.0
    longest = (1 - above * NAPE_TO_WAIST - (band + 1) * WAIST_TO_HIPS) / HIPS_TO_FLOOR
    if design.meta.upper or has_firm_band(design):
        return {"length": (-np.inf, longest)}
    return {"length": (-np.inf, min(longest, LIGHT_LENGTH)), "suns": (-np.inf, LIGHT_SUNS)}


def draw_neckline(rng: np.random.Generator, shirt: ShirtDesign) -> NecklineDesign:
    """A random neckline that leaves a shoulder and does not run into the armhole of the shirt."""
    end = _shoulder_end(shirt) - CENTIMETRE
    neck = draw(NecklineDesign, rng, within={"width": (-np.inf, _width(2 * end - CENTIMETRE))})
    half = 0.5 * (NECK * (1 + neck.width) if neck.width < 0 else NECK + neck.width * (WIDE_OPEN - NECK))
    # A round neckline of depth d bulges to (h² + d²) / 2d from the centre: to the shoulder's end at the deepest.
    deepest = end + sqrt(max(end**2 - half**2, 0.0)) - SHOULDER_SLOPE * (CHEST * shirt.width - half)
    kinds = {"fc_depth": neck.f_collar, "bc_depth": neck.b_collar}
    round_ones = {name: (-np.inf, deepest) for name, kind in kinds.items() if kind is Neckline.CIRCLE}
    depths = draw(NecklineDesign, rng, within=round_ones)
    return replace(neck, fc_depth=depths.fc_depth, bc_depth=depths.bc_depth)


def _width(opening: float) -> float:
    """The ``NecklineDesign.width`` of an opening, given as a fraction of shoulder to bust."""
    return opening / NECK - 1 if opening < NECK else (opening - NECK) / (WIDE_OPEN - NECK)


def _shoulder_end(shirt: ShirtDesign) -> float:
    """From the centre to the armhole's upper end: flared sides draw it inwards."""
    chest = CHEST * shirt.width
    lean = chest * max(shirt.flare - 1, 0.0) / (shirt.length * NAPE_TO_WAIST_OVER_BUST)
    return 0.5 * SHOULDERS - SHOULDER_SLOPE * (chest - 0.5 * SHOULDERS) * lean
