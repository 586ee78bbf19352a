"""The design of an outfit: all its parameters, in the order and under the names of GarmentCode's design files."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import TypeAlias

from gcd_dataset.generator.garments.circle_skirt import FlareSkirtDesign
from gcd_dataset.generator.garments.gathered_skirt import GatheredSkirtDesign
from gcd_dataset.generator.garments.godet_skirt import GodetSkirtDesign
from gcd_dataset.generator.garments.levels_skirt import LevelsSkirtDesign
from gcd_dataset.generator.garments.neckline import LeftNecklineDesign, NecklineDesign
from gcd_dataset.generator.garments.pants import PantsDesign
from gcd_dataset.generator.garments.pencil_skirt import PencilSkirtDesign
from gcd_dataset.generator.garments.shirt import LeftShirtDesign, ShirtDesign
from gcd_dataset.generator.garments.sleeve import LeftSleeveDesign, SleeveDesign
from gcd_dataset.generator.garments.space import Design, choice, flag, part
from gcd_dataset.generator.garments.waistband import Waistband, WaistbandDesign

__all__ = ["T_SHIRT", "Bottom", "LeftDesign", "MetaDesign", "OutfitDesign", "Upper", "UpperHalf"]


class Upper(Enum):
    """What there is for the upper body."""

    FITTED = "FittedShirt"
    SHIRT = "Shirt"


class Bottom(Enum):
    """What there is for the lower body."""

    CIRCLE = "SkirtCircle"
    ASYMMETRIC_CIRCLE = "AsymmSkirtCircle"
    GODET = "GodetSkirt"
    PANTS = "Pants"
    GATHERED = "Skirt2"
    PANELS = "SkirtManyPanels"
    PENCIL = "PencilSkirt"
    LEVELS = "SkirtLevels"


UpperHalf: TypeAlias = tuple[ShirtDesign, NecklineDesign, SleeveDesign]
"""What one half of the upper body is drawn from."""


@dataclass(frozen=True)
class MetaDesign(Design):
    """Which parts the outfit has."""

    upper: Upper | None = choice(None, *Upper, None, keep=0.3)
    wb: Waistband | None = choice(None, *Waistband, None, keep=0.5)
    bottom: Bottom | None = choice(None, *Bottom, None, keep=0.3)


@dataclass(frozen=True)
class LeftDesign(Design):
    """The left half of the upper body, where it is not the mirror image of the right one."""

    enable_asym: bool = flag(False, keep=0.8)
    shirt: LeftShirtDesign = part(LeftShirtDesign)
    collar: LeftNecklineDesign = part(LeftNecklineDesign)
    sleeve: LeftSleeveDesign = part(LeftSleeveDesign)


@dataclass(frozen=True)
class OutfitDesign(Design):
    """A design without a body: what is not a choice is a fraction of a measure, an angle, or centimetres."""

    meta: MetaDesign = part(MetaDesign)
    waistband: WaistbandDesign = part(WaistbandDesign)
    shirt: ShirtDesign = part(ShirtDesign)
    collar: NecklineDesign = part(NecklineDesign)
    sleeve: SleeveDesign = part(SleeveDesign)
    left: LeftDesign = part(LeftDesign)
    skirt: GatheredSkirtDesign = part(GatheredSkirtDesign)
    flare_skirt: FlareSkirtDesign = part(FlareSkirtDesign, key="flare-skirt")
    godet_skirt: GodetSkirtDesign = part(GodetSkirtDesign, key="godet-skirt")
    pencil_skirt: PencilSkirtDesign = part(PencilSkirtDesign, key="pencil-skirt")
    levels_skirt: LevelsSkirtDesign = part(LevelsSkirtDesign, key="levels-skirt")
    pants: PantsDesign = part(PantsDesign)

    def right_half(self) -> UpperHalf:
        """What the right half of the upper body is drawn from; it has a collar only if the left one is its image."""
        if not self.left.enable_asym:
            return self.shirt, self.collar, self.sleeve
        bare = replace(self.collar, component=replace(self.collar.component, style=None))
        return self.shirt, bare, self.sleeve

    def left_half(self) -> UpperHalf | None:
        """What the left half is drawn from; ``None`` for the mirror image of the right one."""
        if not self.left.enable_asym:
            return None
        return self.left.shirt.beside(self.shirt), self.left.collar.beside(self.collar), self.left.sleeve


T_SHIRT = OutfitDesign(meta=MetaDesign(upper=Upper.SHIRT), sleeve=SleeveDesign(sleeveless=False))
"""GarmentCode's other default."""
