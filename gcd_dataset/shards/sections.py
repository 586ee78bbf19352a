"""Compact containers of arrays, the ``.z`` members of a sample: named sections in one frame of Zstandard.

The frame holds its checksum. Decompressed it is a row of sections, each a head of 32 bytes and a body::

    name 16 B | rows u32 | columns u16, 0 for one axis | type 2 B | coding u8 | planes u8 | step i8 | 0 | size u32

``size`` is the length of the body [bytes], so that a reader can skip the sections that it does not know. The type is
NumPy's, little-endian: ``f8``, ``i4``. By coding, the body holds

=====  ===============================================================================================================
0      the array, row after row
1, 2   integers: differences of neighbouring rows (1), or differences of these differences (2); before the first row
       are zeros
3      integers, three columns: the differences of the first column, then the other columns less the first
=====  ===============================================================================================================

Integers are coded column after column as 2 |i| - (i < 0), and written as ``planes`` planes of bytes: first the lowest
byte of every number, then the next one. The decoded number is the integer times 2 to the power ``step``, float32, or
the integer itself, int32, if ``step`` is 127; other steps are -64 to 64.

>>> data = pack({"a": np.array([[0.5, 2.0], [0.75, 2.0]], np.float32)}, {"a": Coding(1, step=-2)})
>>> unpack(data)["a"].tolist()
[[0.5, 2.0], [0.75, 2.0]]
"""

import hashlib
import struct
import threading
from collections.abc import Container, Iterator, Mapping
from typing import NamedTuple

import numpy as np
import zstandard
from jaxtyping import Int

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.layout import LARGEST_SAMPLE

HEAD = struct.Struct("<16sIH2sBBbxI")
TYPES = frozenset({b"f8", b"f4", b"f2", b"i8", b"i4", b"u4", b"u2", b"u1"})
ZSTANDARD = zstandard.ZstdCompressionParameters(
    strategy=zstandard.STRATEGY_DFAST, window_log=20, hash_log=14, chain_log=13, search_log=1, min_match=4,
    write_content_size=True, write_checksum=True,
)  # fmt: skip
"""As a low level, with tables that fit into a core's cache: level 9 saves 3 % of the bytes and takes twice as long."""
WHOLE = 127  # step of integers
LARGEST_STEP = 64  # of others, either way: no number exceeds float32
LARGEST_NUMBER = (1 << 30) - 1  # its differences of differences fit into int32
EXPANSION, ALWAYS = 64, 1 << 20  # a frame may unpack to 64 times its size, and to 1 MB in any case
PADDING = "padding"  # section of incompressible bytes that keeps the frame of a very regular mesh within these limits

_own = threading.local()  # contexts of Zstandard must not be used by two threads at a time


class Coding(NamedTuple):
    """How a section's numbers are coded; see above."""

    order: int = 1
    step: int = WHOLE
    """The numbers are multiples of 2 to this power; ``WHOLE``: integers."""


RAW = Coding(0)


