"""Loading of the drape's kernels, and estimates of how long a drape takes."""

import logging
import math
from importlib import import_module
from types import ModuleType

from gcd_dataset.generator.device import cores, load_kernels, resolve_device
from gcd_dataset.generator.drape import kernels

logger = logging.getLogger("gcd_dataset")

NAMES = (
    "contacts", "crossing", "field", "finish", "place", "rows", "search", "sides", "step", "stillness", "topology",
    "untangling",
)  # fmt: skip
KERNELS: tuple[ModuleType, ...] = tuple(import_module(f"{kernels.__name__}.{name}") for name in NAMES)
FIXED, PER_DENSITY = 0.8, 6.5  # s, s cm² of a CPU core; fitted to 7.2, 2.4 and 1.2 s at 1, 2 and 4 cm
GPU_SECONDS = 0.014  # a garment at 1 cm on an H200, 3 000 garments, 128 at once: benchmarks/reports/drape_sampled.md
LONG = 10.0  # s: shorter times are not logged


def load_drape(device: str) -> None:
    """Load all kernels of the drape on a device; compiles them if the cache has none."""
    load_kernels("drape", *KERNELS, device=device)


def seconds_per_garment(device: str = "auto", spacing: float = 1.0) -> float:
    """Estimated mean time [s] to drape a garment at a mesh spacing [cm]: on one CPU core, or as a share of a GPU batch.

    Measured on other machines; single garments take up to ten times as long. Raises ``ConfigError`` for an unknown
    device.

    >>> seconds_per_garment("cpu"), round(seconds_per_garment("cpu", spacing=2.0), 1)
    (7.3, 2.4)
    """
    return FIXED + PER_DENSITY / spacing**2 if resolve_device(device) == "cpu" else GPU_SECONDS / spacing**2


def log_drape_time(garments: int, device: str = "auto", spacing: float = 1.0) -> None:
    """Log the estimated time to drape ``garments`` if above 10 s; each CPU core drapes one at a time.

    Raises ``ConfigError`` for an unknown device.
    """
    rounds = math.ceil(garments / cores()) if resolve_device(device) == "cpu" else garments
    seconds = rounds * seconds_per_garment(device, spacing)
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
