"""A cache of generated samples, shared by processes, stored as the shards of a data set.

Each sample is first written to its own tar in ``.waiting``. The process that adds the last sample of a shard
writes the shard. At any moment the folder is a valid data set of its finished shards, and a killed process loses no
sample.
"""

import contextlib
import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.files import make_folder
from gcd_dataset.shards.access import locked, reading
from gcd_dataset.shards.layout import GARMENTS, WAITING, Bytes, Layout, index_name, key_of, shard_name, shards_in
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.single import read_single, write_single
from gcd_dataset.shards.writer import SHARD_SIZE, ShardWriter

__all__ = ["SampleCache"]

logger = logging.getLogger("gcd_dataset")

SPLIT = "train"
SINGLE = re.compile(r"gcd_(\d{9,})\.tar")


@dataclass(frozen=True)
class _Shards:
    """A snapshot of the shards. Replaced as a whole: another thread may be reading it."""

    reader: ShardReader | None = None
    """``None`` without shards."""
    numbers: Int[np.ndarray, " n"] = field(default_factory=lambda: np.empty(0, np.int64))
    """Indices of the samples in the shards, in the order of the reader."""
    index_file: tuple[int, int, int] | None = None
    """Identity of the index file: inode, mtime [ns], size [bytes]."""

    @classmethod
    def of(cls, reader: ShardReader | None, index_file: tuple[int, int, int]) -> Self:
        """The snapshot of the shards that ``reader`` has opened."""
        if reader is None:
            return cls(index_file=index_file)
        return cls(reader, np.sort(reader.index.table.sample), index_file)

    def read(self, index: int, members: tuple[str, ...]) -> Mapping[str, Bytes] | None:
        position = int(np.searchsorted(self.numbers, index))
        is_stored = position < len(self.numbers) and self.numbers[position] == index
        return self.reader.read(position, members) if self.reader is not None and is_stored else None

    def between(self, first: int, end: int) -> set[int]:
        """Indices of the samples from ``first`` to ``end - 1`` in the shards."""
        start, stop = np.searchsorted(self.numbers, [first, end])
        return set(self.numbers[start:stop].tolist())


NO_SHARDS = _Shards()


