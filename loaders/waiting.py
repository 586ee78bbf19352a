"""How long a garment takes to make, told before the first of them comes."""

import logging

from gcd_dataset.generator.estimates import core_seconds
from gcd_dataset.generator.recipe import MakeConfig

__all__ = ["seconds_each", "tell_wait"]

logger = logging.getLogger("gcd_dataset")

WORTH_TELLING = 2.0  # s


def seconds_each(config: MakeConfig) -> float:
    """About how long one core, or one GPU, takes for a garment [s].

    >>> seconds_each(MakeConfig(stage="drape", device="cpu", resolution=2.0))
    2.425
    """
    if config.stage != "drape" or config.device != "cpu":
        return 0.0
    return core_seconds(config.resolution)


def tell_wait(config: MakeConfig) -> None:
    """Log how long a garment takes here, if that is long enough to wonder."""
    each = seconds_each(config)
    if each >= WORTH_TELLING:
        logger.warning(
            "waiting for the first garment: about %.0f s each on %s, longer for the first where kernels are compiled",
            each,
            config.device,
        )
