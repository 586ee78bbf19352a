"""Compare two models on the same test garments: the mean difference of each score, with a paired interval.

    python -m benchmarks.reconstruction.compare FIRST SECOND

``FIRST`` and ``SECOND``: two folders of ``train --out``, or two JSON files of ``gcd score --json``. The test garments,
and the settings of drapes, must be the same. A line for each score of both:

    compare.iou +0.0138 [+0.00474, +0.0225] from 0.837 to 0.85 better

is the mean of SECOND - FIRST, its 95 % interval (percentile bootstrap over the garments), and the means of FIRST and of
SECOND. "better", "worse", or "differs" if a score has no better side: the interval does not contain 0. Intervals of the
two means may overlap although the models differ, since some garments are hard for both; pairing removes the variation
between garments. The interval covers the choice of the test garments, not a repeated training, which changes scores,
too. A score with a true difference of 0 is called different for one in twenty test sets.

Times (``ms``) are left out: they depend on the machine. Exit code 0, or 1 with one line on what to correct.
"""

import argparse
import csv
import io
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import discard_stdout, read_whole
from gcd_dataset.jsonfile import LARGEST_JSON, read_json
from gcd_dataset.measurements import MEASURES
from gcd_dataset.metrics import bootstrap_means
from gcd_dataset.scoring.table import EVALUATION, REPORT, SCORES, TIMES, UNITS

LEAST_GARMENTS = 30  # of fewer, bootstrap intervals are too narrow: 12 % of equal models would differ on 8 garments
DIGITS = 6  # decimals: differences of rounding errors count as 0
NOT_SCORES = ("name", "key", "kind", "failure", "remarks", *TIMES)
"""Columns that are not compared."""
LOWER = frozenset({
    *UNITS, *MEASURES, "error_cm", "error_p95_cm", "error_degrees", "stretch_error", "self_crossings", "body_crossings",
    "body_through",
})  # fmt: skip
"""Scores where lower is better."""
NEITHER = frozenset({"seam_mismatch"})
"""Scores without a better side: the true patterns have a mismatch, too, since gathers count."""
FOLDER, FILE = "folder of train --out", "JSON file of gcd score --json"


@dataclass(frozen=True)
class ModelScores:
    """The scores of the answers of one model."""

    source: Path
    garments: Mapping[str, Mapping[str, float]]
    """Garment to its scores by name; all garments have the same scores."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Test set and settings of drapes; those that both models have must be equal."""
    kind: str = FOLDER

    @property
    def names(self) -> list[str]:
        return list(next(iter(self.garments.values())))


@dataclass(frozen=True)
class Difference:
    """A score of the same garments by two models."""

    name: str
    first: float
    """Mean of the first model."""
    second: float
    low: float
    """Lower end of the 95 % interval of the mean difference, second - first."""
    high: float

    @property
    def mean(self) -> float:
        return self.second - self.first

    @property
    def verdict(self) -> str:
        """``better``, ``worse`` or ``differs``; empty if the interval contains 0."""
        if round(self.low, DIGITS) <= 0.0 <= round(self.high, DIGITS):
            return ""
        if self.name in NEITHER:
            return "differs"
        return "better" if (self.mean < 0) == (self.name in LOWER) else "worse"

    def __str__(self) -> str:
        mean, low, high = (f"{round(value, DIGITS) + 0.0:+.3g}" for value in (self.mean, self.low, self.high))
        line = f"compare.{self.name} {mean} [{low}, {high}] from {self.first:.3g} to {self.second:.3g} {self.verdict}"
        return line.rstrip()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0, or 1 for input that cannot be compared. Exits 2 for wrong usage."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="benchmarks.reconstruction.compare", description=__doc__, formatter_class=formatter
    )
    for name in ("first", "second"):
        parser.add_argument(name, type=Path, metavar=name.upper(), help=f"a {FOLDER}, or a {FILE}")
    options = parser.parse_args(arguments)
    try:
        first, second = read_scores(options.first), read_scores(options.second)
        found = differences(first, second)
    except GcdError as error:
        print(f"compare: {error}", file=sys.stderr)
        return 1
    for remark in _remarks(first, second):
        print(f"compare: {remark}", file=sys.stderr)
    try:
        print(f"compare.garments {len(first.garments)} garments", *found, sep="\n", flush=True)
    except BrokenPipeError:
        discard_stdout()
        return 1
    return 0


