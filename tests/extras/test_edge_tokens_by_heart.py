"""Eight garments are learned by heart by the edge token network: a test of minutes, which the everyday tests leave
out."""

import torch

from benchmarks.reconstruction.garments import generated
from benchmarks.reconstruction.models.edge_tokens import build
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.metrics import mean_scores, score_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS

CPU = torch.device("cpu")


def test_eight_garments_are_learned_by_heart() -> None:
    torch.manual_seed(0)
    garments = generated(8, 0, points=1024, drape=None, resolution=4.0, design=SKIRTS)
    learner = build(smoke=True, options={})
    examples = learner.prepare(garments, device=CPU)
    config = TrainConfig(steps=1200, batch=8, lr=3e-3, weight_decay=0.0, ema=0.9)
    found = train(learner, examples, config, device=CPU)
    assert found.curve[-1]["loss"] < found.curve[0]["loss"] / 5
    answers = found.learner.predict(examples.batch(torch.arange(8)))
    score = mean_scores([score_pattern(answer, garments.pattern(k)) for k, answer in enumerate(answers)])
    assert (score.valid, score.panel_count_acc, score.edge_count_acc, score.stitch_f1) == (1, 1, 1, 1)
    assert score.iou > 0.9
