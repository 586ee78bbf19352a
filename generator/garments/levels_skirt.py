"""The levels skirt: skirts sewn one under the other."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import radians
from typing import Any, TypeAlias

from gcd_dataset.generator.garments.circle_skirt import ASYMMETRIC_CIRCLE_SKIRT, CIRCLE_SKIRT
from gcd_dataset.generator.garments.description import (
    RUFFLES,
    Description,
    Detail,
    Setting,
    Tag,
    Zone,
    number_word,
    with_article,
)
from gcd_dataset.generator.garments.garment import BottomGarment, Combined, Cutting, GarmentChoice, Ring
from gcd_dataset.generator.garments.gathered_skirt import GATHERED_SKIRT
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.pencil_skirt import PENCIL_SKIRT
from gcd_dataset.generator.garments.skirt import SHORTEST
from gcd_dataset.generator.garments.space import Design, choice, integer, real
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements

FLARED_LEVEL = 0.375  # suns: descriptions call levels of more flared
GAP = 5.0  # cm between a hem and the level under it before sewing, GarmentCode


class LevelsBase(GarmentChoice):
    """Skirts for the base."""

    garment: BottomGarment[Any]

    GATHERED = GATHERED_SKIRT
    PENCIL = PENCIL_SKIRT
    CIRCLE = CIRCLE_SKIRT
    ASYMMETRIC_CIRCLE = ASYMMETRIC_CIRCLE_SKIRT


class Level(GarmentChoice):
    """Skirts for the levels below."""

    garment: BottomGarment[Any]

    GATHERED = GATHERED_SKIRT
    CIRCLE = CIRCLE_SKIRT
    ASYMMETRIC_CIRCLE = ASYMMETRIC_CIRCLE_SKIRT


DrawLevel: TypeAlias = Callable[[Measurements, str], Component]
"""Draws a level from measures, with the girth of its top as the waist, and a suffix of its panels' names."""


@dataclass(frozen=True)
class LevelsSkirtDesign(Design):
    """A base and the levels under it, each with the parameters of its own section."""

    base: LevelsBase = choice(LevelsBase.PENCIL, *LevelsBase)
    """The skirt at the top, with the parameters of its own section."""
    level: Level = choice(Level.GATHERED, *Level)
    """The skirt of each level, with the parameters of its own section."""
    num_levels: int = integer(1, 1, 5)
    """Number of levels under the base."""
    level_ruffle: float = real(1.0, 1.0, 1.7)
    """Gathers at the top of a level: ratio of its top to the hem above."""
    length: float = real(0.5, 0.2, 0.95)
    """Depth of the lowest hem below the hips as worn, with or without a waistband, as a fraction of hips to floor.

    Base and levels are at least 5 cm long: many short levels hang lower.
    """
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Position of the top: 0 at the hips, 1 at the waist."""
    base_length_frac: float = real(0.5, 0.2, 0.8)
    """The base's share of the length."""


def _lengths(
    size: Measurements, design: LevelsSkirtDesign, *, rise: float, mends: frozenset[Mend]
) -> tuple[float, float]:
    """Lengths of the base, from a top at ``rise``, and of each level [cm]."""
    below_hips = design.length * size.leg_length
    base, levels = design.base_length_frac * below_hips, (1 - design.base_length_frac) * below_hips
    base_rise = rise if Mend.LEVEL_GIRTH in mends else design.rise
    return base + base_rise * size.hips_line, levels / design.num_levels


def with_levels(
    base: Component, level: DrawLevel, design: LevelsSkirtDesign, *, size: Measurements, hem_tilt: float
) -> Component:
    """The base with levels one under the other, each gathered to the hem above; offers the ring ``top``.

    ``hem_tilt``: tilt of the base's hem [degrees].
    """
    skirts = [base]
    for number in range(design.num_levels):
        above = skirts[-1]
        hems = (above.piece(each.panel).outline.length(each.edge) for each in above.interface("bottom"))
        front, back = (design.level_ruffle * hem for hem in hems)
        wearer = replace(size, waist=front + back, waist_back_width=back)
        next_level = level(wearer, f"_{number}").turned(-radians(hem_tilt))
        skirts.append(next_level.placed_by("top", skirts[-1], "bottom", gap=GAP))
    whole = Component.of(*skirts)
    for above, below in pairwise(skirts):
        whole = whole.sewn(above.interface("bottom"), below.interface("top"), gathered=True)
    return whole.offering(top=base.interface("top"))


