"""What every data set of garments has in common."""

import operator
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch.utils.data import Dataset

from gcd_dataset.errors import ConfigError, ShardError, TransformError
from gcd_dataset.loaders.available import fields_held
from gcd_dataset.loaders.indexing import (
    UnknownKeyError,
    index_of,
    number_in,
    several_of,
    unknown_key,
)
from gcd_dataset.loaders.one_thread import as_type
from gcd_dataset.shards.codec import decode_field, read_meta
from gcd_dataset.shards.layout import FIELDS, Bytes, key_of, members_of

__all__ = [
    "GarmentItem",
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
NOTHING: Mapping[str, str] = {}


class GarmentItem(dict[str, Any]):
    """A loaded garment: a dict that names what it holds where something else is asked for.

    torch's own ``default_collate`` cannot stack garments of different sizes, and says what does.
    """

    def __missing__(self, field: object) -> Any:
        raise UnknownKeyError(
            f"the garment has no {field!r:.99}: it holds {', '.join(self)}; fields= of its data set chooses"
        )


class Garments(Dataset[Item], ABC):
    """Garments by number or key; ``fields`` chooses what an item holds, ``transform`` changes it on the way out.

    ======================================  ============================================================================
    ``ds[7]``, ``ds[-1]``, ``ds[i]``        one item; ``i`` may be a whole number of NumPy or torch
    ``ds["gcd_000000012"]``                 the garment of that key, as ``item["meta"]["key"]`` has it
    ``ds[[1, 2, 5]]``, ``ds[indices]``      a list of items, for a list, array or tensor of numbers, or a list of keys
    ``ds[2:5]``                             a data set of these garments
    ======================================  ============================================================================

    Without ``fields`` an item holds all that the garments have: those made up to the box mesh have no ``verts``.
    Floating fields come as ``dtype``, float32 by default; ``None`` keeps what is stored, such as the float64 of
    ``panels`` and ``edges``, which a pattern is decoded from to the last digit. Raises ``ConfigError`` for a field that
    no garment holds, for a ``transform`` that cannot be called, and a ``dtype`` that is not of floating numbers.
    """

    reads_only = False
    """Whether garments are only read, so that a thread beside the training can do it as well as a process."""
    endless = False
    """Whether numbers from ``len()`` on are garments too, those of the epochs that follow in an order of their own."""
    together = 1
    """Consecutive garments that share a design, from each multiple of this number: one process makes them fastest."""

    def __init__(
        self,
        fields: Iterable[str] | None,
        transform: Transform | None,
        *,
        there: Iterable[str] = FIELDS,
        lacking: Mapping[str, str] = NOTHING,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        self.fields = fields_held(fields, there, lacking)
        """Names of what an item holds; see ``gcd_dataset.shards.codec`` for shapes, types and units."""
        self.transform = None if transform is None else function("transform", transform)
        self.dtype = floating(dtype)
        """Of the floating fields; ``None`` for what is stored."""

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

    def __getitem__(self, index: Any) -> Any:
        """Garment ``index``, a number or a key; a list of garments for several, for a slice a data set of them.

        Raises ``IndexError``, ``KeyError`` for a key that no garment has, ``TypeError`` for what is no index.
        """
        if isinstance(index, slice):
            return self.select(range(len(self))[index])
        several = several_of(index)
        return self._one(self._position(index)) if several is None else self.__getitems__(several)

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

    def __repr__(self) -> str:
        told = ", ".join([*self._described(), f"{len(self)} garments"])
        return f"{type(self).__name__}({told}: {', '.join(self.fields)})"

    def tell_wait(self) -> None:
        """Log, once, how long a garment takes to make here, if that is long enough to wonder."""

    def _one(self, position: int) -> Any:
        """The garment at a position from 0 on."""
        return self._item(self._members(position, members_of(self.fields)), position)

    def _described(self) -> list[str]:
        """What tells this data set from others, for people."""
        return []

    def _item(self, members: Mapping[str, Bytes], position: int) -> Any:
        """The item in some members; ``position`` for an error of the transform."""
        return self._transformed(as_item(members, self.fields, self.dtype), position)

    def _transformed(self, item: GarmentItem, position: int) -> Any:
        if self.transform is None:
            return item
        with changing(self, position):
            return kept_item(self.transform(item))

    def _position(self, index: int | str) -> int:
        """The position that a number or a key names. Raises ``IndexError``, ``KeyError``, ``TypeError``."""
        return self._with_key(index) if isinstance(index, str) else index_of(index, len(self))

    def _with_key(self, key: str) -> int:
        found = self._of_key(key)
        if found is None:
            if not len(self):
                raise UnknownKeyError(f"no garment {key!r:.99}: the data set is empty")
            raise unknown_key(key, map(self._key, range(len(self))), [self._key(0), self._key(len(self) - 1)])
        return found

    def _of_key(self, key: str) -> int | None:
        """The position of the garment with a key, if there is one."""
        number = number_in(key)
        return number if number is not None and number < len(self) else None

    def _key(self, position: int) -> str:
        """The key of the garment at a position."""
        return key_of(position)


class SelectedGarments(Garments):
    """Some garments of a data set, in an order of their own; fields and transform are those of the whole."""

    def __init__(self, whole: Garments, positions: Sequence[int]) -> None:
        super().__init__(whole.fields, whole.transform, there=whole.fields, dtype=whole.dtype)
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

    def _one(self, position: int) -> Any:
        return self.whole[int(self.positions[position])]

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments, at once where the whole can do that."""
        return items_of(self.whole, [int(self.positions[self._position(index)]) for index in indices])

    def stream(self, indices: Iterable[int]) -> Iterator[Any]:
        """Garments one after the other, as the whole gives them."""
        return self.whole.stream(int(self.positions[self._position(index)]) for index in indices)

    def identity(self) -> dict[str, Any]:
        """That of the whole, and which of it."""
        return {"of": self.whole.identity(), "chosen": zlib.crc32(self.positions.tobytes())}

    def tell_wait(self) -> None:
        self.whole.tell_wait()

    def _described(self) -> list[str]:
        return [f"of {type(self.whole).__name__}", *self.whole._described()]

    def _of_key(self, key: str) -> int | None:
        position = self.whole._of_key(key)
        return None if position is None else next(iter(np.flatnonzero(self.positions == position).tolist()), None)

    def _key(self, position: int) -> str:
        return self.whole._key(int(self.positions[position]))

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
        if isinstance(error, Exception) and self._indices:
            which = f"{', '.join(map(str, self._indices))} of {type(self._dataset).__name__}"
            error.add_note(f"while loading {'garment' if len(self._indices) == 1 else 'garments'} {which}")


class changing:  # noqa: N801 -- a context manager, named as functions are
    """Turn an error of a transform into a ``TransformError`` that names the garment."""

    # A class: entered for every garment, as ``naming`` is.
    __slots__ = ("_dataset", "_position")

    def __init__(self, dataset: Garments, position: int) -> None:
        self._dataset, self._position = dataset, position

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        # One that is named already comes from a data set in this one.
        if isinstance(error, Exception) and not isinstance(error, TransformError):
            dataset = f"{type(self._dataset).__name__}({', '.join(self._dataset._described())})"
            garment = f"{self._dataset._key(self._position)}, number {self._position} of {dataset}"
            told = " ".join(f"{type(error).__name__}: {error}".split())
            raise TransformError(f"the transform of {garment}: {told}") from error


def _item_of(dataset: Any, index: Any) -> Any:
    with naming(dataset, index):
        return dataset[index]


def made_with(meta: Bytes) -> dict[str, Any]:
    """Seed, index, options and versions in the ``meta.json`` of a sample. Raises ``ShardError`` for a damaged one."""
    content = read_meta(meta)
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


def floating(dtype: Any) -> torch.dtype | None:
    """The type of floating numbers, or ``None``. Raises ``ConfigError`` for anything else."""
    if dtype is None or (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
        return dtype
    raise ConfigError(
        f"dtype={dtype!r:.99}: give a type of floating numbers, such as torch.float32, or None to keep what is stored"
    )


def as_item(members: Mapping[str, Bytes], fields: Iterable[str], dtype: torch.dtype | None = None) -> GarmentItem:
    """Encoded members as tensors, floating ones as ``dtype``, parsed JSON and pictures."""
    item = GarmentItem()
    for field in fields:
        value = decode_field(field, members)
        try:
            item[field] = tensor_of(value, dtype) if isinstance(value, np.ndarray) else value
        except ShardError as error:
            raise ShardError(f"member {FIELDS.get(field, field)}: {error}") from error
    return item


def kept_item(item: Any) -> Any:
    """What a transform has made of an item; a dict as an item again."""
    return GarmentItem(item) if type(item) is dict else item


def tensor_of(array: np.ndarray, dtype: torch.dtype | None = None) -> torch.Tensor:
    """The array as a tensor, floating numbers as ``dtype``; without a copy where it is of that and writable."""
    if array.dtype == np.float64 and dtype is torch.float32:  # most arrays of a pattern: NumPy takes half the time
        try:
            with np.errstate(over="raise"):
                return torch.from_numpy(array.astype(np.float32))
        except FloatingPointError as error:
            raise ShardError("numbers beyond float32: dtype=None keeps them as they are stored") from error
    # Views of ``bytes`` are read-only, which no tensor can be.
    tensor = torch.from_numpy(array if array.flags.writeable else array.copy())
    return tensor if dtype is None or not tensor.is_floating_point() else as_type(tensor, dtype)
