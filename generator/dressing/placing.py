"""Correct placements from which a drape cannot start."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
import shapely
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.limbs import Limb
from gcd_dataset.generator.dressing.frame import Wearer, in_body_frame, moved, placed_outline
from gcd_dataset.generator.dressing.hanging import hang_from_lay_plan
from gcd_dataset.generator.dressing.openings import edge_points, panel_outline
from gcd_dataset.records import Body, BodyPart, Panel, PanelRole, Pattern, Placement

SKIN = 0.5  # cm: a point nearer than this to a face centre counts as inside
EVERY = 4  # sampling: every fourth face


class InsideTest:
    """Tests points. A point behind the nearest sampled face, or within ``SKIN`` of its centre, counts as inside."""

    def __init__(self, body: Body) -> None:
        corners = np.asarray(body.vertices, float)[body.faces[::EVERY]]
        self._centres = corners.mean(axis=1)
        self._normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._tree = cKDTree(self._centres)

    def __call__(self, points: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
        distance, nearest = self._tree.query(points)
        offset = points - self._centres[nearest]
        return np.asarray(((offset * self._normals[nearest]).sum(axis=1) < 0) | (distance < SKIN))


MISAIMED = np.radians(25.0)  # a sleeve further off its arm is turned; arm angles are sampled up to 15°
SHORTEST = 6.0  # cm from the armhole to the centroid of a sleeve: the direction of a shorter one is uncertain


def turn_sleeves(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The labelled pattern with misaimed sleeves turned about their armholes, and a sentence for each."""
    panels, sentences = {panel.name: panel for panel in pattern.panels}, []
    for part, side in ((BodyPart.LEFT_ARM, 1.0), (BodyPart.RIGHT_ARM, -1.0)):
        sleeve, arm = _Sleeve.of(pattern, side), wearer.limbs.get(part)
        if sleeve is None or arm is None:
            continue
        angle = float(np.arccos(np.clip(sleeve.direction @ arm.axis, -1.0, 1.0)))
        if angle > MISAIMED:
            panels |= {panel.name: panel for panel in sleeve.on(arm)}
            name = "left" if side > 0 else "right"
            sentences.append(f"the {name} sleeve points {np.degrees(angle):.0f}° off the arm: turned to it")
    return replace(pattern, panels=tuple(panels.values())), tuple(sentences)


class _Sleeve(NamedTuple):
    """The panels of one sleeve."""

    panels: Sequence[Panel]
    armhole: Float[np.ndarray, "3"]  # middle of the edges sewn to the bodice [cm]
    direction: Float[np.ndarray, "3"]  # unit vector from the armhole down the sleeve

    @classmethod
    def of(cls, pattern: Pattern, side: float) -> Self | None:
        """The sleeve on a side, 1 for the left; ``None`` without a sleeve long enough to have a direction."""
        panels = [panel for panel in pattern.panels if panel.label == PanelRole.ARM and side * _middle(panel)[0] > 0.0]
        armhole = _armhole(pattern, panels)
        if armhole is None:
            return None
        down = np.mean([_middle(panel) for panel in panels], axis=0) - armhole
        length = float(np.linalg.norm(down))
        return cls(panels, armhole, down / length) if length > SHORTEST else None

    def on(self, arm: Limb) -> list[Panel]:
        """The panels turned to the arm's direction about the armhole, and moved sideways until the arm is inside."""
        turn = Rotation.align_vectors([arm.axis], [self.direction])[0]
        aside = arm.origin - self.armhole
        aside -= (aside @ arm.axis) * arm.axis
        panels = []
        for panel in self.panels:
            angles = Rotation.from_matrix(turn.as_matrix() @ panel.placement.matrix).as_euler("xyz")
            translation = turn.apply(panel.placement.translation - self.armhole) + self.armhole + aside
            panels.append(replace(panel, placement=Placement(translation, angles)))
        return panels


