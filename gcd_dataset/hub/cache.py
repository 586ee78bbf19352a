"""A cache of shard members read from a server.

    shards/KEY.tar     a sparse copy of the shard: each cached member at its offset
    shards/KEY.have    number of cached bytes; one flag byte for each member of each sample: 1 if cached
    used               cached bytes of all shards

Members are cached, not shards: half the bytes of a data set are in fields that most models never read. Only members
with a verified CRC-32 are added. Writers hold ``.lock``; readers need no lock.
"""

import contextlib
import errno
import logging
import os
import re
import time
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.files import make_folder
from gcd_dataset.shards.access import locked
from gcd_dataset.shards.folder import read_members
from gcd_dataset.shards.store import MemberLocation

__all__ = ["Cache", "CachedMember", "size_in_bytes"]

COUNTER = 8  # bytes of the counter at the start of a .have file
OPEN_SHARDS = 256  # most open shards, out of the 1024 descriptors that most systems allow a process
TOUCHED_EVERY = 60.0  # s between updates of mtime: on network file systems one costs as much as reading a member
UNITS = {"": 1, "B": 1} | {
    f"{prefix}{unit}": base ** (power + 1)
    for unit, base in (("B", 1000), ("IB", 1024))
    for power, prefix in enumerate("KMGT")
}

log = logging.getLogger(__name__)


class CachedMember(NamedTuple):
    """A verified member, to be cached."""

    flag: int
    """Number of the member among all members of the shard: sample number * members per sample + column."""
    offset: int
    data: memoryview


def size_in_bytes(size: int | str | None) -> int | None:
    """A size with a unit as bytes; ``None`` stays ``None``. Raises ``ConfigError``.

    >>> size_in_bytes("1.5 GiB"), size_in_bytes("20GB"), size_in_bytes(512)
    (1610612736, 20000000000, 512)
    """
    if size is None or (isinstance(size, int) and size >= 0):
        return size
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?I?B?)", str(size).strip().upper())
    if match is None or match[2] not in UNITS:
        raise ConfigError(f"max_cache_size={size!r}: give bytes, or a size such as '20GB' or '500MiB'")
    return int(float(match[1]) * UNITS[match[2]])


class Cache:
    """Members of shards in ``folder``, at most ``limit`` bytes. Safe for several processes; may be pickled and forked.

    Eviction is by shard, the least recently used first. Members that are larger than
    ``limit``, or cannot be written, are not cached; the first failure logs a warning.
    """

    def __init__(self, folder: Path, limit: int | None = None) -> None:
        self.folder, self.limit = folder, limit
        self._open: dict[str, _Shard] = {}
        self._warned = False

    @property
    def used(self) -> int:
        """Cached bytes of all shards."""
        return sum(_counted_bytes(path) for path in self._haves())

    def read(self, key: str, count: int, wanted: Sequence[tuple[int, MemberLocation]]) -> dict[int, memoryview]:
        """Flag to content of the cached members among ``wanted`` (flag, location). ``count``: members of the shard."""
        shard = self._shard(key, count)
        cached = [(flag, part) for flag, part in wanted if shard is not None and shard.have[COUNTER + flag]]
        if shard is None or not cached:
            return {}
        try:
            # Keyed by flag: columns repeat where members of several samples are read.
            content, end = read_members(shard.fd, [part._replace(column=flag) for flag, part in cached])
        except OSError:
            return {}
        return content if end is None else {}  # truncated: evicted meanwhile

    def keep(self, key: str, count: int, pieces: Sequence[CachedMember]) -> None:
        """Add members of a shard, evicting others if needed; logs a warning where that fails."""
        try:
            with self._locked():
                self._keep(key, count, pieces)
        except OutputError as error:
            self._warn(str(error))
        except OSError as error:
            remedy = "make room there" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "give another cache_dir"
            self._warn(f"{self.folder}: cannot be written ({error.strerror}): {remedy}")

    def drop(self, key: str, count: int, flag: int, size: int) -> None:
        """Remove a damaged member of ``size`` bytes."""
        with contextlib.suppress(OutputError, OSError), self._locked():
            shard = self._shard(key, count)
            if shard is not None and shard.have[COUNTER + flag]:
                _set(self._have(key), COUNTER + flag, b"\0")
                self._count(key, -size)

    def _keep(self, key: str, count: int, pieces: Sequence[CachedMember]) -> None:
        have = self._create(key, count).have
        new = [piece for piece in pieces if not have[COUNTER + piece.flag]]
        size = sum(len(piece.data) for piece in new)
        if not new or not self._make_room(size, key):
            return
        self._create(key, count)  # again: making room may have evicted the shard
        _write(self._have(key).with_suffix(".tar"), new)
        # Count before setting flags: after a kill the size is overcounted, never undercounted.
        self._count(key, size)
        for piece in new:
            _set(self._have(key), COUNTER + piece.flag, b"\1")

    def _make_room(self, size: int, key: str) -> bool:
        """Evict shards until ``size`` bytes fit; false where they exceed the limit."""
        if self.limit is None:
            return True
        if size > self.limit:
            self._warn(f"{self.folder}: {size} bytes at once exceed the limit of {self.limit}: raise max_cache_size")
            return False
        if self._total() + size <= self.limit:
            return True
        used = self.used
        # Evict the shard being read last.
        for have in sorted(self._haves(), key=lambda path: (path.stem == key, path.stat().st_mtime_ns)):
            if used + size <= self.limit:
                break
            used -= _counted_bytes(have)
            self._evict(have)
        for orphan in (self.folder / "shards").glob("*.tar"):  # left by a process killed during eviction
            if not orphan.with_suffix(".have").exists():
                orphan.unlink(missing_ok=True)
        self._write_down(used)
        return True

    def _evict(self, have: Path) -> None:
        """Remove a shard, truncated first: readers that hold it open would keep its disk space in use."""
        self._open.pop(have.stem, None)
        have.unlink(missing_ok=True)
        data = have.with_suffix(".tar")
        with contextlib.suppress(FileNotFoundError):
            if not data.is_symlink():
                os.truncate(data, 0)
            data.unlink()

    def _create(self, key: str, count: int) -> "_Shard":
        """The shard's files, created if missing. Raises ``OSError`` or ``OutputError``."""
        have = self._have(key)
        if have.exists() and have.stat().st_size != COUNTER + count:  # same key, another number of members
            self._evict(have)
        if not have.exists():
            make_folder(have.parent)
            # A new file, not the old one truncated: readers of the old file still trust its flags.
            have.with_suffix(".tar").unlink(missing_ok=True)
            have.with_suffix(".tar").open("xb").close()
            _replace(have, bytes(COUNTER + count))  # written, not a hole: mapping a hole on a full disk crashes
        return self._shard(key, count) or _Shard(have, count)

    def _shard(self, key: str, count: int) -> "_Shard | None":
        """The shard's open files; ``None`` where it is not cached."""
        shard = self._open.get(key)
        if shard is not None and not shard.is_evicted and len(shard.have) == COUNTER + count:
            shard.touch()
            return shard
        self._open.pop(key, None)
        try:
            shard = _Shard(self._have(key), count)
        except (OSError, ValueError):
            return None
        shard.touch()
        if len(self._open) >= OPEN_SHARDS:
            self._open.pop(next(iter(list(self._open))), None)
        self._open[key] = shard
        return shard

    def _have(self, key: str) -> Path:
        return self.folder / "shards" / f"{key}.have"

    def _haves(self) -> list[Path]:
        return sorted((self.folder / "shards").glob("*.have"))

    def _total(self) -> int:
        """Cached bytes of all shards, from the file ``used`` where possible."""
        try:
            return int((self.folder / "used").read_text())
        except (OSError, ValueError):
            return self.used

    def _count(self, key: str, size: int) -> None:
        """Add ``size`` bytes, which may be negative, to the counters of a shard and of the cache."""
        total, have = self._total(), self._have(key)
        # Write order: after a kill the total is never less than the sum of the shards.
        if size > 0:
            self._write_down(total + size)
        _set(have, 0, max(0, _counted_bytes(have) + size).to_bytes(COUNTER, "little"))
        if size < 0:
            self._write_down(max(0, total + size))

    def _write_down(self, total: int) -> None:
        _replace(self.folder / "used", str(total).encode())

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        make_folder(self.folder)
        with locked(self.folder / ".lock", "writing the cache", wait=True):
            yield

    def _warn(self, problem: str) -> None:
        if not self._warned:
            log.warning("%s; continuing without caching", problem)
        self._warned = True

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": {}}


