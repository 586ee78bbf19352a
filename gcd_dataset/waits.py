"""How much of its time each part of the making of samples waits for another.

Every process has one account: its parts note what they waited, and ``taken`` empties it. Processes send theirs along
with their results, and the receiver adds them up.
"""

import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, TypeVar

__all__ = ["MAKERS", "WRITER", "Wait", "WaitClock", "Waits", "added", "noted", "shares", "taken", "waited_for"]

MAKERS = "makers"
"""Processes that make samples, which wait for the writer to take them."""
WRITER = "writer"
"""The process that writes samples, which waits for the next; where it makes them itself, their making."""

Item = TypeVar("Item")


class Wait(NamedTuple):
    """Time of one part, or of several like it."""

    idle: float
    """Seconds that it waited."""
    over: float
    """Seconds that passed, those among them."""


Waits = Mapping[str, Wait]
"""Who waits: ``makers``, ``writer``, or a device for its draping processes, which wait for orders."""


def added(*waits: Waits) -> dict[str, Wait]:
    """The sum.

    >>> added({"writer": Wait(1.0, 4.0)}, {"writer": Wait(2.0, 4.0), "cuda:0": Wait(0.5, 5.0)})
    {'writer': Wait(idle=3.0, over=8.0), 'cuda:0': Wait(idle=0.5, over=5.0)}
    """
    total: dict[str, Wait] = {}
    for some in waits:
        for name, wait in some.items():
            before = total.get(name, Wait(0.0, 0.0))
            total[name] = Wait(before.idle + wait.idle, before.over + wait.over)
    return total


def shares(waits: Waits) -> dict[str, float]:
    """The share of the time that each waited, by name.

    >>> shares({"writer": Wait(3.0, 8.0)})
    {'writer': 0.375}
    """
    return {name: min(wait.idle / wait.over, 1.0) for name, wait in sorted(waits.items()) if wait.over > 0}


class WaitClock:
    """Counts the time of one part, and how much of it is waiting. For one thread."""

    def __init__(self) -> None:
        self._since, self._idle = time.perf_counter(), 0.0

    def idle(self, seconds: float) -> None:
        """Count a wait that has just ended."""
        self._idle += seconds

    def taken(self) -> Wait:
        """The time since the last call, or since the beginning."""
        now, idle = time.perf_counter(), self._idle
        wait = Wait(idle, now - self._since)
        self._since, self._idle = now, 0.0
        return wait


_account: dict[str, Wait] = {}
_changing = threading.Lock()


def noted(name: str, wait: Wait) -> None:
    """Add to this process's account."""
    with _changing:
        _account.update(added({name: _account.get(name, Wait(0.0, 0.0))}, {name: wait}))


def taken() -> dict[str, Wait]:
    """This process's account since the last call."""
    with _changing:
        account = dict(_account)
        _account.clear()
        return account


def waited_for(items: Iterable[Item], name: str) -> Iterator[Item]:
    """The same items; ``name`` waits while the next is awaited, and works until it asks for another."""
    clock, coming = WaitClock(), iter(items)
    while True:
        begun = time.perf_counter()
        try:
            item = next(coming)
        except StopIteration:
            return
        clock.idle(time.perf_counter() - begun)
        noted(name, clock.taken())
        yield item
