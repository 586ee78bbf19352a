"""Rules that reject patterns which cannot be worn or sewn, as predicates that return a reason with figures.

Each rule takes a ``DrawnGarment`` and returns a ``Reject`` or ``None``; ``check_design`` applies all rules.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from jaxtyping import Complex

from gcd_dataset.crossings import edge_hulls
from gcd_dataset.errors import PatternError
from gcd_dataset.faults import Fault, Rule, Severity, check_pattern
from gcd_dataset.generator.garments.assembly import MEASURES_USED, bottom_rise, pieces
from gcd_dataset.generator.garments.cuff import arm_girth_in_end
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.garment import BottomGarment
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.sewable import (
    CLOTH_GIVES,
    SHARPEST_CORNER,
    corner_angles,
    end_and_arm_girth,
    girth_of_cloth,
    has_narrow_strap,
    is_mismatched,
    sharpest,
    shortest_shoulder,
    strap_width,
)
from gcd_dataset.generator.garments.tightness import (
    STRAPS_GIVE,
    hip_load,
    rings,
    strap_stretch,
    trunk_rings,
)
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.garments.waistband import band_rise
from gcd_dataset.generator.pattern import MeasuredJoin, assemble_and_measure
from gcd_dataset.records import CANNOT_BE_PUT_ON, Closure, EdgeRole, FitLabel, Measurements, Pattern

LIGHT_LENGTH = 0.5  # largest length of a flared skirt without a firm band, GarmentCode
LIGHT_SUNS = 0.75  # largest flare-skirt.suns of a flared skirt without a firm band, GarmentCode
HEAD_GIRTH = 2.18  # over head_l: mean of 24 of this package's bodies, ± 0.03
NECKLINE = frozenset({EdgeRole.LEFT_COLLAR, EdgeRole.RIGHT_COLLAR})
FIRM_BAND = 0.25  # waistband.width above which a snug band is firm, GarmentCode


@dataclass(frozen=True, slots=True)
class Reject:
    """The reason why a pattern was rejected."""

    rule: str
    figures: str
    """The measured values, in words."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """The measured values by name; a name ends in its unit, if any: ``length_cm``."""

    def __str__(self) -> str:
        return f"{self.rule}: {self.figures}"


@dataclass(frozen=True)
class DrawnGarment:
    """A garment drawn for a wearer, with its joins and the faults of its pattern."""

    size: Measurements
    design: GarmentDesign
    pattern: Pattern
    joins: tuple[MeasuredJoin, ...]
    faults: tuple[Fault, ...]
    """The faults that ``faults.check_pattern`` found."""
    wearer: Measurements | None = None
    """The measures of its wearer, where it is drawn for another size."""

    @property
    def body(self) -> Measurements:
        """The measures of the body that wears it."""
        return self.wearer or self.size

    @cached_property
    def hulls(self) -> tuple[Complex[np.ndarray, "e 4"], ...]:
        """``edge_hulls`` of each panel."""
        return tuple(map(edge_hulls, self.pattern.panels))

    @classmethod
    def of(cls, size: Measurements, design: GarmentDesign, *, name: str = "garment") -> Self:
        """Draw and check a garment. Raises ``PatternError`` if it cannot be drawn for this wearer."""
        pattern, joins = assemble_and_measure(pieces(size, design), name)
        return cls(size, design, pattern, joins, check_pattern(pattern))


def try_on(size: Measurements, design: GarmentDesign, *, name: str = "garment") -> Pattern | Reject:
    """The pattern of a design for a wearer, or the first reason why it cannot be drawn or worn."""
    if design.meta.upper is None and design.meta.bottom is None:
        return Reject("empty", "a garment without upper and bottom, at most a belt: choose meta.upper or meta.bottom")
    try:
        garment = DrawnGarment.of(size, design, name=name)
    except PatternError as error:
        return Reject("cannot_be_drawn", str(error))
    return next(iter(check_design(garment)), garment.pattern)


def check_design(garment: DrawnGarment) -> tuple[Reject, ...]:
    """All reasons to reject the pattern; empty if it can be worn."""
    found = (rule(garment) for rule in RULES)
    return tuple(reject for reject in found if reject is not None)


def fit_labels(
    pattern: Pattern, design: GarmentDesign, *, cut_for: Measurements, wearer: Measurements
) -> tuple[FitLabel, ...]:
    """The rules of ``WORN`` that a pattern drawn for one size breaks on its wearer.

    Raises ``BodyError`` for a wearer that lacks a measure.
    """
    garment = DrawnGarment(cut_for, design, pattern, (), (), wearer.require(*MEASURES_USED))
    found = (rule(garment) for rule in WORN)
    return tuple(FitLabel(broken.rule, broken.figures, broken.numbers) for broken in found if broken is not None)


def reaches_floor(garment: DrawnGarment) -> Reject | None:
    """The parts together are longer than the body from nape to floor, or for a bottom alone from waist to floor."""
    length, room = garment_length(garment.size, garment.design), room_to_floor(garment.body, garment.design)
    if length <= room:
        return None
    figures = f"{length:.1f} cm of garment over {room:.1f} cm of body: shorten it"
    return Reject("reaches_floor", figures, {"length_cm": length, "room_cm": room})


def slides_off(garment: DrawnGarment) -> Reject | None:
    """A bottom without an upper is wider at its top than waist and hips."""
    if not _is_bottom_alone(garment.design):
        return None
    girth, trunk = top_girth(garment.size, garment.design), max(garment.body.waist, garment.body.hips)
    if girth <= trunk:
        return None
    figures = f"a bottom of {girth:.1f} cm at the top on a trunk of {trunk:.1f} cm: narrow its band"
    return Reject("slides_off", figures, {"girth_cm": girth, "trunk_cm": trunk})


def loose_gathers(garment: DrawnGarment) -> Reject | None:
    """A gathered skirt without an upper has no waistband, or a waistband wider than the body."""
    design = garment.design
    if not _is_bottom_alone(design) or not is_gathered(design) or has_snug_band(design):
        return None
    gathers = top_parameter(design, "gather_parameter")
    if gathers <= 1:
        return None
    return Reject("loose_gathers", f"gathers of {gathers:.2f} hang from no snug waistband", {"gathers": gathers})


def too_heavy(garment: DrawnGarment) -> Reject | None:
    """A flared skirt without an upper is long or wide, and has no firm band."""
    design = garment.design
    if not _is_bottom_alone(design) or not is_flared(design) or has_firm_band(design):
        return None
    length, suns = bottom_length(design), top_parameter(design, "fullness_parameter")
    if length <= LIGHT_LENGTH and suns <= LIGHT_SUNS:
        return None
    figures = f"length {length:.2f} and {suns:.2f} suns hang from no firm waistband"
    return Reject("too_heavy", figures, {"length": length, "suns": suns})


def tight_cuff(garment: DrawnGarment) -> Reject | None:
    """A sleeve's end or the cuff of a leg is too narrow for the limb inside it, even stretched by ``CLOTH_GIVES``."""
    design = garment.design
    if has_tight_cuffs(garment.size, design, garment.wearer):
        cuff, leg = cuff_and_leg_girth(garment.size, design, garment.wearer)
        figures = f"a cuff of {cuff:.1f} cm round a leg of {leg:.1f} cm: lower top_ruffle or cuff_len"
        return Reject("tight_cuff", figures, {"cuff_cm": cuff, "limb_cm": leg})
    for half in design.halves():
        end, arm = end_and_arm_girth(garment.size, design, half)
        if garment.wearer is not None:
            arm = arm_girth_in_end(garment.wearer, half[-1])
        if 0.0 < end * CLOTH_GIVES < girth_of_cloth(arm):
            what, remedy = ("cuff", "lower top_ruffle") if half[-1].cuff.type else ("sleeve end", "raise end_width")
            figures = f"a {what} of {end:.1f} cm round an arm of {arm:.1f} cm: {remedy}"
            return Reject("tight_cuff", figures, {"cuff_cm": end, "limb_cm": arm})
    return None


