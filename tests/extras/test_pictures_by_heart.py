"""The patterns of eight garments are learned by heart from their pictures: four minutes for each model."""

import pytest
import torch

from benchmarks.reconstruction.garments import generated
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.tasks import task_named
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.metrics import mean_scores, score_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS

CPU = torch.device("cpu")


@pytest.mark.parametrize("model", ["picture_set", "picture_parameters"])
def test_eight_garments_are_learned_by_heart(model: str) -> None:
    torch.manual_seed(0)
    torch.set_num_threads(1)
    module = load_model(model)
    garments = generated(8, 0, points=64, extra=task_named("T2").extra, resolution=6.0, design=SKIRTS)
    learner = module.build(smoke=True, options={})
    examples = learner.prepare(garments, device=CPU)
    config = TrainConfig(**{**module.SMOKE, "steps": 700, "batch": 8, "checks": 1})
    trained = train(learner, examples, config, device=CPU)
    assert trained.curve[-1]["loss"] < trained.curve[0]["loss"] / 5
    answers = trained.learner.predict(examples.batch(torch.arange(8)))
    score = mean_scores([score_pattern(answer, garments.pattern(k)) for k, answer in enumerate(answers)])
    assert (score.valid, score.panel_count_acc) == (1, 1)
    assert score.iou > 0.9
