"""Random access to the garments in a downloaded ``data.tar.gz``.

The archive is scanned once from end to end; the offsets of its files, and seek points of the gzip stream, are cached in
two files.
"""

import functools
import hashlib
import io
import logging
import os
import re
import tarfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Self

import numpy as np
from jaxtyping import Bool, Int, UInt8

from gcd_dataset.errors import OutputError, ShardError, shown
from gcd_dataset.files import make_folder, open_regular, safe_name, write_whole
from gcd_dataset.records import Record
from gcd_dataset.release.published_names import ENDINGS, REMEDY
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.tar import BLOCK, padded

WINDOW = 1 << 15  # bytes of content that a block may refer back to
EVERY = 1 << 24  # bytes of content between seek points: reading a garment unpacks half of it first, in 30 ms
CHUNK = 1 << 18  # bytes per read; most blocks are shorter than 40 kB
PIECE = 1 << 14  # packed bytes per call of zlib
LARGEST_PART = 1 << 20  # most unpacked bytes per call: a packed byte may hold up to 1000 bytes
MOST_SEARCHED = 64 * CHUNK  # largest content of a chunk that is searched for a block start [bytes]
NOT_ZERO = re.compile(rb"[^\0]")
GZIP, RAW = 31, -15  # window bits that tell zlib the format
TRAILER = 8  # bytes after a stream: CRC-32 and length
LONGEST_MATCH = 258
CODE_LENGTHS = 19  # most code-length codes in a block's header
LONGEST_HEADER = 17 + 3 * CODE_LENGTHS  # bits of a header before the codes of literals and distances
MOST_CODES = 29  # largest valid HLIT and HDIST
FULL_CODE = 128  # Kraft sum of a complete code of up to 7 bits, in units of 2⁻⁷


@dataclass(frozen=True)
class SeekPoint:
    """A position at which unpacking can begin."""

    packed: int
    """Byte offset in the packed file: start of a block; of a gzip stream if ``window`` is ``None``."""
    start: int
    """Byte offset in the content."""
    window: bytes | None
    """The 32 kB of content before it."""


class GzipScanner:
    """The content of a gzip file as a stream; reading it collects seek points in ``points``."""

    def __init__(self, file: int) -> None:
        self.points: list[SeekPoint] = [SeekPoint(0, 0, None)]
        self.position = 0
        self._parts = self._unpacked(file)
        self._rest = memoryview(b"")

    def read(self, size: int) -> bytes:
        """The next ``size`` bytes, fewer at the end. Raises ``zlib.error``, and ``EOFError`` for a truncated file."""
        parts, missing = [], size
        while missing:
            if not self._rest:
                self._rest = memoryview(next(self._parts, b""))
                if not self._rest:
                    break
            parts.append(self._rest[:missing])
            self._rest = self._rest[missing:]
            missing -= len(parts[-1])
        self.position += size - missing
        return b"".join(parts)

    def skip(self, size: int) -> None:
        """Skip ``size`` bytes. Raises as ``read`` does."""
        while size and (skipped := len(self.read(min(size, CHUNK)))):
            size -= skipped

    def _unpacked(self, file: int) -> Iterator[bytes]:
        """Parts of the content. Adds a seek point every ``EVERY`` bytes, where one is found."""
        streams, packed, end, before = _Streams(), 0, 0, b""
        while chunk := os.pread(file, CHUNK, packed):
            parts, size, in_one_stream = [], 0, True
            for first, part in streams.unpacked(chunk):
                if first is not None:
                    in_one_stream = False
                    if end + size - self.points[-1].start >= EVERY:
                        self.points.append(SeekPoint(packed + first, end + size, None))
                size += len(part)
                parts.append(part if size <= MOST_SEARCHED else b"")
                yield from (part,) if part else ()
            content = b"".join(parts)
            is_due = end - self.points[-1].start >= EVERY and len(before) == WINDOW
            if in_one_stream and streams.is_open and is_due and size <= MOST_SEARCHED:
                found = _block_start(chunk, before + content)
                if found is not None:
                    first, start = found
                    window = (before + content)[start : start + WINDOW]
                    self.points.append(SeekPoint(packed + first, end + start, window))
            before = (before + content)[-WINDOW:] if size <= MOST_SEARCHED else b""
            packed, end = packed + len(chunk), end + size
        if streams.is_open:
            raise EOFError(f"ends in the middle, at byte {packed}")


