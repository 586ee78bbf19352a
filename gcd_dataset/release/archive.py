"""Random access to the garments in a downloaded ``data.tar.gz``.

The archive is scanned once from end to end; the offsets of its files, and seek points of the gzip stream, are cached in
two files.
"""

import functools
import io
import logging
import os
import tarfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tokenize import TokenError
from typing import Any, Protocol, Self

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.files import open_regular
from gcd_dataset.records import Record
from gcd_dataset.release.file_cache import cache_path, file_stamp, write_cache
from gcd_dataset.release.gzip_index import WINDOW, GzipScanner, SeekPoint, read_from
from gcd_dataset.release.published_names import ENDINGS, REMEDY
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.tar import BLOCK, padded

logger = logging.getLogger("gcd_dataset")

SCHEMA = 1
GZIP_MAGIC = b"\x1f\x8b"
DAMAGED = (zlib.error, EOFError, tarfile.HeaderError)
LARGEST_CONTENT = 1 << 62  # bytes of an unpacked archive
LARGEST = 1 << 28  # bytes of one file of a garment; a published mesh has 2 MB
MOST_GARMENTS = 1 << 20  # per archive; published archives have 5,000
GAP = 1 << 22  # bytes between two files of a garment: unpacking a gap costs less than another seek


@dataclass(frozen=True, eq=False)
class Archive(Record):
    """The index of one archive: ``n`` garments, ``m`` kinds of file in the order of ``ENDINGS``."""

    path: Path
    names: tuple[str, ...]
    """Names of the garments in archive order, empty folders included."""
    offset: Int[np.ndarray, "n m"]
    """First byte of each file in the unpacked archive; -1 for a missing file."""
    size: Int[np.ndarray, "n m"]
    """Bytes."""
    points: Int[np.ndarray, "k 3"]
    """Seek points: offset in the packed file, offset in the content, and 1 if unpacking needs the window before it."""
    windows: Path
    """File with the concatenated windows of all seek points."""

    @classmethod
    def opened(cls, path: Path, cache_dir: Path | None) -> Self:
        """The archive's index, from the cache or by a scan.

        Raises ``ShardError`` for a damaged archive, ``OutputError`` where the index cannot be written.
        """
        stamp = file_stamp(path)
        index, windows = (cache_path(path, cache_dir, ending) for ending in (".npz", ".windows"))
        cached = cls._read_cache(path, index, windows, stamp)
        if cached is None:
            logger.info("%s: scanning it once for an index of its garments", path)
            _scan(path, index, windows, stamp)
            cached = cls._read_cache(path, index, windows, stamp)
        if cached is None:
            raise ShardError(f"{index}: cannot be read back: give another cache_dir")
        return cached

    def location(self, name: str) -> str:
        """Archive and folder of a garment, for messages."""
        return f"{self.path}: data/{shown(name)}"

    def read(self, name: str, kinds: Sequence[str]) -> dict[str, bytes]:
        """Kind to content of a garment's files, without missing ones. Raises ``ShardError`` for a damaged archive."""
        row, numbers = self._row[name], {kind: number for number, kind in enumerate(ENDINGS)}
        offset, size = self.offset[row].tolist(), self.size[row].tolist()
        locations = {kind: (offset[numbers[kind]], size[numbers[kind]]) for kind in kinds if offset[numbers[kind]] >= 0}
        content = {}
        for group in _neighbours(locations):
            first = locations[group[0]][0]
            block = memoryview(self._block(first, max(sum(locations[kind]) for kind in group) - first))
            for kind in group:
                start, length = locations[kind]
                content[kind] = bytes(block[start - first : start - first + length])
        return content

    def _block(self, first: int, size: int) -> bytes:
        """``size`` bytes of the unpacked archive from ``first`` on. Raises ``ShardError``."""
        with reading(self.path), self.path.open("rb") as file:
            try:
                if not len(self.points):
                    return os.pread(file.fileno(), size, first)
                return read_from(file.fileno(), self._point(first), first, size)
            except DAMAGED as error:
                raise _damaged(self.path, error) from error

    def _point(self, offset: int) -> SeekPoint:
        """The last seek point at or before a byte of the content."""
        row = int(np.searchsorted(self.points[:, 1], offset, side="right")) - 1
        packed, start, has_window = self.points[row].tolist()
        if not has_window:
            return SeekPoint(packed, start, None)
        with reading(self.windows), self.windows.open("rb") as file:
            return SeekPoint(packed, start, os.pread(file.fileno(), WINDOW, row * WINDOW))

    @functools.cached_property
    def _row(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.names)}

    @classmethod
    def _read_cache(cls, path: Path, index: Path, windows: Path, stamp: tuple[int, int]) -> Self | None:
        """The cached index; ``None`` if it is broken, or describes another archive."""
        try:
            arrays = _read_arrays(index)
            if arrays["stamp"].tolist() != [SCHEMA, *stamp] or arrays["kinds"].tolist() != list(ENDINGS):
                return None
            names = tuple(arrays["names"].tolist())
            archive = cls(path, names, arrays["offset"], arrays["size"], arrays["points"], windows)
            return archive if archive._is_valid() else None
        except BROKEN:
            return None

    def _is_valid(self) -> bool:
        """Whether shapes, types and values of a cached index are valid; offsets are not compared with the archive."""
        shape = (len(self.names), len(ENDINGS))
        if not (self.offset.shape == self.size.shape == shape and self.points.shape[1:] == (3,)):
            return False
        if not all(array.dtype == np.int64 for array in (self.offset, self.size, self.points)):
            return False
        starts = self.points[:, 1]
        points_valid = not len(starts) or (starts[0] == 0 and (np.diff(starts) > 0).all() and self.points.min() >= 0)
        files_valid = (self.offset >= -1).all() and (self.size >= 0).all() and (self.size <= LARGEST).all()
        names_valid = all(isinstance(name, str) for name in self.names)
        windows_size = self.windows.stat().st_size
        return bool(points_valid and files_valid and names_valid) and windows_size == len(starts) * WINDOW


