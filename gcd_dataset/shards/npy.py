"""Arrays as ``.npy`` files of version 1.0: plain numbers, C order, little-endian, data aligned to 64 bytes.

NumPy's own writer pads headers differently from release to release; shards must not change with it. The format is
that of the NumPy Enhancement Proposal 1.

>>> read_npy(write_npy(np.array([[1, 2], [3, 4]], np.uint16)))
array([[1, 2],
       [3, 4]], dtype=uint16)
"""

import math
import re
import struct
from functools import lru_cache

import numpy as np

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.layout import Bytes

__all__ = ["npy_header", "read_npy", "write_npy"]

MAGIC = b"\x93NUMPY\x01\x00"
ALIGNMENT = 64
USUAL = 2 * ALIGNMENT  # bytes of a header, unless it has many numbers
KINDS = "biuf"  # NumPy's letters for booleans, integers and floats: never objects, which would need pickle
HEADER = re.compile(rb"\{'descr': '([<|][biuf]\d)', 'fortran_order': False, 'shape': \(([\d, ]*)\), \} *\n")


def write_npy(array: np.ndarray) -> bytes:
    """The array as a ``.npy`` file. Raises ``ShardError`` for anything but plain numbers."""
    if array.dtype.kind not in KINDS:
        raise ShardError(f"an array of {array.dtype} cannot be stored: only numbers can")
    dtype = array.dtype.newbyteorder("<")
    return npy_header(dtype, array.shape) + np.ascontiguousarray(array, dtype).tobytes()


def npy_header(dtype: np.dtype, shape: tuple[int, ...]) -> bytes:
    """How the ``.npy`` file of an array of little-endian numbers begins."""
    axes = ", ".join(str(n) for n in shape) + ("," if len(shape) == 1 else "")
    text = f"{{'descr': '{dtype.str}', 'fortran_order': False, 'shape': ({axes}), }}".encode()
    padding = -(len(MAGIC) + 2 + len(text) + 1) % ALIGNMENT
    header = text + b" " * padding + b"\n"
    return MAGIC + struct.pack("<H", len(header)) + header


def read_npy(file: Bytes) -> np.ndarray:
    """The array in a ``.npy`` file, as a view of it. Raises ``ShardError`` for a file of another writer."""
    data = memoryview(file)
    start, dtype, shape, size = _parsed(bytes(data[:USUAL]))
    if start > USUAL:
        start, dtype, shape, size = _parsed(bytes(data[:start]))
    if len(data) - start != size:
        raise ShardError(f"a .npy file of {len(data) - start} bytes for {dtype} of shape {shape}")
    return np.ndarray(shape, dtype, data, start)


@lru_cache(maxsize=4096)
def _parsed(head: bytes) -> tuple[int, np.dtype, tuple[int, ...], int]:
    """Where the array begins, its type and shape, and how many bytes it takes; if ``head`` is too short the first."""
    if not head.startswith(MAGIC) or len(head) < len(MAGIC) + 2:
        raise ShardError("not a .npy file of version 1.0")
    start = len(MAGIC) + 2 + struct.unpack_from("<H", head, len(MAGIC))[0]
    if start > len(head) == USUAL:
        return start, np.dtype("u1"), (), 0
    match = HEADER.fullmatch(head[len(MAGIC) + 2 : start])
    if match is None:
        raise ShardError("a .npy header of another writer: only plain C-ordered, little-endian numbers are read")
    dtype, shape = np.dtype(match[1].decode()), tuple(int(n) for n in match[2].split(b",") if n.strip())
    return start, dtype, shape, dtype.itemsize * math.prod(shape)
