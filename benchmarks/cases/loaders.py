"""Loading garments of 14 500 vertices: ``GarmentLoader``, other loaders, and a lower bound.

All load the same synthetic garments from the page cache, in batches of 16 collated by ``collate_packed``; CPU time is
that of all threads and workers in the cheapest of several epochs. ``webdataset`` reads the shards sequentially;
``litdata`` and ``hdf5`` read copies that hold the loaded tensors, in random order, as ours does. ``geometry``: panels,
faces, uv, panel of each face, vertices. ``points``: 8 192 surface points with normals, and the pattern as arrays.
``patterns``: the pattern as arrays, design and measures (``hdf5``: the arrays only). ``floor``, the lower bound, reads
the stored bytes and copies them once. A loader that is not installed is left out.
"""

import argparse
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from benchmarks.cases.figures import Figure, Measured
from benchmarks.loading.loaders import LOADERS
from benchmarks.loading.timing import Cost, cost_of
from benchmarks.loading.workload import CONFIGS, write_shards
from gcd_dataset.errors import ConfigError

__all__ = ["add_arguments", "run"]

WORKERS = (0, 1, 2)
ROUNDS = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=192, help="garments; 1.1 MB each, and again for each other loader")
    parser.add_argument(
        "--seconds", type=float, default=1.5, help="duration for each loader, fields and number of workers"
    )
    parser.add_argument("--folder", type=Path, help="folder that keeps the garments; by default temporary")


def run(options: argparse.Namespace) -> Measured:
    """Write shards, then time the loaders. Raises ``ConfigError`` for options out of range."""
    if options.count < 16 or options.seconds <= 0:
        raise ConfigError("give --count of 16 or more, and --seconds of more than 0")
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as own:
        folder = write_shards(options.folder or Path(own), options.count)
        costs = {
            (loader, config, workers): cost
            for config in CONFIGS
            for workers in WORKERS
            for loader, cost in _costs(folder, config, workers, options).items()
        }
    return Measured(_figures(costs), _rows(costs))


Costs = Mapping[tuple[str, str, int], Cost]


def _costs(folder: Path, config: str, workers: int, options: argparse.Namespace) -> dict[str, Cost]:
    """The cheapest epoch of each loader; loaders alternate, so that other load on the machine affects all."""
    costs: dict[str, Cost] = {}
    for _ in range(ROUNDS):
        for loader, load in LOADERS.items():
            batches = load(folder, CONFIGS[config], workers)
            if batches is not None:
                cost = cost_of(batches, options.count, seconds=options.seconds / ROUNDS)
                costs[loader] = min(cost, costs.get(loader, cost))
    return costs


def _figures(costs: Costs) -> list[Figure]:
    def cpu(loader: str, config: str = "geometry") -> float:
        cost = costs.get((loader, config, 0))
        return math.nan if cost is None else cost.cpu_ms

    ratios = [
        Figure("geometry_over_floor", cpu("ours") / cpu("floor"), "times its CPU time"),
        Figure("webdataset_over_ours", cpu("webdataset") / cpu("ours"), "times our CPU time, geometry"),
        Figure("litdata_over_ours", cpu("litdata") / cpu("ours"), "times our CPU time, geometry"),
        Figure("hdf5_over_ours", cpu("hdf5") / cpu("ours"), "times our CPU time, geometry"),
    ]
    absolute = [Figure(f"{config}_cpu_ms", cpu("ours", config), "ms a garment") for config in CONFIGS]
    rates = [Figure(f"{config}_per_second", 1e3 / cpu("ours", config), "garments a core") for config in CONFIGS]
    floors = [Figure("floor_cpu_ms", cpu("floor"), "ms a garment, geometry")]
    return [figure for figure in [*ratios, *absolute, *floors, *rates] if not math.isnan(figure.value)]


def _rows(costs: Costs) -> list[dict[str, Any]]:
    """A row per loader and fields: CPU time and garments per second by number of workers."""
    rows = []
    for config in CONFIGS:
        for loader in LOADERS:
            found = {workers: costs.get((loader, config, workers)) for workers in WORKERS}
            if found[0] is None:
                continue
            row: dict[str, Any] = {"fields": config, "loader": loader}
            row |= {f"CPU-ms, {n} workers": f"{cost.cpu_ms:.3f}" if cost else "" for n, cost in found.items()}
            row |= {
                f"garments/s, {n} workers": f"{1e3 / cost.wall_ms:.0f}" if cost else "" for n, cost in found.items()
            }
            rows.append(row)
    return rows
