"""What makes a pattern unfit to be worn, as predicates that give their reason with figures.

Each rule is a function ``(size, design, pattern) -> Reject | None``; ``check_outfit`` asks them all.
"""

from collections.abc import Callable
from dataclasses import dataclass

from gcd_dataset.generator.garments.circle_skirt import skirt_length
from gcd_dataset.generator.garments.outfit import Bottom, OutfitDesign
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.garments.waistband import band_rise
from gcd_dataset.records import Measurements, Pattern
from gcd_dataset.validate import Rule, Severity, check_pattern

__all__ = ["RULES", "Reject", "check_outfit"]

LIGHT_LENGTH = 0.5  # flare-skirt.length up to which a loose band holds a circle skirt, GarmentCode
LIGHT_SUNS = 0.75  # flare-skirt.suns, the same
FIRM_BAND = 0.25  # waistband.width above which a band at the body's own girth holds any skirt, GarmentCode


@dataclass(frozen=True, slots=True)
class Reject:
    """Why a pattern was turned down."""

    rule: str
    figures: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.figures}"


def check_outfit(size: Measurements, design: OutfitDesign, pattern: Pattern) -> tuple[Reject, ...]:
    """All reasons to turn the pattern down; empty for one that can be worn."""
    found = (rule(size, design, pattern) for rule in RULES)
    return tuple(reject for reject in found if reject is not None)


def reaches_floor(size: Measurements, design: OutfitDesign, pattern: Pattern) -> Reject | None:
    """The parts, hung one under the other, reach from the nape (a bottom alone: from the waist) past the floor."""
    room = size.waist_level if design.meta.upper is None else size.height - size.head_l
    length = garment_length(size, design)
    if length <= room:
        return None
    return Reject("reaches_floor", f"{length:.1f} cm of garment over {room:.1f} cm of body: shorten it")


def slides_off(size: Measurements, design: OutfitDesign, pattern: Pattern) -> Reject | None:
    """A skirt alone is wider at its top than the trunk is anywhere."""
    if not _alone(design):
        return None
    girth, trunk = top_girth(size, design), max(size.waist, size.hips)
    if girth <= trunk:
        return None
    return Reject("slides_off", f"a skirt of {girth:.1f} cm at the top on a trunk of {trunk:.1f} cm: narrow its band")


def too_heavy(size: Measurements, design: OutfitDesign, pattern: Pattern) -> Reject | None:
    """A skirt alone is long or wide, and no firm band holds it."""
    if not _alone(design) or has_firm_band(design):
        return None
    length, suns = design.flare_skirt.length, design.flare_skirt.suns
    if length <= LIGHT_LENGTH and suns <= LIGHT_SUNS:
        return None
    return Reject("too_heavy", f"length {length:.2f} and {suns:.2f} suns hang from no firm waistband")


def unsewable(size: Measurements, design: OutfitDesign, pattern: Pattern) -> Reject | None:
    """A panel crosses itself or breaks another rule of ``validate``, or an edge is too short to sew."""
    for fault in check_pattern(pattern):
        if fault.severity is Severity.ERROR or fault.rule is Rule.SHORT_EDGE:
            return Reject("unsewable", str(fault))
    return None


RULES: tuple[Callable[[Measurements, OutfitDesign, Pattern], Reject | None], ...] = (
    reaches_floor,
    slides_off,
    too_heavy,
    unsewable,
)


def garment_length(size: Measurements, design: OutfitDesign) -> float:
    """Upper, band and bottom, one under the other [cm]."""
    meta = design.meta
    upper = design.shirt.length * size.waist_line if meta.upper else 0.0
    band = design.waistband.width * size.hips_line if meta.wb else 0.0
    bottom = skirt_length(size, design.flare_skirt) if meta.bottom else 0.0
    return upper + band + bottom


def top_girth(size: Measurements, design: OutfitDesign) -> float:
    """Girth at the upper end of a bottom with its band [cm]."""
    rise = design.flare_skirt.rise
    if design.meta.wb is None:
        return girth_at_rise(size, rise)
    return design.waistband.waist * girth_at_rise(size, band_rise(design.waistband, rise) + design.waistband.width)


def has_firm_band(design: OutfitDesign) -> bool:
    """Whether a band at the body's own girth, and high enough, holds the skirt."""
    band = design.waistband
    return design.meta.wb is not None and band.waist <= 1 and band.width > FIRM_BAND


def _alone(design: OutfitDesign) -> bool:
    return design.meta.upper is None and design.meta.bottom is Bottom.CIRCLE_SKIRT