def too_tight(garment: DrawnGarment) -> Reject | None:
    """A ring of cloth round trunk or legs is narrower than the body inside it, by more than cloth stretches."""
    ring = max(rings(garment.size, garment.design, garment.wearer), key=lambda ring: ring.stretch, default=None)
    if ring is None or ring.stretch <= CLOTH_GIVES:
        return None
    figures = f"{ring.name} of {ring.cloth:.1f} cm round {ring.body:.1f} cm of body: {ring.remedy}"
    return Reject("too_tight", figures, {"ring_cm": ring.cloth, "body_cm": ring.body})


def cannot_be_put_on(garment: DrawnGarment) -> Reject | None:
    """A ring that is stretched by ``CLOTH_GIVES`` is too narrow to pass bust, hips or head, or to close where it lies.

    Rings of a garment with an upper pass the bust, those round the trunk of another garment the hips, a neckline the
    head. A ring narrower than this already on the body for which it is cut has a fastening, as has a front with a
    closure: it must only close round the wearer.
    """
    size, design, body = garment.size, garment.design, garment.body
    tight = [(ring.name, ring.cloth, ring.body) for ring in rings(size, design, body)]
    if design.front.closure is Closure.SEWN or not design.halves():
        widest = "hips" if design.meta.upper is None else "bust"
        over = [(f"{ring.name} that passes the {widest}", ring.cloth) for ring in trunk_rings(size, design, body)]
        tight += [(*ring, getattr(body, widest)) for ring in over if getattr(size, widest) <= ring[1]]
        neck = neckline_girth(garment.pattern)
        if HEAD_GIRTH * size.head_l <= neck:
            tight.append(("a neckline that passes the head", neck, HEAD_GIRTH * body.head_l))
    name, cloth, girth = max(tight, key=lambda ring: ring[2] / ring[1], default=("", 1.0, 0.0))
    if girth <= cloth * CLOTH_GIVES:
        return None
    figures = f"{name}: {cloth:.1f} cm of cloth round {girth:.1f} cm of body"
    return Reject(CANNOT_BE_PUT_ON, figures, {"ring_cm": cloth, "body_cm": girth})


