"""The command: what it writes can be read and scored again, and a repeated call continues."""

import csv
import json
import shlex
import shutil
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from benchmarks.examples import tiny_model
from benchmarks.reconstruction import runs, train
from benchmarks.reconstruction.options import parsed
from benchmarks.reconstruction.runs import load_split
from benchmarks.reconstruction.tasks import TASKS
from benchmarks.reconstruction.train import main
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator import MakeConfig
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.metrics import mean_scores, score_pattern
from gcd_dataset.scoring.board import read_card
from gcd_dataset.scoring.table import DRAPED
from gcd_dataset.shards import ShardWriter
from gcd_dataset.spec import read_pattern

EXAMPLE = Path(tiny_model.__file__)
SMALL = ["--smoke", "--train", "4", "--test", "3", "--resolution", "6", "--device", "cpu"]
CALL = ["--model", "panel_set", "--steps", "1", "--batch", "4"]


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
    assert [one.name for one, _ in pairs] == [f"gcd_{k:09d}.json" for k in range(3)]  # as ``gcd bench inputs`` names
    card = read_card(out / "card.toml")
    assert card["name"].startswith("panel_set ")
    assert (card["garments"], card["hardware"], card["baseline"]) == (4, "1 × cpu", False)
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
    """Nor are its answers mixed with those of another run."""
    call = [*CALL, *small, "--out", str(trained)]
    written = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in trained.rglob("*") if path.is_file()}
    monkeypatch.setattr(train, "train", Mock(side_effect=AssertionError))
    assert main(call) == 0
    again = capsys.readouterr()
    assert "T0.panel_set.iou " in again.out
    assert f"{trained / 'report.json'} is of this run" in again.err
    for other, told in (
        (["--batch", "2"], "batch 4, not 2"),
        (["--test", "2"], "test 3, not 2"),
        (["--model", "nearest"], "model panel_set, not nearest"),
    ):
        assert main([*call, *other]) == 1
        assert f"of a run with {told}: give another folder, or delete it" in capsys.readouterr().err
    assert {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in written} == written


def test_answers_of_an_earlier_run_are_removed(tmp_path: Path, small: list[str]) -> None:
    """They would be scored as answers of the later model."""
    assert main(["--model", "nearest", *small, "--out", str(tmp_path)]) == 0
    (tmp_path / "predictions" / "own.json").write_text("{}")
    (tmp_path / "report.json").unlink()
    assert main(["--model", "typical", *small, "--test", "2", "--out", str(tmp_path)]) == 0
    for folder in ("predictions", "truth"):
        names = {path.name for path in patterns_in(tmp_path / folder)} - {"own.json"}
        assert names == {f"gcd_{k:09d}.json" for k in range(2)}
    assert (tmp_path / "predictions" / "own.json").exists()  # a file that the command did not write


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
    call = ["--model", "typical", *small, "--test", "1", "--drape", "--out", str(tmp_path)]
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(runs, "score", Mock(side_effect=SystemExit))
        main(call)
    plain = json.loads((tmp_path / "report.json").read_text())
    assert "iou" in plain["scores"]
    monkeypatch.setattr(train, "answered", Mock(side_effect=AssertionError))
    assert main(call) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["scores"].keys() >= {*plain["scores"], *DRAPED}
    monkeypatch.setattr(runs, "score", Mock(side_effect=AssertionError))
    assert main(call) == 0


def test_garments_can_be_made_alone(tmp_path: Path) -> None:
    flags = [*SMALL, "--out", str(tmp_path / "out"), "--data", str(tmp_path / "data")]
    assert main([*flags, "--make-only"]) == 0
    assert len(list((tmp_path / "data").glob("*/*.npz"))) == 3  # to train, to check, to test
    assert not (tmp_path / "out").exists()


def test_a_validation_set_chooses_the_weights_and_the_training_set_the_range_of_measures(
    tmp_path: Path, small: list[str]
) -> None:
    """Answers are confined to the measures of the bodies trained on, not of those that are watched."""
    flags = ["--model", "parameters", *small, "--steps", "4", "--batch", "2", "--validate", "5", "--out", str(tmp_path)]
    assert main(flags) == 0
    split = load_split(parsed(flags), TASKS["T0"])
    assert len(split.check) == 5
    state = torch.load(tmp_path / "weights.pt", weights_only=True)
    assert np.allclose(state["decoder.most"], split.train.measures.max(axis=0))
    values = state["decoder.weights"]
    assert values.dtype == torch.bfloat16
    best = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["progress"][2]
    assert torch.equal(best[1]["decoder.weights"].to(torch.bfloat16), values)


def test_ranks_share_the_garments_of_a_set(tmp_path: Path, small: list[str]) -> None:
    """Each reads every second one; together they have the hashes of the whole."""
    config = parsed([*small, "--out", str(tmp_path)])
    data: dict[str, Any] = {"data": Path(config.data), "tested": 3, "resolution": 6.0, "design": runs.SKIRTS}
    whole = TASKS["T0"].load(4, **data).train
    shares = [TASKS["T0"].load(4, share=(k, 2), **data).train for k in range(2)]
    assert [share.keys for share in shares] == [whole.keys[::2], whole.keys[1::2]]
    hashes = [share.pattern_hash(k, 2) for k, share in enumerate(shares)]
    assert (hashes[0] + hashes[1]).text == whole.patterns_hash


