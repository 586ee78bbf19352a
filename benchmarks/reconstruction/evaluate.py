"""Scores of a network and of references on the test garments."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from benchmarks.cases.figures import Figure
from gcd_dataset.metrics import PatternScore, bootstrap_interval, mean_scores, score_pattern
from gcd_dataset.records import Pattern

__all__ = ["figures_of", "row_of", "scores_of"]

UNITS = {"panel_l2": "cm", "panel_l2_pen": "cm", "transl_cm": "cm", "rot_deg": "degrees"}
SEAMS = ("stitch_p", "stitch_r", "stitch_f1")


def scores_of(predicted: Sequence[Pattern], true: Sequence[Pattern], *, workers: int = 0) -> list[PatternScore]:
    """The score of each predicted pattern, computed by ``workers`` processes."""
    if workers < 2:
        return [score_pattern(ours, theirs) for ours, theirs in zip(predicted, true, strict=True)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(score_pattern, predicted, true, chunksize=8))


def figures_of(answer: str, scores: Sequence[PatternScore], *, seams: bool) -> list[Figure]:
    """Mean scores as ``answer_metric``; without seam scores for an answer that has no seams."""
    means = mean_scores(scores)
    return [
        Figure(f"{answer}_{metric}", float(getattr(means, metric)), UNITS.get(metric, "share"))
        for metric in PatternScore.__dataclass_fields__
        if seams or metric not in SEAMS
    ]


def row_of(answer: str, scores: Sequence[PatternScore], *, seams: bool) -> Mapping[str, str]:
    """A table row: mean scores with 95 % intervals."""
    means, (low, high) = mean_scores(scores), bootstrap_interval(scores, np.random.default_rng(0))

    def cell(metric: str) -> str:
        if metric in SEAMS and not seams:
            return "no seams"
        value, least, most = (float(getattr(score, metric)) for score in (means, low, high))
        return f"{value:.3g} ({least:.3g} to {most:.3g})"

    return {"answer": answer, **{metric: cell(metric) for metric in PatternScore.__dataclass_fields__}}
