"""Scores of a predicted pattern against the true one.

Panels are matched by outline and placement in space. Renaming or reordering panels, moving the first corner of a loop
or a panel's local origin, or drawing a panel from its other side changes no score. The direction of a panel's axes is
part of its placement and counts in ``rot_deg``.

Means include every garment: an unmatched panel counts as missing, and a prediction without any match gets the worst
score.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np
import shapely
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment, minimize_scalar

from gcd_dataset.curves import LINE, sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.records import EdgeRef, Panel, Pattern
from gcd_dataset.tensors import area_centroid, require_closed
from gcd_dataset.validate import Severity, check_pattern

__all__ = ["PanelShape", "PatternScore", "bootstrap_interval", "mean_scores", "resample_loop", "score_pattern"]

CURVE_SAMPLES = 33  # points of a curved edge: an error of 1e-4 r for a quarter circle
CONTOUR_POINTS = 256
SHIFTS = 64  # starts of the predicted contour that are tried, besides its corners
DISTANCE_SCALE = 20.0  # cm: a distance that costs as much as outlines without overlap
ANGLE_SCALE = np.pi / 2  # rad: a rotation that costs as much as outlines without overlap
FAR = 40.0  # cm: panels further apart match only if their outlines are alike
ALIKE = 0.5  # least intersection over union of outlines that are alike
SMALLEST_AREA = 1.0  # cm²: a smaller panel cannot be sewn


@dataclass(frozen=True, slots=True)
class PatternScore:
    """Scores of one predicted pattern, or their means. Shares lie in [0, 1], 1 is best; distances are best at 0."""

    valid: float
    """1 for a pattern that can be sewn: no error of ``check_pattern``, every panel larger than 1 cm²."""
    panel_count_acc: float
    """1 for the right number of panels."""
    edge_count_acc: float
    """Matched panels with the right number of edges, divided by the larger number of panels."""
    iou: float
    """Sum of the IoU of matched outlines, centroids aligned, divided by the larger number of panels."""
    panel_l2: float
    """Mean distance of matched outlines, centroids aligned, at equal shares of their length [cm]."""
    panel_l2_pen: float
    """``panel_l2`` over all true panels; an unmatched panel counts with its mean radius [cm]."""
    transl_cm: float
    """Distance between the centroids of matched panels in space [cm]."""
    rot_deg: float
    """Angle between the placements of matched panels [degrees]."""
    stitch_p: float
    """Precision of the seams: share of the predicted seams that are true."""
    stitch_r: float
    """Recall of the seams: share of the true seams that are predicted."""
    stitch_f1: float
    """Harmonic mean of precision and recall."""


def score_pattern(predicted: Pattern, true: Pattern) -> PatternScore:
    """Scores of ``predicted`` against ``true``. Predicted panels without a closed outline match nothing.

    Raises ``PatternError`` if a panel of ``true`` has no closed outline.
    """
    true_shapes = [PanelShape.of(panel) for panel in true.panels]
    predicted_shapes = [_shape_or_none(panel) for panel in predicted.panels]
    pairs = _matches(predicted_shapes, true_shapes)
    larger = max(len(predicted_shapes), len(true_shapes))
    distances = {pair.true: _contour_distance(pair.predicted, pair.true) for pair in pairs}
    radii = [float(np.linalg.norm(shape.contour(), axis=1).mean()) for shape in true_shapes]
    penalised = _mean([distances.get(shape, radius) for shape, radius in zip(true_shapes, radii, strict=True)], 0.0)
    right_edges = sum(len(pair.predicted.panel.edges) == len(pair.true.panel.edges) for pair in pairs)
    precision, recall, f1 = _stitch_scores(predicted, true, pairs)
    return PatternScore(
        valid=float(_can_be_sewn(predicted, predicted_shapes)),
        panel_count_acc=float(len(predicted_shapes) == len(true_shapes)),
        edge_count_acc=right_edges / larger if larger else 1.0,
        iou=sum(pair.iou for pair in pairs) / larger if larger else 1.0,
        panel_l2=_mean(list(distances.values()), penalised),
        panel_l2_pen=penalised,
        transl_cm=_mean([pair.distance for pair in pairs], FAR if larger else 0.0),
        rot_deg=_mean([float(np.degrees(pair.angle)) for pair in pairs], 180.0 if larger else 0.0),
        stitch_p=precision,
        stitch_r=recall,
        stitch_f1=f1,
    )


def mean_scores(scores: Sequence[PatternScore]) -> PatternScore:
    """The mean of each score. Raises ``ValueError`` for an empty sequence."""
    if not scores:
        raise ValueError("no scores to take the mean of")
    return PatternScore(*np.mean([astuple(score) for score in scores], axis=0).tolist())


def bootstrap_interval(
    scores: Sequence[PatternScore], rng: np.random.Generator, *, share: float = 0.95, draws: int = 1000
) -> tuple[PatternScore, PatternScore]:
    """Lower and upper ends of the ``share`` confidence interval of the mean scores (percentile bootstrap).

    ``draws``: number of resampled test sets.
    """
    values = np.array([astuple(score) for score in scores]).reshape(-1, len(fields(PatternScore)))
    chosen = rng.integers(len(values), size=(draws, len(values)))
    low, high = np.quantile(values[chosen].mean(axis=1), [(1 - share) / 2, (1 + share) / 2], axis=0)
    return PatternScore(*low.tolist()), PatternScore(*high.tolist())


def resample_loop(
    loop: Float[np.ndarray, "n 2"], count: int, offsets: Float[np.ndarray, "*o"] | float = 0.0
) -> Float[np.ndarray, "*o count 2"]:
    """``count`` points equally spaced along a closed polyline; the first lies ``offsets`` after the polyline's start.

    Offsets are arc lengths in the unit of ``loop``; an array of offsets gives one set of points for each.
    """
    closed = np.concatenate([loop, loop[:1]])
    arc_length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    total = arc_length[-1]
    at = (np.asarray(offsets)[..., None] + np.arange(count) / count * total) % total if total else np.zeros(count)
    return np.stack([np.interp(at, arc_length, closed[:, axis]) for axis in (0, 1)], axis=-1)


# --------------------------------------------------------------------------------------------------------------- shapes


@dataclass(frozen=True, eq=False)
class PanelShape:
    """A panel's outline about its centroid, seen from the right side of the cloth, and its position in space."""

    panel: Panel
    centroid: Float[np.ndarray, "2"]
    """In the panel's own coordinates [cm]."""
    side: float
    """1; or -1 for a panel whose loop runs clockwise, drawn from its wrong side."""
    loop: Float[np.ndarray, "n 2"]
    """Counter-clockwise polyline of the outline about the centroid [cm]; starts at the first corner."""
    polygon: shapely.Geometry
    centre: Float[np.ndarray, "3"]
    """The centroid in space [cm]."""
    matrix: Float[np.ndarray, "3 3"]
    """The rotation of ``loop``'s plane."""

    @staticmethod
    def of(panel: Panel) -> "PanelShape":
        """The shape of a panel. Raises ``PatternError`` for an open loop or an arc that does not span its chord."""
        outline = _polyline(panel)
        centroid, side = area_centroid(panel), float(np.copysign(1.0, _signed_area(outline)))
        loop = (outline - centroid) * [side, 1.0]
        return PanelShape(
            panel=panel,
            centroid=centroid,
            side=side,
            loop=loop,
            polygon=shapely.buffer(shapely.make_valid(shapely.Polygon(loop)), 0.0),
            centre=panel.placement.apply(centroid),
            matrix=panel.placement.matrix @ np.diag([side, 1.0, side]),
        )

    def seen(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Points of the panel's own coordinates about the centroid, as seen from the right side [cm]."""
        return (points - self.centroid) * [self.side, 1.0]

    def contour(self, count: int = CONTOUR_POINTS) -> Float[np.ndarray, "count 2"]:
        """Points at equal distances along the outline [cm]."""
        return resample_loop(self.loop, count)


def _shape_or_none(panel: Panel) -> PanelShape | None:
    try:
        return PanelShape.of(panel)
    except PatternError:
        return None


def _polyline(panel: Panel) -> Float[np.ndarray, "n 2"]:
    """The outline with sampled curves. Raises ``PatternError`` if it is not one closed loop."""
    require_closed(panel)
    if not np.all(np.isfinite(panel.vertices)):
        raise PatternError(f"panel {panel.name}: a vertex is not finite: correct its vertices")
    pieces = [
        sample_curve(*panel.edge_ends(index), edge.curve, 2 if edge.curve == LINE else CURVE_SAMPLES)[:-1]
        for index, edge in enumerate(panel.edges)
    ]
    loop = np.concatenate(pieces)
    if len(loop) < 3:
        raise PatternError(f"panel {panel.name}: {len(loop)} straight edges: close the outline")
    return loop


def _signed_area(loop: Float[np.ndarray, "n 2"]) -> float:
    x, y = loop.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _can_be_sewn(pattern: Pattern, shapes: Sequence[PanelShape | None]) -> bool:
    if any(fault.severity is Severity.ERROR for fault in check_pattern(pattern)):
        return False
    return all(shape is not None and abs(_signed_area(shape.loop)) > SMALLEST_AREA for shape in shapes)


# ------------------------------------------------------------------------------------------------------------- matching


@dataclass(frozen=True, eq=False)
class _Pair:
    """A predicted panel and its match among the true panels."""

    predicted: PanelShape
    true: PanelShape
    iou: float
    distance: float
    """Between the centroids in space [cm]."""
    angle: float
    """Between the placements [rad]."""


def _matches(predicted: Sequence[PanelShape | None], true: Sequence[PanelShape]) -> list[_Pair]:
    """The pairs of least total cost (Hungarian method), without pairs that are neither near nor alike."""
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
        _Pair(drawn[i], true[j], float(iou[i, j]), float(distance[i, j]), float(angle[i, j]))
        for i, j in zip(rows, columns, strict=True)
        if distance[i, j] <= FAR or iou[i, j] >= ALIKE
    ]


