"""Streams of a GPU whose work runs side by side.

Warp frees an array on CUDA's default stream. Warp's own streams wait for that stream and it for them, so the batches of
two such streams would wait for each other whenever an array is freed. A ``WorkStream`` does not synchronise with the
default stream; it frees arrays itself, once the device has ended the work that uses them.
"""

import contextlib
import ctypes
import sys
from collections import deque
from collections.abc import Iterator
from functools import cache

import warp as wp

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drape.device import launch_lock

NON_BLOCKING = 1  # CU_STREAM_NON_BLOCKING, flag of cuStreamCreate


class WorkStream:
    """A stream with an allocator that defers frees to ``wait``."""

    def __init__(self, gpu: wp.Device) -> None:
        self._gpu = gpu
        self._stream = wp.Stream(gpu, cuda_stream=_new_stream(gpu))
        self._allocator = _DeferredFrees(gpu)
        self._reached = wp.Event(gpu)

    @contextlib.contextmanager
    def active(self) -> Iterator[None]:
        """Launch and allocate on this stream within the block."""
        with (
            launch_lock,
            wp.ScopedStream(self._stream, sync_enter=False),
            wp.ScopedAllocator(self._gpu, self._allocator),
        ):
            yield

    def wait(self) -> None:
        """Wait until the device has ended this stream's work, then free the arrays that were dropped meanwhile."""
        with launch_lock:
            wp.synchronize_stream(self._stream)
            self._allocator.free_dropped()

    def mark(self) -> None:
        """Mark this point of the stream for ``reached``."""
        self._stream.record_event(self._reached)

    def reached(self) -> bool:
        """Whether the device has reached the last mark."""
        return bool(self._reached.is_complete)


@cache
def work_streams(device: str, count: int) -> tuple[WorkStream | None, ...]:
    """Streams of a device, the same in every call; ``None`` for each on a CPU. Raises ``DrapeError`` if CUDA fails."""
    gpu = wp.get_device(device)
    return tuple(_work_stream(device, number) if gpu.is_cuda else None for number in range(count))


@cache
def _work_stream(device: str, number: int) -> WorkStream:
    return WorkStream(wp.get_device(device))


@contextlib.contextmanager
def native_builds(device: str) -> Iterator[None]:
    """Build a ``Mesh`` or ``Bvh`` within the block, after the current stream's work and before its further work.

    Warp's native code frees memory that the build's kernels still use. The default stream waits for them, a
    ``WorkStream`` would not.
    """
    gpu = wp.get_device(device)
    if not gpu.is_cuda:
        yield
        return
    with launch_lock:
        wp.synchronize_stream(gpu.stream)
        with wp.ScopedStream(gpu.null_stream, sync_enter=False):
            yield
        wp.synchronize_stream(gpu.null_stream)


class _DeferredFrees:
    """Allocates from the device's memory pool, and frees in ``free_dropped``."""

    def __init__(self, gpu: wp.Device) -> None:
        self._gpu, self._pool = gpu, wp.get_device_allocator(gpu)
        self._dropped: deque[tuple[int, int]] = deque()

    def allocate(self, size_in_bytes: int) -> int:
        return int(self._pool.allocate(size_in_bytes))

    def deallocate(self, ptr: int, size_in_bytes: int) -> None:
        self._dropped.append((ptr, size_in_bytes))

    def free_dropped(self) -> None:
        with self._gpu.context_guard:
            while self._dropped:
                self._pool.deallocate(*self._dropped.popleft())


def _new_stream(gpu: wp.Device) -> int:
    """The handle of a new stream that does not synchronise with CUDA's default stream."""
    driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    handle = ctypes.c_void_p()
    with gpu.context_guard:
        error = driver.cuStreamCreate(ctypes.byref(handle), NON_BLOCKING)
    if error or handle.value is None:
        raise DrapeError(f"{gpu.alias}: CUDA made no stream (error {error}): start again, on another GPU if it repeats")
    return handle.value
