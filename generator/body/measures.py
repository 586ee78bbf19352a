"""The geometry of the measures, one function each, on landmarks and sections.

``gcd_dataset.measurements`` defines each measure by one of them. Landmarks may be batched, ``(*batch, 3)``; a section
is the points (n, 3) or segments (s, 2, 3) in which a plane cuts one body. Units are cm and radians.
"""

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.section import clipped, girth, tape
from gcd_dataset.measurements import SIDEWAYS

X, Y = 0, 1
XZ, ZY = slice(0, 3, 2), slice(2, 0, -1)
BACK = (0.0, -1.0)  # the backward direction as (x, z), in a level section

_Point = Float[np.ndarray, "*batch 3"]
_Length = Float[np.ndarray, "*batch"]


# ------------------------------------------------------------------------------------------------ heights and distances


def height(vertices: Float[np.ndarray, "*batch v 3"]) -> _Length:
    """Soles to the top of the head, vertically [cm]."""
    return np.ptp(vertices[..., Y], axis=-1)


def to_crown(vertices: Float[np.ndarray, "*batch v 3"], point: _Point) -> _Length:
    """Vertical distance from a point to the top of the head [cm]."""
    return vertices[..., Y].max(axis=-1) - point[..., Y]


def apart(a: _Point, b: _Point) -> _Length:
    """Straight distance of two points [cm]."""
    return np.linalg.norm(a - b, axis=-1)


def above(a: _Point, b: _Point) -> _Length:
    """Vertical distance of two points [cm]."""
    return np.abs(a[..., Y] - b[..., Y])


# --------------------------------------------------------------------------------------------------------- inclinations


def sinking(start: _Point, end: _Point) -> _Length:
    """Angle of the line from ``start`` to ``end`` below the horizontal [rad]."""
    return _angle_against(start, end, Y)


def leaning(upper: _Point, lower: _Point) -> _Length:
    """Angle of the line from ``upper`` to ``lower`` from the vertical, outwards on the body's right [rad]."""
    return -_angle_against(lower, upper, X)


# ---------------------------------------------------------------------------------------------------------------- rings


def along(points: Float[np.ndarray, "*batch n 3"]) -> _Length:
    """Length of a polyline [cm]."""
    return np.linalg.norm(np.diff(points, axis=-2), axis=-1).sum(axis=-1)


def around(ring: Float[np.ndarray, "*batch n 3"]) -> _Length:
    """Length of a closed polyline [cm]."""
    return along(np.concatenate([ring, ring[..., :1, :]], axis=-2))


# --------------------------------------------------------------------------------------------------------------- girths


def round_section(section: Float[np.ndarray, "n 3"]) -> float:
    """Length of a tape round a level section [cm]."""
    return girth(section[:, XZ])


def larger_thigh(section: Float[np.ndarray, "s 2 3"], middle: float) -> float:
    """Length of a tape round the larger thigh, in a level section with the legs on both sides of x = ``middle`` [cm].

    GarmentCode measures the contour, which is 0.005 cm longer on smooth thighs, and 2 cm on the rough skin of a scan.
    """
    right = section[:, :, X].mean(axis=1) < middle
    return max(girth(section[side, 0][:, XZ]) for side in (right, ~right))


def over_back(section: Float[np.ndarray, "n 3"], left: Float[np.ndarray, "3"], right: Float[np.ndarray, "3"]) -> float:
    """Length of a tape over the back of a level section, from ``left`` to ``right`` [cm]."""
    x, z = (left - right)[XZ]
    behind = (section - left)[:, XZ] @ [z, -x] >= 0
    return tape(np.concatenate([section[behind], [left, right]])[:, XZ], BACK, over=SIDEWAYS)


# ------------------------------------------------------------------------------------------------------- upright tapes


def down_spine(spine: Float[np.ndarray, "n 3"], upper: Float[np.ndarray, "3"], lower: Float[np.ndarray, "3"]) -> float:
    """Length of a tape down the sagittal section of the spine, from ``upper`` to ``lower`` [cm]."""
    between = (spine[:, Y] < upper[Y]) & (spine[:, Y] > lower[Y])
    return tape(np.concatenate([spine[between], [upper, lower]])[:, ZY], (-1.0, 0.0))


def over_breast(section: Float[np.ndarray, "s 2 3"], level: float, facing: tuple[float, float], over: float) -> float:
    """Length of a tape over the sagittal section of the right breast, from the shoulder down to a level [cm].

    Counts the stretches of the tape with a normal (forward, up) at a cosine to ``facing`` above ``over``.
    """
    above_level = clipped(section, (0.0, 1.0, 0.0), np.array([0.0, level, 0.0]))
    return tape(above_level.reshape(-1, 3)[:, ZY], facing, over=over)


def _angle_against(start: np.ndarray, end: np.ndarray, axis: int) -> np.ndarray:
    """Angle of the line from ``start`` to ``end`` below the plane normal to an axis [rad]."""
    return np.arcsin((start - end)[..., axis] / apart(start, end))
