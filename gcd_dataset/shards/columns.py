"""Columns: one mapped file for each field of each shard, in the cache, made from the shard's tar at its first use.

    CACHE/SHA-256 of the shard/verts      head, starts i64 [samples + 1], rows
    CACHE/SHA-256 of the shard/meta.json  the same, of the bytes of a member that holds no arrays

All checks are made here, once: the SHA-256 of the tar, the key of every sample, the checksum of every member that is
decoded. Reading a column checks nothing; it costs no more than a memory map. Columns may be deleted at any time: files
that are mapped stay readable, others are made again, as is one that a power failure has cut off. Two processes that
make one column write the same bytes.
"""

import hashlib
import mmap
import struct
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gcd_dataset.errors import ShardError
from gcd_dataset.files import open_whole
from gcd_dataset.records import MEASURES
from gcd_dataset.shards.access import mapped, reading
from gcd_dataset.shards.cache import filling, make_room, naming_options, touch
from gcd_dataset.shards.codec import DECODERS, DOUBLE, MISSING_MEASURE, SECTIONS, decode_fields, read_measures
from gcd_dataset.shards.layout import Bytes, is_picture, key_of, member_of, members_of
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.sections import TYPES
from gcd_dataset.shards.tar import samples_in

HEAD = struct.Struct("<8s2sHIQQ")  # magic, type, columns of a row, 0, samples, rows
MAGIC = b"gcdcol1\0"
ALIGNED = 64  # bytes: the rows begin at a multiple of this
MOST_OPEN = 2_048  # mapped files of a field; Linux allows a process 65,530 maps
MEASURES_FIELD = "measures"


class Column(NamedTuple):
    """One field of the samples of a shard."""

    rows: np.ndarray
    """The rows of all samples, mapped privately: writing to them never changes the file."""
    starts: list[int]
    """Where each sample's rows begin, and the end of the last."""


