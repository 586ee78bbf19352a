"""Garments as they were made and read at one time, apart from any storage format: arrays in ``.npz``, texts in JSON.

``tests/test_recorded.py`` makes them again and compares. After a change of the garments that is meant,
``python -m tests.data.record`` records them again.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gcd_dataset import generate_recipe
from gcd_dataset.generator import make
from gcd_dataset.generator.recipes import read_recipe
from gcd_dataset.loaders import GarmentDataset, GeneratedGarments
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.tensors import encode_pattern

RECORDED = Path(__file__).resolve().parent / "recorded"
PICTURES = {"picture": 32, "views": 1, "view_size": 32}
STAGES: Mapping[str, tuple[int, Sequence[int], Mapping[str, Any]]] = {
    "pattern": (3, range(8), {"stage": "pattern", "bodies": "both", "captions": True}),
    "mesh": (4, range(8), {"stage": "mesh", "resolution": 6.0, "points": 256}),
    "drape": (7, (10, 14), {"bodies": "neutral", "resolution": 6.0, "points": 256, **PICTURES}),
}
"""Stage to seed, indices and options of its garments.

The drapes are a fitted top and a pencil skirt: rounding errors of float32 at the start move their vertices by less than
0.01 cm on average, those of wide garments by centimetres, since a fold may fall to either side.
"""
FORMAT = ("schema", "versions", "recipe_sha256", "crc32", "points")  # of meta: facts of the files, not of the garment
NOISY = ("strain", "grade")  # of meta: differ between machines, as the folds of a drape do
RECIPE = """
name = "small"
about = "23 patterns in three splits"
designs = 23
seed = 5
[options]
stage = "pattern"
[splits]
test = 0.2
validation = 0.2
train = 0.6
"""


def garments(stage: str, cache_dir: Path | None = None) -> GeneratedGarments:
    """The garments of a stage, in the stored types."""
    seed, indices, options = STAGES[stage]
    common: Mapping[str, Any] = {"device": "cpu", "on_fail": "keep", "dtype": None, "cache_dir": cache_dir}
    return GeneratedGarments(max(indices) + 1, seed, **common, **options)


def plain(item: Mapping[str, Any]) -> dict[str, Any]:
    """An item with NumPy arrays, and without facts of its files and figures that vary."""
    item = {name: value.numpy() if isinstance(value, torch.Tensor) else value for name, value in item.items()}
    meta = {name: value for name, value in item["meta"].items() if name not in FORMAT + NOISY}
    return item | {"meta": meta | {"drape": meta["drape"] and meta["drape"]["outcome"]}}


def read(stage: str) -> dict[int, dict[str, Any]]:
    """Index to recorded item."""
    items = {int(index): item for index, item in json.loads((RECORDED / f"{stage}.json").read_text()).items()}
    with np.load(RECORDED / f"{stage}.npz") as arrays:
        for name in arrays:
            index, _, field = name.partition(".")
            items[int(index)][field] = arrays[name]
    return items


def write(stage: str) -> None:
    """Record the garments of a stage."""
    ds, texts = garments(stage), {}
    arrays: dict[str, Any] = {}
    for index in STAGES[stage][1]:
        item, sample = plain(ds[index]), make(STAGES[stage][0], index, ds.config)
        if sample.points is not None:
            item["points"] = sample.points.astype(np.float32)  # as sampled: any storage rounds them its own way
        arrays |= {f"{index}.{field}": value for field, value in item.items() if isinstance(value, np.ndarray)}
        texts[index] = {field: value for field, value in item.items() if not isinstance(value, np.ndarray)}
    np.savez_compressed(RECORDED / f"{stage}.npz", **arrays)
    write_json(stage, texts)


def write_json(name: str, entries: Mapping[Any, Any]) -> None:
    """Record entries, one a line."""
    lines = [f'"{key}": {json.dumps(value)}' for key, value in entries.items()]
    (RECORDED / f"{name}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")


def make_recipe(folder: Path) -> tuple[dict[str, list[int]], PatternHash]:
    """The indices in each split of the data set of ``RECIPE``, and the hash of its patterns, read from its files."""
    (folder / "small.toml").write_text(RECIPE)
    recipe = read_recipe(folder / "small.toml")
    generate_recipe(folder / "small", recipe, workers=0)
    stored = {split: GarmentDataset(folder / "small", split) for split in recipe.splits}
    samples = {split: [ds.sample(position) for position in range(len(ds))] for split, ds in stored.items()}
    splits = {split: [sample.provenance.index for sample in made] for split, made in samples.items()}
    every = (sample for made in samples.values() for sample in made)
    return splits, PatternHash.of((sample.provenance.index, encode_pattern(sample.pattern)) for sample in every)


def main() -> None:
    """Record garments and recipe."""
    RECORDED.mkdir(exist_ok=True)
    for stage in STAGES:
        write(stage)
    with tempfile.TemporaryDirectory() as folder:
        splits, patterns = make_recipe(Path(folder))
    write_json("recipe", {**splits, "patterns": patterns.text})


if __name__ == "__main__":
    main()
