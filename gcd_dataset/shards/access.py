"""Access to a data set's files: locks, and OS errors as one-line messages with a remedy."""

import contextlib
import errno
import fcntl
import mmap
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.files import open_regular

REMEDY = "copy it again, or delete it and run gcd generate again"
"""Remedy for a damaged shard: the next writer makes the missing samples again."""

REMEDIES: Mapping[tuple[type[OSError], ...], str] = {
    (PermissionError,): "ask for the right to read it, or give another folder",
    (FileNotFoundError, NotADirectoryError): "give a folder made by gcd generate, or copy the missing files again",
}


class reading:  # noqa: N801 -- a context manager, named as functions are
    """Context that turns ``OSError`` into ``ShardError`` with the file and a remedy."""

    # A class, since it is entered for every garment: ``contextlib.contextmanager`` takes several times as long.
    __slots__ = ("_path",)

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            remedy = next((text for kinds, text in REMEDIES.items() if isinstance(error, kinds)), REMEDY)
            raise ShardError(f"{self._path}: cannot be read ({error.strerror}): {remedy}") from error


def read_file(path: Path, limit: int | None = None) -> bytes:
    """The content of a file. Raises ``ShardError``, for more than ``limit`` bytes before any is read."""
    with reading(path), open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if limit is not None and size > limit:
            raise ShardError(f"{path}: {size} bytes, over the limit of {limit}: {REMEDY}")
        return file.read()


def mapped(path: Path) -> memoryview:
    """The content of a file that no process changes, mapped. Raises ``ShardError``."""
    with reading(path), open_regular(path) as file:
        if not os.fstat(file.fileno()).st_size:
            return memoryview(b"")
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


@contextlib.contextmanager
def writing(path: Path, *, kept: int | None = None) -> Iterator[None]:
    """Turn ``OSError`` into ``OutputError``; ``kept``: whole samples in the file, for the message."""
    note = "" if kept is None else f"; {kept} samples in it are kept"
    try:
        yield
    except OSError as error:
        locked_out = error.errno in (errno.EACCES, errno.EPERM, errno.EROFS)
        remedy = "make it writable" if locked_out else "make room there"
        remedy = "remove this link" if error.errno == errno.ELOOP else f"{remedy} and start again to continue"
        raise OutputError(f"{path}: cannot be written ({error.strerror}){note}: {remedy}") from error


@contextlib.contextmanager
def adding_to(folder: Path) -> Iterator[None]:
    """Turn ``OSError`` into ``OutputError`` for a data set's folder that takes no more files."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({error.strerror}): its samples can be read; to add some, make room and "
            "allow writing, or choose another folder"
        ) from error


@contextlib.contextmanager
def locked(path: Path, task: str, *, wait: bool = False) -> Iterator[None]:
    """Hold an ``flock`` on the file ``path`` during the block. The file is removed at the end; a kill frees the lock.

    ``task``: the work under the lock, for messages. Raises ``OutputError`` where another process holds the lock, unless
    ``wait`` (caused by ``BlockingIOError``); for a folder that cannot be written; on a file system without locks.
    """
    with adding_to(path.parent):
        file, owner = lock_file(path, wait=wait), os.getpid()
    if file is None:
        raise OutputError(
            f"{path.parent}: another process is {task}, or a writer in this process was not closed: wait for it, or "
            "choose another folder"
        ) from BlockingIOError(path)
    try:
        yield
    finally:
        if os.getpid() == owner:  # not in a forked child, which shares the lock
            with contextlib.suppress(OSError):
                path.unlink()
            unlock(file)
        else:
            os.close(file)


def lock_file(path: Path, *, wait: bool) -> int | None:
    """The descriptor of a locked file, created if missing; ``None`` if another process holds the lock, unless ``wait``.

    Raises ``OSError`` for a file that cannot be opened, ``OutputError`` on a file system without locks.
    """
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), path.stat()):
                    return file
        except BlockingIOError:
            os.close(file)
            return None
        except OSError as error:
            os.close(file)
            raise OutputError(
                f"{path}: cannot be locked ({error.strerror}): mount this file system with locks (Lustre: -o flock), "
                "or write to a local disk and copy the folder"
            ) from error
        except BaseException:  # Ctrl-C while waiting
            os.close(file)
            raise
        os.close(file)  # its last holder has renamed or removed it: lock the new file of that name


def unlock(file: int) -> None:
    """Release the lock of a descriptor, and close it."""
    fcntl.flock(file, fcntl.LOCK_UN)  # a child forked meanwhile has the file open too, and would keep the lock
    os.close(file)
