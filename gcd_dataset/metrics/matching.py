"""Pairs of predicted and true panels, and of their edges, at least total cost (Hungarian method)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from gcd_dataset.curves import sample_curve
from gcd_dataset.metrics.shapes import PanelShape, shape_or_none
from gcd_dataset.records import EdgeRef, Pattern

DISTANCE_SCALE = 20.0  # cm: a distance that costs as much as outlines without overlap
ANGLE_SCALE = np.pi / 2  # rad: a rotation that costs as much as outlines without overlap
FAR = 40.0  # cm: panels further apart match only if their outlines are alike
EDGE_POINTS = 9  # of an edge, to compare it
ALIKE = 0.5  # least intersection over union of outlines that are alike


@dataclass(frozen=True, eq=False)
class PanelPair:
    """A predicted panel and its match among the true panels."""

    predicted: PanelShape
    true: PanelShape
    iou: float
    """Intersection over union of the outlines, centroids aligned."""
    distance: float
    """Between the centroids in space [cm]."""
    angle: float
    """Between the placements [rad]."""


def match_panels(predicted: Pattern, true: Pattern) -> list[PanelPair]:
    """Matched panels of two patterns; predicted panels without a closed outline match nothing.

    Raises ``PatternError`` if a panel of ``true`` has no closed outline.
    """
    return match_shapes([shape_or_none(p) for p in predicted.panels], [PanelShape.of(p) for p in true.panels])


def match_shapes(predicted: Sequence[PanelShape | None], true: Sequence[PanelShape]) -> list[PanelPair]:
    """The pairs of least total cost, without pairs that are neither near nor alike."""
    drawn = [shape for shape in predicted if shape is not None]
    if not drawn or not true:
        return []
    polygons = np.array([s.polygon for s in drawn])[:, None], np.array([s.polygon for s in true])[None]
    union = shapely.area(shapely.union(*polygons))
    iou = shapely.area(shapely.intersection(*polygons)) / np.where(union > 0, union, 1.0)
    distance = np.linalg.norm([[a.centre - b.centre for b in true] for a in drawn], axis=2)
    angle = np.array([[_angle(a.matrix, b.matrix) for b in true] for a in drawn])
    rows, columns = linear_sum_assignment((1 - iou) + distance / DISTANCE_SCALE + angle / ANGLE_SCALE)
    return [
        PanelPair(drawn[i], true[j], float(iou[i, j]), float(distance[i, j]), float(angle[i, j]))
        for i, j in zip(rows, columns, strict=True)
        if distance[i, j] <= FAR or iou[i, j] >= ALIKE
    ]


def matched_edges(pair: PanelPair) -> dict[EdgeRef, EdgeRef]:
    """Edge of the predicted panel to its match on the true panel, by the distance of the edges' midpoints."""
    ours, theirs = (_edge_points(shape, 3)[:, 1] for shape in (pair.predicted, pair.true))
    distance = np.linalg.norm(ours[:, None] - theirs, axis=2)
    pairs = zip(*(side.tolist() for side in linear_sum_assignment(distance)), strict=True)
    return {EdgeRef(pair.predicted.panel.name, i): EdgeRef(pair.true.panel.name, j) for i, j in pairs}


def edges_apart(pair: PanelPair) -> float:
    """Largest distance of matched edges at equal shares of their length, centroids of the panels aligned [cm]."""
    ours, theirs = (_edge_points(shape, EDGE_POINTS) for shape in (pair.predicted, pair.true))
    matched = matched_edges(pair).items()
    return max(float(np.linalg.norm(ours[a.edge] - theirs[b.edge], axis=1).max()) for a, b in matched)


def _angle(one: Float[np.ndarray, "3 3"], other: Float[np.ndarray, "3 3"]) -> float:
    """Angle between two rotations [rad]; by atan2, since arccos loses all digits near 0."""
    rotation = one.T @ other
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1))


def _edge_points(shape: PanelShape, count: int) -> Float[np.ndarray, "e count 2"]:
    """Points at equal shares of the length of every edge, both ends included, as ``shape.loop`` has them [cm]."""
    panel = shape.panel
    points = [sample_curve(*panel.edge_ends(i), edge.curve, count) for i, edge in enumerate(panel.edges)]
    return shape.seen(np.array(points))
