"""Shards that have been found to have the hash that was published: remembered, so that none is read twice for it."""

import contextlib
import hashlib
import json
import threading
from pathlib import Path
from typing import Any

from gcd_dataset.files import write_whole
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.manifest import ShardRecord

__all__ = ["CheckedShards"]


class CheckedShards:
    """Of a split in ``folder``: hash, bytes and time of change of each, kept in ``.checked-SPLIT.json``.

    May be used by several threads of the process that brings the split.
    """

    def __init__(self, folder: Path, split: str) -> None:
        self._folder, self._path = folder, folder / f".checked-{require_name(split, 'split')}.json"
        self._known, self._lock = _read(self._path), threading.Lock()

    def holds(self, shard: ShardRecord) -> bool:
        """Whether the shard is there with the bytes that were published: hashed unless it is as it was when it was.

        Raises ``ShardError`` for one that cannot be read.
        """
        path = self._folder / shard.name
        with reading(path):
            if not path.exists() or path.stat().st_size != shard.size:
                return False
            if self._known.get(shard.name) == _state(path, shard.sha256):
                return True
            with path.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != shard.sha256:
                    return False
        self.remember(shard)
        return True

    def remember(self, shard: ShardRecord) -> None:
        """Note that the file has been found to have the hash in ``shard``. Raises ``OutputError``."""
        with self._lock:
            self._known[shard.name] = _state(self._folder / shard.name, shard.sha256)
            write_whole(self._path, json.dumps(self._known, indent=0).encode())


def _state(path: Path, sha256: str) -> list[Any]:
    there = path.stat()
    return [sha256, there.st_size, there.st_mtime_ns]


def _read(path: Path) -> dict[str, Any]:
    """What is remembered; nothing where that cannot be read: all is hashed again then."""
    with contextlib.suppress(OSError, ValueError):
        if isinstance(known := json.loads(path.read_bytes()), dict):
            return known
    return {}
