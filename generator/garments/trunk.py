"""Girths of the trunk between hips and waist, for bottoms and waistbands."""

from math import tan
from typing import NamedTuple

import numpy as np

from gcd_dataset.generator.garments.mends import Mend, folds
from gcd_dataset.records import Measurements

OUTER_DART = 0.9  # outer over inner dart leg of a back, GarmentCode
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


class WaistDart(NamedTuple):
    """A dart in the top of a quarter [cm]."""

    name: str
    width: float
    leg: float
    from_centre: float
    """Distance of the dart's middle from the centre, along the top."""


class Quarter(NamedTuple):
    """Half of the front or of the back of a bottom that darts fit to the body [cm]."""

    hips: float
    height: float
    """Height from the hips to the top."""
    waist: float
    """Width of the body at the top."""
    lean: float
    """Horizontal distance by which the side leans in from hips to top; the darts take in the rest."""
    darts: tuple[WaistDart, ...]
    """From the centre outwards."""
    crotch: float = 0.0
    """Extent of the crotch beyond the centre."""


def front_quarter(size: Measurements, rise: float, mends: frozenset[Mend], *, leg: float) -> Quarter:
    """The front, with one dart below the bust point; ``leg``: dart leg over height."""
    hips, waist = 0.5 * (size.hips - size.hip_back_width), 0.5 * (girth_at_rise(size, rise) - back_at_rise(size, rise))
    height = rise * size.hips_line
    lean, taken = sides_and_darts(size, hips - waist, height, darts=1, mends=mends)
    single = WaistDart("dart", taken, leg * height, 0.5 * (size.bust_points + taken))
    return Quarter(hips, height, waist, lean, (single,) if taken else ())


def back_quarter(size: Measurements, rise: float, mends: frozenset[Mend], *, raise_: float, leg: float) -> Quarter:
    """The back, with two darts, one on either side of the fullest point.

    ``raise_``: height from hips to top behind over the height in front; ``leg``: length of the inner dart leg [cm].
    """
    hips, waist = 0.5 * size.hip_back_width, 0.5 * back_at_rise(size, rise)
    height, point = raise_ * rise * size.hips_line, 0.5 * size.bum_points
    lean, taken = sides_and_darts(size, hips - waist, height, darts=2, mends=mends)
    inner = WaistDart("inner_dart", 0.5 * taken, leg, 0.75 * point + 0.25 * taken)
    outer = WaistDart("outer_dart", 0.5 * taken, OUTER_DART * leg, 1.25 * point + 0.75 * taken)
    return Quarter(hips, height, waist, lean, (inner, outer) if taken else ())


def waist_front(size: Measurements) -> float:
    """The front's part of the waist [cm]; the front of every ring in a waist seam has this projected length."""
    return size.waist - size.waist_back_width


def blend(at_zero: float, at_one: float, share: float) -> float:
    """Linear interpolation: ``at_zero`` for a share of 0, ``at_one`` for 1."""
    return (1 - share) * at_zero + share * at_one
