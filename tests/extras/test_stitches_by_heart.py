"""Eight generated patterns, learnt by heart: all stitches are right, up to the symmetries of the panels (80 s)."""

import pytest
import torch

from benchmarks.reconstruction.garments import pattern_of
from benchmarks.reconstruction.models import stitches
from benchmarks.reconstruction.models.stitches import StitchConfig, StitchLearner
from benchmarks.reconstruction.stitching.graphs import edge_refs, graph_of
from benchmarks.reconstruction.stitching.scores import score_stitches
from benchmarks.reconstruction.stitching.sewing import sew
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.loaders import GeneratedGarments

CONFIG = StitchConfig(width=96, heads=4, layers=4, pair_width=32)
DRAWN = 48
MOST_EDGES = 40  # attention takes time as the square of it


def test_all_stitches_of_eight_patterns_are_right(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stitches, "VARIANTS", (1.0, 1.0))  # as drawn: these are the patterns that are asked for
    names = ("panels", "edges", "stitches")
    garments = GeneratedGarments(DRAWN, 0, drape=None, stage="pattern", fields=names, dtype=None)
    items = (garments[k] for k in range(DRAWN))
    drawn = [(item["panels"].numpy(), item["edges"].numpy(), item["stitches"].numpy()) for item in items]
    arrays = [entry for entry in drawn if len(entry[1]) <= MOST_EDGES][:8]
    assert len(arrays) == 8
    torch.manual_seed(0)
    learner, device = StitchLearner(CONFIG), torch.device("cpu")
    config = TrainConfig(steps=2200, batch=8, lr=1.5e-3, ema=0.98)
    trained = train(learner, learner.examples(arrays, device=device), config, device=device)
    assert isinstance(trained.learner, StitchLearner)
    for k, pattern in enumerate(sew(trained.learner.net, [pattern_of(entry) for entry in arrays])):
        rows = {ref: row for row, ref in enumerate(edge_refs(pattern))}
        stitches_found = [(rows[seam.left], rows[seam.right]) for seam in pattern.seams]
        assert score_stitches(graph_of(pattern_of(arrays[k])), stitches_found).perfect_symmetric == 1.0, k
