"""Atomic file writes, size-limited reads, and paths given by users; system errors become one-line messages."""

import contextlib
import errno
import fcntl
import os
import re
import secrets
import stat
import sys
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from gcd_dataset.errors import GcdError, OutputError, shown

URL = re.compile(r"[a-z][a-z0-9+-]+:/")  # pathlib turns s3://bucket into s3:/bucket
DRAFTS = 8  # numbered draft names for one target; further concurrent writers use random names
REMEDIES = {
    "make room there, or choose another folder": (errno.ENOSPC, errno.EDQUOT, errno.EFBIG),
    "choose a folder that you may write to": (errno.EACCES, errno.EPERM, errno.EROFS),
    "choose another name": (
        errno.EEXIST,
        errno.EISDIR,
        errno.ENOTDIR,
        errno.ENOTEMPTY,
        errno.ENAMETOOLONG,
        errno.ELOOP,
    ),
    "make its folder first": (errno.ENOENT,),
}
REMEDY_OF = {code: remedy for remedy, codes in REMEDIES.items() for code in codes}
OTHER_FILES = {
    stat.S_IFDIR: (errno.EISDIR, "Is a directory"),
    stat.S_IFIFO: (errno.ESPIPE, "a pipe, not a file"),
    stat.S_IFSOCK: (errno.ENXIO, "a socket, not a file"),
}
"""Type of a path to the error of opening it as a file."""


def read_whole(path: Path | str, kind: str, *, limit: int, error: type[GcdError]) -> bytes:
    """All bytes of a file.

    Raises ``error`` if it is missing, unreadable or larger than ``limit`` bytes; the message asks for a ``kind``.
    """
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size  # may grow meanwhile, so the read is limited too
            content = file.read(limit + 1) if size <= limit else b""
    except FileNotFoundError as cause:
        raise error(f"{path}: no such file: give the path of a {kind}") from cause
    except PermissionError as cause:
        raise error(f"{path}: cannot be read ({cause.strerror}): ask for the right to read it") from cause
    except OSError as cause:
        raise error(f"{path}: cannot be read ({cause.strerror}): give the path of a {kind}") from cause
    except ValueError as cause:  # a null byte in the path
        raise error(f"{shown(str(path))}: names no file: give the path of a {kind}") from cause
    if max(size, len(content)) > limit:
        raise error(f"{path}: more than {limit >> 20} MB: give the path of a {kind}")
    return content


def open_regular(path: Path | str) -> BufferedReader:
    """A file open for reading.

    Raises ``OSError``, also for a pipe, a socket, a device or a folder: opening a pipe would wait for its writer.
    """
    mode = stat.S_IFMT(Path(path).stat().st_mode)
    if mode != stat.S_IFREG:
        number, fault = OTHER_FILES.get(mode, (errno.ENODEV, "a device, not a file"))
        raise OSError(number, fault, str(path))
    return Path(path).open("rb")


def write_whole(path: Path | str, content: bytes) -> None:
    """Write ``content`` to ``path`` atomically. Raises ``OutputError``; an existing file is then unchanged."""
    with open_whole(path) as file:
        file.write(content)


@contextlib.contextmanager
def open_whole(path: Path | str, *, synced: bool = True) -> Iterator[BinaryIO]:
    """A file open for writing, renamed to ``path`` when the block succeeds and deleted when it raises.

    Without ``synced`` it may be lost, or be shorter, after a power failure. Raises ``OutputError`` with the
    file, the system's reason and a remedy.
    """
    with drafted(path, synced=synced) as draft, draft.open("wb") as file:
        yield file


@contextlib.contextmanager
def drafted(path: Path | str, *, synced: bool = True) -> Iterator[Path]:
    """Path of an empty draft file, renamed to ``path`` when the block succeeds and deleted when it raises.

    The writer holds a lock on its draft (``flock``). The next writer of ``path`` deletes unlocked drafts, left behind
    by killed writers; on file systems without locks they stay. Raises ``OutputError`` as ``open_whole`` does.
    """
    path = Path(path)
    if not path.name or "\0" in str(path):
        raise OutputError(f"{shown(str(path))}: names no file: give a file name")
    with writing_to(path):
        draft, descriptor = _begin_draft(path)
        try:
            yield draft
            if synced:
                with draft.open("rb+") as file:
                    os.fsync(file.fileno())
            draft.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
            raise
        finally:
            os.close(descriptor)


def _begin_draft(path: Path) -> tuple[Path, int]:
    """An empty draft of ``path`` and its locked descriptor; deletes drafts of dead writers. Raises ``OSError``."""
    chosen: tuple[Path, int] | None = None
    for number in range(DRAFTS):
        draft = path.with_name(f".{path.name}.{number}.part")
        if chosen is not None and not os.path.lexists(draft):
            continue
        descriptor = _lock_draft(draft)
        if descriptor is None:
            continue
        if chosen is None:
            os.ftruncate(descriptor, 0)
            chosen = draft, descriptor
        else:
            with contextlib.suppress(OSError):
                draft.unlink()
            os.close(descriptor)
    if chosen is None:
        draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
        chosen = draft, os.open(draft, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    return chosen


def _lock_draft(draft: Path) -> int | None:
    """Descriptor of the draft, created if missing, with a lock; ``None`` if another writer has it or locks fail.

    Raises ``OSError`` for a folder that cannot be written.
    """
    try:
        descriptor = os.open(draft, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError:
        if os.path.lexists(draft):  # owned by another user, or not a regular file
            return None
        raise
    with contextlib.suppress(BlockingIOError, FileNotFoundError):  # locked by its writer, or just renamed by it
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:  # no locks on this file system
            draft.unlink()
        else:
            if os.path.samestat(os.fstat(descriptor), os.lstat(draft)):
                return descriptor
    os.close(descriptor)
    return None


def make_folder(path: Path | str) -> Path:
    """The folder, created with its parents if missing. Raises ``OutputError``."""
    path = Path(path)
    if "\0" in str(path):
        raise OutputError(f"{shown(str(path))}: names no folder: give a folder name")
    if URL.match(str(path)):
        raise OutputError(
            f"{shown(str(path))}: a URL, but a local folder is needed: give a folder; functions that accept URLs "
            "expect them as str, not as Path"
        )
    with writing_to(path):
        path.mkdir(parents=True, exist_ok=True)
    return path


def user_path(path: Path | str) -> Path:
    """The path with a leading ``~`` or ``~USER`` expanded, if that user exists."""
    try:
        return Path(path).expanduser()
    except RuntimeError:  # no such user: a file name that begins with ~
        return Path(path)


@contextlib.contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Turn ``OSError`` into an ``OutputError`` with the file or folder, the system's reason and a remedy."""
    try:
        yield
    except OSError as error:
        remedy = REMEDY_OF.get(error.errno or 0, "choose another folder")
        raise OutputError(f"{path}: cannot be written ({error.strerror or error}): {remedy}") from error


def discard_stdout() -> None:
    """Discard what is printed from now on: the reader of stdout has exited, and the flush at exit would fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
