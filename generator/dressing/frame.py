"""The frame of a pattern: whether a garment is placed where it is worn, by the edge that holds it up.

Some data sets put the origin at the pelvis or the neck instead of the floor between the feet. A garment whose holding
edge is placed where nobody wears it is moved as a whole.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.limbs import Limb, limbs_of
from gcd_dataset.generator.dressing.openings import ASIDE, Opening, edge_points, middle_of, openings_of, panel_outline
from gcd_dataset.records import Body, BodyPart, EdgeRole, Measurements, Panel, PanelRole, Pattern, Placement
from gcd_dataset.spec import is_bodice, role_by_name


@dataclass(frozen=True, eq=False)
class Wearer:
    """A body with levels above the floor [cm] and limbs."""

    nape: float
    armpit: float
    waist: float
    hips: float
    crotch: float
    limbs: Mapping[BodyPart, Limb]
    body: Body


def wearer_of(body: Body, size: Measurements) -> Wearer:
    """The levels and limbs of a body. Raises ``BodyError`` for a missing measure or a body without a trunk."""
    size.require("height", "head_l", "waist_line", "hips_line", "armscye_depth", "crotch_hip_diff")
    nape = size.height - size.head_l
    return Wearer(
        nape=nape,
        armpit=nape - size.armscye_depth,
        waist=size.waist_level,
        hips=size.waist_level - size.hips_line,
        crotch=size.waist_level - size.hips_line - size.crotch_hip_diff,
        limbs=limbs_of(body),
        body=body,
    )


UNDER_NAPE = 5.0  # cm from the nape down to the highest point of a neckline, as GarmentCode hangs bodices
OVER = 20.0  # cm above the height at which an edge is worn: the highest place of one for a taller wearer
UNDER_NECK = 4.0  # cm below that: shoulders sewn lower slide under the arms
UNDER_ARMPIT = 3.0  # cm below the armpits: the lowest place of a neckline off the shoulders
UNDER_HIPS = 4.0  # cm below the hips: the lowest place of a waist
TALLER = 10.0  # cm: a shift up to this one may only mean that the pattern was cut for a shorter wearer
OVER_HEAD = 40.0  # cm above the head: the highest place of a hood, before it is sewn
WIDE = 31.0  # cm: an opening or a garment that goes round the trunk is wider, a hat is not
ABOVE_NECKLINE = ("hood", "collar", "lapel")  # parts of the names of panels above the neckline
SLEEVES = ("sleeve", "sl_")  # parts of the names of panels round an arm
WAISTBANDS = ("wb", "waist")  # parts of the names of panels above a skirt or trousers
DIRECTIONS = (("left", "right"), ("up", "down"), ("forward", "back"))


@dataclass(frozen=True)
class _Support:
    """The edge that holds a garment up: the height of its highest point as placed, and as worn [cm].

    ``lowest`` and ``highest`` bound the heights at which a pattern places it on purpose.
    """

    name: str
    height: float
    level: float
    lowest: float
    highest: float


def in_body_frame(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The garment moved as a whole to where it is worn, and a sentence, if it is placed above, below or beside that."""
    by = _to_trunk(pattern, wearer)
    support = _support(pattern, wearer, middle=float(wearer.limbs[BodyPart.TRUNK].origin[0] - by[0]))
    if not support.lowest <= support.height <= support.highest:
        by[1] = support.level - support.height
    if not by.any():
        return pattern, ()
    steps = [f"{abs(step):.0f} cm {words[int(step < 0)]}" for step, words in zip(by, DIRECTIONS, strict=True) if step]
    place = f"its {support.name} hung {support.height:.0f} cm high, and is worn at {support.level:.0f} cm"
    if not by[1]:
        place = f"it hung {np.linalg.norm(by):.0f} cm beside the body"
    advice = "; the origin belongs on the floor, between the feet" if np.linalg.norm(by) > TALLER else ""
    return replace(pattern, panels=tuple(moved(panel, by) for panel in pattern.panels)), (
        f"the garment is moved {' and '.join(steps)}: {place}{advice}",
    )


def height_for(pattern: Pattern, wearer: Wearer) -> float:
    """Vertical shift [cm] that brings the neckline to the nape, or the top edge to the armpits or the waist."""
    support = _support(pattern, wearer, middle=middle_of(openings_of(pattern)))
    return support.level - support.height


def placed_outline(panel: Panel) -> Float[np.ndarray, "n 3"]:
    """Points along all edges of a panel, in space [cm]."""
    return panel.placement.apply(panel_outline(panel))


def moved(panel: Panel, by: Float[np.ndarray, "3"]) -> Panel:
    return replace(panel, placement=Placement(panel.placement.translation + by, panel.placement.rotation))


