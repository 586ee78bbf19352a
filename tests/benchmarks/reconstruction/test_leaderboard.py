"""Reports of trained models, from files of results."""

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

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
        "task": task, "model": model, "scores": {"combinatorial": [exact, exact - 0.1, exact + 0.1]},
        "scores_of_kinds": {"skirt": {"combinatorial": 0.25}}, "data": {"train": data, "test": test},
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
        assert text.index("| 1 | panel_set | 4 | 8.0 |") < text.index("| 2 | nearest | 4 | 8.0 |")
        assert cells(text, "panel_set")["combinatorial"] == "0.7 (0.6 to 0.8)"
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


def cells(page: str, model: str) -> dict[str, str]:
    """The cells of the first row of a model, by their heads."""
    head, row = (next(line for line in page.splitlines() if mark in line) for mark in ("| rank |", f"| {model} |"))
    return dict(zip(*([cell.strip() for cell in line.strip("|").split("|")] for line in (head, row)), strict=True))


def test_models_are_ranked_among_equal_budgets_only(tmp_path: Path) -> None:
    """Other numbers of garments, minutes or hardware, references and models below their published budget: not."""
    alone: dict[str, dict[str, Any]] = {"more": {"train": 9000}, "longer": {"minutes": 9.0}}
    for name, changed in alone.items():
        added(tmp_path, result("T1", name, 0.9, **changed))
    added(tmp_path, result("T1", "elsewhere", 0.9) | {"device": "cpu"})
    added(tmp_path, result("T1", "nearest", 0.95) | {"minutes": 0.0, "parameters": 0})
    added(tmp_path, result("T1", "neural_tailor", 0.95))
    for name, exact in (("second", 0.4), ("first", 0.5)):
        added(tmp_path, result("T1", name, exact))
    page = (tmp_path / "leaderboard.md").read_text()
    ranks = {name: cells(page, name)["rank"] for name in ("first", "second", *alone, "elsewhere")}
    assert ranks == {"first": "1", "second": "2", "more": "–", "longer": "–", "elsewhere": "–"}
    assert cells(page, "nearest")["rank"] == "a reference without a training"
    assert "below its published budget" in cells(page, "neural_tailor")["rank"]
    assert cells(page, "first") | {
        "garments": "4", "minutes": "8.0", "weights": "0.0 M", "hardware": "NVIDIA H200", "strict_within_1cm": "",
    } == cells(page, "first")  # fmt: skip


def test_a_record_is_the_best_on_the_validation_set_not_on_the_test_set(tmp_path: Path) -> None:
    added(tmp_path, result("T1", "lucky", 0.9) | {"validation": {"scores": {"combinatorial": [0.4, 0.3, 0.5]}}})
    added(tmp_path, result("T1", "good", 0.8) | {"validation": {"scores": {"combinatorial": [0.6, 0.5, 0.7]}}})
    added(tmp_path, result("T1", "unknown", 0.95))
    page = (tmp_path / "leaderboard.md").read_text()
    assert page.count("(**record**)") == 1
    assert cells(page, "good (**record**)")["validation"] == "0.6 (0.5 to 0.7)"


def test_trainings_with_other_seeds_are_one_row_with_their_spread(tmp_path: Path) -> None:
    for seed, exact in ((0, 0.3), (1, 0.5), (2, 0.4)):
        added(tmp_path, result("T1", "panel_set", exact, seed=seed))
    row = cells((tmp_path / "leaderboard.md").read_text(), "panel_set")
    assert (row["seeds"], row["combinatorial"]) == ("3", "0.4 (0.3 to 0.5)")


