"""The command: what it writes can be read and scored again, and a repeated call continues."""

import argparse
import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
import torch

from benchmarks.reconstruction import train
from benchmarks.reconstruction.models import panel_set
from benchmarks.reconstruction.tasks import TASKS
from benchmarks.reconstruction.train import UNFINISHED, main
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator import MakeConfig
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.metrics import mean_scores, score_pattern
from gcd_dataset.shards import ShardWriter
from gcd_dataset.spec import read_pattern

SMALL = ["--smoke", "--train", "4", "--test", "3", "--resolution", "6", "--device", "cpu"]
CALL = ["panel_set", "--steps", "1", "--batch", "4"]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Options of small runs that share their garments."""
    return [*SMALL, "--data", str(tmp_path_factory.mktemp("garments"))]


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory, small: list[str]) -> Path:
    """The folder of a finished training of ``CALL``."""
    folder = tmp_path_factory.mktemp("once")
    assert main([*CALL, *small, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def trained(tmp_path: Path, once: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(once, tmp_path / "out"))


def patterns_in(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.json"))


def test_answers_are_written_and_scored(once: Path) -> None:
    out = once
    pairs = list(zip(patterns_in(out / "predictions"), patterns_in(out / "truth"), strict=True))
    assert [one.name for one, _ in pairs] == [f"1_{k:09d}.json" for k in range(3)]
    report = json.loads((out / "report.json").read_text())
    again = mean_scores([score_pattern(read_pattern(one), read_pattern(other)) for one, other in pairs])
    assert report["scores"]["iou"][0] == pytest.approx(again.iou, abs=1e-6)
    assert report["scores"]["stitch_f1"][0] == pytest.approx(again.stitch_f1)
    assert (report["steps"], report["data"]["train"]["count"], report["data"]["test"]["count"]) == (1, 4, 3)
    with (out / "scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(float(row["iou"]) for row in rows) / 3 == pytest.approx(again.iou)
    assert (out / "pictures" / "test.png").stat().st_size > 1000
    assert [read_pattern(other).extra["properties"]["kind"] for _, other in pairs] == ["skirt"] * 3


def test_a_finished_run_is_not_answered_again(
    trained: Path, small: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless a file that the evaluator needs is missing."""
    out, call = trained, [*CALL, *small, "--out", str(trained)]
    written = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in out.rglob("*") if path.is_file()}
    with monkeypatch.context() as patch:
        for name in ("train", "_answers"):
            patch.setattr(train, name, Mock(side_effect=AssertionError))
        assert main(call) == 0
    again = capsys.readouterr()
    assert "T0.panel_set.iou " in again.out
    assert f"{out / 'report.json'} is of this run" in again.err
    assert {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in written} == written
    removed = next((out / "predictions").iterdir())
    removed.unlink()
    assert main(call) == 0
    assert removed.exists()


def test_answers_of_an_earlier_run_are_removed(tmp_path: Path, small: list[str]) -> None:
    """They would be scored as answers of the later model."""
    out = tmp_path / "out"
    assert main(["nearest", *small, "--out", str(out)]) == 0
    (out / "predictions" / "own.json").write_text("{}")
    (out / "evaluation.json").write_text("{}")
    assert main(["typical", *small, "--test", "2", "--out", str(out)]) == 0
    for folder in ("predictions", "truth"):
        assert {path.name for path in patterns_in(out / folder)} - {"own.json"} == {f"1_{k:09d}.json" for k in range(2)}
    assert {path.name for path in (out / "bodies").iterdir()} == {
        f"1_{k:09d}{end}" for k in range(2) for end in (".npy", ".meta.json")
    }
    assert (out / "predictions" / "own.json").exists()  # a file that the command did not write
    assert not (out / "evaluation.json").exists()


def test_another_default_of_a_network_is_another_training(
    trained: Path, small: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Versions may differ in one. Comparing networks draws no random number."""
    monkeypatch.setattr(train, "_network_hash", train._network_hash.__wrapped__)
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    same = train._network_hash("panel_set", True, "{}")
    assert torch.equal(torch.rand(3), expected)
    assert same == train._network_hash("panel_set", True, "{}")
    monkeypatch.setattr(panel_set, "SMALL", {**panel_set.SMALL, "points": 128})
    assert main([*CALL, *small, "--out", str(trained)]) == 1
    assert f"of a training with network {same}" in capsys.readouterr().err


def test_a_training_is_told_by_its_task_its_garments_and_their_recipe(small: list[str]) -> None:
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    options = train.options_from(parser.parse_args(small), "panel_set")
    garments = train.load_split(options).train
    recipe = {**garments.recipe, "recipe": {**garments.recipe["recipe"], "resolution": 7.0}}
    usual = train._identity(options, garments)
    for changed, some, names in (
        (replace(options, task=TASKS["T1"]), garments, {"task"}),
        (options, garments.select([0, 1]), {"garments", "ids", "patterns", "points"}),
        (options, replace(garments, recipe=recipe), {"recipe"}),
        (options, replace(garments, recipe={**garments.recipe, "made": 5}), set[str]()),
    ):
        found = train._identity(changed, some)
        assert {name for name in found if found[name] != usual[name]} == names


def test_a_damaged_checkpoint_is_one_error(trained: Path, small: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    (trained / "report.json").unlink()
    path = trained / "checkpoint.pt"
    for data in (path.read_bytes()[:1000], b"", b"PK"):
        path.write_bytes(data)
        assert main([*CALL, *small, "--out", str(trained)]) == 1
        assert "checkpoint.pt: no checkpoint" in capsys.readouterr().err.splitlines()[-1]


def test_the_report_is_written_before_answers_are_draped(
    tmp_path: Path, small: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drapes that are killed leave it as it is, and the next call drapes the answers, once."""
    call = ["typical", *small, "--test", "1", "--drape", "--out", str(tmp_path)]
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(train, "evaluate", Mock(side_effect=SystemExit))
        main(call)
    plain = json.loads((tmp_path / "report.json").read_text())
    assert "iou" in plain["scores"]
    assert not train.is_draped(plain)
    monkeypatch.setattr(train, "_answers", Mock(side_effect=AssertionError))
    assert main(call) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert train.is_draped(report)
    assert report["scores"].items() >= plain["scores"].items()
    monkeypatch.setattr(train, "evaluate", Mock(side_effect=AssertionError))
    assert main(call) == 0


def test_garments_are_made_alone_and_a_limit_ends_the_call(tmp_path: Path, small: list[str]) -> None:
    flags = ["panel_set", *small, "--steps", "4", "--out", str(tmp_path / "out"), "--data", str(tmp_path / "data")]
    assert main([*flags, "--make-only"]) == 0
    assert len(list((tmp_path / "data").glob("*/*.npz"))) == 3  # to train, to check, to test
    assert not list((tmp_path / "out").iterdir())
    assert main([*flags, "--limit-minutes", "0.0001"]) == UNFINISHED
    assert (tmp_path / "out" / "checkpoint.pt").exists()
    assert not (tmp_path / "out" / "report.json").exists()
    assert main(flags) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["steps"], report["options"]["train"]) == (4, report["data"]["train"]["count"])


