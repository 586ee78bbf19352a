"""A data set in an object store during and after its upload.

    train-00000.tar                  a finished shard
    .unfinished/manifest.json        splits, seed and recipe, until the upload is complete
    .unfinished/00000/…              note of range 0: manifest, indices and rejects, as in a data set of this range
    index-train.npz, rejects.jsonl   written once all shards are uploaded
    manifest.json                    written last: readers ask for it first

Range k holds the samples of shard k of all splits: ``k * shard_size`` to ``(k + 1) * shard_size - 1``.
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
PARALLEL_REQUESTS = 16

log = logging.getLogger(__name__)


class UploadedShard(NamedTuple):
    """A shard in the store."""

    record: ShardRecord
    table: ShardTable


@dataclass(frozen=True)
class UploadedRange:
    """The shards of one range in the store."""

    shards: Mapping[str, UploadedShard]
    """Split to shard."""
    rejects: bytes = b""
    """Lines of ``rejects.jsonl`` in the note; empty for a published range: its lines are in the published file."""

    @property
    def samples(self) -> frozenset[int]:
        """Indices of the samples."""
        return frozenset(index for shard in self.shards.values() for index in shard.table.sample.tolist())


class UploadedDataset:
    """A data set in an object store.

    ``requested``: split to its record, all of one shard size. Methods raise ``RemoteError`` as ``Objects`` does, and
    for contradictory files; ``ConfigError`` where the store holds a data set of another seed or recipe.
    """

    def __init__(self, files: Objects, requested: Mapping[str, SplitRecord], layout: Layout) -> None:
        self.files, self._requested, self._layout = files, requested, layout
        (self.range_size,) = {record.shard_size for record in requested.values()}

    def with_sleep(self, sleep: Callable[[float], object]) -> "UploadedDataset":
        """A copy that calls ``sleep`` between attempts, and stops trying when it returns true."""
        files = Objects(self.files.base, patience=self.files.patience, sleep=sleep)
        return UploadedDataset(files, self._requested, self._layout)

    @property
    def is_begun(self) -> bool:
        """Whether an upload has begun and is not yet complete."""
        return self._manifest(f"{NOTES}/{MANIFEST}") is not None

    def begin(self) -> None:
        """Write the manifest of the upload, which ``publish`` removes."""
        self.files.put(f"{NOTES}/{MANIFEST}", Manifest(dict(self._requested)).to_bytes())

    def wanted(self, number: int, count: int) -> range:
        """Indices below ``count`` in range ``number``."""
        return range(number * self.range_size, min((number + 1) * self.range_size, count))

    def numbers(self, count: int) -> range:
        """Numbers of the ranges of ``count`` samples."""
        return range(-(-count // self.range_size))

    def ranges(self, count: int) -> dict[int, UploadedRange]:
        """Number to range, for ranges with all shards in the store at their recorded sizes.

        During an upload the notes of the ranges of ``count`` samples are read too.
        """
        found = self._published()
        if self.is_begun:
            lacking = [n for n in self.numbers(count) if n not in found or not self._holds(found[n], n, count)]
            # A note lists at least the samples of the published range, since its run continued from them.
            noted = _run_parallel(self._noted_range, lacking)
            found |= {number: uploaded for number, uploaded in noted.items() if uploaded is not None}
        is_stored = _run_parallel(lambda number: self._is_stored(found[number]), found)
        return {number: uploaded for number, uploaded in found.items() if is_stored[number]}

    def rejects(self) -> bytes:
        """The published ``rejects.jsonl``."""
        try:
            return self.files.get(REJECTS, LARGEST_FILE)
        except MissingError:
            return b""

    def add(self, number: int, folder: Path) -> UploadedRange:
        """Upload the folder of a range: shards, then the note. Raises ``ShardError`` for a folder of another range."""
        names = [MANIFEST, REJECTS, *(index_name(split) for split in self._requested)]
        small = {name: read_limited(folder / name, LARGEST_FILE) for name in names if (folder / name).exists()}
        found = self._parse_range(number, small, str(folder))
        for shard in found.shards.values():
            self.files.put_file(shard.record.name, folder / shard.record.name)
        for name in sorted(small, key=lambda name: name == MANIFEST):  # the manifest last
            self.files.put(f"{NOTES}/{number:05d}/{name}", small[name])
        return found

    def publish(self, ranges: Mapping[int, UploadedRange]) -> None:
        """Write indices and rejects, then the manifest, which makes the data set visible; remove the notes."""
        manifest = self._manifest(MANIFEST) or Manifest()
        for split, requested in self._requested.items():
            ordered = [uploaded.shards[split] for _, uploaded in sorted(ranges.items()) if split in uploaded.shards]
            if not ordered and split == FAILED:
                continue
            tables = {shard.record.name: shard.table for shard in ordered}
            index = ShardIndex.joined(tables, [shard.record.size for shard in ordered], self._layout)
            self.files.put(index_name(split), index.to_bytes())
            record = manifest.splits.get(split, requested)
            manifest = manifest.with_split(split, replace(record, shards=tuple(shard.record for shard in ordered)))
        rejects = merged_rejects([self.rejects(), *(uploaded.rejects for _, uploaded in sorted(ranges.items()))])
        self.files.put(REJECTS, rejects)
        self.files.put(MANIFEST, manifest.to_bytes())
        try:
            self.files.remove(f"{NOTES}/")
        except RefusedError as error:
            log.warning("%s; the data set is complete, and the notes below .unfinished/ may stay", error)

    # --------------------------------------------------------------------------------------------------------- reading

    def _holds(self, found: UploadedRange, number: int, count: int) -> bool:
        return found.samples.issuperset(self.wanted(number, count))

    def _manifest(self, name: str) -> Manifest | None:
        """A manifest; ``None`` for a missing one. Raises ``ConfigError`` where it contradicts the requested splits."""
        try:
            content = self.files.get(name, LARGEST_MANIFEST)
        except MissingError:
            return None
        return self._parse_manifest(content, self.files.address(name))

    def _parse_manifest(self, content: bytes, location: str) -> Manifest:
        manifest = parse_manifest(content, location, "remove it, or choose another URL")
        if manifest.schema != self._layout.schema:
            raise ConfigError(
                f"{location}: of schema {manifest.schema}, but schema {self._layout.schema} is written: choose "
                "another URL"
            )
        if manifest.recipe is not None:
            raise ConfigError(f"{location}: holds the data set of recipe {manifest.recipe.name}: choose another URL")
        for split, requested in self._requested.items():
            manifest_record_to_resume(manifest, location, split, requested)
        return manifest

    def _published(self) -> dict[int, UploadedRange]:
        """Number to range, from the published manifest and indices."""
        manifest = self._manifest(MANIFEST)
        found: dict[int, dict[str, UploadedShard]] = {}
        for split in self._requested:
            if manifest is None or split not in manifest.splits:
                continue
            name = index_name(split)
            location, content = self.files.address(name), self.files.get(name, LARGEST_FILE)
            index = ShardIndex.parse(content, location, self._layout, remedy="remove it and the manifest, start again")
            for shard in _shards(manifest, split, index, location):
                found.setdefault(_number(shard.record.name, split), {})[split] = shard
        return {number: UploadedRange(shards) for number, shards in found.items()}

    def _noted_range(self, number: int) -> UploadedRange | None:
        """A range from its note; ``None`` without one."""
        folder = f"{NOTES}/{number:05d}"
        try:
            small = {MANIFEST: self.files.get(f"{folder}/{MANIFEST}", LARGEST_MANIFEST)}
        except MissingError:
            return None
        manifest = self._parse_manifest(small[MANIFEST], self.files.address(f"{folder}/{MANIFEST}"))
        for name in (REJECTS, *(index_name(split) for split in manifest.splits)):
            small[name] = self.files.get(f"{folder}/{name}", LARGEST_FILE)
        return self._parse_range(number, small, self.files.address(folder))

    def _parse_range(self, number: int, small: Mapping[str, bytes], location: str) -> UploadedRange:
        """A range from its manifest, indices and rejects (file name to content). Raises ``ShardError``."""
        manifest = self._parse_manifest(small[MANIFEST], f"{location}/{MANIFEST}")
        shards = {}
        for split in manifest.splits:
            index = ShardIndex.parse(small[index_name(split)], f"{location}/{index_name(split)}", self._layout)
            for shard in _shards(manifest, split, index, location):
                if split not in self._requested or shard.record.name != shard_name(split, number):
                    raise ShardError(
                        f"{location}: the note of range {number} lists {shard.record.name}: remove the note"
                    )
                shards[split] = shard
        return UploadedRange(shards, small.get(REJECTS, b""))

    def _is_stored(self, found: UploadedRange) -> bool:
        """Whether the shards of a range are in the store with their recorded sizes."""
        try:
            return all(self.files.size(shard.record.name) == shard.record.size for shard in found.shards.values())
        except MissingError:
            return False


def _shards(manifest: Manifest, split: str, index: ShardIndex, location: str) -> list[UploadedShard]:
    """The shards of a split. Raises ``RemoteError`` where manifest and index differ."""
    tables = index.tables()
    for record in manifest.splits[split].shards:
        if record.name not in tables or len(tables[record.name]) != record.count:
            raise RemoteError(f"{location}: lists other shards than {MANIFEST}: remove both, and start again")
    return [UploadedShard(record, tables[record.name]) for record in manifest.splits[split].shards]


def _number(name: str, split: str) -> int:
    number = shard_number(name, split)
    assert number is not None  # checked by SplitRecord.from_json
    return number


def _run_parallel(request: Callable[[int], R], numbers: Iterable[int]) -> dict[int, R]:
    """Number to result; up to ``PARALLEL_REQUESTS`` run at a time."""
    ordered = sorted(numbers)
    with ThreadPoolExecutor(PARALLEL_REQUESTS) as pool:
        return dict(zip(ordered, pool.map(request, ordered), strict=True))
