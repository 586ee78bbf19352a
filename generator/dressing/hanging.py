"""Hang the panels of a lay plan round a body, by their seams.

First the panels are laid on a table and joined along their seams one after the other, as the garment lies when folded
flat: front over back. A panel with its right side to the table belongs to the back. The two sides of a seam between
front and back then coincide; a seam within a layer joins neighbours. Then the front is placed before the body and the
back behind it, at the height that the openings determine, with the sleeves along the arms.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from jaxtyping import Complex, Float

from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.dressing.frame import Wearer, height_for, placed_outline
from gcd_dataset.generator.dressing.openings import edge_points, middle_of, openings_of, panel_outline
from gcd_dataset.records import BodyPart, Closure, Panel, PanelRole, Pattern, Placement, Seam
from gcd_dataset.spec import role_by_name

ASIDE = 0.1  # share of the trunk's half width: a panel nearer to the middle is not on an arm
BESIDE = 20.0  # cm, largest distance from an arm's axis, across it, to the centroid of a panel on the arm
BEFORE = 28.0  # cm, largest distance before or behind the arm's axis: lapels, further out, are on the trunk
BEYOND = 25.0  # cm, largest distance beyond the end of an arm: cuffs are placed there before sewing
ABOVE_WAIST = 15.0  # cm: largest height of a skirt's panel above the waist
ABOVE_CROTCH = 4.0  # cm above the crotch: a tall panel that ends higher covers the trunk
BAND = 24.0  # cm: a panel above this height counts as tall
UNDER_CROTCH = 2.0  # cm below the crotch: a short panel that ends higher is a band and covers the trunk
POSITIONS = {PanelRole.ARM: "beside an arm", PanelRole.LEG: "round hips and legs", PanelRole.BODY: "round the trunk"}


def label_panels(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern with a label on every panel, and a sentence for each kind of added label."""
    found = {
        panel.name: PanelRole.ARM if _is_on_arm(panel, wearer) else trunk_part(panel, wearer)
        for panel in pattern.panels
        if not panel.label
    }
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


def trunk_part(panel: Panel, wearer: Wearer) -> PanelRole:
    """``LEG`` or ``BODY``, for a panel that is on no arm."""
    heights = placed_outline(panel)[:, 1]
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


ON_SEAM = 9  # points of a seam, for aligning its two sides
CLOSED = 12.0  # cm: a seam closes if the mean distance between its sides on the table is smaller
UPRIGHT = 5.0  # cm: a panel stays upright if turning it would close its seams by less than this
SURE = 0.9  # least share of the seams' length that closes in an accepted layout
GAP = 8.0  # cm between the body and the panels before and behind it
OVER = 0.2  # share of the smaller panel: two panels of a layer that overlap by more are hung one outside the other
STEP = 5.0  # cm between panels hung one outside the other
ARMHOLE = 4.0  # cm from the armpit down to the centre of an armhole, as GarmentCode hangs bodices
SLEEVE_REACH = 0.8  # share of the trunk's half width: a sleeve's centroid lies further from the middle
SLEEVE_DROP = 60.0  # cm, largest distance of a sleeve's centroid below the highest centroid


@dataclass(frozen=True, eq=False)
class _FlatPanel:
    """A panel on the table: drawing points times ``turn`` (a unit complex number) plus ``shift`` [cm]."""

    panel: Panel
    back: bool
    mirrored: bool  # drawn as seen from behind, and so turned over on the table
    turn: complex = 1.0
    shift: complex = 0.0

    def points(self, flat: Float[np.ndarray, "n 2"]) -> Complex[np.ndarray, " n"]:
        drawn = (-flat[:, 0] if self.mirrored else flat[:, 0]) + 1j * flat[:, 1]
        return np.asarray(self.turn * drawn + self.shift)

    def edge(self, index: int) -> Complex[np.ndarray, " n"]:
        ends = self.panel.edge_ends(index)
        return self.points(sample_curve(*ends, self.panel.edge(index).curve, ON_SEAM))

    @functools.cached_property
    def polygon(self) -> shapely.Polygon:
        points = self.points(panel_outline(self.panel))
        return shapely.make_valid(shapely.Polygon(np.stack([points.real, points.imag], axis=1)))


