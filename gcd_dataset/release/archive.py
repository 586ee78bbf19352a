"""The garments in a downloaded ``data.tar.gz``.

A gzip file can be read from its beginning only, so the archive is unpacked once, from end to end: the files that this
package reads go to a cache file, each compressed by itself, and their places to an index beside it.
"""

import functools
import gzip
import hashlib
import io
import logging
import os
import tarfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Self

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import OutputError, ShardError, shown
from gcd_dataset.files import make_folder, open_regular, open_whole, safe_name, write_whole
from gcd_dataset.records import Record
from gcd_dataset.release.published_names import ENDINGS, REMEDY
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.tar import BLOCK, padded

logger = logging.getLogger("gcd_dataset")

SCHEMA = 2
KINDS = ("spec", "design", "measures", "box", "sim", "segmentation", "vertex_labels", "front", "back")
"""The kinds of file that are kept."""
LEVEL = 1  # of zlib: coordinates hardly compress, and higher levels take several times as long
CHUNK = 1 << 20  # bytes skipped at a time
DAMAGED = (zlib.error, EOFError, tarfile.HeaderError, gzip.BadGzipFile)
LARGEST_CONTENT = 1 << 62  # bytes of an unpacked archive
LARGEST = 1 << 28  # bytes of one file of a garment; a published mesh has 2 MB
MOST_GARMENTS = 1 << 20  # per archive; published archives have 5,000


@dataclass(frozen=True, eq=False)
class Archive(Record):
    """The index of one archive: ``n`` garments, ``m`` kinds of file in the order of ``KINDS``."""

    path: Path
    names: tuple[str, ...]
    """Names of the garments in archive order, empty folders included."""
    offset: Int[np.ndarray, "n m"]
    """First byte of each file in ``unpacked``; -1 for a missing file."""
    size: Int[np.ndarray, "n m"]
    """Bytes there."""
    unpacked: Path
    """The compressed files one after another."""

    @classmethod
    def opened(cls, path: Path, cache_dir: Path | None) -> Self:
        """The archive's index, from the cache; else the archive is unpacked.

        Raises ``ShardError`` for a damaged archive, ``OutputError`` where the cache cannot be written.
        """
        stamp = file_stamp(path)
        index, unpacked = (cache_path(path, cache_dir, ending) for ending in (".npz", ".files"))
        cached = cls._read_cache(path, index, unpacked, stamp)
        if cached is None:
            logger.info("%s: unpacking it once, to %s", path, unpacked)
            _unpack(path, index, unpacked, stamp)
            cached = cls._read_cache(path, index, unpacked, stamp)
        if cached is None:
            raise ShardError(f"{index}: cannot be read back: give another cache_dir")
        return cached

    def location(self, name: str) -> str:
        """Archive and folder of a garment, for messages."""
        return f"{self.path}: data/{shown(name)}"

    def read(self, name: str, kinds: Sequence[str]) -> dict[str, bytes]:
        """Kind to content of a garment's files, without missing ones. Raises ``ShardError`` for a damaged cache."""
        content = {}
        with reading(self.unpacked), self.unpacked.open("rb") as file:
            for kind in kinds:
                column = KINDS.index(kind)
                if (offset := int(self.offset[self._row[name], column])) >= 0:
                    packed = os.pread(file.fileno(), int(self.size[self._row[name], column]), offset)
                    try:
                        content[kind] = zlib.decompress(packed)
                    except zlib.error as error:
                        raise ShardError(f"{self.unpacked}: damaged ({error}): delete it") from error
        return content

    @functools.cached_property
    def _row(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.names)}

    @classmethod
    def _read_cache(cls, path: Path, index: Path, unpacked: Path, stamp: tuple[int, int]) -> Self | None:
        """The cached index; ``None`` if it is broken, or describes another archive."""
        try:
            with np.load(index, allow_pickle=False) as file:
                arrays = dict(file)
            is_own = arrays["stamp"].tolist() == [SCHEMA, *stamp] and arrays["kinds"].tolist() == list(KINDS)
            if not is_own or unpacked.stat().st_size != arrays["size"].sum():
                return None
            return cls(path, tuple(arrays["names"].tolist()), arrays["offset"], arrays["size"], unpacked)
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
            return None


