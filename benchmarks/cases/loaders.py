"""Loading garments of 14 500 vertices by index: ours, memory maps, and libraries that store ragged arrays.

All load the same garments from the page cache, in the same random order, in batches of 16 whose arrays are concatenated
and copied once; row numbers index the batch. CPU time is that of all threads, in the median of pairs of epochs, and in
the cheapest one. ``geometry``: panels, faces, uv, panel of each face, vertices. ``points``: 8 192 surface points with
normals, and the pattern as arrays. ``patterns``: the pattern as arrays. ``memmap``: one mapped ``.npy`` file a field,
in 15 lines; ``as ndarray``: the same as a plain array, whose slices cost less; figures are over the faster one.
``webdataset`` reads our tars one after the other. A library that is not installed is left out.

``open``: a data set of 229 376 samples is opened in a new process, filtered by grade, and pickled.
"""

import argparse
import pickle
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.cases.figures import Figure, Measured
from benchmarks.loading.loaders import BATCH, LOADERS
from benchmarks.loading.timing import cpu_ms_of
from benchmarks.loading.workload import CONFIGS, write_large_index, write_shards
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator import MakeConfig
from gcd_dataset.generator.maker import produce
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards import ShardReader, encode_sample

__all__ = ["add_arguments", "run"]

MEMMAPS = ("memmap", "memmap as ndarray")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=192, help="garments; 0.2 MB each, and 1.2 MB for each library")
    parser.add_argument("--seconds", type=float, default=20.0, help="duration for each choice of fields")
    parser.add_argument("--folder", type=Path, help="folder that keeps the garments; by default temporary")
    parser.add_argument("--samples", type=int, default=229_376, help="samples of the large data set")


def run(options: argparse.Namespace) -> Measured:
    """Write shards, then time the loaders. Raises ``ConfigError`` for options out of range."""
    if options.count < BATCH or options.seconds <= 0:
        raise ConfigError(f"give --count of {BATCH} or more, and --seconds of more than 0")
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as own:
        folder = write_shards((options.folder or Path(own)) / "garments", options.count)
        spent = {}
        for config, fields in CONFIGS.items():
            made = {name: load(folder, fields) for name, load in LOADERS.items()}
            loaders = {name: load for name, load in made.items() if load is not None}
            spent[config] = cpu_ms_of(loaders, options.count, BATCH, seconds=options.seconds)
        figures = [*_ratios(spent), *_sizes(folder), *_opening(Path(own) / "large", options.samples)]
    return Measured(figures, _rows(spent))


Spent = dict[str, dict[str, list[float]]]


def _ratios(spent: Spent) -> list[Figure]:
    figures = []
    for config, loaders in spent.items():
        faster = min(MEMMAPS, key=lambda name: float(np.median(loaders[name])))
        figures.append(
            Figure(f"{config}_over_memmap", _over(loaders["ours"], loaders[faster]), "times the CPU time of a memmap")
        )
        figures.append(Figure(f"{config}_cpu_ms", min(loaders["ours"]), "ms a garment"))
        figures += [
            Figure(f"{config}_{name.replace(' ', '_')}", _over(loaders[name], loaders["ours"]), "times our CPU time")
            for name in loaders
            if name not in ("ours", *MEMMAPS)
        ]
    return figures


def _over(one: list[float], other: list[float]) -> float:
    return float(np.median(np.array(one) / np.array(other)))


def _sizes(folder: Path) -> list[Figure]:
    """Bytes of a draped garment to download, its encoding, and the making of its columns."""
    record = ShardReader(folder).record
    begun = time.process_time()
    samples = list(produce(0, range(8), MakeConfig(stage="mesh", picture=0)))
    made, times = time.process_time() - begun, []
    for _ in range(3):
        begun = time.process_time()
        for sample in samples:
            encode_sample(sample)
        times.append(time.process_time() - begun)
    del made
    columns = GarmentDataset(folder, cache_dir=folder / "own_cache")
    begun = time.process_time()
    columns.__getitems__(range(len(columns)))
    return [
        Figure("bytes_per_garment", sum(shard.size for shard in record.shards) / record.count, "bytes to download"),
        Figure("encode_cpu_ms", 1e3 * min(times) / len(samples), "ms a garment"),
        Figure("columns_cpu_ms", 1e3 * (time.process_time() - begun) / len(columns), "ms a garment, all fields"),
    ]


def _opening(folder: Path, samples: int) -> list[Figure]:
    size = write_large_index(folder, samples)
    GarmentDataset(folder, quality="clean", fields=["verts"])
    begun = time.process_time()
    dataset = GarmentDataset(folder, quality="clean", fields=["verts"])
    opened = time.process_time() - begun
    return [
        Figure("open_cpu_s", opened, f"s, {samples} samples filtered by grade"),
        Figure("open_pickled_mb", len(pickle.dumps(dataset)) / 1e6, "MB"),
        Figure("index_bytes", size / samples, "bytes a sample"),
    ]


def _rows(spent: Spent) -> list[dict[str, Any]]:
    return [
        {
            "fields": config,
            "loader": name,
            "CPU-ms a garment": f"{min(times):.4f}",
            "over ours": f"{_over(times, loaders['ours']):.2f}",
        }
        for config, loaders in spent.items()
        for name, times in loaders.items()
    ]
