"""Outfits of two and of three garments: clean and in order, and the time of one beside a single garment's.

    python -m benchmarks.run outfits --count 1000 --device cuda:0 --workers 15

``--count`` single garments, as many outfits of two garments and as many of three, each on its own random body, are
written to a temporary folder; none is drawn again because of its drape. ``two_clean`` and ``three_clean``: the share
with grade ``clean``: all garments settled, no crossing of any kind, wrong order at most 0.5 % of each pair.
``two_time`` and ``three_time``: the time of an outfit over that of a single garment, each from the first quarter of the
samples finished to the last, when the GPU is full: on a GPU, give ``--count 500`` or more.
"""

import argparse
from collections import Counter
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.cases import CaseResult, Figure
from benchmarks.cases.scale import written
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.recipes import find_recipe

SIZES = {1: "single", 2: "two", 3: "three"}
KIND = "[[outfits]]"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=24, help="garments, outfits of two, and outfits of three")
    parser.add_argument("--seed", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2, help="processes that make garments")
    parser.add_argument("--device", default="auto", help="where cloth is draped")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")


def run(options: argparse.Namespace) -> CaseResult:
    """Make single garments, outfits of two, and outfits of three."""
    if options.count < 2:
        raise ConfigError(f"--count is {options.count}: give 2 or more")
    config = replace(
        find_recipe("outfits").config, device=options.device, resolution=options.resolution, on_fail="keep", picture=0
    )
    figures, rows, rates = [], list[dict[str, Any]](), dict[int, float]()
    with TemporaryDirectory() as folder:
        for size, name in SIZES.items():
            counts = Counter[str]()

            def note(meta: dict[str, Any], counts: Counter[str] = counts) -> None:
                counts[meta["grade"]] += 1
                if meta["grade"] != "clean":
                    rows.append({"garments": size, "index": meta["index"], "fault": _fault(meta)})  # noqa: B023

            worn, ends = _of_size(config, size, Path(folder)), max(options.count // 4, 1)
            rates[size] = written(worn, options, note, ends=ends)[0].value
            figures += [
                Figure(f"{name}_per_s", rates[size], "samples"),
                Figure(f"{name}_clean", counts["clean"] / options.count, "share"),
            ]
    figures += [Figure(f"{SIZES[size]}_time", rates[1] / rates[size], "times a single garment's") for size in (2, 3)]
    return CaseResult(figures, rows)


def _of_size(config: MakeConfig, size: int, folder: Path) -> MakeConfig:
    """The configuration with the outfits of ``size`` garments alone."""
    if size == 1:
        return replace(config, outfits="")
    text = (files("gcd_dataset.generator") / "data" / f"outfits_{config.outfits}.toml").read_text("utf-8")
    designs, *kinds = text.split(KIND)
    path = folder / f"{SIZES[size]}.toml"
    path.write_text(designs + "".join(KIND + kind for kind in kinds if kind.count("design =") == size), "utf-8")
    return replace(config, outfits=str(path))


def _fault(meta: dict[str, Any]) -> str:
    """The first reason why a sample is not clean, from the skin outwards."""
    for number, one in enumerate(meta.get("outfit") or [meta]):
        drape = one["drape"]
        crossings = {name: drape[name] for name in ("self_crossings", "body_crossings", "body_through") if drape[name]}
        if drape["outcome"] != "SETTLED" or crossings:
            return f"garment {number}: {drape['outcome']} {crossings or ''}".rstrip()
    for layer in meta.get("layers", ()):
        if layer["crossings"] or layer["wrong_order"]:
            return f"{layer['outer']} over {layer['inner']}: {layer['crossings']} crossings, {layer['wrong_order']:.3f}"
    return "strain"
