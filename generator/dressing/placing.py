"""Correct placements from which a drape cannot start."""

from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.generator.body.inside import InsideTest
from gcd_dataset.generator.dressing.frame import in_body_frame, moved, placed_outline
from gcd_dataset.generator.dressing.hanging import hang_from_lay_plan
from gcd_dataset.generator.dressing.openings import panel_outline
from gcd_dataset.generator.dressing.wearer import Wearer
from gcd_dataset.records import BodyPart, Panel, Pattern

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
