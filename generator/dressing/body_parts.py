"""Label panels with the part of the body that they cover, by their placement."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import shapely

from gcd_dataset.generator.dressing.openings import panel_outline
from gcd_dataset.generator.dressing.wearer import Wearer
from gcd_dataset.records import BodyPart, Panel, PanelRole, Pattern
from gcd_dataset.spec import role_by_name

ASIDE = 0.1  # share of the trunk's half width: a panel nearer to the middle is not on an arm
BESIDE = 20.0  # cm, largest distance from an arm's axis, across it, to the centroid of a panel on the arm
BEFORE = 28.0  # cm, largest distance before or behind the arm's axis: lapels, further out, are on the trunk
BEYOND = 25.0  # cm, largest distance beyond the end of an arm: cuffs are placed there before sewing
ABOVE_WAIST = 15.0  # cm: largest height of a skirt's panel above the waist
ABOVE_CROTCH = 4.0  # cm above the crotch: a tall panel that ends higher covers the trunk
BAND = 24.0  # cm: a panel above this height counts as tall
UNDER_CROTCH = 2.0  # cm below the crotch: a short panel that ends higher is a band and covers the trunk
POSITIONS = {
    PanelRole.ARM: "beside an arm",
    PanelRole.LEG: "round hips and legs",
    PanelRole.BODY: "round the trunk",
}


def label_panels(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern with a label on every panel, and a sentence for each kind of added label."""
    found = {panel.name: _covered_part(panel, wearer) for panel in pattern.panels if not panel.label}
    found = _relabel_skirts(found, pattern)
    panels = tuple(replace(panel, label=found.get(panel.name, panel.label)) for panel in pattern.panels)
    return replace(pattern, panels=panels), tuple(describe_labels(found))


def _relabel_skirts(found: Mapping[str, PanelRole], pattern: Pattern) -> dict[str, PanelRole]:
    """The labels, with arm panels sewn to leg panels relabelled as legs: a wide skirt reaches beside the arms."""
    parts = {panel.name: found.get(panel.name, panel.label) for panel in pattern.panels}
    while True:
        sewn = [
            (a, b) for s in pattern.seams for a, b in ((s.left.panel, s.right.panel), (s.right.panel, s.left.panel))
        ]
        skirts = {a for a, b in sewn if a in found and parts[a] == PanelRole.ARM and parts[b] == PanelRole.LEG}
        if not skirts:
            return {name: PanelRole(parts[name]) for name in found}
        parts |= dict.fromkeys(skirts, PanelRole.LEG)


def _covered_part(panel: Panel, wearer: Wearer) -> PanelRole:
    """The part of the body that a panel covers, by its placement alone, whatever its name."""
    return PanelRole.ARM if _is_on_arm(panel, wearer) else trunk_part(panel, wearer)


def trunk_part(panel: Panel, wearer: Wearer) -> PanelRole:
    """``LEG`` or ``BODY``, for a panel that is on no arm."""
    heights = panel.placement.apply(panel_outline(panel))[:, 1]
    low, high = heights.min(), heights.max()
    is_band = low > wearer.crotch + (ABOVE_CROTCH if high - low > BAND else -UNDER_CROTCH)
    return PanelRole.BODY if high > wearer.waist + ABOVE_WAIST or is_band else PanelRole.LEG


def _is_on_arm(panel: Panel, wearer: Wearer) -> bool:
    flat = panel_outline(panel)
    points = panel.placement.apply(flat)
    centroid = panel.placement.apply(np.array(shapely.Polygon(flat).centroid.coords[0]))
    side = np.sign(centroid[0])
    arm = wearer.limbs.get(BodyPart.LEFT_ARM if side > 0 else BodyPart.RIGHT_ARM)
    aside = (side * points[:, 0]).min() > ASIDE * wearer.limbs[BodyPart.TRUNK].wide
    if arm is None or not aside or centroid[1] > wearer.nape:  # hoods and collars stand beside the head
        return False
    across, along, forward = np.abs(arm.local(centroid))
    half = float(np.ptp(arm.skin @ arm.axis)) / 2
    return bool(across < BESIDE and along < half + BEYOND and forward < BEFORE)


def describe_labels(found: Mapping[str, PanelRole | str]) -> Iterator[str]:
    """A sentence for each part of the body with its newly labelled panels."""
    for part in POSITIONS:
        names = [name for name, label in found.items() if label == part]
        if names:
            panels = f"panel {names[0]} has" if len(names) == 1 else f"panels {', '.join(names)} have"
            odd = [name for name in names if role_by_name(name) not in (None, part)]
            hint = f"; the names suggest another part for {', '.join(odd)}" if odd else ""
            yield f"{panels} no label: assumed to cover {part}, from the position {POSITIONS[part]}{hint}"
