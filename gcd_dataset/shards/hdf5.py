"""A split in one HDF5 file, for programs that read nothing else, and to be carried about.

==========================  ==========================================================================================
``/verts``, ``/faces``, …   an array field of all samples, one below the other: numbers as in a shard, of one type for
                            the whole file; pictures as the bytes of their JPEG files
``/ptr/verts``, …           int64 [n+1]: sample i holds the rows from ``ptr[i]`` to ``ptr[i + 1]``
``/bytes/faces``, …         u1 [n]: bytes a number takes in the shard's file
``/spec``, ``/meta``, …     a JSON field: one text a sample
``/crc32``                  u4 [n]: CRC-32 of each ``meta``, which holds those of the sample's other files
attributes                  ``format``, ``schema``, ``split``, ``count``, ``recipe`` as JSON
==========================  ==========================================================================================

Arrays lie in one piece each, without compression: a sample is then one seek and one read a field. Measured beside this,
chunks read at two thirds of the speed, compressed ones at half of it or less, for files a third smaller.
"""

import contextlib
import json
import os
import threading
import zlib
from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Int, UInt8

from gcd_dataset.errors import ShardError
from gcd_dataset.files import drafted, user_path
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.codec import read_json
from gcd_dataset.shards.layout import FIELDS, MEMBERS, SCHEMA, Bytes
from gcd_dataset.shards.npy import read_npy, write_npy
from gcd_dataset.shards.reader import ShardReader

__all__ = ["Hdf5Reader", "write_hdf5"]

REMEDY = "copy it again, or make it again with gcd export"
FORMAT = "gcd_dataset garments"
META, META_CRC = MEMBERS[0], "crc32"
ARRAYS = tuple(field for field, member in FIELDS.items() if member.endswith(".npy"))
TEXTS = tuple(field for field, member in FIELDS.items() if member.endswith(".json"))
PICTURES = tuple(field for field, member in FIELDS.items() if member.endswith(".jpg"))
RAGGED = ARRAYS + PICTURES


def write_hdf5(reader: ShardReader, path: Path | str) -> Generator[int, None, None]:
    """All samples of a split into a file, yielding the number of each as it is stored.

    Once the iterator has ended the file has its name and is whole; before, there is nothing of it. Every sample is read
    twice: first for its size. Raises ``OutputError`` where the file cannot be written, ``ShardError`` for a damaged
    sample.
    """
    columns = _columns(reader)
    with drafted(user_path(path)) as draft, h5py.File(draft, "w") as file:
        _lay_out(file, reader, columns)
        for position in range(len(reader)):
            members = reader.read(position, MEMBERS)
            for field in TEXTS:
                file[field][position] = bytes(members[FIELDS[field]]).decode()
            file[META_CRC][position] = zlib.crc32(members[META])
            for field, column in columns.items():
                start, end = column.ptr[position : position + 2].tolist()
                if end > start:
                    file[field][start:end] = _array(field, members[FIELDS[field]])
            yield position


