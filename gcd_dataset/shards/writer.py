"""Writes shards, sample by sample, as drafts that survive a kill.

    .train-00012-of-9600.draft, .views-…            the draft of shard 12: its samples so far, and their pictures
    .failed-00012-of-9600.draft, .views-…           the failed drapes of the same task

A finished draft gets its names in this order: pictures, note, and last the tar. So a shard exists when its tar does.
The draft of the split's own shard is locked (``flock``) by the process that fills it.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.files import make_folder, require_name
from gcd_dataset.records import Sample
from gcd_dataset.shards.access import Place, lock_file, reading, unlock, writing
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.layout import (
    FAILED,
    GARMENTS,
    META,
    Bytes,
    Layout,
    garments_in,
    is_picture,
    key_of,
    member_name,
)
from gcd_dataset.shards.manifest import MOST as MOST_SAMPLES
from gcd_dataset.shards.manifest import Plan, shard_name
from gcd_dataset.shards.meta import checked_meta
from gcd_dataset.shards.notes import (
    DRAFT,
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
from gcd_dataset.shards.tar import END, tar_entry

LARGE, SHARDS, MOST = 8192, 20, 32
LARGEST = 128  # samples of a shard, in a split of more than ``LARGE``


def shard_size_of(count: int, wearers: int = 1) -> int:
    """Samples of a shard in a split of ``count`` samples, in whole designs of ``wearers`` samples.

    A split of 20 designs or more has 20 shards or more.

    >>> [shard_size_of(count) for count in (7, 100, 1000, 100_000)], shard_size_of(100, wearers=2)
    ([1, 5, 32, 128], 4)
    """
    size = LARGEST if count > LARGE else min(max(count // SHARDS, 1), MOST)
    return max(size // wearers, 1) * wearers


def draft_name(split: str, number: int, count: int, *, views: bool = False) -> str:
    """The file name of a draft; ``count``: planned samples of the data set."""
    return f".{'views-' if views else ''}{split}-{number:05d}-of-{count}.draft"


class Draft:
    """The shard that a task makes, and the shard of its failed drapes: samples of ``indices``, in this order.

    Opening locks the draft and keeps the whole samples of a killed process. Raises ``OutputError`` where it cannot be
    written, ``ConfigError`` for samples of another data set in it.
    """

    def __init__(self, place: Place, plan: Plan, split: str, number: int, indices: Sequence[int], lock: int) -> None:
        # The split's own tar is named last: it marks the task as done.
        self._tars = {name: _DraftTar(place, plan, name, number) for name in dict.fromkeys((FAILED, split))}
        self._split, self._lock, self._skipped = split, lock, dict[int, str]()
        for tar in self._tars.values():
            tar.restore()
        done = self.done  # samples lie in order: keep those before the first one that is missing or damaged
        kept = next((k for k, index in enumerate(indices) if index not in done), len(indices))
        for tar in self._tars.values():
            tar.truncate(frozenset(indices[:kept]))

    @classmethod
    def open(
        cls, place: Place, plan: Plan, split: str, number: int, indices: Sequence[int], *, wait: bool = False
    ) -> Self | None:
        """The draft of a shard; ``None`` if the shard exists, or if another process fills it, unless ``wait``."""
        path, name = make_folder(place.work) / draft_name(split, number, plan.count), shard_name(split, number)
        with writing(path.parent):
            lock = None if place.exists(name) else lock_file(path, wait=wait)
        if lock is None:
            return None
        try:
            if not place.exists(name):
                return cls(place, plan, split, number, indices, lock)
            path.unlink()  # made for a shard that another process has finished meanwhile
        except BaseException:
            unlock(lock)
            raise
        unlock(lock)
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
        for name, tar in self._tars.items():
            if tar.rows or name == self._split:
                tar.finish(self._skipped if name == self._split else {})
        for tar in self._tars.values():
            tar.remove()
        self.close()

    def close(self) -> None:
        """Close the draft's files and release its lock; the samples in it are kept."""
        if self._lock >= 0:
            for tar in self._tars.values():
                tar.close()
            lock, self._lock = self._lock, -1  # before a signal can end this function, and close it again
            unlock(lock)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _DraftTar:
    """The drafts of a tar and of the tar of its pictures; ``restore`` reads what a killed process has left."""

    def __init__(self, place: Place, plan: Plan, split: str, number: int) -> None:
        self.split, self.number, self.plan, self.rows = split, number, plan, list[Row]()
        self._place = place
        self._names = tuple(shard_name(split, number, views=views) for views in (False, True))
        self._paths = tuple(place.work / draft_name(split, number, plan.count, views=views) for views in (False, True))
        self._files: dict[Path, int] = {}
        self._ends = [[0], [0]]  # ends of the samples in both tars
        self._members: tuple[str, ...] = ()

    def append(self, index: int, members: Mapping[str, Bytes]) -> None:
        self._require_same(members)
        entries = [(is_picture(name), tar_entry(member_name(index, name), members[name])) for name in self._members]
        blocks = [b"".join(entry for is_view, entry in entries if is_view is views) for views in (False, True)]
        row = row_of(self.plan, members, self._ends[0][-1], self._ends[1][-1] if blocks[1] else None)
        if row.number != index:
            raise ShardError(f"sample {index} cannot be stored: its {META} says {row.number}")
        for tar in (1, 0):  # a sample counts when it is in the main tar
            if blocks[tar] or not tar:
                self._write(tar, blocks[tar])
        self._add(row, len(blocks[0]), len(blocks[1]))

    def restore(self) -> None:
        """Keep the whole samples of a killed process, up to the first damaged one."""
        for path, name in zip(self._paths, self._names, strict=True):
            # Undo the naming of files before the task's own shard had its name.
            if not path.exists() and self._place.is_folder and self._place.exists(name):
                with writing(path):
                    (self._place.folder / name).replace(path)
        main, views = self._paths
        if not main.exists():
            return
        for sample in stored_samples(main, views if views.exists() else None, damaged=True):
            members = sample.members
            try:
                meta = checked_meta(members, sample.number)
            except ShardError:
                return
            if meta["crc32"].keys() != members.keys() - {META}:
                return
            plan_of_sample(meta, self.plan).require_same(self.plan, main)
            self._members = tuple(members)
            row = row_of(self.plan, members, sample.start, sample.views_start)
            self._add(row, sample.end - sample.start, sample.views_end - (sample.views_start or 0))

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
        record = record_of(self.number, len(self.rows), self._paths[0], views)
        note = Note.of(self.split, self.plan, record, self._members if self.rows else (), self.rows, skipped)
        if views is not None:
            self._place.put(views, self._names[1])
        self._place.write(note_name(self.split, self.number), note.to_bytes())
        self._place.put(self._paths[0], self._names[0])

    def remove(self, *, named: bool = False) -> None:
        """Remove the files that are left, with ``named`` also those that ``finish`` has given their names."""
        for path in self._paths:
            with writing(path):
                path.unlink(missing_ok=True)
        for name in (*self._names, note_name(self.split, self.number)) if named else ():
            self._place.remove(name)

    def close(self) -> None:
        for file in self._files.values():
            os.close(file)
        self._files.clear()

    def _require_same(self, members: Mapping[str, Bytes]) -> None:
        """Raise ``ConfigError`` for other members than those of the first sample."""
        names = tuple(sorted(members, key=is_picture))
        if not self.rows:
            self._members = names
        elif names != self._members:
            other = sorted({*names} ^ {*self._members}) or ["their order"]
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
                self._files[path] = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        return self._files[path]


