"""Caches of a server's bytes behind one interface: our ``hub.cache``, ``diskcache`` and both of ``fsspec``.

The server is a folder of shards. A sample has ten members, of which a training reads three: 28 % of the bytes.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import diskcache
import fsspec
import numpy as np
from fsspec.spec import AbstractBufferedFile

from gcd_dataset.hub.cache import Cache, CachedMember
from gcd_dataset.shards.store import MemberLocation

__all__ = ["CACHES", "COLUMNS", "SAMPLES", "SHARDS", "MemberCache", "Server", "disk_use", "expected", "write_shards"]

SIZES = (300, 2_000, 3_000, 8_000, 1_000, 60_000, 30_000, 90_000, 40_000, 700)
"""Size of each member of a sample [bytes]."""
COLUMNS = (1, 2, 5)
"""Numbers of the members that a training reads."""
SHARDS, SAMPLES = 6, 64
STARTS = np.cumsum([0, *SIZES]).tolist()
SHARD_BYTES = SAMPLES * STARTS[-1]


def write_shards(folder: Path) -> Path:
    """Write the server's shards, filled with random bytes, to ``folder``."""
    for shard in range(SHARDS):
        (folder / f"{shard}.tar").write_bytes(np.random.default_rng(shard).bytes(SHARD_BYTES))
    return folder


def expected(folder: Path, shard: int, sample: int) -> list[bytes]:
    """The ``COLUMNS`` members of a sample, read from the server without a cache."""
    server = Server(folder)
    return [server.get(shard, *_span(sample, column)) for column in COLUMNS]


def disk_use(folder: Path) -> int:
    """Bytes that the files below a folder occupy; holes do not count."""
    return sum(path.stat().st_blocks * 512 for path in folder.rglob("*") if path.is_file())


def _span(sample: int, column: int) -> tuple[int, int]:
    start = sample * STARTS[-1] + STARTS[column]
    return start, start + SIZES[column]


class Server:
    """A folder of shards that counts the bytes it sends."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.sent = folder, 0

    def get(self, shard: int, start: int, end: int) -> bytes:
        """A range of a shard."""
        with (self.folder / f"{shard}.tar").open("rb") as file:
            file.seek(start)
            content = file.read(end - start)
        self.sent += len(content)
        return content


class MemberCache(ABC):
    """A cache in a folder; ``limit``: bytes that it may hold, for libraries that support a limit."""

    def __init__(self, folder: Path, server: Server, limit: int | None = None) -> None:
        self.folder, self.server, self.limit = folder, server, limit

    @abstractmethod
    def read(self, shard: int, sample: int) -> Sequence[Any]:
        """The members of a sample, fetched where they are not in the cache."""


class OwnCache(MemberCache):
    """``gcd_dataset.hub.cache``: one sparse file per shard, one status byte per member, eviction of whole shards."""

    def __init__(self, folder: Path, server: Server, limit: int | None = None) -> None:
        super().__init__(folder, server, limit)
        self._cache = Cache(folder, limit)

    def read(self, shard: int, sample: int) -> Sequence[Any]:
        key, count, wanted = f"{shard}", SAMPLES * len(SIZES), []
        for column in COLUMNS:
            start, end = _span(sample, column)
            wanted.append((sample * len(SIZES) + column, MemberLocation(column, start, end - start, 0)))
        found: dict[int, Any] = self._cache.read(key, count, wanted)
        fetched = [
            CachedMember(flag, part.offset, memoryview(self.server.get(shard, part.offset, part.end)))
            for flag, part in wanted
            if flag not in found
        ]
        if fetched:
            self._cache.keep(key, count, fetched)
            found |= {piece.flag: piece.data for piece in fetched}
        return [found[flag] for flag, _ in wanted]


class DiskCache(MemberCache):
    """``diskcache``: SQLite, with a separate file for each value of 32 KB or more."""

    def __init__(self, folder: Path, server: Server, limit: int | None = None) -> None:
        super().__init__(folder, server, limit)
        self._cache = diskcache.Cache(str(folder), size_limit=limit or 1 << 40)

    def read(self, shard: int, sample: int) -> Sequence[Any]:
        return [self._member(shard, *_span(sample, column)) for column in COLUMNS]

    def _member(self, shard: int, start: int, end: int) -> Any:
        content = self._cache.get((shard, start))
        if content is None:
            content = self.server.get(shard, start, end)
            self._cache.set((shard, start), content)
        return content


class FsspecCache(MemberCache):
    """``fsspec``'s ``blockcache`` (sparse files of blocks) or ``filecache`` (whole shards). Neither has a limit."""

    def __init__(
        self, folder: Path, server: Server, limit: int | None = None, *, protocol: str, block: int = 5 << 20
    ) -> None:
        super().__init__(folder, server, limit)
        served = _Served(server, block)
        self._files = fsspec.filesystem(protocol, fs=served, cache_storage=str(folder), skip_instance_cache=True)

    def read(self, shard: int, sample: int) -> Sequence[Any]:
        with self._files.open(f"{shard}.tar", "rb") as file:
            return [self._member(file, *_span(sample, column)) for column in COLUMNS]

    @staticmethod
    def _member(file: Any, start: int, end: int) -> bytes:
        file.seek(start)
        content: bytes = file.read(end - start)
        return content


class _Served(fsspec.AbstractFileSystem):  # type: ignore[misc]
    """The server as a file system."""

    protocol = "served"
    cachable = False

    def __init__(self, server: Server, block: int) -> None:
        super().__init__()
        self.server, self.block = server, block

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        return {"name": path, "size": SHARD_BYTES, "type": "file"}

    def _open(self, path: str, mode: str = "rb", block_size: int | None = None, **options: Any) -> Any:
        return _ServedFile(self, path, mode, self.block, **{"cache_type": "none", **options})

    def get_file(self, rpath: str, lpath: str, **_: Any) -> None:
        Path(lpath).write_bytes(self.server.get(int(Path(rpath).stem), 0, SHARD_BYTES))


class _ServedFile(AbstractBufferedFile):  # type: ignore[misc]
    def _fetch_range(self, start: int, end: int) -> bytes:
        content: bytes = self.fs.server.get(int(Path(self.path).stem), start, end)
        return content


CACHES: Mapping[str, Callable[..., MemberCache]] = {
    "hub.cache": OwnCache,
    "diskcache": DiskCache,
    "fsspec blockcache": partial(FsspecCache, protocol="blockcache"),
    "fsspec blockcache 64 KiB": partial(FsspecCache, protocol="blockcache", block=1 << 16),
    "fsspec filecache": partial(FsspecCache, protocol="filecache"),
}
