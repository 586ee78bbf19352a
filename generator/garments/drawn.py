"""Facts of a drawn garment: the gathers between its parts, and whether its sides match."""

from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.garments.assembly import bottom_rise
from gcd_dataset.generator.garments.description import HEMS, RUFFLES, CuffGathers, Description, Detail, Setting, Tag
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.pocket import pocket_details
from gcd_dataset.generator.garments.trim import trim_details
from gcd_dataset.records import Measurements, Panel, PanelRole, Pattern

SAME = 0.5  # cm: halves whose panels differ by less are symmetrical
DIGITS = 6  # of measured ratios: rounding errors, which differ between CPUs, decide no style
TORSO, BAND = (
    ("right_ftorso", "right_btorso", "left_ftorso", "left_btorso"),
    ("wb_front", "wb_front_right", "wb_front_left", "wb_back"),
)
ON_LIMBS = ("sleeve", "cuff")
OTHER = "other"


def part_of(panel: Panel) -> str:
    """The part of a garment that a panel belongs to: torso, band, bottom, other, or the name of a sleeve or cuff."""
    if any(name in panel.name for name in ON_LIMBS):
        return panel.name.removesuffix("_f").removesuffix("_b")
    if panel.label == PanelRole.LEG:
        return "bottom"
    return "torso" if panel.name in TORSO else "band" if panel.name in BAND else OTHER


def gather(pattern: Pattern, above: str, below: str) -> float:
    """Length of the lower part's edges over the upper part's, over all seams between them; 1 without such seams."""
    up, down = _boundaries(pattern).get((above, below), (1.0, 1.0))
    return round(down / up, DIGITS)


def gather_below(pattern: Pattern) -> float:
    """Gathers of the bottom: on the waistband, or else on the shirt's hem."""
    return gather(pattern, "band" if any(panel.name in BAND for panel in pattern.panels) else "torso", "bottom")


def cuff_gathers(pattern: Pattern, *, legs: bool) -> Mapping[str, CuffGathers]:
    """Side, "right" or "left", to the gathers of the cuff of its sleeve, or of its trouser leg."""
    found: dict[str, CuffGathers] = {}
    parts = {part_of(panel) for panel in pattern.panels}
    for side in ("right", "left"):
        limb, cuff = ("bottom", f"pant_{side[0]}_cuff") if legs else (f"{side}_sleeve", f"sl_{side}_cuff")
        band, skirt = cuff in parts, f"{cuff}_skirt"
        if band or skirt in parts:
            top, above = (cuff, cuff) if band else (skirt, limb)
            found[side] = CuffGathers(gather(pattern, top, limb), gather(pattern, above, skirt))
    return found


def most_gathered(pattern: Pattern) -> float:
    """Largest ratio of the longer to the shorter side of a boundary between parts, collars left out.

    1 or more. The seams of a boundary count together, since ease moves cloth between front and back.
    """
    sides = (lengths for parts, lengths in _boundaries(pattern).items() if OTHER not in parts)
    return max((round(own / other, DIGITS) for own, other in sides), default=1.0)


def _boundaries(pattern: Pattern) -> dict[tuple[str, str], tuple[float, float]]:
    """Two parts, in either order, to the total lengths of their edges in the seams between them [cm]."""
    lengths = {panel.name: panel.lengths() for panel in pattern.panels}
    parts = {panel.name: part_of(panel) for panel in pattern.panels}
    found: dict[tuple[str, str], tuple[float, float]] = defaultdict(lambda: (0.0, 0.0))
    for seam in pattern.seams:
        for one, other in ((seam.left, seam.right), (seam.right, seam.left)):
            pair = parts[one.panel], parts[other.panel]
            if pair[0] != pair[1]:
                own, others = found[pair]
                found[pair] = own + lengths[one.panel][one.edge], others + lengths[other.panel][other.edge]
    return dict(found)


def sides_match(details: Iterable[Detail], pattern: Pattern) -> bool:
    """Whether left and right are drawn as mirror images, and no detail is on one side only."""
    return not any(detail.sided for detail in details) and _is_symmetrical(pattern)


def _is_symmetrical(pattern: Pattern) -> bool:
    """Whether every panel is its own mirror image or has one on the other side of the body.

    Godets, bands and the panels of a panelled skirt are alike on all sides; their edges may be divided unevenly, where
    a seam of another part ends.
    """
    panels = {panel.name: panel for panel in pattern.panels}
    for name, panel in panels.items():
        if name.startswith(("ins_", "wb_", "skirt_panel_")):
            continue
        other = _mirror_name(name, panels)
        # The corners of one panel are the mirror images of the other's, wherever they lie.
        mine, theirs = _centred(_corners(panel) * [-1.0, 1.0]), _centred(_corners(panels[other]))
        if len(mine) != len(theirs) or np.linalg.norm(mine[:, None] - theirs, axis=2).min(axis=1).max() >= SAME:
            return False
    return True


