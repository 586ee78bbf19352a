"""Accounts of waiting: the share of time for which each stage of generation is idle.

Every process keeps one account. Its stages add their waits with ``record_wait``; ``take_waits`` reads the account and
empties it. Worker processes send their accounts along with their results, and the receiver adds them up.
"""

import threading
import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack
from typing import NamedTuple, TypeVar

MAKERS = "makers"
"""Worker processes that make samples: they wait while the writer's queue is full."""
WRITER = "writer"
"""The process that writes samples: it waits for the next one. Without workers this includes making the sample."""

Item = TypeVar("Item")


class Wait(NamedTuple):
    """Idle time and total time of one stage, or their sums over several laps or processes."""

    idle: float
    """Seconds spent waiting."""
    over: float
    """Total seconds: waiting and working."""


Waits = Mapping[str, Wait]
"""Name of a stage to its times: ``makers``, ``writer``, or a device for its draping processes."""


def sum_waits(*waits: Waits) -> dict[str, Wait]:
    """The sum by name.

    >>> sum_waits({"writer": Wait(1.0, 4.0)}, {"writer": Wait(2.0, 4.0), "cuda:0": Wait(0.5, 5.0)})
    {'writer': Wait(idle=3.0, over=8.0), 'cuda:0': Wait(idle=0.5, over=5.0)}
    """
    total: dict[str, Wait] = {}
    for account in waits:
        for name, wait in account.items():
            before = total.get(name, Wait(0.0, 0.0))
            total[name] = Wait(before.idle + wait.idle, before.over + wait.over)
    return total


def wait_shares(waits: Waits) -> dict[str, float]:
    """Idle share of the time, in [0, 1], by name.

    >>> wait_shares({"writer": Wait(3.0, 8.0)})
    {'writer': 0.375}
    """
    return {name: min(wait.idle / wait.over, 1.0) for name, wait in sorted(waits.items()) if wait.over > 0}


class WaitClock:
    """Stopwatch for one stage: total time and idle time. Not thread-safe."""

    def __init__(self) -> None:
        self._since, self._idle = time.perf_counter(), 0.0

    def add_idle(self, seconds: float) -> None:
        """Count a wait that has just ended."""
        self._idle += seconds

    def lap(self) -> Wait:
        """Times since the previous lap, or since the clock was made."""
        now, idle = time.perf_counter(), self._idle
        wait = Wait(idle, now - self._since)
        self._since, self._idle = now, 0.0
        return wait


_account: dict[str, Wait] = {}
_account_lock = threading.Lock()


def record_wait(name: str, wait: Wait) -> None:
    """Add to this process's account."""
    with _account_lock:
        _account.update(sum_waits({name: _account.get(name, Wait(0.0, 0.0))}, {name: wait}))


def take_waits() -> dict[str, Wait]:
    """Read and empty this process's account."""
    with _account_lock:
        account = dict(_account)
        _account.clear()
        return account


def timed(items: Iterable[Item], name: str) -> Iterator[Item]:
    """The same items, recording under ``name`` the time spent in ``next`` as idle and the time between as busy.

    If ``items`` is a generator, it is closed when the generator that is returned ends, raises or is closed.
    """
    clock, iterator = WaitClock(), iter(items)
    with ExitStack() as opened:
        if isinstance(iterator, Generator):
            opened.callback(iterator.close)
        while True:
            begin = time.perf_counter()
            try:
                item = next(iterator)
            except StopIteration:
                return
            clock.add_idle(time.perf_counter() - begin)
            record_wait(name, clock.lap())
            yield item
