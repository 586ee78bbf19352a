"""The garments in a ``data.tar.gz`` as downloaded, each read without unpacking those before it.

The archive is read once from end to end; where its files lie, and where unpacking can begin, is kept in two files.
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
from gcd_dataset.records import Record
from gcd_dataset.release.file_cache import cache_path, file_stamp, write_cache
from gcd_dataset.release.gzip_index import WINDOW, GzipScanner, SeekPoint, read_from
from gcd_dataset.release.published_names import ENDINGS, REMEDY
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.tar import BLOCK, padded

__all__ = ["Archive"]

logger = logging.getLogger("gcd_dataset")

SCHEMA = 1
GZIP_MAGIC = b"\x1f\x8b"
DAMAGED = (zlib.error, EOFError, tarfile.HeaderError)
FARTHEST = 1 << 62  # bytes of an archive's content
LARGEST = 1 << 28  # bytes of one file of a garment; a published mesh has 2 MB
MOST = 1 << 20  # garments of an archive; published ones have 5,000
APART = 1 << 22  # bytes between files of a garment that are passed over rather than sought anew


@dataclass(frozen=True, eq=False)
class Archive(Record):
    """Where the garments of one archive lie; ``n`` garments, ``m`` kinds of file in the order of ``ENDINGS``."""

    path: Path
    names: tuple[str, ...]
    """Of the garments, in the order of the archive; those whose folder is empty too."""
    offset: Int[np.ndarray, "n m"]
    """First byte of each file in the unpacked archive; -1 where there is none."""
    size: Int[np.ndarray, "n m"]
    points: Int[np.ndarray, "k 3"]
    """Where unpacking can begin: byte of the file, byte of the content, 1 where that takes the window before."""
    windows: Path
    """The windows of all points, one after the other."""

    @classmethod
    def opened(cls, path: Path, cache_dir: Path | None) -> Self:
        """The archive, from what is kept of it or else read through.

        Raises ``ShardError`` for a damaged archive, ``OutputError`` where its index cannot be kept.
        """
        stamp = file_stamp(path)
        index, windows = (cache_path(path, cache_dir, ending) for ending in (".npz", ".windows"))
        there = cls._read(path, index, windows, stamp)
        if there is None:
            logger.info("%s: read through once, to know where its garments lie", path)
            _scan(path, index, windows, stamp)
            there = cls._read(path, index, windows, stamp)
        if there is None:
            raise ShardError(f"{index}: cannot be read back: give another cache_dir")
        return there

    def where(self, name: str) -> str:
        """How messages call a garment."""
        return f"{self.path}: data/{shown(name)}"

    def read(self, name: str, kinds: Sequence[str]) -> dict[str, bytes]:
        """Files of a garment, those that there are. Raises ``ShardError`` for a damaged archive."""
        row, numbers = self._row[name], {kind: number for number, kind in enumerate(ENDINGS)}
        offset, size = self.offset[row].tolist(), self.size[row].tolist()
        places = {kind: (offset[numbers[kind]], size[numbers[kind]]) for kind in kinds if offset[numbers[kind]] >= 0}
        content = {}
        for group in _near(places):
            first = places[group[0]][0]
            block = memoryview(self._block(first, max(sum(places[kind]) for kind in group) - first))
            for kind in group:
                start, length = places[kind]
                content[kind] = bytes(block[start - first : start - first + length])
        return content

    def _block(self, first: int, size: int) -> bytes:
        """Bytes of the unpacked archive."""
        with reading(self.path), self.path.open("rb") as file:
            try:
                if not len(self.points):
                    return os.pread(file.fileno(), size, first)
                return read_from(file.fileno(), self._point(first), first, size)
            except DAMAGED as error:
                raise _damaged(self.path, error) from error

    def _point(self, offset: int) -> SeekPoint:
        row = int(np.searchsorted(self.points[:, 1], offset, side="right")) - 1
        place, start, windowed = self.points[row].tolist()
        if not windowed:
            return SeekPoint(place, start, None)
        with reading(self.windows), self.windows.open("rb") as file:
            return SeekPoint(place, start, os.pread(file.fileno(), WINDOW, row * WINDOW))

    @functools.cached_property
    def _row(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.names)}

    @classmethod
    def _read(cls, path: Path, index: Path, windows: Path, stamp: tuple[int, int]) -> Self | None:
        """What is kept of the archive; ``None`` where it is of another one, or broken."""
        try:
            kept = _kept_arrays(index)
            if kept["stamp"].tolist() != [SCHEMA, *stamp] or kept["kinds"].tolist() != list(ENDINGS):
                return None
            archive = cls(path, tuple(kept["names"].tolist()), kept["offset"], kept["size"], kept["points"], windows)
            return archive if archive._is_sound() else None
        except BROKEN:
            return None

    def _is_sound(self) -> bool:
        """Whether the places are some that reading an archive through can have given."""
        shape = (len(self.names), len(ENDINGS))
        if not (self.offset.shape == self.size.shape == shape and self.points.shape[1:] == (3,)):
            return False
        if not all(array.dtype == np.int64 for array in (self.offset, self.size, self.points)):
            return False
        starts = self.points[:, 1]
        begins = not len(starts) or (starts[0] == 0 and (np.diff(starts) > 0).all() and self.points.min() >= 0)
        fits = (self.offset >= -1).all() and (self.size >= 0).all() and (self.size <= LARGEST).all()
        named = all(isinstance(name, str) for name in self.names)
        return bool(begins and fits and named) and self.windows.stat().st_size == len(starts) * WINDOW


BROKEN = (OSError, KeyError, ValueError, TypeError, EOFError, SyntaxError, MemoryError, TokenError, zipfile.BadZipFile)
"""What NumPy raises at an index that is none."""


def _kept_arrays(index: Path) -> dict[str, np.ndarray]:
    """The arrays of an index. Raises one of ``BROKEN``."""
    with zipfile.ZipFile(index) as file:
        # We store them as they are: none is larger than the file.
        if sum(info.file_size for info in file.infolist()) > index.stat().st_size:
            raise ValueError("packed")
    with np.load(index, allow_pickle=False) as arrays:
        return dict(arrays)


def _near(places: Mapping[str, tuple[int, int]]) -> list[list[str]]:
    """Kinds of file in the order of their places, (offset, size), those near each other together."""
    groups: list[list[str]] = []
    first = end = 0
    for kind, (start, size) in sorted(places.items(), key=lambda entry: entry[1]):
        if groups and start - end <= APART and start + size - first <= LARGEST:
            groups[-1].append(kind)
            end = max(end, start + size)
        else:
            groups.append([kind])
            first, end = start, start + size
    return groups


# ------------------------------------------------------------------------------------------------------------- scanning


class _Flow(Protocol):
    """An archive's content from its beginning to its end."""

    position: int

    def read(self, size: int) -> bytes: ...

    def skip(self, size: int) -> None: ...


