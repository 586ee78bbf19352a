"""Access to a data set's files: one writer at a time, and what the system refuses as one line with the way out."""

import contextlib
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from gcd_dataset.errors import OutputError, ShardError

__all__ = ["REMEDY", "locked", "read_small", "reading", "writing"]

REMEDY = "copy it again, or delete it and run gcd generate again"
"""What to do about a damaged shard: the next writer makes again what is missing."""


class reading:  # noqa: N801 -- a context manager, named as functions are
    """Turn the system's errors into a ``ShardError``."""

    # A class: entered for every garment, where a generator would take several times as long.
    __slots__ = ("_path",)

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            raise ShardError(f"{self._path}: cannot be read ({error.strerror}): {_way_out(error)}") from error


def read_small(path: Path, most: int) -> bytes:
    """The content of a file of no more than ``most`` bytes. Raises ``ShardError``."""
    with reading(path), path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise ShardError(f"{path}: {size} bytes, where {most} are read: {REMEDY}")
        return file.read()


def _way_out(error: OSError) -> str:
    """What to do about a file that cannot be read."""
    if isinstance(error, PermissionError):
        return "have yourself allowed to read it, or give another folder"
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return "give a folder that gcd generate has made, or copy what is missing again"
    return REMEDY


@contextlib.contextmanager
def writing(path: Path, *, kept: int | None = None) -> Iterator[None]:
    """Turn the system's errors into an ``OutputError``; ``kept`` samples are in the file."""
    there = "" if kept is None else f"; {kept} samples in it are kept"
    try:
        yield
    except OSError as error:
        is_link = error.errno == errno.ELOOP
        remedy = "remove this link" if is_link else "make room there and start again to go on"
        raise OutputError(f"{path}: cannot be written ({error.strerror}){there}: {remedy}") from error


@contextlib.contextmanager
def locked(path: Path, task: str, *, wait: bool = False) -> Iterator[None]:
    """Hold the lock file ``path`` while the block runs; it goes with the lock, and a kill frees it.

    Raises ``OutputError``: where another holds it for the same ``task``, unless this is to ``wait``; in a folder that
    cannot be written; on a file system without locks.
    """
    file, owner = _lock(path, task, wait), os.getpid()
    try:
        yield
    finally:
        if os.getpid() == owner:  # a forked process that drops its copy frees nothing
            with contextlib.suppress(OSError):
                path.unlink()
            # Not by closing alone: a process that was forked meanwhile has it open too, and would be waited for.
            fcntl.flock(file, fcntl.LOCK_UN)
        os.close(file)


def _lock(path: Path, task: str, wait: bool) -> int:
    """The file, ours alone."""
    while True:
        file = _open(path)
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(file).st_nlink:
                return file
        except BlockingIOError as error:
            os.close(file)
            raise OutputError(
                f"{path.parent}: another process is {task}, or a writer in this one was not closed: wait for it, or "
                "choose another folder"
            ) from error
        except OSError as error:
            os.close(file)
            raise OutputError(
                f"{path}: cannot be locked ({error.strerror}): mount this file system with locks (Lustre: -o flock), "
                "or write to a local disk and copy the folder"
            ) from error
        os.close(file)  # whoever held it has just removed it: what we hold is not what others will find


def _open(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise OutputError(
            f"{path.parent}: cannot be written ({error.strerror}): what is there can be read; to add to it, make room "
            "and allow writing, or choose another folder"
        ) from error
