"""Shard indices: the offset, size and CRC-32 of every member, for random access to tars.

``index-train.npz`` can be rebuilt from the shards. A shard that it does not list, or lists with another length, is
scanned.
"""

import contextlib
import hashlib
import io
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
from jaxtyping import Bool, Int, UInt8, UInt32

from gcd_dataset.errors import ShardError
from gcd_dataset.files import open_regular, write_whole
from gcd_dataset.names import safe_name
from gcd_dataset.records import Grade, Outcome, Record
from gcd_dataset.shards.access import REMEDY, read_limited, reading
from gcd_dataset.shards.arrays import Column, read_arrays
from gcd_dataset.shards.layout import (
    BODIES,
    FOREIGN,
    GARMENTS,
    Layout,
    foreign_layout,
    index_name,
    is_extra,
    key_of,
    layout_of,
    member_name,
    shards_in,
)
from gcd_dataset.shards.limits import LARGEST_FILE, LARGEST_JSON, LARGEST_SAMPLE
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.tar import BLOCK, TarMember, tar_entries

__all__ = [
    "GRADES",
    "ShardIndex",
    "ShardTable",
    "first_sample_format",
    "grade_index",
    "has_settled",
    "read_stored_index",
    "read_tables",
    "scan_shard",
    "shard_sizes",
    "whole_samples",
]

REBUILD = "delete it: it is rebuilt from the shards"
META = "meta.json"
MOST_MEMBERS = 256  # most members of a sample read to recognise its format
SCHEMA_ENTRY = re.compile(rb'\{\s*"schema":\s*(\d{1,9})\D')
OWN_START = re.compile(rb"(gcd_\d{9,})\.meta\.json\0")  # start of every shard written by this package


@dataclass(frozen=True, eq=False)
class ShardTable(Record):
    """The contents of one shard: ``n`` samples in file order, ``m`` members each."""

    sample: Int[np.ndarray, " n"]
    """Index of each sample in the data set."""
    offset: Int[np.ndarray, "n m"]
    """First byte of each member's content in the shard."""
    size: UInt32[np.ndarray, "n m"]
    """Bytes of the content."""
    crc: UInt32[np.ndarray, "n m"]
    """CRC-32 of the content."""
    settled: Bool[np.ndarray, " n"]
    """Whether the drape of each sample ended as ``Outcome.SETTLED``; false without a drape."""
    grade: UInt8[np.ndarray, " n"]
    """Index in ``GRADES`` of the grade of each sample."""

    @classmethod
    def of(cls, rows: Iterable["ShardTable"], layout: Layout = GARMENTS) -> Self:
        """The concatenation of several tables."""
        parts = [empty_table(layout), *rows]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS))

    def __getitem__(self, rows: Any) -> "ShardTable":
        return ShardTable(*(getattr(self, name)[rows] for name in _COLUMNS))

    def __len__(self) -> int:
        return len(self.sample)


GRADES = ("", *(grade.value for grade in (Grade.FAILED, Grade.PAPER, Grade.CLEAN)))
"""No grade, then the grades from worst to best: a minimum grade admits this grade and the later ones."""
_COLUMNS = ("sample", "offset", "size", "crc", "settled", "grade")
_ARRAYS: Mapping[str, Column] = {
    "schema": Column("iu", 0), "members": Column("U", 1), "shards": Column("U", 1), "length": Column("iu", 1),
    "shard": Column("iu", 1), "sample": Column("iu", 1), "offset": Column("iu", 2), "size": Column("iu", 2),
    "crc": Column("iu", 2), "settled": Column("b", 1), "grade": Column("iu", 1, needed=False),
    "keys": Column("U", 1, needed=False), "digest": Column("U", 0, needed=False),
}  # fmt: skip
"""The arrays of an index file; ``keys`` for foreign archives, ``digest`` and ``grade`` since schema 2."""


def empty_table(layout: Layout = GARMENTS) -> ShardTable:
    """The table of a shard without samples."""
    none = np.zeros((0, len(layout.members)), np.uint32)
    return ShardTable(
        np.zeros(0, np.int64), none.astype(np.int64), none, none, np.zeros(0, bool), np.zeros(0, np.uint8)
    )


