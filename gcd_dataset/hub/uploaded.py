"""What of a data set is in a store: by its manifest once all is there, before that by a note of each range of samples.

    train-00000.tar                  a shard, whole
    .unfinished/manifest.json        splits, seed and recipe, until all shards are there
    .unfinished/00000/…              manifest, indices and rejects of the samples of shard 0 of all splits, when they
                                     are there: as of a data set of them alone
    index-train.npz, rejects.jsonl   when all shards are there
    manifest.json                    last: readers ask for it first

A range is the samples of shard k of any split: those from ``k * shard_size`` to ``(k + 1) * shard_size - 1``.
"""

import logging
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from gcd_dataset.errors import ConfigError, MissingError, RefusedError, RemoteError, ShardError
from gcd_dataset.hub.objects import Objects
from gcd_dataset.shards.access import read_limited
from gcd_dataset.shards.index import ShardIndex, ShardTable
from gcd_dataset.shards.layout import FAILED, Layout, index_name, shard_name, shard_number
from gcd_dataset.shards.limits import LARGEST_FILE, LARGEST_MANIFEST
from gcd_dataset.shards.manifest import MANIFEST, Manifest, ShardRecord, SplitRecord, parse_manifest
from gcd_dataset.shards.origin import manifest_record_to_resume
from gcd_dataset.shards.rejects import REJECTS, merged_rejects

__all__ = ["UploadedDataset", "UploadedRange", "UploadedShard"]

R = TypeVar("R")

NOTES = ".unfinished"
LINES = 16  # requests at a time

log = logging.getLogger(__name__)


class UploadedShard(NamedTuple):
    """A shard that is in the store."""

    record: ShardRecord
    table: ShardTable


@dataclass(frozen=True)
class UploadedRange:
    """The samples of shard k of all splits, in the store."""

    shards: Mapping[str, UploadedShard]
    """By split."""
    rejects: bytes = b""
    """Lines of ``rejects.jsonl``; none of a range that the manifest tells of, whose lines are in that file."""

    @property
    def samples(self) -> frozenset[int]:
        """Indices of the samples."""
        return frozenset(index for shard in self.shards.values() for index in shard.table.sample.tolist())