def _unpack(path: Path, index: Path, unpacked: Path, stamp: tuple[int, int]) -> None:
    """Unpack an archive and write its index. Raises ``ShardError`` for a damaged one, ``OutputError``."""
    try:
        make_folder(unpacked.parent)
        with reading(path), open_regular(path) as packed, open_whole(unpacked) as kept:
            try:
                garments = _garments(gzip.GzipFile(fileobj=packed), kept)
            except DAMAGED as error:
                raise ShardError(f"{path}: a damaged archive ({error}): {REMEDY}") from error
            if not garments:
                raise ShardError(
                    f"{path}: holds no garment of the published layout, such as data/rand_…/rand_…_sim.ply: {REMEDY}"
                )
    except OutputError as error:
        raise OutputError(f"{error}, or give another folder as cache_dir") from error
    places = np.array([[files.get(kind, (-1, 0)) for kind in KINDS] for files in garments.values()], np.int64)
    content = io.BytesIO()
    np.savez(
        content,
        stamp=np.array([SCHEMA, *stamp], np.int64),
        kinds=np.array(KINDS),
        names=np.array(list(garments)),
        offset=places[..., 0],
        size=places[..., 1],
    )
    write_cache(index, content.getvalue())  # last: its presence means that both files are complete


def _garments(stream: gzip.GzipFile, kept: BinaryIO) -> dict[str, dict[str, tuple[int, int]]]:
    """Garment to kind of file to (offset, size) in ``kept``, to which the files are written."""
    kind_of = {ENDINGS[kind]: kind for kind in KINDS}
    garments: dict[str, dict[str, tuple[int, int]]] = {}
    for info in _entries(stream):
        parts = PurePosixPath(info.name).parts
        if info.isdir() and parts and parts[-1] not in ("data", "."):
            garments.setdefault(parts[-1], {})
        elif info.isreg() and len(parts) > 1 and parts[-1].startswith(parts[-2]):
            files = garments.setdefault(parts[-2], {})
            kind = kind_of.get(parts[-1].removeprefix(parts[-2]))
            if kind is not None and kind not in files:
                if info.size > LARGEST:
                    raise tarfile.HeaderError(f"{shown(info.name)} of {info.size} bytes, over the limit of {LARGEST}")
                packed = zlib.compress(stream.read(info.size), LEVEL)
                files[kind] = (kept.tell(), kept.write(packed))
        if len(garments) > MOST_GARMENTS:
            raise tarfile.HeaderError(f"more than {MOST_GARMENTS} garments")
    return garments if any(garments.values()) else {}


def _entries(stream: gzip.GzipFile) -> Iterator[tarfile.TarInfo]:
    """The header of each entry, whose content may be read; reads the archive to its end."""
    # Not ``TarFile``: it takes a damaged header for the end of the archive.
    while header := stream.read(BLOCK):
        begin = stream.tell()
        if header == bytes(BLOCK):
            _skip(stream, LARGEST_CONTENT)
            return
        try:
            info = tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
        except tarfile.HeaderError as error:
            raise tarfile.HeaderError(f"no tar header at byte {begin - BLOCK} of its content") from error
        if not 0 <= info.size < LARGEST_CONTENT:  # a negative size would loop forever
            raise tarfile.HeaderError(f"{shown(info.name)} of {info.size} bytes at byte {begin - BLOCK} of its content")
        yield info
        _skip(stream, begin + padded(info.size) - stream.tell())
        if stream.tell() < begin + info.size:
            raise EOFError(f"ends in {shown(info.name)}")


def _skip(stream: gzip.GzipFile, size: int) -> None:
    while size and (skipped := len(stream.read(min(size, CHUNK)))):
        size -= skipped


def cache_path(source: Path, cache_dir: Path | None, ending: str) -> Path:
    """Path of the cache file of ``source``: hidden beside it, or in ``cache_dir`` under a unique name."""
    if cache_dir is None:
        return source.with_name(f".{source.name}.gcd{ending}")
    digest = hashlib.sha256(str(source.resolve()).encode()).hexdigest()[:16]
    return cache_dir / safe_name(f"{source.parent.parent.name}-{source.parent.name}-{source.name}-{digest}{ending}")


def write_cache(path: Path, content: bytes) -> None:
    """Write a cache file, atomically. Raises ``OutputError`` that names ``cache_dir`` as a remedy."""
    try:
        make_folder(path.parent)
        write_whole(path, content)
    except OutputError as error:
        raise OutputError(f"{error}, or give another folder as cache_dir") from error


def file_stamp(source: Path) -> tuple[int, int]:
    """Size and mtime [ns], to detect a changed file. Raises ``ShardError``."""
    with reading(source):
        status = source.stat()
    return status.st_size, status.st_mtime_ns
