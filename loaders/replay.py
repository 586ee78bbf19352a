"""Which garment of an epoch is given next, when each is given several times: numbers alone, whatever they stand for."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from typing import NamedTuple

import numpy as np

__all__ = ["Given", "Rate", "Window"]

AT_ONCE = 1024  # places whose chance is drawn together
WORD = 64  # bits of it


@dataclass(frozen=True)
class Rate:
    """How often garments are given: 5/2 is 2 times for one and 3 for the next."""

    over: int
    under: int

    def due(self, garments: int) -> int:
        """How often the first so many are given in all."""
        return garments * self.over // self.under

    def times(self, number: int) -> int:
        """How often one of them is."""
        return self.due(number + 1) - self.due(number)


class Given(NamedTuple):
    """A garment that is given."""

    number: int
    before: int
    """How often it was given before in this epoch."""
    is_last: bool


@dataclass
class Window:
    """The garments of an epoch that may be given next, and at the call of ``next`` one of them by chance.

    >>> window = Window(count=3, rate=Rate(2, 1), room=2, seed=0, epoch=0)
    >>> [given.number for given in window]
    [0, 1, 0, 1, 2, 2]

    It begins with one garment and takes in another with each that is given, until ``room`` are in it: so the first
    comes as soon as it is made. What comes at which place depends on these numbers alone.
    """

    count: int
    """Garments of an epoch."""
    rate: Rate
    room: int
    seed: int
    epoch: int
    place: int = 0
    """How many were given so far."""
    entered: int = 0
    """How many of the garments have been taken in, in the order of their numbers."""
    _waiting: list[list[int]] = field(default_factory=list)
    """Number of each that is in it, and how often it was given."""

    def __iter__(self) -> Iterator[Given]:
        return self

    def __next__(self) -> Given:
        while len(self._waiting) < min(self.room, self.place + 1) and self.entered < self.count:
            self._waiting.append([self.entered, 0])
            self.entered += 1
        if not self._waiting:
            raise StopIteration
        row = _chance(self.seed, self.epoch, self.place // AT_ONCE)[self.place % AT_ONCE] * len(self._waiting) >> WORD
        entry = self._waiting[row]
        number, before = entry
        entry[1] += 1
        is_last = entry[1] == self.rate.times(number)
        if is_last:
            self._waiting[row] = self._waiting[-1]
            self._waiting.pop()
        self.place += 1
        return Given(number, before, is_last)

    def skip(self, places: int) -> None:
        """Go on without what comes at so many places."""
        for _ in range(places):
            next(self)

    def waiting(self, together: int) -> list[list[int]]:
        """The numbers in it, those of a design in one list; that which is given first stands first."""
        left = {number for number, _ in self._waiting}
        ahead, order = deepcopy(self), list[int]()
        while left:
            number = next(ahead).number
            if number in left:
                left.remove(number)
                order.append(number)
        first = {design: place for place, design in reversed(list(enumerate(number // together for number in order)))}
        in_order = sorted(order, key=lambda number: (first[number // together], number))
        return [list(numbers) for _, numbers in groupby(in_order, key=lambda number: number // together)]


@lru_cache(maxsize=4)
def _chance(seed: int, epoch: int, block: int) -> list[int]:
    """Random words. Not of a generator of NumPy, whose numbers may change with its releases."""
    words: list[int] = np.random.SeedSequence((seed, epoch, block)).generate_state(AT_ONCE, np.uint64).tolist()
    return words
