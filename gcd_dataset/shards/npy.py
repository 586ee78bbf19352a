"""Arrays as ``.npy`` files of version 1.0 (NEP 1): plain numbers, C order, little-endian, data aligned to 64 bytes.

NumPy's own writer pads headers differently from version to version; the bytes of shards must not depend on its version.

>>> read_npy(write_npy(np.array([[1, 2], [3, 4]], np.uint16)))
array([[1, 2],
       [3, 4]], dtype=uint16)
"""

import io
import math
import re
import struct
from functools import lru_cache
from tokenize import TokenError

import numpy as np

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.layout import Bytes

__all__ = ["npy_header", "read_any_npy", "read_npy", "write_npy"]

MAGIC = b"\x93NUMPY\x01\x00"
ALIGNMENT = 64
USUAL = 2 * ALIGNMENT  # bytes of a header, unless the shape has many digits
KINDS = "biuf"  # NumPy's letters for booleans, integers and floats: never objects, which would need pickle
COUNT = rb"\d{1,18}"
HEADER = re.compile(
    rb"\{'descr': '(\|[biu]1|<[iu][248]|<f[248])', 'fortran_order': False, 'shape': \((|%b,|%b(?:, %b)+)\), \} *\n"
    % (3 * (COUNT,))
)


KIND_NAMES = {"U": "texts", "b": "booleans", "iu": "integers"}
BROKEN = (ValueError, SyntaxError, TypeError, EOFError, OverflowError, MemoryError, RecursionError, TokenError)
"""Exceptions of NumPy and Python's parser on broken headers."""


def write_npy(array: np.ndarray) -> bytes:
    """The array as a ``.npy`` file. Raises ``ShardError`` for anything but plain numbers."""
    if array.dtype.kind not in KINDS:
        raise ShardError(f"an array of {array.dtype} cannot be stored: only numbers can")
    dtype = array.dtype.newbyteorder("<")
    return npy_header(dtype, array.shape) + np.ascontiguousarray(array, dtype).tobytes()


def npy_header(dtype: np.dtype, shape: tuple[int, ...]) -> bytes:
    """The ``.npy`` header, magic included, of an array of little-endian numbers."""
    axes = ", ".join(str(n) for n in shape) + ("," if len(shape) == 1 else "")
    text = f"{{'descr': '{dtype.str}', 'fortran_order': False, 'shape': ({axes}), }}".encode()
    padding = -(len(MAGIC) + 2 + len(text) + 1) % ALIGNMENT
    header = text + b" " * padding + b"\n"
    return MAGIC + struct.pack("<H", len(header)) + header


def read_npy(file: Bytes) -> np.ndarray:
    """The array in a ``.npy`` file by ``write_npy``, as a view. Raises ``ShardError`` for any other file."""
    data = memoryview(file)
    start, dtype, shape, size = _parsed(bytes(data[:USUAL]))
    if start > USUAL:
        start, dtype, shape, size = _parsed(bytes(data[:start]))
    if len(data) - start != size:
        raise ShardError(f"a .npy file of {len(data) - start} bytes for {dtype} of shape {shape}")
    try:
        return np.ndarray(shape, dtype, data, start)
    except ValueError as error:  # more axes than NumPy has
        raise ShardError(f"a .npy file of shape {shape} ({error})") from error


def read_any_npy(file: Bytes, kinds: str) -> np.ndarray:
    """The array in a ``.npy`` file by any writer, in this machine's byte order.

    ``kinds``: allowed letters of ``dtype.kind``. The declared size is compared with the file's before anything is
    allocated. Raises ``ShardError``.
    """
    stream = io.BytesIO(file)
    try:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise ShardError(f"a .npy file of version {version[0]}.{version[1]}, expected 1.0 or 2.0")
        header = getattr(np.lib.format, f"read_array_header_{version[0]}_0")
        shape, is_fortran, dtype = header(stream)
        if dtype.kind not in kinds or dtype.hasobject:
            raise ShardError(f"{dtype}, expected {KIND_NAMES.get(kinds, 'numbers')}")
        size = dtype.itemsize * math.prod(shape)
        if min(shape, default=0) < 0 or len(file) - stream.tell() != size:
            raise ShardError(f"a .npy file of {len(file) - stream.tell()} bytes for {dtype} of shape {shape}")
        flat = np.frombuffer(file, dtype, math.prod(shape), stream.tell()) if size else np.empty(shape, dtype)
        array = flat.reshape(shape, order="F" if is_fortran else "C")
    except BROKEN as error:
        raise ShardError(f"not a .npy file ({error})") from error
    return array.astype(dtype.newbyteorder("="), copy=False)


@lru_cache(maxsize=4096)
def _parsed(head: bytes) -> tuple[int, np.dtype, tuple[int, ...], int]:
    """Offset, type, shape and size [bytes] of the array; only the offset is valid where ``head`` is too short."""
    if not head.startswith(MAGIC) or len(head) < len(MAGIC) + 2:
        raise ShardError("not a .npy file of version 1.0")
    start = len(MAGIC) + 2 + struct.unpack_from("<H", head, len(MAGIC))[0]
    if start > len(head) == USUAL:
        return start, np.dtype("u1"), (), 0
    match = HEADER.fullmatch(head[len(MAGIC) + 2 : start])
    if match is None:
        raise ShardError("a .npy header by another writer: expected plain, C-ordered, little-endian numbers")
    dtype, shape = np.dtype(match[1].decode()), tuple(int(n) for n in match[2].split(b",") if n.strip())
    return start, dtype, shape, dtype.itemsize * math.prod(shape)
