"""Garments cut for another size than the wearer's: outcomes by the number of sizes, and the rate of making them.

    python -m benchmarks.run fits --count 5000 --device cuda:0 --workers 15 --sheet fits.jpg

The garments are those of the recipe ``fits-draft``, with pictures, maps and ease, written to a temporary folder.
``right``: the share that settled, or whose outcome says how it does not fit: slid off or cannot be put on, being cut
too large or labelled so; overstretched or cannot be put on, being cut too small or labelled so. ``clean``: the share of
those put on that settled without a crossing edge of any kind. ``recipe_hours`` and ``recipe_kj`` are those of the whole
recipe at this rate, computed. ``--sheet`` shows designs on one wearer each, cut for three sizes less to three more.
"""

import argparse
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import CaseResult, Figure, jpeg_file
from benchmarks.cases.scale import written
from gcd_dataset.files import write_whole
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes, picture_of
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.recipes import find_recipe
from gcd_dataset.records import Outcome

TILE = 256  # side of a garment's picture on the sheet [pixels]
LABELS = {"SLID_OFF": {"slides_off"}, "OVERSTRETCHED": {"too_tight", "tight_cuff"}}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=60, help="garments written")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2, help="processes that make garments")
    parser.add_argument("--device", default="auto", help="where cloth is draped")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--fabric", default=MakeConfig().fabric, help="as for gcd generate")
    parser.add_argument("--sheet", type=jpeg_file, help="write a JPEG of designs in all sizes")
    parser.add_argument("--shown", type=int, default=8, help="designs on the sheet")


def run(options: argparse.Namespace) -> CaseResult:
    """Make garments of the recipe, then the sheet."""
    recipe = find_recipe("fits-draft")
    config = replace(recipe.config, device=options.device, resolution=options.resolution, fabric=options.fabric)
    by_step: defaultdict[int, Counter[str]] = defaultdict(Counter)

    def note(meta: dict[str, Any], _: Mapping[str, bytes]) -> None:
        outcome, step = meta["drape"]["outcome"], meta["fit"]["step"]
        crossings = sum(meta["drape"][name] for name in ("self_crossings", "body_crossings", "body_through"))
        settled = outcome == Outcome.SETTLED.name
        clean = "clean" if settled and not crossings else "not clean"
        by_step[step].update([outcome, clean, "right" if settled or _is_right(meta) else "wrong"])

    figures = written(config, options, note)
    rate, total = figures[0].value, sum(by_step.values(), Counter())
    put_on = options.count - total[Outcome.CANNOT_BE_PUT_ON.name]
    figures += [
        Figure("right", total["right"] / options.count, "share"),
        Figure("clean", total["clean"] / put_on, "share of those put on"),
        Figure("recipe_hours", recipe.count / rate / 3600, "hours of these devices, computed"),
    ]
    figures += [
        Figure("recipe_kwh", each.value * recipe.count / 3.6e6, "kWh of the GPU, computed")
        for each in figures
        if each.metric == "joules"
    ]
    if options.sheet:
        _write_sheet(options.sheet, config, options)
    kinds = ["right", "clean", *(outcome.name for outcome in Outcome if total[outcome.name])]
    rows = [
        {"sizes": f"{step:+d}", "garments": sum(counts[each.name] for each in Outcome)}
        | {kind.lower(): counts[kind] for kind in kinds}
        for step, counts in sorted(by_step.items())
    ]
    return CaseResult(figures, rows)


def _is_right(meta: Mapping[str, Any]) -> bool:
    """Whether the outcome of a garment that did not settle agrees with its size or with a label."""
    outcome, step = meta["drape"]["outcome"], meta["fit"]["step"]
    if outcome == Outcome.CANNOT_BE_PUT_ON.name:
        return True
    labelled = bool(LABELS.get(outcome, set()) & {label["rule"] for label in meta["fit"]["labels"]})
    return labelled or (outcome == "SLID_OFF" and step > 0) or (outcome == "OVERSTRETCHED" and step < 0)


def _write_sheet(path: Path, config: MakeConfig, options: argparse.Namespace) -> None:
    """Each row is a design on one wearer; a wearer near an end of the chart gets the last size more than once."""
    indices = range(0, options.shown * config.wearers, config.wearers)
    columns = [
        produce(options.seed, indices, replace(config, misfit=f"{step}:{step}", picture=TILE), workers=1)
        for step in range(config.steps[0], config.steps[1] + 1)
    ]
    blank = np.full((TILE, TILE, 3), 255, np.uint8)
    pictures = [
        picture_of(sample.front, TILE) if sample.front else blank
        for row in zip(*columns, strict=True)
        for sample in row
    ]
    write_whole(path, jpeg_bytes(contact_sheet(pictures, columns=len(columns))))
