"""Uppers: straight and fitted shirts, sewn of two halves, and their records."""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from gcd_dataset.generator.garments.description import Description, Setting
from gcd_dataset.generator.garments.garment import UpperGarment
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.shirt import ShirtDesign, UpperHalf, right_half
from gcd_dataset.generator.garments.shirt_words import describe_shirt
from gcd_dataset.generator.pattern import (
    Component,
    backwards,
)
from gcd_dataset.records import Measurements

if TYPE_CHECKING:
    from gcd_dataset.generator.garments.design import GarmentDesign


def shirt(size: Measurements, design: "GarmentDesign", *, fitted: bool, mends: frozenset[Mend]) -> Component:
    """Two halves sewn at the centres; offers the ring ``bottom``."""
    return _sewn_halves(size, design.right_half(), design.left_half(), fitted=fitted, mends=mends)


@lru_cache(maxsize=8)  # designs that differ in waistband or bottom have the same shirt
def _sewn_halves(
    size: Measurements, right_design: UpperHalf, left_design: UpperHalf | None, *, fitted: bool, mends: frozenset[Mend]
) -> Component:
    """The shirt of two halves; ``left_design``: ``None`` for the mirror image of the right one."""
    right = right_half(size, *right_design, fitted=fitted, mends=mends)
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


@dataclass(frozen=True, kw_only=True)
class Shirt(UpperGarment[ShirtDesign]):
    """A shirt; its neckline, sleeves and differing left half have sections of their own."""

    section: str = "shirt"
    design: type[ShirtDesign] = ShirtDesign
    mends: frozenset[Mend] = frozenset({Mend.SLEEVE_START, Mend.ARMHOLE_ROOM, Mend.SLEEVE_SURPLUS})
    fitted: bool
    """Whether darts fit the shirt to bust and waist; a fitted shirt ends at the waist."""

    def draw(self, size: Measurements, design: "GarmentDesign", *, mends: frozenset[Mend]) -> Component:
        return shirt(size, design, fitted=self.fitted, mends=mends)

    def length(self, size: Measurements, design: "GarmentDesign") -> float:
        return size.waist_line if self.at_waist else self.section_design(design).length * size.waist_line

    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        return describe_shirt(setting, design.halves(), fitted=self.fitted)

    def sections_used(self, design: "GarmentDesign") -> tuple[str, ...]:
        left = design.left_half() is not None
        return ("shirt", "collar", "sleeve") + (("left",) if left else ())


FITTED_SHIRT = Shirt(name="FittedShirt", fitted=True, at_waist=True, mends=Shirt.mends | {Mend.FOLDED_DART})
STRAIGHT_SHIRT = Shirt(name="Shirt", fitted=False)