@dataclass(frozen=True, eq=False)
class ShardIndex(Record):
    """The contents of a split: the concatenated tables of its shards."""

    shards: tuple[str, ...]
    """File names."""
    length: Int[np.ndarray, " k"]
    """Bytes of each shard."""
    shard: Int[np.ndarray, " n"]
    """Row of ``shards`` for each sample."""
    table: ShardTable
    layout: Layout = GARMENTS
    keys: tuple[str, ...] = ()
    """Keys of the samples of foreign archives; otherwise the keys follow from the indices."""

    @classmethod
    def of(cls, folder: Path, tables: Mapping[str, ShardTable], layout: Layout = GARMENTS) -> Self:
        """The index of shards in ``folder``, from file name to table."""
        with reading(folder):
            length = [(folder / name).stat().st_size for name in tables]
        return cls.joined(tables, length, layout)

    @classmethod
    def joined(cls, tables: Mapping[str, ShardTable], length: Sequence[int], layout: Layout = GARMENTS) -> Self:
        """The index of shards of these lengths [bytes], from file name to table."""
        shard = np.repeat(np.arange(len(tables), dtype=np.int32), [len(table) for table in tables.values()])
        table = ShardTable.of(tables.values(), layout)
        return cls(tuple(tables), np.array(length, np.int64), shard, table, layout)

    def __len__(self) -> int:
        return len(self.table)

    def key(self, row: int) -> str:
        """The key of a sample: its name in the shard."""
        return self.keys[row] if self.keys else key_of(int(self.table.sample[row]))

    def write(self, path: Path) -> None:
        """Write the index to ``path``, atomically. Raises ``OutputError``."""
        write_whole(path, self.to_bytes())

    def to_bytes(self) -> bytes:
        """The content of the index file."""
        file = io.BytesIO()
        arrays: dict[str, Any] = {name: getattr(self.table, name) for name in _COLUMNS}
        if self.layout.schema == 1:
            del arrays["grade"]
        arrays |= {"shards": np.array(self.shards, np.str_), "length": self.length, "shard": self.shard}
        if self.keys:
            arrays["keys"] = np.array(self.keys, np.str_)
        arrays |= {"schema": np.array(self.layout.schema), "members": np.array(self.layout.members)}
        if self.layout.schema > 1:
            arrays["digest"] = np.array(_digest(arrays))
        np.savez(file, **arrays)
        return file.getvalue()

    @classmethod
    def read(cls, path: Path, layout: Layout = GARMENTS, *, partial: bool = False) -> Self:
        """The index in ``path``.

        ``partial`` also accepts an index of fewer members, of an earlier schema, or of foreign archives. Raises
        ``ShardError`` for a broken file, and for another schema or layout.
        """
        return cls.parse(read_limited(path, LARGEST_FILE), str(path), layout, partial=partial)

    @classmethod
    def parse(
        cls, content: bytes, path: str, layout: Layout = GARMENTS, *, partial: bool = False, remedy: str = REBUILD
    ) -> Self:
        """The index in a file's content; ``path`` and ``remedy`` for messages. Raises as ``read`` does."""
        try:
            arrays = read_arrays(content, {"schema": _ARRAYS["schema"]})
            _require_known(int(arrays["schema"]), path)
            arrays = read_arrays(content, _ARRAYS)
            schema, members = int(arrays["schema"]), tuple(arrays["members"].tolist())
            keys = tuple(arrays["keys"].tolist()) if "keys" in arrays else ()
            found = replace(foreign_layout(members), schema=schema) if keys else layout_of(layout, schema, members)
            if found is None or (found != layout and not partial):
                raise _other_layout(path, layout, schema, members, bool(keys))
            if schema > 1 and arrays.get("digest", "") != _digest(arrays):
                raise ShardError("its digest does not match its columns")
            if "grade" not in arrays:  # written by an older version
                arrays = {**arrays, "grade": np.zeros(len(arrays["sample"]), np.uint8)}
            _require_consistent(arrays, found)
        except ShardError as error:
            if str(error).startswith(path):
                raise
            raise ShardError(f"{path}: not an index ({error}): {remedy}") from error
        return cls(
            shards=tuple(arrays["shards"].tolist()),
            length=arrays["length"].astype(np.int64, copy=False),
            shard=arrays["shard"].astype(np.int32, copy=False),
            table=ShardTable(
                sample=arrays["sample"].astype(np.int64, copy=False),
                offset=arrays["offset"].astype(np.int64, copy=False),
                size=arrays["size"].astype(np.uint32, copy=False),
                crc=arrays["crc"].astype(np.uint32, copy=False),
                settled=arrays["settled"],
                grade=arrays["grade"].astype(np.uint8, copy=False),
            ),
            layout=found,
            keys=keys,
        )

    def tables(self) -> dict[str, ShardTable]:
        """Shard name to table."""
        first = np.searchsorted(self.shard, np.arange(len(self.shards) + 1))
        return {name: self.table[first[i] : first[i + 1]] for i, name in enumerate(self.shards)}


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of all arrays of an index, which detects an edited column."""
    digest = hashlib.sha256()
    for name in sorted(arrays.keys() - {"digest"}):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.data if array.dtype.kind != "U" else array.tobytes())
    return digest.hexdigest()


def _require_known(schema: int, path: str) -> None:
    """Raise ``ShardError`` for an unknown schema."""
    if schema != SCHEMA:
        raise ShardError(f"{path}: an index of schema {schema}, but this reader knows {SCHEMA}: update gcd_dataset")


def _other_layout(path: str, layout: Layout, schema: int, members: tuple[str, ...], is_foreign: bool) -> ShardError:
    """The error for an index with another layout than ``layout``."""
    for other in (GARMENTS, BODIES):
        if other.kind != layout.kind and not is_foreign and layout_of(other, schema, members) is not None:
            return ShardError(
                f"{path}: an index of {other.kind}, not of {layout.kind}: read them with {other.reader}, or choose "
                "another folder"
            )
    if is_foreign or layout_of(layout, schema, members) is not None:
        lacking = ", ".join(member for member in layout.members if member not in members)
        contents = f"schema {schema}, but schema {layout.schema} is written"
        if schema == layout.schema:
            contents = f"samples without {lacking}" if lacking else "samples with a caption or views"
        if not is_foreign and schema == layout.schema and all(map(is_extra, set(layout.members) ^ set(members))):
            return ShardError(
                f"{path}: an index of {contents}: give the options of the first run, such as captions, or choose "
                "another folder"
            )
        contents = "foreign archives" if is_foreign else contents
        return ShardError(f"{path}: an index of {contents}: these are read-only: choose another folder")
    return ShardError(f"{path}: not an index of {layout.kind} (members {', '.join(members)[:60]}): {REBUILD}")


def _require_consistent(arrays: Mapping[str, np.ndarray], layout: Layout) -> None:
    """Raise ``ShardError`` unless the columns have matching shapes and every member lies inside its shard."""
    n, m, k = len(arrays["sample"]), len(layout.members), len(arrays["shards"])
    for name in (*_COLUMNS, "shard"):
        if arrays[name].shape != ((n, m) if name in ("offset", "size", "crc") else (n,)):
            raise ShardError(f"column {name} of shape {arrays[name].shape}, for {n} samples of {m} members")
    if len(arrays["length"]) != k or len(arrays.get("keys", arrays["sample"])) != n:
        raise ShardError(f"{len(arrays['length'])} lengths for {k} shards, or keys for other than {n} samples")
    for name in ("sample", "shard", "size", "crc", "length", "grade"):
        # Compared as Python integers: an unsigned column may exceed a signed one.
        low, high = (int(arrays[name].min()), int(arrays[name].max())) if arrays[name].size else (0, 0)
        limits = {"shard": max(k - 1, 0), "size": LARGEST_SAMPLE, "crc": 2**32 - 1, "grade": len(GRADES) - 1}
        most = limits.get(name, LONGEST)
        if low < 0 or high > most:
            raise ShardError(f"column {name} from {low} to {high}, outside 0 to {most}")
    # Only names of our shards are joined to a path; names of foreign tars are compared with those in the folder.
    is_own = "keys" not in arrays
    if any("/" in n or n in ("", ".", "..") or (is_own and safe_name(n) != n) for n in arrays["shards"].tolist()):
        raise ShardError("a shard outside the folder")
    if not n:
        return
    if (np.diff(arrays["shard"].astype(np.int64)) < 0).any():
        raise ShardError("shards out of order")
    if layout.kind != FOREIGN and (np.diff(np.sort(arrays["sample"])) == 0).any():
        raise ShardError("a sample occurs twice")
    for first in range(0, n, CHUNK):
        _require_inside(arrays, slice(first, first + CHUNK), layout)


LONGEST = 1 << 62
CHUNK = 1 << 12  # samples checked at a time: bounds the memory of intermediate arrays


def _require_inside(arrays: Mapping[str, np.ndarray], rows: slice, layout: Layout) -> None:
    """Raise ``ShardError`` for a member beyond the end of its shard, or a sample over the size limits."""
    least = -1 if layout.kind == FOREIGN else 0  # foreign samples may lack a member: offset -1
    length = arrays["length"].astype(np.int64, copy=False)[arrays["shard"][rows].astype(np.int64)][:, None]
    offset = arrays["offset"][rows]
    if int(offset.min()) < least or (offset > length).any():
        raise ShardError("a member beyond the end of its shard")
    offset, size = offset.astype(np.int64), arrays["size"][rows].astype(np.int64)
    if (np.where(offset >= 0, offset + size, 0) > length).any():
        raise ShardError("a member beyond the end of its shard")
    if layout.kind != FOREIGN:
        if (size.sum(axis=1) > LARGEST_SAMPLE).any():
            raise ShardError(f"a sample of more than {LARGEST_SAMPLE} bytes")
        if (size[:, 0] > LARGEST_JSON).any():
            raise ShardError(f"a {META} of more than {LARGEST_JSON} bytes")


def read_stored_index(
    folder: Path, split: str, layout: Layout = GARMENTS, *, partial: bool = False
) -> ShardIndex | None:
    """The index file of a split; ``None`` where there is none. Raises as ``ShardIndex.read`` does."""
    with reading(folder):
        exists = (path := folder / index_name(split)).exists()
    return ShardIndex.read(path, layout, partial=partial) if exists else None


def read_tables(
    folder: Path, split: str, layout: Layout = GARMENTS, *, index: ShardIndex | None = None
) -> dict[str, ShardTable]:
    """Shard name to table, for the finished shards of a split: from ``index`` where it has the shard, else scanned.

    ``index``: by default the index file in the folder. Raises ``ShardError`` for an index of another layout.
    """
    index = read_stored_index(folder, split, layout) if index is None else index
    known: dict[tuple[str, int], ShardTable] = {}
    if index is not None:
        known = dict(zip(zip(index.shards, index.length.tolist(), strict=True), index.tables().values(), strict=True))
    tables = {}
    for shard, size in shard_sizes(folder, split).items():
        table = known.get((shard, size))
        tables[shard] = scan_shard(folder / shard, layout) if table is None else table
    return tables


def shard_sizes(folder: Path, split: str) -> dict[str, int]:
    """File name to size [bytes] of each finished shard of a split. Raises ``ShardError``."""
    with reading(folder):
        return {path.name: path.stat().st_size for path in shards_in(folder, split)}


def has_settled(meta: Mapping[str, Any]) -> bool:
    """Whether the drape in a ``meta.json`` has settled; false without a drape."""
    drape = meta.get("drape")  # bodies have no drape
    return drape is not None and drape["outcome"] == Outcome.SETTLED.name


def grade_index(meta: Mapping[str, Any]) -> int:
    """Index in ``GRADES`` of the grade in a ``meta.json``; 0 without a grade."""
    return GRADES.index(meta.get("grade") or "")  # bodies, and samples of schema 1, have none


def scan_shard(path: Path, layout: Layout = GARMENTS) -> ShardTable:
    """The table of a shard, from its tar headers and the checksums in each sample's ``meta.json``.

    Raises ``ShardError`` for a damaged archive, and for samples of another layout or schema.
    """
    with _opened(path) as file:
        try:
            samples = _by_sample(tar_entries(file), layout)
            return ShardTable.of((_row(file, entries, layout) for entries in samples), layout)
        except ShardError as error:
            raise ShardError(f"{path}: {error}: {REMEDY}") from error


def first_sample_format(path: Path) -> tuple[int, tuple[str, ...]] | None:
    """Schema and members of the first sample of a shard; ``None`` for a tar by another program.

    Schema 0 where the sample does not hold it. Raises ``ShardError`` for a file that cannot be read.
    """
    members: list[str] = []
    schema = 0
    with _opened(path) as file:
        start = OWN_START.match(os.pread(file, BLOCK, 0))
        if start is None:
            return None
        # Damage is reported by the scan that follows.
        with contextlib.suppress(ShardError):
            for entry in islice(tar_entries(file), MOST_MEMBERS):
                key, _, member = entry.name.partition(".")
                if key != start[1].decode():
                    break
                if not members and (match := SCHEMA_ENTRY.match(os.pread(file, 64, entry.offset))):
                    schema = int(match[1])
                members.append(member)
    return schema, tuple(members)


def whole_samples(path: Path, layout: Layout = GARMENTS) -> ShardTable:
    """The table of an interrupted shard: its samples before the first incomplete or damaged one."""
    rows: list[ShardTable] = []
    # An error marks the sample that was being written at the interrupt.
    with _opened(path) as file, contextlib.suppress(ShardError):
        for entries in _by_sample(tar_entries(file), layout):
            row = _row(file, entries, layout)
            if any(_crc(file, entry) != crc for entry, crc in zip(entries, row.crc[0].tolist(), strict=True)):
                break
            rows.append(row)
    return ShardTable.of(rows, layout)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    """The file's descriptor. Raises ``ShardError`` for an OS error."""
    with reading(path), open_regular(path) as file:
        yield file.fileno()


