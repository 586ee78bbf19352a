"""What a ``GarmentLoader`` hands out, and where that leaves it: garments by number, or as a stream gives them."""

from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sized
from contextlib import closing, nullcontext
from itertools import islice
from typing import Any, NamedTuple, Protocol, TypeAlias

import torch
from torch.utils.data import DataLoader, Dataset, IterableDataset

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.loaders.base import Garments, items_of
from gcd_dataset.loaders.chance import own_chance
from gcd_dataset.loaders.order import ElasticSampler, RankShare
from gcd_dataset.loaders.parted import is_ours, parted
from gcd_dataset.loaders.ranks import present_rank, require_rank
from gcd_dataset.loaders.states import named, position_of, require_whole
from gcd_dataset.loaders.worker import begin_worker, told
from gcd_dataset.prefetch import prefetch

__all__ = ["AHEAD", "BatchPlan", "ByNumber", "Collate", "Cursor", "Making", "Streamed", "Turn"]

Collate: TypeAlias = Callable[[list[Any]], Any]
Cursor: TypeAlias = Any
"""Where a loader has come to, as its plan counts it."""

AHEAD = 2  # batches
END = object()  # of a stream


class BatchPlan(Protocol):
    """The batches of this rank from any place on."""

    in_thread: bool
    """Whether batches may be made by a thread beside the training: no code of users has a part in them."""
    first: Cursor
    """Where the first epoch begins."""

    def loader(self, **options: Any) -> DataLoader:
        """What loads the batches of each pass that is begun."""

    def __len__(self) -> int:
        """Batches of a whole epoch."""

    def epoch(self, place: Cursor) -> int:
        """The epoch of a place."""

    def state(self, place: Cursor) -> dict[str, Any]:
        """A place, with what names the order that it is one of."""

    def place_of(self, state: Mapping[str, Any]) -> Cursor:
        """The place in a state. Raises ``ConfigError`` for the state of another order."""

    def anew(self, place: Cursor) -> Cursor:
        """Where a pass starts that goes on with nothing: the next epoch, if this one has been begun."""

    def begin(self, place: Cursor) -> Cursor:
        """Where the next pass starts, for somebody who goes on from ``place``."""

    def after(self, start: Cursor, number: int) -> Cursor:
        """The place after batch ``number``, from 1, of a pass."""

    def finished(self, place: Cursor) -> Cursor:
        """The place after the last batch."""

    def marked(self, batch: Any, start: Cursor, number: int) -> Any:
        """The batch, with what the plan has to say of it."""


class Turn(NamedTuple):
    """What a batch is made of."""

    epoch: int
    numbers: list[int]


