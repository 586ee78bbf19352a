"""Ways of a tape, one function each, on landmarks and on sections found beforehand: what measures are taken by.

``gcd_dataset.measurements`` says which measure goes which way. LandmarkTable may come in batches, ``(*batch, 3)``; a
section is the points (n, 3) or segments (s, 2, 3) where a plane cuts one body. Everything is in cm and radians.
"""

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.section import clipped, girth, tape
from gcd_dataset.measurements import SIDEWAYS

__all__ = [
    "above",
    "along",
    "apart",
    "around",
    "down_spine",
    "height",
    "larger_thigh",
    "leaning",
    "over_back",
    "over_breast",
    "round_section",
    "sinking",
    "to_crown",
]

X, Y = 0, 1
XZ, ZY = slice(0, 3, 2), slice(2, 0, -1)
BACK = (0.0, -1.0)  # in the (x, z) plane of a level section, and as (z, y) = (-1, 0) in an upright one

_Point = Float[np.ndarray, "*batch 3"]
_Length = Float[np.ndarray, "*batch"]


# ------------------------------------------------------------------------------------------------ heights and distances


def height(vertices: Float[np.ndarray, "*batch v 3"]) -> _Length:
    """Soles to the top of the head, vertically [cm]."""
    return np.ptp(vertices[..., Y], axis=-1)


def to_crown(vertices: Float[np.ndarray, "*batch v 3"], point: _Point) -> _Length:
    """From a point to the top of the head, vertically [cm]."""
    return vertices[..., Y].max(axis=-1) - point[..., Y]


def apart(a: _Point, b: _Point) -> _Length:
    """From point to point, straight [cm]."""
    return np.linalg.norm(a - b, axis=-1)


def above(a: _Point, b: _Point) -> _Length:
    """From point to point, vertically [cm]."""
    return np.abs(a[..., Y] - b[..., Y])


# --------------------------------------------------------------------------------------------------------- inclinations


def sinking(start: _Point, end: _Point) -> _Length:
    """How far the way from point to point sinks below the horizontal [rad]."""
    return _sinking(start, end, Y)


def leaning(upper: _Point, lower: _Point) -> _Length:
    """How far the way down from point to point leans outwards on the right, from the vertical [rad]."""
    return -_sinking(lower, upper, X)


# ---------------------------------------------------------------------------------------------------------------- rings


def along(points: Float[np.ndarray, "*batch n 3"]) -> _Length:
    """Along points, from the first to the last [cm]."""
    return np.linalg.norm(np.diff(points, axis=-2), axis=-1).sum(axis=-1)


def around(ring: Float[np.ndarray, "*batch n 3"]) -> _Length:
    """Along the points of a closed ring [cm]."""
    return along(np.concatenate([ring, ring[..., :1, :]], axis=-2))


# --------------------------------------------------------------------------------------------------------------- girths


def round_section(section: Float[np.ndarray, "n 3"]) -> float:
    """Tape round a level section [cm]."""
    return girth(section[:, XZ])


def larger_thigh(section: Float[np.ndarray, "s 2 3"], middle: float) -> float:
    """Tape round the larger thigh in a level section on which the legs part at x = ``middle`` [cm].

    The published measure is the outline, which is 0.005 cm longer on smooth thighs and 2 cm on a scan's rough ones.
    """
    right = section[:, :, X].mean(axis=1) < middle
    return max(girth(section[side, 0][:, XZ]) for side in (right, ~right))


def over_back(section: Float[np.ndarray, "n 3"], left: Float[np.ndarray, "3"], right: Float[np.ndarray, "3"]) -> float:
    """Tape over the back of a level section, from side to side [cm]."""
    x, z = (left - right)[XZ]
    behind = (section - left)[:, XZ] @ [z, -x] >= 0
    return tape(np.concatenate([section[behind], [left, right]])[:, XZ], BACK, over=SIDEWAYS)


# ------------------------------------------------------------------------------------------------------- upright tapes


def down_spine(spine: Float[np.ndarray, "n 3"], upper: Float[np.ndarray, "3"], lower: Float[np.ndarray, "3"]) -> float:
    """Tape down the spine's upright section, from point to point [cm]."""
    between = (spine[:, Y] < upper[Y]) & (spine[:, Y] > lower[Y])
    return tape(np.concatenate([spine[between], [upper, lower]])[:, ZY], (-1.0, 0.0))


def over_breast(section: Float[np.ndarray, "s 2 3"], level: float, facing: tuple[float, float], over: float) -> float:
    """Tape over the right breast's upright section, from the shoulder down to a level [cm].

    It touches skin whose normal (forward, up) agrees with ``facing`` by at least the cosine ``over``.
    """
    above_it = clipped(section, (0.0, 1.0, 0.0), np.array([0.0, level, 0.0]))
    return tape(above_it.reshape(-1, 3)[:, ZY], facing, over=over)


def _sinking(start: np.ndarray, end: np.ndarray, axis: int) -> np.ndarray:
    """How far the way from ``start`` to ``end`` sinks against an axis [rad]."""
    return np.arcsin((start - end)[..., axis] / apart(start, end))