def pack(sections: Mapping[str, np.ndarray], codings: Mapping[str, Coding] = {}) -> bytes:
    """The container of arrays with one or two axes; equal arrays give equal bytes with one version of Zstandard.

    An array without a coding is stored as it is. One with NaN, infinities or numbers too large for its coding is stored
    as float32. Raises ``ShardError`` for an array of another type or shape.
    """
    data = b"".join(part for name, array in sections.items() for part in _section(name, array, codings.get(name, RAW)))
    if not hasattr(_own, "compressor"):
        _own.compressor = zstandard.ZstdCompressor(compression_params=ZSTANDARD)
    packed: bytes = _own.compressor.compress(data)
    if len(data) > max(EXPANSION * len(packed), ALWAYS):
        noise = np.frombuffer(hashlib.shake_128().digest(-(-len(data) // (EXPANSION - 1))), np.uint8)
        packed = _own.compressor.compress(data + b"".join(_section(PADDING, noise, RAW)))
    return packed


def unpack(
    data: bytes | bytearray | memoryview, wanted: Container[str] | None = None, *, limit: int = LARGEST_SAMPLE
) -> dict[str, np.ndarray]:
    """The arrays of a container, or the ``wanted`` ones; raw arrays are views of one buffer, which is read-only.

    Raises ``ShardError`` for damaged data, and before anything is allocated for data that would take more than
    ``limit`` bytes or ``EXPANSION`` times its own size.
    """
    content = _decompressed(data, limit)
    return {
        name: _decoded(content, start, head) for name, start, head in _heads(content) if not wanted or name in wanted
    }


def _section(name: str, array: np.ndarray, coding: Coding) -> Iterator[bytes]:
    """Head and body."""
    numbers = _integers(array, coding) if coding.order else None
    if numbers is not None:
        body, planes = _planes(_differences(numbers, coding.order))
        kind = b"i4"
    else:
        with np.errstate(over="ignore"):
            array, coding, planes = array.astype(np.float32) if coding.order else array, RAW, 0
        kind = array.dtype.newbyteorder("<").str[1:].encode()
        if kind not in TYPES or array.ndim not in (1, 2):
            raise ShardError(f"section {name}: {array.dtype} of shape {array.shape} cannot be stored")
        body = np.ascontiguousarray(array, f"<{kind.decode()}").tobytes()
    columns = array.shape[1] if array.ndim > 1 else 0
    yield HEAD.pack(name.encode(), len(array), columns, kind, coding.order, planes, coding.step, len(body))
    yield body


def _integers(array: np.ndarray, coding: Coding) -> Int[np.ndarray, "k n"] | None:
    """The numbers as multiples of the step, column by column; ``None`` for numbers that are none."""
    rows = array
    if coding.step != WHOLE:
        with np.errstate(over="ignore"):
            rows = array * 2.0**-coding.step
        np.rint(rows, out=rows)
    if rows.size and not -LARGEST_NUMBER <= rows.min() <= rows.max() <= LARGEST_NUMBER:  # true for NaN
        return None
    return np.atleast_2d(rows.T).astype(np.int32, order="C")


def _differences(columns: Int[np.ndarray, "k n"], order: int) -> Int[np.ndarray, "k n"]:
    if order == 3:
        columns[1:] -= columns[0]
        return np.concatenate([_differences(columns[:1], 1), columns[1:]])
    for _ in range(order):
        steps = columns.copy()
        steps[:, 1:] -= columns[:, :-1]
        columns = steps
    return columns


def _planes(columns: Int[np.ndarray, "k n"]) -> tuple[bytes, int]:
    codes = ((columns << 1) ^ (columns >> 31)).view(np.uint32)
    count = max((int(codes.max(initial=0)).bit_length() + 7) // 8, 1)
    return b"".join((codes >> 8 * plane).astype(np.uint8).tobytes() for plane in range(count)), count


class _Head(NamedTuple):
    rows: int
    columns: int
    kind: bytes
    order: int
    planes: int
    step: int
    size: int


def _decompressed(data: bytes | bytearray | memoryview, limit: int) -> bytes:
    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= min(limit, max(EXPANSION * len(data), ALWAYS)):
            raise ShardError(f"a frame of {len(data)} bytes that would unpack to {size if size >= 0 else 'any number'}")
        if not hasattr(_own, "decompressor"):
            _own.decompressor = zstandard.ZstdDecompressor()
        content: bytes = _own.decompressor.decompress(data, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise ShardError(f"not a whole frame of Zstandard ({error})") from error
    if len(content) != size:
        raise ShardError(f"a frame of {len(content)} bytes instead of {size}")
    return content


def _heads(content: bytes) -> Iterator[tuple[str, int, _Head]]:
    """Name, start of the body and head of each section. Raises ``ShardError``."""
    position, names = 0, set()
    while position < len(content):
        if position + HEAD.size > len(content):
            raise ShardError(f"a section is cut off at byte {position}")
        name, *values = HEAD.unpack_from(content, position)
        head, start = _Head(*values), position + HEAD.size
        if name in names or start + head.size > len(content):
            raise ShardError(f"a section occurs twice, or is cut off, at byte {position}")
        names.add(name)
        yield name.rstrip(b"\0").decode("latin-1"), start, head
        position = start + head.size


def _decoded(content: bytes, start: int, head: _Head) -> np.ndarray:
    count = head.rows * max(head.columns, 1)
    if head.order == 0 and head.kind in TYPES and head.size == count * int(head.kind[1:]):
        array = np.frombuffer(content, f"<{head.kind.decode()}", count, start)
        return array.reshape(head.rows, head.columns) if head.columns else array
    is_coded = 1 <= head.order <= 3 and 1 <= head.planes <= 4 and (head.order < 3 or head.columns == 3)
    if not is_coded or head.size != count * head.planes or (abs(head.step) > LARGEST_STEP and head.step != WHOLE):
        raise ShardError(f"a section of coding {head.order}, step {head.step}, {head.rows} rows and {head.size} bytes")
    numbers = _numbers(content, start, count, head.planes).reshape(max(head.columns, 1), head.rows)
    out: np.ndarray = np.empty((head.rows, len(numbers)), np.int32 if head.step == WHOLE else np.float32)
    for column, values in enumerate(_summed(numbers, head.order)):
        out[:, column] = values
    if head.step != WHOLE:
        out *= np.float32(2.0**head.step)
    return out if head.columns else out[:, 0]


def _numbers(content: bytes, start: int, count: int, planes: int) -> Int[np.ndarray, " n"]:
    """The coded integers, as wide as their planes need."""
    kind = ("u1", "u2", "u4", "u4")[planes - 1]
    codes: np.ndarray = np.frombuffer(content, np.uint8, count, start).astype(kind)
    for plane in range(1, planes):
        codes |= np.frombuffer(content, np.uint8, count, start + plane * count).astype(kind) << 8 * plane
    negative = codes & 1
    codes >>= 1
    codes ^= np.negative(negative, out=negative)
    return codes.view(f"i{codes.itemsize}")


def _summed(numbers: Int[np.ndarray, "k n"], order: int) -> Iterator[Int[np.ndarray, " n"]]:
    """The columns whose differences these are."""
    sums = (np.cumsum(values, dtype=np.int32) for values in numbers)
    if order == 3:
        first = next(sums)
        yield from (first, first + numbers[1], first + numbers[2])
    else:
        yield from sums if order == 1 else (np.cumsum(values, out=values) for values in sums)
