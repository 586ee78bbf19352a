"""Adults of one sex: a Gaussian over the shape weights, calibrated to a survey.

``adults.npz``, made by ``calibrate.py``, holds mean and principal axes for each sex.
"""

import functools
import io
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import checked_data
from gcd_dataset.records import Record

__all__ = ["SEXES", "Adults", "adults_of", "draw_weights"]

SEXES = ("female", "male")
MAX_DEVIATION = 3.0  # standard deviations along each axis, to which draws are clipped


@dataclass(frozen=True, eq=False)
class Adults(Record):
    """The normal distribution of shape weights among the adults of one sex."""

    mean: Float[np.ndarray, " k"]
    axes: Float[np.ndarray, "k k"]
    """Principal axes as columns, one standard deviation long."""


@functools.cache
def adults_of(sex: str) -> Adults:
    """The adults of a sex. Raises ``BodyError`` for a sex not in ``SEXES``, or a damaged file."""
    if sex not in SEXES:
        raise BodyError(f"no adults of sex {sex!r}: give {' or '.join(SEXES)}, or None for bodies between them")
    with np.load(io.BytesIO(checked_data("adults.npz"))) as file:
        return Adults(file[f"{sex}_mean"].astype(float), file[f"{sex}_axes"].astype(float))


def draw_weights(rng: np.random.Generator, adults: Adults) -> Float[np.ndarray, " k"]:
    """Shape weights (k) of one random adult."""
    along = np.clip(rng.standard_normal(len(adults.mean)), -MAX_DEVIATION, MAX_DEVIATION)
    # einsum: the rounding of a BLAS product depends on its threads, and samples must be the same on any machine.
    return adults.mean + np.einsum("ka,a->k", adults.axes, along)
