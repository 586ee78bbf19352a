"""Batches of garments that a training run, stopped at any moment, goes on with: nothing lost, nothing repeated."""

from collections.abc import Callable, Generator, Iterator, Mapping, Sized
from contextlib import closing, nullcontext
from functools import partial
from typing import Any, cast

import torch
from torch.utils.data import Dataset, IterableDataset

from gcd_dataset.by_thread import by_thread
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, natural
from gcd_dataset.loaders.collate import collate_packed
from gcd_dataset.loaders.order import ElasticSampler, Pad
from gcd_dataset.loaders.plan import ByNumber, Plan, Streamed

__all__ = ["GarmentLoader"]

Collate = Callable[[list[Any]], Any]

AHEAD = 2  # batches


class GarmentLoader:
    """Batches in an order that depends on ``seed``, epoch and position alone; ``iter()`` goes on where the last ended.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> loader = GarmentLoader(FakeGarments(10, fields=["meta"]), batch_size=4)
    >>> [[meta["index"] for meta in batch["meta"]] for batch in loader]
    [[9, 7, 8, 3], [4, 5, 6, 0], [1, 2]]
    >>> loader.epoch, loader.state_dict()["position"]
    (1, 10)

    - ``state_dict()`` counts the batches that the loop has received, whatever workers have made ahead. A loader with
      another number of ranks or workers or another ``batch_size`` takes it: what is left of the epoch comes, once.
    - ``iter()`` ends with the epoch; after the last batch the state is that of the next epoch's beginning. A loop that
      breaks off and begins again gets the batches that follow. Only the last iterator begun gives batches.
    - ``batch_size`` is that of this rank; ranks get equally many garments, so that none waits for another. ``rank``,
      ``world_size`` and ``pad`` are those of ``ElasticSampler``. With ``pad="repeat"`` a batch that is a dict holds
      ``repeated``, bool [B]: the garments that only fill up. ``drop_last`` leaves out each rank's last, smaller batch.
    - ``num_workers=0``: what is only read is read by a thread beside the loop, with the transform; two batches ahead.
      Worker processes cost more than reading does; they are for garments that are made. They stay from epoch to epoch.
    - A garment that cannot be loaded is named in a note on the error.
    - On a machine with a GPU batches lie in pinned memory.
    - An ``IterableDataset`` comes as it does, cut to this rank's share: it has to give the same on every rank, is read
      from its beginning to go on, and takes ``shuffle=False``, no workers and no ``pad``. Garments with
      ``streaming=True`` are read by number all the same: their shards need not be shared out evenly.

    Raises ``ConfigError`` for options that do not fit together.
    """

    def __init__(
        self,
        dataset: Dataset,
        batch_size: int,
        *,
        shuffle: bool = True,
        seed: int = 0,
        num_workers: int = 0,
        collate_fn: Collate = collate_packed,
        rank: int | None = None,
        world_size: int | None = None,
        drop_last: bool = False,
        pad: Pad = "none",
    ) -> None:
        self.dataset, self.batch_size = dataset, natural("batch_size", batch_size, least=1)
        num_workers = natural("num_workers", num_workers)
        self._plan: Plan
        if isinstance(dataset, IterableDataset) and not isinstance(dataset, Garments):
            _require_stream_options(shuffle, num_workers, pad)
            self._plan = Streamed(dataset, batch_size, rank, world_size, drop_last=drop_last)
        else:
            sized = cast(Sized, dataset)  # torch declares no length
            sampler = ElasticSampler(sized, shuffle=shuffle, seed=seed, rank=rank, world_size=world_size, pad=pad)
            self._plan = ByNumber(sampler, dataset, batch_size, drop_last=drop_last)
        self._batches = self._plan.loader(
            num_workers=num_workers,
            collate_fn=collate_fn,
            pin_memory=torch.cuda.device_count() > 0,
            # Of its own: a ``DataLoader`` without one draws from the caller's random numbers.
            generator=torch.Generator().manual_seed(seed),
        )
        self._in_thread = num_workers == 0 and isinstance(dataset, Garments) and dataset.reads_only
        self._position, self._begun = 0, 0

    def __len__(self) -> int:
        """Batches of a whole epoch. Raises ``TypeError`` for a stream."""
        return len(self._plan)

    @property
    def epoch(self) -> int:
        """The epoch of the next batch, from 0. Raises ``TypeError`` for a stream."""
        return self._plan.epoch(self._position)

    def state_dict(self) -> dict[str, Any]:
        """Seed, shuffle, length and data set, which name the order, and the position in it: garments of all ranks."""
        return self._plan.state(self._position)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self._position = self._plan.position_of(state)
        self._begun += 1

    def __iter__(self) -> Iterator[Any]:
        """The batches from the present position to the end of the epoch."""
        self._begun += 1
        return self._received(self._begun)

    def _received(self, begun: int) -> Iterator[Any]:
        """Batches, the position raised with each; an error where another iterator or a state has come between."""
        self._require_last(begun)
        start = self._plan.begin(self._position)
        source = iter(self._batches)
        with closing(_ahead(source)) if self._in_thread else nullcontext(source) as batches:
            for number, batch in enumerate(batches, 1):
                self._position = self._plan.after(start, number)
                yield self._plan.marked(batch, start, number)
                self._require_last(begun)
        self._position = self._plan.finished(self._position)

    def _require_last(self, begun: int) -> None:
        if begun != self._begun:
            raise ConfigError(
                "an iterator that another iter() or load_state_dict() has come after: call iter() again, it goes on "
                "from the loader's state"
            )


def _require_stream_options(shuffle: bool, num_workers: int, pad: Pad) -> None:
    """Raise ``ConfigError`` for what cannot be had from a stream."""
    if shuffle:
        raise ConfigError("shuffle=True: a stream comes in its own order: give shuffle=False, or no stream")
    if num_workers:
        raise ConfigError(f"num_workers={num_workers}: each would read the whole stream: give num_workers=0")
    if pad != "none":
        raise ConfigError(f"pad={pad!r}: what has passed does not come again to fill up: leave it out for a stream")


def _ahead(batches: Iterator[Any]) -> Generator[Any]:
    """The same, made by a thread while the caller is at work."""
    # A thread starts on the first GPU, and pinning memory there would take some of it from another rank.
    gpu = torch.cuda.current_device() if torch.cuda.is_initialized() else None  # type: ignore[no-untyped-call]
    return by_thread(batches, AHEAD, begin=None if gpu is None else partial(torch.cuda.set_device, gpu), wait=True)
