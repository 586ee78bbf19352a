"""Adults: for each sex a Gaussian over the shape weights, calibrated to a survey; half of them are women.

``adults.npz``, made by ``calibrate.py``, holds mean and principal axes for each sex.
"""

import functools
import io
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.asset import checked_data
from gcd_dataset.records import Record

SEXES = ("female", "male")
POOLED = "pooled"
"""The pool of GarmentCodeData: bodies about the neutral one, mostly between the sexes."""
GROUPS = ("random", *SEXES, POOLED)
"""Groups that bodies are drawn from; ``random``: women and men, as a population is made up."""
FEMALE_SHARE = 0.5  # share of women among adults; within one or two per cent in most countries
MAX_DEVIATION = 3.0  # standard deviations along each axis, to which draws are clipped


@dataclass(frozen=True, eq=False)
class Adults(Record):
    """The normal distribution of shape weights among the adults of one sex."""

    mean: Float[np.ndarray, " k"]
    axes: Float[np.ndarray, "k k"]
    """Principal axes as columns, one standard deviation long."""


@functools.cache
def adults_of(sex: str) -> Adults:
    """The adults of a sex, one of ``SEXES``. Raises ``BodyError`` for a damaged file."""
    with np.load(io.BytesIO(checked_data("adults.npz"))) as file:
        return Adults(file[f"{sex}_mean"].astype(float), file[f"{sex}_axes"].astype(float))


def weights_of(adults: Adults, deviates: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Shape weights of the adult at ``deviates`` standard deviations along each axis."""
    along = np.clip(deviates, -MAX_DEVIATION, MAX_DEVIATION)
    # einsum: the rounding of a BLAS product depends on its threads, and samples must be the same on any machine.
    return adults.mean + np.einsum("ka,a->k", adults.axes, along)
