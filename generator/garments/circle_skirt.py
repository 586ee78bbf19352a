"""The circle skirt: two sectors of a ring, ``skirt_front`` and ``skirt_back``."""

from dataclasses import dataclass, replace
from math import pi

from gcd_dataset.generator.garments.ring import sector
from gcd_dataset.generator.garments.space import Design, flag, part, real
from gcd_dataset.generator.garments.trunk import girth_at_rise, waist_back, waist_front
from gcd_dataset.generator.pattern import Component, Piece, cut_into, notch
from gcd_dataset.records import Measurements

__all__ = ["CircleSkirtDesign", "HemCutDesign", "circle_skirt", "skirt_length"]

SHORTEST = 5.0  # cm, GarmentCode
HEM_CUT_MARGIN = 1.0  # cm of hem left beside a cut
FRONT, BACK = 15.0, -15.0  # cm before and behind the axis, GarmentCode


@dataclass(frozen=True)
class HemCutDesign(Design):
    """A triangular cut in the hem."""

    add: bool = flag(False, keep=0.6)
    depth: float = real(0.5, 0.05, 0.95, keep=0.6)
    """As a fraction of the skirt's length."""
    width: float = real(0.1, 0.05, 0.4)
    """At the hem, as a fraction of the skirt's length."""
    place: float = real(-0.5, -1.0, 1.0)
    """Fraction of the hem's length at which it is centred: of the front's if positive, else of the back's."""


@dataclass(frozen=True)
class CircleSkirtDesign(Design):
    """A skirt cut from circles of cloth."""

    length: float = real(0.2, -0.2, 0.95)
    """Below the hips, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    suns: float = real(0.75, 0.1, 1.95)
    """How many full circles the front and the back together are cut from."""
    cut: HemCutDesign = part(HemCutDesign)


def circle_skirt(size: Measurements, design: CircleSkirtDesign) -> Component:
    """Front and back of equal size, sewn at the sides; offers ``top`` [ring].

    The tops are equal although front and back of the waist are not: their gathers shift the seams to where the
    waist's sides are.
    """
    top, length = 0.5 * girth_at_rise(size, design.rise), skirt_length(size, design)
    half = sector("skirt", top, pi * design.suns, length)
    front = replace(half, name="skirt_front").at(0, size.waist_level, FRONT)
    back = replace(half, name="skirt_back").at(0, size.waist_level, BACK)
    if design.cut.add:
        front, back = _with_hem_cut(front, back, design.cut, length)
    waist = front.against("top", ruffle=top / waist_front(size)) + back.along("top", ruffle=top / waist_back(size))
    return (
        Component.of(front, back)
        .sewn(front.along("right"), back.along("right"))
        .sewn(front.along("left"), back.along("left"))
        .offering(top=waist)
    )


def skirt_length(size: Measurements, design: CircleSkirtDesign) -> float:
    """From the top to the hem along the cloth [cm]."""
    return max(design.rise * size.hips_line + design.length * size.leg_length, SHORTEST)


def _with_hem_cut(front: Piece, back: Piece, cut: HemCutDesign, length: float) -> tuple[Piece, Piece]:
    """Front and back, the cut in one of them, moved inwards where it would run over the end of the hem."""
    shape = notch(cut.width * length, cut.depth * length, name="hem_cut")
    target = front if cut.place > 0 else back
    hem = target.outline.length("bottom")
    margin = HEM_CUT_MARGIN + 0.5 * cut.width * length
    at = min(max(abs(cut.place) * hem, margin), hem - margin)
    opened = replace(target, outline=cut_into(target.outline, "bottom", shape, at=at))
    return (opened, back) if cut.place > 0 else (front, opened)
