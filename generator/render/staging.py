"""Host memory for asynchronous copies to and from a device."""

import math
import threading
from collections import defaultdict
from typing import Any, ClassVar

import numpy as np
import warp as wp
from jaxtyping import Shaped


class StagingBuffers:
    """Host memory for asynchronous copies to and from a device.

    Page-locked for a GPU; locking takes milliseconds, so released buffers go to a pool.
    """

    _free: ClassVar[defaultdict[int, list[wp.array]]] = defaultdict(list)
    _pool: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, device: str) -> None:
        self.device = device
        self.locked = wp.get_device(device).is_cuda
        self._in_use: list[wp.array] = []

    def array(self, shape: tuple[int, ...], kind: type | np.dtype) -> Shaped[np.ndarray, "*shape"]:
        """An uninitialised array, valid until ``release``."""
        needed = math.prod(shape) * np.dtype(kind).itemsize
        size = buffer_size(needed)
        if not self.locked:
            return np.empty(shape, kind)
        with self._pool:
            buffer = self._free[size].pop() if self._free[size] else None
        if buffer is None:
            buffer = wp.empty(size, dtype=wp.uint8, device="cpu", pinned=True)
        self._in_use.append(buffer)
        array: np.ndarray = buffer.numpy()[:needed].view(kind).reshape(shape)
        return array

    def event(self) -> wp.Event | None:
        """An event after the work launched so far; ``None`` for the CPU, which does not work in the background."""
        # Not wp.record_event: it takes the stream of the default device, the first GPU.
        return wp.get_stream(self.device).record_event() if self.locked else None

    def release(self) -> None:
        """Return all arrays to the pool."""
        with self._pool:
            for buffer in self._in_use:
                self._free[buffer.size].append(buffer)
        self._in_use = []


LARGE = 1 << 26  # bytes


def buffer_size(needed: int) -> int:
    """The size of the buffer for ``needed`` bytes: few sizes, so that most requests find a free buffer.

    A power of two, as meshes differ from batch to batch; above ``LARGE``, an eighth of one: pictures do not differ.
    """
    step = 1 << max(needed - 1, 0).bit_length()
    if step > LARGE:
        step >>= 3
    return -(-max(needed, 1) // step) * step


def staged_values(staging: StagingBuffers, values: Any, kind: type | np.dtype) -> Shaped[np.ndarray, "..."]:
    """A copy of ``values`` in staging memory."""
    given = np.asarray(values)
    array = staging.array(given.shape, kind)
    array[...] = given
    return array


def wrapped(values: np.ndarray, dtype: type) -> wp.array:
    """A Warp array on the host that shares the memory of ``values``."""
    return wp.array(values, dtype=dtype, device="cpu", copy=False)


def to_device(values: np.ndarray, dtype: type, device: str) -> wp.array:
    """A copy of a staging array on the device; the copy runs asynchronously."""
    source = wrapped(values, dtype)
    copy = wp.empty_like(source, device=device)
    wp.copy(copy, source)
    return copy