def test_garments_of_a_folder_are_trained_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A smoke run keeps its sizes, and takes the garments as they are."""
    config = MakeConfig(stage="mesh", resolution=10.0, picture=0, points=512)
    with ShardWriter(tmp_path / "garments", seed=5, recipe=recipe_of(config)) as writer:
        for index in range(9):
            writer.write(make(5, index, config))
    flags = ["panel_set", "--smoke", "--train", "3", "--test", "3", "--steps", "1", "--device", "cpu"]
    flags += ["--source", str(tmp_path / "garments"), "--out", str(tmp_path / "out")]
    drape = Mock(side_effect=ConfigError("not draped here"))
    monkeypatch.setattr(train, "evaluate", drape)
    assert main([*flags, "--drape"]) == 1
    assert drape.call_args.args[0].resolution == TASKS["T0"].options["resolution"]
    assert main(flags) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["data"]["train"]["recipe"]["source"] == str(tmp_path / "garments")
    assert report["data"]["train"]["count"] == 3
    assert main([*flags, "--resolution", "6"]) == 1
    assert "--resolution 6: the garments of --source are made" in capsys.readouterr().err
    assert main([*flags, "--task", "T1"]) == 1
    assert "garments: garments of stage mesh: give garments made with --stage drape" in capsys.readouterr().err


def test_a_reference_does_not_answer_into_the_folder_of_a_training(
    trained: Path, small: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in sorted(trained.rglob("*")) if path.is_file()}
    for name in ("checkpoint.pt", "curves.csv"):
        assert main(["nearest", *small, "--out", str(trained)]) == 1
        assert f"out holds {name} of a training: give nearest another folder" in capsys.readouterr().err
        assert {path: path.read_bytes() for path in sorted(trained.rglob("*")) if path.is_file()} == before
        (trained / name).unlink()
        del before[trained / name]
    assert main(["nearest", *small, "--out", str(trained)]) == 0


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (["--task", "T9"], "no task 'T9'"),
        (["--task", "T4"], "panel_set does not answer T4: give --task T0, T1"),
        (["--task", "T3", "--drape"], "panel_set does not answer T3"),
        (["--set", "width"], "--set width: give NAME=NUMBER"),
        (["--steps", "3", "--minutes", "1"], "give one of them"),
        (["--steps", "3", "--minutes", "nan"], "give one of them"),
        (["--minutes", "inf"], "give one of them"),
        (["--set", "width=0"], "width 0 of panel_set: give 1 or more"),
        (["--set", "width=33"], "width 33 is no multiple of heads 6 of panel_set: change one"),
        (["--set", "tables=3"], "no size tables of panel_set: choose of"),
        (["--train", "20", "--fresh", "10"], "--fresh 10: give room for the 20 garments of --train"),
        (["--fresh", "5000", "--leave-out", "skirt"], "--fresh: needs a model that encodes garments"),
        (["--set", "width=-4"], "--set width=-4: give numbers of 0 or more"),
        (["--seed", "-1"], "--seed -1: give 0 or more"),
        (["--steps", "3", "--lr", "-1"], "lr -1, checks 4: give a rate above 0"),
        (["--steps", "3", "--checks", "-1"], "checks -1: give"),
        (["--train", "-1"], "--train -1: give 0 or more"),
        (["--test", "-1"], "--test -1: give 0 or more"),
        (["--fresh", "-3"], "--fresh -3: give 0 or more"),
        (["--workers", "-5"], "--workers -5: give -1 or more"),
        (["--limit-minutes", "nan"], "--limit-minutes nan: give 0 or more"),
        (["--device", "tpu"], "device='tpu': give auto, cpu"),
        (["--device", "cuda:99"], "device cuda:99: this machine has"),
        (["--device", "cuda:0,1"], "device cuda:0,1: give one; torchrun"),
    ],
)
def test_unusable_options_are_refused(
    flags: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["panel_set", "--out", str(tmp_path / "out"), *flags]) == 1
    assert expected in capsys.readouterr().err
    assert not list(tmp_path.iterdir())  # neither garments nor results