def _remarks(first: ModelScores, second: ModelScores) -> Iterator[str]:
    for one, other in ((first, second), (second, first)):
        if alone := [name for name in one.names if name not in other.names]:
            yield f"{', '.join(alone)}: scores of {one.source} alone, not compared"


# ------------------------------------------------------------------------------------------------------- the two inputs


def read_scores(source: Path) -> ModelScores:
    """The scores in a folder of ``train``, of ``EVALUATION`` if it is there, or in a file of ``gcd score --json``.

    Raises ``ConfigError`` for a source without scores of each garment, and for scores that are no finite numbers.
    """
    if not source.is_dir():
        return _of_file(source)
    report = read_json(source / REPORT, f"report of a finished training: a {FOLDER}", error=ConfigError)
    settings = _test_set(report, source / REPORT)
    if (source / EVALUATION).is_file():
        garments, of_drapes, _ = _evaluated(source / EVALUATION)
        return ModelScores(source, garments, {**settings, **of_drapes})
    path = source / SCORES
    if not path.exists():
        raise ConfigError(f"{source}: no {SCORES}: give a {FOLDER}")
    text = read_whole(path, "table of scores", limit=LARGEST_JSON, error=ConfigError).decode(errors="replace")
    try:
        rows = [dict(row) for row in csv.DictReader(io.StringIO(text, newline=""), restkey="")]
    except csv.Error as error:
        raise ConfigError(f"{path}: {error}: answer again") from error
    return ModelScores(source, _by_garment(path, "key", [_numbered(row) for row in rows]), settings)


