"""The place of a data set that a user names: a folder, or a store of ``fsspec`` such as S3 or Google Cloud Storage."""

import contextlib
import hashlib
import logging
import re
import shutil
import threading
import time
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from gcd_dataset.errors import ConfigError, OutputError, ShardError, shown
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.shards.access import Place, read_file, writing
from gcd_dataset.shards.cache import default_cache
from gcd_dataset.shards.manifest import MANIFEST
from gcd_dataset.shards.notes import shards_named

LOCAL = ("file", "local")  # protocols of fsspec for folders
READ_ONLY = ("http", "https", "hf")
AT_ONCE = 32  # requests
SLOW = 30.0  # s without an answer before a warning
NAMED = 3  # files named in a message
OURS = re.compile(r"\..*|views|mesh-.+|.+\.index|rejects\.jsonl|.+-\d{5,}\.json")
"""Files of a data set, besides its shards and its manifest."""

logger = logging.getLogger("gcd_dataset")


def place_for(out: Path | str) -> Place:
    """The folder or store that a user names. Raises ``ConfigError`` for a URL that cannot be written to.

    Logs a warning before a new data set is written into a folder with other files.
    """
    protocol, separator, path = str(out).partition("://")
    if not separator or protocol in LOCAL:
        place = Place(unquote(path) if separator else out)
        _warn_of_others(place)
        return place
    import fsspec

    if protocol in READ_ONLY or "::" in path or not path or protocol not in fsspec.available_protocols():
        raise ConfigError(
            f"{shown(str(out))}: cannot be written to: give a folder, or a URL such as s3://BUCKET/PREFIX"
        )
    return UrlPlace(str(out))


def _warn_of_others(place: Place) -> None:
    names = sorted(name for name in place.names() if "/" not in name) if place.folder.is_dir() else []
    others = [shown(name) for name in names if not OURS.fullmatch(name)]
    if others and MANIFEST not in names and not shards_named(names):
        named = ", ".join(others[:NAMED]) + (f" and {len(others) - NAMED} more" if len(others) > NAMED else "")
        logger.warning("%s: holds other files (%s), which stay beside the data set: right folder?", place.folder, named)


class UrlPlace(Place):
    """A data set in a store of ``fsspec``; a file is uploaded by one request."""

    is_folder = False

    def __init__(self, url: str) -> None:  # of no folder
        self._url = url.rstrip("/")
        self.work = default_cache(None) / "work" / hashlib.sha256(self._url.encode()).hexdigest()[:16]

    def location(self, name: str = "") -> str:
        return f"{self._url}/{name}" if name else self._url

    def names(self) -> frozenset[str]:
        with self._asking(ShardError) as (fs, root):
            fs.invalidate_cache()
            return frozenset(path.removeprefix(f"{root}/") for path in fs.find(root, maxdepth=2))

    def exists(self, name: str) -> bool:
        with self._asking(ShardError) as (fs, root):
            fs.invalidate_cache()
            return bool(fs.exists(f"{root}/{name}"))

    def read(self, names: Iterable[str]) -> Iterator[bytes]:
        waiting = iter(names)
        while part := list(islice(waiting, AT_ONCE)):
            with self._asking(ShardError) as (fs, root):
                content = fs.cat([f"{root}/{name}" for name in part])
            yield from (content[f"{root}/{name}"] for name in part)

    def fetch(self, name: str) -> Path:
        path = make_folder(self.work / "fetched") / name.replace("/", "-")
        write_whole(path, next(self.read([name])))
        return path

    def remove_fetched(self) -> None:
        shutil.rmtree(self.work / "fetched", ignore_errors=True)

    def write(self, name: str, content: bytes) -> None:
        with self._asking(OutputError) as (fs, root):
            fs.pipe_file(f"{root}/{name}", content)

    def put(self, draft: Path, name: str) -> None:
        self.write(name, read_file(draft))
        with writing(draft):
            draft.unlink()

    def remove(self, name: str) -> None:
        with self._asking(OutputError) as (fs, root), contextlib.suppress(FileNotFoundError):
            fs.rm_file(f"{root}/{name}")

    @contextlib.contextmanager
    def _asking(self, error: type[OutputError | ShardError]) -> Iterator[tuple[Any, str]]:
        """The file system of the store, and the path in it; turns its errors into ``error``.

        How long a request is tried is up to the store's library; after ``SLOW`` a warning is logged.
        """
        import fsspec

        message = f"{self._url}: no answer for {SLOW:.0f} s; still trying, and Ctrl-C stops: finished shards are kept"
        begun, timer = time.monotonic(), threading.Timer(SLOW, logger.warning, [message])
        timer.daemon = True
        timer.start()
        try:
            yield fsspec.core.url_to_fs(self._url)
        except FileNotFoundError as fault:
            raise error(f"{self._url}: no such bucket, folder or file ({fault}): make it first") from fault
        except Exception as fault:  # each library of a store has errors of its own
            cause = f"{type(fault).__name__}: {fault}; tried for {time.monotonic() - begun:.0f} s"
            raise error(
                f"{self._url}: the store does not answer, or refuses ({' '.join(cause.split()):.300}): check the URL "
                "and the rights of its credentials, then give the same command again to continue"
            ) from fault
        finally:
            timer.cancel()