def test_seams_have_tables(tmp_path: Path) -> None:
    flags = ["--model", "stitches", "--task", "T3", *SMALL, "--steps", "2", "--batch", "2", "--validate", "4"]
    path = tmp_path / "out" / "report.json"
    assert main([*flags, "--out", str(path.parent)]) == 0
    report = json.loads(path.read_text())
    assert report["one_to_one"]["garments"] == 3
    assert {"stitch_nm_perfect", "subdivided_perfect", "subdivided_f1"} <= report["scores"].keys()
    assert patterns_in(path.parent / "predictions")


def test_a_strangers_file_is_trained(tmp_path: Path, small: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "my_model.py"
    path.write_text(EXAMPLE.read_text().replace("def build(", "def mine("))
    flags = [*small, "--steps", "2", "--batch", "2", "--out", str(tmp_path / "out")]
    assert main(["--model", f"{path}:mine", *flags]) == 0
    assert "T0.my_model.iou " in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["options"]["sizes"] == {"width": 64, "points": 256}
    for name, told in ((f"{path}:other", "has no function other"), (f"{tmp_path}/no.py:build", "no model")):
        assert main(["--model", name, *flags]) == 1
        assert told in capsys.readouterr().err


def test_garments_of_a_folder_are_trained_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A smoke run keeps its sizes, and takes the garments as they are."""
    config = MakeConfig(stage="mesh", resolution=10.0, picture=0, points=512)
    with ShardWriter(tmp_path / "garments", seed=5, recipe=recipe_of(config)) as writer:
        for index in range(9):
            writer.write(make(5, index, config))
    flags = ["--model", "panel_set", "--smoke", "--train", "3", "--test", "3", "--steps", "1", "--device", "cpu"]
    flags += ["--source", str(tmp_path / "garments"), "--out", str(tmp_path / "out")]
    drape = Mock(side_effect=ConfigError("not draped here"))
    monkeypatch.setattr(runs, "score", drape)
    assert main([*flags, "--drape"]) == 1
    assert drape.call_args.kwargs["drapes"].resolution == TASKS["T0"].options["resolution"]
    assert main(flags) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["data"]["train"]["recipe"]["source"] == str(tmp_path / "garments")
    assert report["data"]["train"]["count"] == 3
    tested = ["--steps", "0", "--weights", str(tmp_path / "out" / "weights.pt"), "--out", str(tmp_path / "test")]
    assert main([*flags, *tested]) == 0
    kept, again = (torch.load(tmp_path / name / "weights.pt", weights_only=True) for name in ("out", "test"))
    assert all(torch.equal(value, kept[name]) for name, value in again.items())
    assert json.loads((tmp_path / "test" / "report.json").read_text())["steps"] == 0
    assert main([*flags, "--resolution", "6"]) == 1
    assert "--resolution 6: the garments of --source are made" in capsys.readouterr().err
    assert main([*flags, "--task", "T1"]) == 1
    assert "garments: garments of stage mesh: give garments made with --stage drape" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (["--task", "T9"], "no task 'T9'"),
        (["--task", "T4"], "panel_set does not answer T4: give --task T0, T1"),
        (["--set", "width"], "--set width: give NAME=NUMBER"),
        (["--steps", "3", "--minutes", "1"], "give one of them"),
        (["--steps", "0"], "give one of them"),
        (["--steps", "3", "--minutes", "nan"], "--minutes nan: give 0 or more"),
        (["--log-every", "0"], "--log-every 0 --ema 0.999 --warm-up 0.05: give the first three above 0"),
        (["--set", "width=0"], "width 0 of panel_set: give 1 or more"),
        (["--train", "20", "--fresh", "10"], "--fresh 10: give room for the 20 garments of --train"),
        (["--fresh", "5000", "--leave-out", "skirt"], "--fresh: needs a model that encodes garments"),
        (["--seed", "-1"], "--seed -1: give 0 or more"),
        (["--steps", "3", "--checks", "-1"], "--checks -1: give"),
        (["--workers", "-5"], "--workers -5: give -1 or more"),
        (["--device", "tpu"], "device='tpu': give auto, cpu"),
        (["--device", "cuda:99"], "device cuda:99: this machine has"),
        (["--device", "cuda:0,1"], "device cuda:0,1: give one; torchrun"),
    ],
)
def test_unusable_options_are_refused(
    flags: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--model", "panel_set", "--out", str(tmp_path / "out"), *flags]) == 1
    assert expected in capsys.readouterr().err
    assert not list(tmp_path.iterdir())  # neither garments nor results


PLANS = sorted((Path(train.__file__).parent / "plans").glob("*.sh"))


@pytest.mark.parametrize("path", PLANS, ids=lambda path: str(path.stem))
def test_the_plans_of_the_repository_have_valid_commands(path: Path) -> None:
    lines = path.read_text().splitlines()
    (program,) = (line.removeprefix("TRAIN=").strip('"') for line in lines if line.startswith("TRAIN="))
    calls = [line.replace("$TRAIN", program) for line in lines if line.startswith("$TRAIN")]
    configs = [parsed(shlex.split(call)[3:]) for call in calls]
    assert len({(config.out, config.test_source) for config in configs}) == len(configs) > 20
