"""Few draped garments are learned by heart in each of the tasks T4, T5 and T6, and the command runs: minutes."""

import csv
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.judging import judge_of
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.tasks import SURFACES, task_named
from benchmarks.reconstruction.train import main, train
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.benchmarks.reconstruction.toys import small

CPU = torch.device("cpu")


@cache
def skirts() -> GarmentSet:
    return generated(4, 0, points=64, extra=(*SURFACES, "person"), resolution=8.0, design=SKIRTS)


def by_heart(model: str, steps: int, **options: Any) -> tuple[list[Any], list[dict[str, float]]]:
    """Scores of four garments after a training on them, and the curve."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    module, garments = load_model(model), skirts()
    learner = small(model, **options)
    examples = learner.prepare(garments, device=CPU)
    config = Config(**{**module.SMOKE, "steps": steps, "batch": 4, "log_every": 1})
    trained = train(learner, examples, config, device=CPU)
    answers = trained.learner.predict(examples.batch(torch.arange(len(garments))))
    return judge_of(task_named(module.TASKS[0]), watching=True).scores(answers, garments), trained.curve


def test_the_labels_of_four_meshes() -> None:
    scores, curve = by_heart("segmentation", 130)
    assert curve[-1]["loss"] < curve[0]["loss"] / 5
    assert np.mean([score.panel_label for score in scores]) > 0.97
    assert np.mean([score.panel_class for score in scores]) > 0.97


def test_the_measures_of_four_bodies() -> None:
    scores, curve = by_heart("measures", 130)
    assert curve[-1]["loss"] < curve[0]["loss"] / 5
    assert np.mean([score.error_cm for score in scores]) < 1.0


def test_the_drapes_of_four_garments() -> None:
    scores, curve = by_heart("drape_surrogate", 300)
    assert curve[-1]["loss"] < curve[0]["loss"] / 5
    assert np.mean([score.error_cm for score in scores]) < 3.0


@pytest.mark.parametrize(
    ("model", "task", "headline"),
    [
        ("segmentation", "T4", "panel_label"),
        ("nearest_labels", "T4", "panel_label"),
        ("measures", "T5", "error_cm"),
        ("mean_measures", "T5", "error_cm"),
        ("nearest_measures", "T5", "error_cm"),
        ("drape_surrogate", "T6", "error_cm"),
        ("box_mesh", "T6", "error_cm"),
        ("coarse_drape", "T6", "error_cm"),
    ],
)
def test_the_command_trains_and_scores(
    model: str, task: str, headline: str, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    out, data = tmp_path_factory.mktemp(model), tmp_path_factory.getbasetemp() / "garments"
    flags = ["--task", task, "--smoke", "--train", "4", "--test", "2", "--resolution", "8", "--steps", "3"]
    assert main(["--model", model, *flags, "--device", "cpu", "--data", str(data), "--out", str(out)]) == 0
    assert f"{task}.{model}.{headline} " in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    with (out / "scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    mean, low, high = report["scores"][headline]
    assert sum(float(row[headline]) for row in rows) / len(rows) == pytest.approx(mean)
    assert low <= mean <= high
    assert (out / "pictures" / "test.png").stat().st_size > 1000
    assert len(list((out / "predictions").iterdir())) == len(rows) == report["data"]["test"]["count"]
    assert Path(out / "curves.csv").exists() == (model in ("segmentation", "measures", "drape_surrogate"))
