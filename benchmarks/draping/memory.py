"""Memory of a draping process: per garment on the GPU, and resident memory over many drapes."""

import os
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path

import warp as wp

from benchmarks.cases.figures import Figure, Measured
from benchmarks.draping.workload import Worn
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import drape_batch, resolve_device

EVERY = 50  # drapes between records; the first interval is the warm-up
MB = 1e6  # bytes


def measure_memory(worn: Sequence[Worn], drapes: int, *, device: str, batch: int) -> Measured:
    """Memory over ``drapes`` drapes in this process, cycling through the garments.

    Raises ``ConfigError`` for fewer drapes than two intervals.
    """
    if drapes < 2 * EVERY:
        raise ConfigError(f"memory over {drapes} drapes: give {2 * EVERY} or more, {EVERY} are the warm-up")
    device = resolve_device(device)
    jobs = cycle([one.job for one in worn])
    rows: list[dict[str, float]] = []
    for first in range(0, drapes // EVERY * EVERY, EVERY):
        for start in range(0, EVERY, batch):
            drape_batch(list(islice(jobs, min(batch, EVERY - start))), device=device, at_once=batch)
        rows.append({"drapes": first + EVERY, "rss_mb": rss_mb(), "gpu_mb": gpu_used_mb(device)})
    warm, last = rows[0], rows[-1]
    return Measured(
        [
            Figure("drapes", last["drapes"], ""),
            Figure("rss_mb", last["rss_mb"], "MB"),
            Figure("rss_growth_mb", last["rss_mb"] - warm["rss_mb"], "MB"),
            Figure("gpu_growth_mb", last["gpu_mb"] - warm["gpu_mb"], "MB"),
        ],
        rows,
    )


def rss_mb() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MB


def gpu_used_mb(device: str) -> float:
    """Memory that Warp currently holds on a GPU [MB]; 0 on a CPU."""
    return wp.get_mempool_used_mem_current(device) / MB if _pooled(device) else 0.0


def gpu_peak_mb(device: str) -> float:
    """Peak memory of Warp on a GPU since the process started [MB]; 0 on a CPU."""
    return wp.get_mempool_used_mem_high(device) / MB if _pooled(device) else 0.0


def _pooled(device: str) -> bool:
    return bool(wp.get_device(device).is_cuda and wp.is_mempool_enabled(device))
