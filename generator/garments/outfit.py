"""Outfits: a shirt, a skirt, or both joined to a dress, with or without a waistband."""

from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

from gcd_dataset.errors import BodyError, PatternError
from gcd_dataset.generator.garments.circle_skirt import CircleSkirtDesign, circle_skirt
from gcd_dataset.generator.garments.neckline import NecklineDesign
from gcd_dataset.generator.garments.shirt import ShirtDesign, shirt
from gcd_dataset.generator.garments.sleeve import SleeveDesign
from gcd_dataset.generator.garments.space import Design, choice, part
from gcd_dataset.generator.garments.waistband import Waistband, WaistbandDesign, waistband
from gcd_dataset.generator.pattern import Component, assemble
from gcd_dataset.records import Measurements, Pattern

__all__ = ["Bottom", "MetaDesign", "OutfitDesign", "Upper", "outfit"]

GAP = 5.0  # cm between the parts of an outfit before sewing, GarmentCode
MEASURES_USED = (
    "height", "head_l", "neck_w", "shoulder_w", "shoulder_incl", "armscye_depth", "arm_length", "arm_pose_angle",
    "wrist", "bust", "back_width", "bust_line", "waist", "waist_back_width", "waist_line", "hips", "hip_back_width",
    "hips_line",
)  # fmt: skip
BACKS = (("back_width", "bust"), ("waist_back_width", "waist"), ("hip_back_width", "hips"))


class Upper(Enum):
    """What there is for the upper body."""

    SHIRT = "Shirt"


class Bottom(Enum):
    """What there is for the lower body."""

    CIRCLE_SKIRT = "SkirtCircle"


@dataclass(frozen=True)
class MetaDesign(Design):
    """Which parts the outfit has."""

    upper: Upper | None = choice(Upper.SHIRT, *Upper, None, keep=0.3)
    wb: Waistband | None = choice(None, *Waistband, None, keep=0.5)
    bottom: Bottom | None = choice(None, *Bottom, None, keep=0.3)


@dataclass(frozen=True)
class OutfitDesign(Design):
    """A design without a body: everything in it is a fraction, an angle or a choice. The default is a T-shirt."""

    meta: MetaDesign = part(MetaDesign)
    waistband: WaistbandDesign = part(WaistbandDesign)
    shirt: ShirtDesign = part(ShirtDesign)
    collar: NecklineDesign = part(NecklineDesign)
    sleeve: SleeveDesign = part(SleeveDesign)
    flare_skirt: CircleSkirtDesign = part(CircleSkirtDesign, key="flare-skirt")


def outfit(size: Measurements, design: OutfitDesign) -> Pattern:
    """The pattern of a design for a wearer, hung around the wearer from the top down.

    Raises ``BodyError`` for measures that nobody took or that no body has, and ``PatternError`` for an outfit without
    upper and bottom, or where a part cannot be drawn for this wearer.
    """
    parts = _hung(_parts(_measured(size), design))
    whole = Component.of(*parts)
    for above, below in pairwise(parts):
        whole = whole.sewn(above.interface("bottom"), below.interface("top"))
    held = [hung.interface("top") for hung in parts if "top" in hung.interfaces]
    return assemble(whole.with_edge_label(held[0], "lower_interface") if held else whole, "outfit")


def _parts(size: Measurements, design: OutfitDesign) -> tuple[Component, ...]:
    """The parts of the outfit, from the top down."""
    meta, parts = design.meta, []
    if meta.upper is None and meta.bottom is None:
        raise PatternError("an outfit without upper and bottom: choose meta.upper or meta.bottom")
    if meta.upper is Upper.SHIRT:
        parts.append(shirt(size, design.shirt, design.collar, design.sleeve))
    if meta.wb is not None:
        rise = design.flare_skirt.rise if meta.bottom else 1.0
        parts.append(waistband(size, design.waistband, meta.wb, rise=rise).labelled("body"))
    if meta.bottom is Bottom.CIRCLE_SKIRT:
        parts.append(circle_skirt(size, design.flare_skirt).labelled("leg"))
    return tuple(parts)


def _hung(parts: tuple[Component, ...]) -> tuple[Component, ...]:
    """Each part under the one before."""
    hung = parts[:1]
    for below in parts[1:]:
        hung = (*hung, below.placed_by("top", hung[-1], "bottom", gap=GAP))
    return hung


def _measured(size: Measurements) -> Measurements:
    """The measurements, if a garment can be drawn from them."""
    size.require(*MEASURES_USED)
    for back, girth in BACKS:
        if not 0 < getattr(size, back) < getattr(size, girth):
            figures = f"{back} is {getattr(size, back):.1f} cm of a {girth} of {getattr(size, girth):.1f} cm"
            raise BodyError(f"{figures}: the back is a part of the girth, mend the measurement file")
    return size
