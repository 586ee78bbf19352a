"""The paired comparison of two models: garments that are hard for both do not blur their difference."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.reconstruction import compare
from benchmarks.reconstruction.compare import LEAST_GARMENTS, Difference, ModelScores, differences, main, read_scores
from gcd_dataset.cli import main as gcd
from gcd_dataset.errors import ConfigError
from gcd_dataset.scoring.table import EVALUATION, REPORT, SCORES
from gcd_dataset.spec import write_pattern
from tests.benchmarks.reconstruction.toys import t_shirt, tube

RECIPE = {"resolution": 2.0, "bodies": "random"}


def scores(rows: Sequence[Mapping[str, float]], **settings: Any) -> ModelScores:
    return ModelScores(Path("model"), {f"g{k}": row for k, row in enumerate(rows)}, settings)


def run_folder(
    out: Path,
    rows: Sequence[Mapping[str, Any]],
    *,
    task: str = "T1",
    patterns: str = "p",
    ids: str = "i",
    recipe: Mapping[str, Any] | None = None,
) -> Path:
    out.mkdir()
    test = {"count": len(rows), "patterns": patterns, "ids": ids, "recipe": {"recipe": {**RECIPE, **(recipe or {})}}}
    (out / REPORT).write_text(json.dumps({"task": task, "data": {"test": test}}))
    with (out / SCORES).open("w", newline="") as file:
        writer = csv.DictWriter(file, ["key", "kind", *rows[0]])
        writer.writeheader()
        writer.writerows({"key": f"g{k}", "kind": "dress", **row} for k, row in enumerate(rows))
    return out


def evaluated(path: Path, rows: Sequence[Mapping[str, Any]], *, truth: str = "t", **settings: Any) -> Path:
    garments = [{"name": f"g{k}", "kind": "dress", "failure": None, "remarks": [], **row} for k, row in enumerate(rows)]
    path.write_text(json.dumps({"settings": {"hashes": {"truth": truth}, **settings}, "garments": garments}))
    return path


def equal(value: float, count: int = LEAST_GARMENTS) -> list[dict[str, float]]:
    return [{"iou": value}] * count


# ------------------------------------------------------------------------------------------------------ the statistics


def test_a_gain_that_is_the_same_on_every_garment_has_no_spread_although_the_garments_differ() -> None:
    hard = np.linspace(0.1, 0.9, 50)
    (found,) = differences(scores([{"iou": x} for x in hard]), scores([{"iou": x + 0.01} for x in hard]))
    assert (found.first, found.second, found.mean) == pytest.approx((0.5, 0.51, 0.01))
    assert (found.low, found.high) == pytest.approx((0.01, 0.01))
    assert str(found) == "compare.iou +0.01 [+0.01, +0.01] from 0.5 to 0.51 better"


def test_the_interval_has_the_width_of_the_standard_error_of_the_differences() -> None:
    rng = np.random.default_rng(3)
    hard, noise = rng.uniform(size=400), rng.normal(0.0, 0.1, 400)
    (found,) = differences(scores([{"iou": x} for x in hard]), scores([{"iou": x} for x in hard + noise]))
    assert found.high - found.low == pytest.approx(2 * 1.96 * noise.std() / 20, rel=0.1)


@pytest.mark.parametrize(
    ("name", "low", "high", "verdict"),
    [
        ("iou", 0.1, 0.2, "better"),
        ("iou", -0.2, -0.1, "worse"),
        ("iou", -0.1, 0.1, ""),
        ("iou", 0.0, 0.1, ""),
        ("iou", 1e-9, 1e-9, ""),  # rounding errors
        ("panel_l2", 0.1, 0.2, "worse"),
        ("error_cm", -0.2, -0.1, "better"),
        ("waist", -0.2, -0.1, "better"),
        ("seam_mismatch", -0.2, -0.1, "differs"),
    ],
)
def test_the_verdict_knows_which_side_is_better(name: str, low: float, high: float, verdict: str) -> None:
    assert Difference(name, 1.0, 1.0 + (low + high) / 2, low, high).verdict == verdict


def test_few_garments_tell_no_models_apart() -> None:
    few = LEAST_GARMENTS - 1
    with pytest.raises(ConfigError, match=f"model: {few} garments, too few"):
        differences(scores(equal(0.1, few)), scores(equal(0.9, few)))


# ------------------------------------------------------------------------------------------------------------ the input


def test_rows_are_matched_by_garment_and_scores_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hard = np.linspace(0.1, 0.8, LEAST_GARMENTS)
    first = run_folder(tmp_path / "a", [{"iou": x, "valid": 1.0, "ms": 1.0} for x in hard])
    second = run_folder(tmp_path / "b", [{"ms": 9.0, "iou": x + 0.1} for x in hard])
    lines = (second / SCORES).read_text().splitlines()
    (second / SCORES).write_text("\n".join([lines[0], *reversed(lines[1:])]))
    assert main([str(first), str(second)]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        f"compare.garments {LEAST_GARMENTS} garments",
        "compare.iou +0.1 [+0.1, +0.1] from 0.45 to 0.55 better",
    ]
    assert err == f"compare: valid: scores of {first} alone, not compared\n"


def test_a_folder_with_scores_of_the_evaluator_has_these(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [run_folder(tmp_path / name, equal(0.2)) for name in "ab"]
    for out, exact in zip(folders, (0.0, 1.0), strict=True):
        evaluated(out / EVALUATION, [{"strict_within_1cm": exact}] * LEAST_GARMENTS, drape=True)
    assert main([str(out) for out in folders]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["compare.strict_within_1cm +1 [+1, +1] from 0 to 1 better"]


def test_files_of_the_evaluator_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "LEAST_GARMENTS", 2)
    truth, better, worse = (tmp_path / name for name in ("truth", "better", "worse"))
    for folder in (truth, better, worse):
        folder.mkdir()
    for name in range(2):
        write_pattern(tube(), truth / f"{name}.json")
        write_pattern(tube(), better / f"{name}.json")
    (worse / "0.json").write_text("{}")  # and no file of the others: all fail
    for folder in (better, worse):
        assert gcd(["score", str(folder), str(truth), "--quiet", "--json", f"{folder}.json"]) == 0
    capsys.readouterr()
    assert main([f"{worse}.json", f"{better}.json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "compare.garments 2 garments"
    assert "compare.iou +1 [+1, +1] from 0 to 1 better" in lines
    write_pattern(t_shirt(), truth / "0.json")
    assert gcd(["score", str(better), str(truth), "--quiet", "--json", f"{better}.json"]) == 0
    assert main([f"{worse}.json", f"{better}.json"]) == 1
    assert "better.json: hash of truth: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"task": "T1-scan"}, r"task: T1-scan, but T1 in "),
        ({"patterns": "q"}, r"hash of the test patterns: q, but p in "),
        ({"ids": "j"}, r"hash of the test samples: j, but i in "),
        ({"recipe": {"resolution": 1.0}}, r"resolution of the test garments: 1.0, but 2.0 in "),
        ({"recipe": {"bodies": "neutral"}}, r"bodies of the test garments: neutral, but random in "),
    ],
)
@pytest.mark.parametrize("draped", [False, True])
def test_models_of_other_test_sets_are_not_compared(
    draped: bool, change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    folders = [run_folder(tmp_path / "a", equal(1)), run_folder(tmp_path / "b", equal(1), **change)]
    if draped:
        for out in folders:
            evaluated(out / EVALUATION, equal(1), drape=True)
    with pytest.raises(ConfigError, match=f"b: {message}.*a: give answers for the same test garments"):
        differences(*map(read_scores, folders))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"resolution": 1.0}, "resolution of the drapes: 1.0, but 2.0 in "),
        ({"hashes": {"truth": "t", "bodies": "b"}}, "--inputs given: False, but True in "),
        ({"hashes": {"truth": "t", "bodies": "c", "inputs": "d"}}, "hash of bodies: c, but b in "),
        ({"hashes": {"truth": "t", "bodies": "b", "inputs": "c"}}, "hash of inputs: c, but d in "),
    ],
)
def test_drapes_by_other_settings_are_not_compared(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    usual: dict[str, Any] = {"drape": True, "resolution": 2.0, "partial": False, "gcd_dataset": "0.1"}
    usual |= {"hashes": {"truth": "t", "bodies": "b", "inputs": "d"}}
    rows = [{"sim_ok": 1.0, "iou": 0.5}] * LEAST_GARMENTS
    one = read_scores(evaluated(tmp_path / "one.json", rows, **usual))
    other = read_scores(evaluated(tmp_path / "other.json", rows, **{**usual, **change}))
    with pytest.raises(ConfigError, match=rf"other.json: {message}"):
        differences(one, other)
    flat = read_scores(evaluated(tmp_path / "flat.json", equal(0.5), drape=False))
    assert [row.name for row in differences(flat, other)] == ["iou"]


def test_missing_garments_are_named() -> None:
    more, fewer = scores(equal(1.0, 41)), scores(equal(1.0, 40))
    for pair in ((more, fewer), (fewer, more)):
        with pytest.raises(ConfigError, match="model: no garment g40; one of both lacks 1"):
            differences(*pair)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (SCORES, "key,kind,iou\ng0,dress,nan\n", "garment g0: iou is nan"),
        (SCORES, "key,kind,iou\ng0,dress\n", "garment g0: iou is None"),
        (SCORES, "key,kind,iou\ng0,dress,1,2\n", r"garment g0:  is \['2'\]"),
        (SCORES, "key,kind,iou\ng0,dress,1\ng0,dress,1\n", "two garments g0"),
        (SCORES, "kind,iou\ndress,1\n", "garment 0 has no key"),
        (SCORES, "key,kind\ng0,dress\n", "no scores of garments"),
        (SCORES, f"key,kind,iou\ng0,{'x' * 200_000},1\n", "field larger than field limit"),
        (SCORES, None, rf"a: no {SCORES}: give a folder of train --out"),
        (REPORT, '{"one_to_one": {}}', f"{REPORT}: .*no report of this version"),
        (REPORT, None, f"{REPORT}: no such file: give the path of a report of a finished training"),
    ],
)
def test_folders_without_scores_are_refused(tmp_path: Path, name: str, content: str | None, message: str) -> None:
    out = run_folder(tmp_path / "a", equal(1.0))
    (out / name).unlink()
    if content is not None:
        (out / name).write_text(content)
    with pytest.raises(ConfigError, match=message):
        read_scores(out)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"garments": []}', "no settings and garments"),
        ('{"settings": {}, "garments": [1]}', "garment 0 has no name"),
        ('{"settings": {}, "garments": [{"name": "g", "iou": 1}]}', "no hash of the true patterns: score again"),
        ('{"settings": {}, "garments": [{"name": "g", "iou": true}]}', "garment g: iou is True, no finite number"),
        ("{", "correct the JSON"),
    ],
)
def test_files_without_scores_are_refused(
    content: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.json"
    path.write_text(content)
    assert main([str(path), str(path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"compare: {path}: ")
    assert message in line
