"""The files of a data set as ``ShardReader`` reads them: of a folder, or of a server (``gcd_dataset.hub.remote``)."""

import hashlib
import logging
import os
import shlex
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ShardError, did_you_mean
from gcd_dataset.filekinds import is_published
from gcd_dataset.files import user_path
from gcd_dataset.shards.access import REMEDY, Place, read_file, reading
from gcd_dataset.shards.cache import default_cache
from gcd_dataset.shards.index import SplitIndex, index_name
from gcd_dataset.shards.layout import LARGEST_FILE, LARGEST_JSON, Bytes
from gcd_dataset.shards.manifest import HASH, MANIFEST, Manifest, ShardRecord, SplitRecord, read_manifest
from gcd_dataset.shards.meta import decode_json
from gcd_dataset.shards.notes import Gathered, gather, shards_named

DOWNLOAD_FILE = "download.json"
RECIPES = files("gcd_dataset") / "generator" / "recipes"
OPEN_FILES = 256  # most open files, out of the 1024 descriptors that most systems allow a process


class Store(ABC):
    """The files of a data set. May be pickled, forked, and read from several threads."""

    source: str | None = None
    """Origin and revision of the data; ``None`` where unknown."""

    remedy: str = REMEDY
    """The remedy in messages about damaged samples."""

    cache: Path
    """The folder with one folder for each shard, named by its SHA-256, for data derived from it."""

    @abstractmethod
    def location(self, name: str = "") -> str:
        """The path or URL of a file, by default of the whole data set, for messages."""

    @abstractmethod
    def manifest(self) -> Manifest:
        """The manifest; gathered from the notes of the shards where there is none. Raises ``ShardError``."""

    def record(self, split: str) -> SplitRecord:
        """The record of a split. Raises ``ShardError`` where it is missing or empty."""
        splits = self.manifest().splits
        if split in splits and splits[split].count:
            return splits[split]
        choice = f"choose from {', '.join(splits)}{did_you_mean(split, splits)}"
        fault = "none is finished" if split in splits else choice
        raise ShardError(f"{self.location()}: no samples of split {split}: {fault}")

    @abstractmethod
    def index(self, split: str) -> SplitIndex:
        """The index of a split. Raises ``ShardError`` where the split is missing, empty or broken."""

    @abstractmethod
    def path(self, split: str, shard: ShardRecord, *, views: bool = False) -> Path:
        """The whole tar of a shard, or of its pictures, on this machine. Raises ``ShardError``."""

    @abstractmethod
    def part(self, split: str, shard: ShardRecord, start: int, end: int, *, views: bool = False) -> Bytes:
        """Bytes ``start`` to ``end`` of a shard, or of the tar of its pictures. Raises ``ShardError``."""

    def parts(self, split: str, wanted: Sequence[tuple[ShardRecord, int, int, bool]]) -> Iterable[Bytes]:
        """As ``part``, for several samples: shard, start, end and whether of the pictures. Raises ``ShardError``."""
        # One by one: each sample is checked while it is in the CPU cache.
        return (self.part(split, shard, start, end, views=views) for shard, start, end, views in wanted)

    def ensure(self, split: str, shards: Iterable[ShardRecord], *, views: bool = False) -> None:  # noqa: B027
        """Bring whole tars of several shards onto this machine, at once; a folder has them. Raises ``ShardError``."""

    def unfinished(self, split: str) -> str | None:
        """A message that not all samples of the data set are made, with a remedy; ``None`` if all are."""
        manifest = self.manifest()
        if split not in manifest.splits or (missing := manifest.missing(split)) is None:
            return None
        return f"{missing[0]} of {missing[1]} samples are made: {self._continuation(split)}"

    def _continuation(self, split: str) -> str:
        return "ask its publisher to finish it"

    def warn_unfinished(self, splits: Iterable[str]) -> None:
        """Log a warning for the first split that is unfinished."""
        for split in splits:
            if (fault := self.unfinished(split)) is not None:
                message = "%s: the data set is unfinished: %s; partial=True opens it without this warning"
                logging.getLogger("gcd_dataset").warning(message, self.location(), fault)
                return


class FolderStore(Store):
    """The shards in a folder, as they are at the first look.

    ``cache_dir``: folder for data derived from the shards, by default ``~/.cache/gcd_dataset``.
    """

    def __init__(self, folder: Path | str, *, cache_dir: Path | str | None = None) -> None:
        self.folder, self.cache = user_path(folder), default_cache(cache_dir) / "shards"
        self.source = downloaded_from(self.folder)
        if self.source is not None:
            self.remedy = "delete it, and run gcd download again"
        self._manifest: Manifest | None = None
        self._gathered: Gathered | None = None
        self._place = Place(self.folder)
        self._files: dict[str, _OpenFile] = {}  # by SHA-256

    def location(self, name: str = "") -> str:
        return str(self.folder / name)

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
        # This reference keeps the descriptor open while another thread evicts it.
        file = self._files.get(shard.views_sha256 if views else shard.sha256) or self._opened(split, shard, views)
        data, got = memoryview(bytearray(end - start)), 0
        while got < len(data):  # one call reads at most 2 GiB, less on network file systems
            try:
                more = os.preadv(file.fd, [data[got:]], start + got)
            except OSError:
                with reading(file.path):
                    raise
            if not more:
                raise ShardError(f"{file.path}: ends at byte {start + got}, inside a sample: {self.remedy}")
            got += more
        return data

    def _continuation(self, split: str) -> str:
        return f"{self._command(split)} goes on"

    def _command(self, split: str) -> str:
        """The command that continues the data set; ``the same command`` where the plan lacks a file of its options."""
        plan = self.manifest().splits[split].plan
        words = ["gcd", "generate", str(self.folder)]
        if plan.named is not None:
            is_ours = (RECIPES / f"{plan.named[0]}.toml").is_file()
            return shlex.join([*words, "--recipe", plan.named[0]]) if is_ours else "the same command"
        options = {name: value for name, value in plan.recipe.items() if name not in ("design", "mesh", "part")}
        hashed = any(HASH.fullmatch(str(value)) for value in options.values())  # in place of a file
        if "stage" not in options or plan.recipe.get("design") or hashed:
            return "the same command"
        words += ["--count", str(plan.count), "--seed", str(plan.seed)]
        for name, value in options.items():
            option, text = f"--{name.replace('_', '-')}", str(value)
            joined = [f"{option}={text}"] if text.startswith("-") else [option, text]
            words += [option] if value is True else joined
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
        with reading(path):
            file = _OpenFile(path, os.open(path, os.O_RDONLY | os.O_NONBLOCK))  # a pipe fails when it is read
            if (found := os.fstat(file.fd).st_size) != size:
                raise ShardError(f"{path}: {found} bytes, but {size} in {MANIFEST}: {self.remedy}")
        if len(self._files) >= OPEN_FILES:
            self._files.pop(next(iter(list(self._files))), None)
        self._files[shard.views_sha256 if views else shard.sha256] = file
        return file

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_files": {}, "_gathered": None}


class _OpenFile:
    """A descriptor, closed with the last reference to it."""

    def __init__(self, path: Path, fd: int) -> None:
        self.path, self.fd = path, fd
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
