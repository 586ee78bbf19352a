"""Which device Warp runs on, and its kernels loaded there."""

import logging
import os
import sys
import threading
from functools import cache
from types import ModuleType

import warp as wp

from gcd_dataset.errors import ConfigError

__all__ = ["every_device", "load_kernels", "one_at_a_time", "resolve_device"]

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


@cache
def _begin() -> None:
    """Start Warp without the line that its library prints, past Python, on machines that have no GPU driver."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def load_kernels(task: str, *modules: ModuleType, device: str) -> None:
    """Have the kernels of ``modules`` ready on a device; says so, since compiling them takes time."""
    missing = [module for module in modules if (module.__name__, device) not in _loaded]
    if missing:
        logger.info("loading the kernels of the %s for %s: compiled if they are new here, in about 10 s", task, device)
    for module in missing:
        wp.load_module(module, device=device)
        _loaded.add((module.__name__, device))
