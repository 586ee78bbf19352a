"""Girths of the trunk between hips and waist, where bottoms and waistbands sit."""

from gcd_dataset.records import Measurements

__all__ = ["back_at_rise", "back_share", "blend", "girth_at_rise", "waist_back", "waist_front"]


def girth_at_rise(size: Measurements, rise: float) -> float:
    """Girth between the hips (rise 0) and the waist (rise 1) [cm]."""
    return blend(size.hips, size.waist, rise)


def back_at_rise(size: Measurements, rise: float) -> float:
    """The back's part of that girth, between its widths at the hips and at the waist [cm]."""
    return blend(size.hip_back_width, size.waist_back_width, rise)


def back_share(size: Measurements, rise: float) -> float:
    """The back's share of that girth."""
    return blend(size.hip_back_width / size.hips, size.waist_back_width / size.waist, rise)


def waist_front(size: Measurements) -> float:
    """The front's part of the waist: what the front of any ring at the waist counts for in its seam [cm]."""
    return size.waist - size.waist_back_width


def waist_back(size: Measurements) -> float:
    """The back's part of the waist [cm]."""
    return size.waist_back_width


def blend(at_zero: float, at_one: float, share: float) -> float:
    """Between two numbers: the first at 0, the second at 1."""
    return (1 - share) * at_zero + share * at_one
