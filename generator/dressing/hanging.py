"""Panels from a lay plan hung round a body, by how they are sewn.

The garment is first laid flat on a table as it would be worn, front over back: panels are joined along their seams, one
after the other. A panel whose right side faces the table is a back; seams between front and back then lie on each
other, seams within a layer side by side. The flat garment is set before and behind the body by its openings, its
sleeves along the arms.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from jaxtyping import Complex, Float

from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.dressing.body_parts import describe_labels, trunk_part
from gcd_dataset.generator.dressing.openings import Opening, edge_points, openings_of, panel_outline
from gcd_dataset.generator.dressing.wearer import Wearer
from gcd_dataset.records import BodyPart, Panel, PanelRole, Pattern, Placement, Seam
from gcd_dataset.spec import is_bodice, role_by_name

__all__ = ["hang_from_lay_plan", "height_for"]

ON_SEAM = 9  # points of a seam that are laid on each other
CLOSED = 12.0  # cm between the sides of a seam on the table, at most, for it to count as closed
UPRIGHT = 5.0  # cm by which a seam may close less well for its panel to stay upright
SURE = 0.9  # share of the seams' length that must close for a layout to be trusted
GAP = 8.0  # cm between the body and the panels before and behind it
OVER = 0.2  # share of a panel that covers another of its layer, from which it is hung further out
STEP = 5.0  # cm further out
ARMHOLE = 4.0  # cm of an armhole's middle below the armpit, as GarmentCode hangs bodices
UNDER_NAPE = 5.0  # cm of the highest point of a neckline below the nape, as GarmentCode hangs bodices
PAIRED = 40  # openings that are compared pair by pair, the longest; a garment has up to ten
UNPAIRED = 15.0  # cm that an opening without a counterpart counts
ASIDE = 8.0  # cm from the middle: the centre of an opening further out is that of an arm or a leg


@dataclass(frozen=True, eq=False)
class _Laid:
    """A panel on the table: turned by ``turn`` (a unit complex number), then moved by ``shift`` [cm]."""

    panel: Panel
    back: bool
    mirrored: bool
    """Drawn as seen from behind, so turned over on the table."""
    turn: complex = 1.0
    shift: complex = 0.0

    def points(self, flat: Float[np.ndarray, "n 2"]) -> Complex[np.ndarray, " n"]:
        drawn = (-flat[:, 0] if self.mirrored else flat[:, 0]) + 1j * flat[:, 1]
        return np.asarray(self.turn * drawn + self.shift)

    def edge(self, index: int) -> Complex[np.ndarray, " n"]:
        ends = self.panel.edge_ends(index)
        return self.points(sample_curve(*ends, self.panel.edges[index].curve, ON_SEAM))

    @functools.cached_property
    def polygon(self) -> shapely.Polygon:
        points = self.points(panel_outline(self.panel))
        return shapely.make_valid(shapely.Polygon(np.stack([points.real, points.imag], axis=1)))


def hang_from_lay_plan(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern hung round the wearer, and a sentence on how sure its places are.

    Raises ``PatternError`` for panels that no seams join to the rest, and where the seams do not close.
    """
    table = _joined([_laid(panel) for panel in pattern.panels], pattern)
    closed = _closed_share(table, pattern)
    if closed < SURE:
        raise PatternError(
            f"pattern {pattern.name}: its panels lie in one plane, and their places cannot be told from their seams "
            f"({closed:.0%} of the seams' length would close): give each panel a translation and a rotation"
        )
    hung = _hang(table, pattern, wearer)
    backs = [laid.panel.name for laid in table.values() if laid.back]
    return hung, (
        f"the panels lay in one plane: hung by their seams, {', '.join(backs) or 'none'} behind the body, the others "
        f"before it; {closed:.0%} of the seams' length closes so",
        *describe_labels({p.name: hung.panel(p.name).label for p in pattern.panels if not p.label}),
    )


# ------------------------------------------------------------------------------------------------------- on the table


def _laid(panel: Panel) -> _Laid:
    """A panel as it lies: a back where its right side faces the table."""
    facing = 1.0 if shapely.LinearRing(panel_outline(panel)).is_ccw else -1.0
    turned = panel.placement.matrix[2, 2] < -0.5
    return _Laid(panel, back=facing * (-1.0 if turned else 1.0) < 0, mirrored=bool(turned))


