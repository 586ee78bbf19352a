"""Curved start: panels bent round the trunk and the arms, so that seams start nearly closed.

A panel that hangs flat in front of or behind a body part is wrapped on a curve round that part without stretch: lengths
along the part's axis and along the curve stay as cut. The curve is an ellipse that contains the part's cross sections;
it grows until a wide panel stays on its side of the part's middle. Panels that hang edgewise, lie level, or overlap
each other (godets over their skirt) stay flat.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.generator.drape.inside import InsideTest
from gcd_dataset.generator.drape.limbs import Limb, limbs_of
from gcd_dataset.records import Body, BodyPart, BoxMesh, PanelRole

__all__ = ["arrange", "arranged"]

CLEARANCE = 2.0  # cm from the hull to the innermost layer
LAYERS = 0.2  # share of the distance between two panels of one side that remains between their curves
FACING = 0.99  # least cosine between a panel's normal and the part's front for the panel to be wrapped
OVERLAP = 8.0  # cm along the part from which two panels are side by side or in layers, not one below the other
SAMPLED = 600  # points, or up to twice as many, that stand for all
COVERED = 0.1  # share of a panel from which it overlaps another
AROUND = 3.0  # cm round the trunk that a sleeve keeps clear of
REACH = 0.75  # share of the arm's length that a sleeve may reach
MAX_SHIFT = 25.0  # cm that a sleeve is shifted along the arm at most
SIDE = 0.5  # cm that a wide panel keeps from the plane between front and back
CURVES = (1.0, 1.5, 2.5, 5.0)  # growth factors, tried until the panel is outside the body


@dataclass(frozen=True, eq=False)
class _FlatPanel:
    """A panel, flat where the pattern places it."""

    rows: Int[np.ndarray, " m"]
    """The panel's rows of ``uv``."""
    points: Float[np.ndarray, "m 3"]
    """Points in space [cm]."""
    limb: Limb
    label: str
    facing: float
    """1 in front of the body part, -1 behind it, 0 if the panel stays flat."""
    distance: float
    """Distance of the panel's plane from the part's axis [cm]."""


def arranged(mesh: BoxMesh, body: Body) -> BoxMesh:
    """The box mesh at its curved start."""
    return replace(mesh, vertices=arrange(mesh, body))


def arrange(mesh: BoxMesh, body: Body) -> Float[np.ndarray, "v 3"]:
    """Start positions of a garment on a body [cm]; a seam vertex starts at the mean of the points that it joins."""
    limbs = limbs_of(body)
    panels = [_flat_panel(mesh, panel, limbs) for panel in range(len(mesh.panel_names))]
    inside = InsideTest(body)
    placed = np.zeros((len(mesh.uv), 3))
    for side in _sides(panels):
        nearest = min(panel.distance for panel in side)
        for group in _groups(side):
            for panel, points in zip(group, _wrap_group(group, nearest, inside), strict=True):
                placed[panel.rows] = points
    for arm in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM):
        rows = [panel.rows for panel in panels if panel.limb is limbs.get(arm)]
        if rows:
            sleeve = np.concatenate(rows)
            placed[sleeve] += _out_of_trunk(placed[sleeve], limbs[arm], _bodice(panels, limbs[BodyPart.TRUNK]))
    members = np.bincount(mesh.uv_vertex)
    return np.stack([np.bincount(mesh.uv_vertex, column) / members for column in placed.T], axis=1)


def _out_of_trunk(sleeve: Float[np.ndarray, "m 3"], arm: Limb, trunk: Limb) -> Float[np.ndarray, "3"]:
    """Shift along the arm by which a sleeve starts beside the bodice, not inside it [cm].

    Limited so that the sleeve does not reach the hand: a cuff sewn there would be caught on it.
    """
    along = arm.skin @ arm.axis
    room = along.min() + REACH * np.ptp(along) - (sleeve @ arm.axis).max()
    for step in np.arange(min(MAX_SHIFT, room) + 1.0):
        x, _, z = trunk.local(sleeve + step * arm.axis).T
        if (np.hypot(x / (trunk.wide + AROUND), z / (trunk.deep + AROUND)) > 1).all():
            return np.asarray(step * arm.axis)
    return np.zeros(3)


def _sides(panels: list[_FlatPanel]) -> list[list[_FlatPanel]]:
    """Panels grouped by body part and side, front or back."""
    sides: dict[tuple[int, float], list[_FlatPanel]] = {}
    for panel in panels:
        sides.setdefault((id(panel.limb), panel.facing), []).append(panel)
    return list(sides.values())


def _groups(side: list[_FlatPanel]) -> list[list[_FlatPanel]]:
    """Panels wrapped on the same curves, so that they stay side by side or in layers."""
    groups: list[list[_FlatPanel]] = []
    for panel in side:
        near = [group for group in groups if any(_belong_together(panel, other) for other in group)]
        groups = [group for group in groups if not any(group is other for other in near)] + [
            [panel, *(p for group in near for p in group)]
        ]
    return groups


def _belong_together(a: _FlatPanel, b: _FlatPanel) -> bool:
    heights = [panel.points @ panel.limb.axis for panel in (a, b)]
    overlap = min(h.max() for h in heights) - max(h.min() for h in heights)
    return bool(a.label == b.label or overlap > OVERLAP)