BROKEN = (OSError, KeyError, ValueError, TypeError, EOFError, SyntaxError, MemoryError, TokenError, zipfile.BadZipFile)
"""Exceptions of NumPy on a broken index."""


def _read_arrays(index: Path) -> dict[str, np.ndarray]:
    """The arrays of an index. Raises one of ``BROKEN``."""
    with zipfile.ZipFile(index) as file:
        # The index is written uncompressed: larger arrays would be a decompression bomb.
        if sum(info.file_size for info in file.infolist()) > index.stat().st_size:
            raise ValueError("compressed")
    with np.load(index, allow_pickle=False) as arrays:
        return dict(arrays)


def _neighbours(locations: Mapping[str, tuple[int, int]]) -> list[list[str]]:
    """Kinds of file grouped into runs of neighbours, by their (offset, size)."""
    groups: list[list[str]] = []
    first = end = 0
    for kind, (start, size) in sorted(locations.items(), key=lambda entry: entry[1]):
        if groups and start - end <= GAP and start + size - first <= LARGEST:
            groups[-1].append(kind)
            end = max(end, start + size)
        else:
            groups.append([kind])
            first, end = start, start + size
    return groups


# ------------------------------------------------------------------------------------------------------------- scanning


class _Stream(Protocol):
    """The unpacked archive, read from its first byte on."""

    position: int

    def read(self, size: int) -> bytes: ...

    def skip(self, size: int) -> None: ...


class _Plain:
    """The stream of an uncompressed tar."""

    def __init__(self, file: int) -> None:
        self._file, self._end, self.position = file, os.fstat(file).st_size, 0

    def read(self, size: int) -> bytes:
        data = os.pread(self._file, size, self.position)
        self.position += len(data)
        return data

    def skip(self, size: int) -> None:
        self.position = min(self.position + size, self._end)


