"""Label the edges that hold a garment up: necklines, strapless tops and waists, found among its openings."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.dressing.frame import Wearer, placed_outline
from gcd_dataset.generator.dressing.openings import ASIDE, Opening, edge_points, openings_of
from gcd_dataset.records import BodyPart, Closure, EdgeRef, EdgeRole, Panel, PanelRole, Pattern
from gcd_dataset.spec import is_trouser_leg

COLLARS = (EdgeRole.RIGHT_COLLAR, EdgeRole.LEFT_COLLAR)
HOLDING = frozenset({*COLLARS, EdgeRole.STRAPLESS_TOP, EdgeRole.LOWER_INTERFACE})
LEGS_WITHIN = 36.0  # cm from the middle to the centre of a leg opening, at most; openings further out belong to sleeves
OVER_WAIST = 12.0  # cm above the waist: a higher top edge belongs to a bodice
BELOW_WAIST = 35.0  # cm below the waist: the lowest top edge of a bottom
ONE_SIDE = 0.2  # share of its width: an edge or panel with its mean further off the middle belongs to one side


def label_edges(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern with labels on the edges that hold it up, and a sentence for each added label.

    A garment that hangs from the shoulders gets collar labels; on other garments the highest opening round the trunk is
    labelled as a strapless top or a waist. Existing labels stay; a garment with such a label gets no further one.
    """
    labels = {edge.label for panel in pattern.panels for edge in panel.edges}
    openings = openings_of(pattern)
    # Arms go through a garment with sleeves, or with an opening beside the trunk above the waist.
    aside = any(abs(o.centre[0]) > ASIDE and o.low[1] > wearer.waist for o in openings)
    if aside or any(panel.label == PanelRole.ARM for panel in pattern.panels):
        if labels & set(COLLARS):
            return pattern, ()
        found = _collars(pattern, openings, wearer)
        named = {label: [ref for ref, given in found.items() if given == label] for label in COLLARS}
        return _labelled(pattern, found), tuple(
            f"{_named(refs)} labelled {label}: arms go through the garment, and these edges lie round the neck"
            for label, refs in named.items()
            if refs
        )
    if labels & HOLDING:
        return pattern, ()
    top = next((o for o in openings if abs(o.centre[0]) < ASIDE and _is_round_trunk(o, wearer)), None)
    if top is None:
        return pattern, (
            "no opening lies round the waist or the bust: nothing holds the garment up; "
            "add the label lower_interface or strapless_top to the edge that should hold it",
        )
    is_bodice = top.centre[1] > wearer.waist + OVER_WAIST
    label = EdgeRole.STRAPLESS_TOP if is_bodice else EdgeRole.LOWER_INTERFACE
    level, landmark = (wearer.armpit, "armpits") if is_bodice else (wearer.waist, "waist")
    return _labelled(pattern, dict.fromkeys(top.edges, label)), (
        f"{_named(top.edges)} labelled {label}: the highest opening round the trunk, {top.length:.0f} cm long, "
        f"{top.centre[1] - level:+.0f} cm from the {landmark}",
    )


def has_legs(pattern: Pattern) -> bool:
    """Whether the garment has two legs, so that it must be draped on a body with its legs apart.

    Decided by the names of its panels, or by its openings: a low one on each side, and exactly one round the middle,
    above these.
    """
    if any(is_trouser_leg(panel.name) for panel in pattern.panels):
        return True
    openings = openings_of(pattern)
    middle = [o for o in openings if abs(o.centre[0]) < ASIDE]
    low = [o for o in openings if ASIDE <= abs(o.centre[0]) < LEGS_WITHIN and all(o.high[1] < m.low[1] for m in middle)]
    return len(middle) == 1 and {bool(o.centre[0] > 0) for o in low} == {True, False}


def _is_round_trunk(opening: Opening, wearer: Wearer) -> bool:
    wide = opening.low[0] < 0 < opening.high[0]
    deep = opening.high[2] - opening.low[2] > wearer.limbs[BodyPart.TRUNK].deep
    return bool(wide and deep and wearer.waist - BELOW_WAIST < opening.centre[1] < wearer.nape)


def _collars(pattern: Pattern, openings: tuple[Opening, ...], wearer: Wearer) -> dict[EdgeRef, EdgeRole]:
    """The edges of the neckline with their collar labels; edges across the middle and of an open seam get none."""
    # Hoods and collars: most of them lies above the nape.
    necks = {panel.name for panel in pattern.panels if np.median(placed_outline(panel)[:, 1]) > wearer.nape}
    sewn = {side: other for s in pattern.seams for side, other in ((s.left, s.right), (s.right, s.left))}
    ends = [ref for ref, other in sewn.items() if ref.panel not in necks and other.panel in necks]
    for opening in openings:
        if abs(opening.centre[0]) < ASIDE:
            ends += [ref for ref in opening.edges if ref.panel not in necks]
    opened = {side for seam in pattern.seams if seam.closure == Closure.OPEN for side in (seam.left, seam.right)}
    found = {}
    for ref in (ref for ref in ends if ref not in opened):
        line = edge_points(pattern.panel(ref.panel), ref.edge)
        if pattern.panel(ref.panel).label != PanelRole.BODY or line[:, 1].max() < wearer.waist + OVER_WAIST:
            continue
        side = _side(line[:, 0]) or _side(placed_outline(pattern.panel(ref.panel))[:, 0])
        if side:
            found[ref] = COLLARS[int(side > 0)]
    return found


def _side(x: Float[np.ndarray, " n"]) -> float:
    """1 for points on the wearer's left, -1 on the right, 0 across the middle."""
    middle = float(x.mean())
    return float(np.sign(middle)) if abs(middle) > ONE_SIDE * float(np.ptp(x)) else 0.0


def _labelled(pattern: Pattern, found: dict[EdgeRef, EdgeRole]) -> Pattern:
    def labelled(panel: Panel) -> Panel:
        edges = tuple(
            replace(edge, label=edge.label or found.get(EdgeRef(panel.name, i), ""))
            for i, edge in enumerate(panel.edges)
        )
        return replace(panel, edges=edges)

    return replace(pattern, panels=tuple(map(labelled, pattern.panels)))


def _named(refs: Iterable[EdgeRef]) -> str:
    """Edges by panel: ``edges 1, 3 of front and edge 2 of back``."""
    by_panel: dict[str, list[int]] = {}
    for ref in refs:
        by_panel.setdefault(ref.panel, []).append(ref.edge)
    texts = [
        f"edge{'s' if len(edges) > 1 else ''} {', '.join(map(str, sorted(edges)))} of {panel}"
        for panel, edges in by_panel.items()
    ]
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)
