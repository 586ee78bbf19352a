"""The shards of a split that are in a store: as the manifest tells once all are, before that as a note of each does.

train-00000.tar                         a shard, whole
.unfinished-train/manifest.json         seed and recipe, until all shards are up
.unfinished-train/00000/…               manifest and index of one shard that is up, as of a data set of it alone
index-train.npz, manifest.json          last: readers ask for the manifest first
"""

import logging
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from gcd_dataset.errors import ConfigError, MissingError, RefusedError, RemoteError, ShardError
from gcd_dataset.hub.objects import Objects
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import read_small
from gcd_dataset.shards.index import ShardIndex, ShardTable
from gcd_dataset.shards.layout import Layout, index_name, shard_name, shard_number
from gcd_dataset.shards.limits import LARGEST_FILE, LARGEST_MANIFEST
from gcd_dataset.shards.manifest import MANIFEST, Manifest, ShardRecord, SplitRecord, parse_manifest
from gcd_dataset.shards.origin import agreed_with

__all__ = ["Uploaded", "UploadedShard"]

R = TypeVar("R")

LINES = 16  # requests at a time

log = logging.getLogger(__name__)


class UploadedShard(NamedTuple):
    """A shard that is in the store."""

    record: ShardRecord
    table: ShardTable

    def holds(self, samples: Iterable[int]) -> bool:
        """Whether all of these samples are in it."""
        return set(samples) <= set(self.table.sample.tolist())


