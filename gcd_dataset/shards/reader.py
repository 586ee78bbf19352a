"""Samples of a data set by number: the members asked for and no others, checked as they come."""

import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Bool, Int

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.records import Sample
from gcd_dataset.shards.codec import decode_sample
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.layout import FIRST_NAMES, FOREIGN, GARMENTS, MEMBERS, Layout
from gcd_dataset.shards.meta import index_told
from gcd_dataset.shards.store import MemberLocation, Store

__all__ = ["ShardReader", "Verify", "naming_place"]

META = 0  # every layout of ours begins with meta.json
Verify = Literal["lazy", "full", "off"]
Rows: TypeAlias = Int[np.ndarray, " n"]
Wanted: TypeAlias = tuple[str, int, list[MemberLocation]]
"""Shard, number in it, and members of a sample."""


class naming_place:  # noqa: N801 -- a context manager, named as functions are
    """Add shard and sample to errors about a member."""

    # A class: entered for every garment, where a generator would take several times as long.
    __slots__ = ("_place",)

    def __init__(self, place: Callable[[], str]) -> None:
        self._place = place

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ShardError) and str(error).startswith("member "):
            raise ShardError(f"{self._place()}, {error}") from error


class ShardReader:
    """The samples of one split, of one ``layout``, in the order of their indices; in a folder, or any other store.

    ``verify``: ``lazy`` checks a member's CRC-32 the first time that this process reads it, ``full`` checks all of them
    at once, ``off`` none. ``settled_only`` leaves out samples that are not draped, or did not settle. May be pickled,
    forked, and read from several threads.

    Raises ``ShardError`` for a folder without the split, or with a broken, foreign or incomplete one.
    """

    def __init__(
        self,
        where: Path | str | Store,
        split: str = "train",
        *,
        layout: Layout = GARMENTS,
        verify: Verify = "lazy",
        settled_only: bool = False,
    ) -> None:
        if verify not in get_args(Verify):
            raise ConfigError(f"verify={verify!r}: there is {', '.join(get_args(Verify))}")
        self.store = where if isinstance(where, Store) else FolderStore(where)
        self.split, self._verify = split, verify
        self.manifest = self.store.manifest()
        self.index = self.store.index(split, layout)
        self.layout = self.index.layout
        # A shard that was filled out of order, or a foreign one, need not be in the order of its numbers.
        order = np.argsort(self.index.table.sample, kind="stable")
        self._row = order[self.index.table.settled[order]] if settled_only else order
        if not len(self._row):
            there = f"none of the {len(order)} samples of split {split} has settled"
            raise ShardError(f"{self.store.place()}: {there}: leave out settled_only, or make garments that are draped")
        self._first = np.searchsorted(self.index.shard, np.arange(len(self.index.shards))).tolist()
        self._columns_of: dict[tuple[str, ...], list[int]] = {}
        self._unchecked = self._all_unchecked()
        if verify == "full":
            for position in range(len(self)):
                self.read(position, self.layout.members)

    def __len__(self) -> int:
        return len(self._row)

    def rows(self, positions: Iterable[int]) -> Rows:
        """The rows of ``index`` that hold samples."""
        return self._row[np.fromiter(positions, np.int64)]

    def read(self, position: int, members: Iterable[str]) -> dict[str, memoryview]:
        """The content of some members of a sample, writable and the caller's own.

        Raises ``ShardError`` with shard, key and member for a byte that is not what was written.
        """
        return next(self.read_many([position], members))

    def read_many(self, positions: Iterable[int], members: Iterable[str]) -> Iterator[dict[str, memoryview]]:
        """As ``read``, for several samples: a server is asked for all of them at once, a folder for one by one."""
        rows, columns = self.rows(positions), self._columns(tuple(members))
        wanted = self._parts(rows, columns)
        return self._checked(rows, columns, wanted, self.store.read_many(wanted))

    def number(self, position: int) -> int:
        """The index that a sample was written under."""
        return int(self.index.table.sample[self._row[position]])

    def naming(self, position: int) -> "naming_place":
        """A context in which errors about a member of a sample name shard and sample too."""
        return naming_place(lambda: self._named(int(self._row[position])))

    def sample(self, position: int) -> Sample:
        """A garment with everything that is stored of it.

        Raises ``ShardError`` with shard and key for a damaged one, ``ConfigError`` where some members are not there.
        """
        first = FIRST_NAMES if self.layout.schema == 1 else {}
        members = dict.fromkeys([*(first.get(member, member) for member in MEMBERS), *self.layout.members])
        with self.naming(position):
            return decode_sample(self.read(position, members))

    def _named(self, row: int) -> str:
        return f"{self.store.place(self.index.shards[self.index.shard[row]])}: sample {self.index.key(row)}"

    def check(self, position: int) -> None:
        """Raise ``ShardError`` if any byte of a sample is not what was written."""
        rows = self._row[[position]]
        for column, data in self.store.read(*self._parts(rows, self._columns(self.layout.members))[0]).items():
            self._require_same(int(rows[0]), column, data)
            if column == META:
                self._require_own(int(rows[0]), data)

    def _columns(self, members: tuple[str, ...]) -> list[int]:
        """Columns of members, in the order of the file. Raises ``ConfigError`` for one that the samples lack."""
        if members not in self._columns_of:
            if lacking := [member for member in members if member not in self.layout.members]:
                raise ConfigError(
                    f"{self.store.place()}: its samples have no {lacking[0]}: give a data set with all of their files"
                )
            self._columns_of[members] = sorted({self.layout.members.index(member) for member in members})
        return self._columns_of[members]

    def _parts(self, rows: Rows, columns: list[int]) -> list[Wanted]:
        """Shard, number in it, and members of each sample, in the order of the file."""
        table, shards = self.index.table, self.index.shard[rows].tolist()
        # All at once: an array takes as long to give up one row as a hundred.
        offset, size, crc = (array[rows].take(columns, 1).tolist() for array in (table.offset, table.size, table.crc))
        parts = [list(map(MemberLocation, columns, *entry)) for entry in zip(offset, size, crc, strict=True)]
        if self.layout.kind == FOREIGN:  # a sample may lack what others have, and be in another order
            parts = [sorted((part for part in row if part.offset >= 0), key=lambda part: part.offset) for row in parts]
        return [
            (self.index.shards[shard], row - self._first[shard], entry)
            for row, shard, entry in zip(rows.tolist(), shards, parts, strict=True)
        ]

    def _checked(
        self, rows: Rows, columns: list[int], wanted: Sequence[Wanted], content: Iterable[dict[int, memoryview]]
    ) -> Iterator[dict[str, memoryview]]:
        """Member to content of each sample, after a look at what has not been looked at."""
        members = self.layout.members
        # As it was before: of a sample that is asked for twice, both copies may have been read damaged.
        unchecked = self._unchecked[rows]
        first = unchecked.take(columns, 1).any(axis=1).tolist()
        for row, is_first, which, parts, sample in zip(rows.tolist(), first, unchecked, wanted, content, strict=True):
            if is_first:
                self._check_first(row, which, parts, sample)
            yield {members[column]: data for column, data in sample.items()}

    def _check_first(
        self, row: int, unchecked: Bool[np.ndarray, " m"], wanted: Wanted, content: dict[int, memoryview]
    ) -> None:
        """Verify unchecked members; fetch damaged ones again."""
        shard, number, parts = wanted
        for part in parts:
            if unchecked[part.column]:
                if zlib.crc32(content[part.column]) != part.crc:
                    content[part.column] = self.store.mend(shard, number, part) or content[part.column]
                self._require_same(row, part.column, content[part.column])
                if part.column == META:
                    self._require_own(row, content[part.column])

    def _require_own(self, row: int, meta: memoryview) -> None:
        """Raise ``ShardError`` for a ``meta.json`` of another sample than the index tells."""
        if self.layout.kind != FOREIGN and index_told(meta) != self.index.table.sample[row]:
            shard = self.index.shards[self.index.shard[row]]
            raise ShardError(
                f"{self.store.place(shard)}: sample {index_told(meta)} where the index has {self.index.key(row)}: "
                "delete the index, it is made again from the shards"
            )

    def _require_same(self, row: int, column: int, data: memoryview) -> None:
        if zlib.crc32(data) != self.index.table.crc[row, column]:
            raise ShardError(
                f"{self._named(row)}, member {self.layout.members[column]}: bytes differ from those that were written: "
                f"{self.store.remedy}"
            )
        self._unchecked[row, column] = False

    def _all_unchecked(self) -> Bool[np.ndarray, "n m"]:
        return np.full(self.index.table.crc.shape, self._verify != "off")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_unchecked": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._unchecked = self._all_unchecked()
