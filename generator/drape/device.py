"""Which device Warp runs on, and its kernels loaded there."""

import contextlib
import logging
import os
import stat
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import warp as wp

from gcd_dataset.errors import ConfigError, OutputError

__all__ = [
    "cores",
    "device_names",
    "every_device",
    "kernels_cached",
    "load_kernels",
    "memory_kept",
    "one_at_a_time",
    "resolve_device",
]

logger = logging.getLogger("gcd_dataset")

# Warp announces every module it loads; in a data loader's workers that drowns what the user prints.
wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)

one_at_a_time = threading.RLock()
"""Held wherever kernels are launched or recorded: on a GPU a recording takes in what any thread launches there. Graphs
are played without it."""

_loaded: set[tuple[str, str]] = set()


def resolve_device(name: str) -> str:
    """``auto`` becomes the first GPU or the CPU. Raises ``ConfigError`` where there is no such device."""
    _begin()
    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = {device.alias: device.alias for device in wp.get_devices()}
    if wp.is_cuda_available():
        known["cuda"] = "cuda:0"
    if name not in known:
        raise ConfigError(f"device {name}: there is {', '.join(sorted(known))}: use --device auto or cpu")
    return known[name]


def every_device() -> tuple[str, ...]:
    """All GPUs, or the CPU where there is none."""
    _begin()
    return tuple(device.alias for device in wp.get_cuda_devices()) or ("cpu",)


def device_names(devices: Iterable[str]) -> dict[str, str]:
    """What the makers of devices call them, by our name."""
    _begin()
    return {device: wp.get_device(device).name for device in devices}


@cache
def _begin() -> None:
    """Start Warp without the line that its library prints, past Python, on machines that have no GPU driver.

    Raises ``OutputError`` where no folder can be written that compiled kernels may be kept in.
    """
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        refused = _start_warp()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
    if refused is not None:
        logger.warning(
            "compiled kernels are kept in %s, since %s: set WARP_CACHE_PATH to keep them elsewhere",
            wp.config.kernel_cache_dir,
            refused,
        )


def _start_warp() -> str | None:
    """Start Warp with a cache that can be written; why it is not Warp's own, if it is not."""
    try:
        wp.init()
        with tempfile.TemporaryFile(dir=wp.config.kernel_cache_dir):
            return None
    except OSError as error:
        refused = f"{error.filename or wp.config.kernel_cache_dir} cannot be written ({error.strerror})"
    wp.config.kernel_cache_dir = str(_own_folder())
    wp.init()
    return refused


def _own_folder() -> Path:
    """A folder among the temporary ones that nobody else may write: what lies in it is run."""
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


@contextlib.contextmanager
def memory_kept(device: str) -> Iterator[None]:
    """Within the block, this process keeps the memory of a GPU that it has freed.

    By default CUDA hands it back at every synchronisation, and maps it again for the next batch.
    """
    where = wp.get_device(device)
    if not (where.is_cuda and where.is_mempool_enabled):
        yield
        return
    before = wp.get_mempool_release_threshold(where)
    wp.set_mempool_release_threshold(where, where.total_memory)
    try:
        yield
    finally:
        wp.set_mempool_release_threshold(where, before)
    wp.synchronize_device(where)  # hands it back


def cores() -> int:
    """Those that this process may use; all of them where the system does not tell, as macOS."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_kernels(task: str, *modules: ModuleType, device: str) -> None:
    """Have the kernels of ``modules`` ready on a device; says so before it compiles any, which takes time."""
    _begin()
    with one_at_a_time:
        missing = [module for module in modules if (module.__name__, device) not in _loaded]
        if missing and not kernels_cached(*missing, device=device):
            logger.warning("compiling the kernels of the %s for %s, once on this machine: half a minute", task, device)
        for module in missing:
            wp.load_module(module, device=device)
            _loaded.add((module.__name__, device))


def kernels_cached(*modules: ModuleType, device: str) -> bool:
    """Whether the kernels of ``modules`` were compiled for a device before."""
    _begin()
    return all(_is_cached(wp.get_module(module.__name__), wp.get_device(device)) for module in modules)


def _is_cached(module: wp.Module, device: wp.Device) -> bool:
    folder = Path(wp.config.kernel_cache_dir) / module.get_module_identifier(block_dim=1 if device.is_cpu else None)
    endings = (".o",) if device.is_cpu else (".cubin", ".ptx")
    return any(path.suffix in endings for path in folder.glob("*"))