def overloaded_straps(garment: DrawnGarment) -> Reject | None:
    """The shoulder seams stretch under the weight of the garment by more than ``STRAPS_GIVE``."""
    stretch = strap_stretch(garment.size, garment.design)
    if stretch <= STRAPS_GIVE:
        return None
    figures = f"the weight stretches the shoulder seams to {stretch:.2f} times their length: shorten the bottom"
    return Reject("overloaded_straps", figures, {"stretch": stretch})


def overloaded_hips(garment: DrawnGarment) -> Reject | None:
    """A skirt alone, or a strapless dress, is heavier than friction on the hips holds: see ``hip_load``."""
    load = hip_load(garment.size, garment.design)
    if load is None or not load.slides:
        return None
    figures = f"{load.cloth:.2f} m² of cloth on hips that hold {load.held:.2f} m²: shorten the bottom"
    return Reject("overloaded_hips", figures, {"cloth_m2": load.cloth, "held_m2": load.held})


def narrow_shoulder(garment: DrawnGarment) -> Reject | None:
    """A shoulder seam is shorter than ``shortest_shoulder``."""
    least = shortest_shoulder(garment.size)
    panel, length = min(_shoulder_seams(garment.pattern), key=lambda seam: seam[1], default=("", least))
    if length >= least:
        return None
    figures = f"panel {panel}: a shoulder seam of {length:.1f} cm, under {least:.1f} cm: lower collar.width"
    return Reject("narrow_shoulder", figures, {"shoulder_cm": length})


def mismatched_seam(garment: DrawnGarment) -> Reject | None:
    """The sides of a seam differ in length without gathers, or by more than gathers allow."""
    for sewn in garment.joins:
        if is_mismatched(sewn):
            one, other = (f"{side[0].panel} {side[0].edge}" for side in (sewn.join.left, sewn.join.right))
            figures = f"{sewn.left_length:.1f} cm of {one} on {sewn.right_length:.1f} cm of {other}"
            return Reject("mismatched_seam", figures, {"left_cm": sewn.left_length, "right_cm": sewn.right_length})
    return None