def _test_set(report: Any, path: Path) -> dict[str, Any]:
    try:
        test = report["data"]["test"]
        recipe = test.get("recipe") or {}
        settings = {"task": report["task"], "hash of the test patterns": test["patterns"]}
        settings["hash of the test samples"] = test["ids"]
        drawn = {name: value for name, value in recipe.get("recipe", {}).items() if name != "device"}
        return {**settings, **{f"{name} of the test garments": value for name, value in sorted(drawn.items())}}
    except (KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: {error!r}: no report of this version: give a {FOLDER}, or train again") from error


def _of_file(path: Path) -> ModelScores:
    garments, of_drapes, hashes = _evaluated(path)
    if not isinstance(hashes, dict) or "truth" not in hashes:
        raise ConfigError(f"{path}: no hash of the true patterns: score again with this version")
    named = {f"hash of {name}": value for name, value in hashes.items()}
    return ModelScores(path, garments, {**named, **of_drapes}, FILE)


def _evaluated(path: Path) -> tuple[dict[str, dict[str, float]], dict[str, Any], Any]:
    """The contents of a file of ``gcd score --json``: scores of each garment, settings of drapes, hashes of the inputs.

    The settings are empty without drapes. The hashes are not checked.
    """
    found = read_json(path, FILE, error=ConfigError)
    settings = found.get("settings") if isinstance(found, dict) else None
    if not isinstance(settings, dict) or not isinstance(found.get("garments"), list):
        raise ConfigError(f"{path}: no settings and garments: give a {FILE}")
    of_drapes = {}
    if settings.get("drape"):
        of_drapes = {
            "resolution of the drapes": settings.get("resolution"),
            "--partial": bool(settings.get("partial")),
            "--inputs given": "inputs" in (settings.get("hashes") or ()),
            "version of the drapes": settings.get("gcd_dataset"),
        }
    return _by_garment(path, "name", found["garments"]), of_drapes, settings.get("hashes")


def _numbered(row: Mapping[Any, Any]) -> dict[Any, Any]:
    """A row of a CSV file with floats where its texts are numbers."""

    def number(text: Any) -> Any:
        try:
            return float(text)
        except (TypeError, ValueError):
            return text

    return {name: value if name in NOT_SCORES else number(value) for name, value in row.items()}


def _by_garment(path: Path, key: str, rows: Iterable[Any]) -> dict[str, dict[str, float]]:
    """Garment to its scores.

    Raises ``ConfigError`` for a row without a name, a name twice, a value that is no finite number, rows with different
    scores, and without rows or scores.
    """
    garments: dict[str, dict[str, float]] = {}
    for number, row in enumerate(rows):
        name = row.get(key) if isinstance(row, dict) else None
        if not isinstance(name, str):
            raise ConfigError(f"{path}: garment {number} has no {key}: give a {FOLDER}, or a {FILE}")
        if name in garments:
            raise ConfigError(f"{path}: two garments {name}: score them again")
        scores = {score: _finite(value, f"{path}: garment {name}: {score}") for score, value in row.items()
                  if score not in NOT_SCORES}  # fmt: skip
        if garments and scores.keys() != (expected := next(iter(garments.values()))).keys():
            apart = sorted(scores.keys() ^ expected.keys())
            raise ConfigError(f"{path}: garment {name}: other scores than the first ({apart[0]}): score them again")
        garments[name] = scores
    if not garments or not next(iter(garments.values())):
        raise ConfigError(f"{path}: no scores of garments: give a {FOLDER}, or a {FILE}")
    return garments


def _finite(value: Any, place: str) -> float:
    try:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    except OverflowError:
        pass
    raise ConfigError(f"{place} is {value!r:.99}, no finite number: score the garments again")


# ------------------------------------------------------------------------------------------------------ the differences


def differences(first: ModelScores, second: ModelScores) -> list[Difference]:
    """The difference of each score that both have; the bootstrap has a fixed seed.

    Raises ``ConfigError`` for fewer than ``LEAST_GARMENTS`` garments, for other test garments or settings, and without
    a common score.
    """
    if first.kind != second.kind:
        raise ConfigError(
            f"{first.source} is a {first.kind}, {second.source} a {second.kind}: give two folders, or two files"
        )
    for name, value in first.settings.items():
        if name in second.settings and second.settings[name] != value:
            raise ConfigError(
                f"{second.source}: {name}: {_shown(second.settings[name])}, but {_shown(value)} in {first.source}: "
                "give answers for the same test garments, scored alike"
            )
    if apart := sorted(first.garments.keys() ^ second.garments.keys()):
        without = second if apart[0] in first.garments else first
        raise ConfigError(
            f"{without.source}: no garment {apart[0]}; one of both lacks {len(apart)}: give answers for the same "
            "test garments"
        )
    if len(first.garments) < LEAST_GARMENTS:
        raise ConfigError(
            f"{first.source}: {len(first.garments)} garments, too few to tell models apart: test on {LEAST_GARMENTS}"
        )
    names = [name for name in first.names if name in second.names]
    if not names:
        raise ConfigError(f"{second.source}: no score of {first.source}: compare models of one task")
    before, after = (
        np.array([[scores.garments[key][name] for name in names] for key in sorted(first.garments)])
        for scores in (first, second)
    )
    low, high = bootstrap_means(after - before, np.random.default_rng(0))
    columns = (before.mean(axis=0).tolist(), after.mean(axis=0).tolist(), low.tolist(), high.tolist())
    return [Difference(*row) for row in zip(names, *columns, strict=True)]


def _shown(value: Any) -> str:
    """A setting for a message; of a hash, the beginning."""
    text = str(value)
    return text if len(text) <= 16 else f"{text[:16]}…"


if __name__ == "__main__":
    sys.exit(main())
