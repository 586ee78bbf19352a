"""A record of shards with verified hashes, so that no shard is hashed twice."""

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
    """SHA-256, size and mtime of the verified shards of a split, stored in ``.checked-SPLIT.json``. Thread-safe."""

    def __init__(self, folder: Path, split: str) -> None:
        self._folder, self._path = folder, folder / f".checked-{require_name(split, 'split')}.json"
        self._known, self._lock = _read(self._path), threading.Lock()

    def holds(self, shard: ShardRecord) -> bool:
        """Whether the shard is on disk with the published hash. Hashes it unless size and mtime match the record.

        Raises ``ShardError`` for a file that cannot be read.
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
        """Record the file as verified. Raises ``OutputError``."""
        with self._lock:
            self._known[shard.name] = _state(self._folder / shard.name, shard.sha256)
            write_whole(self._path, json.dumps(self._known, indent=0).encode())


def _state(path: Path, sha256: str) -> list[Any]:
    status = path.stat()
    return [sha256, status.st_size, status.st_mtime_ns]


def _read(path: Path) -> dict[str, Any]:
    """The stored record; empty where it cannot be read, so that all shards are hashed again."""
    with contextlib.suppress(OSError, ValueError):
        if isinstance(known := json.loads(path.read_bytes()), dict):
            return known
    return {}
