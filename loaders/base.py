"""What every data set of garments has in common."""

import operator
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch.utils.data import Dataset

from gcd_dataset.errors import ConfigError, TransformError
from gcd_dataset.shards.codec import decode_field, read_json
from gcd_dataset.shards.layout import FIELDS, Bytes, key_of, known_fields

__all__ = [
    "Garments",
    "Item",
    "SelectedGarments",
    "Transform",
    "as_item",
    "changing",
    "function",
    "items_of",
    "made_with",
    "naming",
    "natural",
    "tensor_of",
]

Item: TypeAlias = dict[str, Any]
"""A loaded sample: field name to tensor, parsed JSON, or picture as u8 tensor [3, height, width]."""
Transform: TypeAlias = Callable[[Item], Any]


class Garments(Dataset[Item], ABC):
    """Garments by number; ``fields`` chooses what an item holds, ``transform`` changes it on the way out."""

    reads_only = False
    """Whether garments are only read, so that a thread beside the training can do it as well as a process."""
    endless = False
    """Whether numbers from ``len()`` on are garments too, those of the epochs that follow in an order of their own."""
    together = 1
    """So many garments in a row are best made by one process, since they are one design; from any multiple of it on."""

    def __init__(
        self, fields: Iterable[str] | None, transform: Transform | None, *, there: Iterable[str] = FIELDS
    ) -> None:
        self.fields = known_fields(fields, there)
        """Names of what an item holds; see ``gcd_dataset.shards.codec`` for shapes, types and units."""
        self.transform = None if transform is None else function("transform", transform)

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` was made with: enough to make it again."""

    @abstractmethod
    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless garment ``index`` is, byte for byte, what it should be."""

    def identity(self) -> dict[str, Any]:
        """What tells this data set from another, wherever it lies: its length, and how its ends were made."""
        ends = [self.recipe(index) for index in (0, -1)]
        made = [{name: end[name] for name in ("seed", "index", "recipe")} for end in ends]
        return {"length": len(self), "ends": made}

    @abstractmethod
    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        """The encoded content of at least the members asked for."""

    def __getitem__(self, index: int | slice) -> Any:
        """Garment ``index``, negative ones count from the end; for a slice the garments in it, as a data set.

        Raises ``IndexError``.
        """
        if isinstance(index, slice):
            return self.select(range(len(self))[index])
        position = self._position(index)
        return self._item(self._members(position, tuple(FIELDS[field] for field in self.fields)), position)

    def __iter__(self) -> Iterator[Any]:
        """All garments in order."""
        return (self[index] for index in range(len(self)))

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments, as a ``DataLoader`` asks for a batch of them."""
        return [self[index] for index in indices]

    def stream(self, indices: Iterable[int]) -> Iterator[Any]:
        """Garments one after the other; numbers are taken as they are needed, and may be endless."""
        return (self[index] for index in indices)

    def select(self, indices: Iterable[int]) -> "Garments":
        """These garments in this order, as a data set. Raises ``IndexError``."""
        return SelectedGarments(self, [self._position(index) for index in indices])

    def _item(self, members: Mapping[str, Bytes], position: int) -> Any:
        return self._changed(as_item(members, self.fields), position)

    def _changed(self, item: Any, position: int) -> Any:
        """The item of a garment after the transform."""
        if self.transform is None:
            return item
        with changing(self, position):
            return self.transform(item)

    def _key(self, position: int) -> str:
        """The key of the garment at a position."""
        return key_of(position)

    @property
    def _label(self) -> str:
        """The data set, as messages name it."""
        return type(self).__name__

    def _position(self, index: int) -> int:
        number = operator.index(index)
        length = len(self)
        if not -length <= number < length:
            raise IndexError(f"garment {number} of {length}")
        return number % length


class SelectedGarments(Garments):
    """Some garments of a data set, in an order of their own; fields and transform are those of the whole."""

    def __init__(self, whole: Garments, positions: Sequence[int]) -> None:
        super().__init__(whole.fields, whole.transform, there=whole.fields)
        self.whole = whole
        self.reads_only = whole.reads_only
        self.positions = np.asarray(positions, np.int64)
        """Where each garment stands in the whole."""

    def __len__(self) -> int:
        return len(self.positions)

    def recipe(self, index: int) -> dict[str, Any]:
        return self.whole.recipe(int(self.positions[self._position(index)]))

    def verify(self, index: int) -> None:
        self.whole.verify(int(self.positions[self._position(index)]))

    def _key(self, position: int) -> str:
        return self.whole._key(int(self.positions[position]))

    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return self.select(range(len(self))[index])
        return self.whole[int(self.positions[self._position(index)])]

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments, at once where the whole can do that."""
        return items_of(self.whole, [int(self.positions[self._position(index)]) for index in indices])

    def stream(self, indices: Iterable[int]) -> Iterator[Any]:
        """Garments one after the other, as the whole gives them."""
        return self.whole.stream(int(self.positions[self._position(index)]) for index in indices)

    def identity(self) -> dict[str, Any]:
        """That of the whole, and which of it."""
        return {"of": self.whole.identity(), "chosen": zlib.crc32(self.positions.tobytes())}

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return self.whole._members(int(self.positions[position]), members)


def items_of(dataset: Any, indices: Sequence[int]) -> list[Any]:
    """Several items, at once where the data set can do that, as a ``DataLoader`` asks for them.

    An error gets a note that says which they were.
    """
    if not hasattr(dataset, "__getitems__"):
        return [_item_of(dataset, index) for index in indices]
    with naming(dataset, *indices):
        return dataset.__getitems__(indices)


class naming:  # noqa: N801 -- a context manager, named as functions are
    """Note on an error which items it came up with."""

    # A class: entered for every garment, where a generator would take several times as long.
    __slots__ = ("_dataset", "_indices")

    def __init__(self, dataset: Any, *indices: int) -> None:
        self._dataset, self._indices = dataset, indices

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, Exception):
            which = f"{', '.join(map(str, self._indices))} of {type(self._dataset).__name__}"
            error.add_note(f"while loading {'garment' if len(self._indices) == 1 else 'garments'} {which}")


class changing:  # noqa: N801 -- a context manager, named as functions are
    """Turn an error of a transform into a ``TransformError`` that names the garment."""

    # A class: entered for every garment, as ``naming`` is.
    __slots__ = ("_dataset", "_position")

    def __init__(self, dataset: "Garments", position: int) -> None:
        self._dataset, self._position = dataset, position

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        # One that is named already comes from a data set in this one.
        if isinstance(error, Exception) and not isinstance(error, TransformError):
            garment = f"{self._dataset._key(self._position)}, number {self._position} of {self._dataset._label}"
            told = " ".join(f"{type(error).__name__}: {error}".split())
            raise TransformError(f"the transform of {garment}: {told}") from error


def _item_of(dataset: Any, index: int) -> Any:
    with naming(dataset, index):
        return dataset[index]


def made_with(meta: Bytes) -> dict[str, Any]:
    """Seed, index, options and versions in the ``meta.json`` of a sample. Raises ``ShardError`` for a damaged one."""
    content = read_json(meta)
    return {name: content[name] for name in ("seed", "index", "recipe", "versions")}


def natural(name: str, value: int, least: int = 0) -> int:
    """The value of an argument that counts something. Raises ``ConfigError`` unless it is whole and ``least`` or more.

    >>> natural("batch_size", 8, least=1)
    8
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if number < least:
        raise ConfigError(f"{name}={value!r}: give a whole number, {least} or more")
    return number


def function(name: str, value: Any) -> Any:
    """The value of an argument that is called. Raises ``ConfigError`` for one that cannot be."""
    if not callable(value):
        raise ConfigError(f"{name}={value!r:.99}: give a function that takes an item, or leave it out")
    return value


def as_item(members: Mapping[str, Bytes], fields: Iterable[str]) -> Item:
    """Encoded members as tensors, parsed JSON and pictures."""
    item = {}
    for field in fields:
        value = decode_field(field, members[FIELDS[field]])
        item[field] = tensor_of(value) if isinstance(value, np.ndarray) else value
    return item


def tensor_of(array: np.ndarray) -> torch.Tensor:
    """The array as a tensor, without a copy where it is writable."""
    # Views of ``bytes`` are read-only, which no tensor can be.
    return torch.from_numpy(array if array.flags.writeable else array.copy())
