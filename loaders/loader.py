"""Batches of garments that a training run, stopped at any moment, goes on with: nothing lost, nothing repeated."""

from collections.abc import Generator, Iterator, Mapping, Sized
from contextlib import closing, nullcontext
from functools import partial
from typing import Any, cast

import torch
from torch.utils.data import Dataset, IterableDataset

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, natural
from gcd_dataset.loaders.batch_plan import AHEAD, BatchPlan, ByNumber, Collate, Cursor, Streamed
from gcd_dataset.loaders.collate import collate_packed
from gcd_dataset.loaders.order import ElasticSampler, Pad
from gcd_dataset.loaders.worker import received
from gcd_dataset.prefetch import prefetch

__all__ = ["GarmentLoader"]


class GarmentLoader:
    """Batches in an order that depends on ``seed``, epoch and position alone; each ``iter()`` is the next epoch.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> loader = GarmentLoader(FakeGarments(10, fields=["meta"]), batch_size=4)
    >>> [[meta["index"] for meta in batch["meta"]] for batch in loader]
    [[9, 7, 8, 3], [4, 5, 6, 0], [1, 2]]
    >>> loader.epoch, loader.state_dict()["position"]
    (1, 10)

    - ``state_dict()`` counts the batches that the loop has received, whatever workers have made ahead. A loader with
      another number of ranks or workers or another ``batch_size`` takes it: what is left of the epoch comes, once.
    - ``iter()`` begins an epoch: the first, then those that follow, also after a loop that broke off. After
      ``load_state_dict`` it begins where that state was, as ``loader.load_state_dict(loader.state_dict())`` has a loop
      go on that broke off. Only the last iterator begun gives batches.
    - ``batch_size`` is that of this rank; ranks get equally many garments, so that none waits for another. ``rank``,
      ``world_size`` and ``pad`` are those of ``ElasticSampler``: where they are not given, each ``iter()`` looks them
      up. With ``pad="repeat"`` a batch that is a dict holds ``repeated``, bool [B]: the garments that only fill up.
      ``drop_last`` leaves out each rank's last, smaller batch.
    - ``num_workers=0``: what is only read is read by a thread beside the loop, two batches ahead. Worker processes cost
      more than reading does; they are for garments that are made, and for transforms that take long. They stay from
      epoch to epoch.
    - A ``transform``, an ``augment`` and a ``collate_fn`` of yours run in the loop's thread or in worker processes.
      What they draw from ``torch.rand`` (on the CPU), ``numpy.random`` and ``random`` depends on ``seed``, epoch and
      garment, that of a ``collate_fn`` on the batch, and takes nothing from what the model draws. A data set that is
      asked for whole batches (``__getitems__``), such as a ``Subset`` or a subclass, draws by batch.
    - A transform that fails raises ``TransformError`` with key and data set. Any other error of a garment has a note.
    - On a machine with a GPU batches lie in pinned memory.
    - An ``IterableDataset`` comes as it does, cut to this rank's share: it has to give the same on every rank, is read
      from its beginning to go on, and takes ``shuffle=False``, no workers and no ``pad``. ``FreshGarments`` go on
      without what came before. Garments with ``streaming=True`` are read by number all the same.

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
        if not callable(collate_fn):
            raise ConfigError(f"collate_fn={collate_fn!r:.99}: give a function that takes a list of items")
        self._plan: BatchPlan
        if isinstance(dataset, IterableDataset) and not isinstance(dataset, Garments):
            _require_stream_options(shuffle, num_workers, pad)
            seed = natural("seed", seed)
            self._plan = Streamed(dataset, batch_size, collate_fn, rank, world_size, seed=seed, drop_last=drop_last)
        else:
            sized = cast(Sized, dataset)  # torch declares no length
            sampler = ElasticSampler(sized, shuffle=shuffle, seed=seed, rank=rank, world_size=world_size, pad=pad)
            self._plan = ByNumber(
                sampler, dataset, batch_size, collate_fn, drop_last=drop_last, num_workers=num_workers
            )
        self._batches = self._plan.loader(
            pin_memory=torch.cuda.device_count() > 0,
            # Of its own: a ``DataLoader`` without one draws from the caller's random numbers.
            generator=torch.Generator().manual_seed(seed % (1 << 63)),
        )
        self._place: Cursor = self._plan.first
        self._begun, self._loaded = 0, False

    def __len__(self) -> int:
        """Batches of a whole epoch. Raises ``TypeError`` for a stream that has no length."""
        return len(self._plan)

    def __repr__(self) -> str:
        position = self.state_dict()["position"]
        return f"GarmentLoader({self.dataset!r}, batch_size={self.batch_size}, position {position})"

    @property
    def epoch(self) -> int:
        """The epoch that the loop has come to, from 0; after its last batch the next."""
        return self._plan.epoch(self._place)

    def state_dict(self) -> dict[str, Any]:
        """Seed, shuffle, length and data set, which name the order, and the position in it: garments of all ranks."""
        return self._plan.state(self._place)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self._place, self._loaded = self._plan.place_of(state), True
        self._begun += 1

    def __iter__(self) -> Iterator[Any]:
        """The batches of an epoch, or what is left of that of the state that was loaded."""
        self._begun += 1
        return self._received(self._begun)

    def _received(self, begun: int) -> Iterator[Any]:
        """Batches, the place moved on with each; an error where another iterator or a state has come between."""
        self._require_last(begun)
        start = self._plan.begin(self._place if self._loaded else self._plan.anew(self._place))
        source = iter(self._batches)
        with closing(_ahead(source)) if self._plan.in_thread else nullcontext(source) as batches:
            for number, batch in enumerate(map(received, batches), 1):
                self._place, self._loaded = self._plan.after(start, number), False
                yield self._plan.marked(batch, start, number)
                self._require_last(begun)
        self._place = self._plan.finished(self._place)

    def _require_last(self, begun: int) -> None:
        if begun != self._begun:
            raise ConfigError(
                "an iterator that another iter() or load_state_dict() has come after: take batches from the last one"
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
    return prefetch(batches, AHEAD, begin=None if gpu is None else partial(torch.cuda.set_device, gpu), wait=True)
