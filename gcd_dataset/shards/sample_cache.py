"""Samples kept as they are made, by any number of processes at once, as the shards of a data set.

A sample waits in a tar of its own until all of its shard are there; then whoever has brought the last one writes the
shard. So the folder is at any moment a data set of what is in whole shards, and nothing that was made is lost.
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
from gcd_dataset.shards.layout import MEMBERS, WAITING, Bytes, index_name, key_of, shard_name, shards_in
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.single import read_single, write_single
from gcd_dataset.shards.writer import SHARD_SIZE, ShardWriter

__all__ = ["KeptSamples"]

logger = logging.getLogger("gcd_dataset")

SPLIT = "train"
SINGLE = re.compile(r"gcd_(\d{9,})\.tar")


@dataclass(frozen=True)
class _Shards:
    """The shards as they were looked at: replaced as a whole, since a thread may read while another looks again."""

    reader: ShardReader | None = None
    """``None`` where there are none."""
    numbers: Int[np.ndarray, " n"] = field(default_factory=lambda: np.empty(0, np.int64))
    """Indices of the samples in them, in the order of the reader."""
    index_file: tuple[int, int, int] | None = None
    """What tells their index from others: inode, time of change [ns], size [bytes]."""

    @classmethod
    def of(cls, reader: ShardReader | None, index_file: tuple[int, int, int]) -> Self:
        if reader is None:
            return cls(index_file=index_file)
        return cls(reader, np.sort(reader.index.table.sample), index_file)

    def read(self, index: int, members: tuple[str, ...]) -> Mapping[str, Bytes] | None:
        position = int(np.searchsorted(self.numbers, index))
        is_there = position < len(self.numbers) and self.numbers[position] == index
        return self.reader.read(position, members) if self.reader is not None and is_there else None

    def between(self, first: int, end: int) -> set[int]:
        """The samples that are there."""
        start, stop = np.searchsorted(self.numbers, [first, end])
        return set(self.numbers[start:stop].tolist())


NONE = _Shards()


class KeptSamples:
    """Samples 0 … ``count`` - 1 of a recipe in ``folder``, as far as they have been made; may be pickled and forked.

    A shard is written when all of its samples below ``count`` are there. A folder may be used with another ``count``:
    a shard that was smaller grows. Raises ``ShardError`` for a folder with a broken shard, ``OutputError`` for one
    that cannot be written.
    """

    def __init__(
        self, folder: Path, count: int, *, seed: int, recipe: Mapping[str, Any], shard_size: int = SHARD_SIZE
    ) -> None:
        self.folder = folder
        self._count, self._seed, self._recipe, self._shard_size = count, seed, dict(recipe), shard_size
        self._shards = NONE

    def read(self, index: int, members: tuple[str, ...] = MEMBERS) -> Mapping[str, Bytes] | None:
        """At least these members of a sample; ``None`` for one that is not there.

        Raises ``ShardError`` for a damaged one.
        """
        content = None if self._shards.reader is None else self._in_shard(index, members)
        if content is None:
            content = self._single(index)
        if content is None and self._shard_path(index // self._shard_size).exists():
            # Written since the shards were looked at, or from one to the other in between.
            self._refreshed()
            content = self._in_shard(index, members)
        return content

    def keep(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample, or put it in the place of a damaged one; with the last of its shard the shard is written."""
        self._write_single(index, members)
        number = index // self._shard_size
        wanted = range(number * self._shard_size, min((number + 1) * self._shard_size, self._count))
        if self._shard_path(number).exists():  # else no need to read the index, which may be long
            self._refreshed()
        if self._waiting(number).keys() | self._written(number) >= set(wanted):
            self._pack(number)

    def pack(self) -> None:
        """Write what waits into shards, of which some remain to be filled: a data set of all that is there."""
        with contextlib.suppress(FileNotFoundError):
            for folder in sorted((self.folder / WAITING).iterdir()):
                self._pack(int(folder.name))

    def _pack(self, number: int) -> None:
        """Write a shard, with what waits for it."""
        with self._alone():
            waiting = self._waiting(number)
            self._refreshed(alone=True)
            if any(not self._is_whole(index) for index in waiting.keys() & self._written(number)):
                self._take_apart(number)
                waiting = self._waiting(number)
            with self._writer() as writer:
                for index in sorted(waiting.keys() - writer.done):
                    with _unless_damaged(waiting[index]):
                        writer.add(index, read_single(waiting[index]))
            for path in waiting.values():
                path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # another sample waits there already
                (self.folder / WAITING / f"{number:05d}").rmdir()

    def _take_apart(self, number: int) -> None:
        """Let the undamaged samples of a shard wait again, and remove it."""
        for index in self._written(number) - self._waiting(number).keys():
            with _unless_damaged(self._shard_path(number)):
                content = self._from_shard(index, MEMBERS)
                assert content is not None
                self._write_single(index, content)
        self._shard_path(number).unlink(missing_ok=True)
        self._shards = NONE

    def _writer(self) -> ShardWriter:
        return ShardWriter(self.folder, seed=self._seed, recipe=self._recipe, shard_size=self._shard_size)

    # ------------------------------------------------------------------------------------------------ that wait

    def _single_path(self, index: int) -> Path:
        return self.folder / WAITING / f"{index // self._shard_size:05d}" / f"{key_of(index)}.tar"

    def _write_single(self, index: int, members: Mapping[str, Bytes]) -> None:
        path = self._single_path(index)
        while True:
            make_folder(path.parent)
            try:
                return write_single(path, index, members)
            except OutputError as error:
                # Else another has packed the shard since, and removed the folder, in which nothing waited any more.
                if not isinstance(error.__cause__, FileNotFoundError):
                    raise

    def _single(self, index: int) -> Mapping[str, Bytes] | None:
        path = self._single_path(index)
        with reading(path):
            is_there = path.exists()
        try:
            return read_single(path) if is_there else None
        except (ShardError, FileNotFoundError):
            if path.exists():
                raise
            return None  # gone into its shard meanwhile

    def _waiting(self, number: int) -> dict[int, Path]:
        """Index to file of what waits for a shard."""
        try:
            paths = list((self.folder / WAITING / f"{number:05d}").iterdir())
        except FileNotFoundError:
            return {}
        return {int(match[1]): path for path in paths if (match := SINGLE.fullmatch(path.name))}

    # ------------------------------------------------------------------------------------------------ in shards

    def _shard_path(self, number: int) -> Path:
        return self.folder / shard_name(SPLIT, number)

    def _in_shard(self, index: int, members: tuple[str, ...]) -> Mapping[str, Bytes] | None:
        """A sample from the shards as they were last seen; where it is damaged, as they are, or the one that waits."""
        try:
            return self._from_shard(index, members)
        except ShardError:
            if self._refreshed():
                return self._from_shard(index, members)
            if (mended := self._single(index)) is not None:
                return mended
            raise

    def _from_shard(self, index: int, members: tuple[str, ...]) -> Mapping[str, Bytes] | None:
        if self._shards.reader is None:
            self._refreshed()
        return self._shards.read(index, members)

    def _is_whole(self, index: int) -> bool:
        try:
            return self._from_shard(index, MEMBERS) is not None
        except ShardError:
            return False

    def _written(self, number: int) -> set[int]:
        """Indices of the samples in a shard."""
        return self._shards.between(number * self._shard_size, (number + 1) * self._shard_size)

    def _refreshed(self, *, alone: bool = False) -> bool:
        """Look at the shards as they are; whether they have changed since they were looked at.

        ``alone``: the lock of whoever packs is held.
        """
        try:
            stat = (self.folder / index_name(SPLIT)).stat()
        except FileNotFoundError:
            return False
        index_file = (stat.st_ino, stat.st_mtime_ns, stat.st_size)
        if index_file == self._shards.index_file:
            return False
        self._shards = _Shards.of(self._opened(alone), index_file)
        return True

    def _opened(self, alone: bool) -> ShardReader | None:
        """The shards; ``None`` where all of them were deleted."""
        try:
            return ShardReader(self.folder, SPLIT)
        except ShardError:
            # Of another's making half done, or of a shard that was deleted: a writer puts that in order.
            with contextlib.nullcontext() if alone else self._alone(), self._writer():
                pass
            return ShardReader(self.folder, SPLIT) if shards_in(self.folder, SPLIT) else None

    def _alone(self) -> contextlib.AbstractContextManager[None]:
        """Be the only one that packs. Whoever is must not ask again: it would wait for itself."""
        return locked(self.folder / ".packing.lock", "packing", wait=True)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_shards": NONE}


@contextlib.contextmanager
def _unless_damaged(path: Path) -> Any:
    """Leave out a sample that is damaged: it will be made again."""
    try:
        yield
    except ShardError as error:
        logger.warning("%s: left out of its shard: %s", path, error)