def sharp_corner(garment: DrawnGarment) -> Reject | None:
    """A panel has a corner under ``SHARPEST_CORNER``."""
    panels = garment.pattern.panels
    angles = corner_angles(garment.hulls)
    if angles.min() >= SHARPEST_CORNER:
        return None
    corners = [(panel.name, edge) for panel in panels for edge in range(len(panel.edges))]
    name, edge = corners[sharpest(angles)]
    figures = f"panel {name}, start of edge {edge}: {angles.min():.1f} degrees"
    return Reject("sharp_corner", figures, {"angle_deg": float(angles.min())})


def narrow_strap(garment: DrawnGarment) -> Reject | None:
    """A neckline comes nearer to an armhole than ``NARROWEST_STRAP``."""
    narrow = [
        panel
        for panel, hulls in zip(garment.pattern.panels, garment.hulls, strict=True)
        if has_narrow_strap(panel, hulls)
    ]
    if not narrow:
        return None
    panel = min(narrow, key=strap_width)
    width = strap_width(panel)
    figures = f"panel {panel.name}: {width:.1f} cm of cloth between neckline and armhole: make the neckline shallower"
    return Reject("narrow_strap", figures, {"width_cm": width})


def short_edge(garment: DrawnGarment) -> Reject | None:
    """An edge is too short to mesh and sew."""
    return _fault(garment, "short_edge", lambda rule: rule is Rule.SHORT_EDGE)


def self_crossing(garment: DrawnGarment) -> Reject | None:
    """The outline of a panel crosses itself."""
    return _fault(garment, "self_crossing", lambda rule: rule is Rule.SELF_CROSSING)


def unsewable(garment: DrawnGarment) -> Reject | None:
    """Any other error of ``check_pattern``."""
    return _fault(garment, "unsewable", lambda rule: rule is not Rule.SELF_CROSSING and rule.severity is Severity.ERROR)


RULES: tuple[Callable[[DrawnGarment], Reject | None], ...] = (
    reaches_floor, slides_off, loose_gathers, too_heavy, tight_cuff, too_tight, overloaded_straps, overloaded_hips,
    narrow_shoulder, mismatched_seam, self_crossing, short_edge, unsewable, narrow_strap, sharp_corner,
)  # fmt: skip
WORN = (too_tight, slides_off, tight_cuff, reaches_floor, cannot_be_put_on)
"""The rules about the wearer: on the body for which a garment is cut they reject, on another they are labels."""


def room_to_floor(size: Measurements, design: GarmentDesign) -> float:
    """Height of the nape above the floor, or for a bottom alone of the waist [cm]."""
    return size.waist_level if design.meta.upper is None else size.height - size.head_l


def garment_length(size: Measurements, design: GarmentDesign, mends: frozenset[Mend] = ALL_MENDS) -> float:
    """Length of upper, band and bottom, one under the other [cm]."""
    meta, rise = design.meta, bottom_rise(design, mends)
    upper = meta.upper.garment.length(size, design) if meta.upper else 0.0
    band = design.waistband.width * size.hips_line if meta.wb else 0.0
    return upper + band + (meta.bottom.garment.length(size, design, rise) if meta.bottom else 0.0)


def top_girth(size: Measurements, design: GarmentDesign) -> float:
    """Girth at the top of a bottom with its band, if any [cm]."""
    rise = bottom_rise(design)
    if design.meta.wb is None:
        return girth_at_rise(size, rise)
    return design.waistband.waist * girth_at_rise(size, band_rise(design.waistband, rise) + design.waistband.width)


def has_snug_band(design: GarmentDesign) -> bool:
    """Whether the garment has a snug band: no wider than the body."""
    return design.meta.wb is not None and design.waistband.waist <= 1


def has_firm_band(design: GarmentDesign) -> bool:
    """Whether the garment has a firm band: snug, and high enough to hold a heavy skirt."""
    return has_snug_band(design) and design.waistband.width > FIRM_BAND


def top_of_bottom(design: GarmentDesign) -> BottomGarment[Any] | None:
    """The record of the bottom, or of the uppermost part of a combined bottom; ``None`` without a bottom."""
    return design.meta.bottom.garment.top(design) if design.meta.bottom else None


def is_gathered(design: GarmentDesign) -> bool:
    """Whether the top of the bottom can be gathered."""
    top = top_of_bottom(design)
    return top is not None and bool(top.gather_parameter)