def _support(pattern: Pattern, wearer: Wearer, *, middle: float) -> _Support:
    """The edge that holds a garment up, found by labels, names and openings, whatever its height.

    ``middle``: x of the garment's plane of symmetry [cm].
    """
    panels, openings, roles = pattern.panels, openings_of(pattern), {}
    for panel in panels:
        roles[panel.name] = panel.label or role_by_name(panel.name)
    neck, armpit, waist = wearer.nape - UNDER_NAPE, wearer.armpit, wearer.waist
    hips, head = wearer.hips - UNDER_HIPS, float(wearer.body.vertices[:, 1].max())
    collar = _labelled(pattern, EdgeRole.LEFT_COLLAR, EdgeRole.RIGHT_COLLAR)
    if collar is None and (strapless := _labelled(pattern, EdgeRole.STRAPLESS_TOP)) is not None:
        return _Support("top edge", strapless, armpit, waist, armpit + OVER)
    inner = [o for o in openings if abs(o.centre[0] - middle) <= ASIDE]
    trunk = {
        p.name for p in panels if roles[p.name] not in (PanelRole.ARM, PanelRole.LEG) and not _has(p, ABOVE_NECKLINE)
    }
    named = any(roles[name] == PanelRole.BODY for name in trunk)
    round_top = trunk if named else {ref.panel for o in inner[:1] for ref in o.edges} or set(roles)
    heights = np.concatenate([placed_outline(panel)[:, 1] for panel in panels if panel.name in round_top])
    top, low = float(heights.max()), float(heights.min())
    arms = [
        o
        for o in openings
        if _is_armhole(o, openings, middle) and all(roles[e.panel] != PanelRole.LEG for e in o.edges)
    ]
    if collar is not None or arms or any(p.label == PanelRole.ARM or _has(p, SLEEVES) for p in panels):
        if collar is not None:
            return _Support("neckline", collar, neck, neck - UNDER_NECK, neck + OVER)
        off_shoulders = bool(inner) and float(inner[0].high[0] - inner[0].low[0]) > WIDE
        lowest = armpit - UNDER_ARMPIT if off_shoulders else neck - UNDER_NECK
        unsure = not named and (not arms or any(hole.centre[1] < wearer.nape for hole in arms))
        highest = head + OVER_HEAD if unsure else neck + OVER  # without names a hood looks like a bodice
        return _Support("neckline", top, neck, lowest, highest)
    if (waistline := _labelled(pattern, EdgeRole.LOWER_INTERFACE)) is not None:
        return _Support("waist", waistline, waist, hips, waist + OVER)
    if any(is_bodice(panel.name) and roles[panel.name] != PanelRole.LEG for panel in panels):
        return _Support("top edge", top, armpit, waist, neck + OVER)
    if all(roles[panel.name] == PanelRole.LEG or _has(panel, WAISTBANDS) for panel in panels):
        return _Support("waist", top, waist, hips, waist + OVER)
    if openings and _goes_round(np.stack([openings[0].low, openings[0].high]), wearer):
        return _Support("top edge", float(openings[0].high[1]), waist, hips, neck + OVER)
    return _Support("top", top, waist + top - float(heights.mean()), 0.0, head + top - low)


def _is_armhole(opening: Opening, openings: Sequence[Opening], middle: float) -> bool:
    """Whether an arm goes through an opening: it is beside the middle, and the garment is open below it as well.

    That is, at neck and hem, or lower on the same side.
    """
    aside = opening.centre[0] - middle
    inner = sum(abs(o.centre[0] - middle) <= ASIDE for o in openings)
    across = any(o.low[0] < middle < o.high[0] for o in openings)  # unlike leg warmers
    below = (o for o in openings if o.centre[1] < opening.centre[1] - ASIDE)
    reach = max((np.sign(aside) * (x - middle) for o in below for x in (o.low[0], o.high[0])), default=0.0)
    return bool(abs(aside) > ASIDE and across and (inner > 1 or reach > ASIDE))


def _to_trunk(pattern: Pattern, wearer: Wearer) -> Float[np.ndarray, "3"]:
    """The horizontal shift [cm] of a garment round the trunk that is placed beside it; zeros for others."""
    points = np.concatenate([placed_outline(panel) for panel in pattern.panels])
    low, high, axis = points.min(axis=0), points.max(axis=0), wearer.limbs[BodyPart.TRUNK].origin
    beside = ((axis < low) | (axis > high)) & [True, False, True]
    return np.where(beside & _goes_round(points, wearer), axis - 0.5 * (low + high), 0.0)


def _goes_round(points: Float[np.ndarray, "n 3"], wearer: Wearer) -> bool:
    wide, _, deep = np.ptp(points, axis=0)
    return bool(wide > WIDE and deep > wearer.limbs[BodyPart.TRUNK].deep)


def _labelled(pattern: Pattern, *labels: EdgeRole) -> float | None:
    """The highest point of the edges with these labels [cm]; ``None`` without such edges."""
    edges = (
        (panel, index) for panel in pattern.panels for index, edge in enumerate(panel.edges) if edge.label in labels
    )
    return max((float(edge_points(panel, index)[:, 1].max()) for panel, index in edges), default=None)


def _has(panel: Panel, words: tuple[str, ...]) -> bool:
    return any(word in panel.name.lower() for word in words)
