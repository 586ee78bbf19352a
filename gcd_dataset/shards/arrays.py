"""Named arrays in one file (``.npz``); all sizes are checked before anything is allocated."""

import io
import zipfile
import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.limits import LARGEST_INDEX
from gcd_dataset.shards.npy import read_any_npy

__all__ = ["Column", "read_arrays"]

SMALL = 1 << 20  # bytes: unpacked arrays up to this size are read at any compression ratio


class Column(NamedTuple):
    """The type and the number of axes that an array must have."""

    kinds: str
    """NumPy's letters (``dtype.kind``) of the allowed types."""
    axes: int
    """Number of axes."""
    needed: bool = True


def read_arrays(content: bytes, columns: Mapping[str, Column]) -> dict[str, np.ndarray]:
    """Column name to array, for the names in ``columns``; other arrays in the file are skipped.

    Raises ``ShardError`` for a file that is no ``.npz``, lacks a needed column, has a column of another type or
    number of axes, or unpacks to more than ``SMALL`` bytes and more than ``LARGEST_INDEX`` times its own size.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            entries = {info.filename.removesuffix(".npy"): info for info in file.infolist()}
            size = sum(info.file_size for info in entries.values())
            if size > max(LARGEST_INDEX * len(content), SMALL):
                raise ShardError(f"arrays of {size} bytes in a file of {len(content)}")
            return {
                name: _column(name, file.read(entries[name]), column)
                for name, column in columns.items()
                if column.needed or name in entries
            }
    except KeyError as error:
        raise ShardError(f"column {error.args[0]} is missing") from error
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError, ValueError) as error:
        raise ShardError("not an .npz archive, or truncated") from error


def _column(name: str, data: bytes, column: Column) -> np.ndarray:
    try:
        array = read_any_npy(data, column.kinds)
    except ShardError as error:
        raise ShardError(f"column {name}: {error}") from error
    if array.ndim != column.axes:
        raise ShardError(f"column {name} of shape {array.shape} must have {column.axes} axes")
    return array