def hang_from_lay_plan(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern placed round the wearer, and sentences on the placement and on added labels.

    Raises ``PatternError`` for panels that no seam joins to the rest, and for a layout whose seams do not close.
    """
    table = _join_on_table([_flat_panel(panel) for panel in pattern.panels], pattern)
    closed = _closed_share(table, pattern)
    if closed < SURE:
        raise PatternError(
            f"pattern {pattern.name}: its panels lie in one plane, and their seams do not determine their positions "
            f"(only {closed:.0%} of the seams' length would close): give each panel a translation and a rotation"
        )
    hung = _hang(table, pattern, wearer)
    backs = [flat_panel.panel.name for flat_panel in table.values() if flat_panel.back]
    return hung, (
        f"the panels lay in one plane: placed by their seams, {', '.join(backs) or 'none'} behind the body, the others "
        f"before it; {closed:.0%} of the seams' length closes",
        *describe_labels({p.name: hung.panel(p.name).label for p in pattern.panels if not p.label}),
    )


def _flat_panel(panel: Panel) -> _FlatPanel:
    """A panel on the table: a back if its right side faces the table."""
    facing = 1.0 if shapely.LinearRing(panel_outline(panel)).is_ccw else -1.0
    turned = panel.placement.matrix[2, 2] < -0.5
    return _FlatPanel(panel, back=facing * (-1.0 if turned else 1.0) < 0, mirrored=bool(turned))


def _join_on_table(table: Sequence[_FlatPanel], pattern: Pattern) -> dict[str, _FlatPanel]:
    """The panels joined along their seams: the largest, then always the one with the longest seams to one of these."""
    waiting = {flat_panel.panel.name: flat_panel for flat_panel in table}
    lengths = {panel.name: panel.lengths() for panel in pattern.panels}
    first = max(
        waiting.values(),
        key=lambda flat_panel: (role_by_name(flat_panel.panel.name) is not PanelRole.ARM, flat_panel.polygon.area),
    )
    joined = {first.panel.name: waiting.pop(first.panel.name)}
    while waiting:
        shared: dict[tuple[str, str], list[Seam]] = {}
        for seam in pattern.seams:
            for side, other in ((seam.left, seam.right), (seam.right, seam.left)):
                if side.panel in waiting and other.panel in joined:
                    shared.setdefault((side.panel, other.panel), []).append(seam)
        if not shared:
            raise PatternError(
                f"pattern {pattern.name}: its panels lie in one plane, and no seam joins {', '.join(sorted(waiting))} "
                "to the rest: give each panel a translation and a rotation, or add the stitches"
            )

        seam_lengths = {
            pair: sum(lengths[ref.panel][ref.edge] for seam in seams for ref in (seam.left, seam.right))
            for pair, seams in shared.items()
        }
        (name, beside), _ = max(seam_lengths.items(), key=lambda entry: (entry[1], entry[0][0]))
        joined[name] = _align(waiting.pop(name), joined[beside], shared[name, beside])
    return joined


def _align(flat_panel: _FlatPanel, beside: _FlatPanel, seams: Sequence[Seam]) -> _FlatPanel:
    """The panel turned and moved to align its seams with those of the panel beside it, in the least-squares sense."""
    name = flat_panel.panel.name
    table = {name: flat_panel, beside.panel.name: beside}
    sides = [
        _seam_points(seam, table)[:: 1 if seam.left.panel == name else -1]  # the panel's own side first
        for seam in seams
    ]
    ours, theirs = (np.concatenate(points) for points in zip(*sides, strict=True))
    correlation = np.vdot(ours - ours.mean(), theirs - theirs.mean())
    turn = complex(correlation / abs(correlation)) if abs(correlation) > 0 else 1.0 + 0.0j
    gaps = [np.abs(t * (ours - ours.mean()) - theirs + theirs.mean()).mean() for t in (1.0, turn)]
    if gaps[0] < gaps[1] + UPRIGHT:  # panels other than sleeves are drawn upright
        turn = 1.0 + 0.0j
    return replace(
        flat_panel, turn=turn * flat_panel.turn, shift=complex(turn * (flat_panel.shift - ours.mean()) + theirs.mean())
    )


def _seam_points(
    seam: Seam, table: Mapping[str, _FlatPanel]
) -> tuple[Complex[np.ndarray, " n"], Complex[np.ndarray, " n"]]:
    """The two sides of a seam on the table, point for point."""
    left, right = (table[ref.panel].edge(ref.edge) for ref in (seam.left, seam.right))
    return left, right if seam.right_wrong else right[::-1]


def _closed_share(table: Mapping[str, _FlatPanel], pattern: Pattern) -> float:
    """The share, by length, of the seams between panels that close."""
    closed = total = 0.0
    for seam in pattern.seams:
        if seam.left.panel != seam.right.panel:
            left, right = _seam_points(seam, table)
            length = float(np.abs(np.diff(left)).sum())
            total += length
            gathered = abs(length - float(np.abs(np.diff(right)).sum()))
            closed += length if np.abs(left - right).mean() < CLOSED + gathered / 2 else 0.0
    return closed / total if total else 1.0


def _hang(table: Mapping[str, _FlatPanel], pattern: Pattern, wearer: Wearer) -> Pattern:
    """The garment from the table placed before and behind the body."""
    depths = _depths(table, pattern)

    def placed(panels: Mapping[str, _FlatPanel]) -> Pattern:
        return replace(
            pattern, panels=tuple(_with_placement(panels[p.name], depths[p.name], wearer) for p in pattern.panels)
        )

    flat = placed(table)
    openings = openings_of(flat)
    middle = middle_of(openings)
    sleeves, armholes = _sleeves(flat, middle, wearer)
    if armholes:
        up = wearer.armpit - ARMHOLE - float(np.mean([centre[1] for centre in armholes.values()]))
    else:
        up = height_for(flat, wearer)
    moved = {}
    for name, flat_panel in table.items():
        if name in sleeves:
            flat_panel = _along_arm(flat_panel, armholes[sleeves[name]], sleeves[name], flat, sleeves, wearer)
        moved[name] = replace(flat_panel, shift=flat_panel.shift + complex(-middle, up))
    hung = placed(moved)
    labels = (p.label or (PanelRole.ARM if p.name in sleeves else trunk_part(p, wearer)) for p in hung.panels)
    return replace(hung, panels=tuple(replace(p, label=label) for p, label in zip(hung.panels, labels, strict=True)))


def _depths(table: Mapping[str, _FlatPanel], pattern: Pattern) -> dict[str, float]:
    """Distance of each panel from the innermost layer [cm]: a panel hangs outside those that it overlaps.

    Fronts with buttons hang side by side: the mesh parts their layers.
    """
    buttoned = [{seam.left.panel, seam.right.panel} for seam in pattern.seams if seam.closure == Closure.BUTTONS]
    depths: dict[str, float] = {}
    for name, flat_panel in table.items():
        shape = flat_panel.polygon
        under = [
            depths[other] + STEP
            for other in depths
            if table[other].back == flat_panel.back
            and {name, other} not in buttoned
            and shapely.intersection(shape, table[other].polygon).area
            > OVER * min(shape.area, table[other].polygon.area)
        ]
        depths[name] = max(under, default=0.0)
    return depths


def _with_placement(flat_panel: _FlatPanel, depth: float, wearer: Wearer) -> Panel:
    """The panel with its placement on the body; turned over if it is drawn as seen from behind."""
    trunk = wearer.limbs[BodyPart.TRUNK]
    z = trunk.origin[2] + (-1.0 if flat_panel.back else 1.0) * (trunk.deep + GAP + depth)
    angle = float(np.angle(flat_panel.turn))
    rotation = np.array([0.0, np.pi if flat_panel.mirrored else 0.0, angle])
    return replace(
        flat_panel.panel, placement=Placement(np.array([flat_panel.shift.real, flat_panel.shift.imag, z]), rotation)
    )


def _sleeves(flat: Pattern, middle: float, wearer: Wearer) -> tuple[dict[str, float], dict[float, np.ndarray]]:
    """The side (1 left, -1 right) of each sleeve panel, and per side the centre of the sleeve's armhole seam [cm]."""
    reach = SLEEVE_REACH * wearer.limbs[BodyPart.TRUNK].wide
    centres = {
        p.name: p.placement.apply(np.array(shapely.Polygon(panel_outline(p)).centroid.coords[0])) for p in flat.panels
    }
    top = max(float(c[1]) for c in centres.values())
    aside = {
        name: float(np.sign(c[0] - middle))
        for name, c in centres.items()
        if abs(c[0] - middle) > reach and c[1] > top - SLEEVE_DROP
    }
    armholes: dict[float, np.ndarray] = {}
    for side in set(aside.values()):
        lines = [
            edge_points(flat.panel(ref.panel), ref.edge)
            for seam in flat.seams
            for ref, other in ((seam.left, seam.right), (seam.right, seam.left))
            if aside.get(ref.panel) == side and aside.get(other.panel) != side
        ]
        if lines:
            armholes[side] = np.concatenate(lines).mean(axis=0)
    return {name: side for name, side in aside.items() if side in armholes}, armholes


def _along_arm(
    flat_panel: _FlatPanel,
    armhole: np.ndarray,
    side: float,
    flat: Pattern,
    sleeves: Mapping[str, float],
    wearer: Wearer,
) -> _FlatPanel:
    """A sleeve panel turned about the armhole so that the sleeve points along the arm."""
    arm = wearer.limbs.get(BodyPart.LEFT_ARM if side > 0 else BodyPart.RIGHT_ARM)
    if arm is None:
        return flat_panel
    outlines = np.concatenate([placed_outline(flat.panel(name)) for name, other in sleeves.items() if other == side])
    direction = complex(*(outlines.mean(axis=0) - armhole)[:2])
    if direction == 0:  # skirt panels mistaken for sleeves may be centred on the seam: there is no direction
        return flat_panel
    turn = complex(arm.axis[0], arm.axis[1]) / direction
    turn /= abs(turn)
    about = complex(armhole[0], armhole[1])
    return replace(flat_panel, turn=flat_panel.turn * turn, shift=turn * (flat_panel.shift - about) + about)
