"""Writes shards, sample by sample, as drafts that survive a kill.

    .train-00012.part, .views-train-00012.part      the draft of shard 12: its samples so far, and their pictures
    .failed-00012.part, .views-failed-00012.part    the failed drapes of the same task

A finished draft gets its names in this order: pictures, note, and last the tar. So a shard exists when its tar does.
The draft of the split's own shard is locked (``flock``) by the process that fills it.
"""

import contextlib
import fcntl
import os
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.files import make_folder
from gcd_dataset.names import require_name
from gcd_dataset.records import Sample
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.layout import FAILED, GARMENTS, Bytes, Layout, is_picture, key_of, member_name
from gcd_dataset.shards.manifest import Plan, ShardRecord
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.notes import (
    META,
    Note,
    Row,
    gather,
    note_name,
    plan_of_sample,
    record_of,
    row_of,
    shards_named,
    stored_samples,
)
from gcd_dataset.shards.place import FolderPlace, Place
from gcd_dataset.shards.tar import END, tar_entry

__all__ = ["DRAFT", "Draft", "ShardWriter", "draft_name", "remove_drafts", "shard_size_of"]

LARGE, SHARDS, MOST = 8192, 20, 32
LARGEST = 128  # samples of a shard, in a split of more than ``LARGE``
DRAFT = re.compile(r"\..+-\d{5,}\.part")


