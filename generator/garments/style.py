"""The style of an outfit in words: the tags of its garments and of the outfit as a whole."""

from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.outfit import bottom_rise
from gcd_dataset.generator.garments.tags import HEMS, Tag
from gcd_dataset.records import Measurements

__all__ = ["hem_depth", "outfit_tags"]


def outfit_tags(size: Measurements, design: OutfitDesign) -> tuple[str, ...]:
    """The tags of an outfit for a wearer, in the order of ``TAGS``, each once."""
    meta = design.meta
    found = {_kind(design)} | ({Tag.WAISTBAND} if meta.wb else set())
    for choice in (meta.upper, meta.bottom):
        found.update(choice.garment.tags(design) if choice else ())
    if meta.bottom:
        found.add(_hem(size, design))
    return tuple(tag.value for tag in Tag if tag in found)


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
    """Depth of a bottom's hem below the hips, as a fraction of hips to floor, with each part hung below the last."""
    upper, bottom = design.meta.upper, design.meta.bottom
    assert bottom is not None
    rise = bottom_rise(design)
    if upper is None:
        return (bottom.garment.length(size, design, rise) - rise * size.hips_line) / size.leg_length
    band = design.waistband.width * size.hips_line if design.meta.wb else 0.0
    below_waist = upper.garment.length(size, design) - size.waist_line + band
    return (below_waist + bottom.garment.length(size, design, rise) - size.hips_line) / size.leg_length
