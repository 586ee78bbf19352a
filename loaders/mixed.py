"""Several data sets in one order, each by its share: published garments beside fresh ones."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from heapq import heapify, heappop, heappush
from math import gcd, lcm
from typing import Any

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, Transform, items_of, natural
from gcd_dataset.loaders.indexing import UnknownKeyError, number_of
from gcd_dataset.loaders.order import permutation
from gcd_dataset.shards.layout import Bytes

__all__ = ["MixedDataset"]

MOST = 1 << 62  # garments in an epoch: no length in Python is greater


class MixedDataset(Garments):
    """Garments of several data sets by turns, as often as their ``weights`` say.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> mixed = MixedDataset([FakeGarments(6, fields=["meta"]), FakeGarments(2, seed=9, fields=["meta"])], [3, 1])
    >>> [mixed.source(i) for i in range(len(mixed))]
    [(0, 3), (0, 0), (1, 1), (0, 1), (0, 4), (0, 2), (1, 0), (0, 5)]

    Garment ``i`` is a function of ``seed`` and ``i``. In any stretch of the order each of two data sets is less than
    one garment away from its share, each of three less than two, and of more a few: no order keeps more than two within
    one whatever their weights. These count in proportion to each other, as the decimals that they are written as.

    Every data set comes in an order of its own, by chance, and when it has come to its end in another. ``len()`` is an
    epoch: until each has come through once; those short for their weight have come several times by then. Numbers from
    ``len()`` on are the epochs that follow, which go on where the one before ended. A ``GarmentLoader`` keeps this
    order, whatever its own ``shuffle``; a plain ``DataLoader`` shows the first epoch every time, and with
    ``shuffle=True`` holds the shares on average only.

    ``transform`` is called with each item, after that of the data set it comes from. Raises ``ConfigError`` for data
    sets of different fields or ``dtype``, without garments, or without a positive weight each.
    """

    endless = True

    def __init__(
        self,
        datasets: Sequence[Garments],
        weights: Sequence[float],
        *,
        seed: int = 0,
        transform: Transform | None = None,
    ) -> None:
        self.datasets, self.weights = tuple(datasets), _proportions(weights)
        _require_alike(self.datasets, weights)
        fields = self.datasets[0].fields
        super().__init__(fields, transform, there=fields, dtype=self.datasets[0].dtype)
        self._seed, self._turns = natural("seed", seed), _turns(self.weights)
        self.reads_only = all(dataset.reads_only for dataset in self.datasets)

    @cached_property
    def _length(self) -> int:
        needed = {part: len(dataset) for part, dataset in enumerate(self.datasets)}

        def all_came_through(length: int) -> bool:
            return all(count >= needed[part] for part, count in self._turns.counts(length).items())

        return bisect_left(range(MOST), True, key=all_came_through)

    def __len__(self) -> int:
        return self._length

    def source(self, index: int) -> tuple[int, int]:
        """Which data set garment ``index`` comes from, and its number there. Raises ``IndexError``."""
        part, turn = self._turns.at(self._position(index))
        length = len(self.datasets[part])
        epoch, place = divmod(turn, length)
        return part, permutation(length, self._seed, part, epoch)(place)

    def tell_wait(self) -> None:
        for dataset in self.datasets:
            dataset.tell_wait()

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments at once; what is made on a GPU is made together."""
        sources = [self.source(index) for index in indices]
        of_part: dict[int, list[int]] = defaultdict(list)
        for part, number in sources:
            of_part[part].append(number)
        items = {part: iter(items_of(self.datasets[part], numbers)) for part, numbers in of_part.items()}
        return [
            self._transformed(next(items[part]), self._position(index))
            for (part, _), index in zip(sources, indices, strict=True)
        ]

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` was made with. Raises ``IndexError``."""
        part, number = self.source(index)
        return self.datasets[part].recipe(number)

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless garment ``index`` is, byte for byte, what it should be."""
        part, number = self.source(index)
        self.datasets[part].verify(number)

    def identity(self) -> dict[str, Any]:
        """Those of the data sets, with what makes the order."""
        parts = [dataset.identity() for dataset in self.datasets]
        return {"parts": parts, "weights": self.weights, "seed": self._seed}

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        part, number = self.source(position)
        return self.datasets[part]._members(number, members)

    def _one(self, position: int) -> Any:
        part, number = self.source(position)
        return self._transformed(self.datasets[part][number], position)

    def _described(self) -> list[str]:
        shares = zip(self.weights, self.datasets, strict=True)
        return [" + ".join(f"{weight} {type(dataset).__name__}" for weight, dataset in shares)]

    def _key(self, position: int) -> str:
        part, number = self.source(position)
        return self.datasets[part]._key(number)

    def _position(self, index: int | str) -> int:
        """The position of a number; negative ones count from the end of the first epoch."""
        if isinstance(index, str):
            raise UnknownKeyError(f"garment {index!r:.99}: a mix has no keys: ask one of its data sets, .datasets[0]")
        number = number_of(index)
        if number < -len(self):
            raise IndexError(f"garment {number} of {len(self)}: give -{len(self)} or more")
        return number if number >= 0 else number + len(self)


@dataclass(frozen=True)
class _One:
    """A data set that takes every place it is given."""

    part: int
    weight: int

    def at(self, place: int) -> tuple[int, int]:
        return self.part, place

    def counts(self, length: int) -> dict[int, int]:
        return {self.part: length}


@dataclass(frozen=True)
class _Two:
    """Two groups that take turns: after ``n`` places the first has had its share of ``n``, rounded to whole places."""

    first: "_One | _Two"
    second: "_One | _Two"

    @property
    def weight(self) -> int:
        return self.first.weight + self.second.weight

    def at(self, place: int) -> tuple[int, int]:
        """The data set whose turn it is at a place, and how often it had its turn before."""
        before = self._share(place)
        return self.first.at(before) if self._share(place + 1) > before else self.second.at(place - before)

    def counts(self, length: int) -> dict[int, int]:
        """How often each data set comes in the first ``length`` places."""
        own = self._share(length)
        return self.first.counts(own) | self.second.counts(length - own)

    def _share(self, places: int) -> int:
        return (2 * places * self.first.weight + self.weight) // (2 * self.weight)


def _turns(weights: Sequence[int]) -> _One | _Two:
    """The data sets two by two, always the two lightest groups: so the heavy ones keep closest to their shares."""
    groups: list[tuple[int, int, _One | _Two]] = [
        (weight, part, _One(part, weight)) for part, weight in enumerate(weights)
    ]
    heapify(groups)
    while len(groups) > 1:
        (light, _, second), (heavy, part, first) = heappop(groups), heappop(groups)
        heappush(groups, (light + heavy, part, _Two(first, second)))
    return groups[0][2]


def _proportions(weights: Sequence[float]) -> tuple[int, ...]:
    """The weights as the smallest whole numbers that stand to each other as they do."""
    try:
        exact = [Fraction(str(weight)) for weight in weights]
    except ValueError:
        exact = []
    if not exact or min(exact) <= 0:
        raise ConfigError(f"weights={list(weights)}: give a positive number for each data set")
    whole = [int(weight * lcm(*(other.denominator for other in exact))) for weight in exact]
    return tuple(weight // gcd(*whole) for weight in whole)


def _require_alike(datasets: Sequence[Garments], weights: Sequence[float]) -> None:
    if len(datasets) != len(weights):
        raise ConfigError(f"{len(datasets)} data sets and {len(weights)} weights: give one each")
    for number, dataset in enumerate(datasets):
        if not isinstance(dataset, Garments):
            raise ConfigError(
                f"data set {number} is a {type(dataset).__name__}: give GarmentDataset, GeneratedGarments or the like"
            )
        if not len(dataset):
            raise ConfigError(f"data set {number} has no garments: leave it out")
        if odd := sorted(set(dataset.fields) ^ set(datasets[0].fields)):
            raise ConfigError(f"only one of data sets 0 and {number} has {', '.join(odd)}: give both the same fields")
        if dataset.dtype != datasets[0].dtype:
            unlike = f"{datasets[0].dtype} and {dataset.dtype}"
            raise ConfigError(f"data sets 0 and {number} give floats as {unlike}: give both the same dtype")