class Hdf5Reader:
    """The samples of an HDF5 file by number. May be pickled, forked, and read from several threads.

    Raises ``ShardError`` for a file that is not one of ours, or of another schema.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = user_path(path)
        self._file: _OpenFile | None = None
        self._process, self._lock = os.getpid(), threading.Lock()
        with self._opened() as file:
            attributes = dict(file.handle.attrs)
        if attributes.get("format") != FORMAT:
            raise ShardError(f"{self.path}: not a file that gcd export has made: choose another")
        if attributes["schema"] != SCHEMA:
            there = f"of schema {attributes['schema']}, and this reader knows {SCHEMA}"
            raise ShardError(f"{self.path}: {there}: install the version of gcd_dataset that wrote it")
        self._count, self.split = int(attributes["count"]), str(attributes["split"])
        self.close()  # so that a process forked from here opens the file for itself

    def __len__(self) -> int:
        return self._count

    def read(self, position: int, members: Iterable[str]) -> dict[str, Bytes]:
        """Members of a sample, byte for byte as in its shard. Raises ``ShardError`` for a damaged file."""
        with self._opened() as file:
            return {member: file.member(position, member.split(".")[0]) for member in members}

    def largest(self, field: str) -> int:
        """Rows of the sample that has most of an array field; bytes of its largest picture."""
        with self._opened() as file:
            return int(np.diff(file.handle["ptr"][field][:]).max(initial=0))

    def check(self, position: int) -> None:
        """Raise ``ShardError`` if any byte of a sample is not what was written."""
        members = self.read(position, MEMBERS)
        with self._opened() as file:
            self._require_same(position, META, members[META], file.meta_crc(position))
        for member, crc in read_json(members[META])["crc32"].items():
            self._require_same(position, member, members[member], crc)

    def _require_same(self, position: int, member: str, data: Bytes, crc: int) -> None:
        if zlib.crc32(data) != crc:
            raise ShardError(
                f"{self.path}: sample {position}, member {member}: bytes differ from those that were written: {REMEDY}"
            )

    def close(self) -> None:
        """Let go of the file; the next read opens it again."""
        with self._lock:
            if self._file is not None:
                self._file.handle.close()
            self._file = None

    @contextlib.contextmanager
    def _opened(self) -> Iterator["_OpenFile"]:
        """The file as this process has opened it. Raises ``ShardError`` for a damaged one."""
        if self._process != os.getpid():  # forked: neither file nor lock are ours
            self.__setstate__(self.__getstate__())
        with self._lock, reading(self.path):
            try:
                if self._file is None:
                    self.path.open("rb").close()  # for the system's own words where it may not be read
                    self._file = _OpenFile(self.path)
                yield self._file
            except (PermissionError, FileNotFoundError, NotADirectoryError, IsADirectoryError):
                raise
            except (OSError, KeyError, ValueError, RuntimeError) as error:
                raise ShardError(f"{self.path}: not HDF5, or damaged ({error}): {REMEDY}") from error

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_file": None, "_process": None, "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({**state, "_process": os.getpid(), "_lock": threading.Lock()})


class _OpenFile:
    """A file with what has been looked up in it: to find a name takes longer than to read a garment."""

    def __init__(self, path: Path) -> None:
        # Without locks: nobody writes it any more, and network file systems often have none.
        self.handle = h5py.File(path, "r", locking=False)
        self._data: dict[str, h5py.Dataset] = {}
        self._first: dict[str, np.ndarray] = {}
        self._size: dict[str, np.ndarray] = {}

    def member(self, position: int, field: str) -> Bytes:
        """A field of a sample as it stands in a shard."""
        if field not in self._data:
            self._look_up(field)
        if field in TEXTS:
            return bytes(self._data[field][position])
        start, end = self._first[field][position : position + 2].tolist()
        rows = self._data[field][start:end]
        if field in PICTURES:
            return rows.tobytes()
        return write_npy(rows.astype(f"<{rows.dtype.kind}{self._size[field][position]}", copy=False))

    def meta_crc(self, position: int) -> int:
        """CRC-32 of a sample's ``meta.json``. Raises ``KeyError`` for a file without it."""
        return int(self.handle[META_CRC][position])

    def _look_up(self, field: str) -> None:
        if field in RAGGED:
            self._first[field], self._size[field] = self.handle["ptr"][field][:], self.handle["bytes"][field][:]
        self._data[field] = self.handle[field]


# ------------------------------------------------------------------------------------------------------------- writing


@dataclass(frozen=True)
class _Column:
    """One ragged field of all samples."""

    ptr: Int[np.ndarray, " n+1"]
    """First row of each sample, and behind the last."""
    size: UInt8[np.ndarray, " n"]
    """Bytes of a number in each sample."""
    kind: str
    """NumPy's letter for the numbers."""
    width: tuple[int, ...]
    """Shape of a row."""


def _columns(reader: ShardReader) -> dict[str, _Column]:
    """How much room each field takes. Raises ``ShardError`` for fields of another shape than in other samples."""
    rows = {field: np.zeros(len(reader) + 1, np.int64) for field in RAGGED}
    size = {field: np.zeros(len(reader), np.uint8) for field in RAGGED}
    form: dict[str, tuple[str, tuple[int, ...]]] = {}
    for position in range(len(reader)):
        members = reader.read(position, [FIELDS[field] for field in RAGGED])
        for field in RAGGED:
            array = _array(field, members[FIELDS[field]])
            rows[field][position + 1], size[field][position] = len(array), array.dtype.itemsize
            found = (array.dtype.kind, array.shape[1:])
            if form.setdefault(field, found) != found:
                place = f"{reader.store.place()}: sample {position}, member {FIELDS[field]}"
                raise ShardError(f"{place}: rows of {found}, and of {form[field]} before it: {REMEDY}")
    return {field: _Column(np.cumsum(rows[field]), size[field], *form[field]) for field in RAGGED}


def _lay_out(file: h5py.File, reader: ShardReader, columns: Mapping[str, _Column]) -> None:
    """Room for everything, and what is known of it."""
    record = reader.manifest.splits.get(reader.split) if reader.manifest else None
    recipe = json.dumps(dict(record.recipe) if record else {}, sort_keys=True)
    given = {"format": FORMAT, "schema": SCHEMA, "split": reader.split, "count": len(reader), "recipe": recipe}
    file.attrs.update(given)
    for field in TEXTS:
        file.create_dataset(field, (len(reader),), h5py.string_dtype(), track_times=False)
    file.create_dataset(META_CRC, (len(reader),), np.dtype("<u4"), track_times=False)
    for field, column in columns.items():
        dtype = np.dtype(f"<{column.kind}{column.size.max(initial=1)}")
        file.create_dataset(field, (int(column.ptr[-1]), *column.width), dtype, track_times=False)
        file.create_dataset(f"ptr/{field}", data=column.ptr, track_times=False)
        file.create_dataset(f"bytes/{field}", data=column.size, track_times=False)


def _array(field: str, data: Bytes) -> np.ndarray:
    return np.frombuffer(data, np.uint8) if field in PICTURES else read_npy(data)
