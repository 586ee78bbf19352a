"""``MixedDataset``: several data sets interleaved by weight, such as published garments with generated ones."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, partial
from heapq import heapify, heappop, heappush
from math import gcd, lcm
from typing import Any

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import (
    Garments,
    IndexRangeError,
    Transform,
    UnknownKeyError,
    UserCode,
    load_items,
    require_garments,
    require_integer,
    require_whole_number,
)
from gcd_dataset.loaders.order import cached_permutation
from gcd_dataset.records import Sample
from gcd_dataset.shards.layout import Bytes, split_worn

LONGEST_EPOCH = 1 << 62  # Python's limit for a length


class MixedDataset(Garments):
    """Garments of several data sets, interleaved in proportion to their ``weights``.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> mixed = MixedDataset([FakeGarments(6, fields=["meta"]), FakeGarments(2, seed=9, fields=["meta"])], [3, 1])
    >>> [mixed.source(i) for i in range(len(mixed))]
    [(0, 3), (0, 0), (1, 1), (0, 1), (0, 4), (0, 2), (1, 0), (0, 5)]

    Garment ``i`` is a function of ``seed`` and ``i``. In any stretch of the order, the count of each data set differs
    from its share by at most one garment for two data sets, by at most two for three, and by a few for more. (For three
    or more data sets, no order stays within one for all weights.) Only the ratio of the weights matters; a float has
    the value of its printed decimal.

    Each data set is shuffled, and reshuffled each time it is exhausted. ``len()`` is an epoch: it ends when every data
    set has been exhausted once, so data sets with few garments for their weight repeat. Indices from ``len()`` on are
    the following epochs, which continue where the previous one ended. A ``GarmentLoader`` keeps this order for any
    ``shuffle``; a plain ``DataLoader`` repeats the first epoch, and with ``shuffle=True`` keeps the shares on average
    only.

    ``transform`` is called with each item, after the transform of its own data set; ``OutfitCloth`` gives outfits and
    single garments the same fields. Raises ``ConfigError`` for data sets with different fields or ``dtype``, an empty
    data set, or weights other than one positive number for each.
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
        if not isinstance(datasets, list | tuple):
            raise ConfigError(f"datasets={datasets!r:.99}: give a list of data sets")
        self.datasets, self.weights = tuple(datasets), _integer_ratio(weights)
        _require_compatible(self.datasets, weights)
        fields = self.datasets[0].fields
        super().__init__(fields, transform, available=fields, dtype=self.datasets[0].dtype)
        self._seed, self._tree = require_integer("seed", seed), _weight_tree(self.weights)
        self.reads_only = all(dataset.reads_only for dataset in self.datasets)

    @cached_property
    def _length(self) -> int:
        lengths = {part: len(dataset) for part, dataset in enumerate(self.datasets)}

        def all_exhausted(length: int) -> bool:
            return all(count >= lengths[part] for part, count in self._tree.counts(length).items())

        return bisect_left(range(LONGEST_EPOCH), True, key=all_exhausted)

    def __len__(self) -> int:
        return self._length

    def source(self, index: int) -> tuple[int, int]:
        """Number of the data set that garment ``index`` comes from, and its index there. Raises ``IndexError``."""
        part, before = self._tree.at(self._position(index))
        length = len(self.datasets[part])
        epoch, offset = divmod(before, length)
        return part, cached_permutation(length, self._seed, part, epoch)(offset)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """The items of a batch, one request per data set, so that a GPU drapes its garments together."""
        sources = [self.source(index) for index in indices]
        indices_of: dict[int, list[int]] = defaultdict(list)
        for part, part_index in sources:
            indices_of[part].append(part_index)
        items = {part: iter(load_items(self.datasets[part], wanted)) for part, wanted in indices_of.items()}
        return [
            self._transformed(next(items[part]), self._position(index))
            for (part, _), index in zip(sources, indices, strict=True)
        ]

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` was made with. Raises ``IndexError``."""
        part, part_index = self.source(index)
        return self.datasets[part].recipe(part_index)

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` if the bytes of garment ``index`` differ from the expected ones."""
        part, part_index = self.source(index)
        self.datasets[part].verify(part_index)

    def sample(self, index: int | str) -> Sample:
        part, part_index = self.source(self._position(index))
        return self.datasets[part].sample(part_index)

    def identity(self) -> dict[str, Any]:
        """Identities of the data sets, weights and seed."""
        parts = [dataset.identity() for dataset in self.datasets]
        return {"parts": parts, "weights": self.weights, "seed": self._seed}

    def _separated(self) -> tuple[Garments, UserCode | None]:
        parts, codes = zip(*(dataset._separated() for dataset in self.datasets), strict=True)
        if self.transform is None and not any(codes):
            return self, None
        return self._with(datasets=parts, transform=None), partial(self._transformed_by, codes)

    def _transformed_by(self, codes: Sequence[UserCode | None], item: Any, index: int) -> Any:
        part, part_index = self.source(index)
        code = codes[part]
        return self._transformed(item if code is None else code(item, part_index), index)

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        part, part_index = self.source(position)
        return self.datasets[part]._members(part_index, members)

    def _load(self, position: int) -> Any:
        part, part_index = self.source(position)
        return self._transformed(self.datasets[part][part_index], position)

    def _description(self) -> list[str]:
        shares = zip(self.weights, self.datasets, strict=True)
        return [" + ".join(f"{weight} {type(dataset).__name__}" for weight, dataset in shares)]

    def _key(self, position: int) -> str:
        part, part_index = self.source(position)
        return self.datasets[part]._key(part_index)

    def _position(self, index: int | str) -> int:
        """The position of an index; negative indices count from the end of the first epoch."""
        if isinstance(index, str):
            raise UnknownKeyError(
                f"garment {index!r:.99}: a mix has no keys: use one of its data sets, such as .datasets[0]"
            )
        number = require_whole_number(index)
        if number < -len(self):
            raise IndexRangeError(f"garment {number} of {len(self)}: give -{len(self)} or more")
        return number if number >= 0 else number + len(self)


@dataclass(frozen=True)
class _Leaf:
    """A data set: it takes every position that reaches it."""

    part: int
    weight: int

    def at(self, position: int) -> tuple[int, int]:
        return self.part, position

    def counts(self, length: int) -> dict[int, int]:
        return {self.part: length}


@dataclass(frozen=True)
class _Pair:
    """Two groups interleaved: of ``n`` positions ``first`` takes its share of ``n``, rounded to an integer."""

    first: "_Leaf | _Pair"
    second: "_Leaf | _Pair"

    @property
    def weight(self) -> int:
        return self.first.weight + self.second.weight

    def at(self, position: int) -> tuple[int, int]:
        """The data set at a position, and its number of garments before that position."""
        before = self._share(position)
        takes_first = self._share(position + 1) > before
        return self.first.at(before) if takes_first else self.second.at(position - before)

    def counts(self, length: int) -> dict[int, int]:
        """Garments of each data set in the first ``length`` positions."""
        share = self._share(length)
        return self.first.counts(share) | self.second.counts(length - share)

    def _share(self, length: int) -> int:
        return (2 * length * self.first.weight + self.weight) // (2 * self.weight)


def _weight_tree(weights: Sequence[int]) -> _Leaf | _Pair:
    """A binary tree of the data sets, always joining the two lightest groups: the heaviest deviate least."""
    groups: list[tuple[int, int, _Leaf | _Pair]] = [
        (weight, part, _Leaf(part, weight)) for part, weight in enumerate(weights)
    ]
    heapify(groups)
    while len(groups) > 1:
        (light, _, second), (heavy, part, first) = heappop(groups), heappop(groups)
        heappush(groups, (light + heavy, part, _Pair(first, second)))
    return groups[0][2]


def _integer_ratio(weights: Sequence[float]) -> tuple[int, ...]:
    """The weights as the smallest integers in the same ratio. Raises ``ConfigError``."""
    try:
        exact = [Fraction(str(weight)) for weight in weights]
    except (TypeError, ValueError):
        exact = []
    if not exact or min(exact) <= 0:
        raise ConfigError(f"weights={weights!r:.99}: give a positive number for each data set")
    denominator = lcm(*(weight.denominator for weight in exact))
    integers = [int(weight * denominator) for weight in exact]
    return tuple(weight // gcd(*integers) for weight in integers)


def _require_compatible(datasets: Sequence[Garments], weights: Sequence[float]) -> None:
    if len(datasets) != len(weights):
        raise ConfigError(f"{len(datasets)} data sets and {len(weights)} weights: give one weight for each data set")
    for number, dataset in enumerate(datasets):
        require_garments(f"data set {number}", dataset)
        if not len(dataset):
            raise ConfigError(f"data set {number} has no garments: leave it out")
        odd = sorted(field for field in {*dataset.fields} ^ {*datasets[0].fields} if not split_worn(field)[0])
        if odd:
            raise ConfigError(f"only one of data sets 0 and {number} has {', '.join(odd)}: give both the same fields")
        if dataset.dtype != datasets[0].dtype:
            types = f"{datasets[0].dtype} and {dataset.dtype}"
            raise ConfigError(f"data sets 0 and {number} give floats as {types}: give both the same dtype")
