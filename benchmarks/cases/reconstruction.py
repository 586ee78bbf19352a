"""Reconstruction: from surface points of a garment to its pattern, with a network and references.

    python -m benchmarks.run reconstruction --smoke

``panel_set`` is the trained network; ``nearest`` answers with the training garment of least chamfer distance;
``typical`` always answers with the same garment, the one with the least mean distance to the others; ``ceiling`` is the
ground truth in the network's output format, the best possible answer. Test garments have another seed: other designs
and bodies from the same design space. ``python -m benchmarks.reconstruction.train`` trains one model and has more
options.
"""

import argparse
from pathlib import Path

from benchmarks.cases import CaseResult, Figure
from benchmarks.reconstruction.models import MODELS
from benchmarks.reconstruction.train import add_arguments as add_training_arguments
from benchmarks.reconstruction.train import options_from
from benchmarks.reconstruction.train import run as run_model
from gcd_dataset.scoring.table import REPORT, UNITS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the case."""
    parser.add_argument("--models", default="panel_set,nearest,typical,ceiling", help=f"of {', '.join(MODELS)}")
    add_training_arguments(parser)


def run(options: argparse.Namespace) -> CaseResult:
    """Train or ask each model, and score the answers. Raises ``ConfigError`` for unusable options."""
    figures, rows, out = [], [], Path(options.out)
    options.data = options.data or str(out / "garments")
    for model in options.models.split(","):
        options.out = str(out / model)
        (out / model / REPORT).unlink(missing_ok=True)  # answer, score and time again
        report = run_model(options_from(options, model))
        assert report is not None  # one process
        if report["steps"]:
            figures += [
                Figure("steps", report["steps"], "optimiser steps"),
                Figure("train_minutes", report["minutes"], "min"),
                Figure("parameters", report["parameters"], "numbers"),
                Figure("first_loss", report["first_loss"], "a step, the first row of the curves"),
                Figure("last_loss", report["last_loss"], "a step, the last row of the curves"),
            ]
        figures += [Figure(f"{model}_load_s", report["load_s"], "s"), Figure(f"{model}_test_s", report["test_s"], "s")]
        scores = report["scores"]
        figures += [Figure(f"{model}_{name}", scores[name][0], UNITS.get(name, "share")) for name in scores]
        shown = {name: f"{mean:.3g} ({low:.3g} to {high:.3g})" for name, (mean, low, high) in scores.items()}
        rows.append({"answer": model, **shown})
    return CaseResult(figures, rows)