class ShardWriter:
    """Writes a new split into a folder, in ascending order of the indices; manifest and index at the end.

    ``count``: samples of the whole data set, by default those written here. ``layout``: bodies, or garments,
    with those of the largest outfit. After an error nothing stays. Raises ``ConfigError`` for a folder that holds the
    split already, ``OutputError`` for one that cannot be written.
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
        self._place, self._count, self._garments = Place(folder), count, garments_in(layout.members)
        size = (MOST if count is None else shard_size_of(count)) if shard_size is None else shard_size
        plan = Plan(layout.kind, seed, dict(recipe), 0 if count is None else count, size)
        try:
            self._plan, self._split = Plan.from_json(plan.to_json(), "the plan"), require_name(split, "split")
        except ShardError as error:
            raise ConfigError(f"{self._place.location()}: {error}: no data set can be written with it") from error
        make_folder(self._place.folder)
        if any(name == split for name, _ in shards_named(self._place.names())):
            raise ConfigError(f"{self._place.location()}: holds split {split} already: choose another folder")
        self._tars: list[_DraftTar] = []
        self._last = -1
        self._closed = False

    def write(self, sample: Sample) -> None:
        """Encode and add a garment. Raises as ``add`` does, and ``ShardError`` where the format cannot hold it."""
        self.add(sample.provenance.index, encode_sample(sample, garments=self._garments))

    def add(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add an encoded sample: member name to content.

        Raises ``ConfigError`` unless ``index`` is larger than the last one, ``OutputError`` where it cannot be written.
        """
        if self._closed:
            raise OutputError(f"{self._place.location()}: this writer is closed: open another one")
        if not self._last < index < MOST_SAMPLES:
            after = f"after {key_of(self._last)}" if self._last >= 0 else "as the first"
            raise ConfigError(f"{key_of(index)} {after}: write samples in ascending order, numbers from 0 to 2**31 - 1")
        if not self._tars or len(self._tars[-1].rows) == self._plan.shard_size:
            self._begin()
        self._tars[-1].append(index, members)
        self._last = index

    def close(self) -> None:
        """Finish the shards, and write manifest and index. Raises ``OutputError``."""
        if self._closed:
            return
        if not self._tars:
            self._begin()
        plan = replace(self._plan, count=self._count or max(sum(len(tar.rows) for tar in self._tars), 1))
        try:
            for tar in self._tars:
                tar.plan = plan
                tar.finish({})
                tar.close()
            gather(self._place).write(self._place)
        except BaseException:
            self._discard()
            raise
        self._closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        elif not self._closed:
            self._discard()

    def _discard(self) -> None:
        self._closed = True
        for tar in self._tars:
            tar.close()
            tar.remove(named=True)

    def _begin(self) -> None:
        if self._tars:
            self._tars[-1].close()
        self._tars.append(_DraftTar(self._place, self._plan, self._split, len(self._tars)))
        self._tars[-1].remove()  # the drafts of a killed writer


def remove_drafts(place: Place) -> None:
    """Remove the drafts of a data set whose shards are all finished. Raises ``OutputError``."""
    with reading(place.work):
        drafts = [path for path in place.work.glob(".*.draft") if DRAFT.fullmatch(path.name)]
    for path in drafts:
        with writing(path):
            path.unlink(missing_ok=True)
