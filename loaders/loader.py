"""``GarmentLoader``: resumable batches; after any interruption no garment is lost or repeated."""

import hashlib
import random
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, MutableMapping, Sequence, Sized
from contextlib import closing, nullcontext
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset, IterableDataset

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.loaders.base import Garments, UserCode, is_of_package, load_items, require_callable, require_integer
from gcd_dataset.loaders.batches import collate_list, collate_packed, collate_padded
from gcd_dataset.loaders.order import ElasticSampler, Pad, RankShare
from gcd_dataset.loaders.worker import begin_worker, require_semaphores, sent, unwrap, with_traceback
from gcd_dataset.workers import prefetch

if TYPE_CHECKING:
    from gcd_dataset.loaders.views import Views

Collate: TypeAlias = Callable[[list[Any]], Any]

COLLATES = (collate_list, collate_packed, collate_padded)
BATCHES_AHEAD = 2  # batches that a thread prefetches


# A *pass* is the rest of an epoch: one ``iter()`` of the loader. A *cursor* is how far the training loop has come: a
# position in the order. Each batch is made together with its ``Step``.


class Step(NamedTuple):
    """One batch of a pass."""

    cursor: int
    """The cursor after it; after the last batch the end of the epoch."""
    uses: list[int]
    """For each garment the number of its use: its epoch, or another number where an epoch may repeat a garment."""
    epoch: int = 0
    indices: Sequence[int] = ()
    repeated: list[bool] | None = None
    """With ``pad="repeat"``: whether a garment fills up the epoch."""


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
    - ``FreshGarments`` is the one stream that it takes, with ``shuffle=False``, no workers and no ``pad``; ranks get
      their shares of the garments, and a state resumes without making the earlier ones. A ``GarmentDataset`` with
      ``streaming=True`` is read by index.

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
        is_stream = isinstance(dataset, IterableDataset) and not isinstance(dataset, Garments)
        if is_stream:
            _require_stream(dataset, shuffle, num_workers, pad)
        sized = cast(Sized, dataset)  # torch declares no length
        sampler = ElasticSampler(sized, shuffle=shuffle, seed=seed, rank=rank, world_size=world_size, pad=pad)
        maker = (StreamMaker if is_stream else BatchMaker)(dataset, collate_fn, seed, in_workers)
        self._order = sampler.order
        self._source = Batches(sampler, maker, batch_size, drop_last=drop_last, num_workers=num_workers)
        self._batches = self._source.loader(
            pin_memory=torch.cuda.device_count() > 0,
            # A generator of its own: without one, ``DataLoader`` draws from torch's global stream.
            generator=torch.Generator().manual_seed(seed % (1 << 63)),
        )
        self._cursor = 0
        self._iterator, self._is_loaded = 0, False  # number of the valid iterator; whether to resume a loaded state

    def __len__(self) -> int:
        """Batches of a whole epoch."""
        return len(self._source)

    def __repr__(self) -> str:
        position = self.state_dict()["position"]
        return f"GarmentLoader({self.dataset!r}, batch_size={self.batch_size}, position {position})"

    @property
    def epoch(self) -> int:
        """The epoch of the next batch, from 0."""
        return self._order.epoch(self._cursor)

    def state_dict(self) -> dict[str, Any]:
        """The position, in garments of all ranks, with seed, shuffle, length and data set, which identify the order."""
        return self._order.state(self._cursor)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Resume from a state at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self._cursor, self._is_loaded = self._order.position_in(state), True
        self._iterator += 1

    def __iter__(self) -> Iterator[Any]:
        """The batches of the next epoch, or of the rest of the loaded state's epoch."""
        self._iterator += 1
        return self._batches_of(self._iterator)

    def _batches_of(self, iterator: int) -> Iterator[Any]:
        """Batches of a pass; moves the cursor. Raises ``ConfigError`` once a newer iterator or state exists."""
        self._require_valid(iterator)
        self._source.begin(self._cursor, is_loaded=self._is_loaded)
        source = iter(self._batches)
        with closing(_prefetched(source)) if self._source.runs_in_thread else nullcontext(source) as batches:
            made = (entry for entry in map(unwrap, batches))
            with closing(made if self._views is None else _with_views(self._views, made)) as finished:
                for step, batch in finished:
                    self._cursor, self._is_loaded = step.cursor, False
                    if step.repeated is not None and isinstance(batch, MutableMapping):
                        batch["repeated"] = torch.tensor(step.repeated)
                    yield batch
                    self._require_valid(iterator)

    def _require_valid(self, iterator: int) -> None:
        if iterator != self._iterator:
            raise ConfigError(
                "this iterator ended with a later iter() or load_state_dict(): take batches from the last one"
            )


