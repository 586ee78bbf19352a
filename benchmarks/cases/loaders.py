"""Loading garments of 14 500 vertices by index: ours, memory maps, and libraries that store ragged arrays.

All load the same garments from the page cache, in the same random order, in batches of 16 whose arrays are concatenated
and copied once; row numbers index the batch. CPU time is that of all threads, in the median of epochs taken in turns;
ratios are medians over the pairs of epochs. ``geometry``: panels, faces, uv, panel of each face, vertices. ``points``:
8 192 surface points with normals, and the pattern as arrays. ``patterns``: the pattern as arrays. ``memmap``: one
mapped ``.npy`` file a field, in 15 lines; ``as ndarray``: the same as a plain array, whose slices cost less; figures
are over the faster one. ``webdataset`` reads our tars one after the other. A library that is not installed is left out;
``pip install -e '.[bench]'`` installs all of them.

``open``: a data set of 229 376 samples is opened, filtered by grade, and pickled. ``stream_over_random``: a first pass
with ``streaming=True`` over a first pass in random order with an empty cache, which makes the columns. ``wait``: share
of the time that a training on 512 points of each garment, with a network of two layers, waits for the batches that
``GarmentLoader`` reads from the disk; the shorter its steps and its epochs, the larger: nothing is read ahead of an
epoch's first batch.
"""

import argparse
import pickle
import shutil
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.cases import CaseResult, Figure
from benchmarks.loading import BATCH, CONFIGS, installed_loaders, opened, write_large_index, write_shards
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import GarmentDataset, GarmentLoader, collate_packed
from gcd_dataset.shards import ShardReader, encode_sample

MEMMAPS = ("memmap", "memmap as ndarray")
SAMPLES = 229_376  # of the large data set
TIMES = 5  # repetitions of short measurements
WIDTH = 256  # of the network that is trained


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=512, help="synthetic garments; 0.2 MB each, and 1.2 MB a library")
    parser.add_argument("--data", type=Path, help="a folder of draped garments to load instead")
    parser.add_argument("--seconds", type=float, default=20.0, help="duration for each choice of fields")


def run(options: argparse.Namespace) -> CaseResult:
    """Write shards, then time the loaders. Raises ``ConfigError`` for options out of range."""
    if options.count < BATCH or options.seconds <= 0:
        raise ConfigError(f"give --count of {BATCH} or more, and --seconds of more than 0")
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as own:
        folder = Path(own) / "garments"
        if options.data is None:
            write_shards(folder, options.count)
        else:
            shutil.copytree(options.data, folder)
        count, spent = len(ShardReader(folder)), {}
        for config, fields in CONFIGS.items():
            loaders = installed_loaders(folder, fields)
            spent[config] = cpu_ms_of(loaders, count, BATCH, seconds=options.seconds)
        figures = [*_ratios(spent), *_sizes(folder), *_opening(Path(own) / "large", SAMPLES), *_passes(folder)]
    return CaseResult(figures, _rows(spent))


Spent = dict[str, dict[str, list[float]]]


def cpu_ms_of(
    loaders: Mapping[str, Callable[[Sequence[int]], Any]], count: int, batch: int, *, seconds: float
) -> dict[str, list[float]]:
    """CPU time of an item [ms] in each of several epochs of ``count`` items, by loader, all threads included.

    The loaders take turns, in changing order, with the same garments: other programs on the machine slow all of them.
    Before that each loads one epoch: it opens files, and fills the page cache.
    """
    spent: dict[str, list[float]] = {name: [] for name in loaders}
    for load in loaders.values():
        _epoch(load, range(count), batch)
    end, number = time.perf_counter() + seconds, 0
    while not number or time.perf_counter() < end:
        random = np.random.default_rng(number)
        order = random.permutation(count).tolist()
        for name in random.permutation(list(loaders)):
            spent[name].append(1e3 * _spent(lambda: _epoch(loaders[name], order, batch)) / count)  # noqa: B023
        number += 1
    return spent


def _epoch(load: Callable[[Sequence[int]], Any], order: Sequence[int], batch: int) -> None:
    for first in range(0, len(order), batch):
        load(order[first : first + batch])


def _ratios(spent: Spent) -> list[Figure]:
    figures = []
    for config, loaders in spent.items():
        faster = min(MEMMAPS, key=lambda name: float(np.median(loaders[name])))
        figures += [
            Figure(f"{config}_over_memmap", _over(loaders["ours"], loaders[faster]), "times the CPU time of a memmap"),
            Figure(f"{config}_cpu_ms", float(np.median(loaders["ours"])), "ms a garment"),
        ]
    return figures


