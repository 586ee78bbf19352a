"""Warp's devices: names, start-up, memory pool, streams, and loading of compiled kernels."""

import contextlib
import ctypes
import logging
import os
import stat
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
import warp as wp

from gcd_dataset.errors import ConfigError, DrapeError, OutputError

logger = logging.getLogger("gcd_dataset")

# Warp logs every module it loads; in a data loader's workers that drowns the user's output.
wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)

launch_lock = threading.RLock()
"""Hold this lock to launch kernels or capture graphs: on a GPU a capture records the launches of every thread.
Replaying a graph does not need it."""

Result = TypeVar("Result")
Resumable = Generator[None, None, Result]
"""Work in steps: yields when a step is queued on the current stream; resume it once the device has ended that step."""

_loaded: set[tuple[str, str]] = set()


def resolve_device(name: str) -> str:
    """Warp's name of a device; ``auto`` is the first GPU, or the CPU without one. Raises ``ConfigError`` if unknown.

    >>> resolve_device("cpu")
    'cpu'
    """
    _init_warp()
    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = {device.alias: device.alias for device in wp.get_devices()}
    if wp.is_cuda_available():
        known["cuda"] = "cuda:0"
    if name not in known:
        raise ConfigError(f"unknown device {name!r}: choose one of auto, {', '.join(sorted(known))}")
    return known[name]


def every_device() -> tuple[str, ...]:
    """All GPUs, or the CPU on a machine without GPUs."""
    _init_warp()
    return tuple(device.alias for device in wp.get_cuda_devices()) or ("cpu",)


def device_names(devices: Iterable[str]) -> dict[str, str]:
    """The product name of each device, such as ``NVIDIA H200``."""
    _init_warp()
    return {device: wp.get_device(device).name for device in devices}


@cache
def _init_warp() -> None:
    """Initialise Warp, once, with stderr redirected: its C library prints a warning on machines without a GPU driver.

    Raises ``OutputError`` if no folder for compiled kernels can be written.
    """
    sys.stderr.flush()
    stderr, devnull = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(devnull, 2)
        problem = _init_with_writable_cache()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(devnull)
    if problem is not None:
        logger.warning(
            "compiled kernels are kept in %s, since %s: set WARP_CACHE_PATH to keep them elsewhere",
            wp.config.kernel_cache_dir,
            problem,
        )


def _init_with_writable_cache() -> str | None:
    """Initialise Warp with a writable kernel cache; returns the problem with Warp's default cache, if any."""
    try:
        wp.init()
        with tempfile.TemporaryFile(dir=wp.config.kernel_cache_dir):
            return None
    except OSError as error:
        problem = f"{error.filename or wp.config.kernel_cache_dir} cannot be written ({error.strerror})"
    wp.config.kernel_cache_dir = str(_private_folder())
    wp.init()
    return problem


def _private_folder() -> Path:
    """A temporary folder that only this user may write, since its compiled code is executed."""
    try:
        folder = Path(tempfile.gettempdir()) / f"gcd_dataset-kernels-{os.getuid()}"
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
            return folder
        return Path(tempfile.mkdtemp(prefix="gcd_dataset-kernels-"))
    except OSError as error:
        raise OutputError(
            f"no folder for compiled kernels can be written ({error.strerror}): set WARP_CACHE_PATH to one"
        ) from error


def to_host(array: wp.array) -> np.ndarray:
    """A copy in host memory, in the order of the current stream: ``array.numpy()`` would wait for other streams."""
    if array.device.is_cpu:  # not by Warp, which looks for a capture that another thread may end meanwhile
        return np.array(array.numpy())
    return wp.clone(array, device="cpu").numpy()


class HostMirror:
    """Copies of device arrays in page-locked memory, which is kept: locking it takes longer than the copies."""

    def __init__(self) -> None:
        self._kept: dict[tuple[Any, tuple[int, ...], int], wp.array] = {}

    def fetch(self, *arrays: wp.array) -> Resumable[list[np.ndarray]]:
        """The arrays in host memory, valid until the next call."""
        copies = [self._queued(number, array) for number, array in enumerate(arrays)]
        yield
        return copies

    def _queued(self, number: int, array: wp.array) -> np.ndarray:
        """The copy of an array, once the current stream has ended; on a CPU at once."""
        if array.device.is_cpu:
            return to_host(array)
        key = array.dtype, array.shape, number
        if key not in self._kept:
            self._kept[key] = wp.empty(array.shape, dtype=array.dtype, device="cpu", pinned=True)
        wp.copy(self._kept[key], array)
        return self._kept[key].numpy()


@contextlib.contextmanager
def keep_freed_memory(device: str) -> Iterator[None]:
    """Within the block, CUDA's memory pool keeps freed memory for this process.

    By default CUDA returns freed memory at every synchronisation and maps memory anew for the next batch.
    """
    gpu = wp.get_device(device)
    if not (gpu.is_cuda and gpu.is_mempool_enabled):
        yield
        return
    before = wp.get_mempool_release_threshold(gpu)
    wp.set_mempool_release_threshold(gpu, gpu.total_memory)
    try:
        yield
    finally:
        wp.set_mempool_release_threshold(gpu, before)
    wp.synchronize_device(gpu)  # returns the memory


def keep_some_memory(device: str) -> None:
    """From now on CUDA's memory pool keeps up to ``KEPT`` bytes of freed memory for this process, or more if it did.

    For renderings, one after the other: by default each synchronisation returns the memory of the last one.
    """
    gpu = wp.get_device(device)
    if gpu.is_cuda and gpu.is_mempool_enabled and wp.get_mempool_release_threshold(gpu) < KEPT:
        wp.set_mempool_release_threshold(gpu, KEPT)


