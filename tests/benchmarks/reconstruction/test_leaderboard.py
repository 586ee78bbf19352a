"""Reports of trained models, from files of results."""

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.reconstruction import leaderboard
from benchmarks.reconstruction.leaderboard import main
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.options import parsed
from benchmarks.reconstruction.results import read_entries


def result(
    task: str, model: str, exact: float, *, train: int = 4, tested: int = 500, patterns: str = "ef", **options: Any
) -> dict[str, Any]:
    data = {"count": train - 1, "patterns": "ab" * 32, "ids": "cd" * 32, "recipe": {}}
    test = {**data, "count": tested, "patterns": patterns * 32}
    return {
        "options": {"train": train, **options},
        "task": task, "model": model, "scores": {"topology_exact": [exact, exact - 0.1, exact + 0.1]},
        "scores_of_kinds": {"skirt": {"topology_exact": 0.25}}, "data": {"train": data, "test": test},
        "minutes": 8.0, "steps": 10, "parameters": 1234, "device": "NVIDIA H200",
    }  # fmt: skip


def added(folder: Path, found: dict[str, Any]) -> int:
    path = folder / "report.json"
    path.write_text(json.dumps(found))
    return main(["--reports", str(folder), "--add", str(path), "--command", "python -m x", "--commit", "abc"])


def test_the_best_model_of_a_task_comes_first(tmp_path: Path) -> None:
    assert added(tmp_path, result("T0", "nearest", 0.2)) == 0
    assert added(tmp_path, result("T0", "panel_set", 0.7)) == 0
    assert [entry.model for entry in read_entries(tmp_path / "learning")] == ["panel_set", "nearest"]
    page, board = (tmp_path / "learning_T0.md").read_text(), (tmp_path / "leaderboard.md").read_text()
    for text in (page, board):
        assert text.index("| panel_set | 4 | 8.0 | 0.7 (0.6 to 0.8) |") < text.index("| nearest | 4 |")
    assert "| Of skirt | 0.25 |" in page
    assert "- command: `python -m x`" in page


@pytest.mark.parametrize("text", ["{", "[]", '{"a": 1}', '{"scores": {}}'])
def test_another_file_is_refused(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "report.json").write_text(text)
    assert main(["--reports", str(tmp_path), "--add", str(tmp_path / "report.json"), "--command", "x"]) == 1
    assert "report.json" in capsys.readouterr().err
    assert not (tmp_path / "learning").exists()


