"""Where a data set is written: a folder, or a store at a URL of ``fsspec``."""

import contextlib
import hashlib
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from gcd_dataset.errors import ConfigError, OutputError, ShardError, shown
from gcd_dataset.files import make_folder, user_path, write_whole
from gcd_dataset.shards.access import read_file, reading, writing

__all__ = ["FolderPlace", "Place", "UrlPlace", "place_of", "sync_folder"]

VIEWS = "views"
LOCAL = ("file", "local")  # protocols of fsspec for folders
READ_ONLY = ("http", "https", "hf")
AT_ONCE = 32  # requests


class Place(ABC):
    """The files of a data set by their names, ``train-00012.tar`` or ``views/train-00012.tar``.

    A file appears whole under its name or not at all. Methods raise ``OutputError`` and ``ShardError``.
    """

    work: Path
    """Folder of the drafts on this machine."""

    @abstractmethod
    def location(self, name: str = "") -> str:
        """The path or URL of a file, for messages."""

    @abstractmethod
    def names(self) -> frozenset[str]:
        """The names of all files."""

    @abstractmethod
    def exists(self, name: str) -> bool:
        """Whether there is a file of this name."""

    @abstractmethod
    def read(self, names: Iterable[str]) -> Iterator[bytes]:
        """The contents of files, in order."""

    @abstractmethod
    def fetch(self, name: str) -> Path:
        """A file on this machine with the content of ``name``."""

    @abstractmethod
    def write(self, name: str, content: bytes) -> None:
        """Write or replace a small file."""

    @abstractmethod
    def put(self, draft: Path, name: str) -> None:
        """Move a finished draft, synchronised with the disk, to its name; an existing file is replaced."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file if it exists."""


class FolderPlace(Place):
    """A data set in a folder; the drafts are hidden files in it."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = self.work = user_path(folder)

    def location(self, name: str = "") -> str:
        return str(self.folder / name)

    def names(self) -> frozenset[str]:
        return frozenset(_listed(self.folder)) | {f"{VIEWS}/{name}" for name in _listed(self.folder / VIEWS)}

    def exists(self, name: str) -> bool:
        with reading(self.folder / name):
            return (self.folder / name).exists()

    def read(self, names: Iterable[str]) -> Iterator[bytes]:
        return (read_file(self.folder / name) for name in names)

    def fetch(self, name: str) -> Path:
        return self.folder / name

    def write(self, name: str, content: bytes) -> None:
        write_whole(self.folder / name, content)

    def put(self, draft: Path, name: str) -> None:
        path = self.folder / name
        if path.parent != self.folder:
            make_folder(path.parent)
        with writing(path):
            draft.replace(path)
            sync_folder(path.parent)

    def remove(self, name: str) -> None:
        with writing(self.folder / name):
            (self.folder / name).unlink(missing_ok=True)


class UrlPlace(Place):
    """A data set in a store of ``fsspec``; a file is uploaded by one request."""

    def __init__(self, url: str, cache: Path) -> None:
        self._url = url.rstrip("/")
        self.work = cache / "work" / hashlib.sha256(self._url.encode()).hexdigest()[:16]
        self._opened: Any = None
        self._lock = threading.Lock()

    def location(self, name: str = "") -> str:
        return f"{self._url}/{name}" if name else self._url

    def names(self) -> frozenset[str]:
        fs, root = self._store()
        found: set[str] = set()
        for folder, prefix in ((root, ""), (f"{root}/{VIEWS}", f"{VIEWS}/")):
            with self._asking(ShardError), contextlib.suppress(FileNotFoundError):
                entries = fs.ls(folder, detail=True, refresh=True)
                found |= {prefix + entry["name"].rpartition("/")[2] for entry in entries if entry["type"] == "file"}
        return frozenset(found)

    def exists(self, name: str) -> bool:
        fs, root = self._store()
        with self._asking(ShardError):
            fs.invalidate_cache()
            return bool(fs.exists(f"{root}/{name}"))

    def read(self, names: Iterable[str]) -> Iterator[bytes]:
        fs, root = self._store()
        wanted = [f"{root}/{name}" for name in names]
        with self._asking(ShardError):
            for first in range(0, len(wanted), AT_ONCE):
                part = wanted[first : first + AT_ONCE]
                content = fs.cat(part) if len(part) > 1 else {part[0]: fs.cat_file(part[0])}
                yield from (content[fs._strip_protocol(path)] for path in part)

    def fetch(self, name: str) -> Path:
        path = make_folder(self.work / "fetched") / name.replace("/", "-")
        write_whole(path, next(self.read([name])))
        return path

    def write(self, name: str, content: bytes) -> None:
        fs, root = self._store()
        with self._asking(OutputError):
            fs.pipe_file(f"{root}/{name}", content)

    def put(self, draft: Path, name: str) -> None:
        self.write(name, read_file(draft))
        with writing(draft):
            draft.unlink()

    def remove(self, name: str) -> None:
        fs, root = self._store()
        with self._asking(OutputError), contextlib.suppress(FileNotFoundError):
            fs.rm_file(f"{root}/{name}")

    def _store(self) -> tuple[Any, str]:
        import fsspec

        with self._lock:
            if self._opened is None:
                with self._asking(OutputError):
                    self._opened = fsspec.core.url_to_fs(self._url)
            return self._opened

    @contextlib.contextmanager
    def _asking(self, error: type[OutputError | ShardError]) -> Iterator[None]:
        """Turn the errors of a store into ``error``."""
        try:
            yield
        except FileNotFoundError as fault:
            if error is OutputError:
                raise OutputError(f"{self._url}: no such bucket or folder ({fault}): make it first") from fault
            raise
        except (OutputError, ShardError):
            raise
        except Exception as fault:  # each library of a store has errors of its own
            cause = " ".join(f"{type(fault).__name__}: {fault}".split())
            remedy = "check the URL and the rights of its credentials, then give the same command again to continue"
            raise error(f"{self._url}: the store does not answer, or refuses ({cause:.300}): {remedy}") from fault

    def __getstate__(self) -> Mapping[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_opened", "_lock")}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state, _opened=None, _lock=threading.Lock())


def place_of(out: Path | str, cache: Path) -> Place:
    """The place that a path or URL names; ``cache``: folder in which a store's drafts lie.

    Raises ``ConfigError`` for a URL that cannot be written to.
    """
    text = str(out)
    protocol, separator, path = text.partition("://")
    if not separator:
        return FolderPlace(out)
    if protocol in LOCAL:
        return FolderPlace(unquote(path))
    import fsspec

    if protocol in READ_ONLY or "::" in text or not path or protocol not in fsspec.available_protocols():
        raise ConfigError(f"{shown(text)}: cannot be written to: give a folder, or a URL such as s3://BUCKET/PREFIX")
    return UrlPlace(text, cache)


def sync_folder(folder: Path) -> None:
    """Write the entries of a folder to the disk. Raises ``OSError``."""
    file = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def _listed(folder: Path) -> list[str]:
    with reading(folder):
        try:
            return [path.name for path in folder.iterdir()]
        except FileNotFoundError:
            return []