def _with_views(views: "Views", made: Iterable[tuple[Step, Any]]) -> Generator[tuple[Step, Any]]:
    """The batches with their pictures; threads render ahead of the loop."""
    from gcd_dataset.loaders.views import garments_in, render_ahead

    return render_ahead(views, ((step, batch, step.uses[: garments_in(batch)]) for step, batch in made))


def _require_stream(stream: Dataset, shuffle: bool, num_workers: int, pad: Pad) -> None:
    """Raise ``ConfigError`` for a stream that cannot be resumed, and for options that a stream does not support."""
    if not hasattr(stream, "begin_at"):
        raise ConfigError(
            f"{type(stream).__name__} is a stream: give FreshGarments, a data set with indices, or use a DataLoader"
        )
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


class Batches:
    """The batches of an ``ElasticSampler``'s indices; also the ``batch_sampler`` of their loader."""

    def __init__(
        self, sampler: ElasticSampler, maker: "BatchMaker", batch_size: int, *, drop_last: bool, num_workers: int
    ) -> None:
        self._sampler, self._order, self._batch_size, self._drop_last = sampler, sampler.order, batch_size, drop_last
        self._maker, self._num_workers, self._reads_only = maker, num_workers, maker.reads_only
        self.runs_in_thread = self._reads_only and num_workers == 0 and not self._maker.has_user_code
        """Whether batches may be made in a thread beside the training: no users' code is involved."""
        self._rank_share, self.start = self._present_share(), 0

    def loader(self, **options: Any) -> DataLoader:
        """The ``DataLoader`` of ``(Step, batch)`` that serves all passes; its workers persist between them."""
        if self._num_workers:
            require_semaphores(self._num_workers)
            return DataLoader(
                self._maker,
                batch_sampler=self,  # type: ignore[arg-type]  # declared as yielding lists
                num_workers=self._num_workers,
                persistent_workers=True,
                worker_init_fn=begin_worker,
                collate_fn=_unchanged,
                **options,
            )
        read_ahead = self._reads_only and not self.runs_in_thread and not self._maker.is_user_dataset
        return DataLoader(_Pass(self, self._maker, read_ahead), batch_size=None, collate_fn=_unchanged, **options)

    def __len__(self) -> int:
        """Batches of a whole epoch."""
        return self._count(self._present_share().positions(0))

    def __iter__(self) -> Iterator[Step]:
        start, end, epoch = self.start, self._order.end(self.start), self._order.epoch(self.start)
        positions, indices = self._rank_share.positions(start), self._rank_share.indices(start)
        for number in range(1, self._count(positions) + 1):
            own = positions[(number - 1) * self._batch_size : number * self._batch_size]
            is_last = number == self._count(positions)
            cursor = end if is_last else self._rank_share.after(start, number * self._batch_size)
            repeated = [position >= end for position in own] if self._sampler.pad == "repeat" else None
            yield Step(cursor, self._order.uses(own, epoch), epoch, list(islice(indices, len(own))), repeated)

    def begin(self, cursor: int, *, is_loaded: bool) -> None:
        """Look up the ranks and begin a pass at a loaded cursor, otherwise at the start of the next epoch.

        A loaded cursor after which no batch is left also begins the next epoch.
        """
        start = cursor if is_loaded else self._order.next_pass(cursor)
        self._rank_share = self._present_share()
        self.start = start if self._count(self._rank_share.positions(start)) else self._order.end(start)

    def _present_share(self) -> RankShare:
        """The share of this process's rank, looked up now. Raises ``ConfigError`` if no rank has a whole batch."""
        rank_share = self._sampler.rank_share()
        if not self._count(rank_share.positions(0)):
            raise ConfigError(f"no rank has {self._batch_size} of {self._order.length} garments: leave out drop_last")
        return rank_share

    def _count(self, positions: Sequence[int]) -> int:
        """Batches of a pass over some positions."""
        whole, rest = divmod(len(positions), self._batch_size)
        return whole + (rest > 0 and not self._drop_last)


