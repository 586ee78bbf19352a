"""Scores of a predicted pattern against the true one.

Panels are matched by outline and placement in space. Renaming or reordering panels, moving the first corner of a loop
or a panel's local origin, or drawing a panel from its other side changes no score. The direction of a panel's axes is
part of its placement and counts in ``rot_deg``.

Means include every garment: an unmatched panel counts as missing, a prediction without any match gets the worst score,
and ``failed_score`` is the score of a prediction that is missing or cannot be read.

``answers`` has the scores of labels of vertices, of measures and of drapes.
"""

from gcd_dataset.metrics.answers import (
    DrapeScore,
    MeasureScore,
    TrueLabels,
    VertexLabels,
    VertexScore,
    assigned,
    score_drape,
    score_labels,
    score_measures,
    score_motion,
    true_labels,
)
from gcd_dataset.metrics.matching import PanelPair, match_panels, matched_edges
from gcd_dataset.metrics.scores import PatternScore, bootstrap_means, failed_score, mean_scores, score_pattern
from gcd_dataset.metrics.seams import SewnPiece, seam_lengths_score, sewn_pieces
from gcd_dataset.metrics.shapes import PanelShape, resample_loop

__all__ = [
    "DrapeScore", "MeasureScore", "PanelPair", "PanelShape", "PatternScore", "SewnPiece", "TrueLabels", "VertexLabels",
    "VertexScore", "assigned", "bootstrap_means", "failed_score", "match_panels", "matched_edges", "mean_scores",
    "resample_loop", "score_drape", "score_labels", "score_measures", "score_motion", "score_pattern",
    "seam_lengths_score", "sewn_pieces", "true_labels",
]  # fmt: skip
