"""Atomic file writes, size-limited reads, paths given by users, and names from outside as paths.

System errors become one-line messages. A safe name is one component of a path: it begins with a letter, a digit or
``_``, contains no slash, control character or look-alike of a dot, and leaves room for a file's ending.

>>> safe_name("rand_K3V9QX7T1B"), safe_name("../evil")
('rand_K3V9QX7T1B', '_evil-2d6afc710923')
"""

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import secrets
import stat
import sys
import unicodedata
from collections.abc import Iterator, Sequence
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from gcd_dataset.errors import GcdError, OutputError, ShardError, shown

URL = re.compile(r"[a-z][a-z0-9+-]+:/")  # pathlib turns s3://bucket into s3:/bucket
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

    The writer holds a lock on its draft (``flock``); the next writer of ``path`` takes over the draft of a killed one,
    and writes another beside that of a running one. Raises ``OutputError`` as ``open_whole`` does.
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
    """An empty draft of ``path`` and its locked descriptor. Raises ``OSError``."""
    draft = path.with_name(f".{path.name}.0.part")
    with contextlib.suppress(OSError):  # locked by its writer, of another user, a link, or no locks here
        descriptor = os.open(draft, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(descriptor), os.lstat(draft)):  # else its writer has just renamed it
                os.ftruncate(descriptor, 0)
                return draft, descriptor
            raise BlockingIOError
        except OSError as error:
            if not isinstance(error, BlockingIOError | FileNotFoundError):  # a file system without locks
                draft.unlink()
            os.close(descriptor)
            raise
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    return draft, os.open(draft, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)


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


NAME = re.compile(r"\w[\w .()+-]*")
OTHERS = re.compile(r"[^\w .()+-]+")
LONGEST = 120  # bytes in UTF-8: file systems allow 255, and endings such as _vertex_labels.yaml are appended
HASH = 12  # hexadecimal digits appended to a replaced name, so that different names stay different
LATIN = str.maketrans({"ß": "ss", "æ": "ae", "œ": "oe", "ø": "o", "ł": "l", "đ": "d", "ð": "d", "þ": "th", "ı": "i"})
"""Latin letters that are not a letter and an accent."""
_LETTER = re.compile(r"[A-Za-z0-9]")


def require_name(name: object, source: str) -> str:
    """``name``, the name of a split, a shard or a key in our formats. Raises ``ShardError`` unless it is safe.

    ``source``: the file, and the position in it, for the message.
    """
    if isinstance(name, str) and _is_safe(name):
        return name
    raise ShardError(
        f"{source}: {ascii(name)[:LONGEST]} cannot be a file's name: use letters, digits "
        f"and _ . - ( ) +, at most {LONGEST} bytes, beginning with a letter, a digit or _"
    )


def safe_name(name: str) -> str:
    """``name`` if it is safe as one component of a path, else a similar safe name; deterministic."""
    if _is_safe(name):
        return name
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:HASH]
    stem = OTHERS.sub("_", name).lstrip(" .()+-").encode()[: LONGEST - HASH - 1].decode(errors="ignore")
    return f"{stem or 'unnamed'}-{digest}"


def plain_names(names: Sequence[str], *, longest: int, stem: str = "piece") -> list[str]:
    """The names in printable ASCII, at most ``longest`` characters each, without accents.

    They differ in letters and digits, whatever their case. A name that loses letters, or would be another one's, ends
    in its number, from 1; without a letter left it begins with ``stem``.

    >>> plain_names(["Cós", "cos", "спинка", "back 后"], longest=31)
    ['Cos', 'cos_2', 'piece_3', 'back_4']
    """
    bare = [_without_accents(name) for name in names]
    plain = [" ".join(re.sub(r"[^ -~]", "", re.sub(r"\s", " ", text)).split()) for text in bare]
    whole = [p == b and len(p) <= longest and _LETTER.search(p) for p, b in zip(plain, bare, strict=True)]
    found, taken = [""] * len(names), set[str]()
    for i in sorted(range(len(names)), key=lambda i: not whole[i]):  # complete names are kept
        start = plain[i] if _LETTER.search(plain[i]) else stem
        ends = ([""] if whole[i] else []) + [f"_{i + 1 + turn * len(names)}" for turn in range(len(names) + 1)]
        tries = (start[: longest - len(end)].rstrip() + end for end in ends)
        found[i] = next(name for name in tries if _letters(name) not in taken)
        taken.add(_letters(found[i]))
    return found


def _letters(name: str) -> str:
    return re.sub(r"[^A-Z0-9]", "_", name.upper())


def _without_accents(text: str) -> str:
    text = "".join(c.lower().translate(LATIN).upper() if c.isupper() else c.translate(LATIN) for c in text)
    decomposed = unicodedata.normalize("NFKD", text)
    return "".join(letter for letter in decomposed if not unicodedata.combining(letter))


def _is_safe(name: str) -> bool:
    return NAME.fullmatch(name) is not None and len(name.encode()) <= LONGEST
