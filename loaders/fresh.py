"""``FreshGarments``: garments made during training into a buffer of fixed size, each used several times.

The workers belong to a ``DataLoader``, not to ``gcd_dataset.workers``: they run users' data sets and transforms, which
may be lambdas in a script without a ``__main__`` guard, and each worker needs its own random streams. Like ``gcd
generate`` they call ``produce``, with the same draping processes and the same look-ahead.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache, partial
from itertools import chain, islice
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.generator.maker import READY
from gcd_dataset.loaders.base import (
    GarmentItem,
    Garments,
    Item,
    as_transform_error,
    require_callable,
    require_garments,
    require_integer,
    wrap_item,
)
from gcd_dataset.loaders.batches import copy_tensor
from gcd_dataset.loaders.fields import GarmentFields
from gcd_dataset.loaders.states import dataset_entries, position_in_state
from gcd_dataset.loaders.transforms import Augment
from gcd_dataset.loaders.worker import begin_worker, require_semaphores, sent, unwrap, with_traceback
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.workers import prefetch

DesignOrder: TypeAlias = Callable[[], Iterator[Sequence[int]]]
CHUNK = 1024  # random words that are drawn at once
WORD_BITS = 64


def uses(rate: Fraction, garments: int) -> int:
    """Uses of the first ``garments`` garments together; 5/2 is twice for one garment and three times for the next."""
    return garments * rate.numerator // rate.denominator


class Replay(NamedTuple):
    """One use of a garment."""

    garment: int
    before: int
    """Earlier uses of the garment in this epoch."""
    is_last: bool


@dataclass
class ReplayWindow:
    """Iterator over the uses of an epoch: a window of up to ``room`` garments, from which each use is drawn at random.

    >>> window = ReplayWindow(count=3, rate=Fraction(2), room=2, seed=0, epoch=0)
    >>> [replay.garment for replay in window]
    [0, 1, 0, 1, 2, 2]

    The window starts with one garment and grows by one with each use, so that the first use needs one garment only. A
    garment leaves after its last use. The order depends on these five numbers alone.
    """

    count: int
    """Garments of an epoch."""
    rate: Fraction
    """Uses of each garment."""
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
        is_last = entry[1] == uses(self.rate, index + 1) - uses(self.rate, index)
        if is_last:
            self._window[row] = self._window[-1]
            self._window.pop()
        self.offset += 1
        return Replay(index, before, is_last)

    def designs(self, garments_per_design: int) -> list[list[int]]:
        """The indices in the window, one list per design, in the order of each design's next use."""
        left, ahead = {index for index, _ in self._window}, deepcopy(self)
        designs: dict[int, list[int]] = {}
        while left:
            index = next(ahead).garment
            if index in left:
                left.remove(index)
                designs.setdefault(index // garments_per_design, []).append(index)
        return [sorted(indices) for indices in designs.values()]


@lru_cache(maxsize=4)
def _random_words(seed: int, epoch: int, chunk: int) -> list[int]:
    """Random 64-bit words from ``SeedSequence``: the draws of a ``Generator`` may change between releases of NumPy."""
    words: list[int] = np.random.SeedSequence((seed, epoch, chunk)).generate_state(CHUNK, np.uint64).tolist()
    return words


class FreshGarments(IterableDataset[GarmentFields]):
    """A stream of garments generated during training, each used ``replay`` times.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> fresh = FreshGarments(FakeGarments(4, fields=["meta"]), replay=2, room=3)
    >>> [item["meta"]["index"] for item in fresh]
    [0, 1, 0, 2, 2, 3, 3, 1]
    >>> [item["meta"]["index"] for item in fresh]  # the next epoch
    [0, 0, 1, 3, 3, 2, 1, 2]

    For a model that consumes garments faster than they are made. Garments are used in random order from a buffer; after
    its last use a garment is replaced by a new one. The first item is ready as soon as the first garment is made: the
    buffer grows by one garment with each item, up to ``room``.

    - ``garments``: the data set that makes the garments, usually ``GeneratedGarments``.
    - ``replay``: uses of each garment, at least 1; with 2.5 one garment is used twice, the next three times.
    - ``room``: number of garments in the buffer.
    - ``workers``: number of processes that make garments ahead of the training; 0: this process makes them.
    - ``seed``: seed of order and augmentation. The order depends on ``seed``, epoch, position and data set, not on
      workers or timing.
    - ``augment``: called at each use with the item in the buffer, which it must not change in place, and a random
      stream for this use: see ``gcd_dataset.loaders.transforms``.

    **Loaders.** Pass the stream to a ``GarmentLoader`` with ``shuffle=False``, or to a ``DataLoader``; both without
    workers. For several ranks that make different garments, pass ``garments.select(range(rank, n, ranks))`` on each
    rank, and ``rank=0, world_size=1`` to the loader.

    **Epochs.** Each ``iter()`` is the next epoch: the same garments in another order, with other augmentation. An
    ``endless`` data set, such as ``MixedDataset``, supplies its following garments each epoch. ``set_epoch`` selects an
    epoch; ``load_state_dict`` resumes within an epoch, and makes again only the earlier garments that are still in the
    buffer. A ``GarmentLoader`` does both by its own state.

    **Memory.** The buffer holds ``room`` items; each worker holds the items of up to 74 designs, plus 48 garments of
    1 MB (at 1 cm) if draping processes serve the workers.

    Raises ``ConfigError`` for invalid options, and the errors of workers, such as ``DrapeError`` if a draping process
    ends: then ``load_state_dict(state_dict())`` resumes at the garment that failed.
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
        require_garments("garments", garments)
        self.garments, self.room = garments, require_integer("room", room, least=1)
        self.workers, self.seed = require_integer("workers", workers), require_integer("seed", seed)
        self.augment = None if augment is None else require_callable("augment", augment, "item, rng")
        self._rate = _rate(replay)
        self._next = self._position = 0  # start of the next iter(); position in the current one
        self._iterator = 0  # number of the valid iterator

    @property
    def replay(self) -> Fraction:
        """Uses of each garment."""
        return self._rate

    def __len__(self) -> int:
        """Items of one epoch."""
        return uses(self._rate, len(self.garments))

    def __repr__(self) -> str:
        return f"FreshGarments({self.garments!r}, replay={float(self.replay):g}, room={self.room})"

    def __iter__(self) -> Iterator[GarmentFields]:
        """The next epoch, or the rest of the loaded state's epoch."""
        start = self._position = self._next
        self._next = (start // max(len(self), 1) + 1) * len(self)
        self._iterator += 1
        return self._counted(start, self._iterator)

    def set_epoch(self, epoch: int) -> None:
        """Select the epoch of the next ``iter()``."""
        self._go_to(require_integer("epoch", epoch) * len(self))

    def state_dict(self) -> dict[str, Any]:
        """The position, in items yielded since the first epoch began, and the identity of the order."""
        return {"position": self._position, **dataset_entries(self)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Resume from a state at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self._go_to(position_in_state(state, {}, dataset_entries(self)))

    def identity(self) -> dict[str, Any]:
        """Everything that determines the order: garments, replay, room and seed."""
        return {
            "fresh": self.garments.identity() if len(self.garments) else None,
            "replay": str(self.replay),
            "room": self.room,
            "seed": self.seed,
        }

    def begin_at(self, position: int) -> Iterator[Item]:
        """The items from a position to the end of its epoch; positions count from the start of the first epoch.

        Makes no garment that is used only before the position.
        """
        if get_worker_info() is not None:
            raise ConfigError(
                "FreshGarments in a worker: give the loader num_workers=0; FreshGarments starts its own workers"
            )
        epoch, offset = divmod(position, max(len(self), 1))
        window = ReplayWindow(len(self.garments), self._rate, self.room, self.seed, epoch)
        for _ in range(offset):
            next(window)
        per_design = self.garments.garments_per_design
        order = partial(_make_order, window.designs(per_design), window.entered, window.count, per_design)
        first = epoch * len(self.garments)
        return self._replayed(window, zip(chain.from_iterable(order()), self._made(order, first), strict=True), first)

    def _go_to(self, position: int) -> None:
        self._next = self._position = position
        self._iterator += 1

    def _counted(self, start: int, iterator: int) -> Iterator[Any]:
        for position, item in enumerate(self.begin_at(start), start + 1):
            if iterator == self._iterator:  # no later iter() or load_state_dict()
                self._position = position
            yield item

    def _replayed(self, window: ReplayWindow, made: Iterator[tuple[int, Item]], first: int) -> Iterator[Item]:
        """The items in the window's order, from garments as they are made."""
        buffer: dict[int, Item] = {}
        for replay in window:
            wanted = replay.garment
            while wanted not in buffer:
                garment, item = next(made)
                buffer[garment] = item
                del item  # otherwise this frame would keep it alive after its last use
            yield self._augmented(buffer.pop(wanted) if replay.is_last else buffer[wanted], replay, first)

    def _made(self, order: DesignOrder, first: int) -> Iterator[Item]:
        """The garments in order, made by the workers in turn, one design each."""
        if self.workers:
            require_semaphores(self.workers)
        designs = DataLoader(
            _WorkerGarments(self.garments, order, first if self.garments.endless else 0),
            batch_size=None,
            num_workers=self.workers,
            worker_init_fn=begin_worker,
            # A generator of its own: without one, ``DataLoader`` draws from torch's global stream.
            generator=torch.Generator().manual_seed(self.seed),
        )
        made = chain.from_iterable(map(unwrap, designs))
        return map(_copied, made) if self.workers else made

    def _augmented(self, item: Item, replay: Replay, first: int) -> Item:
        if self.augment is None:
            return item
        number = first + replay.garment  # another stream in each epoch
        with as_transform_error(self.garments, replay.garment):
            return wrap_item(self.augment(item, rng(self.seed, number, Stage.AUGMENT, replay.before)))


def _rate(replay: float) -> Fraction:
    """``replay`` as a fraction. Raises ``ConfigError`` for a value below 1."""
    try:
        rate = Fraction(str(replay))
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if rate < 1:
        raise ConfigError(f"replay={replay!r:.99}: give 1 or more")
    return rate


def _copied(item: Any) -> Any:
    """A copy of the item outside shared memory, of which a container has only 64 MB by default."""
    if not isinstance(item, dict):  # a transform may return any type
        return item
    return GarmentItem(
        (name, copy_tensor(value) if isinstance(value, torch.Tensor) else value) for name, value in item.items()
    )


def _make_order(
    designs: Sequence[Sequence[int]], start: int, count: int, garments_per_design: int
) -> Iterator[Sequence[int]]:
    """The order in which garments are made: these designs, then all others from index ``start`` on."""
    yield from designs
    while start < count:
        end = min((start // garments_per_design + 1) * garments_per_design, count)
        yield range(start, end)
        start = end


class _WorkerGarments(IterableDataset[list[Item] | GcdError]):
    """One worker's garments: every ``num_workers``-th design, as a list of its items; an error ends the stream."""

    def __init__(self, garments: Garments, order: DesignOrder, first: int) -> None:
        self._garments, self._order, self._first = garments, order, first

    def __iter__(self) -> Iterator[list[Item] | GcdError]:
        # Finished garments wait in private memory: shared memory, 64 MB in a container, holds two garments per worker.
        is_here = get_worker_info() is None
        return self._made() if is_here else map(sent, prefetch(self._made_or_error(), READY))

    def _made_or_error(self) -> Iterator[list[Item] | GcdError]:
        """The designs; then the error that ended them, if any, as a value."""
        try:
            yield from self._made()
        except GcdError as error:
            yield with_traceback(error)

    def _made(self) -> Iterator[list[Item]]:
        made = self._garments.stream(self._first + index for index in chain.from_iterable(self._designs()))
        return (list(islice(made, len(design))) for design in self._designs())

    def _designs(self) -> Iterable[Sequence[int]]:
        worker = get_worker_info()
        return islice(self._order(), *((0, None, 1) if worker is None else (worker.id, None, worker.num_workers)))
