"""Access to the files of a data set: where it is written, locks, and OS errors as one-line messages with a remedy."""

import contextlib
import errno
import fcntl
import mmap
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.files import make_folder, open_regular, user_path, write_whole

REMEDY = "copy it again, or delete it and run gcd generate again"
"""Remedy for a damaged shard: the next writer makes the missing samples again."""

REMEDIES: Mapping[tuple[type[OSError], ...], str] = {
    (PermissionError,): "ask for the right to read it, or give another folder",
    (FileNotFoundError, NotADirectoryError): "give a folder made by gcd generate, or copy the missing files again",
}


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn ``OSError`` into ``ShardError`` with the file and a remedy."""
    try:
        yield
    except OSError as error:
        remedy = next((text for kinds, text in REMEDIES.items() if isinstance(error, kinds)), REMEDY)
        raise ShardError(f"{path}: cannot be read ({error.strerror}): {remedy}") from error


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
def locked(path: Path, task: str, *, wait: bool = False) -> Iterator[None]:
    """Hold an ``flock`` on the file ``path`` during the block. The file is removed at the end; a kill frees the lock.

    ``task``: the work under the lock, for messages. Raises ``OutputError`` where another process holds the lock, unless
    ``wait`` (caused by ``BlockingIOError``); for a folder that cannot be written; on a file system without locks.
    """
    with writing(path.parent):
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


VIEWS = "views"


class Place:
    """The files of a data set by their names, ``train-00012.tar`` or ``views/train-00012.tar``: those in a folder.

    ``gcd_dataset.making.store`` has another, in an object store.

    A file appears whole under its name or not at all. Methods raise ``OutputError`` and ``ShardError``.
    """

    is_folder = True
    work: Path
    """Folder of the drafts on this machine: of a folder itself, where they are hidden files."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = self.work = user_path(folder)

    def location(self, name: str = "") -> str:
        """The path or URL of a file, for messages."""
        return str(self.folder / name)

    def names(self) -> frozenset[str]:
        """The names of all files."""
        return frozenset(_listed(self.folder)) | {f"{VIEWS}/{name}" for name in _listed(self.folder / VIEWS)}

    def exists(self, name: str) -> bool:
        """Whether there is a file of this name."""
        with reading(self.folder / name):
            return (self.folder / name).exists()

    def read(self, names: Iterable[str]) -> Iterator[bytes]:
        """The contents of files, in order."""
        return (read_file(self.folder / name) for name in names)

    def fetch(self, name: str) -> Path:
        """A file on this machine with the content of ``name``."""
        return self.folder / name

    def remove_fetched(self) -> None:
        """Remove the copies that ``fetch`` has made; a folder makes none."""

    def write(self, name: str, content: bytes) -> None:
        """Write or replace a small file."""
        write_whole(self.folder / name, content)

    def put(self, draft: Path, name: str) -> None:
        """Move a finished draft, synchronised with the disk, to its name; an existing file is replaced."""
        path = self.folder / name
        if path.parent != self.folder:
            make_folder(path.parent)
        with writing(path):
            draft.replace(path)
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)  # writes its entries to the disk
            finally:
                os.close(folder)

    def remove(self, name: str) -> None:
        """Remove a file if it exists."""
        with writing(self.folder / name):
            (self.folder / name).unlink(missing_ok=True)


def _listed(folder: Path) -> list[str]:
    with reading(folder):
        try:
            return os.listdir(folder)  # noqa: PTH208 -- objects of thousands of paths take three times as long
        except FileNotFoundError:
            return []
