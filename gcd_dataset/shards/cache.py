"""The cache of shards: one folder for each, named by the SHA-256 of its tar, and evicted as a whole.

shards/SHA256/tar     the shard of a server, whole and verified
shards/SHA256/views   the tar of its pictures
shards/SHA256/…       columns made from a shard
shards/.SHA256.tar.part, shards/.SHA256.views.part   downloads that are running or were stopped
"""

import contextlib
import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path

from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.files import make_folder, user_path, writing_to
from gcd_dataset.shards.access import unlock

SIZE = "50 GB"
"""The limit of the cache by default."""

EVICTED = ".evicted-"
UNITS = {"": 1, "B": 1} | {
    f"{prefix}{unit}": base ** (power + 1)
    for unit, base in (("B", 1000), ("IB", 1024))
    for power, prefix in enumerate("KMGT")
}
_added: dict[Path, int] = {}
"""Cache to the bytes that this process has added since it last counted all."""


def default_cache(cache_dir: Path | str | None) -> Path:
    """The folder of the cache, by default ``$GCD_CACHE`` or ``~/.cache/gcd_dataset``; its shards are in ``shards``."""
    if cache_dir is None and not (cache_dir := os.environ.get("GCD_CACHE")):
        return Path.home() / ".cache" / "gcd_dataset"
    return user_path(cache_dir)


def size_in_bytes(size: int | str | None) -> int | None:
    """A size with a unit as bytes; ``None``, without a limit, stays ``None``. Raises ``ConfigError``.

    >>> size_in_bytes("1.5 GiB"), size_in_bytes("20GB"), size_in_bytes(512)
    (1610612736, 20000000000, 512)
    """
    if size is None or (isinstance(size, int) and size >= 0):
        return size
    match = re.fullmatch(r"(\d{1,18}(?:\.\d{1,18})?)\s*([KMGT]?I?B?)", str(size).strip().upper())
    if match is None or match[2] not in UNITS:
        raise ConfigError(f"max_cache_size={size!r}: give bytes, or a size such as '20GB' or '500MiB'")
    return int(Decimal(match[1]) * UNITS[match[2]])


def touch(shard: Path) -> None:
    """Mark the folder of a shard as used now."""
    with contextlib.suppress(OSError):  # a read-only cache
        os.utime(shard)


@contextlib.contextmanager
def naming_options() -> Iterator[None]:
    """Name in an ``OutputError`` the options that give another cache."""
    try:
        yield
    except OutputError as error:
        raise OutputError(f"{error}: cache_dir= or GCD_CACHE gives the cache") from error


@contextlib.contextmanager
def filling(shard: Path) -> Iterator[None]:
    """Make the folder of a shard if it is missing; no process evicts it during the block. Raises ``OutputError``."""
    with naming_options(), contextlib.ExitStack() as lock:
        while True:
            make_folder(shard.parent)
            with writing_to(shard), contextlib.suppress(FileNotFoundError):  # evicted before it was locked
                with contextlib.suppress(FileExistsError):
                    shard.mkdir()
                lock.enter_context(_locked(shard, fcntl.LOCK_SH))
                break
        touch(shard)  # evicted last by other machines, which the lock may not reach
        yield


@contextlib.contextmanager
def _locked(path: Path, kind: int) -> Iterator[None]:
    """Hold an ``flock`` on a shard or a download. Raises ``OSError``, also where another process has just moved it."""
    file = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(file, kind)
        if not os.path.samestat(os.fstat(file), path.stat()):
            raise FileNotFoundError(path)
        yield
    finally:
        unlock(file)


def make_room(shards: Path, size: int, limit: int | None) -> None:
    """Evict the least recently used shards, until ``size`` bytes fit into the cache of at most ``limit`` bytes.

    Mapped files stay readable until they are closed. All is counted again after each 1/64 of the limit, so processes
    that fill the cache together may exceed it by that, and by the shards that they fill. Raises ``ConfigError`` for
    more bytes than the limit.
    """
    if limit is None:
        return
    if size > limit:
        raise ConfigError(f"{shards}: {size} bytes at once exceed the limit of {limit}: raise max_cache_size")
    slack = limit >> 6
    if shards in _added and _added[shards] + size <= slack:
        _added[shards] += size
        return
    _added[shards] = size
    entries = sorted((*_use_of(path), path) for path in _entries(shards))
    total = size + sum(held for _, held, _ in entries)
    for _, held, path in entries:
        if total <= limit - slack:
            break
        total -= held if _evict(path) else 0


def _entries(shards: Path) -> list[Path]:
    """Folders of shards and stopped downloads; removes what a killed eviction has left."""
    found = []
    with writing_to(shards):
        for path in shards.iterdir() if shards.is_dir() else ():
            if path.name.startswith(EVICTED):
                shutil.rmtree(path, ignore_errors=True)
            elif path.is_dir() or path.suffix == ".part":
                found.append(path)
    return found


def _use_of(path: Path) -> tuple[int, int]:
    """Time of the last use [ns] and bytes of a shard; zeros where another process has just evicted it."""
    with contextlib.suppress(OSError):
        files = list(path.iterdir()) if path.is_dir() else [path]
        return path.stat().st_mtime_ns, sum(file.stat().st_size for file in files)
    return 0, 0


def _evict(path: Path) -> bool:
    """Remove a shard that no process fills, or a download that none continues; whether its bytes are gone."""
    with contextlib.suppress(OSError), _locked(path, fcntl.LOCK_EX | fcntl.LOCK_NB):
        if path.is_dir():
            # Renamed first: another process finds the whole folder, or none.
            shutil.rmtree(path.rename(path.with_name(EVICTED + path.name)), ignore_errors=True)
        else:
            path.unlink()
        return True
    return path.suffix != ".part" and not path.exists()  # a download may have become a file of its shard
