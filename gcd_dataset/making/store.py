"""A data set in a store of ``fsspec``: S3, Google Cloud Storage and others."""

import contextlib
import hashlib
import threading
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from gcd_dataset.errors import ConfigError, OutputError, ShardError, shown
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.shards.access import read_file, writing
from gcd_dataset.shards.place import VIEWS, FolderPlace, Place

__all__ = ["UrlPlace", "place_of"]

LOCAL = ("file", "local")  # protocols of fsspec for folders
READ_ONLY = ("http", "https", "hf")
AT_ONCE = 32  # requests


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