def test_a_kind_that_is_left_out_is_compared_with_training_on_it(tmp_path: Path) -> None:
    added(tmp_path, result("T0", "panel_set", 0.7))
    added(tmp_path, result("T0", "panel_set", 0.1, leave_out="skirt", tested=70, patterns="12"))
    for name in ("learning_T0.md", "leaderboard.md"):
        page = (tmp_path / name).read_text()
        assert (
            "| left out | model | of | trained for | tested on | combinatorial, with | combinatorial, without |" in page
        )
        assert "| skirt | panel_set | 4 | 8 minutes | 70 | 0.25 | 0.1 (0 to 0.2) |" in page
        assert page.count("| – | panel_set | 4 | 8.0 |") == 1
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
        rows = [line.split(" | ")[1] for line in ranked.splitlines() if line.startswith("| ")]
        assert rows == ["model", "---", "better", "good"]
        assert "Tested on 499 garments (patterns efefefefefefefef)." in ranked
        assert other.count("Tested on ") == 3
        assert "Tested on 500 garments (patterns efefefefefefefef, meshes of 6 cm).\n\n| rank | model " in other
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
    """Drapes of the answers are scored for one of two models: the share within 1 cm and ``combinatorial`` are not
    comparable."""
    draped = result("T0", "draped", 0.7)
    draped["scores"] |= {"strict_within_1cm": [0.3, 0.2, 0.4], "sim_ok": [0.9, 0.8, 1.0], "stitch_f1": [0.6, 0.5, 0.7]}
    added(tmp_path, draped)
    added(tmp_path, result("T0", "other", 0.5))
    assert [entry.model for entry in read_entries(tmp_path / "learning")] == ["draped", "other"]
    board = (tmp_path / "leaderboard.md").read_text()
    assert cells(board, "other")["strict_within_1cm"] == ""
    assert cells(board, "draped")["rank"] == "1"


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


def test_seams_are_ranked_with_joined_edges_and_counted_for_whole_foreign_patterns(tmp_path: Path) -> None:
    data = {"count": 4, "patterns": "ab" * 32, "ids": "cd" * 32}
    found: dict[str, Any] = {
        "arguments": {"train": 1000, "leave_out": ""}, "data": {"train": data, "test": data}, "train_s": 60.0,
        "one_to_one": {"perfect_symmetric": [0.9, 0.8, 1.0]}, "scores_of_kinds": {"dress": {"perfect_symmetric": 0.75}},
        "several": {"perfect_symmetric": [0.6, 0.5, 0.7]},
        "several_of_kinds": {"dress": {"garments": 2, "perfect_symmetric": 0.25}},
        "foreign": {"garments": 90, "perfect_symmetric": [0.1, 0.0, 0.2], "f1_symmetric": [0.5, 0.4, 0.6]},
    }  # fmt: skip
    assert added(tmp_path, found) == 0
    found |= {"arguments": {"train": 1000, "leave_out": "dress"}, "several": {"perfect_symmetric": [0.3, 0.2, 0.4]}}
    found["one_to_one"] = {"perfect_symmetric": [0.5, 0.4, 0.6]}
    assert added(tmp_path, found) == 0
    page = (tmp_path / "learning_T3.md").read_text()
    row = cells(page, "stitches")
    assert [name for name in row if row[name]][-4:] == [
        "joined_perfect", "subdivided_perfect", "freesewing_whole", "freesewing_f1",
    ]  # fmt: skip
    assert row["freesewing_whole"] == "9 (0 to 18)"
    assert "| dress | stitches | 1,000 | 1 minute | 4 | 0.25 | 0.3 (0.2 to 0.4) | 0.75 | 0.5 (0.4 to 0.6) |" in page


# ---------------------------------------------------------------------------------------------------------------- plans

PLANS = sorted((Path(leaderboard.__file__).parent / "plans").glob("*.sh"))


@pytest.mark.parametrize("path", PLANS, ids=lambda path: str(path.stem))
def test_the_plans_of_the_repository_have_valid_commands(path: Path) -> None:
    lines = path.read_text().splitlines()
    (program,) = (line.removeprefix("TRAIN=").strip('"') for line in lines if line.startswith("TRAIN="))
    calls = [line.replace("$TRAIN", program) for line in lines if line.startswith("$TRAIN")]
    configs = [parsed(shlex.split(call)[3:]) for call in calls]
    assert len({config.results for config in configs}) == len(configs) > 20