class _Shard:
    """The open files of one shard, closed with the last reference."""

    def __init__(self, have: Path, count: int) -> None:
        self._path, self._next_touch = have, 0.0
        with have.open("rb") as file:
            self.have = np.memmap(file, np.uint8, "r", shape=(COUNTER + count,))
            self.fd = os.open(have.with_suffix(".tar"), os.O_RDONLY | os.O_NOFOLLOW)
            # Not __del__: at interpreter exit the os module may be gone before the last shard.
            weakref.finalize(self, os.close, self.fd)
            if not os.path.samestat(os.fstat(file.fileno()), have.stat()):
                raise FileNotFoundError(f"{have}: replaced while it was opened; the .tar may belong to the new one")

    @property
    def is_evicted(self) -> bool:
        """Whether the files have been unlinked."""
        return os.fstat(self.fd).st_nlink == 0

    def touch(self) -> None:
        """Update the mtime, at most every ``TOUCHED_EVERY`` seconds: eviction is by mtime."""
        if (now := time.monotonic()) >= self._next_touch:
            self._next_touch = now + TOUCHED_EVERY
            with contextlib.suppress(OSError):  # a read-only cache
                os.utime(self._path)


def _counted_bytes(have: Path) -> int:
    """Cached bytes of a shard, from its ``.have`` file."""
    try:
        with have.open("rb") as file:
            return int.from_bytes(file.read(COUNTER), "little")
    except FileNotFoundError:
        return 0


def _replace(path: Path, content: bytes) -> None:
    """Replace a file atomically, under the lock. A new draft each time: an existing one could be a link."""
    draft = path.with_suffix(".tmp")
    draft.unlink(missing_ok=True)
    with draft.open("xb") as file:
        file.write(content)
    draft.replace(path)


def _set(path: Path, offset: int, content: bytes) -> None:
    fd = os.open(path, os.O_WRONLY | os.O_NOFOLLOW)
    try:
        os.pwrite(fd, content, offset)
    finally:
        os.close(fd)


def _write(path: Path, pieces: Sequence[CachedMember]) -> None:
    fd = os.open(path, os.O_WRONLY | os.O_NOFOLLOW)
    try:
        for _, offset, data in pieces:
            while data:
                written = os.pwrite(fd, data, offset)
                data, offset = data[written:], offset + written
    finally:
        os.close(fd)
