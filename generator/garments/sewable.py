"""Sewability of drawn parts: checks for crossings, spikes, short edges, mismatched seams and tight cuffs."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from jaxtyping import Complex, Float

from gcd_dataset.crossings import edge_hulls, find_crossings
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.cuff import arm_girth_in_cuff
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.mends import ALL_MENDS
from gcd_dataset.generator.garments.outfit import bottom
from gcd_dataset.generator.garments.upper import Shirt
from gcd_dataset.generator.garments.upper_half import UpperHalf, right_half, right_torso
from gcd_dataset.generator.pattern import Component, MeasuredJoin, measure_joins, panel_of
from gcd_dataset.records import Measurements, Panel
from gcd_dataset.validate import LARGEST, SHORTEST_EDGE

__all__ = [
    "CLOTH_GIVES",
    "SHARPEST_CORNER",
    "bottom_is_sewable",
    "corner_angles",
    "cuff_and_arm_girth",
    "half_is_sewable",
    "is_mismatched",
    "panels_are_sewable",
    "sleeve_is_tight",
    "upper_is_sewable",
]

CLOTH_GIVES = 1.2  # stretched length over rest length: the most that cloth stretches without losing its shape
SHARPEST_CORNER = 10.0  # degrees: a sharper corner can be neither meshed nor sewn
SEAM_SLACK, SEAM_SHARE = 1.5, 0.12  # cm, and of the shorter side: ungathered sides may differ by the larger of both
TIGHTEST_GATHERS = 3.2  # length of cloth over its gathered length: slightly above the design space's maximum


def half_is_sewable(size: Measurements, design: OutfitDesign, half: UpperHalf) -> bool:
    """Whether one half can be sewn: armhole and neckline fit into front and back, and a flared cuff fits its sleeve."""
    drawings = [right_torso, right_half] if half[-1].has_flared_cuff else [right_torso]
    fitted = _is_fitted(design)
    return all(_can_be_sewn(partial(draw, size, *half, fitted=fitted, mends=ALL_MENDS)) for draw in drawings)


def sleeve_is_tight(size: Measurements, design: OutfitDesign, half: UpperHalf) -> bool:
    """Whether the band at the end of the sleeve of one half is too tight for the arm."""
    try:
        band, arm = cuff_and_arm_girth(size, design, half)
    except PatternError:  # drawing the outfit reports it
        return False
    return band * CLOTH_GIVES < arm


def cuff_and_arm_girth(size: Measurements, design: OutfitDesign, half: UpperHalf) -> tuple[float, float]:
    """Girth of the band at the end of a half's sleeve, and of the arm inside it [cm]; 0 without a band.

    Raises ``PatternError`` for a half that cannot be drawn.
    """
    arm = 0.0 if half[-1].sleeveless else arm_girth_in_cuff(size, half[-1])
    if arm == 0.0:
        return 0.0, 0.0
    drawn = right_half(size, *half, fitted=_is_fitted(design), mends=ALL_MENDS)
    return drawn.length("band") if "band" in drawn.interfaces else 0.0, arm


def bottom_is_sewable(size: Measurements, design: OutfitDesign) -> bool:
    """Whether the bottom, with its slits, darts and godets, can be drawn and sewn."""
    return _can_be_sewn(partial(bottom, size, design, ALL_MENDS))


def upper_is_sewable(size: Measurements, design: OutfitDesign) -> bool:
    """Whether an upper other than a shirt can be drawn and sewn."""
    assert design.meta.upper is not None
    return _can_be_sewn(partial(design.meta.upper.garment.draw, size, design, mends=ALL_MENDS))


def _is_fitted(design: OutfitDesign) -> bool:
    garment = design.meta.upper.garment if design.meta.upper else None
    return isinstance(garment, Shirt) and garment.fitted


def _can_be_sewn(part: Callable[[], Component]) -> bool:
    """Whether a part of an outfit can be drawn, its panels can be sewn, and its seams match."""
    try:
        drawn = part()
        panels = [panel_of(piece) for piece in drawn.pieces]
        return not any(map(is_mismatched, measure_joins(drawn))) and panels_are_sewable(panels)
    except PatternError:
        return False


def panels_are_sewable(panels: Sequence[Panel]) -> bool:
    """Whether all panels have edges of valid lengths, no sharp corner, and no crossing."""
    hulls = [edge_hulls(panel) for panel in panels]
    lengths = [panel.edge_lengths() for panel in panels]
    if any(min(edges) < SHORTEST_EDGE or max(edges) > LARGEST for edges in lengths):
        return False
    return corner_angles(hulls).min() >= SHARPEST_CORNER and not any(find_crossings(panels, hulls, lengths))


def is_mismatched(sewn: MeasuredJoin) -> bool:
    """Whether the sides of a join differ too much in length."""
    shorter, longer = sorted((sewn.left_length, sewn.right_length))
    return longer - shorter > max(SEAM_SLACK, (TIGHTEST_GATHERS - 1 if sewn.join.gathered else SEAM_SHARE) * shorter)


def corner_angles(hulls: Sequence[Complex[np.ndarray, "e 4"]]) -> Float[np.ndarray, " corners"]:
    """Interior angles at the starts of all edges, panel after panel, 0 to 360 [degrees], from ``edge_hulls``."""
    edges, sizes = np.concatenate(hulls), np.array([len(panel) for panel in hulls])
    first = np.cumsum(sizes) - sizes
    before, after = np.arange(len(edges)) - 1, np.arange(len(edges)) + 1
    before[first], after[first + sizes - 1] = first + sizes - 1, first
    leaving, arriving = edges[:, 1] - edges[:, 0], (edges[:, 3] - edges[:, 2])[before]
    corners = edges[:, 0]
    around = np.sign(np.add.reduceat((corners.conj() * corners[after]).imag, first))
    return np.degrees(np.pi - np.repeat(around, sizes) * np.angle(leaving / arriving))
