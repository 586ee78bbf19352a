"""Memory for what is read, used again when nobody holds it any more.

Fresh memory costs more than what is read into it: the system clears every page when it is first touched, which took
several times as long as to copy a garment there (measured: 0.8 ms for 800 kB, against 0.2).

>>> first = room_for(100_000)
>>> where = first.ctypes.data
>>> del first
>>> room_for(100_000).ctypes.data == where
True
"""

import ctypes
import weakref
from collections import defaultdict

import numpy as np
from jaxtyping import UInt8

__all__ = ["room_for"]

SMALL = 1 << 16  # bytes: what is smaller has been touched before, as a rule
KEPT = 1 << 26  # bytes of each size that nobody uses, at most


class _Pool:
    """Free memory by size; may be used by several threads, and forked."""

    def __init__(self) -> None:
        self._free: dict[int, list[np.ndarray]] = defaultdict(list)
        self._kinds: dict[int, type[ctypes.Array]] = {}  # kept: to make a type anew takes longer than to read a garment
        self._lent: dict[int, tuple[weakref.ref, np.ndarray]] = {}

    def lend(self, size: int) -> ctypes.Array:
        """A buffer; once it and all that are made of it are gone the memory is free."""
        try:
            memory = self._free[size].pop()
        except IndexError:
            memory = np.empty(size, np.uint8)
        kind = self._kinds.get(size) or self._kinds.setdefault(size, ctypes.c_uint8 * size)
        # An array of ctypes, since views of a NumPy array hold that itself, and nothing between them and it.
        buffer = kind.from_buffer(memory.data)
        place = id(memory)
        self._lent[place] = weakref.ref(buffer, lambda _: self._take_back(place)), memory
        return buffer

    def _take_back(self, place: int) -> None:
        _, memory = self._lent.pop(place)
        free = self._free[memory.size]
        if (len(free) + 1) * memory.size <= KEPT:
            free.append(memory)


_pool = _Pool()


def room_for(size: int) -> UInt8[np.ndarray, " size"]:
    """So many bytes, whatever is in them."""
    if size < SMALL:
        return np.empty(size, np.uint8)
    return np.frombuffer(memoryview(_pool.lend(1 << (size - 1).bit_length())), np.uint8, size)
