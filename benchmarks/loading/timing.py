"""CPU time of batches in a random order."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

__all__ = ["cpu_ms_of"]


def cpu_ms_of(
    loaders: Mapping[str, Callable[[Sequence[int]], Any]], count: int, batch: int, *, seconds: float
) -> dict[str, list[float]]:
    """CPU time of an item [ms] in each of several epochs of ``count`` items, by loader, all threads included.

    The loaders take turns with the same order, so that other programs on the machine slow all of them. Before that each
    loads one epoch: it opens files, and fills the page cache.
    """
    spent: dict[str, list[float]] = {name: [] for name in loaders}
    for load in loaders.values():
        _epoch(load, range(count), batch)
    end, number = time.perf_counter() + seconds, 0
    while not number or time.perf_counter() < end:
        order = np.random.default_rng(number).permutation(count).tolist()
        for name, load in loaders.items():
            before = time.process_time()
            _epoch(load, order, batch)
            spent[name].append(1e3 * (time.process_time() - before) / count)
        number += 1
    return spent


def _epoch(load: Callable[[Sequence[int]], Any], order: Sequence[int], batch: int) -> None:
    for first in range(0, len(order), batch):
        load(order[first : first + batch])