class ByNumber:
    """Batches of a sampler's share, each as many numbers: a batch sampler. A place is a position of the order."""

    first = 0

    def __init__(
        self,
        sampler: ElasticSampler,
        dataset: Dataset,
        batch_size: int,
        collate_fn: Collate,
        *,
        drop_last: bool,
        num_workers: int,
    ) -> None:
        self._sampler, self._batch_size, self._drop_last, self._start = sampler, batch_size, drop_last, 0
        self._making, self._workers = Making(dataset, collate_fn, sampler.order.seed), num_workers
        self._reads_only = isinstance(dataset, Garments) and dataset.reads_only
        self.in_thread = self._reads_only and num_workers == 0 and not self._making.has_code_of_users
        self._division = self._present()

    def loader(self, **options: Any) -> DataLoader:
        """What loads the batches of each pass that is begun; its workers stay."""
        if self._workers:
            return DataLoader(
                self._making,
                batch_sampler=self,  # type: ignore[arg-type]  # declared as one of lists
                num_workers=self._workers,
                persistent_workers=True,
                worker_init_fn=begin_worker,
                collate_fn=_as_it_is,
                **options,
            )
        read_ahead = self._reads_only and not self.in_thread and not self._making.theirs
        return DataLoader(_Pass(self, self._making, read_ahead), batch_size=None, collate_fn=_as_it_is, **options)

    def __len__(self) -> int:
        return len(self._cuts(0, self._present()))

    def __iter__(self) -> Iterator[Turn]:
        """The numbers of each batch of the pass that was begun."""
        numbers, epoch = self._division.garments(self._start), self.epoch(self._start)
        return (Turn(epoch, list(islice(numbers, self._batch_size))) for _ in self._cuts(self._start, self._division))

    def epoch(self, place: int) -> int:
        return self._sampler.order.epoch(place)

    def state(self, place: int) -> dict[str, Any]:
        return self._sampler.order.state(place)

    def place_of(self, state: Mapping[str, Any]) -> int:
        return self._sampler.order.position_of(state)

    def anew(self, place: int) -> int:
        return self._sampler.order.anew(place)

    def begin(self, place: int) -> int:
        """The next epoch's beginning if no batch is left in this one; with the ranks that there are by now."""
        self._division = self._present()
        self._start = place if self._cuts(place, self._division) else self._sampler.order.end(place)
        return self._start

    def after(self, start: int, number: int) -> int:
        """The position after batch ``number``, from 1, of a pass; the epoch's end after the last."""
        done = number >= len(self._cuts(start, self._division))
        return self._sampler.order.end(start) if done else self._division.after(start, number * self._batch_size)

    def finished(self, place: int) -> int:
        return place

    def marked(self, batch: Any, start: int, number: int) -> Any:
        """The batch; if it is a dict, ``repeated`` tells which of its garments only fill up."""
        if self._sampler.pad == "repeat" and isinstance(batch, MutableMapping):
            positions = self._division.share(start)[(number - 1) * self._batch_size : number * self._batch_size]
            end = self._sampler.order.end(start)
            batch["repeated"] = torch.tensor([position >= end for position in positions])
        return batch

    def _present(self) -> RankShare:
        """How garments are shared out as things stand now. Raises ``ConfigError`` if no rank has a batch."""
        division = self._sampler.division()
        if not self._cuts(0, division):
            raise ConfigError(
                f"no rank has {self._batch_size} of {self._sampler.order.length} garments: leave out drop_last"
            )
        return division

    def _cuts(self, start: int, division: RankShare) -> range:
        """Where in a rank's share each batch begins."""
        own = len(division.share(start))
        return range(0, own // self._batch_size * self._batch_size if self._drop_last else own, self._batch_size)


class Making(Dataset):
    """Batches of a data set, by turns; its errors say which garments they came up with.

    What is read or made by this package may be so anywhere. Code of users gets random numbers of its own, which depend
    on seed, epoch and garment: they are the same with any number of workers, and the model's are left alone.
    """

    def __init__(self, dataset: Dataset, collate_fn: Collate, seed: int) -> None:
        self._plain, self._change = parted(dataset)
        self._collate, self._seed = collate_fn, seed
        self.theirs = not is_ours(type(self._plain))
        """Whether all that makes an item is code of users."""
        self.has_code_of_users = self.theirs or self._change is not None or not is_ours(collate_fn)

    def __getitems__(self, turn: Turn) -> Any:
        """The batch of a turn, as a ``DataLoader`` asks a worker for it; or the error that it meets."""
        try:
            return self.finish(turn, self.read(turn))
        except GcdError as error:
            return told(error)

    def read(self, turn: Turn) -> list[Any]:
        """The items of a turn, without what users make of them."""
        if not self.theirs:
            return items_of(self._plain, turn.numbers)
        with own_chance() as chance:
            if hasattr(self._plain, "__getitems__"):
                chance.begin(self._seed, *turn.numbers[:1], turn.epoch)
                return items_of(self._plain, turn.numbers)
            items = []
            for number in turn.numbers:
                chance.begin(self._seed, number, turn.epoch)
                items += items_of(self._plain, [number])
            return items

    def finish(self, turn: Turn, items: list[Any]) -> Any:
        """The items as a batch."""
        if not self.has_code_of_users:
            return self._collate(items)
        with own_chance() as chance:
            if self._change is not None:
                items = list(items)
                for place, number in enumerate(turn.numbers):
                    chance.begin(self._seed, number, turn.epoch)
                    items[place] = self._change(items[place], number)
            chance.begin(self._seed, *turn.numbers[:1], turn.epoch, len(items))
            return self._collate(items)


class _Pass(IterableDataset):
    """The batches of the pass that was begun; ``ahead``: their garments are read by a thread meanwhile."""

    def __init__(self, turns: ByNumber, making: Making, ahead: bool) -> None:
        self._turns, self._making, self._ahead = turns, making, ahead

    def __iter__(self) -> Iterator[Any]:
        read = ((turn, self._making.read(turn)) for turn in self._turns)
        with closing(prefetch(read, AHEAD, wait=True)) if self._ahead else nullcontext(read) as items:
            for turn, there in items:
                yield self._making.finish(turn, there)


class At(NamedTuple):
    """A place in a stream."""

    epoch: int
    """Passes before this one."""
    position: int
    """Items of this pass that all ranks together have received."""


class Streamed(IterableDataset):
    """Every ``world_size``-th item of a stream, from any position on.

    A stream with ``begin_at``, as ``FreshGarments``, begins at any item, counted from the first pass on. Others are
    read from their beginning, and told the pass if they have ``set_epoch``.
    """

    in_thread = False  # it may be code of users
    first = At(0, 0)

    def __init__(
        self,
        stream: IterableDataset,
        batch_size: int,
        collate_fn: Collate,
        rank: int | None,
        world_size: int | None,
        *,
        seed: int,
        drop_last: bool,
    ) -> None:
        self._stream, self._batch_size, self._drop_last = stream, batch_size, drop_last
        self._collate, self._seed = collate_fn, seed
        self._given = require_rank(rank, world_size)
        self._ranks = self._present()
        self._named = named(stream)
        self._reached = self.first

    def loader(self, **options: Any) -> DataLoader:
        """What loads the batches of each pass that is begun."""
        return DataLoader(self, batch_size=None, collate_fn=_as_it_is, **options)

    def __len__(self) -> int:
        own = self._length() // self._present()[1]
        return own // self._batch_size if self._drop_last else -(-own // self._batch_size)

    def __iter__(self) -> Iterator[Any]:
        """This rank's batches of the pass that was begun; of the next if none are left."""
        begun = self._reached
        for start in dict.fromkeys((begun, self.anew(begun))):
            self._reached, items = start, self._items(start)
            while (batch := self._next(items)) is not None:
                yield batch
            if self._reached != start:
                return

    def epoch(self, place: At) -> int:
        return place.epoch

    def state(self, place: At) -> dict[str, Any]:
        return {**place._asdict(), **self._named}

    def place_of(self, state: Mapping[str, Any]) -> At:
        position = position_of(state, {}, self._named)
        return At(require_whole("epoch", state.get("epoch", 0)), position)

    def anew(self, place: At) -> At:
        return At(place.epoch + 1, 0) if place.position else place

    def begin(self, place: At) -> At:
        """The next pass if there is nothing left of this one."""
        if hasattr(self._stream, "begin_at") and place.position >= self._length():
            place = self.anew(place)
        self._ranks, self._reached = self._present(), place
        return place

    def after(self, start: At, number: int) -> At:
        """The place after the last batch that was made: none is made ahead."""
        return self._reached

    def finished(self, place: At) -> At:
        """The beginning of the next pass."""
        return At(place.epoch + 1, 0)

    def marked(self, batch: Any, start: At, number: int) -> Any:
        return batch

    def _present(self) -> tuple[int, int]:
        return self._given or present_rank()

    def _length(self) -> int:
        """Items of a pass. Raises ``TypeError`` for a stream that does not tell."""
        if not isinstance(self._stream, Sized):
            raise TypeError("a stream has no length")
        return len(self._stream)

    def _items(self, start: At) -> Iterator[Any]:
        """The stream's items of a pass from a position on."""
        with own_chance() as chance:
            chance.begin(self._seed, start.epoch)
            if callable(begin_at := getattr(self._stream, "begin_at", None)):
                return iter(begin_at(start.epoch * self._length() + start.position))
            if callable(set_epoch := getattr(self._stream, "set_epoch", None)):
                set_epoch(start.epoch)
            items = iter(self._stream)
            for position in range(start.position):
                chance.begin(self._seed, start.epoch, position)
                if next(items, END) is END:
                    break
            return items

    def _next(self, items: Iterator[Any]) -> Any:
        """The next batch of this rank; ``None`` at the end."""
        rank, world_size = self._ranks
        own: list[Any] = []
        with own_chance() as chance:
            while len(own) < self._batch_size:
                turn: list[Any] = []
                for position in range(self._reached.position, self._reached.position + world_size):
                    chance.begin(self._seed, self._reached.epoch, position)
                    turn += islice(items, 1)
                if len(turn) < world_size:
                    break
                self._reached = self._reached._replace(position=self._reached.position + world_size)
                own.append(turn[rank])
            if not own or (self._drop_last and len(own) < self._batch_size):
                return None
            chance.begin(self._seed, *self._reached, len(own))
            return self._collate(own)


def _as_it_is(batch: Any) -> Any:
    return batch
