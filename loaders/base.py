"""Base classes of the data sets of garments, and the checks of their arguments."""

import contextlib
import inspect
import math
import operator
import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import fields
from difflib import get_close_matches
from functools import cached_property, partial
from typing import Any, SupportsIndex, TypeAlias, overload

import numpy as np
import torch
from jaxtyping import Int
from torch.utils.data import Dataset

from gcd_dataset.errors import ConfigError, ShardError, TransformError
from gcd_dataset.loaders.fields import GarmentFields, select_present_fields
from gcd_dataset.records import Sample
from gcd_dataset.shards.codec import decode_fields, decode_sample
from gcd_dataset.shards.layout import FIELDS, MEMBERS, Bytes, is_picture, key_of, members_of
from gcd_dataset.shards.meta import read_meta

MOST_COMPARED = 10_000  # keys that are compared with an unknown one
CHUNK = 1 << 15  # elements: torch converts larger tensors with several threads

Item: TypeAlias = Mapping[str, Any]
"""An item: ``GarmentFields``, or fields with what users' transforms made of them."""
Transform: TypeAlias = Callable[[Any], Any]
UserCode: TypeAlias = Callable[[Any, int], Any]
"""``(item, index)`` to the transformed item."""
NOTHING: Mapping[str, str] = {}


class InvalidIndexError(ConfigError, TypeError):
    """An index that is neither an integer nor a name."""


class IndexRangeError(ConfigError, IndexError):
    """An index beyond the length."""


class UnknownKeyError(ConfigError, KeyError):
    """A key or name that no item has."""

    __str__ = Exception.__str__  # KeyError's own puts the message in quotes


class GarmentItem(dict[str, Any]):
    """A loaded garment: a dict of fields, with a plain message for a missing field.

    A class of its own, so that torch's ``default_collate`` can refuse garments of different sizes with a remedy.
    """

    def __missing__(self, field: object) -> Any:
        raise UnknownKeyError(
            f"the garment has no {field!r:.99}: it holds {', '.join(self)}; fields= of its data set chooses"
        )

    def _repr_html_(self) -> str:
        from gcd_dataset.viewer.notebook import item_html

        return item_html(self)


