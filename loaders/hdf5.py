"""``Hdf5Garments``: garments from one HDF5 file."""

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch

from gcd_dataset.errors import ShardError
from gcd_dataset.files import open_regular, user_path
from gcd_dataset.loaders.base import (
    GarmentItem,
    Garments,
    Transform,
    decode_item,
    index_from_key,
    recipe_from_meta,
    tensor_of,
)
from gcd_dataset.loaders.fields import absent_when_empty
from gcd_dataset.shards.codec import NO_PICTURE, WIDTHS
from gcd_dataset.shards.hdf5 import FORMAT, MEMBER_OF, crc_of, form_of
from gcd_dataset.shards.layout import ARRAYS, FIELDS, SCHEMA, Bytes, fields_of, key_of, members_of, split_worn
from gcd_dataset.shards.sections import pack

REMEDY = "copy it again, or make it again with gcd export"


class Hdf5Garments(Garments):
    """Garments in a file made by ``gcd export --hdf5``; items equal those of the exported shards.

    >>> ds = Hdf5Garments("train.h5", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape  # doctest: +SKIP
    torch.Size([14475, 3])

    On opening, types, shapes, places in the file and pointers are checked; links and data in other files are not
    followed. Each process of a ``DataLoader`` opens the file itself. Shards are several times as fast. ``fields`` and
    ``dtype`` as in ``GarmentDataset``. Raises ``ShardError`` for a missing, damaged or foreign file, or one of another
    schema, ``ConfigError`` for a field that no garment of the file holds.
    """

    reads_only = True

    def __init__(
        self,
        source: str | Path,
        fields: Iterable[str] | None = None,
        *,
        transform: Transform | None = None,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        self.path, self._opened = user_path(source), (0, None)
        try:
            with open_regular(self.path) as file:  # opening a pipe would wait for its writer
                self._size = os.fstat(file.fileno()).st_size
        except OSError as error:
            raise ShardError(f"{self.path}: cannot be read ({error.strerror}): give a file by gcd export") from error
        with self._reading() as file:
            self._ends = self._checked(file)
            self._numbers = self._column(file, "index", "<i8", (self._count,))[:]
            self.split = bytes(file.attrs["split"]).decode()
        available = {field: MEMBER_OF[field] for field in self._ends}
        least = {field: len(NO_PICTURE) if available[field].endswith(".jpg") else 0 for field in available}
        longest = {field: int(np.diff(ends).max(initial=0)) for field, ends in self._ends.items()}
        empty = {field for field in FIELDS if field in available and longest[field] <= least[field]}
        absent = absent_when_empty(empty.__contains__, [field for field in FIELDS if field in available])
        super().__init__(fields, transform, available=available, absent=absent, dtype=dtype)

    def __len__(self) -> int:
        return self._count

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` was made with. Raises ``IndexError``."""
        return recipe_from_meta(self._values(self._position(index), ["meta"])["meta"].tobytes())

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` if the rows and texts of garment ``index`` are not those written."""
        position = self._position(index)
        with self._reading() as file:
            stored = int(file["crc32"][position])
        if crc_of(self._values(position, self._ends).values()) != stored:
            raise ShardError(f"{self.path}: sample {position}: bytes differ from the written ones: {REMEDY}")

    def _load(self, position: int) -> Any:
        arrays = self._values(position, [field for field in self.fields if field in WIDTHS])
        others = [field for field in self.fields if field not in WIDTHS]
        item = decode_item(self._members(position, members_of(others, self._member_of)), others, self.dtype)
        item |= {field: tensor_of(rows, self.dtype) for field, rows in arrays.items()}
        return self._transformed(GarmentItem((field, item[field]) for field in self.fields), position)

    def _values(self, position: int, fields: Iterable[str]) -> dict[str, np.ndarray]:
        """Field to rows. Raises ``ShardError``."""
        with self._reading() as file:
            return {field: file[field][slice(*self._ends[field][position : position + 2])] for field in fields}

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        values = {member: self._values(position, fields_of([member])) for member in members}
        return {
            member: pack({split_worn(field)[1]: rows for field, rows in of.items()})
            if member in ARRAYS
            else next(iter(of.values())).tobytes()
            for member, of in values.items()
        }

    def _description(self) -> list[str]:
        return [f"{self.split} of {self.path}"]

    def _find_key(self, key: str) -> int | None:
        return next(iter(np.flatnonzero(self._numbers == index_from_key(key)).tolist()), None)

    def _key(self, position: int) -> str:
        return key_of(int(self._numbers[position]))

    def _checked(self, file: h5py.File) -> dict[str, np.ndarray]:
        """The fields of the file, and their pointers. Raises ``ShardError``."""
        form, schema, count = (file.attrs.get(name) for name in ("format", "schema", "count"))
        if not isinstance(form, bytes) or form != FORMAT.encode():
            raise ShardError(f"{self.path}: not written by gcd export --hdf5: give another file")
        if not np.array_equal(schema, SCHEMA):
            raise ShardError(f"{self.path}: of schema {schema!s:.40}, but this reader knows {SCHEMA}: export it again")
        if not isinstance(count, np.integer) or count < 0:
            raise self._broken(f"its count is {count!s:.40}")
        self._count, found = int(count), dict[str, np.ndarray]()
        self._column(file, "crc32", "<u4", (self._count,))
        for field in [field for field in MEMBER_OF if field in file]:
            found[field] = ends = self._column(file, f"{field}_ptr", "<i8", (self._count + 1,))[:]
            if ends[0] != 0 or (np.diff(ends) < 0).any():
                raise self._broken(f"{field}_ptr does not rise from 0")
            dtype, row = form_of(field)
            self._column(file, field, dtype, (int(ends[-1]), *row))
        return found

    def _column(self, file: h5py.File, name: str, dtype: str | np.dtype, shape: tuple[int, ...]) -> h5py.Dataset:
        """An array in this file. Raises ``ShardError`` for another type, shape or place."""
        column = file[name] if isinstance(file.get(name, getlink=True), h5py.HardLink) else None
        if not isinstance(column, h5py.Dataset) or column.external or column.is_virtual or column.chunks:
            raise self._broken(f"{name} is no contiguous array of this file")
        if column.shape != shape or column.dtype != dtype:
            raise self._broken(f"{name} is {column.dtype} of shape {column.shape}, expected {dtype} of shape {shape}")
        if column.size and (end := (column.id.get_offset() or self._size) + column.nbytes) > self._size:
            raise self._broken(f"{name} ends at byte {end} of {self._size}")
        return column

    @contextlib.contextmanager
    def _reading(self) -> Iterator[h5py.File]:
        """The file, opened by each process once."""
        try:
            if self._opened[0] != os.getpid():
                self._opened = os.getpid(), h5py.File(self.path, "r", locking=False)
            yield self._opened[1]
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            raise self._broken(" ".join(str(error).split())) from error

    def _broken(self, fault: str) -> ShardError:
        return ShardError(f"{self.path}: not HDF5, or damaged ({fault}): {REMEDY}")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": (0, None)}