def _over(one: list[float], other: list[float]) -> float:
    return float(np.median(np.array(one) / np.array(other)))


def _sizes(folder: Path) -> list[Figure]:
    """Bytes of a draped garment to download, its encoding, and the making of its columns."""
    reader = ShardReader(folder)
    samples = [reader.sample(position) for position in range(BATCH)]
    encoding = _least(lambda: [encode_sample(sample) for sample in samples]) / len(samples)

    def make_columns() -> None:
        shutil.rmtree(folder / "cache", ignore_errors=True)
        dataset = GarmentDataset(folder, cache_dir=folder / "cache")
        dataset.__getitems__(range(len(dataset)))

    size = sum(shard.size for shard in reader.record.shards) / reader.record.count
    return [
        Figure("bytes_per_garment", size, "bytes to download, without pictures"),
        Figure("encode_cpu_ms", 1e3 * encoding, "ms a garment"),
        Figure("columns_cpu_ms", 1e3 * _least(make_columns) / len(reader), "ms a garment, all fields"),
    ]


def _opening(folder: Path, samples: int) -> list[Figure]:
    size = write_large_index(folder, samples)

    def opening() -> GarmentDataset:
        return GarmentDataset(folder, quality="clean", fields=["verts"])

    spent = _least(opening)
    tracemalloc.start()
    dataset = opening()
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return [
        Figure("open_cpu_s", spent, f"s, {samples} samples filtered by grade"),
        Figure("open_mb", held / 1e6, "MB of memory"),
        Figure("open_pickled_mb", len(pickle.dumps(dataset)) / 1e6, "MB"),
        Figure("index_bytes", size / samples, "bytes a sample"),
    ]


def _passes(folder: Path) -> list[Figure]:
    """First passes with and without random access, and the wait of a training."""
    fields, ratios = CONFIGS["geometry"], []
    for _ in range(TIMES):
        shutil.rmtree(folder / "cache")
        random = _spent(lambda: _read(GarmentLoader(opened(folder, fields), BATCH)))
        ratios.append(_spent(lambda: _stream(folder, fields)) / random)
    return [
        Figure("stream_over_random", float(np.median(ratios)), "times the CPU time of a first random pass, geometry"),
        *_wait(folder),
    ]


def _stream(folder: Path, fields: Sequence[str]) -> None:
    dataset = GarmentDataset(folder, fields=fields, streaming=True)
    _read(torch.utils.data.DataLoader(dataset, BATCH, collate_fn=collate_packed))


def _wait(folder: Path) -> list[Figure]:
    """Share of the time that a small network waits for batches: the median of several epochs."""
    network = torch.nn.Sequential(torch.nn.Linear(6, WIDTH), torch.nn.ReLU(), torch.nn.Linear(WIDTH, 1))
    loader, epochs = GarmentLoader(opened(folder, ["points"]), BATCH), []
    for _ in range(TIMES):
        waited, begun = 0.0, time.perf_counter()
        batches = iter(loader)
        while True:
            asked = time.perf_counter()
            batch = next(batches, None)
            waited += time.perf_counter() - asked
            if batch is None:
                break
            network(batch["points"][:, ::16]).square().mean().backward()
        spent = time.perf_counter() - begun
        epochs.append((100 * waited / spent, 1e3 * spent / len(loader)))
    share, step = np.median(epochs, axis=0)
    return [
        Figure("wait_percent", float(share), "% of the time of a training on points"),
        Figure("step_ms", float(step), "ms, a step of this training"),
    ]


def _read(batches: Iterable[Any]) -> None:
    for _ in batches:
        pass


def _spent(act: Callable[[], Any]) -> float:
    """CPU time [s], all threads included."""
    begun = time.process_time()
    act()
    return time.process_time() - begun


def _least(act: Callable[[], Any]) -> float:
    """The least CPU time of several calls [s], after one that opens files."""
    act()
    return min(_spent(act) for _ in range(TIMES))


def _rows(spent: Spent) -> list[dict[str, Any]]:
    return [
        {
            "fields": config,
            "loader": name,
            "CPU-ms a garment": f"{np.median(times):.4f}",
            "over ours": f"{_over(times, loaders['ours']):.2f}",
        }
        for config, loaders in spent.items()
        for name, times in loaders.items()
    ]
