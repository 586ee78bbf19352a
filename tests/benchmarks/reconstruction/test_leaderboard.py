"""Reports of trained models, from files of results."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.reconstruction import leaderboard, plan
from benchmarks.reconstruction.leaderboard import main
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.plan import main as plan_main
from benchmarks.reconstruction.plan import read_plan
from benchmarks.reconstruction.results import read_entries
from benchmarks.reconstruction.train import UNFINISHED
from gcd_dataset.errors import ConfigError


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


# ----------------------------------------------------------------------------------------------------------------- plan


PLANS = sorted((Path(plan.__file__).parent / "plans").glob("*.toml"))
TWO = '[a]\nmodel = ["typical", "nearest"]\nsmoke = true\n'


def plan_file(folder: Path, text: str) -> Path:
    path = folder / "plan.toml"
    path.write_text(text)
    return path


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Commands that were started; each but ``--make-only`` and ``typical --seed 1`` leaves a report."""
    commands: list[list[str]] = []

    class Process:
        def __init__(self, command: list[str], **options: Any) -> None:
            commands.append(command[2:])
            out = Path(command[command.index("--out") + 1])
            self.returncode = int("--seed" in command)
            if "--make-only" not in command and not self.returncode:
                (out / "report.json").write_text("{}")

        def poll(self) -> int:
            return self.returncode

        def __enter__(self) -> "Process":
            return self

        def __exit__(self, *error: object) -> None: ...

        def terminate(self) -> None: ...

    monkeypatch.setattr(plan, "subprocess", SimpleNamespace(Popen=Process))
    monkeypatch.setattr(plan, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=lambda seconds: None))
    return commands


@pytest.mark.parametrize("path", PLANS, ids=lambda path: str(path.stem))
def test_the_programs_accept_the_plans_of_the_repository(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Large networks are built in tests/extras only."""
    if path.stem != "smoke":
        monkeypatch.setattr(plan, "require_usable", lambda options: None)
    assert read_plan(path)


def test_lists_give_a_run_for_each_combination(tmp_path: Path) -> None:
    runs = read_plan(
        plan_file(tmp_path, '[T0]\nmodel = ["panel_set", "parameters"]\ntrain = [1000, 4000]\nset = ["width=96"]\n')
    )
    assert [run.name for run in runs] == [
        f"T0-{model}-{count}" for model in ("panel_set", "parameters") for count in (1000, 4000)
    ]
    assert runs[1].command[2:] == [
        "benchmarks.reconstruction.train", "panel_set", "--train", "4000", "--set", "width=96",
    ]  # fmt: skip
    assert len({run.garments for run in runs}) == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[a", "give a TOML file of runs"),
        ("", "no runs: give a table"),
        ("a = 1", "[a] is no table"),
        ("[a]\ntrain = 10", "[a] has no model: give model"),
        ('[a]\nprogram = "other"', "program 'other': give one of train, stitching.run"),
        ('[a]\nmodel = "unknown"', "no model 'unknown': choose one of"),
        ('[a]\nmodel = "typical"\nwidth = 3', "unrecognized arguments: --width 3"),
        ('[a]\nmodel = "typical"\nset = ["width=3"]', "typical has no network"),
        ('[a]\nprogram = "stitching.run"\nwidth = 33', "width 33 is no multiple of heads"),
        ('["a/b"]\nmodel = "typical"', "'a/b' is no name for a folder"),
        ('[a]\nmodel = ["typical", "typical"]', "two runs a-typical: give runs with different names"),
    ],
)
def test_unusable_plans_are_refused(text: str, expected: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected)):
        read_plan(plan_file(tmp_path, text))


def test_garments_are_made_once_and_finished_runs_are_left_alone(tmp_path: Path, started: list[list[str]]) -> None:
    call = [str(plan_file(tmp_path, TWO)), "--out", str(tmp_path / "out"), "--gpus", "0"]
    assert plan_main([*call, "--make-only"]) == 0
    assert ["--make-only" in command for command in started] == [True]
    (tmp_path / "out" / "a-typical").mkdir()
    (tmp_path / "out" / "a-typical" / "report.json").write_text("{}")
    assert plan_main([*call, "--limit-minutes", "9"]) == 0
    assert [command[1] for command in started[2:]] == ["nearest"]
    assert started[2][started[2].index("--limit-minutes") + 1] == "8.50"
    assert plan_main(call) == 0
    assert len(started) == 3
    log = (tmp_path / "out" / "a-nearest" / "log.txt").read_text()
    assert log.startswith("$ python -m benchmarks.reconstruction.train nearest --smoke --limit-minutes 8.50 --out ")


def test_a_failed_run_is_named_and_the_others_go_on(
    tmp_path: Path, started: list[list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    """Runs without the scores of drapes that they ask for are unfinished."""
    out = tmp_path / "out"
    path = plan_file(tmp_path, TWO.replace("a]", "b]") + "[c]\nmodel = 'ceiling'\nsmoke = true\ndrape = true\n")
    assert plan_main([str(path), "--out", str(out), "--gpus", "0"]) == UNFINISHED
    assert capsys.readouterr().out == "b-typical  done\nb-nearest  done\nc  unfinished\n"
    runs = read_plan(plan_file(tmp_path, '[d]\nmodel = "typical"\nseed = 1\n[e]\nmodel = "typical"\n'))
    assert not plan._Calls(SimpleNamespace(out=out, data=None, examples="", gpus=0, limit_minutes=0)).train(runs)  # type: ignore[arg-type]
    assert [run.is_done(out) for run in runs] == [False, True]
    assert "plan: d ended with exit code 1" in capsys.readouterr().err


def test_a_folder_of_other_options_is_refused(
    tmp_path: Path, started: list[list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["--out", str(tmp_path / "out"), "--gpus", "0"]
    assert plan_main([str(plan_file(tmp_path, TWO)), *call]) == 0
    assert plan_main([str(plan_file(tmp_path, TWO + "train = 4\n")), *call]) == 1
    assert "a-typical holds a run of other options: delete it" in capsys.readouterr().err


def test_reports_go_to_the_leaderboard(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = plan_file(tmp_path, '[a]\nmodel = ["nearest", "typical"]\ndrape = true\n')
    call = [str(path), "--out", str(tmp_path), "--report", "--reports", str(tmp_path / "reports"), "--commit", "abc"]
    assert plan_main(call) == 1
    assert "has no finished run" in capsys.readouterr().err
    known = json.loads((leaderboard.REPORTS / "learning" / "t1_nearest_16000.json").read_text())
    scores = {name: value for name, value in known["scores"].items() if name != "sim_ok"}
    (tmp_path / "a-nearest").mkdir()
    (tmp_path / "a-nearest" / "report.json").write_text(json.dumps({**known, "scores": scores}))
    assert plan_main(call) == 0
    page = (tmp_path / "reports" / "learning_T1.md").read_text()
    assert "`python -m benchmarks.reconstruction.train nearest --drape --out runs/a-nearest`" in page
    assert plan.NOT_DRAPED in page
    assert "1 of 2 runs reported" in capsys.readouterr().out
