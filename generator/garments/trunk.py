"""Girths of the trunk between hips and waist, for bottoms and waistbands."""

from gcd_dataset.records import Measurements

__all__ = ["back_at_rise", "back_share", "blend", "girth_at_rise", "waist_back", "waist_front"]


def girth_at_rise(size: Measurements, rise: float) -> float:
    """Girth at a rise between the hips (0) and the waist (1) [cm]."""
    return blend(size.hips, size.waist, rise)


def back_at_rise(size: Measurements, rise: float) -> float:
    """The back's part of the girth at a rise [cm], interpolated between its widths at hips and waist."""
    return blend(size.hip_back_width, size.waist_back_width, rise)


def back_share(size: Measurements, rise: float) -> float:
    """The back's share of the girth at a rise, interpolated between its shares at hips and waist."""
    return blend(size.hip_back_width / size.hips, size.waist_back_width / size.waist, rise)


def waist_front(size: Measurements) -> float:
    """The front's part of the waist [cm]: the projected length of the front of any ring in a waist seam."""
    return size.waist - size.waist_back_width


def waist_back(size: Measurements) -> float:
    """The back's part of the waist [cm]; see ``waist_front``."""
    return size.waist_back_width


def blend(at_zero: float, at_one: float, share: float) -> float:
    """Linear interpolation: ``at_zero`` for a share of 0, ``at_one`` for 1."""
    return (1 - share) * at_zero + share * at_one