class Columns:
    """The columns of some fields of a split. May be pickled, forked, and read from several threads.

    Positions are those of ``reader``. ``fields``: those of ``views``; they are made together. ``limit``: most bytes of
    the cache, ``None`` for no limit; the shards used longest ago are removed first. ``single``: floating numbers of 8
    bytes are kept as float32.
    """

    def __init__(
        self, reader: ShardReader, fields: Iterable[str], *, limit: int | None = None, single: bool = False
    ) -> None:
        self._reader, self._store, self._index = reader, reader.store, reader.index
        self._files = {field: _file_name(field, single) for field in fields}
        self._of_tar = {views: [f for f in self._files if is_picture(member_of(f)) == views] for views in (False, True)}
        """Whether of the pictures, and the fields that are made from this tar of a shard."""
        self._limit, self._single = limit, single
        self._starts: list[int] = self._index.first.tolist()
        self._fit: bool | None = None
        self._open: dict[int, list[Column]] = {}
        """Shard to its open columns, in the order of the fields."""

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": {}}

    def views(self, positions: Sequence[int] | np.ndarray) -> dict[str, list[np.ndarray]]:
        """Field to the stored rows of each sample: views of mapped memory, bytes for fields that are no arrays.

        Makes missing columns. Raises ``ShardError``, ``OutputError``.
        """
        places, opened = self._places(positions), self._open
        if not opened.keys() >= {shard for shard, _ in places}:
            self.fetch(positions)
        samples = [(opened.get(shard) or self._opened(shard), number) for shard, number in places]
        views: dict[str, list[np.ndarray]] = {}
        for column, field in enumerate(self._files):
            views[field] = values = []
            for columns, number in samples:
                stored, starts = columns[column]
                values.append(stored[starts[number] : starts[number + 1]])
        return views

    def fetch(self, positions: Sequence[int] | np.ndarray) -> None:
        """Bring the tars of some samples' shards onto this machine, at once, unless their columns are made."""
        unopened = {shard for shard, _ in self._places(positions)} - self._open.keys()
        for views, fields in self._of_tar.items():
            missing = [self._index.record.shards[shard] for shard in unopened if not self._are_made(shard, fields)]
            if missing:
                with naming_options():
                    self._store.ensure(self._reader.split, missing, views=views)

    def has(self, position: int) -> bool:
        """Whether the columns of a sample are made."""
        [(shard, _)] = self._places([position])
        return shard in self._open or self._are_made(shard, self._files)

    def fit(self) -> bool:
        """Whether the columns of all shards fit into the cache, judged by the first shard that has samples."""
        if self._fit is None:
            counts = np.diff(self._starts)
            shard = int(np.argmax(counts > 0))
            columns = (self._open.get(shard) or self._opened(shard)) if self._limit is not None else []
            size = sum(column.rows.nbytes + 8 * len(column.starts) for column in columns)
            self._fit = self._limit is None or size / max(counts[shard], 1) * len(self._index) <= self._limit
        return self._fit

    def _places(self, positions: Sequence[int] | np.ndarray) -> list[tuple[int, int]]:
        """The shard of each sample, and its number there."""
        begins, rows = self._starts, self._reader.rows(positions).tolist()
        return [(shard := bisect_right(begins, row) - 1, row - begins[shard]) for row in rows]

    def _are_made(self, shard: int, fields: Iterable[str]) -> bool:
        folder = self._folder(shard)
        return all((folder / self._files[field]).exists() for field in fields)

    def _folder(self, shard: int) -> Path:
        return self._store.cache / self._index.record.shards[shard].sha256

    def _opened(self, shard: int) -> list[Column]:
        """The columns of a shard, opened; missing and broken ones are made."""
        folder, columns = self._folder(shard), list[Column]()
        for field, name in self._files.items():
            try:
                columns.append(_open_column(folder / name))
            except (OSError, ValueError):
                with filling(folder), reading(folder / name):
                    missing = [each for each, file in self._files.items() if not (folder / file).exists()]
                    self._make(shard, [*missing, field])
                    columns.append(_open_column(folder / name))
        touch(folder)
        if len(self._open) >= MOST_OPEN:
            self._open.pop(next(iter(list(self._open))), None)
        self._open[shard] = columns
        return columns

    def _make(self, number: int, fields: Sequence[str]) -> None:
        """Make columns of a shard by one pass over its tar, and one over its pictures."""
        shard = self._index.record.shards[number]
        numbers = self._index.number[self._starts[number] : self._starts[number + 1]].tolist()
        for views, of_tar in self._of_tar.items():
            chosen = [field for field in of_tar if field in fields]
            if not chosen:
                continue
            path = self._store.path(self._reader.split, shard, views=views)
            content = mapped(path)
            if hashlib.sha256(content).hexdigest() != (shard.views_sha256 if views else shard.sha256):
                raise ShardError(f"{path}: bytes differ from the written ones: {self._store.remedy}")
            columns: dict[str, list[np.ndarray]] = {field: [] for field in chosen}
            try:
                for key, members in _samples(content, numbers):
                    for field, rows in _rows_of(chosen, members, key).items():
                        columns[field].append(_as_single(field, rows) if self._single and field in DOUBLE else rows)
            except ShardError as error:
                raise ShardError(f"{path}: {error}: {self._store.remedy}") from error
            size = sum(rows.nbytes for column in columns.values() for rows in column)
            make_room(self._store.cache, size, self._limit)
            for field, column in columns.items():
                _write_column(self._folder(number) / self._files[field], column)


def _file_name(field: str, single: bool) -> str:
    name = field if field in SECTIONS or field == MEASURES_FIELD else member_of(field)
    return f"{name}.f4" if single and field in DOUBLE else name


def value_of(field: str, rows: np.ndarray) -> Any:
    """The value of a field from its column: the array itself, a decoded picture, text, or parsed JSON."""
    if field in SECTIONS:
        return rows
    if field == MEASURES_FIELD:
        return {name: value for name, value in zip(MEASURES, rows.tolist(), strict=True) if value != MISSING_MEASURE}
    return DECODERS[field](rows.tobytes())


