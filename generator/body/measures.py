"""The 26 measures, one function each, on landmarks and on sections that somebody else has found.

Their meaning is that of GarmentCode's measurement files. Landmarks may come in batches, ``(*batch, 3)``; a section is
the points (n, 3) or segments (s, 2, 3) where a plane cuts one body. Everything is in cm and radians.
"""

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.section import clipped, girth, tape

__all__ = [
    "arm_pose_angle",
    "armscye_depth",
    "back_width",
    "bum_points",
    "bust",
    "bust_line",
    "bust_points",
    "crotch_hip_diff",
    "head_l",
    "height",
    "hip_back_width",
    "hip_inclination",
    "hips",
    "hips_line",
    "leg_circ",
    "neck_w",
    "shoulder_incl",
    "shoulder_w",
    "underbust",
    "vert_bust_line",
    "waist",
    "waist_back_width",
    "waist_line",
    "waist_over_bust_line",
    "wrist",
]

X, Y = 0, 1
XZ, ZY = slice(0, 3, 2), slice(2, 0, -1)
BACK = (0.0, -1.0)  # in the (x, z) plane of a level section, and as (z, y) = (-1, 0) in an upright one
SIDEWAYS = -0.4  # a tape's normal may lean this far away and still count as front or back, GarmentCodeData

_Point = Float[np.ndarray, "*batch 3"]
_Length = Float[np.ndarray, "*batch"]


# ------------------------------------------------------------------------------------------------ heights and distances


def height(vertices: Float[np.ndarray, "*batch v 3"]) -> _Length:
    """Soles to the top of the head, vertically [cm]."""
    return np.ptp(vertices[..., Y], axis=-1)


def head_l(vertices: Float[np.ndarray, "*batch v 3"], nape: _Point) -> _Length:
    """Nape of the neck to the top of the head, vertically [cm]."""
    return vertices[..., Y].max(axis=-1) - nape[..., Y]


def shoulder_w(left: _Point, right: _Point) -> _Length:
    """Shoulder point to shoulder point, straight [cm]."""
    return _apart(left, right)


def armscye_depth(shoulder: _Point, underarm: _Point) -> _Length:
    """Shoulder point to underarm point, straight [cm]."""
    return _apart(shoulder, underarm)


def bust_points(left: _Point, right: _Point) -> _Length:
    """Breast point to breast point, straight [cm]."""
    return _apart(left, right)


def bum_points(left: _Point, right: _Point) -> _Length:
    """Apex to apex of the buttocks, straight [cm]."""
    return _apart(left, right)


def vert_bust_line(nape: _Point, bust_side: _Point) -> _Length:
    """Nape of the neck to the bust level, vertically [cm]."""
    return _above(nape, bust_side)


def hips_line(waist_side: _Point, hips_side: _Point) -> _Length:
    """Waist to hips at the side, vertically [cm]."""
    return _above(waist_side, hips_side)


def crotch_hip_diff(hips_side: _Point, crotch: _Point) -> _Length:
    """Hip level to crotch, vertically [cm]."""
    return _above(hips_side, crotch)


# --------------------------------------------------------------------------------------------------------- inclinations


def shoulder_incl(neck: _Point, shoulder: _Point) -> _Length:
    """How far the way from side-neck to shoulder point sinks below the horizontal [rad]."""
    return _sinking(neck, shoulder, Y)


def arm_pose_angle(shoulder: _Point, wrist: _Point) -> _Length:
    """How far the way from shoulder to wrist sinks below the horizontal [rad]."""
    return _sinking(shoulder, wrist, Y)


def hip_inclination(waist_side: _Point, hips_side: _Point) -> _Length:
    """How far the right side leans outwards from waist to hips, from the vertical [rad]."""
    return -_sinking(hips_side, waist_side, X)


# ---------------------------------------------------------------------------------------------------------------- rings


def neck_w(neck_back: Float[np.ndarray, "*batch n 3"]) -> _Length:
    """Round the back of the neck's base, along points from side-neck to side-neck over the nape [cm]."""
    return _way(neck_back)


def wrist(ring: Float[np.ndarray, "*batch n 3"]) -> _Length:
    """Round the wrist, along the points of a closed ring [cm]."""
    return _way(np.concatenate([ring, ring[..., :1, :]], axis=-2))