class BatchMaker(Dataset):
    """Makes a batch from its indices, in the training process or a worker; errors get a note that names the garments.

    Items of our own data sets are loaded without users' code. Users' code runs with the global
    random streams seeded by seed, epoch and index: the same with any number of workers, and the model's streams are
    untouched.
    """

    def __init__(self, dataset: Dataset, collate_fn: Collate, seed: int, views: "Views | None" = None) -> None:
        self._plain: Dataset = dataset
        self.reads_only = isinstance(dataset, Garments) and dataset.reads_only
        self._user_code: UserCode | None = None
        if isinstance(dataset, Garments):
            self._plain, self._user_code = dataset._separated()
        self._collate, self._seed, self._views = collate_fn, seed, views
        self.is_user_dataset = not is_of_package(type(self._plain))
        """Whether the data set's class is defined outside this package: users' code then makes the whole item."""
        is_user_collate = (collate_fn.func if isinstance(collate_fn, partial) else collate_fn) not in COLLATES
        self.has_user_code = self.is_user_dataset or self._user_code is not None or is_user_collate

    def begin(self, position: int) -> None:
        """Called at the start of a pass."""

    def __getitems__(self, step: Step) -> Any:
        """``(step, batch)``, as a ``DataLoader`` requests it from a worker; on failure the error, as a value."""
        try:
            batch = sent(self.finish(step, self.read(step)))
            return batch if isinstance(batch, GcdError) else (step, batch)
        except GcdError as error:
            return with_traceback(error)

    def read(self, step: Step) -> list[Any]:
        """Load the items, without users' transforms."""
        if not self.is_user_dataset:
            return load_items(self._plain, step.indices)
        with isolated_rng() as random_state:
            if hasattr(self._plain, "__getitems__"):
                random_state.seed(self._seed, *step.indices[:1], step.epoch)
                return load_items(self._plain, step.indices)
            items = []
            for index in step.indices:
                random_state.seed(self._seed, index, step.epoch)
                items += load_items(self._plain, [index])
            return items

    def finish(self, step: Step, items: list[Any]) -> Any:
        """Apply users' transforms, add views if they are rendered here, then collate."""
        if not self.has_user_code:
            return self._collate(self._with_views(step, items))
        with isolated_rng() as random_state:
            if self._user_code is not None:
                items = list(items)
                for row, index in enumerate(step.indices):
                    random_state.seed(self._seed, index, step.epoch)
                    items[row] = self._user_code(items[row], index)
            random_state.seed(self._seed, *step.indices[:1], step.epoch, len(items))
            return self._collate(self._with_views(step, items))

    def _with_views(self, step: Step, items: list[Any]) -> list[Any]:
        return items if self._views is None else self._views.add_to_items(items, step.uses)


class StreamMaker(BatchMaker):
    """Makes batches from a stream with ``begin_at``, whose indices are its positions."""

    def begin(self, position: int) -> None:
        stream: Any = self._plain
        with isolated_rng() as random_state:
            random_state.seed(self._seed, position)
            self._items, self._next = iter(stream.begin_at(position)), position

    def read(self, step: Step) -> list[Any]:
        """The items at the positions of a step. Skips the items of other ranks."""
        items = []
        with isolated_rng() as random_state:
            for position in step.indices:
                for passed in range(self._next, position + 1):
                    random_state.seed(self._seed, passed)
                    item = next(self._items)
                self._next = position + 1
                items.append(item)
        return items


class _Pass(IterableDataset):
    """The batches of the current pass, without workers; with ``read_ahead`` a thread reads the items."""

    def __init__(self, steps: Batches, maker: BatchMaker, read_ahead: bool) -> None:
        self._steps, self._maker, self._read_ahead = steps, maker, read_ahead

    def __iter__(self) -> Iterator[tuple[Step, Any]]:
        self._maker.begin(self._steps.start)
        read = ((step, self._maker.read(step)) for step in self._steps)
        with closing(prefetch(read, BATCHES_AHEAD, wait=True)) if self._read_ahead else nullcontext(read) as loaded:
            for step, items in loaded:
                yield step, self._maker.finish(step, items)


def _unchanged(batch: Any) -> Any:
    return batch


class isolated_rng:  # noqa: N801 -- a context manager, named as functions are
    """Context manager: saves the global random states of torch (CPU), NumPy and Python, and restores them on exit.

    After ``seed``, draws depend on its arguments alone. Enter it in the training thread: the streams are per process.

    >>> with isolated_rng() as random_state:
    ...     random_state.seed(0, 7)
    ...     first = torch.rand(3)
    ...     random_state.seed(0, 7)
    ...     again = torch.rand(3)
    >>> torch.equal(first, again)
    True
    """

    # A class, not a generator function: entered for every batch, and several times as fast.
    __slots__ = ("_saved",)

    def __enter__(self) -> "isolated_rng":
        self._saved = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002
        return self

    def seed(self, *key: int) -> None:
        """Seed all three streams from a hash of the key."""
        digest = hashlib.sha256(repr(key).encode()).digest()[:16]
        torch.default_generator.manual_seed(int.from_bytes(digest[:8], "little"))
        np.random.seed(np.frombuffer(digest, np.uint32))  # noqa: NPY002
        random.seed(digest)

    def __exit__(self, *error: object) -> None:
        torch_state, numpy_state, python_state = self._saved
        torch.set_rng_state(torch_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)
