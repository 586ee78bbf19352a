"""Garments cut for another size than the wearer's: outcomes by the number of sizes, and the rate of making them.

    python -m benchmarks.run fits --count 5000 --device cuda:0 --workers 15 --sheet fits.jpg

The garments are those of the recipe ``fits``, with pictures, maps and ease, written to a temporary folder.
``right``: the share that settled, or whose outcome says how it does not fit: slid off or cannot be put on, being cut
too large or labelled so; overstretched or cannot be put on, being cut too small or labelled so. ``clean``: the share of
those put on that settled without a crossing edge of any kind. ``recipe_hours`` and ``recipe_kwh`` are of the
whole recipe at this rate, computed. ``--sheet``: designs on one wearer each, cut for three sizes less to three more.
"""

import argparse
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import CaseResult, Figure, jpeg_file
from benchmarks.cases.scale import written
from gcd_dataset.errors import PatternError
from gcd_dataset.files import write_whole
from gcd_dataset.generator import build_pattern
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.fitting import Fitting, drape_patterns
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.recipes import find_recipe
from gcd_dataset.generator.render import render_garment
from gcd_dataset.generator.sized import lifted
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
    recipe = find_recipe("fits")
    config = replace(recipe.config, device=options.device, resolution=options.resolution, fabric=options.fabric)
    by_step: defaultdict[int, Counter[str]] = defaultdict(Counter)

    def note(meta: dict[str, Any]) -> None:
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
    """Each row is a design on one wearer; those that cannot be cut in all sizes are left out."""
    shown = (row for number in count() if (row := _in_all_sizes(options.seed, number, config)))
    pictures = [picture for row in islice(shown, options.shown) for picture in row]
    write_whole(path, jpeg_bytes(contact_sheet(pictures, columns=len(pictures) // options.shown)))


def _in_all_sizes(seed: int, number: int, config: MakeConfig) -> list[np.ndarray]:
    """Pictures of a design on its first wearer, cut for each size of ``config.misfit``; none if one cannot be cut."""
    made = prepare(seed, number, config)
    first, chart, (least, most) = made.dressed[0], config.chart, config.steps
    assert chart is not None
    assert first.fit is not None
    sizes, own = list(chart.bodies), first.fit.wearer_size
    place = sizes.index(own)
    if place + least < 0 or place + most >= len(sizes):
        return []
    cut_for = [chart.body(size) for size in sizes[place + least : place + most + 1]]
    try:
        patterns = [
            lifted(build_pattern(size, made.design), made.design, cut_for=size, wearer=first.size) for size in cut_for
        ]
    except PatternError:
        return []
    draped = drape_patterns(
        patterns, lambda _: (first.body, first.size), resolution=config.resolution, device=config.device
    )
    blank = np.full((TILE, TILE, 3), 255, np.uint8)
    return [
        render_garment(one.drape.vertices, one.box_mesh, one.body, size=TILE, device=config.device)[0]
        if isinstance(one, Fitting)
        else blank
        for one in draped
    ]
