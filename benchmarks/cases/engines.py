"""A local Ray cluster against plain processes: CPU and wall seconds per garment, and for the start.

    python -m benchmarks.run engines --stage mesh --count 128 --workers 2

Each engine makes shards of a few garments, as its start, then of ``--count``; the start of the local
engine's processes is subtracted from its second run. CPU seconds are those of this process and all its descendants,
including Ray's, read from /proc when the last garment arrives.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.cases.figures import Figure, Measured
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.making.garments import maker_of, work_of
from gcd_dataset.making.ray import ray_cluster
from gcd_dataset.making.run import make_shards
from gcd_dataset.shards.layout import TRAIN

__all__ = ["add_arguments", "run"]

TICKS = os.sysconf("SC_CLK_TCK")
STAGES = ("pattern", "mesh")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=512, help="garments")
    parser.add_argument("--stage", choices=STAGES, default="pattern")
    parser.add_argument("--workers", type=int, default=2, help="processes that make garments")


def run(options: argparse.Namespace) -> Measured:
    """Time both engines."""
    config = MakeConfig(stage=options.stage, picture=0)
    few = 2 * options.workers
    figures, each = [], {}
    for engine in ("local", "ray"):
        begun = _cpu_seconds(), time.perf_counter()
        with _engine(engine, config, options.workers) as make:
            start = _spent(make(few), few, begun)
            whole = _spent(make(options.count), options.count, (_cpu_seconds(), time.perf_counter()))
        if engine == "local":  # the second run started new processes too: subtract their start
            whole = whole[0] - start[0], whole[1] - start[1]
        each[engine] = [seconds / options.count for seconds in whole]
        for name, unit, first, seconds in zip(("cpu", "wall"), ("CPU-s", "s"), start, each[engine], strict=True):
            figures.append(Figure(f"{engine}_{name}", seconds, f"{unit} a garment"))
            figures.append(Figure(f"{engine}_{name}_start", first, unit))
    for number, name in enumerate(("cpu", "wall")):
        figures.append(Figure(f"{name}_ratio", each["ray"][number] / each["local"][number], "of local"))
    return Measured(figures)


def _spent(made: Iterator[Any], count: int, begun: tuple[float, float]) -> tuple[float, float]:
    """CPU and wall seconds from ``begun`` until ``count`` garments have arrived."""
    for _ in range(count):
        next(made)
    return _cpu_seconds() - begun[0], time.perf_counter() - begun[1]


@contextmanager
def _engine(engine: str, config: MakeConfig, workers: int) -> Iterator[Callable[[int], Iterator[Any]]]:
    """For the block, a function that stores a given number of garments with the engine, yielding each."""
    with ExitStack() as opened:
        make = partial(make_shards, maker=maker_of(0, config, workers))
        if engine == "ray":
            os.environ["RAY_ADDRESS"] = "local"
            make = opened.enter_context(ray_cluster(config, workers)).make_shards

        def made(count: int) -> Iterator[Any]:
            folder = Path(opened.enter_context(tempfile.TemporaryDirectory()))
            work = work_of(folder, {TRAIN: range(count)}, 0, config)
            return make(work.place, list(work.tasks()))

        yield made


def _cpu_seconds() -> float:
    """CPU seconds of this process and its living descendants."""
    spent, parents = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # the process has ended
            continue
        parents[path.parent.name], spent[path.parent.name] = fields[1], (int(fields[11]) + int(fields[12])) / TICKS
    ours = {str(os.getpid())}
    while more := {child for child, parent in parents.items() if parent in ours} - ours:
        ours |= more
    return sum(spent[process] for process in ours)
