"""The upper body: a straight or a fitted shirt of two halves, alike or not."""

from gcd_dataset.generator.garments.design import OutfitDesign, Upper
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.upper_half import right_half
from gcd_dataset.generator.pattern import Component, backwards
from gcd_dataset.records import Measurements

__all__ = ["upper", "upper_length"]


def upper(size: Measurements, design: OutfitDesign, *, mends: frozenset[Mend]) -> Component:
    """Two halves sewn at the centres; offers ``bottom`` [ring]."""
    fitted, left_design = design.meta.upper is Upper.FITTED, design.left_half()
    right = right_half(size, *design.right_half(), fitted=fitted, mends=mends)
    other = right if left_design is None else right_half(size, *left_design, fitted=fitted, mends=mends)
    left = other.mirrored("right", "left")
    whole = Component.of(right, left)
    for name in sorted(name for name in right.interfaces if name.endswith("_centre")):
        whole = whole.sewn(right.interface(name), left.interface(name))
    return whole.offering(
        bottom=backwards(right.interface("front_bottom"))
        + left.interface("front_bottom")
        + backwards(left.interface("back_bottom"))
        + right.interface("back_bottom")
    )


def upper_length(size: Measurements, design: OutfitDesign) -> float:
    """From the nape to the hem behind [cm]."""
    length = 1.0 if design.meta.upper is Upper.FITTED else design.shirt.length
    return length * size.waist_line
