"""Shards written so that nothing finished is ever lost, and a data set made in pieces is the one made in one go."""

import contextlib
import fcntl
import hashlib
import os
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from gcd_dataset.errors import ConfigError, GcdError, OutputError, ShardError
from gcd_dataset.files import make_folder, open_whole
from gcd_dataset.records import Sample
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.index import ShardIndex, ShardTable, empty_table, tables_of, whole_samples
from gcd_dataset.shards.layout import (
    MEMBERS,
    Bytes,
    index_name,
    key_of,
    member_name,
    part_path,
    recipe_hash,
    shard_name,
    shard_number,
)
from gcd_dataset.shards.manifest import MANIFEST, Manifest, ShardRecord, SplitRecord, read_manifest
from gcd_dataset.shards.tar import BLOCK, END, padded, tar_entry

__all__ = ["ShardWriter"]

SHARD_SIZE = 256  # samples: about 250 MB of draped garments at 1 cm


class ShardWriter:
    """Writes the samples of one split into a folder, and goes on where an earlier writer stopped.

    Shard k holds the samples from ``k * shard_size`` to ``(k + 1) * shard_size - 1``, in order, whatever the order and
    the number of sittings they were written in. While it fills it is called ``….tar.part``; on the way out of the
    ``with`` block, by an error too, it becomes a whole shard of the samples so far, which a later writer completes.
    After a kill or a power cut the next writer keeps what is whole in the ``.part`` file.

    Raises ``ConfigError`` for a folder made with another recipe, seed or shard size, ``ShardError`` for one with a
    broken shard, ``OutputError`` with file and remedy for a place that cannot be written.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        split: str = "train",
        seed: int,
        recipe: Mapping[str, Any],
        shard_size: int = SHARD_SIZE,
    ) -> None:
        if shard_size < 1:
            raise ConfigError(f"shard_size is {shard_size}: a shard holds 1 sample or more")
        self._folder, self._split = make_folder(folder), split
        self._manifest = read_manifest(self._folder) or Manifest()
        self._record = _agreed(
            self._folder, self._manifest.splits.get(split), SplitRecord(seed, dict(recipe), shard_size)
        )
        tables = tables_of(self._folder, split)
        self._whole = {
            number: table for name, table in tables.items() if (number := shard_number(name, split)) is not None
        }
        self._shards = self._records()
        self._keep_manifest()
        self._open: dict[int, _OpenShard] = {}
        self._take_up()

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples that are whole on disk."""
        tables = [*self._whole.values(), *(shard.table() for shard in self._open.values())]
        return frozenset(index for table in tables for index in table.sample.tolist())

    def write(self, sample: Sample) -> None:
        """Add a sample. Raises ``ConfigError`` for one that is there, ``OutputError`` where it cannot be written."""
        self.write_members(sample.provenance.index, encode_sample(sample))

    def write_members(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample that ``encode_sample`` has encoded, perhaps in another process. Raises as ``write`` does."""
        number = index // self._record.shard_size
        if number in self._whole and index in self._whole[number].sample:
            raise ConfigError(f"{self._path(number)}: {key_of(index)} is there already: write what is not in .done")
        shard = self._shard(number)
        shard.append(index, members)
        if len(shard.rows) == self._record.shard_size:
            self._finish(number)

    def close(self) -> None:
        """Make whole shards of those still open, and write the index. Raises ``OutputError``."""
        try:
            for number in sorted(self._open):
                self._finish(number)
            tables = {shard_name(self._split, number): self._whole[number] for number in sorted(self._whole)}
            ShardIndex.of(self._folder, tables).write(self._folder / index_name(self._split))
        finally:
            self._release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except OutputError:
            if kind is None:
                raise
            # The first error says what is wrong; whole samples wait in the .part files for the next writer.

    def _take_up(self) -> None:
        """Go on with the shards that an earlier writer could not finish."""
        names = [path.name.removesuffix(".part") for path in self._folder.glob("*.tar.part")]
        try:
            for number in sorted(number for name in names if (number := shard_number(name, self._split)) is not None):
                self._shard(number)
        except GcdError:
            self._release()
            raise

    def _release(self) -> None:
        for shard in self._open.values():
            shard.release()
        self._open.clear()

    def _path(self, number: int) -> Path:
        return self._folder / shard_name(self._split, number)

    def _shard(self, number: int) -> "_OpenShard":
        if number not in self._open:
            self._open[number] = _OpenShard(self._path(number), self._whole.get(number, empty_table()))
        return self._open[number]

    def _finish(self, number: int) -> None:
        shard = self._open[number]
        if shard.rows:
            self._shards[number] = shard.finish()
            self._whole[number] = shard.table()
        else:
            shard.discard()
        self._open.pop(number).release()
        self._keep_manifest()

    def _records(self) -> dict[int, ShardRecord]:
        """What the manifest says of the shards that are there; looked up anew where it is behind."""
        listed = {(shard.name, shard.size): shard for shard in self._record.shards}
        paths = {number: self._path(number) for number in self._whole}
        found = {number: listed.get((path.name, path.stat().st_size)) for number, path in paths.items()}
        return {
            number: record or _shard_record(paths[number], len(self._whole[number])) for number, record in found.items()
        }

    def _keep_manifest(self) -> None:
        shards = tuple(self._shards[number] for number in sorted(self._shards))
        self._manifest = self._manifest.with_split(self._split, replace(self._record, shards=shards))
        self._manifest.write(self._folder)


class _OpenShard:
    """A shard while it is written, under its temporary name: first what there was of it, then what is added.

    A sample belongs to it once its row does: an interrupt, or an error, in the middle of one leaves no trace.
    """

    def __init__(self, path: Path, there: ShardTable) -> None:
        self.path, self.part = path, part_path(path)
        self._file = self._locked()
        try:
            self._take_up(there)
        except BaseException:
            self.release()
            raise

    def _take_up(self, there: ShardTable) -> None:
        """Begin with what an earlier writer left here, then with what the shard to be replaced holds."""
        kept = whole_samples(self.part)
        self.rows = [kept[i : i + 1] for i in range(len(kept))]
        with _telling(self.part):
            os.ftruncate(self._file, self._end)
        missing = there[~np.isin(there.sample, kept.sample)]
        for i in range(len(missing)):
            self._take_over(missing[i : i + 1])

    def table(self) -> ShardTable:
        """The samples so far, in the order of the file."""
        return ShardTable.of(self.rows)

    def append(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample."""
        if any(row.sample[0] == index for row in self.rows):
            raise ConfigError(f"{self.path}: {key_of(index)} is there already: write what is not in .done")
        if set(members) != set(MEMBERS):
            raise ShardError(f"sample {key_of(index)} does not have the members of a sample: use encode_sample")
        data = [members[member] for member in MEMBERS]
        entries = [
            tar_entry(member_name(index, member), content) for member, content in zip(MEMBERS, data, strict=True)
        ]
        headers = self._end + np.cumsum([0] + [len(entry) for entry in entries[:-1]])
        row = ShardTable(
            sample=np.array([index], np.int64),
            offset=(headers[None] + BLOCK).astype(np.int64),
            size=np.array([[len(content) for content in data]], np.uint32),
            crc=np.array([[zlib.crc32(content) for content in data]], np.uint32),
        )
        self._write(b"".join(entries))
        self.rows.append(row)

    def finish(self) -> ShardRecord:
        """Give the shard its name, whole and in order."""
        if any(a.sample[0] > b.sample[0] for a, b in pairwise(self.rows)):
            self._sort()
        with _telling(self.part):
            # What a broken write left goes, and zeros that end the archive come: as a hole, on a full disk too.
            os.ftruncate(self._file, self._end)
            os.ftruncate(self._file, self._end + END)
            os.fsync(self._file)
            record = _shard_record(self.part, len(self.rows))
            self.part.replace(self.path)
            _sync_folder(self.path.parent)
        return replace(record, name=self.path.name)

    def discard(self) -> None:
        """Leave nothing of a shard without samples."""
        with _telling(self.part):
            self.part.unlink()

    def release(self) -> None:
        """Let other writers have the file."""
        os.close(self._file)

    @property
    def _end(self) -> int:
        return _span(self.rows[-1])[1] if self.rows else 0

    def _locked(self) -> int:
        """The file, ours alone. Raises ``OutputError`` if another process writes it."""
        with _telling(self.part):
            file = os.open(self.part, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(file)
            raise OutputError(f"{self.part}: another process is writing it: wait, or choose another folder") from error
        return file

    def _write(self, block: bytes) -> None:
        rest, position = memoryview(block), self._end
        with _telling(self.part, kept=len(self.rows)):
            while rest:
                written = os.pwrite(self._file, rest, position)
                rest, position = rest[written:], position + written

    def _take_over(self, row: ShardTable) -> None:
        """Copy a sample from the shard that this one will replace."""
        start, end = _span(row)
        with _telling(self.path), self.path.open("rb") as source:
            source.seek(start)
            block = source.read(end - start)
        moved = replace(row, offset=row.offset + (self._end - start))
        self._write(block)
        self.rows.append(moved)

    def _sort(self) -> None:
        """Write the samples anew in the order of their indices."""
        ordered = sorted(self.rows, key=lambda row: int(row.sample[0]))
        starts = np.cumsum([0] + [end - start for start, end in map(_span, ordered)])
        with open_whole(self.part) as file:
            for start, end in map(_span, ordered):
                file.write(os.pread(self._file, end - start, start))
        self.release()
        self._file = self._locked()
        self.rows = [
            replace(row, offset=row.offset + (start - _span(row)[0]))
            for row, start in zip(ordered, starts, strict=False)
        ]


def _agreed(folder: Path, there: SplitRecord | None, asked: SplitRecord) -> SplitRecord:
    """The record to go on with. Raises ``ConfigError`` with both sides where they differ."""
    if there is None:
        return asked
    for name in ("seed", "shard_size"):
        if getattr(there, name) != getattr(asked, name):
            raise _other(folder, name, getattr(there, name), getattr(asked, name))
    for option in sorted(set(there.recipe) | set(asked.recipe)):
        before, now = there.recipe.get(option), asked.recipe.get(option)
        if recipe_hash({option: before}) != recipe_hash({option: now}):
            raise _other(folder, option, before, now)
    return there


def _other(folder: Path, name: str, before: Any, now: Any) -> ConfigError:
    return ConfigError(
        f"{folder / MANIFEST}: made with {name}={before!r}, asked for {name}={now!r}: use the same or another folder"
    )


def _span(row: ShardTable) -> tuple[int, int]:
    """First and last byte, plus one, of a sample's place in the file."""
    return int(row.offset[0, 0]) - BLOCK, int(row.offset[0, -1]) + padded(int(row.size[0, -1]))


def _shard_record(path: Path, count: int) -> ShardRecord:
    with path.open("rb") as file:
        return ShardRecord(path.name, count, path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest())


def _sync_folder(folder: Path) -> None:
    """Bring new names to the disk, as ``fsync`` brings content."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


@contextlib.contextmanager
def _telling(path: Path, *, kept: int | None = None) -> Iterator[None]:
    """Turn the system's errors into an ``OutputError`` with file and remedy."""
    try:
        yield
    except OSError as error:
        there = "" if kept is None else f"; {kept} samples in it are kept"
        raise OutputError(
            f"{path}: cannot be written ({error.strerror}){there}: make room there and start again to go on"
        ) from error
