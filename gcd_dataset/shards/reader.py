"""Reads samples of a split by position, and checks them when they are first read."""

import contextlib
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.records import Sample
from gcd_dataset.shards.codec import PATTERN_FIELDS, decode_sample, patterns_of
from gcd_dataset.shards.index import GRADES
from gcd_dataset.shards.layout import BODIES, GARMENTS, META, Bytes, Layout, fields_of, is_picture, key_of
from gcd_dataset.shards.manifest import ShardRecord
from gcd_dataset.shards.meta import checked_meta
from gcd_dataset.shards.store import FolderStore, Store
from gcd_dataset.shards.tar import BLOCK, END, samples_in
from gcd_dataset.tensors import PatternTensor

BATCH = 256  # samples in one read of ``stored_patterns``
MAIN, VIEWS = 1, 2  # bits of the tars of a sample that were checked
Verify = Literal["lazy", "full", "off"]
Quality = Literal["clean", "paper"]


@contextlib.contextmanager
def naming_sample(name: Callable[[], str]) -> Iterator[None]:
    """Prefix errors about a member with its shard and sample, which ``name`` returns."""
    try:
        yield
    except ShardError as error:
        if str(error).startswith("member "):
            raise ShardError(f"{name()}, {error}") from error
        raise


class ShardReader:
    """The samples of one split of a folder or another store, in the order of the shards.

    ``verify``: ``lazy`` checks a sample the first time that this process reads it, ``full`` all samples on opening,
    ``off`` none. A check compares the CRC-32 of every member with that in ``meta.json``, the seal of ``meta.json``, and
    the key with the index. ``settled_only`` leaves out samples without a drape, or with one that did not settle.
    ``quality`` leaves out samples of a lower grade. May be pickled, forked, and read from several threads.

    Raises ``ShardError`` where the split is missing, broken, or of another kind than ``layout``.
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
        self.index = self.store.index(split)
        self.record = self.index.record
        self._require_kind(layout)
        self.layout = layout.of(self.record.members)
        self._first = self.index.first
        self._wanted: tuple[bool, Quality | None] = settled_only, quality
        self._row = self._chosen()
        self._checked = self._unchecked()
        if verify == "full":
            for position in range(len(self)):
                self.check(position)

    def __len__(self) -> int:
        return len(self._row)

    def rows(self, positions: Sequence[int] | Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """The rows of ``index`` for positions."""
        return self._row[np.asarray(positions, np.int64)]

    def number(self, position: int) -> int:
        """The index of the sample at a position."""
        return int(self.index.number[self._row[position]])

    def key(self, position: int) -> str:
        """The name of the sample at a position."""
        return key_of(self.number(position))

    def naming(self, position: int) -> AbstractContextManager[None]:
        """A context in which errors about a member also name shard and sample."""
        return naming_sample(lambda: self._named(int(self._row[position])))

    def read(self, position: int, members: Iterable[str]) -> dict[str, memoryview]:
        """Member to content, in buffers that the caller owns and may write to.

        Raises ``ShardError`` with shard, key and member for a damaged sample, ``ConfigError`` for a member that the
        samples lack.
        """
        return next(self.read_many([position], members))

    def read_many(self, positions: Iterable[int], members: Iterable[str]) -> Iterator[dict[str, memoryview]]:
        """As ``read``, for several samples; a remote store requests them in parallel."""
        wanted = dict.fromkeys(members)
        if lacking := [member for member in wanted if member not in self.layout.members]:
            raise ConfigError(
                f"{self.store.location()}: its samples have no {lacking[0]}: give a data set with all members"
            )
        rows = self.rows(list(positions)).tolist()
        tars = [tar for tar in (False, True) if any(is_picture(member) is tar for member in wanted)]
        mask = sum(VIEWS if tar else MAIN for tar in tars)
        parts = iter(self.store.parts(self.split, [(*self._span(row, tar), tar) for row in rows for tar in tars]))
        for row in rows:
            found: dict[str, memoryview] = {}
            for _ in tars:
                found |= self._members(row, next(parts))
            if mask & ~self._checked[row]:
                self._check(row, found)
                self._checked[row] |= mask
            if lost := [member for member in wanted if member not in found]:
                raise self._fault(row, f": no member {lost[0]}")
            yield {member: found[member] for member in wanted}

    def sample(self, position: int) -> Sample:
        """A garment with all its members.

        Raises ``ShardError`` naming shard and key for a damaged garment, ``ConfigError`` if the split lacks members.
        """
        with self.naming(position):
            return decode_sample(self.read(position, self.layout.members))

    def check(self, position: int) -> None:
        """Check a whole sample, even if it was checked before. Raises ``ShardError``."""
        self._checked[self._row[position]] = 0
        self.read(position, self.layout.members)

    def _unchecked(self) -> bytearray:
        """The bits of the tars of each sample that need no check."""
        return bytearray([MAIN | VIEWS if self._verify == "off" else 0]) * len(self.index)

    def _chosen(self) -> Int[np.ndarray, " n"]:
        settled_only, quality = self._wanted
        rows, count = np.arange(len(self.index), dtype=np.int32), len(self.index)
        if settled_only:
            rows = rows[self.index.settled]
        self._require(rows, f"none of the {count} samples of split {self.split} has settled", "settled_only")
        if quality is not None:
            rows = rows[self.index.grade[rows] >= GRADES.index(quality)]
        self._require(rows, f"none of the {count} samples of split {self.split} has the grade {quality}", "quality")
        return rows

    def _require(self, rows: Sequence[int] | np.ndarray, fault: str, option: str) -> None:
        """Raise ``ShardError`` where ``option`` has left no sample, with the reason."""
        if len(rows):
            return
        if not self.index.outcome.any():
            stage = self.record.plan.recipe.get("stage")
            fault += f": they {f'end with stage {stage}' if stage else 'have no drapes'}, and only drapes settle and "
            fault += "have a grade"
        remedy = f"leave out {option}, or make garments with a drape"
        raise ShardError(f"{self.store.location()}: {fault}: {remedy}")

    def _require_kind(self, layout: Layout) -> None:
        kind = self.record.plan.kind
        if kind != layout.kind:
            known = {one.kind: one.reader for one in (GARMENTS, BODIES)}
            remedy = f"read them with {known[kind]}" if kind in known else "update gcd_dataset"
            raise ShardError(f"{self.store.location()}: holds {kind}, not {layout.kind}: {remedy}")

    def _named(self, row: int) -> str:
        shard, _, _ = self._span(row, False)
        return f"{self.store.location(shard.name(self.split))}: sample {key_of(int(self.index.number[row]))}"

    def _fault(self, row: int, fault: str) -> ShardError:
        return ShardError(f"{self._named(row)}{fault}: {self.store.remedy}")

    def _span(self, row: int, views: bool) -> tuple[ShardRecord, int, int]:
        """The shard of a sample, and its first and last byte in the tar, or in that of the pictures."""
        number = int(np.searchsorted(self._first, row, side="right")) - 1
        shard, blocks = self.record.shards[number], self.index.views_blocks if views else self.index.blocks
        is_last = row + 1 == self._first[number + 1]
        end = (shard.views_size if views else shard.size) - END if is_last else int(blocks[row + 1]) * BLOCK
        return shard, int(blocks[row]) * BLOCK, end

    def _members(self, row: int, data: Bytes) -> dict[str, memoryview]:
        """Member to content of a sample, from its part of a tar. Raises ``ShardError``."""
        view = memoryview(data) if isinstance(data, memoryview | bytearray) else memoryview(bytearray(data))
        try:
            [(key, members)] = samples_in(view)
        except (ShardError, ValueError) as error:
            raise self._fault(row, f": damaged ({error})") from error
        if key != key_of(int(self.index.number[row])):
            fault = f": {key} lies there: the data set has changed since it was opened, or this shard is damaged"
            raise self._fault(row, fault)
        return members

    def _check(self, row: int, found: dict[str, memoryview]) -> None:
        """Compare the members with the checksums in ``meta.json``. Raises ``ShardError``."""
        if META not in found:  # the pictures alone were requested
            shard, start, end = self._span(row, False)
            main = self._members(row, self.store.part(self.split, shard, start, end))
            found = {**found, META: main.get(META, memoryview(b""))}
        try:
            checked_meta(found, int(self.index.number[row]))
        except ShardError as error:
            raise self._fault(row, f", {error}") from error

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_checked": None, "_row": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._checked, self._row = self._unchecked(), self._chosen()


def stored_patterns(
    reader: ShardReader, of: Container[int] | None = None
) -> Iterator[tuple[int, *tuple[PatternTensor, ...]]]:
    """Index and pattern, or patterns of the outfit, of each sample in order; ``of``: indices to read, by default all.

    Raises ``ShardError`` naming shard and sample for a damaged sample, ``ConfigError`` for samples without patterns.
    """
    if missing := [field for field in PATTERN_FIELDS if field not in fields_of(reader.layout.members)]:
        raise ConfigError(
            f"{reader.store.location()}: its samples have no {missing[0]}: give a data set with all fields"
        )
    needed = [member for member in reader.layout.members if member == META or member.endswith("pattern.z")]
    wanted = [position for position in range(len(reader)) if of is None or reader.number(position) in of]
    for first in range(0, len(wanted), BATCH):
        positions = wanted[first : first + BATCH]
        for position, members in zip(positions, reader.read_many(positions, needed), strict=True):
            with reader.naming(position):
                yield reader.number(position), *patterns_of(members)
