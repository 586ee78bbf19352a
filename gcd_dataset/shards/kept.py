"""Samples kept as they are made, by any number of processes at once, as the shards of a data set.

A sample waits in a tar of its own until all of its shard are there; then whoever has brought the last one writes the
shard. So the folder is at any moment a data set of what is in whole shards, and nothing that was made is lost.
"""

import contextlib
import logging
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.files import make_folder
from gcd_dataset.shards.access import locked, reading
from gcd_dataset.shards.layout import MEMBERS, Bytes, index_name, key_of, shard_name, shards_in
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.single import read_single, write_single
from gcd_dataset.shards.writer import SHARD_SIZE, ShardWriter

__all__ = ["KeptSamples"]

logger = logging.getLogger("gcd_dataset")

SPLIT = "train"
WAITING = ".waiting"
SINGLE = re.compile(r"gcd_(\d{9,})\.tar")


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
        self._seen: tuple[int, int, int] | None = None
        self._reader: ShardReader | None = None
        self._is_alone = False

    def read(self, index: int, members: tuple[str, ...] = MEMBERS) -> Mapping[str, Bytes] | None:
        """At least these members of a sample; ``None`` for one that is not there.

        Raises ``ShardError`` for a damaged one.
        """
        content = None if self._reader is None else self._in_shard(index, members)
        if content is None:
            content = self._single(index)
        if content is None and self._shard_path(index // self._shard_size).exists():
            # Written since the shards were looked at, or from one to the other in between.
            self._refreshed()
            content = self._in_shard(index, members)
        return content

    def keep(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample, or put it in the place of a damaged one; with the last of its shard the shard is written."""
        self._let_wait(index, members)
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
            self._refreshed()
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
                write_single(self._single_path(index), index, content)
        self._shard_path(number).unlink(missing_ok=True)
        self._reader = self._seen = None

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """While nobody else changes shards; may be entered again within."""
        if self._is_alone:
            yield
            return
        with locked(self.folder / ".packing.lock", "packing", wait=True):
            self._is_alone = True
            try:
                yield
            finally:
                self._is_alone = False

    def _writer(self) -> ShardWriter:
        return ShardWriter(self.folder, seed=self._seed, recipe=self._recipe, shard_size=self._shard_size)

    # ------------------------------------------------------------------------------------------------ that wait

    def _single_path(self, index: int) -> Path:
        return self.folder / WAITING / f"{index // self._shard_size:05d}" / f"{key_of(index)}.tar"

    def _let_wait(self, index: int, members: Mapping[str, Bytes]) -> None:
        path = self._single_path(index)
        while True:
            make_folder(path.parent)
            try:
                write_single(path, index, members)
                return
            except OutputError:
                if path.parent.exists():
                    raise
                # Another process has packed what waited there, and removed the folder in between.

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
        if self._reader is None:
            self._refreshed()
        position = self._position(index)
        return None if self._reader is None or position is None else self._reader.read(position, members)

    def _is_whole(self, index: int) -> bool:
        try:
            return self._from_shard(index, MEMBERS) is not None
        except ShardError:
            return False

    def _position(self, index: int) -> int | None:
        """Where a sample stands in the reader."""
        if self._reader is None:
            return None
        numbers = self._numbers
        position = int(np.searchsorted(numbers, index))
        return position if position < len(numbers) and numbers[position] == index else None

    def _written(self, number: int) -> set[int]:
        """Indices of the samples in a shard."""
        if self._reader is None:
            return set()
        numbers = self._numbers
        first, last = np.searchsorted(numbers, [number * self._shard_size, (number + 1) * self._shard_size])
        return set(numbers[first:last].tolist())

    def _refreshed(self) -> bool:
        """Look at the shards as they are; whether they have changed since they were looked at."""
        try:
            stat = (self.folder / index_name(SPLIT)).stat()
        except FileNotFoundError:
            return False
        seen = (stat.st_ino, stat.st_mtime_ns, stat.st_size)
        if seen == self._seen:
            return False
        self._reader, self._seen = self._opened(), seen
        if self._reader is not None:
            self._numbers = np.sort(self._reader.index.table.sample)
        return True

    def _opened(self) -> ShardReader | None:
        """The shards as they are; ``None`` where all of them have been deleted."""
        try:
            return ShardReader(self.folder, SPLIT)
        except ShardError:
            # Of another's making half done, or of a shard that was deleted: a writer puts that in order.
            with self._alone(), self._writer():
                pass
            return ShardReader(self.folder, SPLIT) if shards_in(self.folder, SPLIT) else None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_reader": None, "_seen": None}


@contextlib.contextmanager
def _unless_damaged(path: Path) -> Any:
    """Leave out a sample that is damaged: it will be made again."""
    try:
        yield
    except ShardError as error:
        logger.warning("%s: left out of its shard: %s", path, error)
