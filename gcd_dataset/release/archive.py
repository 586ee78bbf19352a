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
from collections.abc import Sequence
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

logger = logging.getLogger("gcd_dataset")

SCHEMA = 2
KINDS = ("spec", "design", "measures", "box", "sim", "segmentation", "vertex_labels", "front", "back")
"""The kinds of file that are kept."""
LEVEL = 1  # of zlib: coordinates hardly compress, and higher levels take several times as long
CHUNK = 1 << 20  # bytes read at a time
DAMAGED = (zlib.error, EOFError, tarfile.TarError, gzip.BadGzipFile)


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


# ----------------------------------------------------------------------------------------------------------- unpacking


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
    with tarfile.open(fileobj=stream, mode="r|", bufsize=CHUNK) as archive:
        for info in archive:
            parts = PurePosixPath(info.name).parts
            if info.isdir() and parts and parts[-1] not in ("data", "."):
                garments.setdefault(parts[-1], {})
            elif info.isreg() and len(parts) > 1 and parts[-1].startswith(parts[-2]):
                files = garments.setdefault(parts[-2], {})
                kind, file = kind_of.get(parts[-1].removeprefix(parts[-2])), archive.extractfile(info)
                if kind is not None and kind not in files and file is not None:
                    files[kind] = (kept.tell(), kept.write(zlib.compress(file.read(), LEVEL)))
    while stream.read(CHUNK):
        pass  # to the checksum, which finds damage
    return garments if any(garments.values()) else {}


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