def is_flared(design: GarmentDesign) -> bool:
    """Whether the bottom, or its uppermost part, is a flared skirt."""
    top = top_of_bottom(design)
    return top is not None and top.flared


def top_parameter(design: GarmentDesign, role: Literal["gather_parameter", "fullness_parameter"]) -> float:
    """The value of the parameter for gathers or fullness of the bottom's top; 0 without such a parameter."""
    top = top_of_bottom(design)
    name = "" if top is None else getattr(top, role)
    return float(getattr(top.section_design(design), name)) if top is not None and name else 0.0


def bottom_length(design: GarmentDesign) -> float:
    """The ``length`` parameter of the bottom."""
    assert design.meta.bottom is not None
    return float(design.meta.bottom.garment.length_garment(design).section_design(design).length)


def cuff_and_leg_girth(
    size: Measurements, design: GarmentDesign, wearer: Measurements | None = None
) -> tuple[float, float]:
    """Girth of the cuff at the end of a leg, and largest girth of the leg inside it [cm]; 0 without a cuff.

    ``wearer``: the measures of the leg; default: ``size``. Raises ``PatternError`` for legs that cannot be drawn.
    """
    garment = design.meta.bottom.garment if design.meta.bottom else None
    if garment is None or garment.cuffs is None:
        return 0.0, 0.0
    drawn = garment.section_design(design), bottom_rise(design)
    cuff, leg = garment.cuffs(size, *drawn)
    return cuff, leg if wearer is None else garment.cuffs(wearer, *drawn)[1]


def has_tight_cuffs(size: Measurements, design: GarmentDesign, wearer: Measurements | None = None) -> bool:
    """Whether the cuffs of trousers are too tight for the legs."""
    try:
        cuff, leg = cuff_and_leg_girth(size, design, wearer)
    except PatternError:  # drawing the garment reports it
        return False
    return cuff * CLOTH_GIVES < leg


def neckline_girth(pattern: Pattern) -> float:
    """Length of all edges of a neckline [cm]; 0 without any."""
    edges = (each for panel in pattern.panels for each in zip(panel.edges, panel.edge_lengths(), strict=True))
    return float(sum(length for edge, length in edges if edge.label in NECKLINE))


def _shoulder_seams(pattern: Pattern) -> Iterator[tuple[str, float]]:
    """Panel and length [cm] of each shoulder seam, all its parts together."""
    for panel in pattern.panels:
        for name in ("shoulder", "left_shoulder"):
            parts = [edge for edge, drawn in enumerate(panel.edges) if drawn.name == name]
            if parts:
                lengths = panel.edge_lengths()
                yield panel.name, float(sum(lengths[edge] for edge in parts))


def is_too_tight(size: Measurements, design: GarmentDesign) -> bool:
    """Whether a ring of cloth round the trunk is too tight."""
    try:
        return any(ring.stretch > CLOTH_GIVES for ring in trunk_rings(size, design))
    except PatternError:  # drawing the garment reports it
        return False


def has_tight_bottom(size: Measurements, design: GarmentDesign) -> bool:
    """Whether a ring of the bottom is too tight for the legs; ``is_too_tight`` is about the rings above it."""
    if design.meta.bottom is None:
        return False
    try:
        rings = design.meta.bottom.garment.rings(size, design, bottom_rise(design))
        return any(ring.stretch > CLOTH_GIVES for ring in rings)
    except PatternError:  # drawing the garment reports it
        return False


def broken_by_weight(size: Measurements, design: GarmentDesign) -> str:
    """The rule that the weight of a garment breaks; empty if it breaks none."""
    try:
        load, stretch = hip_load(size, design), strap_stretch(size, design)
    except PatternError:  # drawing the garment reports it
        return ""
    if load is not None and load.slides:
        return "overloaded_hips"
    return "overloaded_straps" if stretch > STRAPS_GIVE else ""


def _fault(garment: DrawnGarment, name: str, selects: Callable[[Rule], bool]) -> Reject | None:
    for fault in garment.faults:
        if selects(fault.rule):
            return Reject(name, str(fault))
    return None


def _is_bottom_alone(design: GarmentDesign) -> bool:
    return design.meta.upper is None and design.meta.bottom is not None
