"""Waistbands, between upper and bottom. Panels ``wb_front`` and ``wb_back``."""

from dataclasses import dataclass
from enum import Enum

from gcd_dataset.generator.garments.skirt import band, sector
from gcd_dataset.generator.garments.space import Design, real
from gcd_dataset.generator.garments.trunk import back_share, girth_at_rise, waist_back, waist_front
from gcd_dataset.generator.pattern import Component, Piece
from gcd_dataset.records import Measurements

FRONT, BACK = 20.0, -15.0  # cm: z of front and back before sewing, GarmentCode


class Waistband(Enum):
    """Kind of waistband, by GarmentCode's name."""

    STRAIGHT = "StraightWB"
    FITTED = "FittedWB"


@dataclass(frozen=True)
class WaistbandDesign(Design):
    """Girth and height of the band.

    A bottom begins at the band's lower edge, so that the band moves neither its hips nor its hem.
    """

    waist: float = real(1.0, 1.0, 2.0, keep=0.7)
    """Girth, as a fraction of the body's girth."""
    width: float = real(0.2, 0.1, 1.0, keep=0.5)
    """Height, as a fraction of waist to hips; the lower edge sits at the bottom's ``rise``, or lower if the band would
    rise above the waist."""


def waistband(size: Measurements, design: WaistbandDesign, kind: Waistband, *, rise: float) -> Component:
    """A band with its lower edge at ``rise`` (0 hips, 1 waist), or lower if its top would rise above the waist.

    Offers the rings ``top`` and ``bottom``.
    """
    low, height = band_rise(design, rise), design.width * size.hips_line
    top, bottom = (design.waist * girth_at_rise(size, at) for at in (low + design.width, low))
    top_back, bottom_back = top * back_share(size, low + design.width), bottom * back_share(size, low)
    front = _half("wb_front", kind, top - top_back, bottom - bottom_back, height)
    back = _half("wb_back", kind, top_back, bottom_back, height)
    front, back = front.at(0, size.waist_level, FRONT), back.at(0, size.waist_level, BACK)
    return (
        Component.of(front, back)
        .sewn(front.along("right"), back.along("right"))
        .sewn(front.along("left"), back.along("left"))
        .offering(
            top=front.against("top", ruffle=front.outline.length("top") / waist_front(size))
            + back.along("top", ruffle=back.outline.length("top") / waist_back(size)),
            bottom=front.along("bottom", ruffle=front.outline.length("bottom") / waist_front(size))
            + back.against("bottom", ruffle=back.outline.length("bottom") / waist_back(size)),
        )
    )  # fmt: skip


def band_rise(design: WaistbandDesign, rise: float) -> float:
    """Position of the lower edge: ``rise``, or lower if the band would rise above the waist."""
    return min(rise, 1.0 - design.width)


def _half(name: str, kind: Waistband, top: float, bottom: float, height: float) -> Piece:
    if kind is Waistband.STRAIGHT:
        return band(name, top, height)
    return sector(name, top, (bottom - top) / height, height)