class Garments(Dataset[GarmentFields], ABC):
    """Garments by index or key; ``fields`` selects the fields of an item, ``transform`` is called with each item.

    ======================================  ============================================================================
    ``ds[7]``, ``ds[-1]``, ``ds[i]``        one item; ``i`` may be an integer of NumPy or torch
    ``ds["gcd_000000012"]``                 the garment of that key; its item has it as ``item["meta"]["key"]``
    ``ds[[1, 2, 5]]``, ``ds[indices]``      a list of items, for a list, array or tensor of integers, or a list of keys
    ``ds[2:5]``                             a data set of garments 2, 3 and 4
    ======================================  ============================================================================

    Without ``fields`` an item holds every field that the garments have; garments of stage ``mesh`` have no ``verts``.
    Floating fields are cast to ``dtype``, float32 by default. ``None`` keeps the stored types: ``panels`` and ``edges``
    are float64, which lossless decoding of the pattern requires. Raises ``ConfigError`` for a field that no
    garment holds, a ``transform`` that is not callable, and a ``dtype`` that is not floating.
    """

    reads_only = False
    """Whether items are read from storage, not generated: a thread then loads them as fast as worker processes."""
    endless = False
    """Whether indices beyond ``len()`` are valid: the following epochs, each in its own order."""
    window: int | None = None
    """Number of shards among which a random order moves freely (``shard_lengths``); ``None``: all."""
    garments_per_design = 1
    """Number of consecutive garments that share a design; fastest if one process makes them all."""

    def __init__(
        self,
        fields: Iterable[str] | None,
        transform: Transform | None,
        *,
        available: Iterable[str] = FIELDS,
        absent: Mapping[str, str] = NOTHING,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        self._member_of = available if isinstance(available, Mapping) else FIELDS
        self.fields = select_present_fields(fields, available, absent)
        """Names of the fields of an item; see ``gcd_dataset.shards.codec`` for shapes, types and units."""
        self.transform = None if transform is None else require_callable("transform", transform)
        self.dtype = require_float_dtype(dtype)
        """Type of the floating fields; ``None`` keeps the stored type."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions of garment ``index``: enough to make it again."""

    def sample(self, index: int | str) -> Sample:
        """The record of garment ``index``, with all that is stored or made of it, whatever ``fields`` are.

        Raises as ``ds[i]`` does, and ``ConfigError`` where members are missing, as in a download of some fields.
        """
        members = self._members(self._position(index), tuple(self._member_of.values()))
        if missing := [member for member in MEMBERS if member not in members and not is_picture(member)]:
            raise ConfigError(f"sample {index}: the data set holds no {missing[0]}: give one with all members")
        return decode_sample(members)

    @abstractmethod
    def verify(self, index: int) -> None:
        """Raise ``ShardError`` if the bytes of garment ``index`` differ from the expected ones."""

    def identity(self) -> dict[str, Any]:
        """Identity of the data set, independent of its path: length, and the recipes of its first and last garment."""
        recipes = [self.recipe(index) for index in (0, -1)]
        ends = [{name: recipe[name] for name in ("seed", "index", "recipe")} for recipe in recipes]
        return {"length": len(self), "ends": ends}

    @abstractmethod
    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        """Encoded members of a garment, at least those named in ``members``."""

    @overload
    def __getitem__(self, index: slice) -> "Garments": ...
    @overload
    def __getitem__(self, index: SupportsIndex | str) -> GarmentFields: ...
    @overload
    def __getitem__(self, index: Sequence[int] | list[str]) -> list[GarmentFields]: ...
    def __getitem__(self, index: Any) -> Any:
        """The item of an index or key; a list of items for several, a data set for a slice.

        Raises ``IndexError``, ``KeyError`` for an unknown key, ``TypeError`` for a value that is no index.
        """
        if isinstance(index, slice):
            return self.select(range(len(self))[index])
        several = index_list(index)
        return self._load(self._position(index)) if several is None else self.__getitems__(several)

    def __iter__(self) -> Iterator[GarmentFields]:
        return (self[index] for index in range(len(self)))

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """The items of a batch; a ``DataLoader`` calls this."""
        return [self[index] for index in indices]

    def stream(self, indices: Iterable[int]) -> Iterator[Any]:
        """Stream items; ``indices`` may be infinite and is consumed lazily."""
        return (self[index] for index in indices)

    def select(self, indices: Iterable[int]) -> "Garments":
        """A data set of the garments at ``indices`` or of these keys, in this order.

        Raises as ``ds[i]`` does, and ``ConfigError`` for anything but several of them.
        """
        is_array = isinstance(indices, torch.Tensor | np.ndarray)
        if isinstance(indices, Iterable) and not is_array and not isinstance(indices, str | bytes | Mapping):
            indices = list(indices)
        several = index_list(indices)
        if several is None:
            hint = "select by a condition with [i for i, item in enumerate(dataset) if condition(item)]"
            raise ConfigError(f"select({indices!r:.99}): give indices or keys in a list, array or range; {hint}")
        return SelectedGarments(self, [self._position(index) for index in several])

    def __repr__(self) -> str:
        description = ", ".join([*self._description(), f"{len(self)} garments"])
        return f"{type(self).__name__}({description}: {', '.join(self.fields)})"

    def _repr_html_(self) -> str:
        from gcd_dataset.viewer.notebook import dataset_html

        return dataset_html(self)

    def _load(self, position: int) -> Any:
        """The item at a position: an index normalised to 0 … ``len(self)`` - 1."""
        return self._item(self._members(position, self._member_names), position)

    @cached_property
    def _member_names(self) -> tuple[str, ...]:
        """The members that the fields are decoded from."""
        return members_of(self.fields, self._member_of)

    def _description(self) -> list[str]:
        """Words for ``repr`` and error messages, such as seed or folder."""
        return []

    def _item(self, members: Mapping[str, Bytes], position: int) -> Any:
        """Decode members to an item and transform it; ``position`` is for the error message."""
        return self._transformed(decode_item(members, self.fields, self.dtype), position)

    def _transformed(self, item: Any, position: int) -> Any:
        if self.transform is None:
            return item
        with as_transform_error(self, position):
            return wrap_item(self.transform(item))

    def _separated(self) -> tuple["Garments", UserCode | None]:
        """This data set without users' code, and that code; a data set of a user's class stays as it is."""
        if self.transform is None or not is_of_package(type(self)):
            return self, None
        return self._with(transform=None), self._transformed

    def _with(self, **attributes: Any) -> Any:
        other = copy(self)
        other.__dict__.update(attributes)
        return other

    def _position(self, index: int | str) -> int:
        """The position of an index or key. Raises ``IndexError``, ``KeyError``, ``TypeError``."""
        return self._require_key(index) if isinstance(index, str) else resolve_index(index, len(self))

    def _require_key(self, key: str) -> int:
        position = self._find_key(key)
        if position is None:
            if not len(self):
                raise UnknownKeyError(f"no garment {key!r:.99}: the data set is empty")
            compared = list(dict.fromkeys(map(self._key, range(min(len(self), MOST_COMPARED)))))
            digits = re.sub(r"[^0-9]", "", key)[:18]
            by_digits = [key_of(int(digits))] if digits else []
            near = [name for name in by_digits if name in compared] or get_close_matches(key, compared, n=3)
            hint = f"did you mean {' or '.join(near)}? " if near else ""
            first, last = self._key(0), self._key(len(self) - 1)
            known = f"keys are {first} to {last}" if first != last else f"there is {first}"
            raise UnknownKeyError(f"no garment {key!r:.99}: {hint}{known}")
        return position

    def _find_key(self, key: str) -> int | None:
        """The position of the garment with a key; ``None`` if there is none."""
        number = index_from_key(key)
        return number if number is not None and number < len(self) else None

    def _key(self, position: int) -> str:
        return key_of(position)


class DerivedGarments(Garments):
    """Garments of another data set, ``whole``."""

    def __init__(self, whole: Garments, transform: Transform | None) -> None:
        super().__init__(whole.fields, transform, available=whole.fields, dtype=whole.dtype)
        self.whole, self.reads_only = whole, whole.reads_only

    def _in_whole(self, position: int) -> int:
        """The index in ``whole`` of a position."""
        return position

    def recipe(self, index: int) -> dict[str, Any]:
        return self.whole.recipe(self._in_whole(self._position(index)))

    def verify(self, index: int) -> None:
        self.whole.verify(self._in_whole(self._position(index)))

    def sample(self, index: int | str) -> Sample:
        return self.whole.sample(self._in_whole(self._position(index)))

    def _description(self) -> list[str]:
        return [f"of {type(self.whole).__name__}", *self.whole._description()]

    def _key(self, position: int) -> str:
        return self.whole._key(self._in_whole(position))

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return self.whole._members(self._in_whole(position), members)


class SelectedGarments(DerivedGarments):
    """Selected garments of a data set, in a given order; fields and transform are those of the data set."""

    def __init__(self, whole: Garments, positions: Sequence[int]) -> None:
        super().__init__(whole, whole.transform)
        self.positions = np.asarray(positions, np.int64)
        """Index in ``whole`` of each selected garment."""
        if len(positions) and _are_whole_designs(self.positions, whole.garments_per_design):
            self.garments_per_design = whole.garments_per_design

    def __len__(self) -> int:
        return len(self.positions)

    def _in_whole(self, position: int) -> int:
        return int(self.positions[position])

    def _load(self, position: int) -> Any:
        return self.whole[self._in_whole(position)]

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """The items of a batch, fetched from ``whole`` in one call where it can."""
        return load_items(self.whole, [self._in_whole(self._position(index)) for index in indices])

    def stream(self, indices: Iterable[int]) -> Iterator[Any]:
        return self.whole.stream(self._in_whole(self._position(index)) for index in indices)

    def _separated(self) -> tuple[Garments, UserCode | None]:
        whole, code = self.whole._separated()
        if code is None:
            return self, None
        return self._with(whole=whole, transform=None), partial(_of_selected, code, self.positions)

    def identity(self) -> dict[str, Any]:
        """Identity of ``whole``, and a checksum of the selected indices."""
        return {"of": self.whole.identity(), "chosen": zlib.crc32(self.positions.tobytes())}

    def _find_key(self, key: str) -> int | None:
        position = self.whole._find_key(key)
        return None if position is None else next(iter(np.flatnonzero(self.positions == position).tolist()), None)


def _of_selected(code: UserCode, positions: Int[np.ndarray, " n"], item: Any, index: int) -> Any:
    return code(item, int(positions[index]))


def is_of_package(kind: type) -> bool:
    """Whether a class is of this package, and so draws no global random numbers."""
    return kind.__module__.partition(".")[0] == __name__.partition(".")[0]


def _are_whole_designs(positions: Int[np.ndarray, " n"], garments_per_design: int) -> bool:
    """Whether every ``garments_per_design`` consecutive positions, and the rest at the end, are of one design."""
    design = positions // garments_per_design
    return bool((design == np.repeat(design[::garments_per_design], garments_per_design)[: len(design)]).all())


def load_items(dataset: Any, indices: Sequence[int]) -> list[Any]:
    """The items at some indices, in one call where the data set has ``__getitems__``.

    An error gets a note that names the indices.
    """
    if hasattr(dataset, "__getitems__"):
        with note_items(dataset, *indices):
            return dataset.__getitems__(indices)
    items = []
    for index in indices:
        with note_items(dataset, index):
            items.append(dataset[index])
    return items


@contextlib.contextmanager
def note_items(dataset: Any, *indices: int) -> Iterator[None]:
    """Add a note with the indices to an error."""
    try:
        yield
    except Exception as error:
        if indices:
            items = f"{', '.join(map(str, indices))} of {type(dataset).__name__}"
            error.add_note(f"while loading {'garment' if len(indices) == 1 else 'garments'} {items}")
        raise


@contextlib.contextmanager
def as_transform_error(dataset: Garments, position: int) -> Iterator[None]:
    """Turn an error of a transform into a ``TransformError`` that names the garment."""
    try:
        yield
    except TransformError:  # of a nested data set: it names its garment already
        raise
    except Exception as error:
        name = f"{type(dataset).__name__}({', '.join(dataset._description())})"
        garment = f"{dataset._key(position)}, number {position} of {name}"
        message = " ".join(f"{type(error).__name__}: {error}".split())
        raise TransformError(f"the transform of {garment}: {message}") from error


def resolve_index(index: Any, length: int, what: str = "garment") -> int:
    """An index as a position from 0; negative indices count from the end.

    >>> resolve_index(np.int64(-1), 10)
    9

    Raises ``IndexError``, and ``InvalidIndexError`` for anything but an integer.
    """
    number = require_whole_number(index, what)
    if not -length <= number < length:
        raise IndexRangeError(
            f"{what} {number} of {length}: give {f'-{length} to {length - 1}' if length else 'a non-empty data set'}"
        )
    return number % length


def require_whole_number(index: Any, what: str = "garment") -> int:
    """The index as an int. Raises ``InvalidIndexError`` for anything but an integer, also for a bool."""
    if type(index) is int:
        return index
    is_bool = isinstance(index, bool | np.bool_) or getattr(index, "dtype", None) in (torch.bool, np.bool_)
    try:
        if not is_bool:
            return operator.index(index)
    except (TypeError, RuntimeError):  # RuntimeError: a tensor of several elements
        pass
    given = type(index).__name__ if isinstance(index, torch.Tensor | np.ndarray) else repr(index)
    mask = " (for a mask: the positions of its true entries)" if is_bool else ""
    raise InvalidIndexError(f"{what} {given}: give a whole number{mask}, a name, a list of these, or a slice")


def index_list(index: Any) -> list[Any] | None:
    """The indices in a list, array or tensor; ``None`` for a single index. Raises ``InvalidIndexError``.

    >>> index_list(torch.tensor([1, 2]))
    [1, 2]
    """
    if isinstance(index, torch.Tensor | np.ndarray):
        if index.ndim == 0:
            return None
        if index.ndim > 1 or str(index.dtype).removeprefix("torch.").rstrip("0123456789") not in ("int", "uint"):
            form = f"{str(index.dtype).removeprefix('torch.')} of shape {list(index.shape)}"
            column = "[:, 0]" if isinstance(index, torch.Tensor) else "[0]"
            raise InvalidIndexError(
                f"indices in an array of {form}: give whole numbers in one row, such as mask.nonzero(){column}"
            )
        numbers: list[Any] = index.tolist()
        return numbers
    return list(index) if isinstance(index, Sequence) and not isinstance(index, str | bytes) else None


def index_from_key(key: str) -> int | None:
    """The index in a key of this package; ``None`` for any other key.

    >>> index_from_key("gcd_000000012"), index_from_key("gcd_12")
    (12, None)
    """
    match = re.fullmatch(r"gcd_([0-9]{9,18})", key)
    return int(match[1]) if match and key_of(int(match[1])) == key else None


def recipe_from_meta(meta: Bytes) -> dict[str, Any]:
    """Seed, index, options and versions from a sample's ``meta.json``. Raises ``ShardError`` if it is damaged."""
    content = read_meta(meta)
    return {name: content[name] for name in ("seed", "index", "recipe", "versions")}


def require_integer(name: str, value: int, least: int = 0, most: int | None = None) -> int:
    """An argument as an integer. Raises ``ConfigError`` unless it is an integer from ``least`` to ``most``.

    >>> require_integer("batch_size", 8, least=1)
    8
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if number < least or isinstance(value, bool):
        raise ConfigError(f"{name}={value!r:.99}: give a whole number, {least} or more")
    if most is not None and number > most:
        raise ConfigError(f"{name}={number}: give {most} or less")
    return number


def require_number(name: str, value: Any, *, least: float = 0.0, most: float = math.inf, unit: str = "") -> float:
    """An argument as a float. Raises ``ConfigError`` unless it is a finite number from ``least`` to ``most``."""
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (is_number and least <= value <= most and math.isfinite(value)):
        limits = f"{least:g}{unit} or more" if most == math.inf else f"{least:g} to {most:g}{unit}"
        raise ConfigError(f"{name}={value!r:.99}: give a finite number{'' if least == -math.inf else f', {limits}'}")
    return float(value)


def require_garments(name: str, value: Any) -> None:
    """Raise ``ConfigError`` for an argument that is no data set of garments."""
    if not isinstance(value, Garments):
        raise ConfigError(f"{name} is a {type(value).__name__}: give GarmentDataset, GeneratedGarments or the like")


def require_callable(name: str, value: Any, takes: str = "item") -> Any:
    """The argument. Raises ``ConfigError`` for anything but a function of ``takes``, such as ``item, rng``."""
    if not callable(value):
        raise ConfigError(f"{name}={value!r:.99}: give a function of {takes}")
    if not _can_take(value, takes):
        remedy = f"a function of {takes}"
        if takes == "item" and _can_take(value, "item, rng"):
            remedy = "it to Augmented(dataset, augment), which passes each garment's random stream"
        raise ConfigError(f"{name}={value!r:.99} cannot be called with ({takes}): give {remedy}")
    return value


def _can_take(function: Callable[..., Any], arguments: str) -> bool:
    try:
        inspect.signature(function).bind(*arguments.split(", "))
    except ValueError:  # a function in C, without a signature
        return True
    except TypeError:
        return False
    return True


def require_ranges(name: str, given: Any, usual: Any) -> Any:
    """``given``, or ``usual`` for ``None``. Raises ``ConfigError`` for another dataclass, and for invalid numbers."""
    if given is None:
        return usual
    if not isinstance(given, type(usual)):
        raise ConfigError(f"{name}={given!r:.99}: give {type(usual).__name__}(…), or leave it out")
    for entry in fields(given):
        value, default = getattr(given, entry.name), getattr(usual, entry.name)
        if type(default) is float:
            require_number(f"{entry.name} of {name}", value)
        elif isinstance(default, tuple) and default and type(default[0]) is float:
            for number in value if isinstance(value, tuple) else [value]:
                require_number(f"{entry.name} of {name}", number, least=-math.inf)
    return given


def require_float_dtype(dtype: Any) -> torch.dtype | None:
    """The floating type, or ``None``. Raises ``ConfigError`` for anything else."""
    if dtype is None or (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
        return dtype
    raise ConfigError(
        f"dtype={dtype!r:.99}: give a floating type, such as torch.float32, or None to keep the stored types"
    )


def decode_item(members: Mapping[str, Bytes], fields: Iterable[str], dtype: torch.dtype | None = None) -> GarmentItem:
    """Decode members: arrays to tensors (floating ones as ``dtype``), JSON to values, pictures to uint8 tensors."""
    item = GarmentItem()
    for field, value in decode_fields(members, fields).items():
        try:
            item[field] = tensor_of(value, dtype) if isinstance(value, np.ndarray) else value
        except ShardError as error:
            raise ShardError(f"member {FIELDS.get(field, field)}: {error}") from error
    return item


def wrap_item(item: Any) -> Any:
    """The result of a transform; a plain dict becomes a ``GarmentItem`` again."""
    return GarmentItem(item) if type(item) is dict else item


def tensor_of(array: np.ndarray, dtype: torch.dtype | None = None) -> torch.Tensor:
    """The array as a tensor, floating numbers cast to ``dtype``; no copy if the type fits and the array is writable."""
    if array.dtype == np.float64 and dtype is torch.float32:  # patterns; twice as fast as torch's cast
        try:
            with np.errstate(over="raise"):
                return torch.from_numpy(array.astype(np.float32))
        except FloatingPointError as error:
            raise ShardError("numbers beyond the range of float32: dtype=None keeps the stored type") from error
    # Arrays that view ``bytes`` are read-only; tensors cannot be.
    tensor = torch.from_numpy(array if array.flags.writeable else array.copy())
    return tensor if dtype is None or not tensor.is_floating_point() else as_type(tensor, dtype)


def as_type(value: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    """The tensor cast to a type; the same tensor if it has that type."""
    if value.numel() <= CHUNK or value.dtype == dtype or value.device.type != "cpu" or torch.get_num_threads() == 1:
        return value.to(dtype)
    result = torch.empty(value.shape, dtype=dtype)
    source, target = value.reshape(-1), result.view(-1)
    for cut in range(0, len(source), CHUNK):
        target[cut : cut + CHUNK].copy_(source[cut : cut + CHUNK])
    return result
