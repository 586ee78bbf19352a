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

Files are not trusted. libhdf5 loops for ever in some damaged ones, so it never runs in the process that reads: see
``gcd_dataset.shards.hdf5_layout``. Where it loops is the global heap, which holds the texts; that is read here, as the
HDF5 File Format Specification lays it down (section III.E of version 3.0).
"""

import functools
import json
import logging
import math
import os
import re
import stat
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Generator, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Bool, Int, UInt8

from gcd_dataset.errors import ShardError
from gcd_dataset.files import drafted, user_path
from gcd_dataset.jsonfile import found
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.layout import FIELDS, MEMBERS, SCHEMAS, Bytes, content_of
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.npy import npy_header, read_npy, write_npy
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.room import room_for
from gcd_dataset.shards.sink import Sink

__all__ = ["Hdf5Reader", "write_hdf5"]

logger = logging.getLogger("gcd_dataset")

REMEDY = "copy it again, or make it again with gcd export"
FORMAT = "gcd_dataset garments"
META, META_CRC = MEMBERS[0], "crc32"
ARRAYS = tuple(field for field, member in FIELDS.items() if member.endswith(".npy"))
PICTURES = tuple(field for field, member in FIELDS.items() if member.endswith(".jpg"))
RAGGED = ARRAYS + PICTURES
TEXTS = tuple(field for field in FIELDS if field not in RAGGED)

ATTRIBUTES = ("format", "schema", "split", "count")
NAMES = (*FIELDS, META_CRC, *(f"{kind}/{field}" for kind in ("ptr", "bytes") for field in RAGGED))
"""Columns that a file may have."""
NUMBER = {member: number for number, member in enumerate(MEMBERS)}

PAIR = struct.Struct("<qq")
PTR, SIZE, CRC = np.dtype("<i8"), np.dtype("u1"), np.dtype("<u4")
NUMBER_TYPE = re.compile(r"[<|][biuf][1248]")
TEXT_TYPE = "text"
TEXT = struct.Struct("<IQI")
"""Of a text in its column: length, place of a collection, number in it."""
COLLECTION = struct.Struct("<5s3xQ")
"""How a collection begins: ``COLLECTION_MAGIC`` and its size; then come its entries."""
COLLECTION_MAGIC = b"GCOL\x01"
ENTRY = struct.Struct("<H6xQ")
"""How an entry begins: its number, 0 for the free rest, and its size; then comes the text."""
ALIGNMENT = 8
MOST_ENTRIES = 1 << 16  # as many as have different numbers
SIGNATURE = b"\x89HDF\r\n\x1a\n"

LAYOUT_PROGRAM = Path(__file__).with_name("hdf5_layout.py")
CPU_SECONDS, WALL_SECONDS = 1, 60
"""For the headers, which take milliseconds; a network drive may be slow."""
MOST = 1 << 28
"""Samples of a file."""
LARGEST = 1 << 29
"""Bytes of a member."""
LAST_PLACE = 1 << 62
"""Bytes of a file, that the system can address."""


def write_hdf5(reader: ShardReader, path: Path | str) -> Generator[int, None, None]:
    """All samples of a split into a file, yielding the number of each as it is stored.

    Once the iterator has ended the file has its name and is whole; before, there is nothing of it. Every sample is read
    twice: first for its size. Raises ``OutputError`` where the file cannot be written, ``ShardError`` for a damaged
    sample.
    """
    columns = _columns(reader)
    with drafted(user_path(path)) as draft, Sink(draft) as sink, ThreadPoolExecutor(1) as thread:
        # In a thread, since there no interrupt comes between: to libhdf5 that is a write that fails.
        file = thread.submit(h5py.File, sink, "w").result()
        try:
            thread.submit(_lay_out, file, reader, columns).result()
            for position in range(len(reader)):
                members = reader.read(position, reader.layout.members)
                with reader.naming(position):
                    thread.submit(_store, file, position, members, columns).result()
                sink.check()
                yield position
        except (OSError, RuntimeError):
            sink.check()  # the cause of what libhdf5 has met
            raise
        finally:
            thread.submit(file.close).result()
        sink.check()


class Hdf5Reader:
    """The samples of an HDF5 file by number. May be pickled, forked, and read from several threads.

    A member's CRC-32 is checked the first time that this process reads it, and so is where the file says that the
    member lies. libhdf5 reads nothing in this process: a child process with limits on time and memory finds where the
    columns lie, when the file is opened, and the bytes are read from there.

    Raises ``ShardError`` for a file that is damaged, not one of ours, or of another schema.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = user_path(path)
        self._file: _Descriptor | None = None
        self._stamp: tuple[int, int] | None = None  # size and time of change: another file has others
        if self._bytes(self._opened(), 0, len(SIGNATURE)) != SIGNATURE:
            raise self._broken("it does not begin as HDF5 does")
        attributes, self._columns = self._layout()
        if attributes.get("format") != FORMAT:
            raise ShardError(f"{self.path}: not a file that gcd export has made: choose another")
        if attributes.get("schema") not in SCHEMAS:
            known = " and ".join(map(str, SCHEMAS))
            there = f"of schema {found(attributes.get('schema'))}, and this reader knows {known}"
            raise ShardError(f"{self.path}: {there}: install the version of gcd_dataset that wrote it")
        self._count, self.split = self._counted(attributes.get("count")), str(attributes.get("split"))
        self._has_meta_crc = META_CRC in self._columns
        if not self._has_meta_crc:
            logger.warning(
                "%s: from an early version: changed bytes of %s are not found: make it again with gcd export",
                path,
                META,
            )
        self._checked = self._none_checked()

    def __len__(self) -> int:
        return self._count

    def read(self, position: int, members: Iterable[str]) -> dict[str, Bytes]:
        """Members of a sample, byte for byte as in its shard.

        Raises ``ShardError`` with sample and member for a byte that is not what was written.
        """
        file = self._opened()
        content = {member: self._member(file, position, member) for member in members}
        checked = self._checked[position]
        unchecked = {member: data for member, data in content.items() if not checked[NUMBER[member]]}
        if unchecked:
            self._check(file, position, unchecked)
        return content

    def largest(self, field: str) -> int:
        """Rows of the sample that has most of an array field; bytes of its largest picture."""
        ptr = np.frombuffer(self._rows(self._opened(), f"ptr/{field}", 0, self._count + 1), PTR)
        return int(np.diff(ptr).max(initial=0))

    def check(self, position: int) -> None:
        """Raise ``ShardError`` if any byte of a sample is not what was written."""
        self._checked[position] = False
        self.read(position, MEMBERS)

    def close(self) -> None:
        """Let go of the file; the next read opens it again."""
        self._file = None

    # ------------------------------------------------------------------------------------------------------- columns

    def _layout(self) -> tuple[Mapping[str, Any], Mapping[str, "_Stored"]]:
        """Attributes and columns of the file."""
        program = [sys.executable, "-P", str(LAYOUT_PROGRAM), str(self.path.absolute())]
        names = json.dumps({"attributes": ATTRIBUTES, "columns": NAMES})
        try:
            child = subprocess.run(
                [*program, str(CPU_SECONDS)], input=names, capture_output=True, text=True, timeout=WALL_SECONDS
            )
        except subprocess.TimeoutExpired as error:
            raise self._broken(f"its headers are not read in {WALL_SECONDS} s") from error
        if child.returncode < 0:
            raise self._broken(f"its headers end libhdf5 with signal {-child.returncode}, or take more than its limits")
        if child.returncode:
            raise ShardError(f"{self.path}: h5py does not start ({child.stderr.strip()[-200:]}): install it again")
        layout = json.loads(child.stdout)
        if "problem" in layout:
            raise self._broken(layout["problem"])
        length = os.fstat(self._opened().fd).st_size
        columns = {name: _Stored(c["type"], tuple(c["shape"]), c["place"]) for name, c in layout["columns"].items()}
        for name, column in columns.items():
            if not column.is_ours() or column.end > length:
                raise self._broken(f"{name} is {column.type} of shape {column.shape} at byte {column.place}")
        return layout["attributes"], columns

    def _counted(self, count: object) -> int:
        """How many samples there are, if all columns say so."""
        if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count <= MOST:
            raise self._broken(f"its count is {found(count)}")
        fitting = {
            **dict.fromkeys(TEXTS, (TEXT_TYPE, (count,))),
            **{f"ptr/{field}": (PTR.str, (count + 1,)) for field in RAGGED},
            **{f"bytes/{field}": (SIZE.str, (count,)) for field in RAGGED},
            **({META_CRC: (CRC.str, (count,))} if META_CRC in self._columns else {}),
        }
        for name in (*fitting, *RAGGED):
            if name not in self._columns:
                raise self._broken(f"no {name}")
            column = self._columns[name]
            told = (column.type, column.shape)
            if fitting.get(name, told) != told or (name in RAGGED and column.type == TEXT_TYPE):
                raise self._broken(f"{name} is {column.type} of shape {column.shape} for {count} samples")
        return count

    def _member(self, file: "_Descriptor", position: int, member: str) -> Bytes:
        """A member of a sample as it stands in a shard."""
        field = member.split(".")[0]
        if field in TEXTS:
            return self._text(file, field, position)
        first, end = PAIR.unpack(self._rows(file, f"ptr/{field}", position, position + 2))
        if field in PICTURES:
            return self._rows(file, field, first, end)
        column = self._columns[field]
        (size,) = self._rows(file, f"bytes/{field}", position, position + 1)
        if size not in (1, 2, 4, 8):
            raise self._broken(f"numbers of {size} bytes in {field} of sample {position}")
        shape = (end - first, *column.shape[1:])
        if size == column.dtype.itemsize:
            return self._rows(file, field, first, end, npy_header(column.dtype, shape))
        rows = np.frombuffer(self._rows(file, field, first, end), column.dtype).reshape(shape)
        return write_npy(rows.astype(f"<{column.dtype.kind}{size}"))

    def _text(self, file: "_Descriptor", field: str, position: int) -> Bytes:
        """A text: the column holds its length, and its place in one of the collections of texts."""
        length, place, number = TEXT.unpack(self._rows(file, field, position, position + 1))
        if not length:
            return b""
        magic, size = COLLECTION.unpack(self._bytes(file, place, COLLECTION.size))
        end, place = place + size, place + COLLECTION.size
        for _ in range(MOST_ENTRIES if magic == COLLECTION_MAGIC else 0):
            there, size = ENTRY.unpack(self._bytes(file, place, ENTRY.size))
            place += ENTRY.size
            if there == number and length <= size <= end - place:
                return self._bytes(file, place, length)
            place += -(-size // ALIGNMENT) * ALIGNMENT
            if there in (0, number) or place >= end:
                break
        raise self._broken(f"{field} of sample {position} is not where the file says")

    def _rows(self, file: "_Descriptor", name: str, first: int, end: int, header: bytes = b"") -> memoryview:
        """Rows of a column behind a header."""
        column = self._columns[name]
        if not 0 <= first <= end <= column.shape[0]:
            raise self._broken(f"rows {first} to {end} of {name}, which has {column.shape[0]}")
        return self._bytes(file, column.place + first * column.row_size, (end - first) * column.row_size, header)

    def _bytes(self, file: "_Descriptor", place: int, size: int, header: bytes = b"") -> memoryview:
        """Bytes of the file behind a header."""
        if size > LARGEST:
            raise self._broken(f"{size} bytes of one sample, where {LARGEST} are read")
        buffer = room_for(len(header) + size).data
        buffer[: len(header)] = header
        self._fill(file, place, buffer[len(header) :])
        return buffer

    def _fill(self, file: "_Descriptor", place: int, buffer: memoryview) -> None:
        """Read the file from ``place`` on."""
        # Not the file's own place: several threads read it, and forked processes share that.
        with reading(self.path):
            while len(buffer):  # network file systems give less than all at times
                read = os.preadv(file.fd, [buffer], place) if place < LAST_PLACE else 0
                if not read:
                    raise self._broken(f"it ends before byte {place + len(buffer)}")
                buffer, place = buffer[read:], place + read

    # -------------------------------------------------------------------------------------------------------- checks

    def _check(self, file: "_Descriptor", position: int, content: Mapping[str, Bytes]) -> None:
        """Raise ``ShardError`` unless these members are as they were written."""
        meta = content.get(META) or self._member(file, position, META)
        if self._has_meta_crc:
            stored = self._rows(file, META_CRC, position, position + 1)
            self._require_same(position, META, meta, int.from_bytes(stored, "little"))
        crc = self._crc_of_members(position, meta)
        for member, data in content.items():
            if member != META:
                self._require_same(position, member, data, crc.get(member.split(".")[0]))
            self._checked[position, NUMBER[member]] = True

    def _crc_of_members(self, position: int, meta: Bytes) -> Mapping[str, object]:
        """Field to the CRC-32 of its member."""
        try:
            return {member.split(".")[0]: crc for member, crc in read_meta(meta)["crc32"].items()}
        except (ShardError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise self._broken(f"{META} of sample {position} holds no CRC-32 of its other members") from error

    def _require_same(self, position: int, member: str, data: Bytes, crc: object) -> None:
        if zlib.crc32(data) != crc:
            raise ShardError(
                f"{self.path}: sample {position}, member {member}: bytes differ from those that were written: {REMEDY}"
            )

    def _none_checked(self) -> Bool[np.ndarray, "n m"]:
        return np.zeros((self._count, len(MEMBERS)), bool)

    # ---------------------------------------------------------------------------------------------------------- file

    def _opened(self) -> "_Descriptor":
        """The file, as opened by this process or the one that it was forked from."""
        file = self._file
        if file is None:
            with reading(self.path):
                file = self._file = self._open()
        return file

    def _open(self) -> "_Descriptor":
        # Not to wait for a writer, where the path is that of a pipe.
        file = _Descriptor(os.open(self.path, os.O_RDONLY | os.O_NONBLOCK))
        status = os.fstat(file.fd)
        stamp = status.st_size, status.st_mtime_ns
        if not stat.S_ISREG(status.st_mode):
            raise ShardError(f"{self.path}: not a file: give one that gcd export --hdf5 has made")
        if self._stamp not in (None, stamp):
            raise ShardError(f"{self.path}: changed since it was opened: open it anew")
        self._stamp = stamp
        return file

    def _broken(self, what: str) -> ShardError:
        return ShardError(f"{self.path}: not HDF5, or damaged ({what}): {REMEDY}")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_file": None, "_checked": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._checked = self._none_checked()


@dataclass(frozen=True)
class _Stored:
    """A column of a file."""

    type: str
    """NumPy's name of it, or ``TEXT_TYPE``."""
    shape: tuple[int, ...]
    place: int
    """Its first byte in the file."""

    def is_ours(self) -> bool:
        """Whether ``gcd export`` writes such columns."""
        return bool(self.shape) and (self.type == TEXT_TYPE or NUMBER_TYPE.fullmatch(self.type) is not None)

    @functools.cached_property
    def dtype(self) -> np.dtype:
        """Of its numbers; what stands for a text takes as many bytes as ``TEXT``."""
        return np.dtype(f"V{TEXT.size}" if self.type == TEXT_TYPE else self.type)

    @functools.cached_property
    def row_size(self) -> int:
        """Bytes of a row."""
        return self.dtype.itemsize * math.prod(self.shape[1:])

    @property
    def end(self) -> int:
        """Behind its last byte in the file."""
        return self.place + self.shape[0] * self.row_size


class _Descriptor:
    """An open file, closed when nobody holds it any more: a thread may be reading it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    def __del__(self, close: Callable[[int], None] = os.close) -> None:  # a name of the module is gone at its end
        close(self.fd)


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
            with reader.naming(position):
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
    given = {
        "format": FORMAT,
        "schema": reader.layout.schema,
        "split": reader.split,
        "count": len(reader),
        "recipe": recipe,
    }
    file.attrs.update(given)
    for field in TEXTS:
        file.create_dataset(field, (len(reader),), h5py.string_dtype(), track_times=False)
    file.create_dataset(META_CRC, (len(reader),), CRC, track_times=False)
    for field, column in columns.items():
        dtype = np.dtype(f"<{column.kind}{column.size.max(initial=1)}")
        file.create_dataset(field, (int(column.ptr[-1]), *column.width), dtype, track_times=False)
        file.create_dataset(f"ptr/{field}", data=column.ptr, track_times=False)
        file.create_dataset(f"bytes/{field}", data=column.size, track_times=False)


def _store(file: "h5py.File", position: int, members: Mapping[str, Bytes], columns: Mapping[str, _Column]) -> None:
    """Put a sample in its place."""
    for field in TEXTS:
        try:
            file[field][position] = bytes(content_of(field, members)).decode()
        except ValueError as error:  # not UTF-8, or a NUL, which texts of HDF5 cannot hold
            raise ShardError(f"member {FIELDS[field]}: no text that HDF5 holds ({error}): {REMEDY}") from error
    file[META_CRC][position] = zlib.crc32(members[META])
    for field, column in columns.items():
        start, end = column.ptr[position : position + 2].tolist()
        if end > start:
            file[field][start:end] = _array(field, members[FIELDS[field]])


def _array(field: str, data: Bytes) -> np.ndarray:
    try:
        return np.frombuffer(data, np.uint8) if field in PICTURES else read_npy(data)
    except ShardError as error:
        raise ShardError(f"member {FIELDS[field]}: {error}: {REMEDY}") from error
