"""A model of large data sets: cost, bottleneck, and a simulation of many machines that fail.

    python -m benchmarks.run fleet --machines 1000 --garments 10000000 --parts 2560 25600

No garment is made: stage times are those measured by ``benchmarks.run scale``. ``gpu_hours``, ``tb`` and the prices
``*_usd`` are for machines that do not fail; ``hours`` is the simulated time with the fastest part size, ``best_part``.
"""

import argparse
import math
from collections.abc import Mapping
from typing import Any

from benchmarks.cases.figures import Figure, Measured
from benchmarks.fleet import Fleet, Machine, ObjectStore, as_row, bill, expected_seconds, limits, simulate
from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.writer import LARGEST as SHARD_SIZE

__all__ = ["add_arguments", "run"]

PARTS = (10, 40, 100, 400, 1_000, 4_000)  # part sizes that are simulated by default [shards]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--machines", type=int, default=1000, help="GPUs, each with its cores")
    parser.add_argument("--garments", type=int, default=10_000_000)
    parser.add_argument("--rate", type=float, default=Machine.rate, help="garments per second of one GPU")
    parser.add_argument("--bytes", type=float, default=963e3, help="bytes per garment")
    parser.add_argument("--gpu-usd", type=float, default=3.5, help="price of a GPU and its cores per hour")
    parser.add_argument(
        "--parts",
        type=int,
        nargs="+",
        default=[SHARD_SIZE * n for n in PARTS],
        help="part sizes to try [garments]",
    )
    parser.add_argument(
        "--begin", type=float, default=Fleet.begin, help="time from a part's start to its first garment [s]"
    )
    parser.add_argument("--failing", type=float, default=24.0, help="hours of work between failures; inf for none")
    parser.add_argument("--again", type=float, default=Fleet.again, help="time from a failure to the next garment [s]")
    parser.add_argument("--slow-share", type=float, default=0.02, help="share of machines that run at half the rate")
    parser.add_argument("--seed", type=int, default=0)


def run(options: argparse.Namespace) -> Measured:
    """Compute the cost, then simulate each part size; a failure loses unfinished shards, or unfinished parts."""
    if min(options.garments, options.machines, *options.parts) < 1 or min(options.rate, options.bytes) <= 0:
        raise ConfigError("give 1 or more machines, garments and garments per part, and a rate and bytes above 0")
    machine, store = Machine(rate=options.rate), ObjectStore()
    rates = limits(machine, store, gpus=options.machines, size=options.bytes)
    cost = bill(
        machine, store, garments=options.garments, gpus=options.machines, size=options.bytes, gpu_usd=options.gpu_usd
    )
    rows = [_row(options, part, kept) for part in options.parts for kept in (SHARD_SIZE, part)]
    best = min((row for row in rows if row["kept"] == "shards"), key=lambda row: float(row["hours"]))
    figures = [
        Figure("gpu_hours", cost.gpu_hours, "GPU-h without failures"),
        Figure("cpu_hours", cost.cpu_hours, "core-h at work"),
        Figure("tb", cost.size / 1e12, "TB"),
        Figure("shards", cost.shards, "objects"),
        Figure("requests", cost.requests, "that write"),
        Figure("index", cost.index / 1e9, "GB"),
        Figure("compute_usd", cost.compute_usd, "USD"),
        Figure("store_usd", cost.store_usd, "USD, requests and a month"),
        *(
            Figure(f"limit_{name.replace(' ', '_').replace(',', '')}", rate, "garments/s")
            for name, rate in rates.items()
        ),
        Figure("best_part", best["part"], "garments"),
        Figure("hours", best["hours"], "with failures"),
        Figure("efficiency", best["of the ideal rate"], "of the ideal rate"),
    ]
    return Measured(figures, rows)


def _row(options: argparse.Namespace, part: int, kept: int) -> Mapping[str, Any]:
    fleet = Fleet(
        machines=options.machines,
        rate=options.rate,
        begin=options.begin,
        failing=options.failing * 3600 if math.isfinite(options.failing) else math.inf,
        again=options.again,
        kept=kept,
        slow_share=options.slow_share,
    )
    done = simulate(fleet, options.garments, part, seed=options.seed)
    expected = expected_seconds(fleet, part) / 60
    name = "shards" if kept == SHARD_SIZE else "the part"
    return {"part": part, "kept": name, "minutes a part": expected, **as_row(done)}