def _angle(one: Float[np.ndarray, "3 3"], other: Float[np.ndarray, "3 3"]) -> float:
    """Angle between two rotations [rad]; by atan2, since arccos loses all digits near 0."""
    rotation = one.T @ other
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1))


def _contour_distance(predicted: PanelShape, true: PanelShape) -> float:
    """Mean distance of the outlines at equal shares of their length, for the best start of the predicted one [cm]."""
    target = true.contour()
    steps = np.linalg.norm(np.diff(predicted.loop, axis=0, append=predicted.loop[:1]), axis=1)
    length = float(steps.sum())

    def distance(offsets: Float[np.ndarray, "*o"]) -> Float[np.ndarray, "*o"]:
        return np.linalg.norm(resample_loop(predicted.loop, CONTOUR_POINTS, offsets) - target, axis=-1).mean(axis=-1)

    starts = np.concatenate([np.arange(SHIFTS) / SHIFTS * length, np.cumsum(steps)])
    tried = distance(starts)
    best, step = starts[np.argmin(tried)], length / SHIFTS
    refined = minimize_scalar(
        lambda offset: float(distance(offset)), bounds=(best - step, best + step), method="bounded"
    )
    return float(min(tried.min(), refined.fun))


# ---------------------------------------------------------------------------------------------------------------- seams