def _by_sample(entries: Iterator[TarMember], layout: Layout) -> Iterator[list[TarMember]]:
    # Grouped by count, not by key: a change of key shows only in the next sample, which may be truncated.
    while sample := list(islice(entries, len(layout.members))):
        yield sample


def _row(file: int, entries: list[TarMember], layout: Layout) -> ShardTable:
    """The table of one sample. Raises ``ShardError``."""
    key = entries[0].name.partition(".")[0]
    if sum(entry.size for entry in entries) > LARGEST_SAMPLE:
        raise ShardError(f"sample {key} has more than {LARGEST_SAMPLE} bytes")
    meta = _read_meta(file, entries[0], key, layout)
    names = [entry.name for entry in entries]
    if names != [member_name(meta["index"], member) for member in layout.members]:
        missing = [member for member in layout.members if member_name(meta["index"], member) not in names]
        lack = f" and lacks {', '.join(missing)}" if missing else ""
        raise ShardError(f"sample {key} does not have the members of schema {layout.schema} for {layout.kind}{lack}")
    crc = [_crc(file, entries[0])] + [meta["crc32"][member] for member in layout.members[1:]]
    return ShardTable(
        sample=np.array([meta["index"]], np.int64),
        offset=np.array([[entry.offset for entry in entries]], np.int64),
        size=np.array([[entry.size for entry in entries]], np.uint32),
        crc=np.array([crc], np.uint32),
        settled=np.array([has_settled(meta)]),
        grade=np.array([grade_index(meta)], np.uint8),
    )


def _read_meta(file: int, entry: TarMember, key: str, layout: Layout) -> dict[str, Any]:
    if entry.size > LARGEST_JSON:
        raise ShardError(f"sample {key} begins with a member of {entry.size} bytes; {META} has at most {LARGEST_JSON}")
    try:
        meta = read_meta(_content(file, entry))
    except ShardError as error:
        raise ShardError(
            f"sample {key} does not begin with a {META} of a data set of {layout.kind}: {error}"
        ) from error
    if meta["schema"] != layout.schema:
        raise ShardError(f"sample {key} has schema {meta['schema']}, but the data set has schema {layout.schema}")
    if unchecked := [member for member in layout.members[1:] if not _is_crc(meta.get("crc32"), member)]:
        raise ShardError(
            f"sample {key} does not begin with a {META} of a data set of {layout.kind}: no CRC-32 of {unchecked[0]}"
        )
    return meta


def _is_crc(crc: Any, member: str) -> bool:
    value = crc.get(member) if isinstance(crc, Mapping) else None
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 32


def _content(file: int, entry: TarMember) -> bytes:
    return os.pread(file, entry.size, entry.offset)


def _crc(file: int, entry: TarMember) -> int:
    return zlib.crc32(_content(file, entry))
