"""A pool of read buffers.

The system clears each page of fresh memory at its first use. Measured for 800 kB: clearing takes 0.8 ms, copying a
garment into it 0.2 ms.

>>> first = read_buffer(100_000)
>>> address = first.ctypes.data
>>> del first
>>> read_buffer(100_000).ctypes.data == address
True
"""

import sys
from collections import defaultdict

import numpy as np
from jaxtyping import UInt8

SMALL = 1 << 16  # bytes: smaller allocations usually reuse touched pages anyway
MOST_KEPT = 1 << 26  # bytes of buffers kept, of each size
MOST_TRIED = 16  # buffers of a size that are looked at

_kept: dict[int, list[np.ndarray]] = defaultdict(list)
"""Buffers by size, the one lent last at the end. Views of an array refer to the array that owns the memory."""


def _references(kept: list[np.ndarray]) -> int:
    """References to the last buffer, taken out as in ``_unused``; their number differs between versions of Python."""
    memory = kept.pop()
    return sys.getrefcount(memory)


UNUSED = _references([np.empty(0, np.uint8)])
"""References to a buffer that no array views."""


def read_buffer(size: int) -> UInt8[np.ndarray, " size"]:
    """An uninitialised array of ``size`` bytes, from the pool unless it is small. Safe for threads and forks."""
    if size < SMALL:
        return np.empty(size, np.uint8)
    room = 1 << (size - 1).bit_length()
    kept = _kept[room]
    memory = _unused(kept)
    if memory is None:
        memory = np.empty(room, np.uint8)
    if (len(kept) + 1) * room <= MOST_KEPT:
        kept.append(memory)
    return memory[:size]


def _unused(kept: list[np.ndarray]) -> np.ndarray | None:
    """Take out the buffer lent last among those that no array views."""
    used: list[np.ndarray] = []
    try:
        while len(used) < MOST_TRIED:
            memory = kept.pop()  # no other thread sees it meanwhile
            if sys.getrefcount(memory) == UNUSED:
                return memory
            used.append(memory)
    except IndexError:
        pass
    finally:
        kept.extend(reversed(used))
    return None