def read_from(file: int, point: SeekPoint, offset: int, size: int) -> bytes:
    """``size`` bytes of the content from ``offset`` on, unpacked from a seek point before it.

    Raises ``zlib.error`` for a damaged file, ``EOFError`` for a truncated file.
    """
    skipped, parts = offset - point.start, []
    for content in _unpacked_from(file, point):
        parts.append(content[skipped : skipped + size])
        skipped, size = max(skipped - len(content), 0), size - len(parts[-1])
        if not size:
            return b"".join(parts)
    raise EOFError("ends in the middle")


def _unpacked_from(file: int, point: SeekPoint) -> Iterator[bytes]:
    """Parts of the content from a seek point on."""
    streams, packed = _Streams(point.window), point.packed
    while chunk := os.pread(file, CHUNK, packed):
        yield from (part for _, part in streams.unpacked(chunk))
        packed += len(chunk)


class _Streams:
    """Unpacks concatenated gzip streams, with zeros allowed in between; ``window``: starts inside a stream.

    Time and memory of each step are bounded, for any number of streams and any compression ratio.
    """

    def __init__(self, window: bytes | None = None) -> None:
        self._stream = zlib.decompressobj(GZIP) if window is None else zlib.decompressobj(RAW, zdict=window)
        self._trailer = 0 if window is None else TRAILER
        self._begins = window is None

    @property
    def is_open(self) -> bool:
        """Whether a stream has begun and not yet ended."""
        return not self._stream.eof

    def unpacked(self, chunk: bytes) -> Iterator[tuple[int | None, bytes]]:
        """Parts of a chunk's content; the first part of a stream comes with the byte at which the stream starts."""
        position = 0
        while position < len(chunk):
            if self._stream.eof and self._trailer:
                skipped = min(self._trailer, len(chunk) - position)
                self._trailer, position = self._trailer - skipped, position + skipped
                continue
            if self._stream.eof:
                following = NOT_ZERO.search(chunk, position)
                if following is None:
                    return
                position = following.start()
                self._stream, self._begins = zlib.decompressobj(GZIP), True
            first = position if self._begins else None
            piece = chunk[position : position + PIECE]
            part = self._stream.decompress(piece, LARGEST_PART)
            position += len(piece) - len(self._stream.unused_data) - len(self._stream.unconsumed_tail)
            self._begins = False
            yield first, part


# ----------------------------------------------------------------------------------------------------- starts of blocks


def _block_start(chunk: bytes, content: bytes) -> tuple[int, int] | None:
    """The first block that starts at a byte boundary of a chunk: (byte of the chunk, byte of the chunk's content).

    ``content``: the window before the chunk, and the content of the chunk.
    """
    for first in _header_like(chunk):
        # Omit the last byte, which may end inside a code.
        start = _matching_start(chunk[first:-1], content)
        if start is not None:
            return first, start - WINDOW
    return None


