"""A plan names its runs, refuses wrong options, and starts the runs that are not finished."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.reconstruction import leaderboard, plan
from benchmarks.reconstruction.plan import main, read_plan
from benchmarks.reconstruction.train import UNFINISHED
from gcd_dataset.errors import ConfigError

PLANS = sorted((Path(plan.__file__).parent / "plans").glob("*.toml"))
TWO = '[a]\nmodel = ["typical", "nearest"]\nsmoke = true\n'


def written(folder: Path, text: str) -> Path:
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
        written(tmp_path, '[T0]\nmodel = ["panel_set", "parameters"]\ntrain = [1000, 4000]\nset = ["width=96"]\n')
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
        read_plan(written(tmp_path, text))


def test_garments_are_made_once_and_finished_runs_are_left_alone(tmp_path: Path, started: list[list[str]]) -> None:
    call = [str(written(tmp_path, TWO)), "--out", str(tmp_path / "out"), "--gpus", "0"]
    assert main([*call, "--make-only"]) == 0
    assert ["--make-only" in command for command in started] == [True]
    (tmp_path / "out" / "a-typical").mkdir()
    (tmp_path / "out" / "a-typical" / "report.json").write_text("{}")
    assert main([*call, "--limit-minutes", "9"]) == 0
    assert [command[1] for command in started[2:]] == ["nearest"]
    assert started[2][started[2].index("--limit-minutes") + 1] == "8.50"
    assert main(call) == 0
    assert len(started) == 3
    log = (tmp_path / "out" / "a-nearest" / "log.txt").read_text()
    assert log.startswith("$ python -m benchmarks.reconstruction.train nearest --smoke --limit-minutes 8.50 --out ")


def test_a_failed_run_is_named_and_the_others_go_on(
    tmp_path: Path, started: list[list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    """Runs without the scores of drapes that they ask for are unfinished."""
    out = tmp_path / "out"
    path = written(tmp_path, TWO.replace("a]", "b]") + "[c]\nmodel = 'ceiling'\nsmoke = true\ndrape = true\n")
    assert main([str(path), "--out", str(out), "--gpus", "0"]) == UNFINISHED
    assert capsys.readouterr().out == "b-typical  done\nb-nearest  done\nc  unfinished\n"
    runs = read_plan(written(tmp_path, '[d]\nmodel = "typical"\nseed = 1\n[e]\nmodel = "typical"\n'))
    assert not plan._Calls(SimpleNamespace(out=out, data=None, examples="", gpus=0, limit_minutes=0)).train(runs)  # type: ignore[arg-type]
    assert [run.is_done(out) for run in runs] == [False, True]
    assert "plan: d ended with exit code 1" in capsys.readouterr().err


def test_a_folder_of_other_options_is_refused(
    tmp_path: Path, started: list[list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["--out", str(tmp_path / "out"), "--gpus", "0"]
    assert main([str(written(tmp_path, TWO)), *call]) == 0
    assert main([str(written(tmp_path, TWO + "train = 4\n")), *call]) == 1
    assert "a-typical holds a run of other options: delete it" in capsys.readouterr().err


def test_reports_go_to_the_leaderboard(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, '[a]\nmodel = ["nearest", "typical"]\ndrape = true\n')
    call = [str(path), "--out", str(tmp_path), "--report", "--reports", str(tmp_path / "reports"), "--commit", "abc"]
    assert main(call) == 1
    assert "has no finished run" in capsys.readouterr().err
    known = json.loads((leaderboard.REPORTS / "learning" / "t1_nearest_16000.json").read_text())
    scores = {name: value for name, value in known["scores"].items() if name != "sim_ok"}
    (tmp_path / "a-nearest").mkdir()
    (tmp_path / "a-nearest" / "report.json").write_text(json.dumps({**known, "scores": scores}))
    assert main(call) == 0
    page = (tmp_path / "reports" / "learning_T1.md").read_text()
    assert "`python -m benchmarks.reconstruction.train nearest --drape --out runs/a-nearest`" in page
    assert plan.NOT_DRAPED in page
    assert "1 of 2 runs reported" in capsys.readouterr().out


def test_wrong_usage_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, TWO)
    assert main([str(path), "--only", "T9*", "--out", str(tmp_path)]) == 1
    assert "has no run T9*: give --only a pattern" in capsys.readouterr().err
    assert main([str(path), "--limit-minutes", "nan", "--out", str(tmp_path)]) == 1
    assert "--limit-minutes nan: give 0 or more" in capsys.readouterr().err
    assert main([str(path), "--list", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out == "a-typical  unfinished\na-nearest  unfinished\n"