def _stitch_scores(predicted: Pattern, true: Pattern, pairs: Sequence[_Pair]) -> tuple[float, float, float]:
    """Precision, recall and F1 of the seams; edges of matched panels are matched by their midpoints."""
    true_edge = {ref: other for pair in pairs for ref, other in _true_edges(pair).items()}
    found = {frozenset((true_edge.get(seam.left), true_edge.get(seam.right))) for seam in predicted.seams}
    wanted = {frozenset((seam.left, seam.right)) for seam in true.seams}
    right, n_predicted, n_true = len(found & wanted), len(predicted.seams), len(true.seams)
    if not n_predicted + n_true:
        return 1.0, 1.0, 1.0
    return right / max(n_predicted, 1), right / max(n_true, 1), 2 * right / (n_predicted + n_true)


def _true_edges(pair: _Pair) -> dict[EdgeRef, EdgeRef]:
    """Edge of the predicted panel to its match on the true panel."""
    middles = _edge_middles(pair.predicted)[:, None], _edge_middles(pair.true)[None]
    distance = np.linalg.norm(middles[0] - middles[1], axis=2)
    pairs = zip(*(side.tolist() for side in linear_sum_assignment(distance)), strict=True)
    return {EdgeRef(pair.predicted.panel.name, i): EdgeRef(pair.true.panel.name, j) for i, j in pairs}


def _edge_middles(shape: PanelShape) -> Float[np.ndarray, "e 2"]:
    panel = shape.panel
    middles = [sample_curve(*panel.edge_ends(i), edge.curve, 3)[1] for i, edge in enumerate(panel.edges)]
    return shape.seen(np.array(middles))


def _mean(values: Sequence[float], otherwise: float) -> float:
    return float(np.mean(values)) if values else otherwise
