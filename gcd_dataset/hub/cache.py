"""What was read of a server, kept member by member: a shard that fills as it is asked for.

    shards/KEY.tar     the shard, a sparse file: what has come stands where it stands in the whole
    shards/KEY.have    bytes of it that have come, then one byte a member of a sample: 1 where it is there
    used               bytes of all shards together

Members, not shards, since half a data set's bytes are in fields that most models never read, and since a member is
what a hash can vouch for: what is here has been checked. Whoever adds something holds ``.lock``; reading needs none.
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

COUNTER = 8  # bytes at the head of a .have file
OPEN_SHARDS = 256  # of the 1024 files that most systems give a process
TOUCHED_EVERY = 60.0  # s: on a network's file system a time costs as much to write down as a member to read
UNITS = {"": 1, "B": 1} | {
    f"{prefix}{unit}": base ** (power + 1)
    for unit, base in (("B", 1000), ("IB", 1024))
    for power, prefix in enumerate("KMGT")
}

log = logging.getLogger(__name__)


class CachedMember(NamedTuple):
    """A member that has come, and has been checked."""

    flag: int
    """Its number among all members of the shard."""
    offset: int
    data: memoryview


def size_in_bytes(size: int | str | None) -> int | None:
    """``20_000_000_000`` for ``"20GB"``. Raises ``ConfigError``.

    >>> size_in_bytes("1.5 GiB"), size_in_bytes("20GB"), size_in_bytes(512)
    (1610612736, 20000000000, 512)
    """
    if size is None or (isinstance(size, int) and size >= 0):
        return size
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?I?B?)", str(size).strip().upper())
    if match is None or match[2] not in UNITS:
        raise ConfigError(f"max_cache_size={size!r}: write bytes, or a size such as '20GB' or '500MiB'")
    return int(float(match[1]) * UNITS[match[2]])


class Cache:
    """Shards in part, no more than ``limit`` bytes of them; any number of processes may use one folder.

    Where there is no room, the shard that was asked for the longest ago makes way; what does not fit at all, or cannot
    be written, is not kept. May be pickled and forked.
    """

    def __init__(self, folder: Path, limit: int | None = None) -> None:
        self.folder, self.limit = folder, limit
        self._open: dict[str, _Shard] = {}
        self._warned = False

    @property
    def used(self) -> int:
        """Bytes that are kept, of all shards."""
        return sum(_held(path) for path in self._haves())

    def read(self, key: str, count: int, wanted: Sequence[tuple[int, MemberLocation]]) -> dict[int, memoryview]:
        """Flag to content of those members that are here. ``count``: members of the shard."""
        shard = self._shard(key, count)
        here = [(flag, part) for flag, part in wanted if shard is not None and shard.have[COUNTER + flag]]
        if shard is None or not here:
            return {}
        try:
            # By flag, since members of several samples may be asked for at once.
            content, end = read_members(shard.fd, [part._replace(column=flag) for flag, part in here])
        except OSError:
            return {}
        return content if end is None else {}  # cut off: it has made way for others meanwhile

    def keep(self, key: str, count: int, pieces: Sequence[CachedMember]) -> None:
        """Add members to a shard, unless there is no room for them."""
        try:
            with self._locked():
                self._keep(key, count, pieces)
        except OutputError as error:
            self._warn(str(error))
        except OSError as error:
            remedy = "make room there" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "give another cache_dir"
            self._warn(f"{self.folder}: cannot be written ({error.strerror}): {remedy}")

    def drop(self, key: str, count: int, flag: int, size: int) -> None:
        """Forget a member of ``size`` bytes, which was found to be damaged."""
        with contextlib.suppress(OutputError, OSError), self._locked():
            shard = self._shard(key, count)
            if shard is not None and shard.have[COUNTER + flag]:
                _set(self._have(key), COUNTER + flag, b"\0")
                self._count(key, -size)

    def _keep(self, key: str, count: int, pieces: Sequence[CachedMember]) -> None:
        have = self._made(key, count).have
        fresh = [piece for piece in pieces if not have[COUNTER + piece.flag]]
        size = sum(len(piece.data) for piece in fresh)
        if not fresh or not self._make_room(size, key):
            return
        self._made(key, count)  # it may have been the one to make way
        _write(self._have(key).with_suffix(".tar"), fresh)
        # Counted before it is vouched for: what a kill leaves behind is counted too much, never too little.
        self._count(key, size)
        for piece in fresh:
            _set(self._have(key), COUNTER + piece.flag, b"\1")

    def _make_room(self, size: int, key: str) -> bool:
        """Let shards go until there is room. False where there can be none."""
        if self.limit is None:
            return True
        if size > self.limit:
            self._warn(f"{self.folder}: {size} bytes at once do not fit into {self.limit}: raise max_cache_size")
            return False
        if self._counted() + size <= self.limit:
            return True
        used = self.used
        # Its own shard goes last: what is read now is read on.
        for have in sorted(self._haves(), key=lambda path: (path.stem == key, path.stat().st_mtime_ns)):
            if used + size <= self.limit:
                break
            used -= _held(have)
            self._evict(have)
        for orphan in (self.folder / "shards").glob("*.tar"):  # of a process that was killed in the middle of this
            if not orphan.with_suffix(".have").exists():
                orphan.unlink(missing_ok=True)
        self._write_down(used)
        return True

    def _evict(self, have: Path) -> None:
        """Let a shard go. Cut off first: readers hold it open, and its bytes would stay with them."""
        self._open.pop(have.stem, None)
        have.unlink(missing_ok=True)
        data = have.with_suffix(".tar")
        with contextlib.suppress(FileNotFoundError):
            if not data.is_symlink():
                os.truncate(data, 0)
            data.unlink()

    def _made(self, key: str, count: int) -> "_Shard":
        """The shard's files, made if they were not there. Raises ``OSError`` or ``OutputError``."""
        have = self._have(key)
        if have.exists() and have.stat().st_size != COUNTER + count:  # of other members under the same name
            self._evict(have)
        if not have.exists():
            make_folder(have.parent)
            # Another file, not the same one emptied: whoever holds that still believes it full.
            have.with_suffix(".tar").unlink(missing_ok=True)
            have.with_suffix(".tar").open("xb").close()
            _write_anew(have, bytes(COUNTER + count))  # zeros, no hole: a map over a hole of a full disk is a crash
        return self._shard(key, count) or _Shard(have, count)

    def _shard(self, key: str, count: int) -> "_Shard | None":
        """The shard's files, opened once; ``None`` where there are none."""
        shard = self._open.get(key)
        if shard is not None and not shard.is_gone and len(shard.have) == COUNTER + count:
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

    def _counted(self) -> int:
        """Bytes in use, as last written down."""
        try:
            return int((self.folder / "used").read_text())
        except (OSError, ValueError):
            return self.used

    def _count(self, key: str, size: int) -> None:
        """Count ``size`` bytes more of a shard."""
        total, have = self._counted(), self._have(key)
        # Whatever a kill comes between, the whole is no less than its parts.
        if size > 0:
            self._write_down(total + size)
        _set(have, 0, max(0, _held(have) + size).to_bytes(COUNTER, "little"))
        if size < 0:
            self._write_down(max(0, total + size))

    def _write_down(self, total: int) -> None:
        _write_anew(self.folder / "used", str(total).encode())

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        make_folder(self.folder)
        with locked(self.folder / ".lock", "writing the cache", wait=True):
            yield

    def _warn(self, what: str) -> None:
        if not self._warned:
            log.warning("%s; going on without keeping what is read", what)
        self._warned = True

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": {}}


