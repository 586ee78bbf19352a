"""A campaign starts what is not finished, once for each data set and GPU, and goes on after failures and limits."""

import argparse
import fcntl
import json
import subprocess
import time
from pathlib import Path

import pytest

from benchmarks.reconstruction import campaign, planned_runs
from benchmarks.reconstruction.campaign import main
from benchmarks.reconstruction.models import MODELS
from benchmarks.reconstruction.planned_runs import Planned, read_plan
from benchmarks.reconstruction.stitching import run as stitching
from benchmarks.reconstruction.tasks import TASKS
from benchmarks.reconstruction.train import UNFINISHED, add_arguments, options_from
from gcd_dataset.errors import ConfigError

PLANS = Path(campaign.__file__).parent / "plans"
FAMILIES = {"upper_garment", "dress", "jumpsuit", "skirt", "pants"}
PLAN = """
[a]
task = "T0"
model = ["short", "fails"]
train = [10, 20]
minutes = 1

[b]
task = "T1"
model = "long"
train = 5
minutes = 3
"""


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A plan of toy programs."""
    monkeypatch.setitem(planned_runs.PROGRAMS, "train", "tests.benchmarks.reconstruction.toy_program")
    for name in ("short", "fails", "long", "endless", "beside", "slow", "hangs", "breaks", "naps"):
        monkeypatch.setitem(MODELS, name, "tests.benchmarks.reconstruction.toy_program")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[3]))
    monkeypatch.setattr(campaign, "LEAVE", 0.5)
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def starts(out: Path) -> list[str]:
    """The programs started since the last call of this function, in order."""
    found = (out / "starts.txt").read_text().splitlines()
    (out / "starts.txt").unlink()
    return found


def test_lists_hold_a_value_for_each_run(plan: Path) -> None:
    runs = read_plan(plan)
    assert [run.name for run in runs] == ["a-short-10", "a-short-20", "a-fails-10", "a-fails-20", "b"]
    assert runs[1].command[3:] == ["short", "--task", "T0", "--train", "20", "--minutes", "1"]
    assert Planned("c", "stitching.run", "", {"smoke": True, "placed": False, "leave_out": "skirt"}).command[3:] == [
        "--smoke", "--leave-out", "skirt",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "no runs"),
        ("a = 1", "a is no table"),
        ("[a]\ntask = 'T0'", "[a] has no model"),
        ("[a]\nmodel = 'nearest'\ntask = 'T9'", "no task 'T9'"),
        ("[a]\nprogram = 'rm'", "program 'rm'"),
        ("[a]\nmodel = ['nearest', 'nearest']", "two runs a-nearest"),
        ("[a]\nmodel = 'nearest'\ntrain = []", "[a] has an empty list"),
        ("[a]\nmodel = 'nearest'\nminutes = 'abc'", "[a] minutes = 'abc': give a number"),
        ("[a]\nmodel = 'nearest'\ntrain = -1", "[a] train = -1: give a number"),
        ("['../../b']\nmodel = 'nearest'", "is no name for a folder"),
        ("[a", "give a TOML file"),
        ("[a]\nmodel = 'panel_sets'", "[a] no model 'panel_sets': choose one of panel_set"),
        ("[a]\nmodel = 3", "[a] no model '3'"),
        ("[a]\nmodel = 'nearest'\nfresh = 5000", "[a] nearest has no network and no training: leave out"),
        ("[a]\nmodel = 'stitches'\ntask = 'T3'\nfresh = 5000", "[a] --fresh: needs a model that encodes garments"),
        ("[a]\nmodel = 'panel_set'\nfresh = 50", "[a] --fresh 50: give room for the 4000 garments"),
        ("[a]\nmodel = ['nearest', 'panel_set']\ntask = 'T4'", "[a] nearest does not answer T4"),
        ("[a]\nmodel = 'panel_set'\nset = ['width=33']", "[a] width 33 is no multiple of heads 6"),
        ("[a]\nmodel = 'panel_set'\nstep = 5", "[a] unrecognized arguments: --step 5"),
        ("[a]\nmodel = 'panel_set'\nbatch = 'many'", "[a] argument --batch: invalid int value"),
        ("[a]\nprogram = 'stitching.run'\nfresh = 5000", "[a] unrecognized arguments: --fresh 5000"),
        ("[a]\nprogram = 'stitching.run'\nmodel = 'stitches'", "[a] unrecognized arguments: stitches"),
        ("[a]\nprogram = 'stitching.run'\nfull = true\nwidth = 3", "[a] unrecognized arguments: --full"),
        ("[a]\nprogram = 'stitching.run'\nwidth = 33", "[a] width 33 is no multiple of heads 8"),
    ],
)
def test_an_unusable_plan_is_refused(text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_plan(tmp_path / "plan.toml")
    assert expected in str(caught.value)


def test_a_repeated_call_starts_what_is_not_finished(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "runs"
    call = [str(plan), "--out", str(out), "--gpus", "0"]
    assert main(call) == 1
    began = starts(out)
    # Each data set is made once, by the run with most garments; the longest run comes first.
    assert began[:3] == ["make a-short-20", "make b", "b"]
    assert sorted(began[3:]) == ["a-fails-10", "a-fails-20", "a-short-10", "a-short-20"]
    said = capsys.readouterr()
    assert "a-fails-10 failed with exit code 1" in said.err
    assert "the toy is broken" in said.err
    assert (
        "2 done, 0 to be draped, 2 failed, 1 unfinished, 0 waiting; 7 minutes left" in said.out
    )  # 2 + 1, and twice 1 + 1
    assert "the toy is broken" in (out / "a-fails-10" / "log.txt").read_text()

    assert main([*call, "--only", "[!a]*"]) == 0
    assert starts(out) == ["make b", "b"]
    assert main([*call, "--only", "*-short-*"]) == 0
    assert not (out / "starts.txt").exists()
    assert "a-short-10  done                 topology_exact 0.500" in capsys.readouterr().out


def test_garments_can_be_made_before_any_run(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Runs whose time is fixed take fewer steps while others drape."""
    call = [str(plan), "--out", str(tmp_path / "runs"), "--gpus", "2", "--only", "a-short-*", "b"]
    assert main([*call, "--make-only"]) == 0
    assert sorted(starts(tmp_path / "runs")) == ["make a-short-20", "make b"]
    assert "0 failed, 0 unfinished, 3 waiting" in capsys.readouterr().out
    assert main(call) == 0
    assert {"a-short-10", "a-short-20", "b"} <= set(starts(tmp_path / "runs"))


