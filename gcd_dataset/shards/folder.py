"""A data set in a local folder."""

import hashlib
import os
import shlex
import weakref
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ShardError
from gcd_dataset.filekinds import is_published
from gcd_dataset.files import user_path
from gcd_dataset.shards.access import read_file, reading
from gcd_dataset.shards.buffers import read_buffer
from gcd_dataset.shards.cache import default_cache
from gcd_dataset.shards.index import SplitIndex, index_name
from gcd_dataset.shards.layout import LARGEST_FILE, LARGEST_JSON, Bytes
from gcd_dataset.shards.manifest import MANIFEST, Manifest, ShardRecord, read_manifest
from gcd_dataset.shards.meta import decode_json
from gcd_dataset.shards.notes import Gathered, gather, shards_named
from gcd_dataset.shards.place import Place
from gcd_dataset.shards.store import Store

DOWNLOAD_FILE = "download.json"
OPEN_FILES = 256  # most open files, out of the 1024 descriptors that most systems allow a process


class FolderStore(Store):
    """The shards in a folder, as they are at the first look.

    ``cache_dir``: folder for data derived from the shards, by default ``~/.cache/gcd_dataset``.
    """

    def __init__(self, folder: Path | str, *, cache_dir: Path | str | None = None) -> None:
        self.folder, self._cache = user_path(folder), default_cache(cache_dir)
        self.source = downloaded_from(self.folder)
        if self.source is not None:
            self.remedy = "delete it, and run gcd download again"
        self._manifest: Manifest | None = None
        self._gathered: Gathered | None = None
        self._place = Place(self.folder)
        self._files: dict[str, _OpenFile] = {}

    def location(self, name: str = "") -> str:
        return str(self.folder / name)

    @property
    def cache(self) -> Path:
        return self._cache / "shards"

    def manifest(self) -> Manifest:
        if self._manifest is None:
            stored = read_manifest(self.folder)
            self._manifest = self._gather().manifest if stored is None else stored
        return self._manifest

    def index(self, split: str) -> SplitIndex:
        record, path = self.record(split), self.folder / index_name(split)
        names = self._place.names()
        for shard in record.shards:
            if shard.name(split) not in names:
                raise self._missing(split, shard, False)
        if self._gathered is None and path.name in names:
            content = read_file(path, LARGEST_FILE)
            if record.index_sha256 not in ("", hashlib.sha256(content).hexdigest()):
                raise ShardError(f"{path}: not the index of these shards ({MANIFEST} has another hash): run gcd index")
            return SplitIndex.from_bytes(content, record, str(path))
        index = self._gather().indices.get(split)
        if index is None or index.record.shards != record.shards:
            raise ShardError(f"{path}: no such file, and the shards differ from {MANIFEST}: run gcd index")
        return index

    def path(self, split: str, shard: ShardRecord, *, views: bool = False) -> Path:
        path = self.folder / shard.name(split, views=views)
        with reading(path):
            if not path.exists():
                raise self._missing(split, shard, views)
        return path

    def part(self, split: str, shard: ShardRecord, start: int, end: int, *, views: bool = False) -> Bytes:
        path = self.folder / (name := shard.name(split, views=views))
        with reading(path):
            # This reference keeps the descriptor open while another thread evicts it.
            file = self._files.get(name) or self._opened(split, shard, views)
            data = read_buffer(end - start).data
            got = 0
            while got < len(data):  # one call reads at most 2 GiB, less on network file systems
                more = os.preadv(file.fd, [data[got:]], start + got)
                if not more:
                    raise ShardError(f"{path}: ends at byte {start + got}, inside a sample: {self.remedy}")
                got += more
        return data

    def _continuation(self, split: str) -> str:
        return f"{self._command(split)} goes on"

    def _command(self, split: str) -> str:
        """The command that continues the data set; ``the same command`` where the plan lacks some of its options."""
        plan = self.manifest().splits[split].plan
        words = ["gcd", "generate", str(self.folder)]
        if plan.named is not None:
            return shlex.join([*words, "--recipe", plan.named[0]])
        if "stage" not in plan.recipe or plan.recipe.get("design"):
            return "the same command"
        words += ["--count", str(plan.count), "--seed", str(plan.seed)]
        for name, value in plan.recipe.items():
            if name not in ("design", "mesh", "part"):  # not options
                words += [f"--{name.replace('_', '-')}", *([] if value is True else [str(value)])]
        return shlex.join(words)

    def _gather(self) -> Gathered:
        if self._gathered is None:
            if self.source is not None:
                raise ShardError(f"{self.folder}: the download of {self.source} is incomplete: run gcd download again")
            if is_published(self.folder) and not shards_named(self._place.names()):
                raise ShardError(
                    f"{self.folder}: no shards: this is GarmentCodeData as published: read it with "
                    "PublishedGarmentCodeData, or make shards of it with gcd convert"
                )
            self._gathered = gather(self._place)
        return self._gathered

    def missing_pictures(self, split: str) -> ShardError | None:
        """The error about the first tar of pictures that the manifest lists and the folder lacks."""
        names = self._place.names()
        lacking = (s for s in self.manifest().splits[split].shards if s.views_size and s.views_name(split) not in names)
        return next((self._missing(split, shard, True) for shard in lacking), None)

    def _missing(self, split: str, shard: ShardRecord, views: bool) -> ShardError:
        """The error about a shard of the manifest, or its pictures, that is not in the folder."""
        path = self.folder / shard.name(split, views=views)
        also = f"delete {shard.name(split)} too and make both again" if views else "make it again"
        remedy = (
            f"copy it again, or {also}: {self._command(split)}" if self.source is None else "run gcd download again"
        )
        return ShardError(f"{path}: no such file, but {MANIFEST} lists it: {remedy}")

    def _opened(self, split: str, shard: ShardRecord, views: bool) -> "_OpenFile":
        """A shard, opened. Raises ``ShardError`` for one that is missing or of another size."""
        path, size = self.path(split, shard, views=views), shard.views_size if views else shard.size
        file = _OpenFile(os.open(path, os.O_RDONLY | os.O_NONBLOCK))  # a pipe fails when it is read
        if (found := os.fstat(file.fd).st_size) != size:
            raise ShardError(f"{path}: {found} bytes, but {size} in {MANIFEST}: {self.remedy}")
        if len(self._files) >= OPEN_FILES:
            self._files.pop(next(iter(list(self._files))), None)
        self._files[shard.name(split, views=views)] = file
        return file

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_files": {}, "_gathered": None}


class _OpenFile:
    """A descriptor, closed with the last reference to it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        # Not __del__: at interpreter exit the os module may be gone before the last file.
        weakref.finalize(self, os.close, fd)


def splits_in(folder: Path | str) -> tuple[str, ...]:
    """The splits of the data set in a folder, sorted. Raises ``ShardError`` for a folder without shards."""
    return tuple(sorted(FolderStore(folder).manifest().splits))


def is_set(folder: Path) -> bool:
    """Whether a folder holds a data set: a manifest or shards. Raises ``ShardError`` where it cannot be read."""
    with reading(folder):
        if not folder.is_dir():
            return False
    names = Place(folder).names()
    return MANIFEST in names or bool(shards_named(names))


def downloaded_from(folder: Path) -> str | None:
    """Source and revision of a downloaded folder; ``None`` for another one. Raises ``ShardError``."""
    path = folder / DOWNLOAD_FILE
    with reading(path):
        if not path.exists():
            return None
    try:
        return str(decode_json(read_file(path, LARGEST_JSON))["source"])
    except (ShardError, ValueError, KeyError, TypeError) as error:
        raise ShardError(f"{path}: not the record of a download ({error}): delete it, and download again") from error
