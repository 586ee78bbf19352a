"""A split as one HDF5 file, for programs that read no tars.

==========================  ==========================================================================================
``/verts``, ``/faces``, …   an array field of all samples, concatenated along the rows, in one type for the whole file;
                            pictures as the bytes of their JPEG files
``/ptr/verts``, …           int64 [n+1]: sample i holds the rows from ``ptr[i]`` to ``ptr[i + 1]``
``/bytes/faces``, …         u1 [n]: size of a number in the shard's member [bytes]; the HDF5 type may be wider
``/spec``, ``/meta``, …     a JSON field: one text per sample
``/caption``                the captions, if the samples have them: one text per sample
``/view_0``, …              stored views, if the samples have them: pictures as above, and ``/view_0_json``, …, their
                            facts as JSON texts
``/crc32``                  u4 [n]: CRC-32 of each ``meta``, which holds the CRC-32 of the sample's other members
attributes                  ``format``, ``schema``, ``split``, ``count``, ``recipe`` as JSON
==========================  ==========================================================================================

Arrays are contiguous and uncompressed: a sample takes one seek and one read per field. Measured: chunked files are read
at two thirds of this speed; compressed files at half of it or less, for a third less disk space.

Files are not trusted. libhdf5 loops forever on some damaged files, so it runs in a child process, which returns the
offsets of the columns: see ``gcd_dataset.shards.hdf5_layout``. The texts lie in the global heap, where the loops occur;
this module reads the heap itself (HDF5 File Format Specification 3.0, section III.E).
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
from gcd_dataset.shards.buffers import read_buffer
from gcd_dataset.shards.layout import (
    FIELDS,
    MEMBERS,
    MOST_VIEWS,
    SCHEMAS,
    Bytes,
    fields_of,
    garments_layout,
    is_extra,
    member_content,
)
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.npy import npy_header, read_npy, write_npy
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.sink import Sink

__all__ = ["Hdf5Reader", "write_hdf5"]

logger = logging.getLogger("gcd_dataset")

REMEDY = "copy it again, or make it again with gcd export"
SHARD_REMEDY = "copy the shard again, or delete it and run gcd generate again"
FORMAT = "gcd_dataset garments"
META, META_CRC = MEMBERS[0], "crc32"
ARRAYS = tuple(field for field, member in FIELDS.items() if member.endswith(".npy"))
MEMBER_OF = fields_of(garments_layout(caption=True, views=MOST_VIEWS).members)
"""Field to its member, those of captions and views included, in the order of a shard."""
PICTURES = tuple(field for field, member in MEMBER_OF.items() if member.endswith(".jpg"))
RAGGED = ARRAYS + PICTURES
TEXTS = tuple(field for field in MEMBER_OF if field not in RAGGED)
OPTIONAL = tuple(field for field, member in MEMBER_OF.items() if is_extra(member))
"""The fields of captions and views."""

ATTRIBUTES = ("format", "schema", "split", "count")
NAMES = (*MEMBER_OF, META_CRC, *(f"{kind}/{field}" for kind in ("ptr", "bytes") for field in RAGGED))
"""The HDF5 data sets of a file; files of early versions lack ``crc32``, files without captions and views their own."""

PAIR = struct.Struct("<qq")
PTR, SIZE, CRC = np.dtype("<i8"), np.dtype("u1"), np.dtype("<u4")
NUMBER_TYPE = re.compile(r"[<|][biuf][1248]")
TEXT_TYPE = "text"
TEXT = struct.Struct("<IQI")
"""A text in its column: length, offset of its heap collection, number in the collection."""
COLLECTION = struct.Struct("<5s3xQ")
"""Header of a heap collection: ``COLLECTION_MAGIC`` and its size; the entries follow."""
COLLECTION_MAGIC = b"GCOL\x01"
ENTRY = struct.Struct("<H6xQ")
"""Header of an entry: its number, 0 for free space, and its size; the text follows."""
ALIGNMENT = 8
MOST_ENTRIES = 1 << 16  # per collection: entry numbers are 16-bit
SIGNATURE = b"\x89HDF\r\n\x1a\n"

LAYOUT_PROGRAM = Path(__file__).with_name("hdf5_layout.py")
CPU_SECONDS, WALL_SECONDS = 1, 60
"""Limits of the child process; reading headers takes milliseconds, on a slow network drive longer."""
MOST_SAMPLES = 1 << 28
"""Largest accepted number of samples of a file."""
LARGEST = 1 << 29
"""Largest accepted size of a member [bytes]."""
LARGEST_OFFSET = 1 << 62
"""Limit of the file offsets that are read: the system cannot address larger ones."""


def write_hdf5(reader: ShardReader, path: Path | str) -> Generator[int, None, None]:
    """Write all samples of a split to an HDF5 file, yielding the position of each once it is stored.

    The file appears under its name when the iterator ends. Every sample is read twice, first for its size. Raises
    ``OutputError`` where the file cannot be written, ``ShardError`` for a damaged sample.
    """
    columns = _columns(reader)
    with drafted(user_path(path)) as draft, Sink(draft) as sink, ThreadPoolExecutor(1) as thread:
        # In a thread, where no KeyboardInterrupt is raised: libhdf5 would take it for a failed write.
        file = thread.submit(h5py.File, sink, "w").result()
        try:
            thread.submit(_allocate, file, reader, columns).result()
            for position in range(len(reader)):
                members = reader.read(position, reader.layout.members)
                with reader.naming(position):
                    thread.submit(_store, file, position, members, columns).result()
                sink.check()
                yield position
        except (OSError, RuntimeError):
            sink.check()  # raises the OSError behind libhdf5's own error
            raise
        finally:
            thread.submit(file.close).result()
        sink.check()


class Hdf5Reader:
    """The samples of an HDF5 file by position. May be pickled, forked, and read from several threads.

    The CRC-32 of a member is checked the first time that this process reads it. libhdf5 does not run in this process:
    on opening, a child process with limits on time and memory finds the offsets of the columns; bytes are read from
    there.

    Raises ``ShardError`` for a file that is damaged, not one of ours, or of another schema.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = user_path(path)
        self._file: _Descriptor | None = None
        self._stamp: tuple[int, int] | None = None  # size and mtime, to detect a replaced file
        if self._bytes(self._opened(), 0, len(SIGNATURE)) != SIGNATURE:
            raise self._broken("no HDF5 signature")
        attributes, self._columns = self._layout()
        if attributes.get("format") != FORMAT:
            raise ShardError(f"{self.path}: not written by gcd export: give another file")
        if attributes.get("schema") not in SCHEMAS:
            known = " and ".join(map(str, SCHEMAS))
            schema = f"of schema {found(attributes.get('schema'))}, but this reader knows {known}"
            raise ShardError(f"{self.path}: {schema}: install the version of gcd_dataset that wrote it")
        self._fields = tuple(field for field in MEMBER_OF if field not in OPTIONAL or field in self._columns)
        self._number = {MEMBER_OF[field]: number for number, field in enumerate(self._fields)}
        self._count, self.split = self._counted(attributes.get("count")), str(attributes.get("split"))
        self._has_meta_crc = META_CRC in self._columns
        if not self._has_meta_crc:
            logger.warning(
                "%s: written by an early version, without checksums of %s: make it again with gcd export",
                path,
                META,
            )
        self._checked = self._none_checked()

    def __len__(self) -> int:
        return self._count

    @property
    def members(self) -> tuple[str, ...]:
        """The members of each sample, in the order of a shard."""
        return tuple(self._number)

    def read(self, position: int, members: Iterable[str]) -> dict[str, Bytes]:
        """Members of a sample, byte for byte as in its shard.

        Raises ``ShardError`` with sample and member for a CRC-32 mismatch.
        """
        file = self._opened()
        content = {member: self._member(file, position, member) for member in members}
        checked = self._checked[position]
        unchecked = {member: data for member, data in content.items() if not checked[self._number[member]]}
        if unchecked:
            self._check(file, position, unchecked)
        return content

    def largest(self, field: str) -> int:
        """The largest number of rows of an array field in one sample; of a picture field, bytes."""
        ptr = np.frombuffer(self._rows(self._opened(), f"ptr/{field}", 0, self._count + 1), PTR)
        return int(np.diff(ptr).max(initial=0))

    def check(self, position: int) -> None:
        """Check the CRC-32 of all members of a sample. Raises ``ShardError``."""
        self._checked[position] = False
        self.read(position, self.members)

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        self._file = None

    # ------------------------------------------------------------------------------------------------------- columns

    def _layout(self) -> tuple[Mapping[str, Any], Mapping[str, "_StoredColumn"]]:
        """Attributes and columns of the file, found by the child process."""
        program = [sys.executable, "-P", str(LAYOUT_PROGRAM), str(self.path.absolute())]
        names = json.dumps({"attributes": ATTRIBUTES, "columns": NAMES})
        try:
            child = subprocess.run(
                [*program, str(CPU_SECONDS)], input=names, capture_output=True, text=True, timeout=WALL_SECONDS
            )
        except subprocess.TimeoutExpired as error:
            raise self._broken(f"reading its headers takes over {WALL_SECONDS} s") from error
        if child.returncode < 0:
            raise self._broken(
                f"its headers crash libhdf5 (signal {-child.returncode}), or exceed the limits on time and memory"
            )
        if child.returncode:
            raise ShardError(f"{self.path}: h5py does not start ({child.stderr.strip()[-200:]}): install it again")
        layout = json.loads(child.stdout)
        if "problem" in layout:
            raise self._broken(layout["problem"])
        length = os.fstat(self._opened().fd).st_size
        columns = {
            name: _StoredColumn(c["type"], tuple(c["shape"]), c["offset"]) for name, c in layout["columns"].items()
        }
        for name, column in columns.items():
            if not column.has_known_type() or column.end > length:
                raise self._broken(f"{name} is {column.type} of shape {column.shape} at byte {column.offset}")
        return layout["attributes"], columns

    def _counted(self, count: object) -> int:
        """The number of samples. Raises ``ShardError`` unless all columns agree with it."""
        if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count <= MOST_SAMPLES:
            raise self._broken(f"its count is {found(count)}")
        ragged = [field for field in self._fields if field in RAGGED]
        expected = {
            **{field: (TEXT_TYPE, (count,)) for field in self._fields if field in TEXTS},
            **{f"ptr/{field}": (PTR.str, (count + 1,)) for field in ragged},
            **{f"bytes/{field}": (SIZE.str, (count,)) for field in ragged},
            **({META_CRC: (CRC.str, (count,))} if META_CRC in self._columns else {}),
        }
        for name in (*expected, *ragged):
            if name not in self._columns:
                raise self._broken(f"{name} is missing")
            column = self._columns[name]
            actual = (column.type, column.shape)
            if expected.get(name, actual) != actual or (name in RAGGED and column.type == TEXT_TYPE):
                raise self._broken(f"{name} is {column.type} of shape {column.shape} for {count} samples")
        return count

    def _member(self, file: "_Descriptor", position: int, member: str) -> Bytes:
        """A member of a sample, byte for byte as in its shard."""
        field = _field_of(member)
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
        """A text from the global heap; its column holds length, collection and number."""
        length, offset, number = TEXT.unpack(self._rows(file, field, position, position + 1))
        if not length:
            return b""
        magic, size = COLLECTION.unpack(self._bytes(file, offset, COLLECTION.size))
        end, offset = offset + size, offset + COLLECTION.size
        for _ in range(MOST_ENTRIES if magic == COLLECTION_MAGIC else 0):
            entry, size = ENTRY.unpack(self._bytes(file, offset, ENTRY.size))
            offset += ENTRY.size
            if entry == number and length <= size <= end - offset:
                return self._bytes(file, offset, length)
            offset += -(-size // ALIGNMENT) * ALIGNMENT
            if entry in (0, number) or offset >= end:
                break
        raise self._broken(f"{field} of sample {position} is not in the heap")

    def _rows(self, file: "_Descriptor", name: str, first: int, end: int, header: bytes = b"") -> memoryview:
        """``header``, followed by rows of a column."""
        column = self._columns[name]
        if not 0 <= first <= end <= column.shape[0]:
            raise self._broken(f"rows {first} to {end} of {name}, which has {column.shape[0]}")
        return self._bytes(file, column.offset + first * column.row_size, (end - first) * column.row_size, header)

    def _bytes(self, file: "_Descriptor", offset: int, size: int, header: bytes = b"") -> memoryview:
        """``header``, followed by bytes of the file."""
        if size > LARGEST:
            raise self._broken(f"{size} bytes of one sample, over the limit of {LARGEST}")
        buffer = read_buffer(len(header) + size).data
        buffer[: len(header)] = header
        self._fill(file, offset, buffer[len(header) :])
        return buffer

    def _fill(self, file: "_Descriptor", offset: int, buffer: memoryview) -> None:
        """Fill ``buffer`` from the file, from ``offset`` on."""
        # preadv: threads and forked processes share the file's position.
        with reading(self.path):
            while len(buffer):  # network file systems may return fewer bytes
                read = os.preadv(file.fd, [buffer], offset) if offset < LARGEST_OFFSET else 0
                if not read:
                    raise self._broken(f"it ends before byte {offset + len(buffer)}")
                buffer, offset = buffer[read:], offset + read

    # -------------------------------------------------------------------------------------------------------- checks

    def _check(self, file: "_Descriptor", position: int, content: Mapping[str, Bytes]) -> None:
        """Raise ``ShardError`` unless these members match their CRC-32."""
        meta = content.get(META) or self._member(file, position, META)
        if self._has_meta_crc:
            stored = self._rows(file, META_CRC, position, position + 1)
            self._require_same(position, META, meta, int.from_bytes(stored, "little"))
        crc = self._crc_of_members(position, meta)
        for member, data in content.items():
            if member != META:
                self._require_same(position, member, data, crc.get(_field_of(member)))
            self._checked[position, self._number[member]] = True

    def _crc_of_members(self, position: int, meta: Bytes) -> Mapping[str, object]:
        """Field to the CRC-32 of its member."""
        try:
            return {_field_of(member): crc for member, crc in read_meta(meta)["crc32"].items()}
        except (ShardError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise self._broken(f"{META} of sample {position} holds no CRC-32 of its other members") from error

    def _require_same(self, position: int, member: str, data: Bytes, crc: object) -> None:
        if zlib.crc32(data) != crc:
            raise ShardError(
                f"{self.path}: sample {position}, member {member}: bytes differ from the written ones: {REMEDY}"
            )

    def _none_checked(self) -> Bool[np.ndarray, "n m"]:
        return np.zeros((self._count, len(self._number)), bool)

    # ---------------------------------------------------------------------------------------------------------- file

    def _opened(self) -> "_Descriptor":
        """The open file; a forked process keeps its parent's descriptor."""
        file = self._file
        if file is None:
            with reading(self.path):
                file = self._file = self._open()
        return file

    def _open(self) -> "_Descriptor":
        # Non-blocking: opening a named pipe would wait for its writer.
        file = _Descriptor(os.open(self.path, os.O_RDONLY | os.O_NONBLOCK))
        status = os.fstat(file.fd)
        stamp = status.st_size, status.st_mtime_ns
        if not stat.S_ISREG(status.st_mode):
            raise ShardError(f"{self.path}: not a file: give one written by gcd export --hdf5")
        if self._stamp not in (None, stamp):
            raise ShardError(f"{self.path}: changed since it was opened: open it again")
        self._stamp = stamp
        return file

    def _broken(self, problem: str) -> ShardError:
        return ShardError(f"{self.path}: not HDF5, or damaged ({problem}): {REMEDY}")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_file": None, "_checked": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._checked = self._none_checked()


@dataclass(frozen=True)
class _StoredColumn:
    """A column of a file."""

    type: str
    """NumPy's type string, or ``TEXT_TYPE``."""
    shape: tuple[int, ...]
    offset: int
    """First byte in the file."""

    def has_known_type(self) -> bool:
        """Whether ``gcd export`` writes columns of this type."""
        return bool(self.shape) and (self.type == TEXT_TYPE or NUMBER_TYPE.fullmatch(self.type) is not None)

    @functools.cached_property
    def dtype(self) -> np.dtype:
        """Type of an element; a text is a heap reference, as in ``TEXT``."""
        return np.dtype(f"V{TEXT.size}" if self.type == TEXT_TYPE else self.type)

    @functools.cached_property
    def row_size(self) -> int:
        """Bytes of a row."""
        return self.dtype.itemsize * math.prod(self.shape[1:])

    @property
    def end(self) -> int:
        """End of the column in the file [bytes]."""
        return self.offset + self.shape[0] * self.row_size


class _Descriptor:
    """An open file, closed with the last reference: another thread may be reading it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    # ``close`` is bound here: the os module may be gone at interpreter exit.
    def __del__(self, close: Callable[[int], None] = os.close) -> None:
        close(self.fd)


# ------------------------------------------------------------------------------------------------------------- writing


@dataclass(frozen=True)
class _Column:
    """One ragged field of all samples, to be written."""

    ptr: Int[np.ndarray, " n+1"]
    """First row of each sample, and the number of rows."""
    size: UInt8[np.ndarray, " n"]
    """Size of a number in each sample [bytes]."""
    kind: str
    """``dtype.kind`` of the numbers."""
    width: tuple[int, ...]
    """Shape of a row."""


def _columns(reader: ShardReader) -> dict[str, _Column]:
    """Row counts and types of each field. Raises ``ShardError`` for samples of different kinds or row shapes."""
    optional = {_field_of(member) for member in reader.layout.members} & {*OPTIONAL}
    ragged = [field for field in RAGGED if field not in OPTIONAL or field in optional]
    rows = {field: np.zeros(len(reader) + 1, np.int64) for field in ragged}
    size = {field: np.zeros(len(reader), np.uint8) for field in ragged}
    form: dict[str, tuple[str, tuple[int, ...]]] = {}
    for position in range(len(reader)):
        members = reader.read(position, [MEMBER_OF[field] for field in ragged])
        for field in ragged:
            with reader.naming(position):
                array = _array(field, members[MEMBER_OF[field]])
            rows[field][position + 1], size[field][position] = len(array), array.dtype.itemsize
            found = (array.dtype.kind, array.shape[1:])
            if form.setdefault(field, found) != found:
                member = f"{reader.store.location()}: sample {position}, member {MEMBER_OF[field]}"
                raise ShardError(
                    f"{member}: rows of type and shape {found}, but {form[field]} in earlier samples: {SHARD_REMEDY}"
                )
    return {field: _Column(np.cumsum(rows[field]), size[field], *form[field]) for field in ragged}


def _allocate(file: h5py.File, reader: ShardReader, columns: Mapping[str, _Column]) -> None:
    """Create attributes and data sets; write ``ptr`` and ``bytes``."""
    recipe = json.dumps(dict(reader.record.plan.recipe), sort_keys=True)
    attributes = {
        "format": FORMAT,
        "schema": reader.layout.schema,
        "split": reader.split,
        "count": len(reader),
        "recipe": recipe,
    }
    file.attrs.update(attributes)
    for field in _texts(reader.layout.members):
        file.create_dataset(field, (len(reader),), h5py.string_dtype(), track_times=False)
    file.create_dataset(META_CRC, (len(reader),), CRC, track_times=False)
    for field, column in columns.items():
        dtype = np.dtype(f"<{column.kind}{column.size.max(initial=1)}")
        file.create_dataset(field, (int(column.ptr[-1]), *column.width), dtype, track_times=False)
        file.create_dataset(f"ptr/{field}", data=column.ptr, track_times=False)
        file.create_dataset(f"bytes/{field}", data=column.size, track_times=False)


def _texts(members: Iterable[str]) -> tuple[str, ...]:
    """The text fields of samples with these members."""
    held = {_field_of(member) for member in members}
    return tuple(field for field in TEXTS if field in held)


def _field_of(member: str) -> str:
    """The field of a member, under its name in any schema."""
    return fields_of([member]).popitem()[0]


def _store(file: "h5py.File", position: int, members: Mapping[str, Bytes], columns: Mapping[str, _Column]) -> None:
    """Write the rows of one sample."""
    for field in _texts(members):
        try:
            file[field][position] = bytes(member_content(field, members)).decode()
        except ValueError as error:  # not UTF-8, or with a NUL, which HDF5 texts cannot hold
            raise ShardError(
                f"member {MEMBER_OF[field]}: not storable as HDF5 text ({error}): {SHARD_REMEDY}"
            ) from error
    file[META_CRC][position] = zlib.crc32(members[META])
    for field, column in columns.items():
        start, end = column.ptr[position : position + 2].tolist()
        if end > start:
            file[field][start:end] = _array(field, members[MEMBER_OF[field]])


def _array(field: str, data: Bytes) -> np.ndarray:
    try:
        return np.frombuffer(data, np.uint8) if field in PICTURES else read_npy(data)
    except ShardError as error:
        raise ShardError(f"member {MEMBER_OF[field]}: {error}: {SHARD_REMEDY}") from error
