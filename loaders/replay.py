"""The replay order of an epoch: which garment comes next when each is used several times, in integer arithmetic."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from typing import NamedTuple

import numpy as np

CHUNK = 1024  # random words that are drawn at once
WORD_BITS = 64


@dataclass(frozen=True)
class ReplayRate:
    """Uses per garment as a fraction: 5/2 is twice for one garment and three times for the next."""

    numerator: int
    denominator: int

    def total(self, garments: int) -> int:
        """Uses of the first ``garments`` garments together."""
        return garments * self.numerator // self.denominator

    def times(self, index: int) -> int:
        """Uses of one garment."""
        return self.total(index + 1) - self.total(index)


class Replay(NamedTuple):
    """One use of a garment."""

    garment: int
    before: int
    """Earlier uses of the garment in this epoch."""
    is_last: bool


@dataclass
class ReplayWindow:
    """Iterator over the uses of an epoch: a window of up to ``room`` garments, from which each use is drawn at random.

    >>> window = ReplayWindow(count=3, rate=ReplayRate(2, 1), room=2, seed=0, epoch=0)
    >>> [replay.garment for replay in window]
    [0, 1, 0, 1, 2, 2]

    The window starts with one garment and grows by one with each use, so that the first use needs one garment only. A
    garment leaves after its last use. The order depends on these five numbers alone.
    """

    count: int
    """Garments of an epoch."""
    rate: ReplayRate
    room: int
    """Most garments in the window."""
    seed: int
    epoch: int
    offset: int = 0
    """Uses so far."""
    entered: int = 0
    """Garments that have entered the window so far, in the order of their indices."""
    _window: list[list[int]] = field(default_factory=list)
    """Index and uses so far of each garment in the window."""

    def __iter__(self) -> Iterator[Replay]:
        return self

    def __next__(self) -> Replay:
        while len(self._window) < min(self.room, self.offset + 1) and self.entered < self.count:
            self._window.append([self.entered, 0])
            self.entered += 1
        if not self._window:
            raise StopIteration
        word = _random_words(self.seed, self.epoch, self.offset // CHUNK)[self.offset % CHUNK]
        row = word * len(self._window) >> WORD_BITS
        entry = self._window[row]
        index, before = entry
        entry[1] += 1
        is_last = entry[1] == self.rate.times(index)
        if is_last:
            self._window[row] = self._window[-1]
            self._window.pop()
        self.offset += 1
        return Replay(index, before, is_last)

    def skip(self, uses: int) -> None:
        """Advance by some uses."""
        for _ in range(uses):
            next(self)

    def designs(self, garments_per_design: int) -> list[list[int]]:
        """The indices in the window, one list per design, in the order of each design's next use."""
        left = {index for index, _ in self._window}
        ahead, order = deepcopy(self), list[int]()
        while left:
            index = next(ahead).garment
            if index in left:
                left.remove(index)
                order.append(index)
        first_use: dict[int, int] = {}
        for rank, index in enumerate(order):
            first_use.setdefault(index // garments_per_design, rank)
        in_order = sorted(order, key=lambda index: (first_use[index // garments_per_design], index))
        return [list(indices) for _, indices in groupby(in_order, key=lambda index: index // garments_per_design)]


@lru_cache(maxsize=4)
def _random_words(seed: int, epoch: int, chunk: int) -> list[int]:
    """Random 64-bit words from ``SeedSequence``: the draws of a ``Generator`` may change between releases of NumPy."""
    words: list[int] = np.random.SeedSequence((seed, epoch, chunk)).generate_state(CHUNK, np.uint64).tolist()
    return words
