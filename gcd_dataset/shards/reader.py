"""Reads samples of a split by position: only the requested members, with their CRC-32 checked."""

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
from gcd_dataset.shards.index import GRADES
from gcd_dataset.shards.layout import FOREIGN, GARMENTS, MEMBERS, Layout
from gcd_dataset.shards.meta import read_sample_index
from gcd_dataset.shards.store import MemberLocation, Store

__all__ = ["Quality", "ShardReader", "Verify", "naming_sample"]

META = 0  # column of meta.json in our layouts
Verify = Literal["lazy", "full", "off"]
Quality = Literal["clean", "paper"]
Rows: TypeAlias = Int[np.ndarray, " n"]
Request: TypeAlias = tuple[str, int, list[MemberLocation]]
"""Shard, number of a sample in it, and the locations of the requested members."""


class naming_sample:  # noqa: N801 -- a context manager, named as functions are
    """Context that prefixes errors about a member with its shard and sample; ``name`` returns that prefix."""

    # A class, since it is entered for every garment: ``contextlib.contextmanager`` takes several times as long.
    __slots__ = ("_name",)

    def __init__(self, name: Callable[[], str]) -> None:
        self._name = name

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ShardError) and str(error).startswith("member "):
            raise ShardError(f"{self._name()}, {error}") from error