# --------------------------------------------------------------------------------------------------------------- girths


def bust(section: Float[np.ndarray, "n 3"]) -> float:
    """Tape round the fullest level section of the chest [cm]."""
    return girth(section[:, XZ])


def underbust(section: Float[np.ndarray, "n 3"]) -> float:
    """Tape round the level section below the breasts [cm]."""
    return girth(section[:, XZ])


def waist(section: Float[np.ndarray, "n 3"]) -> float:
    """Tape round the narrowest level section of the waist [cm]."""
    return girth(section[:, XZ])


def hips(section: Float[np.ndarray, "n 3"]) -> float:
    """Tape round the fullest level section of the hips [cm]."""
    return girth(section[:, XZ])


def leg_circ(section: Float[np.ndarray, "s 2 3"], middle: float) -> float:
    """Tape round the larger thigh in a level section on which the legs part at x = ``middle`` [cm].

    The published measure is the outline, which is 0.005 cm longer on smooth thighs and 2 cm on a scan's rough ones.
    """
    right = section[:, :, X].mean(axis=1) < middle
    return max(girth(section[side, 0][:, XZ]) for side in (right, ~right))


def back_width(section: Float[np.ndarray, "n 3"], left: Float[np.ndarray, "3"], right: Float[np.ndarray, "3"]) -> float:
    """Tape over the back at bust level, from side to side [cm]."""
    return _over_back(section, left, right)


def waist_back_width(
    section: Float[np.ndarray, "n 3"], left: Float[np.ndarray, "3"], right: Float[np.ndarray, "3"]
) -> float:
    """Tape over the back at waist level, from side to side [cm]."""
    return _over_back(section, left, right)


def hip_back_width(
    section: Float[np.ndarray, "n 3"], left: Float[np.ndarray, "3"], right: Float[np.ndarray, "3"]
) -> float:
    """Tape over the buttocks at hip level, from side to side [cm]."""
    return _over_back(section, left, right)


# ------------------------------------------------------------------------------------------------------- upright tapes


def waist_line(
    spine: Float[np.ndarray, "n 3"], nape: Float[np.ndarray, "3"], mid_waist_back: Float[np.ndarray, "3"]
) -> float:
    """Tape down the spine's upright section, from the nape to the waist [cm]."""
    between = (spine[:, Y] < nape[Y]) & (spine[:, Y] > mid_waist_back[Y])
    return tape(np.concatenate([spine[between], [nape, mid_waist_back]])[:, ZY], (-1.0, 0.0))


def waist_over_bust_line(over_bust: Float[np.ndarray, "s 2 3"], mid_waist_back: Float[np.ndarray, "3"]) -> float:
    """Tape over the right breast's upright section, from the shoulder to the waist level [cm]."""
    return _down_to(float(mid_waist_back[Y]), over_bust, (1.0, 0.5), SIDEWAYS)


def bust_line(over_bust: Float[np.ndarray, "s 2 3"], bust_point: Float[np.ndarray, "3"]) -> float:
    """Tape over the right breast's upright section, from the shoulder to the breast point's level [cm]."""
    return _down_to(float(bust_point[Y]), over_bust, (1.0, 1.0), 0.0)


def _down_to(level: float, cut: np.ndarray, facing: tuple[float, float], over: float) -> float:
    above = clipped(cut, (0.0, 1.0, 0.0), np.array([0.0, level, 0.0]))
    return tape(above.reshape(-1, 3)[:, ZY], facing, over=over)


def _over_back(section: np.ndarray, left: np.ndarray, right: np.ndarray) -> float:
    x, z = (left - right)[XZ]
    behind = (section - left)[:, XZ] @ [z, -x] >= 0
    return tape(np.concatenate([section[behind], [left, right]])[:, XZ], BACK, over=SIDEWAYS)


def _apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=-1)


def _above(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(a[..., Y] - b[..., Y])


def _sinking(start: np.ndarray, end: np.ndarray, axis: int) -> np.ndarray:
    """How far the way from ``start`` to ``end`` sinks against an axis [rad]."""
    return np.arcsin((start - end)[..., axis] / _apart(start, end))


def _way(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(points, axis=-2), axis=-1).sum(axis=-1)
