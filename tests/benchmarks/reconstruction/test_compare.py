"""The paired comparison of two models: garments that are hard for both do not blur their difference."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.reconstruction.compare import Scores, differences, main, read_scores
from benchmarks.reconstruction.evaluate import main as evaluate
from benchmarks.reconstruction.train import EVALUATION, REPORT, SCORES
from gcd_dataset.errors import ConfigError
from gcd_dataset.spec import write_pattern
from tests.benchmarks.reconstruction.sewn_patterns import tube


def scores(rows: Sequence[Mapping[str, float]], **about: Any) -> Scores:
    return Scores(Path("model"), {f"g{k}": row for k, row in enumerate(rows)}, about)


def run_folder(out: Path, rows: Sequence[Mapping[str, Any]], *, patterns: str = "p", task: str = "T1") -> Path:
    out.mkdir()
    test = {"count": len(rows), "patterns": patterns, "ids": "i", "recipe": {"recipe": {"resolution": 2.0}}}
    (out / REPORT).write_text(json.dumps({"task": task, "data": {"test": test}}))
    with (out / SCORES).open("w", newline="") as file:
        writer = csv.DictWriter(file, ["key", "kind", *rows[0]])
        writer.writeheader()
        writer.writerows({"key": f"g{k}", "kind": "dress", **row} for k, row in enumerate(rows))
    return out


def test_a_gain_that_is_the_same_on_every_garment_has_no_spread_although_the_garments_differ() -> None:
    hard = np.linspace(0.1, 0.9, 50)
    (found,) = differences(scores([{"iou": x} for x in hard]), scores([{"iou": x + 0.01} for x in hard]))
    assert (found.first, found.second, found.mean) == pytest.approx((0.5, 0.51, 0.01))
    assert (found.low, found.high) == pytest.approx((0.01, 0.01))
    assert found.differs
    assert str(found) == "compare.iou +0.01 [+0.01, +0.01] from 0.5 to 0.51 differs"


def test_the_interval_has_the_width_of_the_standard_error_of_the_differences() -> None:
    rng = np.random.default_rng(3)
    hard, noise = rng.uniform(size=400), rng.normal(0.0, 0.1, 400)
    (found,) = differences(scores([{"iou": x} for x in hard]), scores([{"iou": x} for x in hard + noise]))
    assert found.high - found.low == pytest.approx(2 * 1.96 * noise.std() / 20, rel=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_equal_models_are_told_apart_seldom(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"score{k}" for k in range(100)]
    ours, theirs = rng.normal(size=(2, 200, len(names)))
    found = differences(*(scores([dict(zip(names, row, strict=True)) for row in rows]) for rows in (ours, theirs)))
    assert sum(row.differs for row in found) <= 12  # 5 of 100 expected; 13 and more: 1 in 700


def test_models_change_places_with_the_sign() -> None:
    ours, theirs = scores([{"iou": 0.2}, {"iou": 0.5}]), scores([{"iou": 0.4}, {"iou": 0.4}])
    (there,), (back,) = differences(ours, theirs), differences(theirs, ours)
    assert (there.mean, there.low, there.high) == pytest.approx((-back.mean, -back.high, -back.low))
    assert not there.differs


def test_rows_are_matched_by_garment_and_scores_by_name(tmp_path: Path) -> None:
    first = run_folder(tmp_path / "a", [{"iou": 0.2, "valid": 1.0}, {"iou": 0.8, "valid": 1.0}])
    second = run_folder(tmp_path / "b", [{"extra": 3.0, "iou": 0.3}, {"extra": 3.0, "iou": 0.9}])
    lines = (second / SCORES).read_text().splitlines()
    (second / SCORES).write_text("\n".join([lines[0], *reversed(lines[1:])]))
    (found,) = differences(read_scores(first), read_scores(second))
    assert found.name == "iou"
    assert (found.low, found.high) == pytest.approx((0.1, 0.1))


def test_a_folder_has_the_scores_of_drapes_if_there_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    garments: list[dict[str, Any]] = [
        {"name": "g0", "kind": "dress", "failure": None, "remarks": [], "within_1cm": 1.0}
    ]
    folders = [run_folder(tmp_path / name, [{"iou": 0.2}]) for name in "ab"]
    for out in folders:
        (out / EVALUATION).write_text(json.dumps({"settings": {"drape": True}, "garments": garments}))
    assert main([str(out) for out in folders]) == 0
    assert capsys.readouterr().out == "compare.garments 1 garments\ncompare.within_1cm +0 [+0, +0] from 1 to 1\n"


def test_files_of_the_evaluator_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth, better, worse = (tmp_path / name for name in ("truth", "better", "worse"))
    for folder in (truth, better, worse):
        folder.mkdir()
    for name in ("one", "two"):
        write_pattern(tube(), truth / f"{name}.json")
        write_pattern(tube(), better / f"{name}.json")
    (worse / "one.json").write_text("{}")  # and no file of the other: both fail
    for folder in (better, worse):
        evaluate([str(folder), str(truth), "--quiet", "--json", f"{folder}.json"])
    capsys.readouterr()
    assert main([f"{worse}.json", f"{better}.json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "compare.garments 2 garments"
    assert "compare.iou +1 [+1, +1] from 0 to 1 differs" in lines


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"patterns": "q"}, r"b: hash of the test patterns: 'q', but 'p' in .*a: score both alike"),
        ({"task": "T0"}, r"b: task: 'T0', but 'T1' in .*a: score both alike"),
    ],
)
def test_models_of_other_test_sets_are_not_compared(tmp_path: Path, change: dict[str, str], message: str) -> None:
    first, second = run_folder(tmp_path / "a", [{"iou": 1}]), run_folder(tmp_path / "b", [{"iou": 1}], **change)
    with pytest.raises(ConfigError, match=message):
        differences(read_scores(first), read_scores(second))


def test_drapes_by_other_settings_are_not_compared(tmp_path: Path) -> None:
    def file(name: str, **settings: Any) -> Scores:
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps({"settings": settings, "garments": [{"name": "g0", "sim_ok": 1.0, "iou": 0.5}]}))
        return read_scores(path)

    fine, usual = file("fine", drape=True, resolution=1.0), file("usual", drape=True, resolution=None)
    with pytest.raises(ConfigError, match=r"resolution of drapes: 1.0, but 2.0 in .*usual.json"):
        differences(usual, fine)
    flat = file("flat", drape=False, resolution=None)
    assert [row.name for row in differences(flat, fine)] == ["sim_ok", "iou"]


def test_missing_garments_are_named() -> None:
    both, one = scores([{"iou": 1.0}, {"iou": 1.0}]), scores([{"iou": 1.0}])
    for pair in ((both, one), (one, both)):
        with pytest.raises(ConfigError, match=r"model: no garment g1 \(1 are in one alone\)"):
            differences(*pair)


def test_models_without_a_common_score_are_not_compared() -> None:
    with pytest.raises(ConfigError, match="no score that model has"):
        differences(scores([{"iou": 1.0}]), scores([{"error_cm": 1.0}]))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("key,kind,iou\ng0,dress,nan\n", "garment g0: iou is 'nan'"),
        ("key,kind,iou\ng0,dress,\n", "garment g0: iou is ''"),
        ("key,kind,iou\ng0,dress\n", "garment g0: iou is None"),
        ("key,kind,iou\ng0,dress,1\ng0,dress,1\n", "two garments g0"),
        ("kind,iou\ndress,1\n", "garment 0 has no key"),
        ("key,kind,iou\n", "no garments"),
    ],
)
def test_tables_without_numbers_are_refused(tmp_path: Path, content: str, message: str) -> None:
    out = run_folder(tmp_path / "a", [{"iou": 1.0}])
    (out / SCORES).write_text(content)
    with pytest.raises(ConfigError, match=message):
        read_scores(out)


@pytest.mark.parametrize("name", [SCORES, REPORT])
def test_a_folder_without_a_finished_training_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    out = run_folder(tmp_path / "a", [{"iou": 1.0}])
    (out / name).unlink()
    assert main([str(out), str(out)]) == 1
    assert f"compare: {out / name}: no such file: give the path of a" in capsys.readouterr().err


def test_json_of_another_kind_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.json"
    for content in ("[]", '{"garments": []}', '{"settings": {}, "garments": [1]}'):
        path.write_text(content)
        assert main([str(path), str(path)]) == 1
        assert f"compare: {path}: " in capsys.readouterr().err