def _open_column(path: Path) -> Column:
    """A column. Raises ``ValueError`` for a file that is none, or cut off."""
    with path.open("rb") as file:
        memory = mmap.mmap(file.fileno(), 0, flags=mmap.MAP_PRIVATE, prot=mmap.PROT_READ | mmap.PROT_WRITE)
    if len(memory) < HEAD.size:
        raise ValueError(f"{path}: cut off")
    magic, kind, columns, _, samples, count = HEAD.unpack_from(memory)
    begin = _aligned(HEAD.size + 8 * (samples + 1))
    if magic != MAGIC or kind not in TYPES or len(memory) != begin + count * max(columns, 1) * int(kind[1:]):
        raise ValueError(f"{path}: not a column, or cut off")
    starts = np.frombuffer(memory, np.int64, samples + 1, HEAD.size).tolist()
    shape = (count, columns) if columns else (count,)
    return Column(np.ndarray(shape, f"<{kind.decode()}", memory, begin), starts)


def _aligned(size: int) -> int:
    return -(-size // ALIGNED) * ALIGNED


def _samples(content: memoryview, numbers: Sequence[int]) -> Iterator[tuple[str, Mapping[str, Bytes]]]:
    """Key and members of each sample of a tar. Raises ``ShardError`` for other samples than the index has."""
    samples = samples_in(content)
    for number in numbers:
        key, members = next(samples, ("no sample", {}))
        if key != key_of(number):
            raise ShardError(f"holds {key} where the index has {key_of(number)}")
        yield key, members
    if (more := next(samples, None)) is not None:
        raise ShardError(f"holds {more[0]}, which the index lacks")


def _rows_of(fields: Sequence[str], members: Mapping[str, Bytes], key: str) -> dict[str, np.ndarray]:
    """Field to its rows in a column, for one sample. Raises ``ShardError``."""
    arrays = [field for field in fields if field in SECTIONS]
    needed = members_of(fields, {field: member_of(field) for field in fields})
    if lacking := [member for member in needed if member not in members]:
        raise ShardError(f"sample {key} has no {lacking[0]}")
    try:
        rows: dict[str, np.ndarray] = decode_fields(members, arrays) if arrays else {}
        for field in fields:
            if field == MEASURES_FIELD:
                measures = read_measures(members[member_of(field)])
                rows[field] = np.array([measures.get(name, MISSING_MEASURE) for name in MEASURES])
            elif field not in SECTIONS:
                rows[field] = np.frombuffer(members[member_of(field)], np.uint8)
    except ShardError as error:
        raise ShardError(f"sample {key}, {error}") from error
    return rows


def _as_single(field: str, rows: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        narrow = rows.astype(np.float32)
    if not np.isfinite(narrow).all():
        raise ShardError(f"field {field}: numbers beyond the range of float32: dtype=None keeps the stored type")
    return narrow


def _write_column(path: Path, rows: Sequence[np.ndarray]) -> None:
    """Write a column under another name, then rename it. Raises ``OutputError``."""
    first = rows[0]
    starts = np.cumsum([0, *map(len, rows)], dtype=np.int64)
    columns = first.shape[1] if first.ndim > 1 else 0
    head = HEAD.pack(MAGIC, first.dtype.str[1:].encode(), columns, 0, len(rows), int(starts[-1])) + starts.tobytes()
    begin = _aligned(len(head))
    content = np.empty(begin + sum(value.nbytes for value in rows), np.uint8)
    content[:begin] = np.frombuffer(head.ljust(begin, b"\0"), np.uint8)
    np.concatenate(rows, out=content[begin:].view(first.dtype).reshape(-1, *first.shape[1:]))
    with open_whole(path, synced=False) as file:
        file.write(content.data)  # in one call: the page cache then holds it in large pages, which read faster
