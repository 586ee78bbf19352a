"""A log line with the expected time per garment, before the first garment."""

import logging

from gcd_dataset.generator.estimates import core_seconds
from gcd_dataset.generator.recipe import MakeConfig

__all__ = ["seconds_each", "tell_wait"]

logger = logging.getLogger("gcd_dataset")

LOGGED_FROM = 2.0  # s: shorter times are not logged


def seconds_each(config: MakeConfig) -> float:
    """Approximate time to make a garment on one CPU core [s]; 0 for all but drapes on the CPU.

    >>> seconds_each(MakeConfig(stage="drape", device="cpu", resolution=2.0))
    2.425
    """
    if config.stage != "drape" or config.device != "cpu":
        return 0.0
    return core_seconds(config.resolution)


def tell_wait(config: MakeConfig) -> None:
    """Log the expected time per garment if it is ``LOGGED_FROM`` seconds or longer."""
    each = seconds_each(config)
    if each >= LOGGED_FROM:
        logger.warning(
            "waiting for the first garment: about %.0f s each on %s, longer for the first if kernels must be compiled",
            each,
            config.device,
        )
