"""Garments made while a model trains: ahead of it, into a buffer of a fixed size, each given several times."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, islice
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, Item, function, natural
from gcd_dataset.loaders.one_thread import copied
from gcd_dataset.loaders.transforms import Augment
from gcd_dataset.loaders.worker import begin_worker
from gcd_dataset.seeding import Stage, rng

__all__ = ["FreshGarments"]

AHEAD = 8  # designs that each worker may have ready: some take ten times as long as others


class FreshGarments(IterableDataset[Item]):
    """Every garment of a data set, made by ``workers`` processes ahead of the training and given ``replay`` times.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> fresh = FreshGarments(FakeGarments(4, fields=["meta"]), replay=2, room=3)
    >>> [item["meta"]["index"] for item in fresh]
    [2, 1, 1, 0, 0, 3, 3, 2]

    A model that takes more garments a second than can be made sees each of them ``replay`` times, at random moments
    out of the ``room`` garments in the buffer; 2.5 is 2 times for one and 3 for the next. A garment that was given as
    often gives its place to the next that was made, so that memory is bounded: ``room`` items here, and those of eight
    designs in each worker; where another process drapes for the workers, 64 garments more in each, of 1 MB at 1 cm.
    Training begins when the buffer is full. The order is a function of ``seed`` and of the data set's: of neither
    workers nor time.

    ``augment`` changes an item each time it is given, with a random stream of its own: see
    ``gcd_dataset.loaders.transforms``. It gets the item in the buffer, which it must not change in place.

    Give it to a ``GarmentLoader`` with ``shuffle=False``, or to a ``DataLoader``; both without workers. Several ranks
    share the making with ``garments.select(range(rank, n, ranks))`` each, and ``rank=0, world_size=1`` of the loader.
    Raises ``ConfigError`` for options that cannot be.
    """

    def __init__(
        self,
        garments: Garments,
        *,
        replay: float = 1.0,
        room: int = 256,
        workers: int = 0,
        seed: int = 0,
        augment: Augment | None = None,
    ) -> None:
        if not 1 <= replay < float("inf"):
            raise ConfigError(f"replay={replay!r}: give 1 or more")
        self.garments, self.replay, self.room = garments, Fraction(str(replay)), natural("room", room, least=1)
        self.workers, self.seed = natural("workers", workers), natural("seed", seed)
        self.augment = None if augment is None else function("augment", augment)

    def __len__(self) -> int:
        """Items of one pass."""
        return self._due(len(self.garments))

    def __iter__(self) -> Iterator[Item]:
        if get_worker_info() is not None:
            raise ConfigError("FreshGarments in a worker: give the loader num_workers=0; it has workers of its own")
        chance = np.random.default_rng(self.seed)
        made = enumerate(self._made())
        buffer: list[_Given] = []
        while True:
            while len(buffer) < self.room and (following := next(made, None)) is not None:
                buffer.append(_Given(*following, self._times(following[0])))
            if not buffer:
                return
            place = int(chance.integers(len(buffer)))
            yield self._changed(buffer[place])
            buffer[place].given += 1
            if buffer[place].given == buffer[place].times:
                buffer[place] = buffer[-1]
                buffer.pop()

    def identity(self) -> dict[str, Any]:
        """What tells this stream from others: whose garments, how often, and all that the order is a function of."""
        options = {"replay": str(self.replay), "room": self.room, "seed": self.seed}
        return {"garments": self.garments.identity(), **options}

    def _made(self) -> Iterator[Item]:
        """The garments in order: workers have them by turns, and give them by turns."""
        options: dict[str, Any] = {"prefetch_factor": AHEAD} if self.workers else {}
        designs = DataLoader(
            _Share(self.garments),
            batch_size=None,
            num_workers=self.workers,
            worker_init_fn=begin_worker,
            # Of its own: a ``DataLoader`` without one draws from the caller's random numbers.
            generator=torch.Generator().manual_seed(self.seed),
            **options,
        )
        made = chain.from_iterable(designs)
        return map(_own, made) if self.workers else made

    def _changed(self, entry: "_Given") -> Item:
        if self.augment is None:
            return entry.item
        return self.augment(entry.item, rng(self.seed, entry.number, Stage.AUGMENT, entry.given))

    def _times(self, number: int) -> int:
        """How often a garment is given."""
        return self._due(number + 1) - self._due(number)

    def _due(self, garments: int) -> int:
        return int(garments * self.replay)


@dataclass
class _Given:
    """A garment in the buffer."""

    number: int
    item: Item
    times: int
    """How often it is given in all."""
    given: int = 0


def _own(item: Any) -> Any:
    """The item in memory of this process: a container has 64 MB that workers can share, if nobody asks for more."""
    if not isinstance(item, dict):  # a transform has made something else of it
        return item
    return {name: copied(value) if isinstance(value, torch.Tensor) else value for name, value in item.items()}


class _Share(IterableDataset[list[Item]]):
    """Each worker's garments: every so many designs, those of a design in a list."""

    def __init__(self, garments: Garments) -> None:
        self._garments = garments

    def __iter__(self) -> Iterator[list[Item]]:
        worker = get_worker_info()
        first, step = (0, 1) if worker is None else (worker.id, worker.num_workers)
        count, each = len(self._garments), self._garments.together
        designs = [range(k, min(k + each, count)) for k in range(first * each, count, step * each)]
        made = self._garments.stream(chain.from_iterable(designs))
        return (list(islice(made, len(design))) for design in designs)
