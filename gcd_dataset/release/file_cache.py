"""Cache files with data derived from a published file: beside it, or in ``cache_dir``."""

import hashlib
from pathlib import Path

from gcd_dataset.errors import OutputError
from gcd_dataset.files import make_folder, safe_name, write_whole
from gcd_dataset.shards.access import reading


def cache_path(source: Path, cache_dir: Path | None, ending: str) -> Path:
    """Path of the cache file of ``source``: hidden beside it, or in ``cache_dir`` under a unique name."""
    if cache_dir is None:
        return source.with_name(f".{source.name}.gcd{ending}")
    digest = hashlib.sha256(str(source.resolve()).encode()).hexdigest()[:16]
    return cache_dir / safe_name(f"{source.parent.parent.name}-{source.parent.name}-{source.name}-{digest}{ending}")


def write_cache(path: Path, content: bytes) -> None:
    """Write a cache file, atomically. Raises ``OutputError`` that names ``cache_dir`` as a remedy."""
    try:
        make_folder(path.parent)
        write_whole(path, content)
    except OutputError as error:
        raise OutputError(f"{error}, or give another folder as cache_dir") from error


def file_stamp(source: Path) -> tuple[int, int]:
    """Size and mtime [ns], to detect a changed file. Raises ``ShardError``."""
    with reading(source):
        status = source.stat()
    return status.st_size, status.st_mtime_ns