def _joined(table: Sequence[_Laid], pattern: Pattern) -> dict[str, _Laid]:
    """The panels joined along their seams: from the largest on, always the one with the longest seam to those laid."""
    waiting = {laid.panel.name: laid for laid in table}
    lengths = {panel.name: panel.edge_lengths() for panel in pattern.panels}
    first = max(
        waiting.values(), key=lambda laid: (role_by_name(laid.panel.name) is not PanelRole.ARM, laid.polygon.area)
    )
    done = {first.panel.name: waiting.pop(first.panel.name)}
    while waiting:
        shared: dict[tuple[str, str], list[Seam]] = {}
        for seam in pattern.seams:
            for here, there in ((seam.left, seam.right), (seam.right, seam.left)):
                if here.panel in waiting and there.panel in done:
                    shared.setdefault((here.panel, there.panel), []).append(seam)
        if not shared:
            raise PatternError(
                f"pattern {pattern.name}: its panels lie in one plane, and no seam joins {', '.join(sorted(waiting))} "
                "to the rest: give each panel a translation and a rotation, or add the stitches"
            )

        def sewn(pair: tuple[str, str], seams: Mapping[tuple[str, str], list[Seam]] = shared) -> tuple[float, str]:
            return sum(lengths[ref.panel][ref.edge] for s in seams[pair] for ref in (s.left, s.right)), pair[0]

        name, beside = max(shared, key=sewn)
        done[name] = _fitted(waiting.pop(name), done[beside], shared[name, beside])
    return done


def _fitted(laid: _Laid, beside: _Laid, seams: Sequence[Seam]) -> _Laid:
    """A panel turned and moved so that its seams lie on those of the panel beside it, as well as they can."""
    sides = [_sides(seam, {laid.panel.name: laid, beside.panel.name: beside}) for seam in seams]
    ours = np.concatenate(
        [a if seam.left.panel == laid.panel.name else b for seam, (a, b) in zip(seams, sides, strict=True)]
    )
    theirs = np.concatenate(
        [b if seam.left.panel == laid.panel.name else a for seam, (a, b) in zip(seams, sides, strict=True)]
    )
    lean = np.vdot(ours - ours.mean(), theirs - theirs.mean())
    turn = complex(lean / abs(lean)) if abs(lean) > 0 else 1.0 + 0.0j
    gaps = [np.abs(t * (ours - ours.mean()) - theirs + theirs.mean()).mean() for t in (1.0, turn)]
    if gaps[0] < gaps[1] + UPRIGHT:  # panels are drawn as they are worn, sleeves apart
        turn = 1.0 + 0.0j
    return replace(laid, turn=turn * laid.turn, shift=complex(turn * (laid.shift - ours.mean()) + theirs.mean()))


def _sides(seam: Seam, table: Mapping[str, _Laid]) -> tuple[Complex[np.ndarray, " n"], Complex[np.ndarray, " n"]]:
    """The two sides of a seam on the table, point for point."""
    left, right = (table[ref.panel].edge(ref.edge) for ref in (seam.left, seam.right))
    return left, right if seam.right_wrong else right[::-1]


def _closed_share(table: Mapping[str, _Laid], pattern: Pattern) -> float:
    """The share of the seams between panels that close, by length."""
    closed = total = 0.0
    for seam in pattern.seams:
        if seam.left.panel != seam.right.panel:
            left, right = _sides(seam, table)
            length = float(np.abs(np.diff(left)).sum())
            total += length
            gathered = abs(length - float(np.abs(np.diff(right)).sum()))
            closed += length if np.abs(left - right).mean() < CLOSED + gathered / 2 else 0.0
    return closed / total if total else 1.0


# ------------------------------------------------------------------------------------------------------- on the body


def _hang(table: Mapping[str, _Laid], pattern: Pattern, wearer: Wearer) -> Pattern:
    """The garment from the table before and behind the body."""
    depths = _depths(table)

    def hung(given: Mapping[str, _Laid]) -> Pattern:
        return replace(pattern, panels=tuple(_placed(given[p.name], depths[p.name], wearer) for p in pattern.panels))

    flat = hung(table)
    openings = openings_of(flat)
    middle = _middle(openings)
    sleeves, holes = _sleeves(flat, middle, wearer)
    if holes:
        up = wearer.armpit - ARMHOLE - float(np.mean([hole[1] for hole in holes.values()]))
    else:
        up = height_for(openings, pattern, wearer)
    moved = {}
    for name, laid in table.items():
        if name in sleeves:
            laid = _along_arm(laid, holes[sleeves[name]], sleeves[name], flat, sleeves, wearer)
        moved[name] = replace(laid, shift=laid.shift + complex(-middle, up))
    placed = hung(moved)
    return replace(placed, panels=tuple(_labelled(panel, panel.name in sleeves, wearer) for panel in placed.panels))


def _labelled(panel: Panel, on_arm: bool, wearer: Wearer) -> Panel:
    return replace(panel, label=panel.label or (PanelRole.ARM if on_arm else trunk_part(panel, wearer)))


def height_for(openings: Sequence[Opening], pattern: Pattern, wearer: Wearer) -> float:
    """How far up a garment must go: its neckline to the nape, or its top edge to the armpits or the waist [cm]."""
    if not openings:
        heights = np.concatenate([panel.placement.apply(panel_outline(panel))[:, 1] for panel in pattern.panels])
        return wearer.waist - float(heights.mean())
    middle = _middle(openings)
    if any(_goes_through_arm(o, openings, middle) for o in openings):
        inner = [o for o in openings if abs(o.centre[0] - middle) < ASIDE] or list(openings)
        return wearer.nape - UNDER_NAPE - max(float(o.high[1]) for o in inner)
    return (wearer.armpit if _is_bodice(openings[0]) else wearer.waist) - float(openings[0].centre[1])


