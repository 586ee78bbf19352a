"""Named arrays in one file (``.npz``), of which every size is known before anything is allocated."""

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

ROOM = 1 << 20  # bytes that a small file may hold, however well they were compressed


class Column(NamedTuple):
    """What an array has to be."""

    kinds: str
    """NumPy's letters for the types allowed."""
    axes: int
    needed: bool = True


def read_arrays(content: bytes, columns: Mapping[str, Column]) -> dict[str, np.ndarray]:
    """The arrays in a file's content, of those named; others are left out.

    Raises ``ShardError`` for a file that is no such archive, lacks a column, has one of another type, or holds more
    than ``LARGEST_INDEX`` times its own size.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            entries = {info.filename.removesuffix(".npy"): info for info in file.infolist()}
            size = sum(info.file_size for info in entries.values())
            if size > max(LARGEST_INDEX * len(content), ROOM):
                raise ShardError(f"{size} bytes in a file of {len(content)}")
            return {
                name: _column(name, file.read(entries[name]), column)
                for name, column in columns.items()
                if column.needed or name in entries
            }
    except KeyError as error:
        raise ShardError(f"no column {error.args[0]}") from error
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError, ValueError) as error:
        raise ShardError("no archive of arrays, or cut off") from error


def _column(name: str, data: bytes, column: Column) -> np.ndarray:
    try:
        array = read_any_npy(data, column.kinds)
    except ShardError as error:
        raise ShardError(f"column {name}: {error}") from error
    if array.ndim != column.axes:
        raise ShardError(f"column {name} of shape {array.shape}, where {column.axes} axes are read")
    return array
