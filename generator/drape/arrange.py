"""Where sewing starts: panels bent round the trunk and the arms, so that seams begin nearly closed.

A panel that hangs flat before or behind a part of the body is laid on a curve round that part, without stretching it:
lengths along the part's axis and along the curve stay as they were cut. The curve is an ellipse that holds the part's
cross sections; where a panel is wider than half of it, the curve is taken as much larger as keeps the
panel in front of, or behind, the part's middle. Panels that hang edgewise, lie level, or hang one over the
other (godets over their skirt), stay as they are.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.generator.body.inside import InsideTest
from gcd_dataset.generator.body.limbs import Limb, limbs_of
from gcd_dataset.records import Body, BodyPart, BoxMesh, PanelRole

__all__ = ["arrange", "arranged"]

CLEARANCE = 2.0  # cm from the hull to the innermost layer
LAYERS = 0.2  # of the distance between two panels of one side that is kept between their curves
FACING = 0.99  # cosine of the turn, from the part's front or back, at which a panel is still laid round it
OVERLAP = 8.0  # cm along the part, from which two panels hang over each other, not one below the other
LOOKED_AT = 600  # points, or up to twice as many, that are looked at where all are meant
COVERED = 0.1  # share of a panel from which it is said to lie on another
AROUND = 3.0  # cm round the trunk that a sleeve keeps clear of
REACH = 0.75  # of the arm, hand or no hand, that it may cover then
FURTHEST = 25.0  # cm that it is drawn off for that
SIDE = 0.5  # cm that a wide panel keeps from the plane between front and back
CURVES = (1.0, 1.5, 2.5, 5.0)  # times as large, tried until the panel is nowhere inside the body


@dataclass(frozen=True, eq=False)
class _Hung:
    """A panel, flat in its place."""

    rows: Int[np.ndarray, " m"]
    """Its rows of ``uv``."""
    points: Float[np.ndarray, "m 3"]
    """[cm]"""
    limb: Limb
    label: str
    facing: float
    """1 before the part, -1 behind it, 0 where it stays as it is."""
    distance: float
    """Of its plane from the part's axis, forward or backward [cm]."""


def arranged(mesh: BoxMesh, body: Body) -> BoxMesh:
    """The box mesh where its sewing starts."""
    return replace(mesh, vertices=arrange(mesh, body))


def arrange(mesh: BoxMesh, body: Body) -> Float[np.ndarray, "v 3"]:
    """Start positions of a garment on a body [cm]; a seam vertex stands in the middle of the points it joins."""
    limbs = limbs_of(body)
    panels = [_hung(mesh, panel, limbs) for panel in range(len(mesh.panel_names))]
    inside = InsideTest(body)
    placed = np.zeros((len(mesh.uv), 3))
    for side in _sides(panels):
        nearest = min(panel.distance for panel in side)
        for group in _groups(side):
            for panel, points in zip(group, _laid(group, nearest, inside), strict=True):
                placed[panel.rows] = points
    for arm in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM):
        rows = [panel.rows for panel in panels if panel.limb is limbs.get(arm)]
        if rows:
            sleeve = np.concatenate(rows)
            placed[sleeve] += _out_of_trunk(placed[sleeve], limbs[arm], _bodice(panels, limbs[BodyPart.TRUNK]))
    members = np.bincount(mesh.uv_vertex)
    return np.stack([np.bincount(mesh.uv_vertex, column) / members for column in placed.T], axis=1)


def _out_of_trunk(sleeve: Float[np.ndarray, "m 3"], arm: Limb, trunk: Limb) -> Float[np.ndarray, "3"]:
    """How a sleeve must be drawn off along its arm to start beside the bodice, not within it [cm].

    Not so far that its end comes near the hand: a cuff that is sewn there is caught on it.
    """
    along = arm.skin @ arm.axis
    room = along.min() + REACH * np.ptp(along) - (sleeve @ arm.axis).max()
    for step in np.arange(min(FURTHEST, room) + 1.0):
        x, _, z = trunk.local(sleeve + step * arm.axis).T
        if (np.hypot(x / (trunk.wide + AROUND), z / (trunk.deep + AROUND)) > 1).all():
            return np.asarray(step * arm.axis)
    return np.zeros(3)


def _sides(panels: list[_Hung]) -> list[list[_Hung]]:
    """Panels of one part of the body that hang on one side of it."""
    sides: dict[tuple[int, float], list[_Hung]] = {}
    for panel in panels:
        sides.setdefault((id(panel.limb), panel.facing), []).append(panel)
    return list(sides.values())


def _groups(side: list[_Hung]) -> list[list[_Hung]]:
    """Panels that are laid on the same curves: what hangs side by side or in layers then still does."""
    groups: list[list[_Hung]] = []
    for panel in side:
        near = [group for group in groups if any(_belong_together(panel, other) for other in group)]
        groups = [group for group in groups if not any(group is other for other in near)] + [
            [panel, *(p for group in near for p in group)]
        ]
    return groups


def _belong_together(a: _Hung, b: _Hung) -> bool:
    heights = [panel.points @ panel.limb.axis for panel in (a, b)]
    overlap = min(h.max() for h in heights) - max(h.min() for h in heights)
    return bool(a.label == b.label or overlap > OVERLAP)


