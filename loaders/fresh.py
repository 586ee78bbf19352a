"""Garments made while a model trains: ahead of it, into a buffer of a fixed size, each given several times.

The processes are those of a ``DataLoader``, not of ``gcd_dataset.workers``: they run data sets and transforms of users,
which may be no more than a lambda in a script without a guard, with random numbers of their own in each worker. What
they do is the maker's: ``produce`` at the same draping processes, as far ahead.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import chain, islice
from typing import Any

import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.generator.maker import READY
from gcd_dataset.loaders.base import GarmentItem, Garments, Item, changing, function, kept_item, natural
from gcd_dataset.loaders.one_thread import copied
from gcd_dataset.loaders.replay import Given, Rate, Window
from gcd_dataset.loaders.states import named, position_of
from gcd_dataset.loaders.transforms import Augment
from gcd_dataset.loaders.worker import begin_worker, received, told
from gcd_dataset.prefetch import prefetch
from gcd_dataset.seeding import Stage, rng

__all__ = ["FreshGarments"]


class FreshGarments(IterableDataset[Item]):
    """Every garment of a data set, made by ``workers`` processes ahead of the training and given ``replay`` times.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> fresh = FreshGarments(FakeGarments(4, fields=["meta"]), replay=2, room=3)
    >>> [item["meta"]["index"] for item in fresh]
    [0, 1, 0, 2, 2, 3, 3, 1]
    >>> [item["meta"]["index"] for item in fresh]  # the next epoch
    [0, 0, 1, 3, 3, 2, 1, 2]

    A model that takes more garments a second than can be made sees each of them ``replay`` times, at random moments
    out of the garments in the buffer; 2.5 is 2 times for one and 3 for the next. A garment that was given as often
    gives its place to the next that was made, so that memory is bounded: ``room`` items here, and those of 74 designs
    in each worker; where other processes drape for the workers, 48 garments more in each, of 1 MB at 1 cm.
    The first garment comes as soon as it is made: the buffer takes in one more with each that is given, until there are
    ``room`` of them. The order is a function of ``seed``, epoch and place, and of the data set: not of workers or time.

    Each ``iter()`` is the next epoch: the same garments in another order, changed otherwise. Of a data set that goes on
    beyond its length, as ``MixedDataset`` does, each epoch has the garments that follow. ``set_epoch`` chooses another,
    and ``load_state_dict`` goes on in the midst of one: what came before is not made again, but for what is in the
    buffer there. A ``GarmentLoader`` does both by its own state.

    ``augment`` changes an item each time it is given, with a random stream of its own: see
    ``gcd_dataset.loaders.transforms``. It gets the item in the buffer, which it must not change in place.

    Give it to a ``GarmentLoader`` with ``shuffle=False``, or to a ``DataLoader``; both without workers. Several ranks
    share the making with ``garments.select(range(rank, n, ranks))`` each, and ``rank=0, world_size=1`` of the loader.
    Raises ``ConfigError`` for options that cannot be, and what a worker raises, such as ``DrapeError`` where a draping
    process ends: ``load_state_dict(state_dict())`` then goes on with the garment that did not come.
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
        if not isinstance(garments, Garments):
            raise ConfigError(f"FreshGarments of a {type(garments).__name__}: give GeneratedGarments, or the like")
        self.garments, self.room = garments, natural("room", room, least=1)
        self.workers, self.seed = natural("workers", workers), natural("seed", seed)
        self.augment = None if augment is None else function("augment", augment)
        self._rate = _rate(replay)
        self._next = self._reached = self._begun = 0

    @property
    def replay(self) -> Fraction:
        """How often each garment is given."""
        return Fraction(self._rate.over, self._rate.under)

    def __len__(self) -> int:
        """Items of one epoch."""
        return self._rate.due(len(self.garments))

    def __repr__(self) -> str:
        return f"FreshGarments({self.garments!r}, replay={float(self.replay):g}, room={self.room})"

    def __iter__(self) -> Iterator[Item]:
        """The next epoch, or what is left of the one that a state was of."""
        start = self._reached = self._next
        self._next = (start // max(len(self), 1) + 1) * len(self)
        self._begun += 1
        return self._counted(start, self._begun)

    def set_epoch(self, epoch: int) -> None:
        """Have the next ``iter()`` be that epoch."""
        self._go_to(natural("epoch", epoch) * len(self))

    def state_dict(self) -> dict[str, Any]:
        """How many items were given since the first epoch began, by the ``iter()`` begun last, and of which order."""
        return {"position": self._reached, **named(self)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self._go_to(position_of(state, {}, named(self)))

    def identity(self) -> dict[str, Any]:
        """What makes the order: garments, and how they are given."""
        return {
            "fresh": self.garments.identity() if len(self.garments) else None,
            "replay": str(self.replay),
            "room": self.room,
            "seed": self.seed,
        }

    def begin_at(self, position: int) -> Iterator[Item]:
        """The items from a position to the end of its epoch; positions count from the beginning of the first epoch.

        Garments that were given for the last time before are not made.
        """
        if get_worker_info() is not None:
            raise ConfigError("FreshGarments in a worker: give the loader num_workers=0; it has workers of its own")
        epoch, place = divmod(position, max(len(self), 1))
        window = Window(len(self.garments), self._rate, self.room, self.seed, epoch)
        window.skip(place)
        order = _Making(window.waiting(self.garments.together), window.entered, window.count, self.garments.together)
        first = epoch * len(self.garments)
        return self._given(window, zip(order.numbers(), self._made(order, first), strict=True), first)

    def _go_to(self, position: int) -> None:
        self._next = self._reached = position
        self._begun += 1

    def _counted(self, start: int, begun: int) -> Iterator[Item]:
        for position, item in enumerate(self.begin_at(start), start + 1):
            if begun == self._begun:  # no other ``iter()`` or state has come since
                self._reached = position
            yield item

    def _given(self, window: Window, made: Iterator[tuple[int, Item]], first: int) -> Iterator[Item]:
        """The items that a window chooses, out of those that are made."""
        buffer: dict[int, Item] = {}
        for given in window:
            while given.number not in buffer:
                number, item = next(made)
                buffer[number] = item
                del item
            yield self._changed(buffer.pop(given.number) if given.is_last else buffer[given.number], given, first)

    def _made(self, order: "_Making", first: int) -> Iterator[Item]:
        """The garments in order: workers have them by turns, and give them by turns."""
        self.garments.tell_wait()  # before the workers are there, who would all say it
        designs = DataLoader(
            _Share(self.garments, order, first if self.garments.endless else 0),
            batch_size=None,
            num_workers=self.workers,
            worker_init_fn=begin_worker,
            # Of its own: a ``DataLoader`` without one draws from the caller's random numbers.
            generator=torch.Generator().manual_seed(self.seed),
        )
        made = chain.from_iterable(map(received, designs))
        return map(_own, made) if self.workers else made

    def _changed(self, item: Item, given: Given, first: int) -> Item:
        if self.augment is None:
            return item
        number = first + given.number  # other chance in each epoch
        with changing(self.garments, given.number):
            return kept_item(self.augment(item, rng(self.seed, number, Stage.AUGMENT, given.before)))


def _rate(replay: float) -> Rate:
    """The share as whole numbers. Raises ``ConfigError``."""
    try:
        share = Fraction(str(replay))
    except (ValueError, ZeroDivisionError):
        share = Fraction(0)
    if share < 1:
        raise ConfigError(f"replay={replay!r:.99}: give 1 or more")
    return Rate(share.numerator, share.denominator)


def _own(item: Any) -> Any:
    """The item in memory of this process: a container has 64 MB that workers can share, if nobody asks for more."""
    if not isinstance(item, dict):  # a transform has made something else of it
        return item
    return GarmentItem(
        (name, copied(value) if isinstance(value, torch.Tensor) else value) for name, value in item.items()
    )


class _Making:
    """The order in which garments are made: some designs, then all others from a number on."""

    def __init__(self, designs: Sequence[Sequence[int]], start: int, count: int, together: int) -> None:
        self._designs, self._start, self._count, self._together = designs, start, count, together

    def __iter__(self) -> Iterator[Sequence[int]]:
        """The numbers of each design."""
        yield from self._designs
        start = self._start
        while start < self._count:
            end = min((start // self._together + 1) * self._together, self._count)
            yield range(start, end)
            start = end

    def numbers(self) -> Iterator[int]:
        """Of the garments."""
        return chain.from_iterable(self)


class _Share(IterableDataset[list[Item] | GcdError]):
    """Each worker's garments: every so many designs, those of a design in a list; an error ends them."""

    def __init__(self, garments: Garments, order: _Making, first: int) -> None:
        self._garments, self._order, self._first = garments, order, first

    def __iter__(self) -> Iterator[list[Item] | GcdError]:
        # Finished garments wait in the worker's own memory: shared memory, 64 MB in a container, holds two a worker.
        return self._made() if get_worker_info() is None else prefetch(self._told(), READY)

    def _told(self) -> Iterator[list[Item] | GcdError]:
        """The garments, then the error that ended them."""
        try:
            yield from self._made()
        except GcdError as error:
            yield told(error)

    def _made(self) -> Iterator[list[Item]]:
        made = self._garments.stream(self._first + number for number in chain.from_iterable(self._designs()))
        return (list(islice(made, len(design))) for design in self._designs())

    def _designs(self) -> Iterable[Sequence[int]]:
        worker = get_worker_info()
        return islice(self._order, *((0, None, 1) if worker is None else (worker.id, None, worker.num_workers)))