def _flat_panel(mesh: BoxMesh, panel: int, limbs: dict[BodyPart, Limb]) -> _FlatPanel:
    rows = np.unique(mesh.corners[mesh.panel_id == panel])
    points = _points_before_sewing(mesh, rows)
    limb = limbs[BodyPart.TRUNK]
    if mesh.panel_labels[panel] == PanelRole.ARM:
        side = BodyPart.LEFT_ARM if points[:, 0].mean() > 0 else BodyPart.RIGHT_ARM
        limb = limbs.get(side, limb)
    local = limb.local(points)
    middle = local.mean(axis=0)
    normal = np.linalg.svd(local - middle, full_matrices=False)[2][2]
    facing = float(np.sign(middle[2])) if abs(normal[2]) > FACING else 0.0
    return _FlatPanel(rows, points, limb, mesh.panel_labels[panel], facing, abs(float(middle[2])))


def _points_before_sewing(mesh: BoxMesh, rows: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """A panel's points before its seam vertices were merged: ``uv`` mapped to fit its other vertices [cm]."""
    vertices = mesh.uv_vertex[rows]
    free = vertices >= mesh.n_seam_vertices
    if free.sum() < 3:
        return np.asarray(mesh.vertices[vertices], float)
    flat, placed = mesh.uv[rows][free], mesh.vertices[vertices][free]
    rotation, *_ = np.linalg.lstsq(flat - flat.mean(axis=0), placed - placed.mean(axis=0), rcond=None)
    return np.asarray((mesh.uv[rows] - flat.mean(axis=0)) @ rotation + placed.mean(axis=0))


def _sampled(points: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "n d"]:
    return points[:: max(1, len(points) // SAMPLED)]


def _bodice(panels: list[_FlatPanel], trunk: Limb) -> Limb:
    """The section of the trunk that a bodice covers; the whole trunk without one."""
    bodice = [panel for panel in panels if panel.limb is trunk and panel.label == PanelRole.BODY]
    return _section(bodice) if bodice else trunk


def _wrap_group(group: list[_FlatPanel], nearest: float, inside: InsideTest) -> list[Float[np.ndarray, "m 3"]]:
    """The panels on the tightest curves of ``CURVES`` that are clear of the body; flat if none is.

    ``nearest``: least ``distance`` of the panels on this side of the part [cm].
    """
    if not group[0].facing or _overlap(group):
        return [panel.points for panel in group]
    limb = _section(group)
    curves = [limb.curve(CLEARANCE + LAYERS * (panel.distance - nearest)) for panel in group]
    growth = _growth(curves[0], np.concatenate([limb.local(panel.points)[:, 0] for panel in group]))
    for times in CURVES:
        wrapped = [_wrapped(panel, limb, curve, times * growth) for panel, curve in zip(group, curves, strict=True)]
        if not inside(_sampled(np.concatenate(wrapped))).any():
            return wrapped
    return [panel.points for panel in group]


def _overlap(group: list[_FlatPanel]) -> bool:
    """Whether panels overlap: if bent, the slanted cloth between two of them would cross other panels."""
    projected = [panel.limb.local(panel.points)[:, :2] for panel in group]
    hulls = [shapely.convex_hull(shapely.multipoints(points)) for points in projected]
    for i, j in combinations(range(len(group)), 2):
        common = shapely.intersection(hulls[i], hulls[j]).area
        if common > COVERED * min(hulls[i].area, hulls[j].area) and _covers(projected[i], projected[j]):
            return True
    return False


def _covers(a: Float[np.ndarray, "m 2"], b: Float[np.ndarray, "n 2"]) -> bool:
    """Whether more than a share ``COVERED`` of the smaller panel's points lie on points of the other."""
    few, many = sorted((a, b), key=len)
    tree = cKDTree(many)
    spacing = np.median(tree.query(_sampled(many), k=2)[0][:, 1])
    return bool((tree.query(_sampled(few))[0] < spacing / 2).mean() > COVERED)


def _section(group: list[_FlatPanel]) -> Limb:
    """The section of the body part that the panels cover."""
    along = np.concatenate([panel.points for panel in group]) @ group[0].limb.axis
    return group[0].limb.section(along.min() - CLEARANCE, along.max() + CLEARANCE)


def _wrapped(panel: _FlatPanel, limb: Limb, curve: Float[np.ndarray, "n 2"], times: float) -> Float[np.ndarray, "m 3"]:
    """The panel on a curve that is grown ``times`` [cm]."""
    local = limb.local(panel.points)
    x, z = _on_curve(curve, local[:, 0], times).T
    depth = panel.facing * (local[:, 2] - local[:, 2].mean())  # a panel not quite upright stays so
    return limb.world(np.stack([x, local[:, 1], panel.facing * (z + depth)], axis=1))


def _on_curve(curve: Float[np.ndarray, "n 2"], s: Float[np.ndarray, " m"], times: float) -> Float[np.ndarray, "m 2"]:
    """Points at arc lengths ``s``, either way, on a curve grown ``times`` from its first point."""
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    wound = np.mod(s / times, at[-1])
    grown = [times * (np.interp(wound, at, column) - column[0]) + column[0] for column in curve.T]
    return np.stack(grown, axis=1)


def _growth(curve: Float[np.ndarray, "n 2"], s: Float[np.ndarray, " m"]) -> float:
    """Growth factor of the curve with which its points at ``s`` stay on their side of the part's middle."""
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
