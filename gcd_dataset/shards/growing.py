"""A shard during writing: a ``.tar.part`` file that survives a kill."""

import contextlib
import hashlib
import os
import zlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import open_whole
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.index import ShardTable, grade_index, has_settled, whole_samples
from gcd_dataset.shards.layout import Bytes, Layout, is_extra, key_of, member_name, part_path
from gcd_dataset.shards.manifest import ShardRecord
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.tar import BLOCK, END, padded, tar_entry

__all__ = ["GrowingShard", "shard_record", "sync_folder"]

META = 0  # every layout begins with meta.json


class GrowingShard:
    """An open shard under its temporary name: samples of an earlier writer, then appended samples.

    A sample counts only once its row is added to ``rows``: an interrupt or error while it is written leaves no trace.
    ``existing``: table of the finished shard at ``path`` that this one will replace.
    """

    def __init__(self, path: Path, existing: ShardTable, layout: Layout) -> None:
        self.path, self.part, self._layout = path, part_path(path), layout
        with contextlib.ExitStack() as on_error:
            self._file = self._opened()
            on_error.callback(self.close)
            self._resume(existing)
            on_error.pop_all()

    def _resume(self, existing: ShardTable) -> None:
        """Keep the whole samples of the ``.part`` file, then copy samples that it lacks from the finished shard."""
        recovered = whole_samples(self.part, self._layout)
        self.rows = [recovered[i : i + 1] for i in range(len(recovered))]
        with writing(self.part):
            os.ftruncate(self._file, self._end)
        missing = existing[~np.isin(existing.sample, recovered.sample)]
        self.copy(self.path, missing)

    def table(self) -> ShardTable:
        """The samples written so far, in file order."""
        return ShardTable.of(self.rows, self._layout)

    def append(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Append a sample. Raises as ``ShardWriter.add`` does."""
        if any(row.sample[0] == index for row in self.rows):
            raise ConfigError(
                f"{self.path}: {key_of(index)} is there already: write only indices that are not in .done"
            )
        _require_members(index, members, self._layout)
        data = [members[member] for member in self._layout.members]
        entries = [
            tar_entry(member_name(index, member), content)
            for member, content in zip(self._layout.members, data, strict=True)
        ]
        headers = self._end + np.cumsum([0] + [len(entry) for entry in entries[:-1]])
        meta = read_meta(data[META])
        row = ShardTable(
            sample=np.array([index], np.int64),
            offset=(headers[None] + BLOCK).astype(np.int64),
            size=np.array([[len(content) for content in data]], np.uint32),
            crc=np.array([[zlib.crc32(content) for content in data]], np.uint32),
            settled=np.array([has_settled(meta)]),
            grade=np.array([grade_index(meta)], np.uint8),
        )
        self._write(b"".join(entries))
        self.rows.append(row)

    def copy(self, source: Path, samples: ShardTable) -> None:
        """Append ``samples`` of the shard ``source`` that this shard lacks. Raises ``ShardError``, ``OutputError``."""
        present = {int(row.sample[0]) for row in self.rows}
        for i in range(len(samples)):
            if int(samples.sample[i]) not in present:
                self._copy_sample(source, samples[i : i + 1])

    def finish(self) -> ShardRecord:
        """Sort the samples by index, end the archive and rename it to ``path``; its record."""
        if any(a.sample[0] > b.sample[0] for a, b in pairwise(self.rows)):
            self._sort()
        with writing(self.part):
            # Cut off a failed write, then end the archive with zeros: a hole, which needs no room on a full disk.
            os.ftruncate(self._file, self._end)
            os.ftruncate(self._file, self._end + END)
            os.fsync(self._file)
            record = shard_record(self.part, self.table())
            self.part.replace(self.path)
            sync_folder(self.path.parent)
        return replace(record, name=self.path.name)

    def discard(self) -> None:
        """Remove the file of a shard without samples."""
        with writing(self.part):
            self.part.unlink()

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    @property
    def _end(self) -> int:
        return _span(self.rows[-1])[1] if self.rows else 0

    def _opened(self) -> int:
        with writing(self.part):
            return os.open(self.part, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)

    def _write(self, block: bytes) -> None:
        rest, position = memoryview(block), self._end
        with writing(self.part, kept=len(self.rows)):
            while rest:
                written = os.pwrite(self._file, rest, position)
                rest, position = rest[written:], position + written

    def _copy_sample(self, path: Path, row: ShardTable) -> None:
        start, end = _span(row)
        with reading(path), path.open("rb") as source:
            source.seek(start)
            block = source.read(end - start)
        moved = replace(row, offset=row.offset + (self._end - start))
        self._write(block)
        self.rows.append(moved)

    def _sort(self) -> None:
        """Rewrite the file with the samples in the order of their indices."""
        ordered = sorted(self.rows, key=lambda row: int(row.sample[0]))
        starts = np.cumsum([0] + [end - start for start, end in map(_span, ordered)])
        with open_whole(self.part) as file:
            for start, end in map(_span, ordered):
                file.write(os.pread(self._file, end - start, start))
        self.close()
        self._file = self._opened()
        self.rows = [
            replace(row, offset=row.offset + (start - _span(row)[0]))
            for row, start in zip(ordered, starts, strict=False)
        ]


def shard_record(path: Path, table: ShardTable) -> ShardRecord:
    """The manifest's record of the finished shard ``path``. Raises ``OSError``."""
    rejects: Counter[str] = Counter()
    redraws: Counter[str] = Counter()
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        for offset, size in zip(table.offset[:, META].tolist(), table.size[:, META].tolist(), strict=True):
            meta = read_meta(os.pread(file.fileno(), size, offset))
            rejects.update(reason.partition(":")[0] for reason in meta.get("rejects", ()))  # bodies have no rejects
            redraws.update(meta.get("redraws", {}))
    counts = (dict(sorted(counter.items())) for counter in (rejects, redraws))
    return ShardRecord(path.name, len(table), path.stat().st_size, digest, *counts)


def _require_members(index: int, members: Mapping[str, Bytes], layout: Layout) -> None:
    """Raise ``ShardError`` for a missing member, and for a caption or view that the layout does not have."""
    for member in layout.members:
        if member not in members:
            raise ShardError(f"{key_of(index)} has no {member}, which all samples of this data set have: add it")
    if more := [member for member in members if member not in layout.members and is_extra(member)]:
        raise ShardError(f"{key_of(index)} has {more[0]}, which no other sample of this data set has: leave it out")


def _span(row: ShardTable) -> tuple[int, int]:
    """Start and end of a sample in the file [bytes], its first header and last padding included."""
    return int(row.offset[0, 0]) - BLOCK, int(row.offset[0, -1]) + padded(int(row.size[0, -1]))


def sync_folder(folder: Path) -> None:
    """``fsync`` the folder, so that renames survive a power cut."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
