"""Girths of the trunk between hips and waist, for bottoms and waistbands."""

from math import tan

import numpy as np

from gcd_dataset.generator.garments.mends import Mend, folds
from gcd_dataset.records import Measurements

LEAST_ABOVE_HIPS = 1.0  # cm of a fitted bottom above the hips, under a waistband that reaches down to them

LEGS_LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # heights as fractions of floor to hips
LEGS_GIRTHS = (0.80, 0.79, 0.85, 0.89, 0.87, 0.83, 0.88, 0.94, 0.96, 1.0)
"""Girth of a tape round both standing legs over ``hips``: means of 12 of this package's bodies, ± 0.05."""
TRUNK_DEPTHS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)  # depths below the waist as fractions of waist to hips
TRUNK_GIRTHS = (1.0, 0.99, 1.0, 1.03, 1.02, 1.0)
"""Girth of a tape round the trunk over ``girth_at_rise``: means of 61 of this package's bodies, ± 0.03."""


def girth_at_rise(size: Measurements, rise: float) -> float:
    """Girth at a rise between the hips (0) and the waist (1) [cm]."""
    return blend(size.hips, size.waist, rise)


def girth_below_waist(size: Measurements, depth: float) -> float:
    """Girth ``depth`` cm below the waist [cm]: of the trunk; below the hips, of a tape round both legs.

    Above the waist (``depth`` < 0) interpolated to the bust.
    """
    if depth < 0.0:
        return blend(size.waist, size.bust, min(-depth / (size.waist_line - size.drawn_bust_line), 1.0))
    if depth <= size.hips_line:
        share = depth / size.hips_line
        return girth_at_rise(size, 1.0 - share) * float(np.interp(share, TRUNK_DEPTHS, TRUNK_GIRTHS))
    level = (size.leg_length + size.hips_line - depth) / size.leg_length
    return size.hips * float(np.interp(level, LEGS_LEVELS, LEGS_GIRTHS))


def back_at_rise(size: Measurements, rise: float) -> float:
    """The back's part of the girth at a rise [cm], interpolated between its widths at hips and waist."""
    return blend(size.hip_back_width, size.waist_back_width, rise)


def back_share(size: Measurements, rise: float) -> float:
    """The back's share of the girth at a rise, interpolated between its shares at hips and waist."""
    return blend(size.hip_back_width / size.hips, size.waist_back_width / size.waist, rise)


def drawn_rise(size: Measurements, rise: float) -> float:
    """The rise at which trousers or a pencil skirt begin: seams above the hips have a least length."""
    return max(rise, LEAST_ABOVE_HIPS / size.hips_line)


def sides_and_darts(
    size: Measurements, excess: float, height: float, *, darts: int, mends: frozenset[Mend]
) -> tuple[float, float]:
    """The hips' excess over a top ``height`` cm above, divided between the lean of the side and the darts [cm].

    The side leans in by the hips' slope, at most by the excess; ``darts`` of equal width take in the rest.
    """
    lean = min(height * tan(size.drawn_hip_inclination), excess)
    if folds((excess - lean) / darts, mends):
        return excess, 0.0
    return lean, excess - lean


def waist_front(size: Measurements) -> float:
    """The front's part of the waist [cm]; the front of every ring in a waist seam has this projected length."""
    return size.waist - size.waist_back_width


def waist_back(size: Measurements) -> float:
    """The back's part of the waist [cm]; see ``waist_front``."""
    return size.waist_back_width


def blend(at_zero: float, at_one: float, share: float) -> float:
    """Linear interpolation: ``at_zero`` for a share of 0, ``at_one`` for 1."""
    return (1 - share) * at_zero + share * at_one
