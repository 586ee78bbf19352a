"""What a ``GarmentLoader`` hands out, and where that leaves it: garments by number, or as a stream gives them."""

from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from itertools import islice
from typing import Any, Protocol

import torch
from torch.utils.data import DataLoader, Dataset, IterableDataset

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import items_of
from gcd_dataset.loaders.order import ElasticSampler, identity_of, position_of, rank_of
from gcd_dataset.loaders.worker import begin_worker

__all__ = ["ByNumber", "Plan", "Streamed"]


class Plan(Protocol):
    """The batches of this rank from any position on."""

    def loader(self, *, num_workers: int, **options: Any) -> DataLoader:
        """What loads the batches of each pass that is begun."""

    def __len__(self) -> int:
        """Batches of a whole epoch."""

    def epoch(self, position: int) -> int:
        """The epoch of a position."""

    def state(self, position: int) -> dict[str, Any]:
        """A position, with what names the order that it is one of."""

    def position_of(self, state: Mapping[str, Any]) -> int:
        """The position in a state. Raises ``ConfigError`` for the state of another order."""

    def begin(self, position: int) -> int:
        """Where the next pass starts, for somebody who has come to ``position``."""

    def after(self, start: int, number: int) -> int:
        """The position after batch ``number``, from 1, of a pass."""

    def finished(self, position: int) -> int:
        """The position after the last batch."""

    def marked(self, batch: Any, start: int, number: int) -> Any:
        """The batch, with what the plan has to say of it."""


class ByNumber:
    """Batches of a sampler's share, each as many numbers: a batch sampler."""

    def __init__(self, sampler: ElasticSampler, dataset: Dataset, batch_size: int, *, drop_last: bool) -> None:
        self._sampler, self._dataset = sampler, dataset
        self._batch_size, self._drop_last, self._start = batch_size, drop_last, 0
        if not len(self):
            raise ConfigError(f"no rank has {batch_size} of {sampler.order.length} garments: leave out drop_last")

    def loader(self, *, num_workers: int, **options: Any) -> DataLoader:
        """What loads the batches of each pass that is begun; its workers stay."""
        named, stay = _Named(self._dataset), num_workers > 0
        return DataLoader(
            named,
            batch_sampler=self,
            num_workers=num_workers,
            persistent_workers=stay,
            worker_init_fn=begin_worker,
            **options,
        )

    def __len__(self) -> int:
        return len(self._cuts(0))

    def __iter__(self) -> Iterator[list[int]]:
        """The numbers of each batch of the pass that was begun."""
        numbers = self._sampler.garments(self._start)
        return (list(islice(numbers, self._batch_size)) for _ in self._cuts(self._start))

    def epoch(self, position: int) -> int:
        return position // self._sampler.order.length

    def state(self, position: int) -> dict[str, Any]:
        return self._sampler.order.state(position)

    def position_of(self, state: Mapping[str, Any]) -> int:
        return self._sampler.order.position_of(state)

    def begin(self, position: int) -> int:
        """The next epoch's beginning if no batch is left in this one."""
        self._start = position if self._cuts(position) else self._sampler.order.end(position)
        return self._start

    def after(self, start: int, number: int) -> int:
        """The position after batch ``number``, from 1, of a pass; the epoch's end after the last."""
        done = number >= len(self._cuts(start))
        return self._sampler.order.end(start) if done else self._sampler.after(start, number * self._batch_size)

    def finished(self, position: int) -> int:
        return position

    def marked(self, batch: Any, start: int, number: int) -> Any:
        """The batch; if it is a dict, ``repeated`` tells which of its garments only fill up."""
        if self._sampler.pad == "repeat" and isinstance(batch, MutableMapping):
            positions = self._sampler.share(start)[(number - 1) * self._batch_size : number * self._batch_size]
            end = self._sampler.order.end(start)
            batch["repeated"] = torch.tensor([position >= end for position in positions])
        return batch

    def _cuts(self, start: int) -> range:
        """Where in this rank's share each batch begins."""
        own = len(self._sampler.share(start))
        return range(0, own // self._batch_size * self._batch_size if self._drop_last else own, self._batch_size)


class Streamed(IterableDataset):
    """Every ``world_size``-th item of a stream, from any position on; a position counts items of one pass.

    A stream with ``begin_at`` has epochs, as ``FreshGarments`` does: there it counts those of all epochs.
    """

    def __init__(
        self, stream: IterableDataset, batch_size: int, rank: int | None, world_size: int | None, *, drop_last: bool
    ) -> None:
        self._stream, self._batch_size, self._drop_last = stream, batch_size, drop_last
        self._rank, self._world_size = rank_of(rank, world_size)
        self._start = self._reached = 0

    def loader(self, *, num_workers: int, **options: Any) -> DataLoader:
        """What loads the batches of each pass that is begun."""
        return DataLoader(self, batch_size=self._batch_size, drop_last=self._drop_last, **options)

    def __len__(self) -> int:
        raise TypeError("a stream has no length")

    def __iter__(self) -> Iterator[Any]:
        """This rank's items of the pass that was begun; from the stream's beginning if none are left."""
        for start in dict.fromkeys((self._start, self.finished(self._start))):
            self._reached, items = start, self._from(start)
            while len(turn := list(islice(items, self._world_size))) == self._world_size:
                self._reached += self._world_size
                yield turn[self._rank]
            if self._reached > start:
                return

    def _from(self, position: int) -> Iterator[Any]:
        """The items of the stream from a position on: without those before it, where the stream can do that."""
        if self._epoch_length is None:
            return islice(iter(self._stream), position, None)
        return self._stream.begin_at(position)  # type: ignore[attr-defined]

    @property
    def _epoch_length(self) -> int | None:
        """Items of an epoch, of a stream that begins at any position of any epoch."""
        return len(self._stream) if hasattr(self._stream, "begin_at") else None  # type: ignore[arg-type]

    def epoch(self, position: int) -> int:
        if (length := self._epoch_length) is None:
            raise TypeError("a stream has no epochs")
        return position // max(length, 1)

    def state(self, position: int) -> dict[str, Any]:
        return {"position": position, **self._names()}

    def position_of(self, state: Mapping[str, Any]) -> int:
        return position_of(state, self._names())

    def begin(self, position: int) -> int:
        self._start = position
        return position

    def after(self, start: int, number: int) -> int:
        """The position after the last batch that was made: none is made ahead."""
        return self._reached

    def finished(self, position: int) -> int:
        """The beginning of the next pass."""
        length = self._epoch_length
        return 0 if length is None else -(-position // max(length, 1)) * length

    def marked(self, batch: Any, start: int, number: int) -> Any:
        return batch

    def _names(self) -> dict[str, Any]:
        return {"dataset": identity_of(self._stream)}


class _Named(Dataset):
    """A data set whose errors say which garments they came up with."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        return items_of(self._dataset, indices)
