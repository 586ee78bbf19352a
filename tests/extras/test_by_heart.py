"""Models of patterns learn a few garments by heart."""

from functools import cache
from typing import Any

import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, generated, pattern_of
from benchmarks.reconstruction.models import load_model, stitches
from benchmarks.reconstruction.models.stitches import StitchLearner
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.stitching.graphs import edge_refs, graph_of
from benchmarks.reconstruction.stitching.net import StitchConfig
from benchmarks.reconstruction.stitching.scores import score_stitches
from benchmarks.reconstruction.stitching.sewing import sew
from benchmarks.reconstruction.tasks import NAMED
from benchmarks.reconstruction.train import train
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.metrics import mean_scores, score_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.benchmarks.reconstruction.toys import small

CPU = torch.device("cpu")
COUNT = 4


@cache
def garments_of(count: int) -> GarmentSet:
    return generated(count, 0, points=1024, extra=NAMED, drape=None, resolution=4.0, design=SKIRTS)


def by_heart(model: str, garments: GarmentSet, **config: Any) -> tuple[list[Any], list[dict[str, float]]]:
    """The answers of a model to the garments that it was trained on, and the curve of this training."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    learner, count = small(model), len(garments)
    examples = learner.prepare(garments, device=CPU)
    trained = train(learner, examples, Config(**{**load_model(model).SMOKE, "batch": count, **config}), device=CPU)
    return trained.learner.predict(examples.batch(torch.arange(count))), trained.curve


FAST: dict[str, Any] = {"lr": 3e-3, "weight_decay": 0.0, "ema": 0.9}


@pytest.mark.parametrize(
    ("model", "count", "config", "least_iou"),
    [
        ("parameters", 4, {"steps": 200}, 0.85),
        ("panel_set", 2, {"steps": 200, **FAST}, 0.9),
        ("edge_tokens", 4, {"steps": 400, **FAST}, 0.9),
    ],
)
def test_the_patterns_of_a_few_garments(model: str, count: int, config: dict[str, Any], least_iou: float) -> None:
    garments = garments_of(count)
    answers, curve = by_heart(model, garments, **config)
    assert curve[-1]["loss"] < curve[0]["loss"] / 4
    score = mean_scores([score_pattern(answer, garments.pattern(k)) for k, answer in enumerate(answers)])
    assert (score.valid, score.panel_count_acc, score.stitch_f1) == (1, 1, 1)
    assert score.iou > least_iou


DRAWN, MOST_EDGES = 48, 30  # attention takes time as the square of the edges


def test_all_stitches_of_four_patterns(monkeypatch: pytest.MonkeyPatch) -> None:
    """All are right, up to the symmetries of the panels."""
    torch.set_num_threads(1)
    monkeypatch.setattr(stitches, "VARIANTS", (1.0, 1.0))  # as drawn: these are the patterns that are asked for
    names = ("panels", "edges", "stitches")
    garments = GeneratedGarments(DRAWN, 0, drape=None, stage="pattern", fields=names, dtype=None)
    items = (garments[k] for k in range(DRAWN))
    drawn = [(item["panels"].numpy(), item["edges"].numpy(), item["stitches"].numpy()) for item in items]
    arrays = [entry for entry in drawn if len(entry[1]) <= MOST_EDGES][:COUNT]
    torch.manual_seed(0)
    learner = StitchLearner(StitchConfig(width=64, heads=4, layers=3, pair_width=32))
    config = Config(steps=700, batch=COUNT, lr=1.5e-3, ema=0.98)
    trained = train(learner, learner.examples(arrays, device=CPU), config, device=CPU).learner
    assert isinstance(trained, StitchLearner)
    for k, pattern in enumerate(sew(trained.net, [pattern_of(entry) for entry in arrays])):
        rows = {ref: row for row, ref in enumerate(edge_refs(pattern))}
        found = [(rows[seam.left], rows[seam.right]) for seam in pattern.seams]
        assert score_stitches(graph_of(pattern_of(arrays[k])), found).perfect_symmetric == 1.0, k