def test_a_limit_that_leaves_garments_unmade_is_told(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = [str(plan), "--out", str(tmp_path), "--gpus", "0", "--make-only", "--only", "b"]
    assert main([*call, "--limit-minutes", "1e-6"]) == UNFINISHED
    assert "left no time for all garments of b: repeat the command" in capsys.readouterr().err
    assert main(call) == 0


def test_runs_at_once_have_gpus_of_their_own(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan.write_text("[a]\ntask = 'T0'\nmodel = 'short'\ntrain = [1, 2, 3]\nminutes = 1")
    assert main([str(plan), "--out", str(tmp_path / "runs"), "--gpus", "2"]) == 0
    said = capsys.readouterr().err
    assert "a-1 begins on GPU 0" in said
    assert "a-2 begins on GPU 1" in said


def test_a_gpu_has_several_runs_at_once(plan: Path, tmp_path: Path) -> None:
    plan.write_text("[a]\nmodel = 'beside'\ntrain = 1\n[b]\ntask = 'T1'\nmodel = 'short'\ntrain = 1")
    call = [str(plan), "--out", str(tmp_path / "runs"), "--gpus", "0", "--limit-minutes", "2"]
    assert main([*call, "--at-once", "2"]) == 0
    assert sorted(starts(tmp_path / "runs")) == ["a", "b", "make a", "make b"]
    log = (tmp_path / "runs" / "a" / "log.txt").read_text()
    assert f"--turns {tmp_path / 'runs' / 'turns'}" in log


def test_runs_at_once_are_at_least_one(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(plan), "--out", str(tmp_path), "--at-once", "0"]) == 1
    assert "--at-once 0: give 1 or more" in capsys.readouterr().err


def test_the_limit_ends_what_runs(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan.write_text("[a]\ntask = 'T0'\nmodel = 'endless'\ntrain = 1\nminutes = 0.01\nspare = 0.01")
    begun = time.monotonic()
    assert main([str(plan), "--out", str(tmp_path / "runs"), "--gpus", "0", "--limit-minutes", "0.03"]) == 0
    assert time.monotonic() - begun < 20
    assert "0 done, 0 to be draped, 0 failed, 0 unfinished, 1 waiting" in capsys.readouterr().out


def test_a_run_that_cannot_be_finished_in_time_is_not_begun(plan: Path, tmp_path: Path) -> None:
    out = tmp_path / "runs"
    assert main([str(plan), "--out", str(out), "--gpus", "0", "--only", "b", "--limit-minutes", "1"]) == 0
    assert starts(out) == ["make b"]


def test_answers_are_draped_after_the_trainings(plan: Path, tmp_path: Path) -> None:
    """In a second start, with all cores but one; what is planned and reported is the command with ``--drape``."""
    plan.write_text(
        "[a]\nmodel = 'short'\ntrain = [1, 2]\nminutes = 1\ndrape = true\n"
        "[b]\ntask = 'T1'\nmodel = 'slow'\ntrain = 1\nminutes = 1"
    )
    out = tmp_path / "runs"
    call = [str(plan), "--out", str(out), "--gpus", "0"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "cores", lambda: 9)
        assert main(call) == 0
    began = starts(out)
    assert began[:2] == ["make a-2", "make b"]
    assert sorted(began[2:5]) == ["a-1", "a-2", "b"]
    assert sorted(began[5::2]) == ["drape a-1", "drape a-2"]
    trained, draped = (line for line in (out / "a-1" / "log.txt").read_text().splitlines() if line.startswith("$ "))
    assert ("--drape" in trained, "--drape" in draped) == (False, True)
    assert "--workers 8" in draped
    assert "--drape" in json.loads((out / "a-1" / "planned.json").read_text())
    assert main(call) == 0
    assert not (out / "starts.txt").exists()


def test_a_gpu_drapes_the_answers_of_one_run_at_a_time(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan.write_text("[a]\nmodel = 'short'\ntrain = [1, 2, 3]\nminutes = 1\ndrape = true")
    monkeypatch.setattr(campaign, "cores", lambda: 9)
    out = tmp_path / "runs"
    call = [str(plan), "--out", str(out), "--at-once", "2"]
    assert main([*call, "--gpus", "1"]) == 0
    drapes = [line for line in starts(out) if line.startswith("drape")]
    assert [line.split()[0] for line in drapes] == ["drape", "draped"] * 3
    for k in (1, 2, 3):
        path = out / f"a-{k}" / "report.json"
        report = json.loads(path.read_text())
        path.write_text(json.dumps(report | {"scores": {"topology_exact": report["scores"]["topology_exact"]}}))
    capsys.readouterr()
    assert main([*call, "--gpus", "2"]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "garments made" not in line]
    assert said[:3] == [
        "campaign: garments of a-1, a-2, a-3", "campaign: a-1 drapes on GPU 0", "campaign: a-2 drapes on GPU 1",
    ]  # fmt: skip
    assert "--workers 4" in (out / "a-3" / "log.txt").read_text().splitlines()[-1]  # 8 for two GPUs


def test_nothing_drapes_beside_a_training(plan: Path, tmp_path: Path) -> None:
    """On its GPU, whose steps it would slow."""
    plan.write_text(
        "[a]\nmodel = 'short'\ntrain = 1\nminutes = 1\ndrape = true\n[b]\nmodel = 'naps'\ntrain = 1\nminutes = 1"
    )
    out = tmp_path / "runs"
    assert main([str(plan), "--out", str(out), "--gpus", "0", "--at-once", "2"]) == 0
    began = starts(out)
    assert began.index("ended b") < began.index("drape a")


def test_drapes_wait_for_garments(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """While they are made, their trainings are about to need the GPU."""
    plan.write_text(
        "[a]\nmodel = 'short'\ntrain = 1\ndrape = true\n[b]\ntask = 'T1'\nmodel = 'slow'\ntrain = 1\nminutes = 1"
    )
    assert main([str(plan), "--out", str(tmp_path / "runs"), "--gpus", "0", "--at-once", "2"]) == 0
    said = capsys.readouterr().err
    assert said.index("b begins") < said.index("a drapes")


def test_one_gpu_drapes_garments_while_others_train(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan.write_text(
        "[draped]\ntask = 'T1'\nmodel = 'slow'\ntrain = 5\nminutes = 1\n"
        "[flat]\ntask = 'T0'\nmodel = 'short'\ntrain = [10, 20, 30]\nminutes = 1\n"
    )
    assert main([str(plan), "--out", str(tmp_path / "runs"), "--gpus", "2"]) == 0
    began = starts(tmp_path / "runs")
    assert began[0] == "make flat-30"  # by all cores, before anything drapes
    said = capsys.readouterr().err.splitlines()
    draped = said.index("campaign: garments of draped")
    made = next(k for k in range(draped, len(said)) if "garments made in" in said[k])
    assert any("begins on GPU 0" in line for line in said[:made])
    assert not any("begins on GPU 1" in line for line in said[:made])
    assert any("draped begins on GPU" in line for line in said[made:])


@pytest.mark.parametrize(("model", "expected"), [("short", {"1"}), ("breaks", {"0", "1"})])
def test_all_gpus_drape_garments_while_nothing_trains(
    model: str, expected: set[str], plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``breaks`` is trained by the first call; its answers, which are still to be draped, need no GPU yet."""
    monkeypatch.setattr(campaign, "_gpus", lambda: 2)
    plan.write_text(
        f"[draped]\ntask = 'T1'\nmodel = 'slow'\ntrain = 5\nminutes = 1\n"
        f"[flat]\ntask = 'T0'\nmodel = '{model}'\ntrain = 10\nminutes = 1\ndrape = true"
    )
    call = [str(plan), "--out", str(tmp_path / "runs"), "--gpus", "2"]
    if model == "breaks":
        assert main([*call, "--only", "flat"]) == 1
    assert main(call) == (model == "breaks")
    gpus = dict(line.split(" ") for line in (tmp_path / "runs" / "gpus.txt").read_text().splitlines())
    assert set(gpus["draped"].split(",")) == expected


def test_fresh_garments_wait_for_the_others(plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which all cores and GPUs make, before a training's own workers drape on its other GPU."""
    fresh = "fresh = 9\nworkers = 3\nmake_device = 'cuda:1'"
    plan.write_text(
        f"[a]\nmodel = 'panel_set'\ntrain = 1\n{fresh}\n[b]\ntask = 'T1'\nmodel = 'slow'\ntrain = 1\nminutes = 1"
    )
    monkeypatch.setitem(MODELS, "panel_set", "tests.benchmarks.reconstruction.toy_program")
    monkeypatch.setattr(planned_runs, "_require_usable", lambda run: None)
    monkeypatch.setattr(planned_runs, "_is_network", lambda model: True)
    monkeypatch.setattr(campaign, "cores", lambda: 9)
    out = tmp_path / "runs"
    assert main([str(plan), "--out", str(out), "--gpus", "0", "--at-once", "2"]) == 0
    began = starts(out)
    assert began[:2] == ["make a", "make b"]
    assert sorted(began[2:]) == ["a", "b"]
    made, trained = ((out / name).read_text() for name in ("garments_a.txt", "a/log.txt"))
    assert "--workers 8" in made
    assert "cuda:1" not in made
    assert "--fresh 9 --workers 3 --make-device cuda:1" in trained


def test_drapes_do_not_wait_for_a_training_that_needs_more_time(plan: Path, tmp_path: Path) -> None:
    """It is begun after them, for a later call to continue."""
    plan.write_text(
        "[a]\nmodel = 'short'\ntrain = 1\nminutes = 0.01\nspare = 0.01\ndrape = true\n"
        "[b]\nmodel = 'long'\ntrain = 1\nminutes = 8"
    )
    out = tmp_path / "runs"
    assert main([str(plan), "--out", str(out), "--gpus", "0", "--limit-minutes", "2"]) == 0
    assert starts(out) == ["make a", "a", "drape a", "draped a", "b"]


def test_drapes_that_the_limit_ends_are_repeated(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan.write_text("[a]\ntask = 'T0'\nmodel = 'hangs'\ntrain = 1\nminutes = 0.01\nspare = 0.01\ndrape = true")
    monkeypatch.setattr(campaign, "DRAPING", 0.01)
    out, reports = tmp_path / "runs", tmp_path / "reports"
    call = [str(plan), "--out", str(out), "--gpus", "0"]
    report = [*call, "--report", "--reports", str(reports), "--commit", "abc"]
    assert main([*call, "--limit-minutes", "0.15"]) == 0
    assert starts(out) == ["make a", "a", "drape a"]
    said = capsys.readouterr().out
    assert "a    to be draped  0.0           topology_exact 0.500" in said
    assert "0 done, 1 to be draped, 0 failed" in said
    assert json.loads((out / "a" / "report.json").read_text())["scores"] == {"topology_exact": [0.5, 0.4, 0.6]}
    assert main(report) == 0
    assert "1 of 1 runs reported, 1 of them not draped" in capsys.readouterr().out
    page = (reports / "learning_T0.md").read_text()
    assert "| hangs | 1 | 1.0 | 0.5 (0.4 to 0.6) |" in page
    assert campaign.NOT_DRAPED in page
    assert "--drape --out runs/a`" in page

    assert main(call) == 0
    assert starts(out) == ["make a", "drape a", "draped a"]
    assert "1 done, 0 to be draped" in capsys.readouterr().out
    assert main(report) == 0
    page = (reports / "learning_T0.md").read_text()
    assert "| hangs | 1 | 1.0 | 0.5 (0.4 to 0.6) | 0.25 (0.2 to 0.3) | 0.25 (0.2 to 0.3) | 0.25 (0.2 to 0.3) |" in page
    assert campaign.NOT_DRAPED not in page


def test_drapes_that_fail_are_tried_again_by_the_next_call(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan.write_text("[a]\nmodel = 'breaks'\ntrain = 1\nminutes = 1\ndrape = true")
    out = tmp_path / "runs"
    call = [str(plan), "--out", str(out), "--gpus", "0"]
    assert main(call) == 1
    assert starts(out) == ["make a", "a", "drape a"]
    assert "the drapes are broken" in capsys.readouterr().err
    assert main([*call, "--list"]) == 0
    assert "a    to be draped  0.8 " in capsys.readouterr().out
    assert main(call) == 1
    assert starts(out) == ["make a", "drape a"]


def test_a_folder_has_one_campaign_at_a_time(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call = [str(plan), "--out", str(tmp_path), "--gpus", "0", "--only", "a-short-10"]
    with (tmp_path / "lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        # What a killed campaign leaves behind: a program that has inherited the lock.
        left = subprocess.Popen(["sleep", "60"], pass_fds=[file.fileno()])
    assert main(call) == 1
    assert "a campaign, or a run that one left, goes on there" in capsys.readouterr().err
    left.kill()
    left.wait()
    assert main(call) == 0


def test_results_of_other_options_are_not_taken(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call = [str(plan), "--out", str(tmp_path / "runs"), "--gpus", "0", "--only", "a-short-10"]
    assert main(call) == 0
    plan.write_text(PLAN.replace("minutes = 1", "minutes = 2"))
    assert main(call) == 1
    assert "a-short-10 holds a run of other options" in capsys.readouterr().err
    assert main([*call[:-1], "x*"]) == 1
    assert "has no run x*" in capsys.readouterr().err


def test_finished_runs_are_reported(plan: Path, tmp_path: Path) -> None:
    out, reports = tmp_path / "runs", tmp_path / "reports"
    call = [str(plan), "--out", str(out), "--gpus", "0", "--only", "a-short-*"]
    report = [*call, "--report", "--reports", str(reports), "--commit", "abc"]
    assert main(report) == 1
    assert main(call) == 0
    assert main(report) == 0
    page = (reports / "learning_T0.md").read_text()
    assert "| short | 20 | 1.0 | 0.5 (0.4 to 0.6) |" in page
    assert "toy_program short --task T0 --train 10 --minutes 1 --out runs/a-short-10`" in page


def test_a_report_of_other_options_is_refused(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The leaderboard would name a command that did not make it."""
    call = [str(plan), "--out", str(tmp_path / "runs"), "--gpus", "0", "--only", "a-short-10"]
    assert main(call) == 0
    plan.write_text(PLAN.replace("minutes = 1", "minutes = 2"))
    assert main([*call, "--report", "--reports", str(tmp_path / "reports"), "--commit", "abc"]) == 1
    assert "a-short-10 holds a run of other options" in capsys.readouterr().err
    assert not (tmp_path / "reports").exists()


@pytest.mark.parametrize("text", ['{"task": "T0", ', "", "[1]", "3"])
def test_a_damaged_report_is_one_error(
    text: str, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = [str(plan), "--out", str(tmp_path), "--gpus", "0", "--only", "a-short-10"]
    assert main(call) == 0
    (tmp_path / "a-short-10" / "report.json").write_text(text)
    for flags in ([], ["--list"], ["--report", "--reports", str(tmp_path / "reports"), "--commit", "abc"]):
        capsys.readouterr()
        assert main([*call, *flags]) == 1
        (error,) = capsys.readouterr().err.splitlines()
        assert f"{tmp_path / 'a-short-10' / 'report.json'}" in error


@pytest.mark.parametrize(
    ("name", "without"),
    [
        ("smoke.toml", {"T7"}),
        ("h200.toml", {"T7"}),
        ("h200_short.toml", {"T7", "T1-scan"}),
        ("h200_hour.toml", {"T7"}),
        ("h200_long.toml", {"T7", "T0", "T1-scan", "T5"}),
        ("h200_families.toml", {"T7", "T1-scan"}),
    ],
)
def test_the_commands_of_the_committed_plans_are_valid(name: str, without: set[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    add_arguments(parser)
    stitches = argparse.ArgumentParser()
    stitching.add_arguments(stitches)
    for run in read_plan(PLANS / name):
        arguments = [*run.command[3:], "--out", "out"]
        if run.program == "train":
            args = parser.parse_args(arguments)
            options_from(args, args.model)
        else:
            args = stitching.parsed(stitches, arguments)
        assert not args.leave_out or args.leave_out in FAMILIES
    assert {run.task for run in read_plan(PLANS / name)} == set(TASKS) - without


@pytest.mark.parametrize(
    ("given", "steps", "minutes"),
    [
        ([], 0, 6.0), (["--minutes", "2.5"], 0, 2.5), (["--steps", "70"], 70, 0.0),
        (["--smoke"], 0, 0.4), (["--smoke", "--steps", "70"], 70, 0.0),
    ],
)  # fmt: skip
def test_stitches_are_trained_for_a_time_or_some_steps(given: list[str], steps: int, minutes: float) -> None:
    parser = argparse.ArgumentParser()
    stitching.add_arguments(parser)
    config, _ = stitching.configs_from(stitching.parsed(parser, ["--out", "out", *given]))
    assert (config.steps, config.minutes) == (steps, minutes)
    with pytest.raises(ConfigError, match="steps 5, minutes 3: give one of them"):
        stitching.configs_from(stitching.parsed(parser, ["--out", "out", "--steps", "5", "--minutes", "3"]))


@pytest.mark.parametrize(
    ("given", "shown"), [("", ["0,1,2", "1,2,0", "2,0,1"]), ("3,5,7", ["3,5,7", "5,7,3", "7,3,5"])]
)
def test_a_program_sees_its_own_gpu_first(given: str, shown: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", given)
    monkeypatch.setattr(campaign, "_gpus", lambda: 3)
    assert [campaign._visible(gpu) for gpu in range(3)] == shown


def test_families_are_compared_with_a_training_on_all() -> None:
    runs = read_plan(PLANS / "h200_families.toml")
    left_out = {task: {run.options["leave_out"] for run in runs if run.task == task} for task in {r.task for r in runs}}
    assert all(kinds == {"", *FAMILIES} for kinds in left_out.values())
    by_task = {task: {run.options["steps"] for run in runs if run.task == task} for task in left_out}
    assert all(len(steps) == 1 for steps in by_task.values())
    assert sum(run.minutes for run in runs) == pytest.approx(32, abs=1), "the minutes that the plan states"


def test_short_trainings_have_equal_time_and_garments() -> None:
    runs = read_plan(PLANS / "h200_short.toml")
    assert {run.minutes for run in runs} == {0.0, 2.0}
    assert {run.train for run in runs} == {4000}
    for name in ("T0", "T1"):
        models = {run.model for run in read_plan(PLANS / "h200.toml") if run.task == name}
        assert {run.model for run in runs if run.task == name} == models


def test_the_plan_trains_on_the_sizes_of_the_tasks() -> None:
    runs = read_plan(PLANS / "h200.toml")
    for task in set(TASKS) - {"T7"}:
        sizes = {run.train for run in runs if run.task == task}
        assert sizes >= {1000, 4000}
        assert (24_000 in sizes) == (task in ("T0", "T3"))
        left_out = {run.options.get("leave_out") for run in runs if run.task == task}
        assert left_out >= FAMILIES
        minutes = {run.minutes for run in runs if run.task == task and run.minutes}
        assert len(minutes) == 1, f"the models of {task} have equal time"
