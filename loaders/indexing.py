"""Indices of a data set: an integer, a key, a list of either, or a slice.

>>> resolve_index(np.int64(-1), 10), index_list(torch.tensor([1, 2]))
(9, [1, 2])
>>> resolve_index(10, 10)
Traceback (most recent call last):
...
gcd_dataset.loaders.indexing.IndexRangeError: garment 10 of 10: give -10 to 9
"""

import operator
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from itertools import islice
from typing import Any

import numpy as np
import torch

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.layout import key_of

MOST_COMPARED = 10_000  # keys that are compared with an unknown one


class InvalidIndexError(ConfigError, TypeError):
    """An index that is neither an integer nor a name."""


class IndexRangeError(ConfigError, IndexError):
    """An index beyond the length."""


class UnknownKeyError(ConfigError, KeyError):
    """A key or name that no item has."""

    __str__ = Exception.__str__  # KeyError's own puts the message in quotes


def resolve_index(index: Any, length: int, what: str = "garment") -> int:
    """An index as a position from 0; negative indices count from the end.

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
    """The indices in a list, array or tensor; ``None`` for a single index. Raises ``InvalidIndexError``."""
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


def unknown_key(key: str, keys: Iterable[str], like: Sequence[str]) -> UnknownKeyError:
    """The error for an unknown key, with similar keys.

    ``keys``: the known keys; ``like``: the first and the last, for the message.
    """
    digits = re.sub(r"[^0-9]", "", key)[:18]
    compared = list(islice(keys, MOST_COMPARED))
    by_digits = [key_of(int(digits))] if digits else []
    near = [name for name in by_digits if name in compared] or get_close_matches(key, compared, n=3)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    known = f"keys are {like[0]} to {like[1]}" if like[0] != like[1] else f"there is {like[0]}"
    return UnknownKeyError(f"no garment {key!r:.99}: {hint}{known}")
