"""What makes a pattern unfit to be worn, as predicates that give their reason with figures.

Each rule takes a ``DrawnOutfit`` and returns a ``Reject`` or ``None``; ``check_outfit`` asks them all.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

from gcd_dataset.crossings import edge_hulls
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.garment import BottomGarment
from gcd_dataset.generator.garments.outfit import bottom_rise, pieces
from gcd_dataset.generator.garments.sewable import (
    CLOTH_GIVES,
    SHARPEST_CORNER,
    corner_angles,
    cuff_and_arm_girth,
    is_mismatched,
)
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.garments.waistband import band_rise
from gcd_dataset.generator.pattern import MeasuredJoin, assemble_and_measure
from gcd_dataset.records import Measurements, Pattern
from gcd_dataset.validate import Fault, Rule, Severity, check_pattern

__all__ = [
    "RULES",
    "DrawnOutfit",
    "Reject",
    "check_outfit",
    "cuff_and_leg_girth",
    "garment_length",
    "has_firm_band",
    "has_snug_band",
    "has_tight_cuffs",
    "is_flared",
    "is_gathered",
    "room_to_floor",
    "top_girth",
    "top_of_bottom",
    "try_on",
]

LIGHT_LENGTH = 0.5  # length of a flared skirt up to which a loose or thin band holds it, GarmentCode
LIGHT_SUNS = 0.75  # flare-skirt.suns, the same
FIRM_BAND = 0.25  # waistband.width above which a band at the body's own girth holds any skirt, GarmentCode


@dataclass(frozen=True, slots=True)
class Reject:
    """Why a pattern was turned down."""

    rule: str
    figures: str
    """In words."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """The same by name, which ends in the unit where there is one."""

    def __str__(self) -> str:
        return f"{self.rule}: {self.figures}"


@dataclass(frozen=True)
class DrawnOutfit:
    """An outfit drawn for a wearer."""

    size: Measurements
    design: OutfitDesign
    pattern: Pattern
    joins: tuple[MeasuredJoin, ...]
    faults: tuple[Fault, ...]
    """What ``validate`` finds."""

    @classmethod
    def of(cls, size: Measurements, design: OutfitDesign, *, name: str = "outfit") -> Self:
        """The outfit drawn. Raises ``PatternError`` where it cannot be drawn for this wearer."""
        pattern, joins = assemble_and_measure(pieces(size, design), name)
        return cls(size, design, pattern, joins, check_pattern(pattern))


def try_on(size: Measurements, design: OutfitDesign, *, name: str = "outfit") -> Pattern | Reject:
    """The pattern of a design for a wearer, or the first reason why it cannot be drawn, or not be worn."""
    if design.meta.upper is None and design.meta.bottom is None:
        return Reject("empty", "an outfit without upper and bottom, at most a belt: choose meta.upper or meta.bottom")
    try:
        outfit = DrawnOutfit.of(size, design, name=name)
    except PatternError as error:
        return Reject("cannot_be_drawn", str(error))
    return next(iter(check_outfit(outfit)), outfit.pattern)


def check_outfit(outfit: DrawnOutfit) -> tuple[Reject, ...]:
    """All reasons to turn the pattern down; empty for one that can be worn."""
    found = (rule(outfit) for rule in RULES)
    return tuple(reject for reject in found if reject is not None)


def reaches_floor(outfit: DrawnOutfit) -> Reject | None:
    """The parts, hung one under the other, reach from the nape (a bottom alone: from the waist) past the floor."""
    length, room = garment_length(outfit.size, outfit.design), room_to_floor(outfit.size, outfit.design)
    if length <= room:
        return None
    figures = f"{length:.1f} cm of garment over {room:.1f} cm of body: shorten it"
    return Reject("reaches_floor", figures, {"length_cm": length, "room_cm": room})


def slides_off(outfit: DrawnOutfit) -> Reject | None:
    """A bottom alone is wider at its top than the trunk is anywhere."""
    if not _is_bottom_alone(outfit.design):
        return None
    size = outfit.size
    girth, trunk = top_girth(size, outfit.design), max(size.waist, size.hips)
    if girth <= trunk:
        return None
    figures = f"a bottom of {girth:.1f} cm at the top on a trunk of {trunk:.1f} cm: narrow its band"
    return Reject("slides_off", figures, {"girth_cm": girth, "trunk_cm": trunk})


def loose_gathers(outfit: DrawnOutfit) -> Reject | None:
    """A gathered skirt alone hangs from no band, or from one wider than the body."""
    design = outfit.design
    if not _is_bottom_alone(design) or not is_gathered(design) or has_snug_band(design):
        return None
    gathers = top_parameter(design, "gather_parameter")
    if gathers <= 1:
        return None
    return Reject("loose_gathers", f"gathers of {gathers:.2f} hang from no snug waistband", {"gathers": gathers})


def too_heavy(outfit: DrawnOutfit) -> Reject | None:
    """A flared skirt alone is long or wide, and no firm band holds it."""
    design = outfit.design
    if not _is_bottom_alone(design) or not is_flared(design) or has_firm_band(design):
        return None
    length, suns = bottom_length(design), top_parameter(design, "fullness_parameter")
    if length <= LIGHT_LENGTH and suns <= LIGHT_SUNS:
        return None
    figures = f"length {length:.2f} and {suns:.2f} suns hang from no firm waistband"
    return Reject("too_heavy", figures, {"length": length, "suns": suns})


def tight_cuff(outfit: DrawnOutfit) -> Reject | None:
    """A band at the end of trousers or sleeves is narrower than the limb in it, by more than cloth gives."""
    size, design = outfit.size, outfit.design
    if has_tight_cuffs(size, design):
        cuff, leg = cuff_and_leg_girth(size, design)
        figures = f"a cuff of {cuff:.1f} cm round a leg of {leg:.1f} cm: lower top_ruffle or cuff_len"
        return Reject("tight_cuff", figures, {"cuff_cm": cuff, "limb_cm": leg})
    for half in design.halves():
        cuff, arm = cuff_and_arm_girth(size, design, half)
        if 0.0 < cuff * CLOTH_GIVES < arm:
            figures = f"a cuff of {cuff:.1f} cm round an arm of {arm:.1f} cm: lower top_ruffle"
            return Reject("tight_cuff", figures, {"cuff_cm": cuff, "limb_cm": arm})
    return None


def mismatched_seam(outfit: DrawnOutfit) -> Reject | None:
    """Two sides of a seam differ in length where nothing is gathered, or by more than gathers can take."""
    for sewn in outfit.joins:
        if is_mismatched(sewn):
            one, other = (f"{side[0].panel} {side[0].edge}" for side in (sewn.join.left, sewn.join.right))
            figures = f"{sewn.left_length:.1f} cm of {one} on {sewn.right_length:.1f} cm of {other}"
            return Reject("mismatched_seam", figures, {"left_cm": sewn.left_length, "right_cm": sewn.right_length})
    return None


def sharp_corner(outfit: DrawnOutfit) -> Reject | None:
    """A panel ends in a spike."""
    panels = outfit.pattern.panels
    angles = corner_angles([edge_hulls(panel) for panel in panels])
    if angles.min() >= SHARPEST_CORNER:
        return None
    corners = [(panel.name, edge) for panel in panels for edge in range(len(panel.edges))]
    name, edge = corners[int(angles.argmin())]
    figures = f"panel {name}, start of edge {edge}: {angles.min():.1f} degrees"
    return Reject("sharp_corner", figures, {"angle_deg": float(angles.min())})


def short_edge(outfit: DrawnOutfit) -> Reject | None:
    """An edge is too short to be meshed and sewn."""
    return _fault(outfit, "short_edge", lambda rule: rule is Rule.SHORT_EDGE)


def self_crossing(outfit: DrawnOutfit) -> Reject | None:
    """The outline of a panel crosses itself."""
    return _fault(outfit, "self_crossing", lambda rule: rule is Rule.SELF_CROSSING)


def unsewable(outfit: DrawnOutfit) -> Reject | None:
    """Anything else that forbids sewing."""
    return _fault(outfit, "unsewable", lambda rule: rule is not Rule.SELF_CROSSING and rule.severity is Severity.ERROR)


RULES: tuple[Callable[[DrawnOutfit], Reject | None], ...] = (
    reaches_floor,
    slides_off,
    loose_gathers,
    too_heavy,
    tight_cuff,
    mismatched_seam,
    self_crossing,
    short_edge,
    unsewable,
    sharp_corner,
)


# ------------------------------------------------------------------------------------------------------------- figures


def room_to_floor(size: Measurements, design: OutfitDesign) -> float:
    """From where the garment hangs down to the floor [cm]."""
    return size.waist_level if design.meta.upper is None else size.height - size.head_l


def garment_length(size: Measurements, design: OutfitDesign) -> float:
    """Upper, band and bottom, one under the other [cm]."""
    meta = design.meta
    upper = meta.upper.garment.length(size, design) if meta.upper else 0.0
    band = design.waistband.width * size.hips_line if meta.wb else 0.0
    return upper + band + (meta.bottom.garment.length(size, design, bottom_rise(design)) if meta.bottom else 0.0)


def top_girth(size: Measurements, design: OutfitDesign) -> float:
    """Girth at the upper end of a bottom with its band [cm]."""
    rise = bottom_rise(design)
    if design.meta.wb is None:
        return girth_at_rise(size, rise)
    return design.waistband.waist * girth_at_rise(size, band_rise(design.waistband, rise) + design.waistband.width)


def has_snug_band(design: OutfitDesign) -> bool:
    """Whether there is a band at the body's own girth."""
    return design.meta.wb is not None and design.waistband.waist <= 1


