"""The design of an outfit: all its parameters, in the order and under the names of GarmentCode's design files."""

from dataclasses import dataclass, replace
from typing import Any

from gcd_dataset.generator.garments.circle_skirt import CIRCLE_SKIRT
from gcd_dataset.generator.garments.flare_skirt import FlareSkirtDesign
from gcd_dataset.generator.garments.garment import Garment, one_of, section_of
from gcd_dataset.generator.garments.gathered_skirt import GATHERED_SKIRT, GatheredSkirtDesign
from gcd_dataset.generator.garments.godet_skirt import GODET_SKIRT, GodetSkirtDesign
from gcd_dataset.generator.garments.levels_skirt import LEVELS_SKIRT, LevelsSkirtDesign
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.neckline import LeftNecklineDesign, NecklineDesign
from gcd_dataset.generator.garments.pants import PANTS, PantsDesign
from gcd_dataset.generator.garments.pencil_skirt import PENCIL_SKIRT, PencilSkirtDesign
from gcd_dataset.generator.garments.shirt import LeftShirtDesign, ShirtDesign
from gcd_dataset.generator.garments.sleeve import LeftSleeveDesign, SleeveDesign
from gcd_dataset.generator.garments.space import Design, choice, flag, part, with_parts
from gcd_dataset.generator.garments.upper import STRAIGHT_SHIRT, Shirt
from gcd_dataset.generator.garments.upper_half import UpperHalf
from gcd_dataset.generator.garments.waistband import Waistband, WaistbandDesign
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Bottom, Upper


@dataclass(frozen=True)
class MetaDesign(Design):
    """The parts of the outfit: upper, waistband, bottom."""

    upper: Upper | None = one_of(Upper, keep=0.3)
    wb: Waistband | None = choice(None, *Waistband, None, keep=0.5)
    bottom: Bottom | None = one_of(Bottom, keep=0.3)


@dataclass(frozen=True)
class LeftDesign(Design):
    """The left half of the upper body, if it is not the mirror image of the right one."""

    enable_asym: bool = flag(False, keep=0.8)
    shirt: LeftShirtDesign = part(LeftShirtDesign)
    collar: LeftNecklineDesign = part(LeftNecklineDesign)
    sleeve: LeftSleeveDesign = part(LeftSleeveDesign)


@dataclass(frozen=True)
@with_parts({garment.section: garment.design for garment in GARMENTS})
class OutfitDesign(Design):
    """A design independent of the body: each parameter is a choice, a fraction of a measure, an angle, or a length.

    The fields are the sections of GarmentCode's designs, followed by the sections of garments that GarmentCode lacks.
    ``garment.section_design(design)`` is the section of a garment.
    """

    meta: MetaDesign = part(MetaDesign)
    waistband: WaistbandDesign = part(WaistbandDesign)
    shirt: ShirtDesign = section_of(STRAIGHT_SHIRT)
    collar: NecklineDesign = part(NecklineDesign)
    sleeve: SleeveDesign = part(SleeveDesign)
    left: LeftDesign = part(LeftDesign)
    skirt: GatheredSkirtDesign = section_of(GATHERED_SKIRT)
    flare_skirt: FlareSkirtDesign = section_of(CIRCLE_SKIRT)
    godet_skirt: GodetSkirtDesign = section_of(GODET_SKIRT)
    pencil_skirt: PencilSkirtDesign = section_of(PENCIL_SKIRT)
    levels_skirt: LevelsSkirtDesign = section_of(LEVELS_SKIRT)
    pants: PantsDesign = section_of(PANTS)

    def sections_used(self) -> frozenset[str]:
        """The names of the fields that the outfit is drawn from."""
        meta, used = self.meta, {"meta"}
        if meta.wb:
            used.add("waistband")
        if meta.upper:
            used.update(meta.upper.garment.sections_used(self))
        if meta.bottom:
            used.update(part.field for part in (meta.bottom.garment, *meta.bottom.garment.parts(self)))
        return frozenset(used)

    def mends(self) -> frozenset[Mend]:
        """The mends that may change the pattern of the outfit."""
        own = {Mend.EXPORT_PIVOT} | ({Mend.WORN_LENGTH} if self.meta.wb and self.meta.bottom else set())
        worn: list[Garment[Any]] = [] if self.meta.upper is None else [self.meta.upper.garment]
        if self.meta.bottom is not None:
            worn += [self.meta.bottom.garment, *self.meta.bottom.garment.parts(self)]
        return frozenset(own.union(*(garment.mends for garment in worn)))

    def includes(self, name: str) -> bool:
        return name in self.sections_used()

    def halves(self) -> tuple[UpperHalf, ...]:
        """The designs of the two halves of a shirt, one design if they are alike; empty without a shirt."""
        if self.meta.upper is None or not isinstance(self.meta.upper.garment, Shirt):
            return ()
        left = self.left_half()
        return (self.right_half(),) if left is None else (self.right_half(), left)

    def right_half(self) -> UpperHalf:
        """The design of the right half of the upper body; without a collar if the left half differs."""
        if not self.left.enable_asym:
            return self.shirt, self.collar, self.sleeve
        bare = replace(self.collar, component=replace(self.collar.component, style=None))
        return self.shirt, bare, self.sleeve

    def left_half(self) -> UpperHalf | None:
        """The design of the left half; ``None`` for the mirror image of the right one."""
        if not self.left.enable_asym:
            return None
        return self.left.shirt.beside(self.shirt), self.left.collar.beside(self.collar), self.left.sleeve
