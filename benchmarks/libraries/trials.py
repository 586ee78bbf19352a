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
    """One process, no limit."""

    hit: float
    """CPU time of a member that is in the cache [µs]."""
    miss: float
    """CPU time of a member that is fetched from a local folder [µs]."""
    sent: float
    """Bytes fetched, over those asked for."""


class Shared(NamedTuple):
    """Two processes that fill one cache, each in its own order."""

    wrong: int
    """Samples that came back with other bytes, or with an error."""
    again: float
    """Bytes fetched again by a third process afterwards, over those asked for."""


class Killed(NamedTuple):
    """Readers that are killed (SIGKILL) eight times in one limited cache."""

    wrong: int
    """Samples that came back with other bytes, or with an error."""
    left: float
    """Bytes on disk at the end, over the limit."""


def _order(seed: int) -> list[tuple[int, int]]:
    """All samples once."""
    chosen = [(shard, sample) for shard in range(SHARDS) for sample in range(SAMPLES)]
    return [chosen[i] for i in np.random.default_rng(seed).permutation(len(chosen))]


def _asked(served: Path) -> int:
    """Bytes of an epoch."""
    return SHARDS * SAMPLES * sum(map(len, expected(served, 0, 0)))


def cost(make: Make, served: Path) -> Cost:
    """An epoch of misses, then epochs of hits."""
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
    """How many samples come back with other bytes than the server's, or with an error."""
    wrong = 0
    for shard, sample in order:
        try:
            found = [bytes(content) for content in cache.read(shard, sample)]
        except Exception:  # noqa: BLE001 -- a library's error is what is counted
            wrong += 1
            continue
        wrong += found != expected(cache.server.folder, shard, sample)
    return wrong


def shared(make: Make, served: Path) -> Shared:
    """Two processes fill a cache, a third reads it."""
    with tempfile.TemporaryDirectory() as folder:
        with FORK.Pool(READERS) as pool:
            wrong = sum(pool.starmap(_read_all, [(make, folder, served, seed) for seed in range(READERS)]))
        server = Server(served)
        wrong += _wrong(make(Path(folder), server), _order(READERS))
        return Shared(wrong, server.sent / _asked(served))


def _read_all(make: Make, folder: str, served: Path, seed: int) -> int:
    return _wrong(make(Path(folder), Server(served)), _order(seed))


def limited(make: Make, served: Path) -> float:
    """Most bytes on disk, over the limit, in two epochs through a cache that may hold a quarter of one."""
    limit, peak = _asked(served) // 4, 0
    with tempfile.TemporaryDirectory() as folder:
        cache = make(Path(folder), Server(served), limit)
        for number, (shard, sample) in enumerate(_order(0) + _order(1)):
            cache.read(shard, sample)
            if number % 8 == 0:
                peak = max(peak, disk_use(Path(folder)))
    return peak / limit


def killed(make: Make, served: Path) -> Killed:
    """Readers of a limited cache are killed at different moments; then all of it is read."""
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
