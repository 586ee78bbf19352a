"""Where every member of every sample lies: what turns a tar into a file with random access.

``index-train.npz`` can always be made again from the shards; a shard that it does not know, or knows in another
length, is read anew.
"""

import contextlib
import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
from jaxtyping import Bool, Int, UInt32

from gcd_dataset.errors import ShardError
from gcd_dataset.files import write_whole
from gcd_dataset.names import safe_name
from gcd_dataset.records import Outcome, Record
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.layout import (
    BODIES,
    GARMENTS,
    SCHEMA,
    Layout,
    foreign_layout,
    index_name,
    key_of,
    member_name,
    shards_in,
)
from gcd_dataset.shards.tar import BLOCK, Entry, tar_entries

__all__ = [
    "ShardIndex",
    "ShardTable",
    "has_settled",
    "known_index",
    "members_of_shard",
    "scan_shard",
    "sizes_in",
    "tables_of",
    "whole_samples",
]

MADE_AGAIN = "delete it, it is made again from the shards"
META = "meta.json"
MOST_MEMBERS = 64  # of a sample that is looked at
OURS = re.compile(rb"(gcd_\d{9,})\.meta\.json\0")  # how every archive of ours begins


@dataclass(frozen=True, eq=False)
class ShardTable(Record):
    """The contents of one shard; ``n`` samples in the order of the file, ``m`` members."""

    sample: Int[np.ndarray, " n"]
    """Index of each sample in the data set."""
    offset: Int[np.ndarray, "n m"]
    """First byte of each member's content."""
    size: UInt32[np.ndarray, "n m"]
    """Bytes of it."""
    crc: UInt32[np.ndarray, "n m"]
    """CRC-32 of it."""
    settled: Bool[np.ndarray, " n"]
    """Whether the drape of each sample ended as ``Outcome.SETTLED``; false where there is none."""

    @classmethod
    def of(cls, rows: Iterable["ShardTable"], layout: Layout = GARMENTS) -> Self:
        """Several tables as one."""
        parts = [empty_table(layout), *rows]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS))

    def __getitem__(self, rows: Any) -> "ShardTable":
        return ShardTable(*(getattr(self, name)[rows] for name in _COLUMNS))

    def __len__(self) -> int:
        return len(self.sample)


_COLUMNS = ("sample", "offset", "size", "crc", "settled")


def empty_table(layout: Layout = GARMENTS) -> ShardTable:
    """The contents of a shard without samples."""
    none = np.zeros((0, len(layout.members)), np.uint32)
    return ShardTable(np.zeros(0, np.int64), none.astype(np.int64), none, none, np.zeros(0, bool))