def _armhole(pattern: Pattern, sleeve: Sequence[Panel]) -> Float[np.ndarray, "3"] | None:
    """The middle of the sleeve's edges that are sewn to a panel of the trunk; ``None`` without such a seam."""
    panels = {panel.name: panel for panel in pattern.panels}
    own, points = {panel.name for panel in sleeve}, []
    for seam in pattern.seams:
        for here, there in ((seam.left, seam.right), (seam.right, seam.left)):
            if here.panel in own and panels[there.panel].label == PanelRole.BODY:
                points.append(edge_points(panels[here.panel], here.edge).mean(axis=0))
    return np.mean(points, axis=0) if points else None


def _middle(panel: Panel) -> Float[np.ndarray, "3"]:
    return placed_outline(panel).mean(axis=0)


LEVEL = 1.0  # cm: largest distance of panels from the plane in which they lie
LATTICE = 4.0  # cm between the sample points of a panel
INSIDE = 0.15  # share of a panel's points inside the body, above which the panel is moved out
FURTHER = 3.0  # cm by which a panel is moved beyond the nearest position outside the body
FURTHEST = 80.0  # cm: search range for this position


def place_panels(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern with its panels round the wearer, and a sentence for each change.

    Panels in one plane, as on a lay plan, are placed by their seams; a garment above or below the body is moved to it
    as a whole; panels inside the body are moved out. Raises ``PatternError`` for a lay plan whose seams do not
    determine the positions of the panels.
    """
    if len(pattern.panels) > 1 and _lie_in_one_plane(pattern):
        pattern, assumed = hang_from_lay_plan(pattern, wearer)
    else:
        pattern, assumed = in_body_frame(pattern, wearer)
    pattern, out = _out_of_body(pattern, wearer)
    return pattern, assumed + out


def _lie_in_one_plane(pattern: Pattern) -> bool:
    """Whether all panels lie in one plane, as on a lay plan, rather than round a body."""
    points = np.concatenate([placed_outline(panel) for panel in pattern.panels])
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    return bool(np.abs(centred @ normal).max() < LEVEL)


def _out_of_body(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """Panels inside the body moved out horizontally."""
    inside = InsideTest(wearer.body)
    panels, sentences = [], []
    for panel in pattern.panels:
        points, outward = _sample_points(panel), _outward(panel, wearer)
        by, share = 0.0, float(inside(points).mean())
        if share > INSIDE:
            steps = np.arange(1.0, FURTHEST)
            by = next((s for s in steps if not inside(points + s * outward).any()), FURTHEST) + FURTHER
            sentences.append(f"panel {panel.name} hung {share:.0%} inside the body: moved out by {by:.0f} cm")
        panels.append(moved(panel, by * outward) if by else panel)
    return replace(pattern, panels=tuple(panels)), tuple(sentences)


def _outward(panel: Panel, wearer: Wearer) -> Float[np.ndarray, "3"]:
    """The horizontal unit vector out of the body: to the panel's right side; for a flat panel away from the trunk."""
    flat = panel_outline(panel)
    sign = 1.0 if shapely.LinearRing(flat).is_ccw else -1.0
    outward = sign * panel.placement.matrix[:, 2] * [1.0, 0.0, 1.0]
    if np.linalg.norm(outward) < 0.5:
        outward = (placed_outline(panel).mean(axis=0) - wearer.limbs[BodyPart.TRUNK].origin) * [1.0, 0.0, 1.0]
    length = float(np.linalg.norm(outward))
    return outward / length if length > 0 else np.array([0.0, 0.0, 1.0])


def _sample_points(panel: Panel) -> Float[np.ndarray, "n 3"]:
    """Points on the outline and on a lattice inside it, in space [cm]."""
    flat = panel_outline(panel)
    low, high = flat.min(axis=0), flat.max(axis=0)
    x, y = (np.arange(a, b, LATTICE) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    within = shapely.contains_xy(shapely.Polygon(flat), grid[:, 0], grid[:, 1])
    return panel.placement.apply(np.concatenate([flat, grid[within]]))
