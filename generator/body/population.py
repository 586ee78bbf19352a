"""Women and men as they are met: a Gaussian over the shape weights for each sex, calibrated to a survey.

``adults.npz`` holds its mean and principal axes; ``calibrate.py`` made it.
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
FURTHEST = 3.0  # standard deviations along any axis: whoever is further out is drawn there


@dataclass(frozen=True, eq=False)
class Adults(Record):
    """The shape weights of the adults of one sex, normally distributed."""

    mean: Float[np.ndarray, " k"]
    axes: Float[np.ndarray, "k k"]
    """Columns: one standard deviation along each principal axis."""


@functools.cache
def adults_of(sex: str) -> Adults:
    """The adults of a sex. Raises ``BodyError`` with the sexes there are, or where the file is damaged."""
    if sex not in SEXES:
        raise BodyError(f"no adults of sex {sex!r}: give {' or '.join(SEXES)}, or None for bodies between them")
    with np.load(io.BytesIO(checked_data("adults.npz"))) as file:
        return Adults(file[f"{sex}_mean"].astype(float), file[f"{sex}_axes"].astype(float))


def draw_weights(rng: np.random.Generator, adults: Adults) -> Float[np.ndarray, " k"]:
    """Shape weights of somebody."""
    along = np.clip(rng.standard_normal(len(adults.mean)), -FURTHEST, FURTHEST)
    # einsum and not a matrix product: the sums of BLAS depend on its threads, and a sample is to be the same anywhere.
    return adults.mean + np.einsum("ka,a->k", adults.axes, along)
