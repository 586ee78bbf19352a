"""CPU time of a process and its workers."""

import multiprocessing
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["Cost", "cost_of"]


class Cost(NamedTuple):
    """Time per item."""

    cpu_ms: float
    wall_ms: float


def cost_of(batches: Iterable[Any], count: int, *, seconds: float) -> Cost:
    """The cheapest epoch of ``count`` items within about ``seconds``, after one warm-up epoch.

    Other programs on the machine slow some epochs; the cheapest epoch is disturbed least.
    """
    for _ in batches:  # warm-up: starts workers, checks hashes, fills the page cache
        pass
    costs: list[Cost] = []
    end = time.perf_counter() + seconds
    while not costs or time.perf_counter() < end:
        before, begun = _cpu_seconds(), time.perf_counter()
        for _ in batches:
            pass
        wall, after = time.perf_counter() - begun, _cpu_seconds()
        cpu = sum(spent - before.get(process, 0.0) for process, spent in after.items())
        costs.append(Cost(1e3 * cpu / count, 1e3 * wall / count))
    return min(costs)


def _cpu_seconds() -> dict[int, float]:
    """Process number to CPU time [s], all threads included: 0 for this process, and each living child."""
    spent = {0: time.process_time()}
    for child in multiprocessing.active_children():
        threads = Path(f"/proc/{child.pid}/task").iterdir()
        spent[child.pid or -1] = sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads) / 1e9
    return spent
