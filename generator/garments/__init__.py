"""The wardrobe: what can be designed, what chance designs, and the patterns of designs."""

from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.outfit import outfit
from gcd_dataset.generator.garments.rules import Fitted, Reject, check_outfit, try_on
from gcd_dataset.generator.garments.sampling import (
    Kind,
    design_from_dict,
    design_to_dict,
    sample_design,
    sample_kind,
)

__all__ = [
    "Fitted",
    "Kind",
    "OutfitDesign",
    "Reject",
    "check_outfit",
    "design_from_dict",
    "design_to_dict",
    "outfit",
    "sample_design",
    "sample_kind",
    "try_on",
]
