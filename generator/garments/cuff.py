"""Cuffs of sleeves and trousers: a band, a small skirt, or a band with a skirt on it.

Panels of the right sleeve's cuff: ``sl_right_cuff_f``, ``sl_right_cuff_skirt_b``, …; of the right trouser leg's:
``pant_r_cuff_f``, ….
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import RUFFLES, CuffGathers
from gcd_dataset.generator.garments.skirt import band, sewn_at_sides, skirt_panel
from gcd_dataset.generator.garments.space import Design, choice, real
from gcd_dataset.generator.pattern import Component, Piece
from gcd_dataset.records import Measurements, PanelRole

if TYPE_CHECKING:
    from gcd_dataset.generator.garments.sleeve import SleeveDesign

LONGEST_ON_SLEEVE = 0.7  # longest cuff, as a share of the sleeve, GarmentCode
SHORTEST = 0.1  # cm: the shortest cuff
ON_SHOULDER = 0.12  # approximate share of shoulder to wrist above the armhole, which no sleeve length includes
ARM_LEVELS = (0.15, 0.25, 0.35, 0.5, 0.6, 0.7, 0.85, 1.0)  # positions as fractions of shoulder to wrist
ARM_GIRTHS = (2.2, 1.9, 1.8, 1.61, 1.53, 1.48, 1.22, 1.0)  # over the wrist's: means of this package's bodies, ± 0.05
FRONT, BACK = 15.0, -15.0  # cm before and behind the limb, GarmentCode
DEEP = 12.0  # cm: least length of a cuff that descriptions call deep
GAP = 2.0  # cm between sleeve, band and skirt before sewing, GarmentCode


class Cuff(Enum):
    """Kind of cuff, by GarmentCode's name."""

    BAND = "CuffBand"
    SKIRT = "CuffSkirt"
    BAND_SKIRT = "CuffBandSkirt"


@dataclass(frozen=True)
class SleeveCuffDesign(Design):
    """The cuff of a sleeve, or none."""

    type: Cuff | None = choice(None, *Cuff, None)
    """Kind of cuff, or none: a band, a flared skirt, or a band with a skirt below."""
    top_ruffle: float = real(1.0, 1.0, 3.0)
    """Gathers at the limb's end: ratio of the sleeve's or leg's girth to the cuff's."""
    cuff_len: float = real(0.1, 0.05, 0.9, keep=0.7)
    """Length, as a fraction of the arm."""
    skirt_fraction: float = real(0.5, 0.1, 0.9, keep=0.5)
    """The skirt's share of the length of a band with a skirt."""
    skirt_flare: float = real(1.2, 1.0, 2.0)
    """Hem of the skirt, as a fraction of its top without gathers."""
    skirt_ruffle: float = real(1.0, 1.0, 1.5, keep=0.3)
    """Gathers at the top of the skirt: ratio of the top to the edge that it is sewn to."""


@dataclass(frozen=True)
class PantsCuffDesign(SleeveCuffDesign):
    """The cuff of a trouser leg, or none."""

    type: Cuff | None = choice(None, *Cuff, None, keep=0.5)
    top_ruffle: float = real(1.0, 1.0, 2.0)
    cuff_len: float = real(0.1, 0.05, 0.9, keep=0.3)
    """Length, as a fraction of hips to floor; taken off the leg."""
    skirt_fraction: float = real(0.5, 0.1, 0.9)
    skirt_ruffle: float = real(1.0, 1.0, 1.5)


def cuff_words(kind: Cuff, length: float, gathers: CuffGathers, *, limb: str) -> tuple[str, ...]:
    """Noun phrases for the two cuffs of a pair of limbs; ``length``: of a cuff [cm]; ``limb``: "sleeve" or "leg"."""
    deep = "deep " if length >= DEEP else ""
    ends = f"at the {limb} ends"
    frill = "frills" if gathers.frill >= RUFFLES else "flounces"
    if kind is Cuff.SKIRT:
        cuffs = f"{deep}flared cuffs" if frill == "flounces" else f"{deep}gathered frills"
    else:
        cuffs = f"{deep}band cuffs" if kind is Cuff.BAND else f"{deep}band cuffs with {frill}"
    if gathers.limb < RUFFLES:
        return (f"{cuffs} {ends}",)
    return (f"{cuffs} that gather the {limb} ends", f"{limb} ends gathered into {cuffs}")


def single_cuff_words(kind: Cuff, length: float, gathers: CuffGathers) -> str:
    """A noun phrase for the cuff of one limb: see ``cuff_words``."""
    deep = "deep " if length >= DEEP else ""
    frill = "frill" if gathers.frill >= RUFFLES else "flounce"
    noun = {Cuff.BAND: "band cuff", Cuff.BAND_SKIRT: f"band cuff with a {frill}", Cuff.SKIRT: "flared cuff"}[kind]
    return f"a {deep}{noun}"