class Uploaded:
    """The shards of one split in a store. Raises ``RemoteError`` as ``Objects`` does, and for objects of others.

    ``asked``: how the split is made; raises ``ConfigError`` for one that is there and made otherwise.
    """

    def __init__(self, files: Objects, split: str, layout: Layout, asked: SplitRecord) -> None:
        self.files, self._split, self._layout, self._asked = files, split, layout, asked
        self._notes = f".unfinished-{require_name(split, 'split')}"

    @property
    def is_begun(self) -> bool:
        """Whether a run has begun, and none has finished since."""
        return self._manifest(f"{self._notes}/{MANIFEST}") is not None

    def begin(self) -> None:
        """Note how the split is made, until ``publish``."""
        begun = Manifest().with_split(self._split, replace(self._asked, shards=()))
        self.files.put(f"{self._notes}/{MANIFEST}", begun.to_bytes())

    def wanted(self, number: int, count: int) -> range:
        """The samples below ``count`` that belong into a shard."""
        size = self._asked.shard_size
        return range(number * size, min((number + 1) * size, count))

    def shards(self, count: int) -> dict[int, UploadedShard]:
        """The shards that are there as they were written, by number; notes are read of those of ``count`` samples."""
        found = self._published()
        if self.is_begun:
            numbers = range(-(-count // self._asked.shard_size))
            lacking = [n for n in numbers if n not in found or not found[n].holds(self.wanted(n, count))]
            # A note tells of at least as much as the manifest, which the run that wrote it has found.
            found |= {n: shard for n, shard in _side_by_side(self._noted, lacking).items() if shard is not None}
        sizes = _side_by_side(self._size, found)
        return {number: shard for number, shard in found.items() if sizes[number] == shard.record.size}

    def add(self, number: int, folder: Path) -> UploadedShard:
        """Store the shard of a folder that holds it alone, and the note of it. Raises ``ShardError`` for another."""
        name, index = shard_name(self._split, number), index_name(self._split)
        manifest, table = read_small(folder / MANIFEST, LARGEST_MANIFEST), read_small(folder / index, LARGEST_FILE)
        shard = self._read(number, manifest, table, str(folder))
        self.files.put_file(name, folder / name)
        self.files.put(f"{self._notes}/{number:05d}/{index}", table)
        self.files.put(f"{self._notes}/{number:05d}/{MANIFEST}", manifest)
        return shard

    def publish(self, shards: Mapping[int, UploadedShard]) -> None:
        """Show the split to readers: its index, then the manifest; notes go."""
        ordered = [shards[number] for number in sorted(shards)]
        tables = {shard.record.name: shard.table for shard in ordered}
        index = ShardIndex.joined(tables, [shard.record.size for shard in ordered], self._layout)
        manifest = self._manifest(MANIFEST) or Manifest()
        there = manifest.splits.get(self._split, self._asked)
        record = replace(there, shards=tuple(shard.record for shard in ordered))
        self.files.put(index_name(self._split), index.to_bytes())
        self.files.put(MANIFEST, manifest.with_split(self._split, record).to_bytes())
        try:
            self.files.remove(f"{self._notes}/")
        except RefusedError as error:
            log.warning("%s; all is there, and these notes of its making may stay", error)

    # --------------------------------------------------------------------------------------------------------- reading

    def _manifest(self, name: str) -> Manifest | None:
        """A manifest, if there is one, of the schema that is written and of a split made as asked."""
        place = self.files.address(name)
        try:
            manifest = parse_manifest(self.files.get(name, LARGEST_MANIFEST), place, "remove it, or choose another URL")
        except MissingError:
            return None
        if manifest.schema != self._layout.schema:
            raise ConfigError(
                f"{place}: of schema {manifest.schema}, and schema {self._layout.schema} is written: make more at "
                "another URL"
            )
        if manifest.recipe is not None:
            raise ConfigError(f"{place}: the data set {manifest.recipe.name}: choose another URL")
        agreed_with(manifest, place, self._split, self._asked)
        return manifest

    def _published(self) -> dict[int, UploadedShard]:
        """The shards in the manifest and the index, by number."""
        manifest, name = self._manifest(MANIFEST), index_name(self._split)
        if manifest is None or self._split not in manifest.splits:
            return {}
        place = self.files.address(name)
        index = ShardIndex.parse(
            self.files.get(name, LARGEST_FILE), place, self._layout, remedy="remove it and the manifest, start again"
        )
        tables, found = index.tables(), {}
        for record in manifest.splits[self._split].shards:
            if record.name not in tables or len(tables[record.name]) != record.count:
                raise RemoteError(f"{place}: tells of other shards than {MANIFEST}: remove both, and start again")
            found[_number(record.name, self._split)] = UploadedShard(record, tables[record.name])
        return found

    def _noted(self, number: int) -> UploadedShard | None:
        """The shard that a note tells of, if there is one."""
        folder = f"{self._notes}/{number:05d}"
        try:
            manifest = self.files.get(f"{folder}/{MANIFEST}", LARGEST_MANIFEST)
            index = self.files.get(f"{folder}/{index_name(self._split)}", LARGEST_FILE)
        except MissingError:
            return None
        return self._read(number, manifest, index, self.files.address(folder))

    def _read(self, number: int, manifest: bytes, index: bytes, place: str) -> UploadedShard:
        """What manifest and index tell of one shard."""
        told = parse_manifest(manifest, f"{place}/{MANIFEST}")
        agreed_with(told, f"{place}/{MANIFEST}", self._split, self._asked)
        table = ShardIndex.parse(index, f"{place}/{index_name(self._split)}", self._layout).table
        records = told.splits[self._split].shards if self._split in told.splits else ()
        if [(shard.name, shard.count) for shard in records] != [(shard_name(self._split, number), len(table))]:
            raise ShardError(f"{place}: tells of another shard than {shard_name(self._split, number)}: remove it")
        return UploadedShard(records[0], table)

    def _size(self, number: int) -> int | None:
        try:
            return self.files.size(shard_name(self._split, number))
        except MissingError:
            return None


def _number(name: str, split: str) -> int:
    number = shard_number(name, split)
    assert number is not None  # by the manifest's own check
    return number


def _side_by_side(ask: Callable[[int], R], numbers: Iterable[int]) -> dict[int, R]:
    """What each number brings, some of them at a time."""
    ordered = sorted(numbers)
    with ThreadPoolExecutor(LINES) as pool:
        return dict(zip(ordered, pool.map(ask, ordered), strict=True))
