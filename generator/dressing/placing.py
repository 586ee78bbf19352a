"""Placements that a drape cannot start from, and better ones."""

from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.generator.body.inside import InsideTest
from gcd_dataset.generator.dressing.hanging import hang_from_lay_plan, height_for
from gcd_dataset.generator.dressing.openings import openings_of, panel_outline
from gcd_dataset.generator.dressing.wearer import Wearer
from gcd_dataset.records import BodyPart, Panel, Pattern, Placement

__all__ = ["lie_in_one_plane", "place_panels"]

LEVEL = 1.0  # cm: panels that stay within it of one plane lie in it
LATTICE = 4.0  # cm between the points of a panel that are looked at
INSIDE = 0.15  # share of a panel's points in the body, from which it is moved out
FURTHER = 3.0  # cm beyond the last place where it still touched
FURTHEST = 80.0  # cm that a panel is moved at most


def place_panels(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern with panels that hang round the wearer, and a sentence for each change.

    Panels that all lie in one plane, as on a lay plan, are hung by how they are sewn; a garment off the body is moved
    to it as a whole; panels inside the body are moved out. Raises ``PatternError`` where the panels' places cannot be
    told from their seams.
    """
    if len(pattern.panels) > 1 and lie_in_one_plane(pattern):
        pattern, assumed = hang_from_lay_plan(pattern, wearer)
    else:
        pattern, assumed = _beside_body(pattern, wearer)
    pattern, moved = _outside(pattern, wearer)
    return pattern, assumed + moved


def lie_in_one_plane(pattern: Pattern) -> bool:
    """Whether the panels lie on one table, as on a lay plan, rather than round a body."""
    points = np.concatenate([_hung(panel) for panel in pattern.panels])
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    return bool(np.abs(centred @ normal).max() < LEVEL)


def _beside_body(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """The garment moved up or down where it hangs over the head or under the floor."""
    heights = np.concatenate([_hung(panel) for panel in pattern.panels])[:, 1]
    top, low = float(wearer.body.vertices[:, 1].max()), float(heights.min())
    if low < top and heights.max() > 0:
        return pattern, ()
    by = height_for(openings_of(pattern), pattern, wearer)
    side = "over the head" if low >= top else "under the floor"
    moved = tuple(_moved(panel, np.array([0.0, by, 0.0])) for panel in pattern.panels)
    return replace(pattern, panels=moved), (
        f"the garment hung {side}: moved {abs(by):.0f} cm {'down' if by < 0 else 'up'}, by its openings",
    )


def _outside(pattern: Pattern, wearer: Wearer) -> tuple[Pattern, tuple[str, ...]]:
    """Panels that hang in the body moved out, forward or backward along their normals."""
    inside = InsideTest(wearer.body)
    panels, sentences = [], []
    for panel in pattern.panels:
        points, way = _points(panel), _outward(panel, wearer)
        by, share = 0.0, float(inside(points).mean())
        if share > INSIDE:
            steps = np.arange(1.0, FURTHEST)
            by = next((s for s in steps if not inside(points + s * way).any()), FURTHEST) + FURTHER
            sentences.append(f"panel {panel.name} hung {share:.0%} inside the body: moved out by {by:.0f} cm")
        panels.append(_moved(panel, by * way) if by else panel)
    return replace(pattern, panels=tuple(panels)), tuple(sentences)


def _outward(panel: Panel, wearer: Wearer) -> Float[np.ndarray, "3"]:
    """The level way out of the body: to the panel's right side, or off the trunk for one that lies level."""
    flat = panel_outline(panel)
    turn = 1.0 if shapely.LinearRing(flat).is_ccw else -1.0
    way = turn * panel.placement.matrix[:, 2] * [1.0, 0.0, 1.0]
    if np.linalg.norm(way) < 0.5:
        way = (_hung(panel).mean(axis=0) - wearer.limbs[BodyPart.TRUNK].origin) * [1.0, 0.0, 1.0]
    length = float(np.linalg.norm(way))
    return way / length if length > 0 else np.array([0.0, 0.0, 1.0])


def _hung(panel: Panel) -> Float[np.ndarray, "n 3"]:
    return panel.placement.apply(panel_outline(panel))


def _points(panel: Panel) -> Float[np.ndarray, "n 3"]:
    """Points all over a panel, where it hangs."""
    flat = panel_outline(panel)
    low, high = flat.min(axis=0), flat.max(axis=0)
    x, y = (np.arange(a, b, LATTICE) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    within = shapely.contains_xy(shapely.Polygon(flat), grid[:, 0], grid[:, 1])
    return panel.placement.apply(np.concatenate([flat, grid[within]]))


def _moved(panel: Panel, by: Float[np.ndarray, "3"]) -> Panel:
    return replace(panel, placement=Placement(panel.placement.translation + by, panel.placement.rotation))