@dataclass(frozen=True, eq=False)
class ShardIndex(Record):
    """The contents of a split: the tables of its shards, one below the other."""

    shards: tuple[str, ...]
    """File names."""
    length: Int[np.ndarray, " k"]
    """Bytes of each shard."""
    shard: Int[np.ndarray, " n"]
    """Row of ``shards`` for each sample."""
    table: ShardTable
    layout: Layout = GARMENTS
    keys: tuple[str, ...] = ()
    """Names of the samples of foreign archives; ours follow from their indices."""

    @classmethod
    def of(cls, folder: Path, tables: Mapping[str, ShardTable], layout: Layout = GARMENTS) -> Self:
        """The index of shards that lie in ``folder``, from file name to contents."""
        counts = [len(table) for table in tables.values()]
        with reading(folder):
            length = np.array([(folder / name).stat().st_size for name in tables], np.int64)
        shard = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
        return cls(tuple(tables), length, shard, ShardTable.of(tables.values(), layout), layout)

    def __len__(self) -> int:
        return len(self.table)

    def key(self, row: int) -> str:
        """The name of a sample in its shard."""
        return self.keys[row] if self.keys else key_of(int(self.table.sample[row]))

    def write(self, path: Path) -> None:
        """Keep the index as ``path``, whole or not at all. Raises ``OutputError``."""
        write_whole(path, self.to_bytes())

    def to_bytes(self) -> bytes:
        """The index as a file."""
        file = io.BytesIO()
        arrays: dict[str, Any] = {name: getattr(self.table, name) for name in _COLUMNS}
        arrays |= {"shards": np.array(self.shards, np.str_), "length": self.length, "shard": self.shard}
        if self.keys:
            arrays["keys"] = np.array(self.keys, np.str_)
        np.savez(file, schema=np.array(SCHEMA), members=np.array(self.layout.members), **arrays)
        return file.getvalue()

    @classmethod
    def read(cls, path: Path, layout: Layout = GARMENTS, *, partial: bool = False) -> Self:
        """The index in ``path``; ``partial``: one of some of the layout's members, or of foreign archives, will do too.

        Raises ``ShardError`` for a file that is broken, of another schema or layout.
        """
        with reading(path):
            content = path.read_bytes()
        return cls.parse(content, str(path), layout, partial=partial)

    @classmethod
    def parse(
        cls, content: bytes, path: str, layout: Layout = GARMENTS, *, partial: bool = False, remedy: str = MADE_AGAIN
    ) -> Self:
        """The index in a file's content; ``path`` and ``remedy`` stand in errors. Raises as ``read`` does."""
        try:
            if not zipfile.is_zipfile(io.BytesIO(content)):
                raise zipfile.BadZipFile("no archive of arrays, or cut off")
            with np.load(io.BytesIO(content), allow_pickle=False) as file:
                arrays = dict(file)
            schema, members = int(arrays["schema"]), tuple(arrays["members"].tolist())
            table = ShardTable(*(arrays[name] for name in _COLUMNS))
            keys = tuple(arrays["keys"].tolist()) if "keys" in arrays else ()
            found = foreign_layout(members) if keys else layout
            if partial and schema == SCHEMA and not keys and layout.holds(members):
                found = layout.of(members)
            index = cls(tuple(arrays["shards"].tolist()), arrays["length"], arrays["shard"], table, found, keys)
        except (KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise ShardError(f"{path}: not an index ({error}): {remedy}") from error
        if schema == SCHEMA and members == found.members and (partial or not keys):
            return index._consistent(path, remedy)
        for other in (GARMENTS, BODIES):
            if schema == SCHEMA and members == other.members != layout.members:
                raise ShardError(
                    f"{path}: an index of {other.kind}, not of {layout.kind}: read them with {other.reader}, or choose "
                    "another folder"
                )
        if schema == SCHEMA and (keys or layout.holds(members)):
            what = "foreign archives" if keys else f"samples without {_lacking(layout, members)}"
            raise ShardError(f"{path}: an index of {what}, which are only read: choose another folder")
        remedy = "update gcd_dataset" if schema > SCHEMA else remedy
        raise ShardError(f"{path}: an index of schema {schema}, and this reader knows {SCHEMA}: {remedy}")

    def _consistent(self, path: str, remedy: str) -> Self:
        """The index itself. Raises ``ShardError`` unless its columns fit together and every member is in its shard."""
        try:
            self._require_consistent()
        except ValueError as error:
            raise ShardError(f"{path}: not an index ({error}): {remedy}") from error
        return self

    def _require_consistent(self) -> None:
        n, m, k = len(self.table), len(self.layout.members), len(self.shards)
        shapes = {name: getattr(self.table, name).shape for name in _COLUMNS} | {"shard": self.shard.shape}
        if any(shape != ((n, m) if name in ("offset", "size", "crc") else (n,)) for name, shape in shapes.items()):
            raise ValueError(f"columns of {sorted(set(shapes.values()))} rows and members")
        if len(self.length) != k or (self.keys and len(self.keys) != n):
            raise ValueError(f"{len(self.length)} lengths and {len(self.keys)} keys for {k} shards of {n} samples")
        if n and (not 0 <= self.shard.min() <= self.shard.max() < k or (np.diff(self.shard) < 0).any()):
            raise ValueError(f"rows of shards beyond {k}, or out of order")
        there = self.table.offset >= 0
        ends = np.where(there, self.table.offset + self.table.size.astype(np.int64), 0)
        if n and (ends > self.length[self.shard][:, None]).any():
            raise ValueError("a member beyond the end of its shard")
        # Foreign names are compared with those in the folder, ours are joined to it.
        if any(
            "/" in name or name in ("", ".", "..") or not (self.keys or safe_name(name) == name) for name in self.shards
        ):
            raise ValueError("a shard outside the folder")

    def tables(self) -> dict[str, ShardTable]:
        """File name to contents."""
        first = np.searchsorted(self.shard, np.arange(len(self.shards) + 1))
        return {name: self.table[first[i] : first[i + 1]] for i, name in enumerate(self.shards)}


def known_index(folder: Path, split: str, layout: Layout = GARMENTS, *, partial: bool = False) -> ShardIndex | None:
    """The index that is kept in a folder; ``None`` where there is none. Raises as ``ShardIndex.read`` does."""
    with reading(folder):
        is_there = (path := folder / index_name(split)).exists()
    return ShardIndex.read(path, layout, partial=partial) if is_there else None


def tables_of(
    folder: Path, split: str, layout: Layout = GARMENTS, *, index: ShardIndex | None = None
) -> dict[str, ShardTable]:
    """The contents of each whole shard of a split, from its ``index`` where that knows the shard.

    Without ``index`` the one that is kept in the folder. Raises ``ShardError`` for one of another layout.
    """
    index = known_index(folder, split, layout) if index is None else index
    known: dict[tuple[str, int], ShardTable] = {}
    if index is not None:
        known = dict(zip(zip(index.shards, index.length.tolist(), strict=True), index.tables().values(), strict=True))
    tables = {}
    for shard, size in sizes_in(folder, split).items():
        table = known.get((shard, size))
        tables[shard] = scan_shard(folder / shard, layout) if table is None else table
    return tables


def sizes_in(folder: Path, split: str) -> dict[str, int]:
    """File name to bytes of each whole shard of a split. Raises ``ShardError``."""
    with reading(folder):
        return {path.name: path.stat().st_size for path in shards_in(folder, split)}


def has_settled(meta: Mapping[str, Any]) -> bool:
    """Whether the sample of a ``meta.json`` has been draped and hangs still."""
    drape = meta.get("drape")  # a body has none
    return drape is not None and drape["outcome"] == Outcome.SETTLED.name


def scan_shard(path: Path, layout: Layout = GARMENTS) -> ShardTable:
    """The contents of a shard, read from its tar headers and the hashes in each sample's ``meta.json``.

    Raises ``ShardError`` for a damaged archive, or samples that are not of this schema and layout.
    """
    with _opened(path) as file:
        try:
            samples = _by_sample(tar_entries(file), layout)
            return ShardTable.of((_row(file, entries, layout) for entries in samples), layout)
        except ShardError as error:
            raise ShardError(f"{path}: {error}: {REMEDY}") from error


def members_of_shard(path: Path) -> tuple[str, ...] | None:
    """The members of the first sample of a shard; ``None`` for an archive that is not ours."""
    members: list[str] = []
    with _opened(path) as file:
        match = OURS.match(os.pread(file, BLOCK, 0))
        if match is None:
            return None
        # An error here is damage, which the scan will tell.
        with contextlib.suppress(ShardError):
            for entry in islice(tar_entries(file), MOST_MEMBERS):
                key, _, member = entry.name.partition(".")
                if key != match[1].decode():
                    break
                members.append(member)
    return tuple(members)


def whole_samples(path: Path, layout: Layout = GARMENTS) -> ShardTable:
    """The contents of a shard whose writing was broken off: every sample up to the first that is not whole."""
    rows: list[ShardTable] = []
    # An error here is the sample that was being written when the end came.
    with _opened(path) as file, contextlib.suppress(ShardError):
        for entries in _by_sample(tar_entries(file), layout):
            row = _row(file, entries, layout)
            if any(_crc(file, entry) != crc for entry, crc in zip(entries, row.crc[0].tolist(), strict=True)):
                break
            rows.append(row)
    return ShardTable.of(rows, layout)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    """The file's descriptor. Raises ``ShardError`` for what the system refuses."""
    with reading(path), path.open("rb") as file:
        yield file.fileno()


def _by_sample(entries: Iterator[Entry], layout: Layout) -> Iterator[list[Entry]]:
    # By number, not by key: to see that a key has changed, one would read into the next sample, which may be torn.
    while sample := list(islice(entries, len(layout.members))):
        yield sample


def _lacking(layout: Layout, members: Sequence[str]) -> str:
    return ", ".join(member for member in layout.members if member not in members)


def _row(file: int, entries: list[Entry], layout: Layout) -> ShardTable:
    """The table of one sample."""
    key = entries[0].name.partition(".")[0]
    meta = _read_meta(file, entries[0], key, layout)
    if [entry.name for entry in entries] != [member_name(meta["index"], member) for member in layout.members]:
        raise ShardError(f"sample {key} does not have the members of schema {SCHEMA} for {layout.kind}")
    crc = [_crc(file, entries[0])] + [meta["crc32"][member] for member in layout.members[1:]]
    return ShardTable(
        sample=np.array([meta["index"]], np.int64),
        offset=np.array([[entry.offset for entry in entries]], np.int64),
        size=np.array([[entry.size for entry in entries]], np.uint32),
        crc=np.array([crc], np.uint32),
        settled=np.array([meta["settled"]]),
    )


def _read_meta(file: int, entry: Entry, key: str, layout: Layout) -> dict[str, Any]:
    try:
        meta = json.loads(_content(file, entry))
        if meta["schema"] != SCHEMA:
            raise ShardError(f"sample {key} is of schema {meta['schema']}, and this reader knows schema {SCHEMA}")
        return {
            "index": int(meta["index"]),
            "crc32": {member: int(meta["crc32"][member]) for member in layout.members[1:]},
            "settled": has_settled(meta),
        }
    except (ValueError, KeyError, TypeError) as error:
        raise ShardError(f"sample {key} does not begin with a {META} of a data set of {layout.kind}") from error


def _content(file: int, entry: Entry) -> bytes:
    return os.pread(file, entry.size, entry.offset)


def _crc(file: int, entry: Entry) -> int:
    return zlib.crc32(_content(file, entry))
