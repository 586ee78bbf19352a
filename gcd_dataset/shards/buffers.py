"""A pool of read buffers.

The system clears each page of fresh memory at its first use. Measured for 800 kB: clearing takes 0.8 ms, copying a
garment into it 0.2 ms.

>>> first = read_buffer(100_000)
>>> address = first.ctypes.data
>>> del first
>>> read_buffer(100_000).ctypes.data == address
True
"""

import ctypes
import weakref
from collections import defaultdict

import numpy as np
from jaxtyping import UInt8

SMALL = 1 << 16  # bytes: smaller allocations usually reuse touched pages anyway
MOST_FREE = 1 << 26  # bytes of free buffers kept, of each size


class _Pool:
    """Free buffers by size. Safe for threads and forks."""

    def __init__(self) -> None:
        self._most_free = MOST_FREE  # the module's names are gone when the interpreter ends
        self._free: dict[int, list[np.ndarray]] = defaultdict(list)
        # Cached: making a ctypes type takes longer than reading a garment.
        self._kinds: dict[int, type[ctypes.Array]] = {}
        self._lent: dict[int, tuple[weakref.ref, np.ndarray]] = {}

    def lend(self, size: int) -> ctypes.Array:
        """A buffer; its memory returns to the pool with the last array made from it."""
        try:
            memory = self._free[size].pop()
        except IndexError:
            memory = np.empty(size, np.uint8)
        kind = self._kinds.get(size) or self._kinds.setdefault(size, ctypes.c_uint8 * size)
        # Lend a ctypes array: views of a NumPy array refer to its base, so they would keep no wrapper array alive.
        buffer = kind.from_buffer(memory.data)
        key = id(memory)
        self._lent[key] = weakref.ref(buffer, lambda _: self._take_back(key)), memory
        return buffer

    def _take_back(self, key: int) -> None:
        _, memory = self._lent.pop(key)
        free = self._free[memory.size]
        if (len(free) + 1) * memory.size <= self._most_free:
            free.append(memory)


_pool = _Pool()


def read_buffer(size: int) -> UInt8[np.ndarray, " size"]:
    """An uninitialised array of ``size`` bytes, from the pool unless it is small."""
    if size < SMALL:
        return np.empty(size, np.uint8)
    return np.frombuffer(memoryview(_pool.lend(1 << (size - 1).bit_length())), np.uint8, size)
