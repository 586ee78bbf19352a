"""Reports of trained models, from files of results."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

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