KEPT = 3 << 30  # bytes: two renderings of 64 × 512² pixels with all maps


def cores() -> int:
    """Cores that this process may use; all cores on systems without affinity, such as macOS."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_kernels(task: str, *modules: ModuleType, device: str) -> None:
    """Load the kernels of ``modules`` on a device; logs a warning before it compiles any.

    ``task`` names the kernels in the warning, such as ``drape``.
    """
    _init_warp()
    with launch_lock:
        missing = [module for module in modules if (module.__name__, device) not in _loaded]
        if missing and not kernels_cached(*missing, device=device):
            logger.warning("compiling the kernels of the %s for %s, once on this machine: half a minute", task, device)
        wp.force_load(device, [wp.get_module(module.__name__) for module in missing], max_workers=cores())
        _loaded.update((module.__name__, device) for module in missing)


def kernels_cached(*modules: ModuleType, device: str) -> bool:
    """Whether the cache holds the kernels of ``modules``, compiled for a device."""
    _init_warp()
    on_cpu, cache_folder = wp.get_device(device).is_cpu, Path(wp.config.kernel_cache_dir)
    endings, options = ((".o",), {"block_dim": 1}) if on_cpu else ((".cubin", ".ptx"), {})
    names = (wp.get_module(module.__name__).get_module_identifier(**options) for module in modules)
    return all(any(path.suffix in endings for path in (cache_folder / name).glob("*")) for name in names)


NON_BLOCKING = 1  # CU_STREAM_NON_BLOCKING, flag of cuStreamCreateWithPriority
URGENT = -1  # the priority of the default stream is 0, lower numbers come first


class WorkStream:
    """A stream and an urgent stream. Their work runs beside that of other streams, and their arrays are freed late.

    Warp frees an array on CUDA's default stream. Warp's own streams wait for that stream and it for them, so the
    batches of two such streams would wait for each other whenever an array is freed. A ``WorkStream`` does not
    synchronise with the default stream; it frees arrays itself, once the device has ended the work that uses them.
    """

    def __init__(self, gpu: wp.Device) -> None:
        self._gpu = gpu
        self._stream, self._urgent = (wp.Stream(gpu, cuda_stream=_new_stream(gpu, each)) for each in (0, URGENT))
        self._allocator = _DeferredFrees(gpu)
        self._reached = wp.Event(gpu)
        self._is_urgent = False
        """Whether the last work was urgent."""

    @contextlib.contextmanager
    def active(self, *, urgent: bool = False) -> Iterator[None]:
        """Launch and allocate on this stream within the block; ``urgent``: before the waiting work of other streams.

        Urgent work waits for the work before it, and later work for it.
        """
        stream, other = (self._urgent, self._stream) if urgent else (self._stream, self._urgent)
        with launch_lock, wp.ScopedStream(stream, sync_enter=False), wp.ScopedAllocator(self._gpu, self._allocator):
            if self._is_urgent is not urgent:
                stream.wait_stream(other)
                self._is_urgent = urgent
            yield

    def wait(self) -> None:
        """Wait until the device has ended the work of both streams, then free the arrays dropped meanwhile."""
        with launch_lock:
            wp.synchronize_stream(self._stream)
            wp.synchronize_stream(self._urgent)
            self.free_dropped()

    def free_dropped(self) -> None:
        """Free the arrays dropped so far. Call it when the device has ended the work of both streams."""
        self._allocator.free_dropped()

    def mark(self) -> None:
        """Mark this point of the active stream for ``reached``."""
        self._gpu.stream.record_event(self._reached)

    def reached(self) -> bool:
        """Whether the device has reached the last mark."""
        return bool(self._reached.is_complete)


_streams: dict[tuple[str, int], WorkStream] = {}
_builders: dict[str, wp.Stream] = {}


def work_streams(device: str, count: int) -> list[WorkStream | None]:
    """Streams of a device, the same in every call; ``None`` for each on a CPU. Raises ``DrapeError`` if CUDA fails."""
    gpu = wp.get_device(device)
    if not gpu.is_cuda:
        return [None] * count
    return [_streams.get((device, k)) or _streams.setdefault((device, k), WorkStream(gpu)) for k in range(count)]


@contextlib.contextmanager
def native_builds(device: str) -> Iterator[None]:
    """Build a ``Mesh`` or ``Bvh`` within the block, after the current stream's work and before its further work.

    Warp's native code frees memory that the build's kernels still use. The default stream, on which it does so, waits
    for Warp's own streams; it would not wait for a ``WorkStream``.
    """
    gpu = wp.get_device(device)
    if not gpu.is_cuda:
        yield
        return
    with launch_lock:
        wp.synchronize_stream(gpu.stream)
        stream = _builders.get(device) or _builders.setdefault(device, wp.Stream(gpu, priority=URGENT))
        with wp.ScopedStream(stream, sync_enter=False):
            yield
        wp.synchronize_stream(stream)


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


def _new_stream(gpu: wp.Device, priority: int) -> int:
    """The handle of a new stream that does not synchronise with CUDA's default stream."""
    driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    handle = ctypes.c_void_p()
    with gpu.context_guard:
        error = driver.cuStreamCreateWithPriority(ctypes.byref(handle), NON_BLOCKING, priority)
    if error or handle.value is None:
        raise DrapeError(f"{gpu.alias}: CUDA made no stream (error {error}): start again, on another GPU if it repeats")
    return handle.value
