"""The order of samples: a pure function of seed, epoch and position, split over any number of ranks.

A *position* counts the garments that all ranks together have received since the first epoch began: epoch ``e`` covers
positions ``e * n`` to ``(e + 1) * n - 1``, with *offsets* 0 to ``n - 1``. The garment *index* at a position depends on
neither ranks, workers nor batch size, so one integer is the whole state of a loader, and a job may resume with another
number of ranks.
"""

import math
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from threading import Thread
from typing import Any, Literal, get_args

import numpy as np
from torch.utils.data import DistributedSampler

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, require_integer
from gcd_dataset.loaders.ranks import accelerate_processes, current_rank, require_rank
from gcd_dataset.loaders.states import dataset_entries, position_in_state

Pad = Literal["none", "repeat"]

ROUNDS = 8  # rounds of the Feistel network: four change the row, four the column
MASK64 = (1 << 64) - 1
CHUNK = 1024  # indices that a rank computes at once


class Permutation:
    """A keyed pseudorandom permutation of 0 … ``length`` - 1 in O(1) memory.

    >>> shuffled = Permutation(5, 0, 7)
    >>> [shuffled(i) for i in range(5)]
    [1, 0, 2, 4, 3]

    A generalised Feistel network on a grid of about √length × √length numbers, with cycle-walking: a result beyond
    ``length`` is permuted again (Black and Rogaway, Ciphers with Arbitrary Finite Domains, CT-RSA 2002).

    Not ``np.random.permutation``: that needs a table of 8 bytes per garment in every process, 8 GB for 10⁹, and its
    result may change between releases of NumPy, while the positions in users' checkpoints must keep their meaning.
    """

    def __init__(self, length: int, *key: int) -> None:
        self.length = length
        self._rows = math.isqrt(length - 1) + 1
        self._columns = -(-length // self._rows)
        keys = np.random.SeedSequence(key).generate_state(ROUNDS, np.uint64).tolist()
        self._round_keys = tuple(zip(keys[::2], keys[1::2], strict=True))

    def __call__(self, number: int) -> int:
        while (number := self._permute_grid(number)) >= self.length:
            pass
        return number

    def many(self, numbers: Sequence[int]) -> list[int]:
        """``[self(number) for number in numbers]`` in NumPy: 1000 numbers take as long as 20 single calls."""
        result = np.asarray(numbers, np.uint64)
        outside = np.arange(len(result))
        while len(outside):
            result[outside] = self._permute_grid(result[outside])
            outside = outside[result[outside] >= self.length]
        return result.tolist()

    def _permute_grid(self, number: Any) -> Any:
        """The Feistel network on the numbers of the grid; takes an int or a uint64 array."""
        row, column = divmod(number, self._columns)
        for row_key, column_key in self._round_keys:
            row = (row + _mix64(column + row_key)) % self._rows
            column = (column + _mix64(row + column_key)) % self._columns
        return row * self._columns + column


cached_permutation = lru_cache(maxsize=64)(Permutation)


class WindowedPermutation:
    """A permutation that shuffles the shards, then the garments within each window of ``window`` shards.

    A reader that goes through it needs the shards of one window at a time, each once. ``lengths``: garments of each
    shard.

    >>> WindowedPermutation([2, 2, 2], 2, 7).many(range(6))
    [5, 4, 0, 1, 3, 2]
    """

    def __init__(self, lengths: Sequence[int], window: int, *key: int) -> None:
        self._key, counts = key, np.asarray(lengths, np.int64)
        shards = np.array(Permutation(len(counts), *key, SHARDS).many(range(len(counts))), np.int64)
        self._first = (np.cumsum(counts) - counts)[shards]  # index of each shard's first garment, in their new order
        self._begin = np.cumsum([0, *counts[shards]])  # where each of them begins in that order
        self._windows = np.append(self._begin[:-1:window], self._begin[-1])

    def window_of(self, number: int) -> int:
        """The window of a number."""
        return int(np.searchsorted(self._windows, number, "right")) - 1

    def first_of_shards(self, window: int) -> list[int]:
        """The first garment of each shard of a window; none for a window after the last."""
        edges = np.searchsorted(self._begin, self._windows[window : window + 2])
        return self._first[edges[0] : edges[1]].tolist() if len(edges) == 2 else []

    def many(self, numbers: Sequence[int]) -> list[int]:
        """The garment at each number."""
        places = np.asarray(numbers, np.int64)
        windows = np.searchsorted(self._windows, places, "right") - 1
        for window in np.unique(windows).tolist():
            begin, end, inside = self._windows[window], self._windows[window + 1], windows == window
            shuffled = cached_permutation(int(end - begin), *self._key, window)
            places[inside] = begin + shuffled.many((places[inside] - begin).tolist())
        shards = np.searchsorted(self._begin, places, "right") - 1
        return (self._first[shards] + places - self._begin[shards]).tolist()


SHARDS = 1 << 32  # key of the order of the shards, beside the numbers of windows


def _mix64(word: Any) -> Any:
    """The finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014): every bit depends on every bit of ``word``."""
    word = word & MASK64  # for Python's ints; uint64 arrays wrap by themselves
    word = ((word ^ word >> 30) * 0xBF58476D1CE4E5B9) & MASK64
    word = ((word ^ word >> 27) * 0x94D049BB133111EB) & MASK64
    return word ^ word >> 31


class SampleOrder:
    """Position → index: the garments of an epoch, then those of the next epoch in another order.

    With ``shuffle`` each epoch is a permutation keyed by ``(seed, epoch)``, of a data set with a ``window`` a
    ``WindowedPermutation``; otherwise it is 0, 1, 2, …. An ``endless`` data set, such as ``MixedDataset``, and
    ``FreshGarments`` have an order of their own: index = position. Raises ``ConfigError`` for an empty data set, and
    for anything but a data set with a length and indices.
    """

    def __init__(self, dataset: Sized, *, shuffle: bool, seed: int) -> None:
        is_stream = hasattr(dataset, "begin_at")
        is_indexed = isinstance(dataset, Sized) and (is_stream or hasattr(dataset, "__getitem__"))
        if not is_indexed or isinstance(dataset, str | bytes | type | Mapping):
            path = f"{str(dataset)!r:.99}" if isinstance(dataset, str | PathLike) else "…"
            raise ConfigError(f"dataset={dataset!r:.99} is no data set: give GarmentDataset({path}) or the like")
        self.length, self.shuffle, self.seed = len(dataset), shuffle, require_integer("seed", seed)
        if not self.length:
            raise ConfigError("an empty data set has no order: give a data set with at least one garment")
        self._is_endless = is_stream or (isinstance(dataset, Garments) and dataset.endless)
        self.window = dataset.window if isinstance(dataset, Garments) and shuffle else None
        self._shards = tuple(dataset.shard_lengths()) if self.window is not None else ()  # type: ignore[attr-defined]
        self._windowed: tuple[int, WindowedPermutation] | None = None
        self._fetch_ahead, self._ahead = getattr(dataset, "fetch_ahead", None), (0, -1)
        self._dataset_entries = dataset_entries(dataset)

    def indices(self, positions: Sequence[int]) -> list[int]:
        """The indices at some positions of one epoch."""
        if self._is_endless or not positions:
            return list(positions)
        epoch = positions[0] // self.length
        offsets = [position - epoch * self.length for position in positions]
        if not self.shuffle:
            return offsets
        if self.window is None:
            return cached_permutation(self.length, self.seed, epoch).many(offsets)
        if self._windowed is None or self._windowed[0] != epoch:
            self._windowed = epoch, WindowedPermutation(self._shards, self.window, self.seed, epoch)
        permutation = self._windowed[1]
        ahead = epoch, permutation.window_of(offsets[-1]) + 1
        if self._fetch_ahead is not None and self._ahead < ahead:
            # A thread fetches the shards of the next window, once, while this one is read.
            self._ahead = ahead
            Thread(target=self._fetch_ahead, args=(permutation.first_of_shards(ahead[1]),), daemon=True).start()
        return permutation.many(offsets)

    def uses(self, positions: Sequence[int], epoch: int) -> list[int]:
        """The number of each use of a garment: its epoch; its position for data sets that repeat garments in one."""
        return list(positions) if self._is_endless else [epoch] * len(positions)

    def epoch(self, position: int) -> int:
        return position // self.length

    def end(self, position: int) -> int:
        """The end of the epoch of a position: where the next epoch begins."""
        return (self.epoch(position) + 1) * self.length

    def next_pass(self, position: int) -> int:
        """The position itself if an epoch begins there, otherwise the end of its epoch."""
        return self.end(position - 1)

    def state(self, position: int) -> dict[str, Any]:
        """A position with the entries that identify this order."""
        return {"position": position, **self._entries(), **self._dataset_entries}

    def position_in(self, state: Mapping[str, Any]) -> int:
        """The position in a state. Raises ``ConfigError`` for a state of another order, or an invalid one."""
        return position_in_state(state, self._entries(), self._dataset_entries)

    def _entries(self) -> dict[str, Any]:
        window = {} if self.window is None else {"window": self.window}
        return {"seed": self.seed, "shuffle": self.shuffle, "length": self.length, **window}


@dataclass(frozen=True)
class RankShare:
    """One rank's share of an order: every ``world_size``-th position, from ``rank`` on."""

    order: SampleOrder
    rank: int
    world_size: int
    pad: Pad

    def positions(self, start: int) -> range:
        """This rank's positions from ``start`` to the end of the epoch; with padding possibly beyond that end."""
        remaining = self.order.end(start) - start
        count = -(-remaining // self.world_size) if self.pad == "repeat" else remaining // self.world_size
        return range(start + self.rank, start + self.rank + count * self.world_size, self.world_size)

    def after(self, start: int, received: int) -> int:
        """The position after every rank has received ``received`` garments of a pass from ``start``."""
        is_done = received >= len(self.positions(start))
        return self.order.end(start) if is_done else start + received * self.world_size

    def indices(self, start: int) -> Iterator[int]:
        """This rank's indices from ``start`` to the end of the epoch; padding repeats the epoch's first garments."""
        length, positions = self.order.length, self.positions(start)
        first = self.order.end(start) - length
        for cut in range(0, len(positions), CHUNK):
            chunk = positions[cut : cut + CHUNK]
            yield from self.order.indices([first + (position - first) % length for position in chunk])


class ElasticSampler(DistributedSampler[int]):
    """This rank's garments of an epoch, for a plain ``DataLoader``; each ``iter()`` is the next epoch.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> [list(ElasticSampler(FakeGarments(7), rank=rank, world_size=2)) for rank in (0, 1)]
    [[1, 0, 2], [3, 6, 4]]

    Ranks take garments in turn: after ``k`` garments each, all ranks together have received the first
    ``k * world_size`` garments of the order. If ``rank`` and ``world_size`` are not given, ``len()`` and ``iter()``
    look them up: in ``torch.distributed`` if it is initialised, else in the environment that ``torchrun`` sets, else
    0 of 1. ``pad`` is for the end of an epoch, when fewer garments than ranks remain: ``none`` leaves them out, so that
    all ranks get equally many; ``repeat`` fills up with the first garments of the epoch.

    A ``DistributedSampler`` by type, so Lightning does not replace it. A loader that ``accelerate`` has prepared splits
    the garments over its processes itself, so with several of them the sampler requires ``rank`` and ``world_size``: 0
    and 1 in such a loader, whose state then counts the garments that all processes have received.

    ``iter()`` after a broken-off loop begins the next epoch; after ``load_state_dict`` it yields the rest of the
    state's epoch. ``set_epoch`` selects the epoch of the next ``iter()``.

    ``state_dict()`` counts garments as they are passed to the ``DataLoader``, whose workers prefetch; pass
    ``received``, the garments that the training loop has received. Raises ``ConfigError`` for an invalid rank, and
    without a rank where ``accelerate`` runs several processes.
    """

    def __init__(
        self,
        dataset: Sized,
        *,
        shuffle: bool = True,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        pad: Pad = "none",
    ) -> None:
        # No super().__init__: DistributedSampler's asks for the rank at once, before a framework may have set it.
        if pad not in get_args(Pad):
            raise ConfigError(f"pad={pad!r}: choose {' or '.join(get_args(Pad))}")
        self.order = SampleOrder(dataset, shuffle=shuffle, seed=seed)
        self.pad, self._fixed_rank = pad, require_rank(rank, world_size)
        self._rank_share = self.rank_share() if self._fixed_rank else None
        self.position = self._start = self._first_epoch = 0
        self._is_loaded = False

    @property
    def rank(self) -> int:  # type: ignore[override]
        """This rank, from 0, looked up now."""
        return self.rank_share().rank

    @property
    def world_size(self) -> int:
        """Number of ranks, looked up now."""
        return self.rank_share().world_size

    num_replicas = world_size  # the name in ``DistributedSampler``

    @property
    def epoch(self) -> int:  # type: ignore[override]
        """The epoch of the next garment, from 0."""
        return self.order.epoch(self.position)

    def rank_share(self) -> RankShare:
        """This rank's share; the rank is looked up now. Raises ``ConfigError`` for more ranks than garments."""
        rank_share = RankShare(self.order, *(self._fixed_rank or current_rank()), self.pad)
        if not rank_share.positions(0):
            raise ConfigError(
                f"{self.order.length} garments for {rank_share.world_size} ranks: give pad='repeat', or fewer ranks"
            )
        return rank_share

    def __len__(self) -> int:
        """This rank's garments in a whole epoch."""
        self._require_no_second_split()
        return len(self.rank_share().positions(0))

    def __iter__(self) -> Iterator[int]:
        self._require_no_second_split()
        self._rank_share = rank_share = self.rank_share()
        start = self.position if self._is_loaded else self.order.next_pass(self.position)
        # A rest of an epoch in which not every rank gets a garment is left out.
        self._start = start if rank_share.positions(start) else self.order.end(start)
        return self._indices(rank_share, self._start)

    def set_epoch(self, epoch: int) -> None:
        """Select the epoch of the next ``iter()``.

        The first call after ``load_state_dict`` keeps the epoch of the state, and later epochs count from it: a
        framework may count from 0 again.
        """
        epoch = require_integer("epoch", epoch)
        if self._is_loaded:
            self._first_epoch = self.epoch - epoch
        else:
            self.position = (self._first_epoch + epoch) * self.order.length

    def state_dict(self, received: int | None = None) -> dict[str, Any]:
        """The state of the training loop; ``received``: garments of this rank since the last ``iter()``."""
        if received is None:
            return self.order.state(self.position)
        rank_share = self._rank_share or self.rank_share()
        return self.order.state(rank_share.after(self._start, require_integer("received", received)))

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Resume from a state at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self.position = self._start = self.order.position_in(state)
        self._is_loaded, self._rank_share = True, None

    def _indices(self, rank_share: RankShare, start: int) -> Iterator[int]:
        for count, index in enumerate(rank_share.indices(start), 1):
            self.position, self._is_loaded = rank_share.after(start, count), False
            yield index

    def _require_no_second_split(self) -> None:
        """Raise ``ConfigError`` where ``accelerate`` runs several processes, unless this sampler is for all of them."""
        if self._fixed_rank != (0, 1) and (count := accelerate_processes()) > 1:
            raise ConfigError(
                f"accelerate runs {count} processes, and a loader that it prepares splits garments over them: give "
                "rank=0, world_size=1 and prepare the loader, or load with a GarmentLoader, which is not prepared"
            )
