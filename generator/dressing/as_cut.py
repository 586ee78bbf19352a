"""Cloth as cut, round the body before sewing: where a pattern has each place of a garment."""

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.generator.body.limbs import FRONT, Limb, along_arm, limbs_of
from gcd_dataset.generator.body.section import unit
from gcd_dataset.generator.dressing.flat_cloth import FlatCloth
from gcd_dataset.generator.dressing.frame import WAISTBANDS
from gcd_dataset.generator.dressing.worn import on_side
from gcd_dataset.records import Body, BodyPart, BoxMesh, EdgeRole, Measurements, PanelRole, Pattern
from gcd_dataset.spec import is_trouser_leg

UPPER_EDGES = frozenset({EdgeRole.LEFT_COLLAR, EdgeRole.RIGHT_COLLAR, EdgeRole.STRAPLESS_TOP})
ABOVE_ARM = 1.8  # cm from the top of a sleeve to the shoulder's end of the arm: median of 19 draped garments


def placed_as_cut(
    mesh: BoxMesh, pattern: Pattern, body: Body, size: Measurements, *, waist: float
) -> Float[np.ndarray, "c 3"]:
    """Each row of ``mesh.uv`` round the body, at its height, or place along the arm, in the pattern [cm].

    Gaps between panels close, and so do darts: the height is that of the sewn cloth with a gradient nearest to the
    panels' upward direction, or in waistbands and skirts to the direction towards the upper edge. Uppers are drawn down
    from the outer end of the shoulder seam; from there to the ``waist`` [cm above the floor], cloth is as long as the
    way over the bust or down the back, and longer than the difference in height. Sleeves begin at the shoulder and lie
    along the arm.
    """
    axes = np.stack([panel.placement.matrix[:, :2] for panel in pattern.panels])[mesh.panel_id]
    roles = np.array(mesh.panel_labels)
    on_sleeve = (roles == PanelRole.ARM)[mesh.panel_id]
    placed, trunk = np.array(mesh.vertices, float), FlatCloth.of(mesh, ~on_sleeve)
    rise, start = axes[:, 1].copy(), placed[:, 1]
    every = np.arange(len(placed))
    held = np.isin(every, mesh.labels.get(EdgeRole.LOWER_INTERFACE, ()))
    if UPPER_EDGES & mesh.labels.keys():
        nape, ahead = size.height - size.head_l, placed[:, 2] > 0.0
        drawn = np.where(ahead, size.waist_over_bust_line, size.waist_line)
        left = drawn - (nape - 0.5 * size.shoulder_w * np.tan(size.shoulder_incl) - start)  # down to the waist
        shrink = np.where(left > 0.0, (nape - waist) / drawn, 1.0)
        start, rise = waist + shrink * left, rise * shrink[mesh.faces].mean(axis=1)[:, None]
        held = (left > 0.0) & np.isin(every, mesh.faces[(roles == PanelRole.BODY)[mesh.panel_id]])
    skirts = (roles == PanelRole.LEG) & ~np.array(list(map(is_trouser_leg, mesh.panel_names)))
    hung = (skirts | [any(word in name for word in WAISTBANDS) for name in mesh.panel_names])[mesh.panel_id]
    if len(top := _upper_edge(mesh, pattern)) and hung.any():
        rise[hung] = FlatCloth.of(mesh, hung).towards(top)
    held &= np.isin(every, trunk.vertices)
    if len(trunk.vertices):
        height = trunk.integrated(rise[~on_sleeve], start)
        placed[:, 1] = height + (start - height)[held if held.any() else trunk.vertices].mean()
    found = placed[mesh.uv_vertex]
    for part in (BodyPart.RIGHT_ARM, BodyPart.LEFT_ARM):
        if arm := limbs_of(body).get(part):
            own = on_side(mesh, roles == PanelRole.ARM, np.sign(arm.origin[0]))
            rows = np.unique(mesh.corners[own])
            found[rows] = _along(mesh, own, axes[own], arm)[mesh.uv_vertex[rows]]
    return found


def _upper_edge(mesh: BoxMesh, pattern: Pattern) -> Int[np.ndarray, " t"]:
    """The vertices of a waistband's or skirt's upper edge, with its ends, which the label of a free edge leaves out."""
    found, panel_of = [np.array(mesh.labels.get(EdgeRole.LOWER_INTERFACE, ()), int)], mesh.panel_of_row
    for number, panel in enumerate(pattern.panels):
        corners = [
            at for edge in panel.edges if edge.label == EdgeRole.LOWER_INTERFACE for at in (edge.start, edge.end)
        ]
        rows = np.flatnonzero(panel_of == number)
        away = np.abs(mesh.uv[rows] - panel.vertices[corners][:, None]).sum(axis=2)
        found.append(mesh.uv_vertex[rows[away.argmin(axis=1)]])
    return np.concatenate(found)


def _along(
    mesh: BoxMesh, own: Bool[np.ndarray, " f"], axes: Float[np.ndarray, "f 3 2"], arm: Limb
) -> Float[np.ndarray, "v 3"]:
    """The vertices of a sleeve, turned in the frontal plane so that it lies along the arm [cm]."""
    cloth, placed = FlatCloth.of(mesh, own), np.asarray(mesh.vertices, float)
    root = np.intersect1d(cloth.vertices, mesh.faces[~own])
    if not len(root):
        return placed
    middle = placed[cloth.vertices].mean(axis=0)
    axis = unit((middle - placed[root].mean(axis=0)) * (1.0, 1.0, 0.0))
    along = cloth.integrated(np.einsum("fij,i->fj", axes, axis), placed @ axis)
    along += (along_arm(arm, 0.0) - arm.origin) @ arm.axis - ABOVE_ARM - along[root[placed[root, 1].argmax()]]
    return arm.world(np.stack([(placed - middle) @ np.cross(axis, FRONT), along, placed[:, 2] - middle[2]], axis=1))
