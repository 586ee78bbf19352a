"""Compare two models on the same test garments: the mean difference of each score, with a paired interval.

    python -m benchmarks.reconstruction.compare FIRST SECOND

``FIRST`` and ``SECOND``: folders of ``train --out``, or JSON files of ``evaluate --json``. Both must have scored the
same garments in the same way. A line for each score of both:

    compare.iou +0.0138 [+0.00499, +0.0227] from 0.837 to 0.85 differs

is the mean of SECOND - FIRST, its 95 % interval (percentile bootstrap over the garments), and the two means. "differs":
the interval does not contain 0. The intervals of the two means may overlap although the models differ, since the same
garments are hard for both; a paired interval leaves this out. It covers the choice of the test garments, not a repeated
training. Of twenty scores of equal models one "differs" by chance: choose the score before you look.

Exit code 0, or 1 with one line on what to correct.
"""

import argparse
import csv
import io
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reconstruction.scoring.garments import SPACING
from benchmarks.reconstruction.train import EVALUATION, REPORT, SCORES
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import read_whole
from gcd_dataset.jsonfile import LARGEST_JSON, read_json
from gcd_dataset.metrics import bootstrap_means

__all__ = ["Difference", "Scores", "differences", "main", "read_scores"]

NO_SCORES = ("name", "key", "kind", "failure", "remarks")
"""Columns of a garment that are no scores."""
GIVE = "a folder of train --out or a JSON file of evaluate --json"


@dataclass(frozen=True)
class Scores:
    """The scores of the answers of one model."""

    source: Path
    garments: Mapping[str, Mapping[str, float]]
    """Garment to its scores by name."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """What must be equal for scores to be compared: task, test set, settings of the evaluator."""

    @property
    def names(self) -> list[str]:
        """The scores that all garments have."""
        rows = list(self.garments.values())
        return [name for name in rows[0] if all(name in row for row in rows)]


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
    def differs(self) -> bool:
        """Whether the interval does not contain 0."""
        return not self.low <= 0.0 <= self.high

    def __str__(self) -> str:
        values = f"{self.mean:+.3g} [{self.low:+.3g}, {self.high:+.3g}] from {self.first:.3g} to {self.second:.3g}"
        return f"compare.{self.name} {values}{' differs' if self.differs else ''}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0, or 1 for input that cannot be compared. Exits 2 for wrong usage."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.reconstruction.compare",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for name in ("first", "second"):
        parser.add_argument(name, type=Path, metavar=name.upper(), help=GIVE)
    options = parser.parse_args(arguments)
    try:
        first, second = read_scores(options.first), read_scores(options.second)
        found = differences(first, second)
    except GcdError as error:
        print(f"compare: {error}", file=sys.stderr)
        return 1
    print(f"compare.garments {len(first.garments)} garments")
    for difference in found:
        print(difference)
    return 0


def read_scores(source: Path) -> Scores:
    """The scores of a folder of ``train``, with those of drapes if there are, or of a file of ``evaluate --json``.

    Raises ``ConfigError`` for a source without scores of each garment, and for scores that are no finite numbers.
    """
    if not source.is_dir():
        return _evaluated(source)
    path = source / SCORES
    text = read_whole(path, "table of scores, which train writes", limit=LARGEST_JSON, error=ConfigError)
    report = read_json(source / REPORT, "report of a finished training", error=ConfigError)
    try:
        test = report["data"]["test"]
        recipe = (test.get("recipe") or {}).get("recipe") or {}
        about = {
            "task": report["task"],
            "hash of the test patterns": test["patterns"],
            "hash of the test samples": test["ids"],
            "resolution of the test garments": recipe.get("resolution"),
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{source / REPORT}: {error!r}: no report of this version: train again") from error
    if (source / EVALUATION).is_file():
        evaluated = _evaluated(source / EVALUATION)
        return Scores(source, evaluated.garments, {**about, **evaluated.about})
    rows = csv.DictReader(io.StringIO(text.decode(errors="replace")))
    return Scores(source, _by_garment(path, "key", rows), about)


def _evaluated(path: Path) -> Scores:
    found = read_json(path, "folder of train --out or JSON file of evaluate --json", error=ConfigError)
    settings = found.get("settings") if isinstance(found, dict) else None
    if not isinstance(settings, dict) or not isinstance(found.get("garments"), list):
        raise ConfigError(f"{path}: no settings and garments: give {GIVE}")
    about: dict[str, Any] = {}
    if settings.get("drape"):
        about = {
            "resolution of drapes": settings.get("resolution") or SPACING,
            "--partial": bool(settings.get("partial")),
            "--inputs given": settings.get("inputs") is not None,
        }
    return Scores(path, _by_garment(path, "name", found["garments"]), about)


def _by_garment(path: Path, key: str, rows: Iterable[Any]) -> dict[str, dict[str, float]]:
    """Garment to its scores. Raises ``ConfigError`` for rows without a name, twice the same, and for no numbers."""
    garments: dict[str, dict[str, float]] = {}
    for row in rows:
        if not isinstance(row, dict) or not isinstance(row.get(key), str):
            raise ConfigError(f"{path}: garment {len(garments)} has no {key}: give {GIVE}")
        if row[key] in garments:
            raise ConfigError(f"{path}: two garments {row[key]}: score them again")
        scores = {name: _number(value) for name, value in row.items() if name not in NO_SCORES}
        for name, value in scores.items():
            if not math.isfinite(value):
                raise ConfigError(f"{path}: garment {row[key]}: {name} is {row[name]!r:.99}: score them again")
        garments[row[key]] = scores
    if not garments:
        raise ConfigError(f"{path}: no garments: give {GIVE}")
    return garments


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def differences(first: Scores, second: Scores) -> list[Difference]:
    """The difference of each score that both have; the bootstrap has a fixed seed.

    Raises ``ConfigError`` for scores of other garments or by other settings, and without a common score.
    """
    for name in first.about.keys() & second.about.keys():
        if (ours := first.about[name]) != (theirs := second.about[name]):
            raise ConfigError(
                f"{second.source}: {name}: {theirs!r:.99}, but {ours!r:.99} in {first.source}: score both alike"
            )
    if apart := sorted(first.garments.keys() ^ second.garments.keys()):
        other = second if apart[0] in first.garments else first
        raise ConfigError(
            f"{other.source}: no garment {apart[0]} ({len(apart)} are in one alone): score both on the same garments"
        )
    names = [name for name in first.names if name in second.names]
    if not names:
        raise ConfigError(f"{second.source}: no score that {first.source} has: compare models of one task")
    ours, theirs = (
        np.array([[scores.garments[key][name] for name in names] for key in sorted(first.garments)])
        for scores in (first, second)
    )
    low, high = bootstrap_means(theirs - ours, np.random.default_rng(0))
    columns = (ours.mean(axis=0).tolist(), theirs.mean(axis=0).tolist(), low.tolist(), high.tolist())
    return [Difference(*row) for row in zip(names, *columns, strict=True)]


if __name__ == "__main__":
    sys.exit(main())