def _hung(mesh: BoxMesh, panel: int, limbs: dict[BodyPart, Limb]) -> _Hung:
    rows = np.unique(mesh.corners[mesh.panel_id == panel])
    points = _flat(mesh, rows)
    limb = limbs[BodyPart.TRUNK]
    if mesh.panel_labels[panel] == PanelRole.ARM:
        side = BodyPart.LEFT_ARM if points[:, 0].mean() > 0 else BodyPart.RIGHT_ARM
        limb = limbs.get(side, limb)
    local = limb.local(points)
    middle = local.mean(axis=0)
    normal = np.linalg.svd(local - middle, full_matrices=False)[2][2]
    facing = float(np.sign(middle[2])) if abs(normal[2]) > FACING else 0.0
    return _Hung(rows, points, limb, mesh.panel_labels[panel], facing, abs(float(middle[2])))


def _flat(mesh: BoxMesh, rows: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """The points of a panel as it hung before its seams were merged: its plane is known from those not sewn."""
    vertices = mesh.uv_vertex[rows]
    free = vertices >= mesh.n_seam_vertices
    if free.sum() < 3:
        return np.asarray(mesh.vertices[vertices], float)
    flat, hung = mesh.uv[rows][free], mesh.vertices[vertices][free]
    turn, *_ = np.linalg.lstsq(flat - flat.mean(axis=0), hung - hung.mean(axis=0), rcond=None)
    return np.asarray((mesh.uv[rows] - flat.mean(axis=0)) @ turn + hung.mean(axis=0))


def _some(points: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "n d"]:
    """Enough of the points to tell for all."""
    return points[:: max(1, len(points) // LOOKED_AT)]


def _bodice(panels: list[_Hung], trunk: Limb) -> Limb:
    """As much of the trunk as a bodice covers; all of it where there is none."""
    bodice = [panel for panel in panels if panel.limb is trunk and panel.label == PanelRole.BODY]
    return _stretch(bodice) if bodice else trunk


def _laid(group: list[_Hung], nearest: float, inside: InsideTest) -> list[Float[np.ndarray, "m 3"]]:
    """The panels round their part, on the tightest curves that are clear of the body; flat where none are.

    ``nearest`` is how near to the part its innermost panel on this side hangs [cm].
    """
    if not group[0].facing or _overlap(group):
        return [panel.points for panel in group]
    limb = _stretch(group)
    curves = [limb.curve(CLEARANCE + LAYERS * (panel.distance - nearest)) for panel in group]
    growth = _growth(curves[0], np.concatenate([limb.local(panel.points)[:, 0] for panel in group]))
    for times in CURVES:
        laid = [_wrapped(panel, limb, curve, times * growth) for panel, curve in zip(group, curves, strict=True)]
        if not inside(_some(np.concatenate(laid))).any():
            return laid
    return [panel.points for panel in group]


def _overlap(group: list[_Hung]) -> bool:
    """Whether panels lie over each other: the slanted cloth between them would cross others', were they bent."""
    seen = [panel.limb.local(panel.points)[:, :2] for panel in group]
    hulls = [shapely.convex_hull(shapely.multipoints(points)) for points in seen]
    for i, j in combinations(range(len(group)), 2):
        common = shapely.intersection(hulls[i], hulls[j]).area
        if common > COVERED * min(hulls[i].area, hulls[j].area) and _covers(seen[i], seen[j]):
            return True
    return False


def _covers(a: Float[np.ndarray, "m 2"], b: Float[np.ndarray, "n 2"]) -> bool:
    """Whether more than a few points of the smaller panel lie between those of the other."""
    few, many = sorted((a, b), key=len)
    tree = cKDTree(many)
    spacing = np.median(tree.query(_some(many), k=2)[0][:, 1])
    return bool((tree.query(_some(few))[0] < spacing / 2).mean() > COVERED)


def _stretch(group: list[_Hung]) -> Limb:
    """As much of the part as the panels cover."""
    along = np.concatenate([panel.points for panel in group]) @ group[0].limb.axis
    return group[0].limb.stretch(along.min() - CLEARANCE, along.max() + CLEARANCE)


def _wrapped(panel: _Hung, limb: Limb, curve: Float[np.ndarray, "n 2"], times: float) -> Float[np.ndarray, "m 3"]:
    """The panel on a curve, grown by ``times`` [cm]."""
    local = limb.local(panel.points)
    x, z = _on_curve(curve, local[:, 0], times).T
    depth = panel.facing * (local[:, 2] - local[:, 2].mean())  # a panel not quite upright stays so
    return limb.world(np.stack([x, local[:, 1], panel.facing * (z + depth)], axis=1))


def _on_curve(curve: Float[np.ndarray, "n 2"], s: Float[np.ndarray, " m"], times: float) -> Float[np.ndarray, "m 2"]:
    """Points at lengths ``s`` along a curve, grown from its first point; negative lengths go the other way round."""
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    wound = np.mod(s / times, at[-1])
    grown = [times * (np.interp(wound, at, column) - column[0]) + column[0] for column in curve.T]
    return np.stack(grown, axis=1)


def _growth(curve: Float[np.ndarray, "n 2"], s: Float[np.ndarray, " m"]) -> float:
    """How much larger the curve must be so that its points at ``s`` stay on their side of the middle."""
    ends, low, high = np.array([s.min(), s.max()]), 1.0, 1.0
    half = 0.5 * float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())

    def stays(times: float) -> bool:
        return bool(np.abs(ends).max() <= times * half and _on_curve(curve, ends, times)[:, 1].min() >= SIDE)

    while not stays(high):
        low, high = high, 2 * high
    if high == 1.0:
        return 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if stays(middle) else (middle, high)
    return high