def _matching_start(packed: bytes, content: bytes) -> int | None:
    """Offset in ``content`` of the content of ``packed``, except its last bytes; ``None`` if it does not match."""
    try:
        zeros, ones = (zlib.decompressobj(RAW, zdict=bytes([fill]) * WINDOW) for fill in (0, 255))
        low, high = (np.frombuffer(stream.decompress(packed), np.uint8) for stream in (zeros, ones))
    except zlib.error:
        return None
    if len(low) != len(high) or len(low) < WINDOW // 8:
        return None
    known = np.flatnonzero(low == high)  # bytes that do not depend on the window
    # The omitted last byte holds a few codes, each of them a literal or a match.
    latest = len(content) - len(low)
    starts = np.arange(max(WINDOW, latest - 16 * LONGEST_MATCH), latest + 1)
    probes = known[:: max(len(known) // 64, 1)]
    whole = np.frombuffer(content, np.uint8)
    for start in starts[(whole[starts[:, None] + probes] == low[probes]).all(axis=1)].tolist():
        stream = zlib.decompressobj(RAW, zdict=content[start - WINDOW : start])
        if stream.decompress(packed) == content[start : start + len(low)]:
            return start
    return None


def _header_like(chunk: bytes) -> list[int]:
    """Candidate bytes: a header of a dynamic, non-final block (RFC 1951, section 3.2.7) may start there."""
    bits = np.unpackbits(np.frombuffer(chunk, np.uint8), bitorder="little")
    starts = np.arange(0, max(len(bits) - LONGEST_HEADER, 0), 8)
    starts = starts[(bits[starts] == 0) & (bits[starts + 1] == 0) & (bits[starts + 2] == 1)]
    starts = starts[(_number(bits, starts + 3, 5) <= MOST_CODES) & (_number(bits, starts + 8, 5) <= MOST_CODES)]
    return (starts[_has_full_code(bits, starts)] // 8).tolist()


def _has_full_code(bits: UInt8[np.ndarray, " n"], positions: Int[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """Whether the code-length code of a header is complete (Kraft sum 1), as zlib requires."""
    count = _number(bits, positions + 13, 4) + 4
    total = np.zeros(len(positions), np.int64)
    for i in range(CODE_LENGTHS):
        length = _number(bits, positions + 17 + 3 * i, 3)
        total += np.where((i < count) & (length > 0), FULL_CODE >> length, 0)
    return total == FULL_CODE


def _number(bits: UInt8[np.ndarray, " n"], positions: Int[np.ndarray, " k"], width: int) -> Int[np.ndarray, " k"]:
    """Numbers of ``width`` bits, least significant first."""
    return sum((bits[positions + i].astype(np.int64) << i for i in range(width)), np.zeros(len(positions), np.int64))


logger = logging.getLogger("gcd_dataset")

SCHEMA = 1
DAMAGED = (zlib.error, EOFError, tarfile.HeaderError)
LARGEST_CONTENT = 1 << 62  # bytes of an unpacked archive
LARGEST = 1 << 28  # bytes of one file of a garment; a published mesh has 2 MB
MOST_GARMENTS = 1 << 20  # per archive; published archives have 5,000


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
        found = [kind for kind in kinds if self.offset[row, numbers[kind]] >= 0]
        columns = [numbers[kind] for kind in found]
        starts, ends = self.offset[row, columns].tolist(), (self.offset + self.size)[row, columns].tolist()
        # The files of a garment are neighbours: unpacking all in between costs less than another seek.
        first = min(starts, default=0)
        block = memoryview(self._block(first, max(ends, default=0) - first))
        return {kind: bytes(block[a - first : b - first]) for kind, a, b in zip(found, starts, ends, strict=True)}

    def _block(self, first: int, size: int) -> bytes:
        """``size`` bytes of the unpacked archive from ``first`` on. Raises ``ShardError``."""
        with reading(self.path), self.path.open("rb") as file:
            try:
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
            with np.load(index, allow_pickle=False) as file:
                arrays = dict(file)
            names, points = tuple(arrays["names"].tolist()), arrays["points"]
            is_own = arrays["stamp"].tolist() == [SCHEMA, *stamp] and arrays["kinds"].tolist() == list(ENDINGS)
            if not is_own or windows.stat().st_size != len(points) * WINDOW:
                return None
            return cls(path, names, arrays["offset"], arrays["size"], points, windows)
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
            return None


# ------------------------------------------------------------------------------------------------------------- scanning


def _scan(path: Path, index: Path, windows: Path, stamp: tuple[int, int]) -> None:
    """Scan an archive and write its index. Raises ``ShardError`` for a damaged one, ``OutputError``."""
    with reading(path), open_regular(path) as file:
        stream = GzipScanner(file.fileno())
        try:
            garments = _garments(stream)
        except DAMAGED as error:
            raise _damaged(path, error) from error
    if not garments:
        raise ShardError(
            f"{path}: holds no garment of the published layout, such as data/rand_…/rand_…_sim.ply: {REMEDY}"
        )
    locations = np.array([[files.get(kind, (-1, 0)) for kind in ENDINGS] for files in garments.values()], np.int64)
    numbers = [(point.packed, point.start, int(point.window is not None)) for point in stream.points]
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
    write_cache(windows, b"".join(point.window or bytes(WINDOW) for point in stream.points))
    write_cache(index, content.getvalue())


def _garments(stream: GzipScanner) -> dict[str, dict[str, tuple[int, int]]]:
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


def _entries(stream: GzipScanner) -> Iterator[tuple[tarfile.TarInfo, int]]:
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
