"""The style of an outfit as drawn: the tags of its garments and of the outfit as a whole."""

from gcd_dataset.generator.garments.description import Description, Setting
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.drawn import cuff_gathers, gather_below, most_gathered, sides_match
from gcd_dataset.generator.garments.outfit import bottom_rise
from gcd_dataset.generator.garments.tags import HEMS, RUFFLES, Tag
from gcd_dataset.records import Measurements, Pattern


def outfit_tags(size: Measurements, design: OutfitDesign, pattern: Pattern) -> tuple[str, ...]:
    """The tags of an outfit, drawn for a wearer in ``pattern``, in the order of ``TAGS``, each once."""
    parts = [part for part in described(size, design, pattern) if part]
    found = {_kind(design)} | {tag for part in parts for tag in part.tags}
    details = [detail for part in parts for detail in part.details]
    if most_gathered(pattern) >= RUFFLES:
        found.add(Tag.RUFFLED)
    if len(design.halves()) > 1 and not sides_match(details, pattern):
        found.add(Tag.ASYMMETRIC)
    if design.meta.bottom:
        found.update([_hem(size, design)] + ([Tag.WAISTBAND] if design.meta.wb else []))
    return tuple(tag.value for tag in Tag if tag in found)


def described(
    size: Measurements, design: OutfitDesign, pattern: Pattern
) -> tuple[Description | None, Description | None]:
    """Upper and bottom in words, as drawn in ``pattern``; ``None`` for one that the outfit lacks."""
    meta = design.meta
    above = Setting(size, cuffs=cuff_gathers(pattern, legs=False))
    setting = Setting(size, bottom_rise(design), gather_below(pattern), cuff_gathers(pattern, legs=True))
    return (
        meta.upper.garment.describe(above, design) if meta.upper else None,
        meta.bottom.garment.describe(setting, design) if meta.bottom else None,
    )


def _kind(design: OutfitDesign) -> Tag:
    upper, bottom = design.meta.upper, design.meta.bottom
    if bottom is None:
        return Tag.TOP
    if bottom.garment.legs:
        return Tag.JUMPSUIT if upper else Tag.TROUSERS
    return Tag.DRESS if upper else Tag.SKIRT


def _hem(size: Measurements, design: OutfitDesign) -> Tag:
    depth = hem_depth(size, design)
    return next(
        (tag for most, tag in zip(HEMS, (Tag.MINI, Tag.KNEE, Tag.MIDI), strict=True) if depth <= most), Tag.MAXI
    )


def hem_depth(size: Measurements, design: OutfitDesign) -> float:
    """Depth of the lowest hem below the hips, as a fraction of hips to floor."""
    return (hem_below_waist(size, design) - size.hips_line) / size.leg_length


def hem_below_waist(size: Measurements, design: OutfitDesign) -> float:
    """Depth of the lowest hem below the waist, the parts hung one under the other, each as long as drawn [cm]."""
    meta, rise = design.meta, bottom_rise(design)
    band = design.waistband.width * size.hips_line if meta.wb else 0.0
    if meta.upper:
        start = meta.upper.garment.length(size, design) - size.waist_line + band
    else:
        start = (1.0 - rise) * size.hips_line
    return start + (meta.bottom.garment.drawn_length(size, design, rise) if meta.bottom else 0.0)
