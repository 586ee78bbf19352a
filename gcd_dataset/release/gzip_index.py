"""Gzip files read from anywhere.

A gzip file can be unpacked from its beginning only, or from the start of a block of its compressed stream (RFC 1951)
for whoever knows the 32 kB of content before it. ``GzipScanner`` reads a file once from end to end and notes such
starts on the way; ``read_from`` begins at one of them.

Where blocks start is found by trial: a byte may be one where what follows reads as a header. That is so by chance too,
so a start is taken only if unpacking from it gives, byte for byte, what unpacking from the beginning has given. Only
blocks that start with a byte will do, one in eight: those behind them may be stored ones, which count in whole bytes.

Why not a library: neither indexed_gzip 1.10 nor rapidgzip 0.16 tells that a file ends before its time. Measured with an
archive of 200 MB, 396 published garments, on two cores: CPU time and growth of memory to index it, size of the index,
CPU time to read a garment of 0.8 MB.

=============================  =======  =======  =======  ======
this module                      2.2 s    11 MB   0.7 MB   31 ms
indexed_gzip, a point a 4 MB     3.4 s    51 MB   2.4 MB   20 ms
indexed_gzip, a point a 16 MB    3.8 s   131 MB   0.6 MB   49 ms
rapidgzip                        1.2 s   128 MB   3.0 MB   12 ms
=============================  =======  =======  =======  ======
"""

import os
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int, UInt8

__all__ = ["WINDOW", "GzipScanner", "SeekPoint", "read_from"]

WINDOW = 1 << 15  # bytes of content that a block may refer back to
EVERY = 1 << 24  # bytes of content between points: half of it is unpacked in vain for a garment, some 30 ms
CHUNK = 1 << 18  # bytes of the file at a time; a block is seldom longer than 40 kB
PIECE = 1 << 14  # bytes of the file that are unpacked at a time,
LARGEST_PART = 1 << 20  # and of their content; it may be a thousand times as large as they are
MOST_SEARCHED = 64 * CHUNK  # bytes of content of a chunk: what unpacks to more has no use for a point
NOT_ZERO = re.compile(rb"[^\0]")
GZIP, RAW = 31, -15  # window bits that tell zlib the format
TRAILER = 8  # bytes after a stream: CRC-32 and length
LONGEST_MATCH = 258
CODE_LENGTHS = 19  # of a block's header
LONGEST_HEADER = 17 + 3 * CODE_LENGTHS  # bits, up to the codes themselves
MOST_CODES = 29  # beyond 257 and beyond 1
FULL_CODE = 128  # Kraft sum of a complete code of up to 7 bits, in units of 2⁻⁷


@dataclass(frozen=True)
class SeekPoint:
    """Where unpacking can begin."""

    place: int
    """In the file: of a block, or of a whole stream where ``window`` is ``None``."""
    start: int
    """Place in the content that this is."""
    window: bytes | None
    """The content before it."""


class GzipScanner:
    """The content of a gzip file from beginning to end, as a stream; ``points`` grow while it is read."""

    def __init__(self, file: int) -> None:
        self.points: list[SeekPoint] = [SeekPoint(0, 0, None)]
        self.position = 0
        self._parts = self._unpacked(file)
        self._rest = memoryview(b"")

    def read(self, size: int) -> bytes:
        """The next ``size`` bytes, fewer at the end. Raises ``zlib.error``, and ``EOFError`` for a cut file."""
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
        """Leave out ``size`` bytes. Raises as ``read`` does."""
        while size and (passed := len(self.read(min(size, CHUNK)))):
            size -= passed

    def _unpacked(self, file: int) -> Iterator[bytes]:
        streams, place, end, before = _Streams(), 0, 0, b""
        while chunk := os.pread(file, CHUNK, place):
            parts, size, inside = [], 0, True
            for first, part in streams.unpacked(chunk):
                if first is not None:
                    inside = False
                    if end + size - self.points[-1].start >= EVERY:
                        self.points.append(SeekPoint(place + first, end + size, None))
                size += len(part)
                parts.append(part if size <= MOST_SEARCHED else b"")
                yield from (part,) if part else ()
            content = b"".join(parts)
            far = end - self.points[-1].start >= EVERY and len(before) == WINDOW
            if inside and streams.is_open and far and size <= MOST_SEARCHED:
                found = _block_start(chunk, before + content)
                if found is not None:
                    first, start = found
                    window = (before + content)[start : start + WINDOW]
                    self.points.append(SeekPoint(place + first, end + start, window))
            before = (before + content)[-WINDOW:] if size <= MOST_SEARCHED else b""
            place, end = place + len(chunk), end + size
        if streams.is_open:
            raise EOFError(f"ends in the middle, at byte {place}")


