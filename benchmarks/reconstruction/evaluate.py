"""Scores of a network, and of the references beside it, on garments that training has not seen."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import torch

from benchmarks.cases.figures import Figure
from benchmarks.reconstruction.data import GarmentBatch, patterns_from
from benchmarks.reconstruction.models import PatternNet
from gcd_dataset.metrics import PatternScore, bootstrap_interval, mean_scores, score_pattern
from gcd_dataset.records import Pattern

__all__ = ["figures_of", "predict", "row_of", "scores_of"]

UNITS = {"panel_l2": "cm", "panel_l2_pen": "cm", "transl_cm": "cm", "rot_deg": "degrees"}
SEAMS = ("stitch_p", "stitch_r", "stitch_f1")


def predict(net: PatternNet, garments: GarmentBatch, *, batch: int, device: torch.device) -> list[Pattern]:
    """The patterns that the network sees in the garments' points."""
    net.eval()
    with torch.no_grad():
        parts = [
            net(garments.points[first : first + batch].to(device))[-1].garments()
            for first in range(0, len(garments), batch)
        ]
    return [pattern for part in parts for pattern in patterns_from(part)]


def scores_of(predicted: Sequence[Pattern], true: Sequence[Pattern], *, workers: int = 0) -> list[PatternScore]:
    """The score of each predicted pattern, by ``workers`` processes side by side."""
    if workers < 2:
        return [score_pattern(ours, theirs) for ours, theirs in zip(predicted, true, strict=True)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(score_pattern, predicted, true, chunksize=8))


def figures_of(who: str, scores: Sequence[PatternScore], *, seams: bool) -> list[Figure]:
    """The mean of each score as ``who_metric``; without those of the seams for answers that have none."""
    means = mean_scores(scores)
    return [
        Figure(f"{who}_{metric}", float(getattr(means, metric)), UNITS.get(metric, "share"))
        for metric in PatternScore.__dataclass_fields__
        if seams or metric not in SEAMS
    ]


def row_of(who: str, scores: Sequence[PatternScore], *, seams: bool) -> Mapping[str, str]:
    """The means with their 95 % intervals, as a row of the report."""
    means, (low, high) = mean_scores(scores), bootstrap_interval(scores, np.random.default_rng(0))

    def cell(metric: str) -> str:
        if metric in SEAMS and not seams:
            return "no seams"
        value, least, most = (float(getattr(score, metric)) for score in (means, low, high))
        return f"{value:.3g} ({least:.3g} to {most:.3g})"

    return {"answer": who, **{metric: cell(metric) for metric in PatternScore.__dataclass_fields__}}
