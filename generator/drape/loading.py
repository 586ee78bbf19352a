"""The kernels of the drape, and what is waited for: compiling them, and a garment."""

import logging
import math
from types import ModuleType

from gcd_dataset.generator.drape.device import cores, kernels_cached, load_kernels, resolve_device
from gcd_dataset.generator.drape.kernels import (
    boxes,
    carry,
    contacts,
    crossing,
    field,
    finish,
    refine,
    rows,
    search,
    sides,
    step,
    stillness,
    topology,
)
from gcd_dataset.generator.estimates import core_seconds

__all__ = ["kernels_compiled", "load_drape", "seconds_per_garment", "seconds_to_drape", "tell_wait"]

logger = logging.getLogger("gcd_dataset")

KERNELS: tuple[ModuleType, ...] = (
    boxes,
    carry,
    contacts,
    crossing,
    field,
    finish,
    refine,
    rows,
    search,
    sides,
    step,
    stillness,
    topology,
)
GPU_SECONDS = 0.027  # of 1 000 garments at 1 cm on an H200, 128 at a time: benchmarks/reports/drape_sampled.md
LONG = 10.0  # s: a shorter wait is not worth a line


def load_drape(device: str) -> None:
    """Have all kernels of the drape ready on a device."""
    load_kernels("drape", *KERNELS, device=device)


def kernels_compiled(device: str = "auto") -> bool:
    """Whether the drape's kernels were compiled for a device before, by this version on this machine.

    Where they were not, the first drape compiles them, in about half a minute, and says so. Raises ``ConfigError`` for
    a device that is not there.
    """
    return kernels_cached(*KERNELS, device=resolve_device(device))


def seconds_per_garment(device: str = "auto", spacing: float = 1.0) -> float:
    """How long a garment takes to drape, in the mean, at a mesh spacing [cm]: on one core of a CPU, or its share on a
    GPU that drapes many. An estimate from measured figures of other machines; some garments take ten times as long.

    Raises ``ConfigError`` for a device that is not there.

    >>> seconds_per_garment("cpu"), round(seconds_per_garment("cpu", spacing=2.0), 1)
    (7.3, 2.4)
    """
    return core_seconds(spacing) if resolve_device(device) == "cpu" else GPU_SECONDS / spacing**2


def seconds_to_drape(garments: int, device: str = "auto", spacing: float = 1.0) -> float:
    """How long ``garments`` take together, by ``seconds_per_garment``: each core of a CPU drapes one at a time.

    Raises ``ConfigError`` for a device that is not there.
    """
    rounds = math.ceil(garments / cores()) if resolve_device(device) == "cpu" else garments
    return rounds * seconds_per_garment(device, spacing)


def tell_wait(garments: int, device: str = "auto", spacing: float = 1.0) -> None:
    """Log how long ``garments`` will take to drape, where that is long. Raises ``ConfigError`` as the others do."""
    seconds = seconds_to_drape(garments, device, spacing)
    if seconds > LONG:
        logger.info(
            "draping %d garment%s at %g cm on %s takes about %s; at %g cm a third of that",
            garments,
            "" if garments == 1 else "s",
            spacing,
            "this CPU" if resolve_device(device) == "cpu" else device,
            f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min",
            2 * spacing,
        )
