"""The wardrobe: what can be designed, what chance designs, and the patterns of designs."""

from gcd_dataset.generator.garments.outfit import OutfitDesign, outfit
from gcd_dataset.generator.garments.rules import Reject, check_outfit
from gcd_dataset.generator.garments.sampling import design_from_dict, design_to_dict, sample_design

__all__ = ["OutfitDesign", "Reject", "check_outfit", "design_from_dict", "design_to_dict", "outfit", "sample_design"]