def _mirror_name(name: str, panels: dict[str, Panel]) -> str:
    """The panel on the other side of the body; the panel itself if there is none."""
    swapped = (
        ("right", "left"), ("left", "right"), ("pant_r_", "pant_l_"), ("pant_l_", "pant_r_"),
        ("pant_f_r", "pant_f_l"), ("pant_f_l", "pant_f_r"), ("pant_b_r", "pant_b_l"), ("pant_b_l", "pant_b_r"),
    )  # fmt: skip
    return next((other for a, b in swapped if a in name and (other := name.replace(a, b)) in panels), name)


def _corners(panel: Panel) -> Float[np.ndarray, "e 2"]:
    """The corners of the outline, without the ends of lines."""
    return panel.vertices[[edge.start for edge in panel.edges]]


def _centred(corners: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, "v 2"]:
    """The corners about the middle of their bounding box."""
    return corners - 0.5 * (corners.min(axis=0) + corners.max(axis=0))


def garment_tags(size: Measurements, design: GarmentDesign, pattern: Pattern) -> tuple[str, ...]:
    """The tags of a garment, drawn for a wearer in ``pattern``, in the order of ``TAGS``, each once."""
    parts = [part for part in described(size, design, pattern) if part]
    found = {_kind(design)} | {tag for part in parts for tag in part.tags}
    details = [detail for part in parts for detail in part.details]
    if most_gathered(pattern) >= RUFFLES:
        found.add(Tag.RUFFLED)
    if len(design.halves()) > 1 and not sides_match(details, pattern):
        found.add(Tag.ASYMMETRIC)
    if design.pockets():
        found.add(Tag.POCKETS)
    if design.meta.bottom:
        found.update([_hem(size, design)] + ([Tag.WAISTBAND] if design.meta.wb else []))
    return tuple(tag.value for tag in Tag if tag in found)


def described(
    size: Measurements, design: GarmentDesign, pattern: Pattern
) -> tuple[Description | None, Description | None]:
    """Upper and bottom in words, as drawn in ``pattern``; ``None`` for one that the garment lacks."""
    meta = design.meta
    above = Setting(size, cuffs=cuff_gathers(pattern, legs=False))
    setting = Setting(size, bottom_rise(design), gather_below(pattern), cuff_gathers(pattern, legs=True))
    chest, back = design.pocket_sides()
    on_front = (*pocket_details("chest", chest, design.pocket.kind), *trim_details(design.worn_trim()))
    return (
        meta.upper.garment.describe(above, design).adding(*on_front) if meta.upper else None,
        meta.bottom.garment.describe(setting, design).adding(*pocket_details("back", back, design.pocket.kind))
        if meta.bottom
        else None,
    )


def _kind(design: GarmentDesign) -> Tag:
    upper, bottom = design.meta.upper, design.meta.bottom
    if bottom is None:
        return Tag.TOP
    if bottom.garment.legs:
        return Tag.JUMPSUIT if upper else Tag.TROUSERS
    return Tag.DRESS if upper else Tag.SKIRT


def _hem(size: Measurements, design: GarmentDesign) -> Tag:
    depth = hem_depth(size, design)
    return next(
        (tag for most, tag in zip(HEMS, (Tag.MINI, Tag.KNEE, Tag.MIDI), strict=True) if depth <= most), Tag.MAXI
    )


def hem_depth(size: Measurements, design: GarmentDesign) -> float:
    """Depth of the lowest hem below the hips, as a fraction of hips to floor."""
    return round((hem_below_waist(size, design) - size.hips_line) / size.leg_length, DIGITS)


def hem_below_waist(size: Measurements, design: GarmentDesign) -> float:
    """Depth of the lowest hem below the waist, the parts hung one under the other, each as long as drawn [cm]."""
    meta, rise = design.meta, bottom_rise(design)
    band = design.waistband.width * size.hips_line if meta.wb else 0.0
    if meta.upper:
        start = meta.upper.garment.length(size, design) - size.waist_line + band
    else:
        start = (1.0 - rise) * size.hips_line
    return start + (meta.bottom.garment.drawn_length(size, design, rise) if meta.bottom else 0.0)