def _combined(size: Measurements, drawn: Combined[LevelsSkirtDesign], cutting: Cutting) -> Component:
    """A base and levels without slits; only ``level_ruffle`` gathers the levels."""
    design, (base, level), mends = drawn.design, drawn.parts, cutting.mends
    base_length, level_length = _lengths(size, design, rise=cutting.rise, mends=mends)
    ungathered = level.garment.without_slits(level.garment.ungathered(level.design))
    level_rise = 1.0 if Mend.LEVEL_GIRTH in mends else level.design.rise
    return with_levels(
        base.garment.cut(size, base.plain, Cutting(cutting.rise, base_length, mends)),
        lambda wearer, suffix: level.garment.cut(wearer, ungathered, Cutting(level_rise, level_length, mends, suffix)),
        design,
        size=size,
        hem_tilt=base.garment.hem_tilt(base.design),
    )


def _length(size: Measurements, drawn: Combined[LevelsSkirtDesign], rise: float, *, shortest: float = 0.0) -> float:
    """``shortest``: of base and levels [cm]."""
    base, level = _lengths(size, drawn.design, rise=rise, mends=ALL_MENDS)
    return max(base, shortest) + drawn.design.num_levels * max(level, shortest)


def _rings(
    size: Measurements, drawn: Combined[LevelsSkirtDesign], rise: float, length: float, wearer: Measurements
) -> Iterable[Ring]:
    """The rings of the base; the levels are at least as wide as its hem."""
    base, (base_length, _) = drawn.parts[0], _lengths(size, drawn.design, rise=rise, mends=ALL_MENDS)
    return base.garment.rings_of(size, base.plain, rise, base_length, wearer)


def _describe(setting: Setting, drawn: Combined[LevelsSkirtDesign]) -> Description:
    design, (top, level) = drawn
    base = top.garment.description_of(setting, top.plain)
    is_flared = level.garment is not GATHERED_SKIRT and level.design.suns >= FLARED_LEVEL
    is_gathered = design.level_ruffle >= RUFFLES
    cut = ("gathered " if is_gathered else "") + ("flared " if is_flared else "")
    tiers = f"{number_word(design.num_levels)} {cut}{'tier' if design.num_levels == 1 else 'tiers'}"
    details = [Detail(Zone.LOWER, (f"{tiers} under {with_article(base.noun[0])}",), main=True)]
    tags = [Tag.TIERED, *base.tags, *([Tag.RUFFLED] if is_gathered else [])]
    if level.garment is ASYMMETRIC_CIRCLE_SKIRT and top.garment is not ASYMMETRIC_CIRCLE_SKIRT:
        words = ("tiers that are longer behind than in front", "high-low tiers")
        details.append(Detail(Zone.HEM, words))
        tags.append(Tag.ASYMMETRIC)
    tiered = number_word(design.num_levels + 1)
    nouns = ("tiered skirt", f"{tiered}-tier skirt")
    return Description(nouns, (), (*details, *base.details), base.traits, tuple(tags))


LEVELS_SKIRT = BottomGarment(
    name="SkirtLevels",
    section="levels-skirt",
    mends=frozenset({Mend.LEVEL_GIRTH}),
    design=LevelsSkirtDesign,
    parts_of=lambda design: (design.base.garment, design.level.garment),
    cut=_combined,
    rise_of=lambda drawn: drawn.design.rise,
    remedies=("level_ruffle-", "num_levels-"),
    length_of=_length,
    drawn_length_of=partial(_length, shortest=SHORTEST),
    description_of=_describe,
    rings_of=_rings,
)