def read_from(file: int, point: SeekPoint, offset: int, size: int) -> bytes:
    """``size`` bytes of the content from ``offset`` on, unpacked from a point before it.

    Raises ``zlib.error`` for a damaged file, ``EOFError`` for one that ends before.
    """
    skipped, parts = offset - point.start, []
    for content in _unpacked_from(file, point):
        parts.append(content[skipped : skipped + size])
        skipped, size = max(skipped - len(content), 0), size - len(parts[-1])
        if not size:
            return b"".join(parts)
    raise EOFError("ends in the middle")


def _unpacked_from(file: int, point: SeekPoint) -> Iterator[bytes]:
    """The content from a point on."""
    streams, place = _Streams(point.window), point.place
    while chunk := os.pread(file, CHUNK, place):
        yield from (part for _, part in streams.unpacked(chunk))
        place += len(chunk)


class _Streams:
    """Gzip streams one behind the other, of which zeros may fill the gaps; ``window``: from inside one on.

    However many streams there are, and however much they unpack to, each step takes little time and memory.
    """

    def __init__(self, window: bytes | None = None) -> None:
        self._stream = zlib.decompressobj(GZIP) if window is None else zlib.decompressobj(RAW, zdict=window)
        self._trailer = 0 if window is None else TRAILER
        self._begins = window is None

    @property
    def is_open(self) -> bool:
        """Whether a stream has begun, and not ended."""
        return not self._stream.eof

    def unpacked(self, chunk: bytes) -> Iterator[tuple[int | None, bytes]]:
        """The content of the next bytes of the file, in parts; for each the byte of the chunk that its stream begins
        at, where it is the first part of one."""
        place = 0
        while place < len(chunk):
            if self._stream.eof and self._trailer:
                passed = min(self._trailer, len(chunk) - place)
                self._trailer, place = self._trailer - passed, place + passed
                continue
            if self._stream.eof:
                following = NOT_ZERO.search(chunk, place)
                if following is None:
                    return
                place = following.start()
                self._stream, self._begins = zlib.decompressobj(GZIP), True
            first = place if self._begins else None
            piece = chunk[place : place + PIECE]
            part = self._stream.decompress(piece, LARGEST_PART)
            place += len(piece) - len(self._stream.unused_data) - len(self._stream.unconsumed_tail)
            self._begins = False
            yield first, part


# ----------------------------------------------------------------------------------------------------- starts of blocks


def _block_start(chunk: bytes, content: bytes) -> tuple[int, int] | None:
    """The first block that begins with a byte of a chunk: that byte, and how far into what the chunk adds.

    ``content``: the window before, and all that the chunk unpacks to.
    """
    for first in _header_like(chunk):
        # The last byte may hold the beginning of a code.
        start = _matching_start(chunk[first:-1], content)
        if start is not None:
            return first, start - WINDOW
    return None


def _matching_start(packed: bytes, content: bytes) -> int | None:
    """Where in the content the unpacked bytes begin, if they are the content from there nearly to its end."""
    try:
        zeros, ones = (zlib.decompressobj(RAW, zdict=bytes([fill]) * WINDOW) for fill in (0, 255))
        low, high = (np.frombuffer(stream.decompress(packed), np.uint8) for stream in (zeros, ones))
    except zlib.error:
        return None
    if len(low) != len(high) or len(low) < WINDOW // 8:
        return None
    known = np.flatnonzero(low == high)  # what does not depend on the content before
    # The last byte of the chunk is left out: a few codes, of a byte or a match each.
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
    """Bytes that may begin a block with codes of its own (RFC 1951, section 3.2.7) other than the last."""
    bits = np.unpackbits(np.frombuffer(chunk, np.uint8), bitorder="little")
    places = np.arange(0, max(len(bits) - LONGEST_HEADER, 0), 8)
    places = places[(bits[places] == 0) & (bits[places + 1] == 0) & (bits[places + 2] == 1)]
    places = places[(_number(bits, places + 3, 5) <= MOST_CODES) & (_number(bits, places + 8, 5) <= MOST_CODES)]
    return (places[_has_full_code(bits, places)] // 8).tolist()


def _has_full_code(bits: UInt8[np.ndarray, " n"], places: Int[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """Whether the code for code lengths in a header uses all of its words, as zlib demands."""
    count = _number(bits, places + 13, 4) + 4
    total = np.zeros(len(places), np.int64)
    for i in range(CODE_LENGTHS):
        length = _number(bits, places + 17 + 3 * i, 3)
        total += np.where((i < count) & (length > 0), FULL_CODE >> length, 0)
    return total == FULL_CODE


def _number(bits: UInt8[np.ndarray, " n"], places: Int[np.ndarray, " k"], width: int) -> Int[np.ndarray, " k"]:
    """Numbers of ``width`` bits, the lowest first."""
    return sum((bits[places + i].astype(np.int64) << i for i in range(width)), np.zeros(len(places), np.int64))