class ShardReader:
    """The samples of one split of a folder or another store, in the order of their indices.

    ``verify``: ``lazy`` checks a member's CRC-32 the first time that this process reads it, ``full`` checks all members
    on opening, ``off`` none. ``settled_only`` leaves out samples without a drape, or with one that did not settle.
    ``quality`` leaves out samples of a lower grade. May be pickled, forked, and read from several threads.

    Raises ``ShardError`` where the split is missing, broken, incomplete, or of another layout.
    """

    def __init__(
        self,
        where: Path | str | Store,
        split: str = "train",
        *,
        layout: Layout = GARMENTS,
        verify: Verify = "lazy",
        settled_only: bool = False,
        quality: Quality | None = None,
    ) -> None:
        if quality is not None and quality not in get_args(Quality):
            raise ConfigError(
                f"quality={quality!r:.99}: choose from {', '.join(get_args(Quality))}, or None for all samples"
            )
        if verify not in get_args(Verify):
            raise ConfigError(f"verify={verify!r}: choose from {', '.join(get_args(Verify))}")
        self.store = where if isinstance(where, Store) else FolderStore(where)
        self.split, self._verify = split, verify
        self.manifest = self.store.manifest()
        self.index = self.store.index(split, layout)
        self.layout = self.index.layout
        # Samples of shards filled out of order, and of foreign tars, may not be sorted by index.
        order = np.argsort(self.index.table.sample, kind="stable")
        self._row = order[self.index.table.settled[order]] if settled_only else order
        self._require_rows(f"none of the {len(order)} samples of split {split} has settled", "settled_only")
        if quality is not None:
            self._row = self._row[self.index.table.grade[self._row] >= GRADES.index(quality)]
            self._require_rows(f"none of the {len(order)} samples of split {split} has the grade {quality}", "quality")
        self._first = np.searchsorted(self.index.shard, np.arange(len(self.index.shards))).tolist()
        self._columns_of: dict[tuple[str, ...], list[int]] = {}
        self._unchecked = self._all_unchecked()
        if verify == "full":
            for position in range(len(self)):
                self.read(position, self.layout.members)

    def __len__(self) -> int:
        return len(self._row)

    def rows(self, positions: Iterable[int]) -> Rows:
        """The rows of ``index`` for positions."""
        return self._row[np.fromiter(positions, np.int64)]

    def read(self, position: int, members: Iterable[str]) -> dict[str, memoryview]:
        """Member to content, in buffers that the caller owns and may write to.

        Raises ``ShardError`` with shard, key and member for a CRC-32 mismatch.
        """
        return next(self.read_many([position], members))

    def read_many(self, positions: Iterable[int], members: Iterable[str]) -> Iterator[dict[str, memoryview]]:
        """As ``read``, for several samples; a remote store requests them in parallel."""
        rows, columns = self.rows(positions), self._columns(tuple(members))
        requests = self._requests(rows, columns)
        return self._checked(rows, columns, requests, self.store.read_many(requests))

    def number(self, position: int) -> int:
        """The index of the sample at a position."""
        return int(self.index.table.sample[self._row[position]])

    def naming(self, position: int) -> "naming_sample":
        """A context in which errors about a member also name shard and sample."""
        return naming_sample(lambda: self._named(int(self._row[position])))

    def sample(self, position: int) -> Sample:
        """A garment with all its members.

        Raises ``ShardError`` naming shard and key for a damaged garment, ``ConfigError`` if the split lacks members.
        """
        members = dict.fromkeys([*MEMBERS, *self.layout.members])
        with self.naming(position):
            return decode_sample(self.read(position, members))

    def _require_rows(self, fault: str, option: str) -> None:
        """Raise ``ShardError`` where ``option`` has left no sample, with the reason."""
        if len(self._row):
            return
        table, remedy = self.index.table, f"leave out {option}, or make garments with a drape"
        record = None if self.manifest is None else self.manifest.splits.get(self.split)
        if not table.grade.any() and table.settled.any():
            remedy = f"leave out {option}, or make the garments again: samples of older versions have no grade"
        elif not table.grade.any():
            stage = "" if record is None or "stage" not in record.recipe else f"end with stage {record.recipe['stage']}"
            fault += f": they {stage or 'have no drapes'}, and only drapes settle and have a grade"
        raise ShardError(f"{self.store.location()}: {fault}: {remedy}")

    def _named(self, row: int) -> str:
        return f"{self.store.location(self.index.shards[self.index.shard[row]])}: sample {self.index.key(row)}"

    def check(self, position: int) -> None:
        """Check all members of a sample again. Raises ``ShardError`` for a CRC-32 mismatch."""
        rows = self._row[[position]]
        for column, data in self.store.read(*self._requests(rows, self._columns(self.layout.members))[0]).items():
            self._require_same(int(rows[0]), column, data)
            if column == META:
                self._require_index(int(rows[0]), data)

    def _columns(self, members: tuple[str, ...]) -> list[int]:
        """Columns of members in file order. Raises ``ConfigError`` for a member that the samples lack."""
        if members not in self._columns_of:
            if lacking := [member for member in members if member not in self.layout.members]:
                raise ConfigError(
                    f"{self.store.location()}: its samples have no {lacking[0]}: give a data set with all members"
                )
            self._columns_of[members] = sorted({self.layout.members.index(member) for member in members})
        return self._columns_of[members]

    def _requests(self, rows: Rows, columns: list[int]) -> list[Request]:
        """A request for each row, its members in file order."""
        table, shards = self.index.table, self.index.shard[rows].tolist()
        # Indexed once for all rows: indexing an array takes as long for one row as for a hundred.
        offset, size, crc = (array[rows].take(columns, 1).tolist() for array in (table.offset, table.size, table.crc))
        parts = [list(map(MemberLocation, columns, *entry)) for entry in zip(offset, size, crc, strict=True)]
        if self.layout.kind == FOREIGN:  # a sample may lack members, or have them in another order
            parts = [sorted((part for part in row if part.offset >= 0), key=lambda part: part.offset) for row in parts]
        return [
            (self.index.shards[shard], row - self._first[shard], entry)
            for row, shard, entry in zip(rows.tolist(), shards, parts, strict=True)
        ]

    def _checked(
        self, rows: Rows, columns: list[int], requests: Sequence[Request], content: Iterable[dict[int, memoryview]]
    ) -> Iterator[dict[str, memoryview]]:
        """Member to content of each sample, with unchecked members verified."""
        members = self.layout.members
        # Copied before the loop: a sample requested twice is read twice, and both reads are checked.
        unchecked = self._unchecked[rows]
        needs_check = unchecked.take(columns, 1).any(axis=1).tolist()
        for row, check, flags, request, sample in zip(
            rows.tolist(), needs_check, unchecked, requests, content, strict=True
        ):
            if check:
                self._check_unchecked(row, flags, request, sample)
            yield {members[column]: data for column, data in sample.items()}

    def _check_unchecked(
        self, row: int, unchecked: Bool[np.ndarray, " m"], request: Request, content: dict[int, memoryview]
    ) -> None:
        """Verify unchecked members; fetch damaged ones again."""
        shard, number, parts = request
        for part in parts:
            if unchecked[part.column]:
                if zlib.crc32(content[part.column]) != part.crc:
                    content[part.column] = self.store.refetch(shard, number, part) or content[part.column]
                self._require_same(row, part.column, content[part.column])
                if part.column == META:
                    self._require_index(row, content[part.column])

    def _require_index(self, row: int, meta: memoryview) -> None:
        """Raise ``ShardError`` where ``meta.json`` and its row of the index name different samples."""
        if self.layout.kind != FOREIGN and read_sample_index(meta) != self.index.table.sample[row]:
            shard = self.index.shards[self.index.shard[row]]
            raise ShardError(
                f"{self.store.location(shard)}: holds sample {read_sample_index(meta)} where the index has "
                f"{self.index.key(row)}: delete the index: it is rebuilt from the shards"
            )

    def _require_same(self, row: int, column: int, data: memoryview) -> None:
        if zlib.crc32(data) != self.index.table.crc[row, column]:
            raise ShardError(
                f"{self._named(row)}, member {self.layout.members[column]}: bytes differ from the written ones: "
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
