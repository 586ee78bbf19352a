"""Turn the panels of sleeves to the arms of a body in another pose than the pattern was placed for."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.limbs import Limb
from gcd_dataset.generator.dressing.openings import edge_points, panel_outline
from gcd_dataset.generator.dressing.wearer import Wearer
from gcd_dataset.records import BodyPart, Panel, PanelRole, Pattern, Placement

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
    armhole: Float[np.ndarray, "3"]
    """Middle of the edges sewn to the bodice [cm]."""
    direction: Float[np.ndarray, "3"]
    """Unit vector from the armhole down the sleeve."""

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
        return [_turned(panel, turn, self.armhole, aside) for panel in self.panels]


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
    return panel.placement.apply(panel_outline(panel)).mean(axis=0)


def _turned(panel: Panel, turn: Rotation, about: np.ndarray, by: np.ndarray) -> Panel:
    """The panel turned about a point, then moved."""
    matrix = turn.as_matrix() @ panel.placement.matrix
    angles = Rotation.from_matrix(matrix).as_euler("xyz")
    translation = turn.apply(panel.placement.translation - about) + about + by
    return replace(panel, placement=Placement(translation, angles))
