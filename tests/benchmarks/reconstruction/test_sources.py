"""Trainings on one source of garments, tested on another."""

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.runs import SKIRTS
from benchmarks.reconstruction.tasks import TASKS
from benchmarks.reconstruction.train import main
from gcd_dataset.errors import ConfigError
from gcd_dataset.spec import write_pattern
from tests.benchmarks.reconstruction.toys import t_shirt

SPLIT = "GarmentCodeData_v2_official_train_valid_test_data_split.json"
SEAMS = ["--model", "stitches", "--task", "T3", "--smoke", "--device", "cpu"]
SEAMS += ["--train", "2", "--checks", "0", "--test", "3"]


@pytest.fixture
def published(examples: Path, tmp_path: Path) -> str:
    """A shirt to train on, a skirt to check and to test, each on two bodies; draped by another solver."""
    folder = tmp_path / "published"
    shutil.copytree(examples / "published" / "GarmentCodeData_v2_unpacked", folder, symlinks=True)
    (folder / SPLIT).chmod(0o644)
    lists = json.loads((folder / SPLIT).read_text())
    (folder / SPLIT).write_text(json.dumps({**lists, "validation": lists["test"]}))
    return str(folder)


def test_a_finished_training_is_tested_on_foreign_patterns(tmp_path: Path) -> None:
    """Their results name the source and lie apart; the weights are those of the training."""
    (tmp_path / "foreign").mkdir()
    for name in ("shirt_00001", "shirt_2", "blouse"):
        write_pattern(t_shirt(), tmp_path / "foreign" / f"{name}_specification.json")
    out = tmp_path / "out"
    flags = [*SEAMS, "--steps", "2", "--batch", "2", "--out", str(out)]
    assert main(flags) == 0
    weights = (out / "weights.pt").read_bytes()
    assert main([*flags, "--test-source", str(tmp_path / "foreign")]) == 0
    ours, theirs = (json.loads((folder / "report.json").read_text()) for folder in (out, out / "on-foreign"))
    assert (ours["tested_on"], theirs["tested_on"]) == ("generated", str(tmp_path / "foreign"))
    assert ours["data"]["train"] == theirs["data"]["train"]
    assert ours["weights_sha256"] == theirs["weights_sha256"]
    assert (out / "weights.pt").read_bytes() == weights
    assert theirs["one_to_one"]["garments"] == 3
    assert set(theirs["scores_of_kinds"]) == {"shirt", "blouse"}
    assert ours["data"]["test"]["patterns"] != theirs["data"]["test"]["patterns"]


def test_the_official_split_trains_and_tests(published: str, tmp_path: Path) -> None:
    """Training on published garments, with a test on ours, and one on the published test garments."""
    flags = [*SEAMS, "--steps", "1", "--batch", "2", "--source", published, "--out", str(tmp_path / "out")]
    for test, tested in ([], 2), (["--test-source", "generated"], 3):
        assert main([*flags, *test]) == 0
        report = json.loads((tmp_path / "out" / ("on-generated" if test else "") / "report.json").read_text())
        assert report["data"]["train"]["recipe"]["split"] == "train"
        assert report["data"]["train"]["count"] == 2
        assert report["data"]["test"]["count"] == tested
        assert report["tested_on"] == ("generated" if test else published)


def test_published_garments_test_a_training_on_ours(published: str, tmp_path: Path) -> None:
    """Their points are those of their drapes, their designs have our parameters; their wearers have no weights."""
    options: dict[str, Any] = {"data": tmp_path, "tested": 5, "resolution": 8.0, "design": SKIRTS}
    split = TASKS["T1"].load(1, test_source=published, **options)
    assert split.test.kinds == ("skirt", "skirt")
    assert len(set(split.test.designs)) == 1
    assert split.test.points.shape == (2, *split.train.points.shape[1:])
    low, high = split.test.points[0, :, 1].min() + 100, split.test.points[0, :, 1].max() + 100
    assert (low, high) == pytest.approx((52.6, 108.6), abs=0.3)  # the drape's box in expected.json
    assert np.isnan(split.test.ragged["design"].rows).mean() < 0.2
    assert "pose" not in split.test.ragged
    assert not list(Path(published).rglob(".*"))  # what is unpacked lies in the cache
    for name, told in (("T0", "garments of stage drape"), ("T5", "no shape weights of the wearers, which T5 needs")):
        with pytest.raises(ConfigError, match=told):
            TASKS[name].load(1, test_source=published, **options)


def test_scans_test_a_training_on_whole_surfaces(tmp_path: Path) -> None:
    """The test garments are those of T1-scan; a task with other answers has none to give."""
    options: dict[str, Any] = {"data": tmp_path, "tested": 1, "resolution": 8.0, "design": SKIRTS}
    split, whole = TASKS["T1"].load(1, test_source="T1-scan", **options), TASKS["T1"].load(1, **options)
    assert split.test.keys == whole.test.keys
    assert split.train.patterns_hash == whole.train.patterns_hash
    assert not np.array_equal(split.test.points, whole.test.points)
    assert np.array_equal(split.test.points, TASKS["T1-scan"].load(1, **options).test.points)
    with pytest.raises(ConfigError, match="--test-source T4: T1 has other inputs or answers: give a folder"):
        TASKS["T1"].load(1, test_source="T4", **options)


def test_another_test_source_leaves_the_training_set_as_it_is(tmp_path: Path) -> None:
    """So that a later test on the training's own source is on garments that it never saw."""
    for folder, names in (("ours", "abcdefgh"), ("theirs", "xy")):
        (tmp_path / folder).mkdir()
        for name in names:
            write_pattern(t_shirt(), tmp_path / folder / f"{name}_specification.json")
    load = partial(TASKS["T3"].load, 8, source=str(tmp_path / "ours"), tested=3, checked=1)
    own, other = load(), load(test_source=str(tmp_path / "theirs"))
    assert len(own.train) == 4
    assert own.train.keys == other.train.keys
    assert (len(own.test), len(other.test)) == (3, 2)


def test_a_training_on_a_source_goes_on_with_the_same_garments() -> None:
    """Other numbers of test garments would leave others to train on."""
    of_source, generated = Config(source="folder", test=5, steps=1), Config(test=5, steps=1)
    assert of_source.identity != replace(of_source, test=6).identity
    assert generated.identity == replace(generated, test=6).identity