class UploadedDataset:
    """A data set in a store. Raises ``RemoteError`` as ``Objects`` does, and for objects of others.

    ``asked``: split to how its samples are made, with one size of shards for all; raises ``ConfigError`` for a data set
    that is there and made otherwise.
    """

    def __init__(self, files: Objects, asked: Mapping[str, SplitRecord], layout: Layout) -> None:
        self.files, self._asked, self._layout = files, asked, layout
        (self.range_size,) = {record.shard_size for record in asked.values()}

    def sleeping_by(self, sleep: Callable[[float], object]) -> "UploadedDataset":
        """The same, which waits for the store by ``sleep``, until that gives true."""
        files = Objects(self.files.base, patience=self.files.patience, sleep=sleep)
        return UploadedDataset(files, self._asked, self._layout)

    @property
    def is_begun(self) -> bool:
        """Whether a run has begun, and none has finished since."""
        return self._manifest(f"{NOTES}/{MANIFEST}") is not None

    def begin(self) -> None:
        """Note how the data set is made, until ``publish``."""
        self.files.put(f"{NOTES}/{MANIFEST}", Manifest(dict(self._asked)).to_bytes())

    def wanted(self, number: int, count: int) -> range:
        """The samples below ``count`` in a range."""
        return range(number * self.range_size, min((number + 1) * self.range_size, count))

    def numbers(self, count: int) -> range:
        """The ranges that hold ``count`` samples."""
        return range(-(-count // self.range_size))

    def ranges(self, count: int) -> dict[int, UploadedRange]:
        """The ranges that are there as they were written, by number; notes are read of those of ``count`` samples."""
        found = self._published()
        if self.is_begun:
            lacking = [n for n in self.numbers(count) if n not in found or not self._holds(found[n], n, count)]
            # A note tells of at least as much as the manifest, which the run that wrote it has found.
            found |= {number: its for number, its in _side_by_side(self._noted, lacking).items() if its is not None}
        is_there = _side_by_side(lambda number: self._is_there(found[number]), found)
        return {number: its for number, its in found.items() if is_there[number]}

    def rejects(self) -> bytes:
        """The rejects of the data set that the manifest tells of."""
        try:
            return self.files.get(REJECTS, LARGEST_FILE)
        except MissingError:
            return b""

    def add(self, number: int, folder: Path) -> UploadedRange:
        """Store what a folder holds, which is a range alone, and the note of it. Raises ``ShardError`` for another."""
        names = [MANIFEST, REJECTS, *(index_name(split) for split in self._asked)]
        small = {name: read_limited(folder / name, LARGEST_FILE) for name in names if (folder / name).exists()}
        found = self._read(number, small, str(folder))
        for shard in found.shards.values():
            self.files.put_file(shard.record.name, folder / shard.record.name)
        for name in sorted(small, key=lambda name: name == MANIFEST):  # the manifest last
            self.files.put(f"{NOTES}/{number:05d}/{name}", small[name])
        return found

    def publish(self, ranges: Mapping[int, UploadedRange]) -> None:
        """Show the data set to readers: indices and rejects, then the manifest; notes go."""
        manifest = self._manifest(MANIFEST) or Manifest()
        for split, asked in self._asked.items():
            ordered = [its.shards[split] for _, its in sorted(ranges.items()) if split in its.shards]
            if not ordered and split == FAILED:
                continue
            tables = {shard.record.name: shard.table for shard in ordered}
            index = ShardIndex.joined(tables, [shard.record.size for shard in ordered], self._layout)
            self.files.put(index_name(split), index.to_bytes())
            there = manifest.splits.get(split, asked)
            manifest = manifest.with_split(split, replace(there, shards=tuple(shard.record for shard in ordered)))
        rejects = merged_rejects([self.rejects(), *(its.rejects for _, its in sorted(ranges.items()))])
        self.files.put(REJECTS, rejects)
        self.files.put(MANIFEST, manifest.to_bytes())
        try:
            self.files.remove(f"{NOTES}/")
        except RefusedError as error:
            log.warning("%s; all is there, and these notes of its making may stay", error)

    # --------------------------------------------------------------------------------------------------------- reading

    def _holds(self, found: UploadedRange, number: int, count: int) -> bool:
        return found.samples.issuperset(self.wanted(number, count))

    def _manifest(self, name: str) -> Manifest | None:
        """A manifest, if there is one, of the schema that is written and of splits made as asked."""
        place = self.files.address(name)
        try:
            content = self.files.get(name, LARGEST_MANIFEST)
        except MissingError:
            return None
        return self._agreed(content, place)

    def _agreed(self, content: bytes, place: str) -> Manifest:
        manifest = parse_manifest(content, place, "remove it, or choose another URL")
        if manifest.schema != self._layout.schema:
            raise ConfigError(
                f"{place}: of schema {manifest.schema}, and schema {self._layout.schema} is written: make more at "
                "another URL"
            )
        if manifest.recipe is not None:
            raise ConfigError(f"{place}: the data set {manifest.recipe.name}: choose another URL")
        for split, asked in self._asked.items():
            manifest_record_to_resume(manifest, place, split, asked)
        return manifest

    def _published(self) -> dict[int, UploadedRange]:
        """The ranges that manifest and indices tell of, by number."""
        manifest = self._manifest(MANIFEST)
        found: dict[int, dict[str, UploadedShard]] = {}
        for split in self._asked:
            if manifest is None or split not in manifest.splits:
                continue
            name = index_name(split)
            place, content = self.files.address(name), self.files.get(name, LARGEST_FILE)
            index = ShardIndex.parse(content, place, self._layout, remedy="remove it and the manifest, start again")
            for shard in _shards(manifest, split, index, place):
                found.setdefault(_number(shard.record.name, split), {})[split] = shard
        return {number: UploadedRange(shards) for number, shards in found.items()}

    def _noted(self, number: int) -> UploadedRange | None:
        """The range that a note tells of, if there is one."""
        folder = f"{NOTES}/{number:05d}"
        try:
            small = {MANIFEST: self.files.get(f"{folder}/{MANIFEST}", LARGEST_MANIFEST)}
        except MissingError:
            return None
        manifest = self._agreed(small[MANIFEST], self.files.address(f"{folder}/{MANIFEST}"))
        for name in (REJECTS, *(index_name(split) for split in manifest.splits)):
            small[name] = self.files.get(f"{folder}/{name}", LARGEST_FILE)
        return self._read(number, small, self.files.address(folder))

    def _read(self, number: int, small: Mapping[str, bytes], place: str) -> UploadedRange:
        """What manifest, indices and rejects tell of one range."""
        manifest = self._agreed(small[MANIFEST], f"{place}/{MANIFEST}")
        shards = {}
        for split in manifest.splits:
            index = ShardIndex.parse(small[index_name(split)], f"{place}/{index_name(split)}", self._layout)
            for shard in _shards(manifest, split, index, place):
                if split not in self._asked or shard.record.name != shard_name(split, number):
                    raise ShardError(f"{place}: tells of {shard.record.name}, in the note of range {number}: remove it")
                shards[split] = shard
        return UploadedRange(shards, small.get(REJECTS, b""))

    def _is_there(self, found: UploadedRange) -> bool:
        """Whether the shards of a range are objects of the length that they had."""
        try:
            return all(self.files.size(shard.record.name) == shard.record.size for shard in found.shards.values())
        except MissingError:
            return False


def _shards(manifest: Manifest, split: str, index: ShardIndex, place: str) -> list[UploadedShard]:
    """The shards of a split. Raises ``RemoteError`` where manifest and index tell of others."""
    tables = index.tables()
    for record in manifest.splits[split].shards:
        if record.name not in tables or len(tables[record.name]) != record.count:
            raise RemoteError(f"{place}: tells of other shards than {MANIFEST}: remove both, and start again")
    return [UploadedShard(record, tables[record.name]) for record in manifest.splits[split].shards]


def _number(name: str, split: str) -> int:
    number = shard_number(name, split)
    assert number is not None  # by the manifest's own check
    return number


def _side_by_side(ask: Callable[[int], R], numbers: Iterable[int]) -> dict[int, R]:
    """What each number brings, some of them at a time."""
    ordered = sorted(numbers)
    with ThreadPoolExecutor(LINES) as pool:
        return dict(zip(ordered, pool.map(ask, ordered), strict=True))