@pytest.mark.parametrize(
    "changed",
    [
        {"scores": {"iou": ["a", "b", "c"]}},
        {"scores": {"iou": None}},
        {"scores": {"iou": [0.5, 0.4]}},
        {"scores": {"iou": [float("nan")] * 3}},
        {"scores": [1, 2]},
        {"scores_of_kinds": {"skirt": {"iou": None}}},
        {"minutes": "abc"},
        {"minutes": float("inf")},
        {"task": "T9"},
        {"task": "../x"},
        {"task": 5},
    ],
)
def test_a_malformed_report_is_refused_and_not_kept(
    changed: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert added(tmp_path, result("T0", "nearest", 0.2)) == 0
    assert added(tmp_path, result("T0", "panel_set", 0.2) | changed) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert [path.name for path in (tmp_path / "learning").iterdir()] == ["t0_nearest_4_8min.json"]


def test_scores_are_drawn_against_the_number_of_garments(tmp_path: Path) -> None:
    added(tmp_path, result("T1", "panel_set", 0.3, train=1000))
    assert not (tmp_path / "learning_T1.png").exists()
    added(tmp_path, result("T1", "panel_set", 0.5, train=4000))
    added(tmp_path, result("T1", "panel_set", 0.8, train=4000, fresh=65536) | {"fresh": 6000})
    added(tmp_path, result("T1", "nearest", 0.2, train=4000))
    page = (tmp_path / "learning_T1.md").read_text()
    assert "| score | model | 1,000 | 4,000 | 10,000 |" in page
    assert (
        "| topology_exact | panel_set | 0.3 (0.2 to 0.4) | 0.5 (0.4 to 0.6) | 0.8 (0.7 to 0.9) |\n"
        "| topology_exact | nearest |  | 0.2 (0.1 to 0.3) |  |" in page
    )
    assert "| panel_set | 4,000 + 6,000 fresh | 8.0 |" in page
    picture = np.asarray(Image.open(tmp_path / "learning_T1.png").convert("RGB"))
    assert min(picture.shape[:2]) > 200
    assert (picture != 255).any(axis=2).mean() > 0.01


def test_a_kind_that_is_left_out_is_compared_with_training_on_it(tmp_path: Path) -> None:
    added(tmp_path, result("T0", "panel_set", 0.7))
    added(tmp_path, result("T0", "panel_set", 0.1, leave_out="skirt", tested=70, patterns="12"))
    for name in ("learning_T0.md", "leaderboard.md"):
        page = (tmp_path / name).read_text()
        assert (
            "| left out | model | of | trained for | tested on | topology_exact, with | topology_exact, without |"
            in page
        )
        assert "| skirt | panel_set | 4 | 8 minutes | 70 | 0.25 | 0.1 (0 to 0.2) |" in page
        assert page.count("| panel_set | 4 | 8.0 |") == 1
        assert page.count("Tested on") == 1


def test_results_on_other_test_garments_have_a_table_of_their_own(tmp_path: Path) -> None:
    """Of few garments, of other patterns, and of drapes at another resolution; the ranked test set is the task's."""
    coarse = result("T0", "coarse", 0.97)
    coarse["data"]["test"]["recipe"] = {"recipe": {"resolution": 6.0, "design": {}}}
    others = (
        result("T0", "few", 0.99, tested=100), result("T0", "few too", 0.98, tested=100),
        result("T0", "foreign", 0.95, patterns="34"), coarse,
    )  # fmt: skip
    for found in (*others, result("T0", "good", 0.7, tested=499), result("T0", "better", 0.8, tested=499)):
        assert added(tmp_path, found) == 0
    for name in ("learning_T0.md", "leaderboard.md"):
        ranked, other = (tmp_path / name).read_text().split("Results on other test garments do not compare with")
        rows = [line.split(" | ")[0] for line in ranked.splitlines() if line.startswith("| ")]
        assert rows == ["| model", "| ---", "| better", "| good"]
        assert "Tested on 499 garments (patterns efefefefefefefef)." in ranked
        assert other.count("Tested on ") == 3
        assert "Tested on 500 garments (patterns efefefefefefefef, meshes of 6 cm).\n\n| model " in other
        assert other.index("| few | 4 |") < other.index("| few too | 4 |")


@pytest.mark.parametrize("sign", ["option", "command", "garments"])
def test_smoke_runs_are_refused(sign: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, path = result("T0", "panel_set", 0.2, tested=8), tmp_path / "report.json"
    if sign == "option":
        found["options"]["smoke"] = True
    if sign == "garments":
        found["data"]["test"]["recipe"] = {"recipe": {"design": {"meta": {"upper": "none"}}}}
    path.write_text(json.dumps(found))
    command = "python -m x --smoke" if sign == "command" else "python -m x"
    assert main(["--reports", str(tmp_path), "--add", str(path), "--command", command, "--commit", "abc"]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line == f"leaderboard: {path}: a smoke run, which tells nothing about a model: run it again without --smoke"
    assert not (tmp_path / "learning").exists()


def test_models_are_ranked_by_a_score_that_all_have(tmp_path: Path) -> None:
    """Drapes of the answers are scored for one of two models: the share within 1 cm and ``topology_exact`` are not
    comparable."""
    draped = result("T0", "draped", 0.7)
    draped["scores"] |= {"within_1cm": [0.3, 0.2, 0.4], "sim_ok": [0.9, 0.8, 1.0], "stitch_f1": [0.6, 0.5, 0.7]}
    added(tmp_path, draped)
    added(tmp_path, result("T0", "other", 0.5))
    assert [entry.model for entry in read_entries(tmp_path / "learning")] == ["draped", "other"]
    board = (tmp_path / "leaderboard.md").read_text()
    assert "| model | trained on | minutes | within_1cm | topology_exact | stitch_f1 | sim_ok |" in board
    assert "| other | 4 | 8.0 |  | 0.5 (0.4 to 0.6) |  |  |" in board


@pytest.mark.parametrize("changed", [{"seed": 1}, {"lr": 0.125}, {"batch": 7}])
def test_unusual_options_make_another_model(changed: dict[str, Any], tmp_path: Path) -> None:
    usual: dict[str, Any] = {"seed": 0, **{name: load_model("parameters").USUAL[name] for name in ("batch", "lr")}}
    added(tmp_path, result("T0", "parameters", 0.5, **usual))
    added(tmp_path, result("T0", "parameters", 0.4, **{**usual, **changed}))
    ((name, value),) = changed.items()
    assert [entry.model for entry in read_entries(tmp_path / "learning")] == [
        "parameters",
        f"parameters {name}={value}",
    ]


def test_kinds_of_stitched_patterns_are_told_apart(tmp_path: Path) -> None:
    data = {"count": 4, "patterns": "ab" * 32, "ids": "cd" * 32}
    found: dict[str, Any] = {
        "arguments": {"train": 1000, "leave_out": ""}, "data": {"train": data, "test": data}, "train_s": 60.0,
        "one_to_one": {"f1_symmetric": [0.9, 0.8, 1.0]}, "scores_of_kinds": {"dress": {"f1_symmetric": 0.75}},
        "several": {"f1_several_symmetric": [0.6, 0.5, 0.7]},
        "several_of_kinds": {"dress": {"garments": 2, "f1_symmetric": 0.25, "f1_several_symmetric": 0.5}},
    }  # fmt: skip
    assert added(tmp_path, found) == 0
    found |= {"arguments": {"train": 1000, "leave_out": "dress"}, "one_to_one": {"f1_symmetric": [0.5, 0.4, 0.6]}}
    found["several"] = {"f1_several_symmetric": [0.3, 0.2, 0.4]}
    assert added(tmp_path, found) == 0
    page = (tmp_path / "learning_T3.md").read_text()
    assert "| dress | stitches | 1,000 | 1 minute | 4 | 0.75 | 0.5 (0.4 to 0.6) | 0.5 | 0.3 (0.2 to 0.4) |" in page


# ---------------------------------------------------------------------------------------------------------------- plans

PLANS = sorted((Path(leaderboard.__file__).parent / "plans").glob("*.sh"))


@pytest.mark.parametrize("path", PLANS, ids=lambda path: str(path.stem))
def test_the_plans_of_the_repository_have_valid_commands(path: Path) -> None:
    lines = path.read_text().splitlines()
    (program,) = (line.removeprefix("TRAIN=").strip('"') for line in lines if line.startswith("TRAIN="))
    calls = [line.replace("$TRAIN", program) for line in lines if line.startswith("$TRAIN")]
    configs = [parsed(shlex.split(call)[3:]) for call in calls]
    assert len({config.out for config in configs}) == len(configs) > 20
