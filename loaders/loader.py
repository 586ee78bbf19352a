"""``GarmentLoader``: resumable batches; after any interruption no garment is lost or repeated."""

from collections.abc import Generator, Iterable, Iterator, Mapping, Sized
from contextlib import closing, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import torch
from torch.utils.data import Dataset, IterableDataset

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, require_callable, require_integer
from gcd_dataset.loaders.batch_plan import BATCHES_AHEAD, BatchPlan, Collate, Cursor, IndexedPlan, StreamPlan
from gcd_dataset.loaders.collate import collate_packed
from gcd_dataset.loaders.order import ElasticSampler, Pad
from gcd_dataset.loaders.worker import unwrap
from gcd_dataset.prefetch import prefetch

if TYPE_CHECKING:
    from gcd_dataset.loaders.views import Views


class GarmentLoader:
    """Batches in an order that depends on ``seed``, epoch and position alone; each ``iter()`` is the next epoch.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> loader = GarmentLoader(FakeGarments(10, fields=["meta"]), batch_size=4)
    >>> [[meta["index"] for meta in batch["meta"]] for batch in loader]
    [[9, 7, 8, 3], [4, 5, 6, 0], [1, 2]]
    >>> loader.epoch, loader.state_dict()["position"]
    (1, 10)

    - ``state_dict()`` counts the batches that the training loop has received, not those prefetched by workers. A loader
      with another number of ranks or workers or another ``batch_size`` can load the state: the rest of the epoch
      follows, each garment once.
    - Each ``iter()`` begins the next epoch, also after a loop that ended early. After ``load_state_dict`` it yields the
      rest of the state's epoch; to continue a loop that ended early, call
      ``loader.load_state_dict(loader.state_dict())``. Only the most recent iterator yields batches.
    - ``batch_size`` is per rank; all ranks get equally many garments, so none waits for another. ``rank``,
      ``world_size`` and ``pad`` are those of ``ElasticSampler``; if not given, each ``iter()`` looks them up. With
      ``pad="repeat"`` a batch that is a dict holds ``repeated``, bool [B]: true for garments that are repeated.
      ``drop_last`` leaves out each rank's last, smaller batch.
    - ``views``: pictures of each garment, rendered while the training works: on a CPU with workers in these, after
      transforms and before ``collate_fn``; otherwise by a thread of this process, from batches of ``collate_packed``,
      ``collate_padded`` or ``collate_list``.
    - ``num_workers=0``: a thread reads stored garments, two batches ahead of the loop. Worker processes cost more than
      reading does; use them for generated garments and slow transforms. They persist over epochs.
    - Your ``transform``, ``augment`` and ``collate_fn`` run in the training thread or in worker processes. Their draws
      from ``torch.rand`` (on the CPU), ``numpy.random`` and ``random`` depend on ``seed``, epoch and garment (for
      ``collate_fn``: on the batch), and leave the model's random state alone. A data set with ``__getitems__``, such as
      a ``Subset`` or a subclass, is seeded per batch.
    - A transform that fails raises ``TransformError`` with key and data set. Any other error carries a note that names
      the garment.
    - It has no ``pin_memory``: batches are in pinned memory on a machine with a GPU. No ``sampler``: a state must be
      able to resume the order; ``select`` chooses or repeats garments; a ``DataLoader`` takes ``ElasticSampler``. No
      ``generator``: ``seed`` decides. No ``set_epoch``: each ``iter()`` is the next epoch on every rank.
    - An ``IterableDataset`` is read in its own order and split over ranks: it must yield the same items on every rank,
      is read again from its beginning to resume, and requires ``shuffle=False``, no workers and no ``pad``.
      ``FreshGarments`` resumes without making the earlier garments. A ``GarmentDataset`` with ``streaming=True`` is an
      exception: the loader reads it by index.

    Raises ``ConfigError`` for options that do not fit together, and for full shared memory.
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
        views: "Views | None" = None,
    ) -> None:
        self.dataset, self.batch_size = dataset, require_integer("batch_size", batch_size, least=1)
        num_workers = require_integer("num_workers", num_workers)
        require_callable("collate_fn", collate_fn, "items")
        _require_views(views)
        in_workers = views if views is not None and views.device == "cpu" and num_workers else None
        self._views = None if in_workers is not None else views
        self._plan: BatchPlan
        if isinstance(dataset, IterableDataset) and not isinstance(dataset, Garments):
            _require_stream_options(shuffle, num_workers, pad)
            seed = require_integer("seed", seed)
            self._plan = StreamPlan(dataset, batch_size, collate_fn, rank, world_size, seed=seed, drop_last=drop_last)
        else:
            sized = cast(Sized, dataset)  # torch declares no length
            sampler = ElasticSampler(sized, shuffle=shuffle, seed=seed, rank=rank, world_size=world_size, pad=pad)
            self._plan = IndexedPlan(
                sampler,
                dataset,
                batch_size,
                collate_fn,
                drop_last=drop_last,
                num_workers=num_workers,
                views=in_workers,
            )
        self._batches = self._plan.loader(
            pin_memory=torch.cuda.device_count() > 0,
            # A generator of its own: without one, ``DataLoader`` draws from torch's global stream.
            generator=torch.Generator().manual_seed(seed % (1 << 63)),
        )
        self._cursor: Cursor = self._plan.first
        self._iterator, self._is_loaded = 0, False  # number of the valid iterator; whether to resume a loaded state

    def __len__(self) -> int:
        """Batches of a whole epoch. Raises ``TypeError`` for a stream without a length."""
        return len(self._plan)

    def __repr__(self) -> str:
        position = self.state_dict()["position"]
        return f"GarmentLoader({self.dataset!r}, batch_size={self.batch_size}, position {position})"

    @property
    def epoch(self) -> int:
        """The epoch of the next batch, from 0."""
        return self._plan.epoch(self._cursor)

    def state_dict(self) -> dict[str, Any]:
        """The position, in garments of all ranks, with seed, shuffle, length and data set, which identify the order."""
        return self._plan.state(self._cursor)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Resume from a state at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self._cursor, self._is_loaded = self._plan.cursor_in(state), True
        self._iterator += 1

    def __iter__(self) -> Iterator[Any]:
        """The batches of the next epoch, or of the rest of the loaded state's epoch."""
        self._iterator += 1
        return self._batches_of(self._iterator)

    def _batches_of(self, iterator: int) -> Iterator[Any]:
        """Batches of a pass; moves the cursor. Raises ``ConfigError`` once a newer iterator or state exists."""
        self._require_valid(iterator)
        start = self._plan.begin(self._cursor if self._is_loaded else self._plan.next_pass(self._cursor))
        source = iter(self._batches)
        with closing(_prefetched(source)) if self._plan.runs_in_thread else nullcontext(source) as batches:
            numbered = enumerate(map(unwrap, batches), 1)
            made = ((_Made(number, self._plan.after(start, number)), batch) for number, batch in numbered)
            with closing(made if self._views is None else self._with_views(self._views, made, start)) as finished:
                for (number, cursor), batch in finished:
                    self._cursor, self._is_loaded = cursor, False
                    yield self._plan.annotate(batch, start, number)
                    self._require_valid(iterator)
        self._cursor = self._plan.after_last(self._cursor)

    def _with_views(
        self, views: "Views", made: Iterable[tuple["_Made", Any]], start: Cursor
    ) -> Generator[tuple["_Made", Any]]:
        """The batches with their pictures; threads render ahead of the loop."""
        from gcd_dataset.loaders.views import garments_in, render_ahead

        return render_ahead(
            views,
            ((tag, batch, self._plan.uses(start, tag.number, garments_in(batch))) for tag, batch in made),
        )

    def _require_valid(self, iterator: int) -> None:
        if iterator != self._iterator:
            raise ConfigError(
                "this iterator ended with a later iter() or load_state_dict(): take batches from the last one"
            )


