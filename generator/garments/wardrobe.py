"""The wardrobe: all uppers and bottoms, one line each."""

from typing import Any

from gcd_dataset.generator.garments.capes import CAPE, PONCHO
from gcd_dataset.generator.garments.circle_skirt import ASYMMETRIC_CIRCLE_SKIRT, CIRCLE_SKIRT, PANEL_SKIRT
from gcd_dataset.generator.garments.garment import BottomGarment, Garment, GarmentChoice, UpperGarment
from gcd_dataset.generator.garments.gathered_skirt import GATHERED_SKIRT
from gcd_dataset.generator.garments.godet_skirt import GODET_SKIRT
from gcd_dataset.generator.garments.levels_skirt import LEVELS_SKIRT
from gcd_dataset.generator.garments.pants import PANTS
from gcd_dataset.generator.garments.pencil_skirt import PENCIL_SKIRT
from gcd_dataset.generator.garments.pleated_skirt import PLEATED_SKIRT
from gcd_dataset.generator.garments.upper import FITTED_SHIRT, STRAIGHT_SHIRT


class Upper(GarmentChoice):
    """Garments for the upper body."""

    garment: UpperGarment[Any]

    FITTED = FITTED_SHIRT
    SHIRT = STRAIGHT_SHIRT
    CAPE = CAPE
    PONCHO = PONCHO


class Bottom(GarmentChoice):
    """Garments for the lower body."""

    garment: BottomGarment[Any]

    CIRCLE = CIRCLE_SKIRT
    ASYMMETRIC_CIRCLE = ASYMMETRIC_CIRCLE_SKIRT
    GODET = GODET_SKIRT
    PANTS = PANTS
    GATHERED = GATHERED_SKIRT
    PANELS = PANEL_SKIRT
    PENCIL = PENCIL_SKIRT
    LEVELS = LEVELS_SKIRT
    PLEATED = PLEATED_SKIRT


GARMENTS: tuple[Garment[Any], ...] = tuple(member.garment for kind in (Upper, Bottom) for member in kind)
"""All records, in the order of the members."""
