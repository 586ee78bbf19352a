"""Waistbands, between upper and bottom. Panels ``wb_front`` and ``wb_back``.

Under a shirt with a closure the opening goes through the band: its fronts are ``wb_front_right`` and ``wb_front_left``.
"""

from dataclasses import dataclass, replace
from enum import Enum

from gcd_dataset.generator.garments.front import FrontDesign, sewn_fronts, with_extension
from gcd_dataset.generator.garments.skirt import band, sector
from gcd_dataset.generator.garments.space import Design, real
from gcd_dataset.generator.garments.trunk import back_share, girth_at_rise, waist_front
from gcd_dataset.generator.pattern import Component, Interface, Piece, backwards
from gcd_dataset.records import Closure, Measurements

FRONT, BACK = 20.0, -15.0  # cm: z of front and back before sewing, GarmentCode
ELASTIC = 0.95  # girth of a band with elastic, as a fraction of a plain band's
WITHOUT_HIPS = 1.08  # hips over waist below which a plain band may slide off


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


def waistband(
    size: Measurements,
    design: WaistbandDesign,
    kind: Waistband,
    *,
    rise: float,
    shirt: FrontDesign | None = None,
    elastic: bool = False,
) -> Component:
    """A band with its lower edge at ``rise`` (0 hips, 1 waist), or lower if its top would rise above the waist.

    ``elastic``: narrower for a wearer whose hips do not hold it.
    Offers the rings ``top`` and ``bottom``, from the right side; ``top`` from the centre front where ``shirt``, the
    front of the shirt above, opens the band.
    """
    low, height = band_rise(design, rise), design.width * size.hips_line
    share = design.waist * (ELASTIC if elastic and size.hips < WITHOUT_HIPS * size.waist else 1.0)
    top, bottom = (share * girth_at_rise(size, at) for at in (low + design.width, low))
    top_back, bottom_back = top * back_share(size, low + design.width), bottom * back_share(size, low)
    across, lower = top - top_back, bottom - bottom_back
    if shirt is None:
        fronts = [_half("wb_front", kind, across, lower, height).at(0, size.waist_level, FRONT)]
    else:
        across, lower = 0.5 * across, 0.5 * lower
        fronts = []
        for side, inner, x in (("right", "left", -0.5 * across), ("left", "right", 0.5 * across)):
            half = _half(f"wb_front_{side}", kind, across, lower, height).at(x, size.waist_level, FRONT)
            fronts.append(with_extension(half, inner, shirt.extension) if shirt.extension else half)
    back = _half("wb_back", kind, top_back, bottom_back, height).at(0, size.waist_level, BACK)
    right, left = fronts[0], fronts[-1]
    whole = (
        Component.of(*fronts, back)
        .sewn(right.along("right"), back.along("right"))
        .sewn(left.along("left"), back.along("left"))
    )
    if shirt is not None:
        closure = Closure.OPEN if shirt.open_hem else shirt.closure
        worn = replace(shirt, closure=closure, open_top=0.0, open_hem=0.0)
        whole = sewn_fronts(whole, right.against("left"), left.along("right"), worn)

    def gathered(edge: str) -> list[Interface]:
        ruffle = len(fronts) * right.outline.length(edge) / waist_front(size)
        return [front.against(edge, ruffle=ruffle) for front in fronts]

    *first, last = gathered("top")
    return whole.offering(
        top=sum((last, back.along("top", ruffle=back.outline.length("top") / size.waist_back_width), *first), ()),
        bottom=sum(map(backwards, gathered("bottom")), ())
        + back.against("bottom", ruffle=back.outline.length("bottom") / size.waist_back_width),
    )


def band_rise(design: WaistbandDesign, rise: float) -> float:
    """Position of the lower edge: ``rise``, or lower if the band would rise above the waist."""
    return min(rise, 1.0 - design.width)


def _half(name: str, kind: Waistband, top: float, bottom: float, height: float) -> Piece:
    if kind is Waistband.STRAIGHT:
        return band(name, top, height)
    return sector(name, top, (bottom - top) / height, height)