class _Made(NamedTuple):
    """Number of a batch in its pass, from 1, and the cursor after it."""

    number: int
    cursor: Cursor


def _require_stream_options(shuffle: bool, num_workers: int, pad: Pad) -> None:
    """Raise ``ConfigError`` for options that a stream does not support."""
    if shuffle:
        raise ConfigError("shuffle=True: a stream has its own order: give shuffle=False, or an indexable data set")
    if num_workers:
        raise ConfigError(f"num_workers={num_workers}: each worker would read the whole stream: give num_workers=0")
    if pad != "none":
        raise ConfigError(f"pad={pad!r}: a stream cannot repeat its first items to fill up: leave it out for a stream")


def _require_views(views: Any) -> None:
    """Raise ``ConfigError`` unless this is ``Views`` or ``None``."""
    if views is not None:
        from gcd_dataset.loaders.views import Views

        if not isinstance(views, Views):
            raise ConfigError(f"views={views!r:.99}: give Views(…), or leave it out")


def _prefetched(batches: Iterator[Any]) -> Generator[Any]:
    """The same batches, made by a thread while the caller works."""
    # A new thread's current device is GPU 0; pinning memory would then open a CUDA context on another rank's GPU.
    gpu = torch.cuda.current_device() if torch.cuda.is_initialized() else None  # type: ignore[no-untyped-call]
    return prefetch(
        batches, BATCHES_AHEAD, begin=None if gpu is None else partial(torch.cuda.set_device, gpu), wait=True
    )