def _is_bodice(top: Opening) -> bool:
    """Whether the panels round the highest opening are a bodice's, by name: a skirt's may look the same."""
    return all(is_bodice(ref.panel) for ref in top.edges)


def _depths(table: Mapping[str, _Laid]) -> dict[str, float]:
    """How far outside the first layer each panel hangs: beyond those of its side that it covers [cm]."""
    depths: dict[str, float] = {}
    for name, laid in table.items():
        shape = laid.polygon
        under = [
            depths[other] + STEP
            for other in depths
            if table[other].back == laid.back
            and shapely.intersection(shape, table[other].polygon).area
            > OVER * min(shape.area, table[other].polygon.area)
        ]
        depths[name] = max(under, default=0.0)
    return depths


def _placed(laid: _Laid, depth: float, wearer: Wearer) -> Panel:
    """The panel where it hangs; turned over where it is drawn as seen from behind."""
    trunk = wearer.limbs[BodyPart.TRUNK]
    z = trunk.origin[2] + (-1.0 if laid.back else 1.0) * (trunk.deep + GAP + depth)
    angle = float(np.angle(laid.turn))
    rotation = np.array([0.0, np.pi if laid.mirrored else 0.0, angle])
    return replace(laid.panel, placement=Placement(np.array([laid.shift.real, laid.shift.imag, z]), rotation))


def _middle(openings: Sequence[Opening]) -> float:
    """The x about which the openings are most nearly mirror images of each other."""
    if not openings:
        return 0.0
    if len(openings) > PAIRED:
        openings = sorted(openings, key=lambda opening: -opening.length)[:PAIRED]
    centres = np.array([o.centre[0] for o in openings])
    kinds = np.array([[0.2 * o.length, 0.5 * o.centre[1]] for o in openings])
    unlike = np.abs(kinds[:, None] - kinds).sum(axis=2)
    tried = sorted({0.5 * (a + b) for a in centres.tolist() for b in centres.tolist()})
    uneven = [(np.abs(centres[:, None] + centres - 2 * x) + unlike).min(axis=1, initial=UNPAIRED).sum() for x in tried]
    return float(tried[int(np.argmin(uneven))])


def _goes_through_arm(opening: Opening, openings: Sequence[Opening], middle: float) -> bool:
    """Whether an opening is aside, and another, round the middle or as far aside, lies below it."""
    below = [o for o in openings if o.centre[1] < opening.centre[1] - ASIDE]
    return abs(opening.centre[0] - middle) > ASIDE and bool(below)


def _sleeves(flat: Pattern, middle: float, wearer: Wearer) -> tuple[dict[str, float], dict[float, np.ndarray]]:
    """The side (1 left, -1 right) of each panel on an arm, and the middle of the seam that holds a side's sleeve."""
    reach = 0.8 * wearer.limbs[BodyPart.TRUNK].wide
    centres = {
        p.name: p.placement.apply(np.array(shapely.Polygon(panel_outline(p)).centroid.coords[0])) for p in flat.panels
    }
    top = max(float(c[1]) for c in centres.values())
    aside = {
        name: float(np.sign(c[0] - middle))
        for name, c in centres.items()
        if abs(c[0] - middle) > reach and c[1] > top - 60.0
    }
    holes: dict[float, np.ndarray] = {}
    for side in set(aside.values()):
        lines = [
            edge_points(flat.panel(ref.panel), ref.edge)
            for seam in flat.seams
            for ref, other in ((seam.left, seam.right), (seam.right, seam.left))
            if aside.get(ref.panel) == side and aside.get(other.panel) != side
        ]
        if lines:
            holes[side] = np.concatenate(lines).mean(axis=0)
    return {name: side for name, side in aside.items() if side in holes}, holes


def _along_arm(
    laid: _Laid, hole: np.ndarray, side: float, flat: Pattern, sleeves: Mapping[str, float], wearer: Wearer
) -> _Laid:
    """A panel of a sleeve turned about its armhole until the sleeve points along the arm."""
    arm = wearer.limbs.get(BodyPart.LEFT_ARM if side > 0 else BodyPart.RIGHT_ARM)
    if arm is None:
        return laid
    far = np.concatenate(
        [flat.panel(n).placement.apply(panel_outline(flat.panel(n))) for n, s in sleeves.items() if s == side]
    )
    now = complex(*(far.mean(axis=0) - hole)[:2])
    turn = complex(arm.axis[0], arm.axis[1]) / now
    turn /= abs(turn)
    about = complex(hole[0], hole[1])
    return replace(laid, turn=laid.turn * turn, shift=turn * (laid.shift - about) + about)
