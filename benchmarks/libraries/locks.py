"""Lock files: our ``shards.access.locked`` beside ``filelock``."""

import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from filelock import FileLock

from gcd_dataset.shards.access import locked

ROUNDS = 5
USES = 1000
TURNS = 100
HELD = 0.002  # s for which a process holds the lock in its turn
FORK = multiprocessing.get_context("fork")

Lock = Callable[[Path], AbstractContextManager[Any]]
LOCKS: Mapping[str, Lock] = {
    "shards.access": lambda path: locked(path, "measuring", wait=True),
    "filelock": lambda path: FileLock(path),
}


class LockCost(NamedTuple):
    """The figures of one kind of lock."""

    alone: float
    """CPU time to acquire and release the lock without contention [µs]."""
    wait: float
    """The longest wait while two processes take turns, each holding it for 2 ms [ms]."""
    freed: float
    """From the kill (SIGKILL) of the holder to the acquisition by a waiter [ms]."""
    left: float
    """Files left behind in the folder."""


def lock_cost(lock: Lock) -> LockCost:
    """The median figures of several rounds."""
    return LockCost(*np.median([_round(lock) for _ in range(ROUNDS)], axis=0))


def _round(lock: Lock) -> LockCost:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ".lock"
        return LockCost(
            _alone(lock, path), _wait_in_turns(lock, path), _freed(lock, path), len(list(Path(folder).iterdir()))
        )


def _alone(lock: Lock, path: Path) -> float:
    begun = time.process_time()
    for _ in range(USES):
        with lock(path):
            pass
    return 1e6 * (time.process_time() - begun) / USES


def _wait_in_turns(lock: Lock, path: Path) -> float:
    with FORK.Pool(2) as pool:
        waits = pool.starmap(_take_turns, 2 * [(lock_name(lock), path)])
    return 1e3 * max(map(max, waits))


def lock_name(lock: Lock) -> str:
    """The name of a kind of lock."""
    return next(name for name, known in LOCKS.items() if known is lock)


def _take_turns(name: str, path: Path) -> list[float]:
    waits = []
    for _ in range(TURNS):
        asked = time.monotonic()
        with LOCKS[name](path):
            waits.append(time.monotonic() - asked)
            time.sleep(HELD)
        time.sleep(HELD / 4)
    return waits


def _freed(lock: Lock, path: Path) -> float:
    ours, theirs = FORK.Pipe()
    holder = FORK.Process(target=_hold, args=(lock_name(lock), path, theirs))
    holder.start()
    ours.recv()
    waiter = FORK.Process(target=_wait, args=(lock_name(lock), path, theirs))
    waiter.start()
    time.sleep(0.3)
    assert holder.pid is not None
    begun = time.monotonic()
    os.kill(holder.pid, signal.SIGKILL)
    freed: float = ours.recv()
    for process in (holder, waiter):
        process.join()
    return 1e3 * (freed - begun)


def _hold(name: str, path: Path, pipe: Connection) -> None:
    with LOCKS[name](path):
        pipe.send(0.0)
        time.sleep(60)


def _wait(name: str, path: Path, pipe: Connection) -> None:
    with LOCKS[name](path):
        pipe.send(time.monotonic())
