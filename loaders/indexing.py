"""What may stand in the brackets behind a data set: a number, a name, several of these, or a slice.

>>> index_of(np.int64(-1), 10), several_of(torch.tensor([1, 2]))
(9, [1, 2])
>>> index_of(10, 10)
Traceback (most recent call last):
...
IndexError: garment 10 of 10: give -10 to 9
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

__all__ = ["NoIndexError", "UnknownKeyError", "index_of", "number_in", "number_of", "several_of", "unknown_key"]

LOOKED_AT = 10_000  # keys, for those that look like one that is not there


class NoIndexError(ConfigError, TypeError):
    """Something in brackets that is neither a number nor a name."""


class UnknownKeyError(ConfigError, KeyError):
    """A name that nothing has."""

    __str__ = Exception.__str__  # that of KeyError puts the message in quotes


def index_of(index: Any, length: int, what: str = "garment") -> int:
    """The position, from 0, that a whole number of any kind names; negative ones count from the end.

    Raises ``IndexError``, and ``NoIndexError`` for anything but a whole number.
    """
    number = number_of(index, what)
    if not -length <= number < length:
        raise IndexError(
            f"{what} {number} of {length}: give {f'-{length} to {length - 1}' if length else 'one with some'}"
        )
    return number % length


def number_of(index: Any, what: str = "garment") -> int:
    """The index as an integer. Raises ``NoIndexError`` for anything but a whole number; for True and False too."""
    if type(index) is int:
        return index
    is_bool = isinstance(index, bool | np.bool_) or getattr(index, "dtype", None) in (torch.bool, np.bool_)
    try:
        if not is_bool:
            return operator.index(index)
    except (TypeError, RuntimeError):  # the second of a tensor of several numbers
        pass
    told = type(index).__name__ if isinstance(index, torch.Tensor | np.ndarray) else repr(index)
    mask = ", of a mask where it is true" if is_bool else ""
    raise NoIndexError(f"{what} {told}: give a whole number{mask}, a name, a list of these, or a slice")


def several_of(index: Any) -> list[Any] | None:
    """The indices in a list, array or tensor of them; ``None`` for one index. Raises ``NoIndexError``."""
    if isinstance(index, torch.Tensor | np.ndarray):
        if index.ndim == 0:
            return None
        if index.ndim > 1 or str(index.dtype).removeprefix("torch.").rstrip("0123456789") not in ("int", "uint"):
            form = f"{str(index.dtype).removeprefix('torch.')} of shape {list(index.shape)}"
            raise NoIndexError(
                f"an array of {form} in brackets: give whole numbers in one row, such as mask.nonzero()[0]"
            )
        numbers: list[Any] = index.tolist()
        return numbers
    return list(index) if isinstance(index, Sequence) and not isinstance(index, str | bytes) else None


def number_in(key: str) -> int | None:
    """The number of the sample with a key of ours; ``None`` for another key.

    >>> number_in("gcd_000000012"), number_in("gcd_12")
    (12, None)
    """
    match = re.fullmatch(r"gcd_([0-9]{9,18})", key)
    return int(match[1]) if match and key_of(int(match[1])) == key else None


def unknown_key(key: str, keys: Iterable[str], like: Sequence[str]) -> UnknownKeyError:
    """The error for a key that is none of ``keys``, with those that look like it; ``like``: a first and a last one."""
    digits = re.sub(r"[^0-9]", "", key)[:18]
    some = list(islice(keys, LOOKED_AT))
    meant = [key_of(int(digits))] if digits else []
    near = [name for name in meant if name in some] or get_close_matches(key, some, n=3)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    there = f"keys are {like[0]} to {like[1]}" if like[0] != like[1] else f"there is {like[0]}"
    return UnknownKeyError(f"no garment {key!r:.99}: {hint}{there}")
