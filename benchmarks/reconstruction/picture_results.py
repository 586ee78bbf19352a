"""The scores of networks that were trained on different inputs, as files, figures and tables."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases.figures import Figure
from benchmarks.reconstruction.picture_inputs import Input
from benchmarks.reconstruction.scoring.table import UNITS
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.metrics import PatternScore, bootstrap_interval, mean_scores

TESTS = (Input.HELD_OUT, Input.PLAIN, Input.DRAWN, Input.GREY)
METRICS = ("panel_count_acc", "edge_count_acc", "iou")
"""The metrics whose gaps are stated in points."""


@dataclass
class Result:
    """Scores of a network that was trained on one input."""

    what: Input
    figures: dict[str, float]
    scores: dict[Input, list[PatternScore]]
    """By the input that it was tested on, in the order of the test garments."""


def write_result(out: Path, result: Result, args: argparse.Namespace) -> None:
    """Write the scores of every test garment, with the options that they depend on."""
    scores = {test: [astuple(score) for score in found] for test, found in result.scores.items()}
    steps = {"steps": int(result.figures["steps"])}
    text = {"options": {**_options(args), **steps}, "figures": result.figures, "scores": scores}
    write_whole(out / f"{result.what}.json", json.dumps(text).encode())


def read_result(out: Path, what: Input, args: argparse.Namespace) -> Result | None:
    """The result of an earlier call with the same options; ``None`` without one."""
    path = out / f"{what}.json"
    if not path.exists():
        return None
    text = json.loads(path.read_text())
    options = _options(args)
    if not args.steps:
        options["steps"] = text["options"]["steps"]
    if text["options"] != options:
        raise ConfigError(f"{path} has results of other options: give another --out")
    log(f"{what}: read from {path}")
    if any(len(row) != len(fields(PatternScore)) for rows in text["scores"].values() for row in rows):
        raise ConfigError(f"{path} has the scores of another version: give another --out")
    scores = {Input(test): [PatternScore(*row) for row in rows] for test, rows in text["scores"].items()}
    return Result(what, text["figures"], scores)


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """The options that decide the result, besides the number of renderers."""
    without = ("out", "inputs", "minutes", "workers", "report", "keep", "case")
    return {name: value for name, value in vars(args).items() if name not in without}


def figures_of(results: Mapping[Input, Result]) -> list[Figure]:
    """Course of each training, mean scores of each network on each test, gaps of the drawn input to the others."""
    units = {"train_minutes": "min", "waiting": "of the time"}
    figures = [
        Figure(f"{what}_{name}", value, units.get(name, ""))
        for what, result in results.items()
        for name, value in result.figures.items()
    ]
    for what, result in results.items():
        for test, scores in result.scores.items():
            means = mean_scores(scores)
            figures += [Figure(f"{what}_on_{test}_{name}", getattr(means, name), "share") for name in METRICS]
    if Input.DRAWN in results:
        for other in (what for what in results if what is not Input.DRAWN):
            for test in TESTS:
                found = gaps(results[Input.DRAWN].scores[test], results[other].scores[test])
                figures += [
                    Figure(f"gap_to_{other}_on_{test}_{name}", found[0][name], f"points, {low:.1f} to {high:.1f}")
                    for name in METRICS
                    for low, high in [(found[1][name], found[2][name])]
                ]
    return figures


def gaps(
    scores: Sequence[PatternScore], others: Sequence[PatternScore]
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Mean differences in points by metric, and the ends of their 95 % intervals, paired by garment."""
    apart = [
        PatternScore(*(100.0 * (np.array(astuple(one)) - astuple(other))).tolist())
        for one, other in zip(scores, others, strict=True)
    ]
    ends = bootstrap_interval(apart, np.random.default_rng(0))
    mean, low, high = ({name: float(getattr(one, name)) for name in METRICS} for one in (mean_scores(apart), *ends))
    return mean, low, high


def rows_of(results: Mapping[Input, Result]) -> list[dict[str, str]]:
    """A table row for each network and test: mean scores with 95 % intervals."""
    rows = []
    for test in TESTS:
        for what, result in results.items():
            scores = result.scores[test]
            means, (low, high) = mean_scores(scores), bootstrap_interval(scores, np.random.default_rng(0))
            cells = {
                name: f"{getattr(means, name):.3g} ({getattr(low, name):.3g} to {getattr(high, name):.3g})"
                for name in PatternScore.__dataclass_fields__
            }
            named = {f"{name} [{UNITS[name]}]" if name in UNITS else name: cell for name, cell in cells.items()}
            rows.append({"tested on": str(test), "trained on": str(what), **named})
    return rows


def log(text: str) -> None:
    """Print a line of progress."""
    print(text, file=sys.stderr, flush=True)