class _Plain:
    """The content of a tar that is not packed."""

    def __init__(self, file: int) -> None:
        self._file, self._end, self.position = file, os.fstat(file).st_size, 0

    def read(self, size: int) -> bytes:
        data = os.pread(self._file, size, self.position)
        self.position += len(data)
        return data

    def skip(self, size: int) -> None:
        self.position = min(self.position + size, self._end)


def _scan(path: Path, index: Path, windows: Path, stamp: tuple[int, int]) -> None:
    """Read an archive through, and keep what there is to know about it."""
    with reading(path), path.open("rb") as file:
        packed = os.pread(file.fileno(), 2, 0) == GZIP_MAGIC
        flow = GzipScanner(file.fileno()) if packed else _Plain(file.fileno())
        try:
            garments = _garments(flow)
        except DAMAGED as error:
            raise _damaged(path, error) from error
    if not garments:
        raise ShardError(f"{path}: holds no garment of the published layout, as data/rand_…/rand_…_sim.ply: {REMEDY}")
    points = flow.points if isinstance(flow, GzipScanner) else []
    places = np.array([[files.get(kind, (-1, 0)) for kind in ENDINGS] for files in garments.values()], np.int64)
    numbers = [(point.place, point.start, int(point.window is not None)) for point in points]
    arrays: dict[str, Any] = {
        "stamp": np.array([SCHEMA, *stamp], np.int64),
        "kinds": np.array(list(ENDINGS)),
        "names": np.array(list(garments)),
        "offset": places[..., 0],
        "size": places[..., 1],
        "points": np.array(numbers, np.int64).reshape(-1, 3),
    }
    content = io.BytesIO()
    np.savez(content, **arrays)
    # The index last: it is what says that all is there.
    write_cache(windows, b"".join(point.window or bytes(WINDOW) for point in points))
    write_cache(index, content.getvalue())


def _garments(flow: _Flow) -> dict[str, dict[str, tuple[int, int]]]:
    """Name of each garment to the places of its files, by kind."""
    kind_of = {ending: kind for kind, ending in ENDINGS.items()}
    garments: dict[str, dict[str, tuple[int, int]]] = {}
    for info, offset in _entries(flow):
        parts = PurePosixPath(info.name).parts
        if info.isdir() and parts and parts[-1] not in ("data", "."):
            garments.setdefault(parts[-1], {})
        elif info.isreg() and len(parts) > 1 and parts[-1].startswith(parts[-2]):
            files = garments.setdefault(parts[-2], {})
            if (kind := kind_of.get(parts[-1].removeprefix(parts[-2]))) is not None:
                if info.size > LARGEST:
                    raise tarfile.HeaderError(f"{shown(info.name)} of {info.size} bytes, where {LARGEST} are read")
                files[kind] = (offset, info.size)
        if len(garments) > MOST:
            raise tarfile.HeaderError(f"more than {MOST} garments")
    return garments if any(garments.values()) else {}


def _entries(flow: _Flow) -> Iterator[tuple[tarfile.TarInfo, int]]:
    """The headers of an archive, each with the place of its content; all of the archive is read."""
    # Not by ``tarfile`` as a whole: to that a damaged header is the end of the archive.
    while header := flow.read(BLOCK):
        if header == bytes(BLOCK):
            flow.skip(FARTHEST)
            return
        place = flow.position
        try:
            info = tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
        except tarfile.HeaderError as error:
            raise tarfile.HeaderError(f"no tar header at byte {place - BLOCK} of its content") from error
        if not 0 <= info.size < FARTHEST:  # else the way would lead back, and never end
            raise tarfile.HeaderError(f"{shown(info.name)} of {info.size} bytes at byte {place - BLOCK} of its content")
        yield info, place
        flow.skip(padded(info.size))
        if flow.position < place + info.size:
            raise EOFError(f"ends in {shown(info.name)}")


def _damaged(path: Path, error: Exception) -> ShardError:
    return ShardError(f"{path}: a damaged archive ({error}): {REMEDY}")
