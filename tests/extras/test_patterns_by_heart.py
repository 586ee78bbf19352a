"""Eight garments are learned by heart by the other models of patterns: a minute each."""

import torch

from benchmarks.reconstruction.garments import generated
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.tasks import NAMED
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.metrics import mean_scores, score_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS

CPU = torch.device("cpu")


def test_eight_garments_are_learned_by_heart() -> None:
    torch.manual_seed(0)
    module = load_model("parameters")
    garments = generated(8, 0, points=1024, extra=NAMED, drape=None, resolution=4.0, design=SKIRTS)
    learner = module.build(smoke=True, options={})
    examples = learner.prepare(garments, device=CPU)
    trained = train(learner, examples, TrainConfig(**{**module.SMOKE, "steps": 300}), device=CPU)
    assert trained.curve[-1]["loss"] < trained.curve[0]["loss"] / 5
    answers = trained.learner.predict(examples.batch(torch.arange(8)))
    score = mean_scores([score_pattern(answer, garments.pattern(k)) for k, answer in enumerate(answers)])
    assert (score.valid, score.panel_count_acc) == (1, 1)
    assert score.iou > 0.85
    assert score.stitch_f1 > 0.85
