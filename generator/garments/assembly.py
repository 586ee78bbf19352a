"""Garments: an upper, a waistband and a bottom, or some of them, sewn together from the top down."""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import fmod

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.pocket import with_pockets
from gcd_dataset.generator.garments.trim import with_trim
from gcd_dataset.generator.garments.waistband import band_rise, waistband
from gcd_dataset.generator.pattern import Component, assemble
from gcd_dataset.records import EdgeRole, Measurements, PanelRole, Pattern

GAP = 5.0  # cm between the parts of a garment before sewing, GarmentCode
MEASURES_USED = (
    "height", "head_l", "neck_w", "shoulder_w", "shoulder_incl", "armscye_depth", "arm_length", "arm_pose_angle",
    "wrist", "bust", "back_width", "bust_line", "waist", "waist_back_width", "waist_line", "hips", "hip_back_width",
    "hips_line",
)  # fmt: skip


def draw_garment(
    size: Measurements, design: GarmentDesign, *, name: str = "garment", mends: frozenset[Mend] = ALL_MENDS
) -> Pattern:
    """The pattern of a design for a wearer, placed round the body.

    Raises ``BodyError`` for missing or impossible measures, and ``PatternError`` for a garment without upper and
    bottom, or with a part that cannot be drawn for this wearer.
    """
    return assemble(pieces(size, design, mends=mends), name)


def pieces(size: Measurements, design: GarmentDesign, *, mends: frozenset[Mend] = ALL_MENDS) -> Component:
    """The component of a garment, as ``draw_garment`` assembles it. Raises as ``draw_garment`` does."""
    drawn = parts(size.require(*MEASURES_USED).require_parts(), design, mends)
    placed = list(drawn[:1])
    for below in drawn[1:]:
        placed.append(below.placed_by("top", placed[-1], "bottom", gap=GAP))
    whole = Component.of(*placed)
    hems = ["bottom_from_front" if design.opens_band() else "bottom", "bottom"]
    for (above, below), hem in zip(pairwise(placed), hems, strict=False):
        whole = whole.sewn(above.interface(hem), below.interface("top"), gathered=True)
    whole = with_pockets(whole, design.pocket, design.pockets())
    whole = with_trim(whole, design.worn_trim(), design.front)
    if Mend.EXPORT_PIVOT not in mends:
        # GarmentCode moves each piece in its plane by the fractional part of its first corner's coordinates.
        corners = ([fmod(coordinate, 1.0) for coordinate in piece.outline.origin] for piece in whole.pieces)
        shifts = (piece.placement.matrix[:, :2] @ at for piece, at in zip(whole.pieces, corners, strict=True))
        moved = (piece.moved(tuple(by.tolist())) for piece, by in zip(whole.pieces, shifts, strict=True))
        whole = replace(whole, pieces=tuple(moved))
    tops = [part.interface("top") for part in placed if "top" in part.interfaces]
    return whole.with_edge_label(tops[0], EdgeRole.LOWER_INTERFACE) if tops else whole


def bottom_rise(design: GarmentDesign, mends: frozenset[Mend] = ALL_MENDS) -> float:
    """Position of the bottom's top: 0 hips, 1 waist.

    1 without a bottom or under an ``at_waist`` upper; lower under a band that would rise above the waist.
    """
    upper, bottom = design.meta.upper, design.meta.bottom
    rise = 1.0 if bottom is None or (upper is not None and upper.garment.at_waist) else bottom.garment.rise(design)
    return band_rise(design.waistband, rise) if design.meta.wb and Mend.WORN_LENGTH in mends else rise


@lru_cache(maxsize=8)  # sampling draws it for the sewability check, then the garment draws it again
def upper(size: Measurements, design: GarmentDesign, mends: frozenset[Mend]) -> Component:
    """The upper of a design with an upper; offers the ring ``bottom`` if it can carry a part."""
    assert design.meta.upper is not None
    return design.meta.upper.garment.draw(size, design, mends=mends)


@lru_cache(maxsize=8)  # likewise
def bottom(size: Measurements, design: GarmentDesign, mends: frozenset[Mend]) -> Component:
    """The bottom of a design with a bottom; offers the ring ``top``."""
    assert design.meta.bottom is not None
    drawn = design.meta.bottom.garment.draw(size, design, rise=bottom_rise(design, mends), mends=mends)
    return drawn.labelled(PanelRole.LEG)


@lru_cache(maxsize=8)  # sampling draws them to find tight rings, then the garment and its rules draw them again
def parts(size: Measurements, design: GarmentDesign, mends: frozenset[Mend] = ALL_MENDS) -> tuple[Component, ...]:
    """The parts of the garment, from the top down, not yet placed. Raises ``PatternError`` as ``draw_garment`` does."""
    meta, rise, found = design.meta, bottom_rise(design), []
    if meta.upper is None and meta.bottom is None:
        raise PatternError("a garment without upper and bottom: choose meta.upper or meta.bottom")
    if meta.upper is not None:
        found.append(upper(size, design, mends))
        if not meta.upper.garment.carries and (meta.wb or meta.bottom):
            raise PatternError(
                f"nothing can be sewn to the hem of a {meta.upper.value}: set meta.wb and meta.bottom to null"
            )
    if meta.wb is not None:
        shirt = design.front if design.opens_band() else None
        elastic = meta.upper is None and meta.bottom is not None and meta.bottom.garment.elastic
        band = waistband(size, design.waistband, meta.wb, rise=rise, shirt=shirt, elastic=elastic)
        found.append(band.labelled(PanelRole.BODY))
    if meta.bottom is not None:
        found.append(bottom(size, design, mends))
    return tuple(found)