def skirt_share(design: SleeveCuffDesign) -> float:
    """The skirt's share of a cuff's length: the limb does not fill this part; 1 without a cuff."""
    return {Cuff.BAND: 0.0, Cuff.BAND_SKIRT: design.skirt_fraction, Cuff.SKIRT: 1.0, None: 1.0}[design.type]


def arm_girth_in_end(size: Measurements, design: "SleeveDesign") -> float:
    """Largest girth of the arm in a sleeve's end: its cuff's band, the top of its skirt, or the hem [cm]."""
    skirt = skirt_share(design.cuff)
    end = ON_SHOULDER + (1 - ON_SHOULDER) * design.length
    band = sleeve_cuff_length(size, design) / size.arm_length
    levels = np.linspace(end - band, end - skirt * band, 9)
    return float(np.interp(levels, ARM_LEVELS, ARM_GIRTHS).max()) * size.wrist


def sleeve_cuff_length(size: Measurements, design: "SleeveDesign") -> float:
    """Length by which the cuff shortens its sleeve [cm]; 0 without a cuff."""
    if design.cuff.type is None:
        return 0.0
    return min(design.cuff.cuff_len, LONGEST_ON_SLEEVE * design.length) * size.arm_length


def with_sleeve_cuff(size: Measurements, design: "SleeveDesign", sleeve: Component) -> Component:
    """The right sleeve along the x axis, wrist to the left, with its cuff, at least as wide as the wrist.

    Offers ``opening`` like the sleeve, and the shorter side of the seam between sleeve and cuff as the ring ``band``.
    """
    if design.cuff.type is None:
        return sleeve
    girth = max(sleeve.length("end") / design.cuff.top_ruffle, size.wrist)
    drawn = cuff("sl_right", girth, sleeve_cuff_length(size, design), design.cuff.type, design.cuff).labelled(
        PanelRole.ARM
    )
    placed = drawn.turned(-pi / 2).placed_by("top", sleeve, "end", gap=GAP, top=True)
    sewn = Component.of(sleeve, placed).sewn(sleeve.interface("end"), placed.interface("top"), gathered=True)
    band = min(
        sleeve.interface("end"), placed.interface("top"), key=lambda ring: sewn.offering(ring=ring).length("ring")
    )
    return sewn.offering(opening=sleeve.interface("opening"), band=band)


def cuff(limb: str, girth: float, length: float, kind: Cuff, design: SleeveCuffDesign) -> Component:
    """A cuff round a limb, down from the origin; offers the ring ``top`` (front from right to left, then back).

    Raises ``PatternError`` for a cuff shorter than ``SHORTEST``.
    """
    if kind is Cuff.BAND:
        return _band(limb, girth, length)
    if kind is Cuff.SKIRT:
        return _skirt(limb, girth, length, design)
    upper = _band(limb, girth, length * (1 - design.skirt_fraction))
    lower = _skirt(limb, girth, length * design.skirt_fraction, design)
    placed = lower.placed_by("top", upper, "bottom", gap=GAP)
    sewn = Component.of(upper, placed).sewn(upper.interface("bottom"), placed.interface("top"), gathered=True)
    return sewn.offering(top=upper.interface("top"))


def _band(limb: str, girth: float, length: float) -> Component:
    front, back, tube = _tube(f"{limb}_cuff", length, lambda name: band(name, 0.5 * girth, length))
    return tube.offering(
        top=front.against("top") + back.along("top"), bottom=front.along("bottom") + back.against("bottom")
    )


def _skirt(limb: str, girth: float, length: float, design: SleeveCuffDesign) -> Component:
    flare = 0.5 * girth * (design.skirt_flare - 1)
    front, back, tube = _tube(
        f"{limb}_cuff_skirt",
        length,
        lambda name: skirt_panel(name, 0.5 * girth, length, flare=flare, ruffle=design.skirt_ruffle),
    )
    return tube.offering(top=front.along("top") + back.against("top"))


def _tube(name: str, length: float, half: Callable[[str], Piece]) -> tuple[Piece, Piece, Component]:
    """Front and back of the same shape, and the component of both, sewn at the sides."""
    if length < SHORTEST:
        raise PatternError(f"{name} is {length:.2f} cm long: raise cuff_len, or the length of the sleeve or trousers")
    front, back = half(f"{name}_f").at(0, 0, FRONT), half(f"{name}_b").at(0, 0, BACK)
    return front, back, sewn_at_sides(front, back)