def shard_size_of(count: int, wearers: int = 1) -> int:
    """Samples of a shard in a split of ``count`` samples, in whole designs of ``wearers`` samples.

    A split of 20 designs or more has 20 shards or more.

    >>> [shard_size_of(count) for count in (7, 100, 1000, 100_000)], shard_size_of(100, wearers=2)
    ([1, 5, 32, 128], 4)
    """
    size = LARGEST if count > LARGE else min(max(count // SHARDS, 1), MOST)
    return max(size // wearers, 1) * wearers


def draft_name(split: str, number: int, *, views: bool = False) -> str:
    """The file name of a draft."""
    return f".{'views-' if views else ''}{split}-{number:05d}.part"


class Draft:
    """The shard that a task makes, and the shard of its failed drapes: samples of ``indices``, in this order.

    Opening locks the draft and keeps the whole samples of a killed process. Raises ``OutputError`` where it cannot be
    written, ``ConfigError`` for samples of another data set in it.
    """

    def __init__(self, place: Place, plan: Plan, split: str, number: int, indices: Sequence[int], lock: int) -> None:
        self._place, self._plan, self._split, self._number, self._lock = place, plan, split, number, lock
        self._indices = indices
        self._tars = {name: _DraftTar(place, plan, name, number) for name in dict.fromkeys((split, FAILED))}
        self._skipped: dict[int, str] = {}
        self._keep()

    @classmethod
    def open(
        cls, place: Place, plan: Plan, split: str, number: int, indices: Sequence[int], *, wait: bool = False
    ) -> Self | None:
        """The draft of a shard; ``None`` if the shard exists, or if another process fills it, unless ``wait``."""
        path = make_folder(place.work) / draft_name(split, number)
        while not place.exists(ShardRecord(number, 0, 0, "").name(split)):
            lock = _locked(path, wait=wait)
            if lock is None:
                return None
            try:
                if _is_at(lock, path) and not place.exists(ShardRecord(number, 0, 0, "").name(split)):
                    return cls(place, plan, split, number, indices, lock)
                if _is_at(lock, path):  # made for a shard that another process has finished meanwhile
                    path.unlink()
            except BaseException:
                os.close(lock)
                raise
            os.close(lock)
        return None

    @property
    def done(self) -> frozenset[int]:
        """Numbers of the samples in the draft, those included that could not be made."""
        return frozenset(row.number for tar in self._tars.values() for row in tar.rows) | self._skipped.keys()

    def add(self, index: int, members: Mapping[str, Bytes], *, failed: bool = False) -> None:
        """Append a sample: member name to content. Raises ``OutputError``; the samples before are kept then."""
        self._tars[FAILED if failed else self._split].append(index, members)

    def skip(self, index: int, fault: str) -> None:
        """Note that a sample could not be made."""
        self._skipped[index] = fault

    def finish(self) -> None:
        """Give the shard, and that of its failed drapes, its name. Raises ``OutputError``."""
        tars = [
            self._tars[name] for name in reversed(self._tars)
        ]  # the split's own tar last: it marks the task as done
        for tar in tars:
            if tar.rows or tar.split == self._split:
                tar.finish(self._skipped if tar.split == self._split else {})
        for tar in tars:
            tar.remove()
        self.close()

    def close(self) -> None:
        """Close the draft's files and release its lock; the samples in it are kept."""
        if self._lock >= 0:
            for tar in self._tars.values():
                tar.close()
            fcntl.flock(self._lock, fcntl.LOCK_UN)  # a child forked meanwhile has the file open too
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _keep(self) -> None:
        """Truncate the tars before the first sample that is missing or damaged: samples lie in order."""
        done = self.done
        kept = next((k for k, index in enumerate(self._indices) if index not in done), len(self._indices))
        for tar in self._tars.values():
            tar.truncate(frozenset(self._indices[:kept]))


class _DraftTar:
    """The draft of one tar, and that of its pictures."""

    def __init__(self, place: Place, plan: Plan, split: str, number: int) -> None:
        self.split, self.rows = split, list[Row]()
        self._place, self.plan, self._number = place, plan, number
        self._paths = tuple(place.work / draft_name(split, number, views=views) for views in (False, True))
        self._files: dict[Path, int] = {}
        self._ends = [[0], [0]]  # ends of the samples in both tars
        self._members: dict[str, None] = {}
        self._restore()
        self._read()

    def append(self, index: int, members: Mapping[str, Bytes]) -> None:
        self._require_same(members)
        blocks = [
            b"".join(tar_entry(member_name(index, member), members[member]) for member in self._members if kind(member))
            for kind in (lambda member: not is_picture(member), is_picture)
        ]
        row = row_of(self.plan, members, self._ends[0][-1], self._ends[1][-1] if blocks[1] else None)
        if row.number != index:
            raise ShardError(f"sample {index} cannot be stored: its {META} says {row.number}")
        for tar in (1, 0):  # a sample counts when it is in the main tar
            if blocks[tar] or not tar:
                self._write(tar, blocks[tar])
        self._add(row, len(blocks[0]), len(blocks[1]))

    def truncate(self, numbers: frozenset[int]) -> None:
        """Remove the samples from the first one on that is not among ``numbers``."""
        count = next((k for k, row in enumerate(self.rows) if row.number not in numbers), len(self.rows))
        self.rows, self._ends = self.rows[:count], [ends[: count + 1] for ends in self._ends]
        for path, ends in zip(self._paths, self._ends, strict=True):
            if path.exists():
                with writing(path):
                    os.ftruncate(self._file(path), ends[-1])

    def finish(self, skipped: Mapping[int, str]) -> None:
        """End the tars, and give pictures, note and tar their names."""
        views = self._paths[1] if self._ends[1][-1] else None
        for path, ends in zip((self._paths[0], views), self._ends, strict=True):
            if path is not None:
                with writing(path, kept=len(self.rows)):
                    file = self._file(path)
                    os.ftruncate(file, ends[-1])  # cut off a failed write
                    os.ftruncate(file, ends[-1] + END)  # zeros are a hole, which needs no room on a full disk
                    os.fsync(file)
        record = record_of(self._number, len(self.rows), self._paths[0], views)
        note = Note.of(self.split, self.plan, record, self._members if self.rows else (), self.rows, skipped)
        if views is not None:
            self._place.put(views, record.views_name(self.split))
        self._place.write(note_name(self.split, self._number), note.to_bytes())
        self._place.put(self._paths[0], record.name(self.split))

    def remove(self) -> None:
        """Remove the files that are left."""
        for path in self._paths:
            with writing(path):
                path.unlink(missing_ok=True)

    def close(self) -> None:
        for file in self._files.values():
            os.close(file)
        self._files.clear()

    def _require_same(self, members: Mapping[str, Bytes]) -> None:
        """Raise ``ConfigError`` for other members than those of the first sample."""
        names = tuple(sorted(members, key=is_picture))
        if not self.rows:
            self._members = dict.fromkeys(names)
        elif names != tuple(self._members):
            other = sorted(set(names) ^ self._members.keys()) or ["their order"]
            raise ConfigError(f"{self._paths[0]}: its samples differ in {other[0]}: give the same members to all")

    def _add(self, row: Row, size: int, views_size: int) -> None:
        self.rows.append(row)
        for ends, length in zip(self._ends, (size, views_size), strict=True):
            ends.append(ends[-1] + length)

    def _write(self, tar: int, block: bytes) -> None:
        path, position = self._paths[tar], self._ends[tar][-1]
        rest = memoryview(block)
        with writing(path, kept=len(self.rows)):
            file = self._file(path)
            try:
                while rest:
                    written = os.pwrite(file, rest, position)
                    rest, position = rest[written:], position + written
            except OSError:
                os.ftruncate(file, self._ends[tar][-1])  # leaves room for other files
                raise

    def _file(self, path: Path) -> int:
        if path not in self._files:
            with writing(path):
                self._files[path] = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        return self._files[path]

    def _restore(self) -> None:
        """Undo the naming of files by a process that was killed before the task's own shard had its name."""
        record = ShardRecord(self._number, 0, 0, "")
        for path, name in zip(self._paths, (record.name(self.split), record.views_name(self.split)), strict=True):
            if not path.exists() and isinstance(self._place, FolderPlace) and self._place.exists(name):
                with writing(path):
                    (self._place.folder / name).replace(path)

    def _read(self) -> None:
        """Keep the whole samples of a draft up to the first damaged one."""
        main, views = self._paths
        if not main.exists():
            return
        pictures = iter(stored_samples(views, damaged=True)) if views.exists() else iter(())
        for sample in stored_samples(main, damaged=True):
            try:
                meta = read_meta(sample.members.get(META, b""))
                wanted = meta["crc32"]
                members, of_views = dict(sample.members), any(map(is_picture, wanted))
                picture = next(pictures, None) if of_views else None
                if picture is not None and picture.number == sample.number:
                    members |= picture.members
                whole = {m: zlib.crc32(data) for m, data in members.items() if m != META} == dict(wanted)
            except ShardError:
                return
            if not whole:
                return
            plan_of_sample(meta, self.plan).require_same(self.plan, main)
            self._members = dict.fromkeys(members)
            row = row_of(self.plan, members, sample.start, None if picture is None else picture.start)
            self._add(row, sample.end - sample.start, 0 if picture is None else picture.end - picture.start)


class ShardWriter:
    """Writes a new split into a folder, in ascending order of the indices; manifest and index at the end.

    ``count``: samples of the whole data set, by default those written here. ``layout``: garments or bodies. After an
    error nothing stays. Raises ``ConfigError`` for a folder that holds the split already, ``OutputError`` for one that
    cannot be written.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        split: str = "train",
        seed: int,
        recipe: Mapping[str, Any],
        count: int | None = None,
        shard_size: int | None = None,
        layout: Layout = GARMENTS,
    ) -> None:
        self._place, self._split, self._count = FolderPlace(folder), require_name(split, "split"), count
        make_folder(self._place.folder)
        if any(name == split for name, _ in shards_named(self._place.names())):
            raise ConfigError(f"{self._place.location()}: holds split {split} already: choose another folder")
        size = shard_size or (MOST if count is None else shard_size_of(count))
        self._plan = Plan(layout.kind, seed, dict(recipe), count or 0, size)
        self._tars: list[_DraftTar] = []
        self._last = -1
        self._closed = False

    def write(self, sample: Sample) -> None:
        """Encode and add a garment. Raises as ``add`` does, and ``ShardError`` where the format cannot hold it."""
        self.add(sample.provenance.index, encode_sample(sample))

    def add(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add an encoded sample: member name to content.

        Raises ``ConfigError`` unless ``index`` is larger than the last one, ``OutputError`` where it cannot be written.
        """
        if self._closed:
            raise OutputError(f"{self._place.location()}: this writer is closed: open another one")
        if index <= self._last:
            raise ConfigError(f"{key_of(index)} after {key_of(self._last)}: write samples in ascending order")
        if not self._tars or len(self._tars[-1].rows) == self._plan.shard_size:
            self._begin()
        self._tars[-1].append(index, members)
        self._last = index

    def close(self) -> None:
        """Finish the shards, and write manifest and index. Raises ``OutputError``."""
        if self._closed:
            return
        self._closed = True
        if not self._tars:
            self._begin()
        plan = replace(self._plan, count=self._count or max(sum(len(tar.rows) for tar in self._tars), 1))
        for tar in self._tars:
            tar.plan = plan
            tar.finish({})
            tar.close()
        gather(self._place).write(self._place)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
            return
        self._closed = True
        for tar in self._tars:
            tar.close()
            tar.remove()

    def _begin(self) -> None:
        if self._tars:
            self._tars[-1].close()
        for views in (False, True):  # of a killed writer
            (self._place.work / draft_name(self._split, len(self._tars), views=views)).unlink(missing_ok=True)
        self._tars.append(_DraftTar(self._place, self._plan, self._split, len(self._tars)))


def remove_drafts(place: Place) -> None:
    """Remove the drafts of a data set whose shards are all finished. Raises ``OutputError``."""
    with reading(place.work):
        drafts = [path for path in place.work.glob(".*.part") if DRAFT.fullmatch(path.name)]
    for path in drafts:
        with writing(path):
            path.unlink(missing_ok=True)


def _locked(path: Path, *, wait: bool) -> int | None:
    """The descriptor of a locked file, created if missing; ``None`` if another process has locked it."""
    with writing(path):
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    try:
        fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        return None
    except OSError as error:
        os.close(file)
        raise OutputError(
            f"{path}: cannot be locked ({error.strerror}): mount this file system with locks (Lustre: -o flock), or "
            "write to a local disk and copy the folder"
        ) from error
    except BaseException:  # Ctrl-C while waiting
        os.close(file)
        raise
    return file


def _is_at(file: int, path: Path) -> bool:
    """Whether a path still names an open file: its last holder may have renamed or removed it."""
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(file), path.stat())
    return False