def _scan(path: Path, index: Path, windows: Path, stamp: tuple[int, int]) -> None:
    """Scan an archive and write its index. Raises ``ShardError`` for a damaged one, ``OutputError``."""
    with reading(path), open_regular(path) as file:
        is_packed = os.pread(file.fileno(), 2, 0) == GZIP_MAGIC
        stream = GzipScanner(file.fileno()) if is_packed else _Plain(file.fileno())
        try:
            garments = _garments(stream)
        except DAMAGED as error:
            raise _damaged(path, error) from error
    if not garments:
        raise ShardError(
            f"{path}: holds no garment of the published layout, such as data/rand_…/rand_…_sim.ply: {REMEDY}"
        )
    points = stream.points if isinstance(stream, GzipScanner) else []
    locations = np.array([[files.get(kind, (-1, 0)) for kind in ENDINGS] for files in garments.values()], np.int64)
    numbers = [(point.packed, point.start, int(point.window is not None)) for point in points]
    arrays: dict[str, Any] = {
        "stamp": np.array([SCHEMA, *stamp], np.int64),
        "kinds": np.array(list(ENDINGS)),
        "names": np.array(list(garments)),
        "offset": locations[..., 0],
        "size": locations[..., 1],
        "points": np.array(numbers, np.int64).reshape(-1, 3),
    }
    content = io.BytesIO()
    np.savez(content, **arrays)
    # The index last: its presence means that both files are complete.
    write_cache(windows, b"".join(point.window or bytes(WINDOW) for point in points))
    write_cache(index, content.getvalue())


def _garments(stream: _Stream) -> dict[str, dict[str, tuple[int, int]]]:
    """Garment to kind of file to (offset, size)."""
    kind_of = {ending: kind for kind, ending in ENDINGS.items()}
    garments: dict[str, dict[str, tuple[int, int]]] = {}
    for info, offset in _entries(stream):
        parts = PurePosixPath(info.name).parts
        if info.isdir() and parts and parts[-1] not in ("data", "."):
            garments.setdefault(parts[-1], {})
        elif info.isreg() and len(parts) > 1 and parts[-1].startswith(parts[-2]):
            files = garments.setdefault(parts[-2], {})
            if (kind := kind_of.get(parts[-1].removeprefix(parts[-2]))) is not None:
                if info.size > LARGEST:
                    raise tarfile.HeaderError(f"{shown(info.name)} of {info.size} bytes, over the limit of {LARGEST}")
                files[kind] = (offset, info.size)
        if len(garments) > MOST_GARMENTS:
            raise tarfile.HeaderError(f"more than {MOST_GARMENTS} garments")
    return garments if any(garments.values()) else {}


def _entries(stream: _Stream) -> Iterator[tuple[tarfile.TarInfo, int]]:
    """Header and content offset of each entry; reads the archive to its end."""
    # Not ``TarFile``: it takes a damaged header for the end of the archive.
    while header := stream.read(BLOCK):
        if header == bytes(BLOCK):
            stream.skip(LARGEST_CONTENT)
            return
        offset = stream.position
        try:
            info = tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
        except tarfile.HeaderError as error:
            raise tarfile.HeaderError(f"no tar header at byte {offset - BLOCK} of its content") from error
        if not 0 <= info.size < LARGEST_CONTENT:  # a negative size would loop forever
            raise tarfile.HeaderError(
                f"{shown(info.name)} of {info.size} bytes at byte {offset - BLOCK} of its content"
            )
        yield info, offset
        stream.skip(padded(info.size))
        if stream.position < offset + info.size:
            raise EOFError(f"ends in {shown(info.name)}")


def _damaged(path: Path, error: Exception) -> ShardError:
    return ShardError(f"{path}: a damaged archive ({error}): {REMEDY}")
