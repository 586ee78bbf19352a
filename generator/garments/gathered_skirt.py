"""The gathered skirt (GarmentCode's ``Skirt2``): two trapezoids. Panels ``skirt_front`` and ``skirt_back``."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from gcd_dataset.generator.garments.description import RUFFLES, Description, Detail, Setting, Tag, Zone
from gcd_dataset.generator.garments.garment import BottomGarment, Cutting, Ring
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.skirt import (
    SHORTEST,
    hem_ring,
    sewn_at_sides,
    skirt_length,
    skirt_panel,
    waist_ring,
)
from gcd_dataset.generator.garments.space import Design, integer, real
from gcd_dataset.generator.garments.trunk import back_at_rise, girth_at_rise
from gcd_dataset.generator.pattern import Component, Piece
from gcd_dataset.records import Measurements

VISIBLE_SLIT, HIGH_SLIT = 4.0, 0.6  # cm, least slit in a description; share of the part below the hips of a high slit
HARDLY_FLARED = 2  # cm added to each side of the hem
FRONT, BACK = 25.0, -20.0  # cm: z of front and back before sewing, GarmentCode


@dataclass(frozen=True)
class GatheredSkirtDesign(Design):
    """A skirt of trapezoids, gathered at the top."""

    length: float = real(0.2, -0.2, 0.95)
    """Depth of the hem below the hips as worn, with or without a waistband, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    ruffle: float = real(1.3, 1.0, 2.0, keep=0.3)
    """Gathers at the top: ratio of the skirt's top to the body's girth."""
    bottom_cut: float = real(0.0, 0.0, 0.9, keep=0.3)
    """Height of the slits at both sides, as a fraction of the part below the hips."""
    flare: int = integer(0, 0, 20, keep=0.5)
    """Width added to each side of the hem [cm]."""


def gathered_skirt(size: Measurements, design: GatheredSkirtDesign, cutting: Cutting) -> Component:
    """Front and back, at least 5 cm long; offers the rings ``top`` and ``bottom``."""
    rise, length = cutting.rise, max(cutting.length, SHORTEST)
    back_width, slit = back_at_rise(size, rise), _slit(design, length - rise * size.hips_line, cutting.mends)

    def panel(name: str, width: float) -> Piece:
        return skirt_panel(name, width, length, flare=design.flare, ruffle=design.ruffle, bottom_cut=slit)

    front = panel(f"skirt_front{cutting.suffix}", girth_at_rise(size, rise) - back_width).at(0, size.waist_level, FRONT)
    back = panel(f"skirt_back{cutting.suffix}", back_width).at(0, size.waist_level, BACK)
    return sewn_at_sides(front, back).offering(top=waist_ring(size, front, back), bottom=hem_ring(front, back))


def _slit(design: GatheredSkirtDesign, below_hips: float, mends: frozenset[Mend]) -> float:
    """Height of the side slits [cm]; 0 for a skirt that ends above the hips."""
    length = below_hips if Mend.SLIT_LENGTH in mends else design.length
    return design.bottom_cut * max(length, 0.0)


def _rings(
    size: Measurements, design: GatheredSkirtDesign, rise: float, length: float, wearer: Measurements
) -> Iterator[Ring]:
    """The skirt's cloth at the hips, if it covers them: with few gathers it is no wider than the waist."""
    above = rise * wearer.hips_line
    if length > above:
        cloth = design.ruffle * girth_at_rise(size, rise) + 4 * design.flare * above / length
        yield Ring("a skirt", cloth, wearer.hips, "raise skirt.ruffle or skirt.flare")


def _describe(setting: Setting, design: GatheredSkirtDesign) -> Description:
    """Gathered if the seam at its top gathers it: on a wide hem or band the same skirt hangs straight."""
    details, tags = [], []
    length = skirt_length(setting.size, design, setting.rise) - setting.rise * setting.size.hips_line
    slit = _slit(design, length, GATHERED_SKIRT.mends)
    if slit >= VISIBLE_SLIT:
        high = "high " if design.bottom_cut > HIGH_SLIT else ""
        details.append(Detail(Zone.HEM, (f"{high}slits at both sides", f"{high}side slits"), main=True))
        tags.append(Tag.SLIT)
    is_flared = design.flare > HARDLY_FLARED
    if is_flared:
        tags.append(Tag.A_LINE)
    if setting.gather >= RUFFLES:
        nouns = ("gathered A-line skirt",) if is_flared else ("gathered skirt",)
        seam = Detail(Zone.LOWER, ("fullness gathered at the waist", "gathers at the waist"))
        return Description(nouns, (), (seam, *details), tags=(Tag.GATHERED, *tags))
    if not is_flared:
        tags.append(Tag.STRAIGHT)
    return Description(("A-line skirt" if is_flared else "straight skirt",), (), tuple(details), tags=tuple(tags))


GATHERED_SKIRT = BottomGarment(
    name="Skirt2",
    section="skirt",
    mends=frozenset({Mend.SLIT_LENGTH}),
    design=GatheredSkirtDesign,
    cut=gathered_skirt,
    length_of=skirt_length,
    description_of=_describe,
    without_slits=lambda design: replace(design, bottom_cut=0.0),
    ungathered=lambda design: replace(design, ruffle=1.0),
    gather_parameter="ruffle",
    rings_of=_rings,
    remedies=("bottom_cut", "length+", "flare-"),
    widened_by="flare",
    always_sewable=lambda design: design.bottom_cut == 0,
)
