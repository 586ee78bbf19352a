"""Few draped garments are learned by heart in each of the tasks T4, T5 and T6, and the command runs: minutes."""

import csv
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.judging import judge_of
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.tasks import SURFACES, task_named
from benchmarks.reconstruction.train import main
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.extras.test_by_heart import by_heart


@cache
def skirts() -> GarmentSet:
    return generated(4, 0, points=64, extra=(*SURFACES, "person"), resolution=8.0, design=SKIRTS)


@pytest.mark.parametrize(
    ("model", "steps", "limits"),
    [
        ("segmentation", 130, {"panel_label": (0.97, 1.01), "panel_class": (0.97, 1.01)}),
        ("measures", 130, {"error_cm": (0.0, 1.0)}),
        ("drape_surrogate", 300, {"error_cm": (0.0, 3.0)}),
    ],
)
def test_four_garments_are_learned(model: str, steps: int, limits: dict[str, tuple[float, float]]) -> None:
    """The labels of four meshes, the measures of four bodies and the drapes of four garments."""
    answers, curve = by_heart(model, skirts(), steps=steps, log_every=1)
    scores = judge_of(task_named(load_model(model).TASKS[0]), watching=True).scores(answers, skirts())
    assert curve[-1]["loss"] < curve[0]["loss"] / 5
    for name, (low, high) in limits.items():
        assert low < np.mean([getattr(score, name) for score in scores]) < high


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