class _Shard:
    """The files of one shard, open; closed when the last thread lets go of it."""

    def __init__(self, have: Path, count: int) -> None:
        self._path, self._due = have, 0.0
        with have.open("rb") as file:
            self.have = np.memmap(file, np.uint8, "r", shape=(COUNTER + count,))
            self.fd = os.open(have.with_suffix(".tar"), os.O_RDONLY | os.O_NOFOLLOW)
            # No __del__: at the end of the program the module that closes may be gone before the last shard.
            weakref.finalize(self, os.close, self.fd)
            if not os.path.samestat(os.fstat(file.fileno()), have.stat()):
                raise FileNotFoundError(f"{have}: has made way for another, to which the data may belong")

    @property
    def is_gone(self) -> bool:
        """Whether it has made way for others."""
        return os.fstat(self.fd).st_nlink == 0

    def touch(self) -> None:
        """Write down that it is in use, now and then: whoever makes room goes by that."""
        if (now := time.monotonic()) >= self._due:
            self._due = now + TOUCHED_EVERY
            with contextlib.suppress(OSError):  # a cache that may only be read
                os.utime(self._path)


def _held(have: Path) -> int:
    """Bytes of a shard that are kept."""
    try:
        with have.open("rb") as file:
            return int.from_bytes(file.read(COUNTER), "little")
    except FileNotFoundError:
        return 0


def _write_anew(path: Path, content: bytes) -> None:
    """Replace a file under the lock, by a draft that is never a link to another file."""
    draft = path.with_suffix(".tmp")
    draft.unlink(missing_ok=True)
    with draft.open("xb") as file:
        file.write(content)
    draft.replace(path)


def _set(path: Path, place: int, content: bytes) -> None:
    fd = os.open(path, os.O_WRONLY | os.O_NOFOLLOW)
    try:
        os.pwrite(fd, content, place)
    finally:
        os.close(fd)


def _write(path: Path, pieces: Sequence[CachedMember]) -> None:
    fd = os.open(path, os.O_WRONLY | os.O_NOFOLLOW)
    try:
        for _, place, data in pieces:
            while data:
                written = os.pwrite(fd, data, place)
                data, place = data[written:], place + written
    finally:
        os.close(fd)