class SampleCache:
    """A cache of samples 0 … ``count`` - 1 of a recipe in ``folder``. May be pickled and forked.

    A shard is written once all of its samples below ``count`` are cached. A folder may be reused with another
    ``count``; its last shard then grows. Raises ``ShardError`` for a broken shard, ``OutputError`` for a folder that
    cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        count: int,
        *,
        seed: int,
        recipe: Mapping[str, Any],
        shard_size: int = SHARD_SIZE,
        layout: Layout = GARMENTS,
    ) -> None:
        self.folder = folder
        self._layout = layout
        self._count, self._seed, self._recipe, self._shard_size = count, seed, dict(recipe), shard_size
        self._shards = NO_SHARDS

    def read(self, index: int, members: tuple[str, ...] | None = None) -> Mapping[str, Bytes] | None:
        """Member to content, of at least these members (default: all); ``None`` for a sample that is not cached.

        Raises ``ShardError`` for a damaged sample.
        """
        members = self._layout.members if members is None else members
        content = None if self._shards.reader is None else self._in_shard(index, members)
        if content is None:
            content = self._single(index)
        if content is None and self._shard_path(index // self._shard_size).exists():
            # The shard was written after the last refresh, possibly between the two reads above.
            self._refresh()
            content = self._in_shard(index, members)
        return content

    def keep(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample, or replace a damaged one; the last sample of a shard triggers its writing."""
        self._write_single(index, members)
        number = index // self._shard_size
        wanted = range(number * self._shard_size, min((number + 1) * self._shard_size, self._count))
        if self._shard_path(number).exists():  # otherwise skip the index, which may be large
            self._refresh()
        if self._waiting(number).keys() | self._written(number) >= set(wanted):
            self._pack(number)

    def pack(self) -> None:
        """Write all waiting samples into shards, complete or not."""
        with contextlib.suppress(FileNotFoundError):
            for folder in sorted((self.folder / WAITING).iterdir()):
                self._pack(int(folder.name))

    def _pack(self, number: int) -> None:
        """Write a shard with its waiting samples."""
        with self._lock():
            waiting = self._waiting(number)
            self._refresh(holds_lock=True)
            if any(not self._is_whole(index) for index in waiting.keys() & self._written(number)):
                self._unpack(number)
                waiting = self._waiting(number)
            with self._writer() as writer:
                for index in sorted(waiting.keys() - writer.done):
                    with _unless_damaged(waiting[index]):
                        writer.add(index, read_single(waiting[index], self._layout))
            for path in waiting.values():
                path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # a new sample is already waiting there
                (self.folder / WAITING / f"{number:05d}").rmdir()

    def _unpack(self, number: int) -> None:
        """Move the undamaged samples of a shard back to ``.waiting``, and remove the shard."""
        for index in self._written(number) - self._waiting(number).keys():
            with _unless_damaged(self._shard_path(number)):
                content = self._from_shard(index, self._layout.members)
                assert content is not None
                self._write_single(index, content)
        self._shard_path(number).unlink(missing_ok=True)
        self._shards = NO_SHARDS

    def _writer(self) -> ShardWriter:
        return ShardWriter(
            self.folder, seed=self._seed, recipe=self._recipe, shard_size=self._shard_size, layout=self._layout
        )

    # ------------------------------------------------------------------------------------------ waiting samples

    def _single_path(self, index: int) -> Path:
        return self.folder / WAITING / f"{index // self._shard_size:05d}" / f"{key_of(index)}.tar"

    def _write_single(self, index: int, members: Mapping[str, Bytes]) -> None:
        path = self._single_path(index)
        while True:
            make_folder(path.parent)
            try:
                return write_single(path, index, members, self._layout)
            except OutputError as error:
                # FileNotFoundError: another process packed the shard and removed the empty folder. Try again.
                if not isinstance(error.__cause__, FileNotFoundError):
                    raise

    def _single(self, index: int) -> Mapping[str, Bytes] | None:
        path = self._single_path(index)
        with reading(path):
            exists = path.exists()
        try:
            return read_single(path, self._layout) if exists else None
        except (ShardError, FileNotFoundError):
            if path.exists():
                raise
            return None  # packed into its shard meanwhile

    def _waiting(self, number: int) -> dict[int, Path]:
        """Index to file of the samples waiting for a shard."""
        try:
            paths = list((self.folder / WAITING / f"{number:05d}").iterdir())
        except FileNotFoundError:
            return {}
        return {int(match[1]): path for path in paths if (match := SINGLE.fullmatch(path.name))}

    # ------------------------------------------------------------------------------------------ samples in shards

    def _shard_path(self, number: int) -> Path:
        return self.folder / shard_name(SPLIT, number)

    def _in_shard(self, index: int, members: tuple[str, ...]) -> Mapping[str, Bytes] | None:
        """A sample from the shards. If it is damaged, try refreshed shards, then a waiting replacement."""
        try:
            return self._from_shard(index, members)
        except ShardError:
            if self._refresh():
                return self._from_shard(index, members)
            if (replacement := self._single(index)) is not None:
                return replacement
            raise

    def _from_shard(self, index: int, members: tuple[str, ...]) -> Mapping[str, Bytes] | None:
        if self._shards.reader is None:
            self._refresh()
        return self._shards.read(index, members)

    def _is_whole(self, index: int) -> bool:
        try:
            return self._from_shard(index, self._layout.members) is not None
        except ShardError:
            return False

    def _written(self, number: int) -> set[int]:
        """Indices of the samples in a shard."""
        return self._shards.between(number * self._shard_size, (number + 1) * self._shard_size)

    def _refresh(self, *, holds_lock: bool = False) -> bool:
        """Reload the index if its file has changed; whether it has. ``holds_lock``: the caller holds ``_lock``."""
        try:
            stat = (self.folder / index_name(SPLIT)).stat()
        except FileNotFoundError:
            return False
        index_file = (stat.st_ino, stat.st_mtime_ns, stat.st_size)
        if index_file == self._shards.index_file:
            return False
        self._shards = _Shards.of(self._open_reader(holds_lock), index_file)
        return True

    def _open_reader(self, holds_lock: bool) -> ShardReader | None:
        """A reader of the shards; ``None`` where all of them were deleted."""
        try:
            return ShardReader(self.folder, SPLIT)
        except ShardError:
            # Stale index of an unfinished writer, or of a deleted shard: opening a writer repairs it.
            with contextlib.nullcontext() if holds_lock else self._lock(), self._writer():
                pass
            return ShardReader(self.folder, SPLIT) if shards_in(self.folder, SPLIT) else None

    def _lock(self) -> contextlib.AbstractContextManager[None]:
        """The packing lock. Not reentrant: a second acquisition waits forever."""
        return locked(self.folder / ".packing.lock", "packing", wait=True)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_shards": NO_SHARDS}


@contextlib.contextmanager
def _unless_damaged(path: Path) -> Any:
    """Skip a damaged sample with a warning; it will be generated again."""
    try:
        yield
    except ShardError as error:
        logger.warning("%s: left out of its shard: %s", path, error)
