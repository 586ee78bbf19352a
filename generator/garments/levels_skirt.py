"""The levels skirt: skirts sewn one under the other."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from math import radians
from typing import TypeAlias

from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.space import Design, choice, integer, real
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements

__all__ = ["DrawLevel", "Level", "LevelsBase", "LevelsSkirtDesign", "level_lengths", "with_levels"]

GAP = 5.0  # cm between a hem and the level under it before sewing, GarmentCode


class LevelsBase(Enum):
    """Skirts for the top."""

    GATHERED = "Skirt2"
    PENCIL = "PencilSkirt"
    CIRCLE = "SkirtCircle"
    ASYMMETRIC_CIRCLE = "AsymmSkirtCircle"


class Level(Enum):
    """Skirts for the levels below."""

    GATHERED = "Skirt2"
    CIRCLE = "SkirtCircle"
    ASYMMETRIC_CIRCLE = "AsymmSkirtCircle"


DrawLevel: TypeAlias = Callable[[Measurements, str], Component]
"""Draws a level for a wearer whose waist is as wide as the level's top; its panels' names end in a tag."""


@dataclass(frozen=True)
class LevelsSkirtDesign(Design):
    """A base and the levels under it, each with the parameters of its own section."""

    base: LevelsBase = choice(LevelsBase.PENCIL, *LevelsBase)
    level: Level = choice(Level.GATHERED, *Level)
    num_levels: int = integer(1, 1, 5)
    """How many levels hang under the base."""
    level_ruffle: float = real(1.0, 1.0, 1.7)
    """Gathers at the top of a level: level over the hem above."""
    length: float = real(0.5, 0.2, 0.95)
    """Of all, below the hips, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    base_length_frac: float = real(0.5, 0.2, 0.8)
    """The base's share of the length."""


def level_lengths(
    size: Measurements, design: LevelsSkirtDesign, *, rise: float, mends: frozenset[Mend]
) -> tuple[float, float]:
    """Of the base, from a top at ``rise``, and of each level [cm]."""
    whole = design.length * size.leg_length
    base, levels = design.base_length_frac * whole, (1 - design.base_length_frac) * whole
    above = rise if Mend.LEVEL_GIRTH in mends else design.rise
    return base + above * size.hips_line, levels / design.num_levels


def with_levels(
    base: Component, level: DrawLevel, design: LevelsSkirtDesign, *, size: Measurements, tilt: float
) -> Component:
    """The base with levels hung one under the other, each gathered to the hem above; offers ``top`` [ring].

    ``tilt`` is that of the base's hem [degrees].
    """
    skirts = [base]
    for number in range(design.num_levels):
        front, back = (design.level_ruffle * hem for hem in _hems(skirts[-1]))
        wearer = replace(size, waist=front + back, waist_back_width=back)
        below = level(wearer, f"_{number}").turned(-radians(tilt))
        skirts.append(below.placed_by("top", skirts[-1], "bottom", gap=GAP))
    whole = Component.of(*skirts)
    for above, below in pairwise(skirts):
        whole = whole.sewn(above.interface("bottom"), below.interface("top"), gathered=True)
    return whole.offering(top=base.interface("top"))


def _hems(skirt: Component) -> tuple[float, float]:
    """Lengths of the hem before and behind [cm]."""
    front, back = (skirt.piece(section.panel).outline.length(section.edge) for section in skirt.interface("bottom"))
    return front, back
