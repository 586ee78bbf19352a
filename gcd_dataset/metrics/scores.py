"""The scores of a pattern, their means over a test set, and confidence intervals."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from gcd_dataset.curves import signed_area
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.metrics.matching import FAR, edges_apart, match_shapes
from gcd_dataset.metrics.seams import seam_counts, seam_lengths_score, seam_mismatch
from gcd_dataset.metrics.shapes import PanelShape, resample_loop, shape_or_none
from gcd_dataset.records import Pattern

CONTOUR_POINTS = 256
SHIFTS = 64  # starts of the predicted contour that are tried, besides its corners
SMALLEST_AREA = 1.0  # cm²: a smaller panel cannot be sewn
SAME_OUTLINE = 0.9  # least intersection over union of a right panel
EDGE_APART = 1.0  # cm: distance of a right edge
DRAWS_AT_ONCE = 100  # resampled test sets in memory


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
    """Mean distance of matched outlines, centroids aligned, at equal shares of their length; for each panel at most the
    mean radius of the true one, and in all at most the mean of these radii [cm]."""
    panel_l2_pen: float
    """``panel_l2`` over all true panels; an unmatched panel counts with its mean radius [cm]."""
    transl_cm: float
    """Distance between the centroids of matched panels in space, for each panel at most 40 [cm]."""
    rot_deg: float
    """Angle between the placements of matched panels [degrees]."""
    stitch_p: float
    """Precision of the seams as pairs of edges: share of the predicted seams that are true."""
    stitch_r: float
    """Recall of the seams as pairs of edges: share of the true seams that are predicted."""
    stitch_f1: float
    """Harmonic mean of precision and recall."""
    stitch_nm_p: float
    """Precision of the seams by length, however their edges are subdivided; see ``seam_lengths_score``."""
    stitch_nm_r: float
    """Recall of the seams by length."""
    stitch_nm_f1: float
    """Harmonic mean of both."""
    stitch_nm_perfect: float
    """1 if all seams by length are right and none is missing, in the right direction."""
    panel_f1: float
    """F1 of the panels; a predicted panel is right if it is matched with an IoU of 0.9 or more."""
    garment_perfect: float
    """1 if all seams are right and none is missing: ``stitch_f1`` is 1. Which ends meet does not count."""
    combinatorial: float
    """1 if every panel is matched, none is missing, all numbers of edges are right, and all seams join the right ends
    of the right edges. Sizes and shapes do not count."""
    edges_within_1cm: float
    """1 if ``combinatorial``, and all edges lie within 1 cm of the true ones, centroids of the panels aligned."""
    seam_mismatch: float
    """Mean of the difference of a predicted seam's lengths over the larger; gathers count. 1 if no seam is predicted
    where the true pattern has some."""


def score_pattern(predicted: Pattern, true: Pattern) -> PatternScore:
    """Scores of ``predicted`` against ``true``. Predicted panels without a closed outline match nothing.

    Lines inside panels, and their seams, count in ``valid`` alone. Raises ``PatternError`` if a panel of ``true`` has
    no closed outline.
    """
    whole, predicted, true = predicted, predicted.without_lines(), true.without_lines()
    true_shapes = [PanelShape.of(panel) for panel in true.panels]
    predicted_shapes = [shape_or_none(panel) for panel in predicted.panels]
    pairs = match_shapes(predicted_shapes, true_shapes)
    larger = max(len(predicted_shapes), len(true_shapes))
    contours = {shape: resample_loop(shape.loop, CONTOUR_POINTS) for shape in true_shapes}
    radii = {shape: float(np.linalg.norm(contour, axis=1).mean()) for shape, contour in contours.items()}
    distances = {p.true: min(_contour_distance(p.predicted, contours[p.true]), radii[p.true]) for p in pairs}
    penalised = _mean([distances.get(shape, radius) for shape, radius in radii.items()], 0.0)
    worst = _mean(list(radii.values()), 0.0)
    alike = sum(pair.iou >= SAME_OUTLINE for pair in pairs)
    right_edges = sum(len(pair.predicted.panel.edges) == len(pair.true.panel.edges) for pair in pairs)
    right, directed, found, wanted = seam_counts(predicted, true, pairs)
    combinatorial = directed == found == wanted and len(pairs) == right_edges == larger
    named = {shape.panel.name: shape for shape in predicted_shapes if shape is not None}
    by_length = seam_lengths_score(predicted, true, pairs, named, {shape.panel.name: shape for shape in true_shapes})
    return PatternScore(
        valid=float(_can_be_sewn(whole, predicted_shapes)),
        panel_count_acc=float(len(predicted_shapes) == len(true_shapes)),
        edge_count_acc=right_edges / larger if larger else 1.0,
        iou=sum(pair.iou for pair in pairs) / larger if larger else 1.0,
        panel_l2=min(_mean(list(distances.values()), worst), worst),  # the panels that match may be the large ones
        panel_l2_pen=penalised,
        transl_cm=_mean([min(pair.distance, FAR) for pair in pairs], FAR if larger else 0.0),
        rot_deg=_mean([float(np.degrees(pair.angle)) for pair in pairs], 180.0 if larger else 0.0),
        stitch_p=right / found if found else float(not wanted),
        stitch_r=right / wanted if wanted else float(not found),
        stitch_f1=2 * right / (found + wanted) if found + wanted else 1.0,
        stitch_nm_p=by_length[0],
        stitch_nm_r=by_length[1],
        stitch_nm_f1=by_length[2],
        stitch_nm_perfect=by_length[3],
        panel_f1=2 * alike / (len(predicted_shapes) + len(true_shapes)) if larger else 1.0,
        garment_perfect=float(right == found == wanted),
        combinatorial=float(combinatorial),
        edges_within_1cm=float(combinatorial and all(edges_apart(pair) <= EDGE_APART for pair in pairs)),
        seam_mismatch=seam_mismatch(predicted, named) if found or not wanted else 1.0,
    )


def failed_score(true: Pattern) -> PatternScore:
    """The score of a garment whose prediction is missing or cannot be read: the worst value of every score.

    Distances are those of a prediction without a matched panel. Raises ``PatternError`` as ``score_pattern`` does.
    """
    nothing = score_pattern(Pattern("", (), ()), true)
    shares = {field.name: 0.0 for field in fields(PatternScore) if not field.name.startswith("panel_l2")}
    return replace(nothing, **(shares | {"transl_cm": FAR, "rot_deg": 180.0, "seam_mismatch": 1.0}))


def mean_scores(scores: Sequence[PatternScore]) -> PatternScore:
    """The mean of each score. Raises ``ValueError`` for an empty sequence."""
    if not scores:
        raise ValueError("no scores to take the mean of")
    return PatternScore(*np.mean([astuple(score) for score in scores], axis=0).tolist())


def bootstrap_means(
    values: Float[np.ndarray, "n k"], rng: np.random.Generator, *, draws: int = 1000
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Lower and upper ends of the 95 % confidence interval of the mean of each column (percentile bootstrap).

    ``draws``: number of resampled test sets. Raises ``ValueError`` without rows. Efron and Tibshirani, An Introduction
    to the Bootstrap (1993), chapter 13.
    """
    count = len(values)
    if not count:
        raise ValueError("no values to take the mean of")
    parts = [min(DRAWS_AT_ONCE, draws - first) for first in range(0, draws, DRAWS_AT_ONCE)]
    means = [rng.multinomial(count, np.full(count, 1 / count), size=part) @ values / count for part in parts]
    low, high = np.quantile(np.concatenate(means), [0.025, 0.975], axis=0)
    return low, high


def _can_be_sewn(pattern: Pattern, shapes: Sequence[PanelShape | None]) -> bool:
    large = all(shape is not None and abs(signed_area(shape.loop)) > SMALLEST_AREA for shape in shapes)
    return large and not any(fault.severity is Severity.ERROR for fault in check_pattern(pattern))


def _contour_distance(predicted: PanelShape, target: Float[np.ndarray, "n 2"]) -> float:
    """Mean distance of the outlines at equal shares of their length, for the best start of the predicted one [cm]."""
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


def _mean(values: Sequence[float], otherwise: float) -> float:
    return float(np.mean(values)) if values else otherwise
