"""Trials of a cache: cost of a hit and of a miss, several processes, a size limit, killed processes."""

import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.libraries.caches import COLUMNS, SAMPLES, SHARDS, MemberCache, Server, disk_use, expected

__all__ = ["Cost", "Killed", "Shared", "cost", "killed", "limited", "shared"]

Make = Callable[..., MemberCache]
EPOCHS = 2
READERS = 2
KILLS = 8
FORK = multiprocessing.get_context("fork")


class Cost(NamedTuple):
    """Figures of one process without a size limit."""

    hit: float
    """CPU time to read a cached member [µs]."""
    miss: float
    """CPU time to read a member that is fetched from a local folder [µs]."""
    sent: float
    """Ratio of bytes fetched to bytes requested."""


class Shared(NamedTuple):
    """Figures of two processes that fill one cache, each in its own order."""

    wrong: int
    """Samples that differ from the server's, or raise an error."""
    again: float
    """Ratio of bytes that a third process then fetches to the bytes that it requests."""


class Killed(NamedTuple):
    """Figures of readers of one limited cache, killed eight times (SIGKILL)."""

    wrong: int
    """Samples that differ from the server's, or raise an error."""
    left: float
    """Ratio of bytes on disk at the end to the limit."""


def _order(seed: int) -> list[tuple[int, int]]:
    """Shard and sample numbers of an epoch, in an order given by the seed."""
    chosen = [(shard, sample) for shard in range(SHARDS) for sample in range(SAMPLES)]
    return [chosen[i] for i in np.random.default_rng(seed).permutation(len(chosen))]


def _asked(served: Path) -> int:
    """Bytes requested in an epoch."""
    return SHARDS * SAMPLES * sum(map(len, expected(served, 0, 0)))


def cost(make: Make, served: Path) -> Cost:
    """Time one epoch of misses, then several epochs of hits."""
    reads = SHARDS * SAMPLES * len(COLUMNS)
    with tempfile.TemporaryDirectory() as folder:
        server = Server(served)
        miss = _seconds(make(Path(folder), server), epochs=1) / reads
        sent = server.sent
        hit = _seconds(make(Path(folder), server), epochs=EPOCHS) / reads / EPOCHS
    return Cost(1e6 * hit, 1e6 * miss, sent / _asked(served))


def _seconds(cache: MemberCache, epochs: int) -> float:
    begun = time.process_time()
    for epoch in range(epochs):
        for shard, sample in _order(epoch):
            cache.read(shard, sample)
    return time.process_time() - begun


def _wrong(cache: MemberCache, order: list[tuple[int, int]]) -> int:
    """Number of samples read from the cache that differ from the server's, or raise an error."""
    wrong = 0
    for shard, sample in order:
        try:
            found = [bytes(content) for content in cache.read(shard, sample)]
        except Exception:  # noqa: BLE001 -- counts errors of any library
            wrong += 1
            continue
        wrong += found != expected(cache.server.folder, shard, sample)
    return wrong


def shared(make: Make, served: Path) -> Shared:
    """Fill a cache by two processes, then read it by a third."""
    with tempfile.TemporaryDirectory() as folder:
        with FORK.Pool(READERS) as pool:
            wrong = sum(pool.starmap(_read_all, [(make, folder, served, seed) for seed in range(READERS)]))
        server = Server(served)
        wrong += _wrong(make(Path(folder), server), _order(READERS))
        return Shared(wrong, server.sent / _asked(served))


def _read_all(make: Make, folder: str, served: Path, seed: int) -> int:
    return _wrong(make(Path(folder), Server(served)), _order(seed))


def limited(make: Make, served: Path) -> float:
    """Ratio of the most bytes on disk to the limit, in two epochs; the limit is a quarter of an epoch's bytes."""
    limit, peak = _asked(served) // 4, 0
    with tempfile.TemporaryDirectory() as folder:
        cache = make(Path(folder), Server(served), limit)
        for number, (shard, sample) in enumerate(_order(0) + _order(1)):
            cache.read(shard, sample)
            if number % 8 == 0:
                peak = max(peak, disk_use(Path(folder)))
    return peak / limit


def killed(make: Make, served: Path) -> Killed:
    """Kill readers of a limited cache at different moments, then read all samples."""
    limit = _asked(served) // 4
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(KILLS):
            reader = FORK.Process(target=_read_on, args=(make, folder, served, limit, seed))
            reader.start()
            assert reader.pid is not None
            time.sleep(0.15 + 0.013 * seed)
            os.kill(reader.pid, signal.SIGKILL)
            reader.join()
        wrong = _wrong(make(Path(folder), Server(served), limit), _order(KILLS))
        return Killed(wrong, disk_use(Path(folder)) / limit)


def _read_on(make: Make, folder: str, served: Path, limit: int, seed: int) -> None:
    cache = make(Path(folder), Server(served), limit)
    while True:
        for shard, sample in _order(seed):
            cache.read(shard, sample)
