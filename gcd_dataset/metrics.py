"""How close a predicted pattern is to the true one, whatever it calls its panels and wherever its loops start.

Panels are matched by what they are in space: their outlines, and where they hang. Renaming or reordering panels, moving
the first corner of a loop or a panel's local origin, or drawing a panel from its other side changes no score. Which way
a panel's own axes point is part of its placement: they count in ``rot_deg``.

No garment is left out of a mean: what cannot be matched counts as missing, and a prediction without one match gets the
worst value there is.
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

CURVE_SAMPLES = 33  # points that stand for a curved edge: an arc of a quarter circle is 0.1 permille of r off
CONTOUR_POINTS = 256
SHIFTS = 64  # first guesses of where the other contour starts, beside its corners
DISTANCE_SCALE = 20.0  # cm apart that weigh as much as outlines that do not overlap
ANGLE_SCALE = np.pi / 2  # the same for how far panels are turned against each other
FAR = 40.0  # cm: panels further apart are one panel only if their outlines say so
ALIKE = 0.5  # intersection over union from which they do
SMALLEST_AREA = 1.0  # cm²: nobody sews less


@dataclass(frozen=True, slots=True)
class PatternScore:
    """Scores of one predicted pattern, or their means. Shares are in [0, 1], and 1 is best; distances are best at 0."""

    valid: float
    """1 where it can be sewn: no fault of ``check_pattern``, no panel of 1 cm² or less."""
    panel_count_acc: float
    """1 where the number of panels is right."""
    edge_count_acc: float
    """Matched panels with the right number of edges, of the larger number of panels."""
    iou: float
    """Intersection over union of matched outlines laid centroid on centroid; over the larger number of panels."""
    panel_l2: float
    """Mean distance between matched outlines, laid centroid on centroid, at equal shares of their length [cm]."""
    panel_l2_pen: float
    """The same over all true panels, where one without match costs its mean radius [cm]."""
    transl_cm: float
    """Distance between the centroids of matched panels in space [cm]."""
    rot_deg: float
    """Angle between the placements of matched panels [degrees]."""
    stitch_p: float
    """Seams predicted that are true, of those predicted."""
    stitch_r: float
    """The same, of those that are true."""
    stitch_f1: float
    """Harmonic mean of both."""


def score_pattern(predicted: Pattern, true: Pattern) -> PatternScore:
    """How close ``predicted`` comes to ``true``. Predicted panels that cannot be drawn match nothing.

    Raises ``PatternError`` where a panel of ``true`` cannot be drawn.
    """
    theirs = [PanelShape.of(panel) for panel in true.panels]
    ours = [_shape_or_none(panel) for panel in predicted.panels]
    pairs = _matches(ours, theirs)
    larger = max(len(ours), len(theirs))
    distances = {pair.theirs: _contour_distance(pair.ours, pair.theirs) for pair in pairs}
    radii = [float(np.linalg.norm(shape.contour(), axis=1).mean()) for shape in theirs]
    penalised = _mean([distances.get(shape, radius) for shape, radius in zip(theirs, radii, strict=True)], 0.0)
    right_edges = sum(len(pair.ours.panel.edges) == len(pair.theirs.panel.edges) for pair in pairs)
    precision, recall, f1 = _stitch_scores(predicted, true, pairs)
    return PatternScore(
        valid=float(_can_be_sewn(predicted, ours)),
        panel_count_acc=float(len(ours) == len(theirs)),
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
    """The mean of each score. Raises ``ValueError`` for none."""
    if not scores:
        raise ValueError("no scores to take the mean of")
    return PatternScore(*np.mean([astuple(score) for score in scores], axis=0).tolist())


def bootstrap_interval(
    scores: Sequence[PatternScore], rng: np.random.Generator, *, share: float = 0.95, draws: int = 1000
) -> tuple[PatternScore, PatternScore]:
    """Between what the means would lie for ``share`` of test sets like this one (percentile bootstrap)."""
    values = np.array([astuple(score) for score in scores]).reshape(-1, len(fields(PatternScore)))
    chosen = rng.integers(len(values), size=(draws, len(values)))
    low, high = np.quantile(values[chosen].mean(axis=1), [(1 - share) / 2, (1 + share) / 2], axis=0)
    return PatternScore(*low.tolist()), PatternScore(*high.tolist())


def resample_loop(
    loop: Float[np.ndarray, "n 2"], count: int, offsets: Float[np.ndarray, "*o"] | float = 0.0
) -> Float[np.ndarray, "*o count 2"]:
    """``count`` points at equal distances along a closed polyline, ``offsets`` [its unit] behind its first point."""
    closed = np.concatenate([loop, loop[:1]])
    reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    length = reached[-1]
    at = (np.asarray(offsets)[..., None] + np.arange(count) / count * length) % length if length else np.zeros(count)
    return np.stack([np.interp(at, reached, closed[:, axis]) for axis in (0, 1)], axis=-1)


# --------------------------------------------------------------------------------------------------------------- shapes


@dataclass(frozen=True, eq=False)
class PanelShape:
    """A panel as a thing in space: its outline about its centroid, seen from its right side, and how it hangs."""

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
        """Raises ``PatternError`` for a loop that is not closed or an arc that does not span its chord."""
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
    """The outline, curves sampled. Raises ``PatternError`` where it is not one closed loop."""
    require_closed(panel)
    if not np.all(np.isfinite(panel.vertices)):
        raise PatternError(f"panel {panel.name}: a corner is no point: mend its vertices")
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
    """A predicted panel and the true one it stands for."""

    ours: PanelShape
    theirs: PanelShape
    iou: float
    distance: float
    """Between the centroids in space [cm]."""
    angle: float
    """Between the placements [rad]."""


def _matches(ours: Sequence[PanelShape | None], theirs: Sequence[PanelShape]) -> list[_Pair]:
    """The pairs of least total cost (Hungarian method), less those that are neither near nor alike."""
    drawn = [shape for shape in ours if shape is not None]
    if not drawn or not theirs:
        return []
    polygons = np.array([s.polygon for s in drawn])[:, None], np.array([s.polygon for s in theirs])[None]
    union = shapely.area(shapely.union(*polygons))
    iou = shapely.area(shapely.intersection(*polygons)) / np.where(union > 0, union, 1.0)
    distance = np.linalg.norm([[a.centre - b.centre for b in theirs] for a in drawn], axis=2)
    angle = np.array([[_angle(a.matrix, b.matrix) for b in theirs] for a in drawn])
    rows, columns = linear_sum_assignment((1 - iou) + distance / DISTANCE_SCALE + angle / ANGLE_SCALE)
    return [
        _Pair(drawn[i], theirs[j], float(iou[i, j]), float(distance[i, j]), float(angle[i, j]))
        for i, j in zip(rows, columns, strict=True)
        if distance[i, j] <= FAR or iou[i, j] >= ALIKE
    ]


def _angle(one: Float[np.ndarray, "3 3"], other: Float[np.ndarray, "3 3"]) -> float:
    """Angle of the rotation that takes one onto the other [rad]; by atan2, since arccos is blind near 0."""
    turn = one.T @ other
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1))


def _contour_distance(ours: PanelShape, theirs: PanelShape) -> float:
    """Mean distance of the outlines, point by point along them, for the best start of ours [cm]."""
    target = theirs.contour()
    steps = np.linalg.norm(np.diff(ours.loop, axis=0, append=ours.loop[:1]), axis=1)
    length = float(steps.sum())

    def distance(offsets: Float[np.ndarray, "*o"]) -> Float[np.ndarray, "*o"]:
        return np.linalg.norm(resample_loop(ours.loop, CONTOUR_POINTS, offsets) - target, axis=-1).mean(axis=-1)

    starts = np.concatenate([np.arange(SHIFTS) / SHIFTS * length, np.cumsum(steps)])
    tried = distance(starts)
    best, step = starts[np.argmin(tried)], length / SHIFTS
    refined = minimize_scalar(
        lambda offset: float(distance(offset)), bounds=(best - step, best + step), method="bounded"
    )
    return float(min(tried.min(), refined.fun))


# ---------------------------------------------------------------------------------------------------------------- seams


def _stitch_scores(predicted: Pattern, true: Pattern, pairs: Sequence[_Pair]) -> tuple[float, float, float]:
    """Precision, recall and F1 of the seams, edges of matched panels being matched by their middles."""
    called = {ref: other for pair in pairs for ref, other in _true_edges(pair).items()}
    claimed = {frozenset((called.get(seam.left), called.get(seam.right))) for seam in predicted.seams}
    actual = {frozenset((seam.left, seam.right)) for seam in true.seams}
    right, ours, theirs = len(claimed & actual), len(predicted.seams), len(true.seams)
    if not ours + theirs:
        return 1.0, 1.0, 1.0
    return right / max(ours, 1), right / max(theirs, 1), 2 * right / (ours + theirs)


def _true_edges(pair: _Pair) -> dict[EdgeRef, EdgeRef]:
    """The edge of the true panel that each edge of the predicted one stands for."""
    middles = _edge_middles(pair.ours)[:, None], _edge_middles(pair.theirs)[None]
    apart = np.linalg.norm(middles[0] - middles[1], axis=2)
    ours, theirs = pair.ours.panel.name, pair.theirs.panel.name
    pairs = zip(*(side.tolist() for side in linear_sum_assignment(apart)), strict=True)
    return {EdgeRef(ours, i): EdgeRef(theirs, j) for i, j in pairs}


def _edge_middles(shape: PanelShape) -> Float[np.ndarray, "e 2"]:
    panel = shape.panel
    middles = [sample_curve(*panel.edge_ends(i), edge.curve, 3)[1] for i, edge in enumerate(panel.edges)]
    return shape.seen(np.array(middles))


def _mean(values: Sequence[float], otherwise: float) -> float:
    return float(np.mean(values)) if values else otherwise