def has_firm_band(design: OutfitDesign) -> bool:
    """Whether a band at the body's own girth, and high enough, holds the skirt."""
    return has_snug_band(design) and design.waistband.width > FIRM_BAND


def top_of_bottom(design: OutfitDesign) -> BottomGarment[Any] | None:
    """The record of the bottom, or of that which a bottom made of several begins with; ``None`` without a bottom."""
    return design.meta.bottom.garment.top(design) if design.meta.bottom else None


def is_gathered(design: OutfitDesign) -> bool:
    """Whether the bottom is a gathered skirt, or begins with one."""
    top = top_of_bottom(design)
    return top is not None and bool(top.gather_parameter)


def is_flared(design: OutfitDesign) -> bool:
    """Whether the bottom is a flared skirt, or begins with one."""
    top = top_of_bottom(design)
    return top is not None and top.flared


def top_parameter(design: OutfitDesign, role: Literal["gather_parameter", "fullness_parameter"]) -> float:
    """The parameter that gathers the top of the bottom, or makes it wide; 0 where it has none."""
    top = top_of_bottom(design)
    name = "" if top is None else getattr(top, role)
    return float(getattr(top.section_design(design), name)) if top is not None and name else 0.0


def bottom_length(design: OutfitDesign) -> float:
    """The ``length`` of a bottom by its section."""
    assert design.meta.bottom is not None
    return float(design.meta.bottom.garment.length_garment(design).section_design(design).length)


def cuff_and_leg_girth(size: Measurements, design: OutfitDesign) -> tuple[float, float]:
    """Girth of a band at the end of the legs, and of the leg where it is widest inside the band [cm]; 0 without one.

    Raises ``PatternError`` where legs cannot be drawn.
    """
    garment = design.meta.bottom.garment if design.meta.bottom else None
    if garment is None or garment.cuffs is None:
        return 0.0, 0.0
    return garment.cuffs(size, garment.section_design(design), bottom_rise(design))


def has_tight_cuffs(size: Measurements, design: OutfitDesign) -> bool:
    """Whether the legs do not go through the cuffs of trousers."""
    try:
        cuff, leg = cuff_and_leg_girth(size, design)
    except PatternError:  # which the drawing tells
        return False
    return cuff * CLOTH_GIVES < leg


def _fault(outfit: DrawnOutfit, name: str, concerns: Callable[[Rule], bool]) -> Reject | None:
    for fault in outfit.faults:
        if concerns(fault.rule):
            return Reject(name, str(fault))
    return None


def _is_bottom_alone(design: OutfitDesign) -> bool:
    return design.meta.upper is None and design.meta.bottom is not None
