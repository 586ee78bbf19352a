"""Files written whole or not at all, and the folders that users name."""

import contextlib
import errno
import fcntl
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from gcd_dataset.errors import GcdError, OutputError, shown

__all__ = ["drafted", "make_folder", "open_whole", "read_whole", "user_path", "write_whole", "writing_to"]

URL = re.compile(r"[a-z][a-z0-9+-]+:/")  # what a path keeps of s3://bucket
DRAFTS = 8  # names of drafts that the writers of one file share; more writers at once take names by chance
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


def read_whole(path: Path | str, kind: str, *, limit: int, error: type[GcdError]) -> bytes:
    """All bytes of a file. Raises ``error``, which asks for a ``kind``, where it is missing or over ``limit`` bytes."""
    try:
        with Path(path).open("rb") as file:
            size = os.fstat(file.fileno()).st_size  # of a device 0
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


def write_whole(path: Path | str, content: bytes) -> None:
    """``content`` in ``path``. Raises ``OutputError`` where that fails; what stood there before then still does."""
    with open_whole(path) as file:
        file.write(content)


@contextlib.contextmanager
def open_whole(path: Path | str) -> Iterator[BinaryIO]:
    """A file open for writing that takes the name ``path`` when the block ends well, and vanishes when it does not.

    Raises ``OutputError`` with the file, the system's reason and a remedy.
    """
    with drafted(path) as draft, draft.open("wb") as file:
        yield file


@contextlib.contextmanager
def drafted(path: Path | str) -> Iterator[Path]:
    """An empty file to fill; it takes the name ``path`` when the block ends well, else it vanishes.

    Its writer holds a lock on it (``flock``), so that the drafts of killed writers are told from those of living ones:
    the next writer of ``path`` removes them, except on file systems without locks. Raises ``OutputError`` as
    ``open_whole`` does.
    """
    path = Path(path)
    if not path.name or "\0" in str(path):
        raise OutputError(f"{shown(str(path))}: names no file: give a file name")
    with writing_to(path):
        draft, held = _begin_draft(path)
        try:
            yield draft
            with draft.open("rb+") as file:
                os.fsync(file.fileno())
            draft.replace(path)
        finally:
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
            os.close(held)


def _begin_draft(path: Path) -> tuple[Path, int]:
    """An empty draft of ``path`` and its locked descriptor; drafts of dead writers go. Raises ``OSError``."""
    ours: tuple[Path, int] | None = None
    for number in range(DRAFTS):
        draft = path.with_name(f".{path.name}.{number}.part")
        if ours is not None and not os.path.lexists(draft):
            continue
        held = _claimed(draft)
        if held is None:
            continue
        if ours is None:
            os.ftruncate(held, 0)
            ours = draft, held
        else:
            with contextlib.suppress(OSError):
                draft.unlink()
            os.close(held)
    if ours is None:
        draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
        ours = draft, os.open(draft, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    return ours


def _claimed(draft: Path) -> int | None:
    """The draft, made if need be, open and locked; ``None`` where it is another's, or cannot be locked.

    Raises ``OSError`` for a folder that cannot be written.
    """
    try:
        file = os.open(draft, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError:
        if os.path.lexists(draft):  # another user's, or no file
            return None
        raise
    with contextlib.suppress(BlockingIOError, FileNotFoundError):  # in work, or just finished by its writer
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:  # no locks on this file system
            draft.unlink()
        else:
            if os.path.samestat(os.fstat(file), os.lstat(draft)):
                return file
    os.close(file)
    return None


def make_folder(path: Path | str) -> Path:
    """The folder, made with its parents if it was not there. Raises ``OutputError``."""
    path = Path(path)
    if "\0" in str(path):
        raise OutputError(f"{shown(str(path))}: names no folder: give a folder name")
    if URL.match(str(path)):
        raise OutputError(
            f"{shown(str(path))}: a URL, where a folder of this machine is written: give a folder, or, where URLs are "
            "taken, the URL as text"
        )
    with writing_to(path):
        path.mkdir(parents=True, exist_ok=True)
    return path


def user_path(path: Path | str) -> Path:
    """The path that a user has written: a ``~`` or ``~USER`` at its beginning is that home, where there is one."""
    try:
        return Path(path).expanduser()
    except RuntimeError:  # nobody is called so: a plain name that begins with it
        return Path(path)


@contextlib.contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Turn the system's errors into an ``OutputError`` with the file or folder, the system's reason and a remedy."""
    try:
        yield
    except OSError as error:
        remedy = REMEDY_OF.get(error.errno or 0, "choose another folder")
        raise OutputError(f"{path}: cannot be written ({error.strerror or error}): {remedy}") from error
