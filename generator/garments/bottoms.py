"""The bottoms there are: how each is drawn, where its top sits and how long it is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from gcd_dataset.generator.garments.circle_skirt import asymmetric_circle_skirt, circle_skirt, flare_skirt_length
from gcd_dataset.generator.garments.design import Bottom, OutfitDesign
from gcd_dataset.generator.garments.gathered_skirt import gathered_skirt, gathered_skirt_length
from gcd_dataset.generator.garments.godet_skirt import with_godets
from gcd_dataset.generator.garments.levels_skirt import LevelsBase, level_lengths, with_levels
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.panel_skirt import panel_skirt
from gcd_dataset.generator.garments.pants import pants, pants_length
from gcd_dataset.generator.garments.pencil_skirt import pencil_skirt, pencil_skirt_length, without_slits
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements

__all__ = ["BOTTOMS", "BottomProgram"]


class Drawing(Protocol):
    """How a bottom is drawn; its top sits at ``rise`` (0 hips, 1 waist)."""

    def __call__(
        self, size: Measurements, design: OutfitDesign, *, rise: float, mends: frozenset[Mend]
    ) -> Component: ...


@dataclass(frozen=True)
class BottomProgram:
    """All that an outfit must know of a bottom."""

    draw: Drawing
    """The component; it offers ``top`` [ring]."""
    rise: Callable[[OutfitDesign], float]
    """Where its top sits by the design: 0 hips, 1 waist."""
    length: Callable[[Measurements, OutfitDesign, float], float]
    """From the top, at a rise, to the hem [cm]."""


class Cutting(Protocol):
    """How a skirt of a given length [cm] is drawn, its panels' names ending in ``tag``."""

    def __call__(
        self,
        size: Measurements,
        design: OutfitDesign,
        *,
        rise: float,
        length: float,
        mends: frozenset[Mend],
        tag: str = "",
    ) -> Component: ...


@dataclass(frozen=True)
class _Skirt:
    """A skirt that can be worn by itself, have godets let into it, or hang over or under another."""

    cut: Cutting
    """The component; it offers ``top`` and ``bottom`` [rings]."""
    rise: Callable[[OutfitDesign], float]
    length: Callable[[Measurements, OutfitDesign, float], float]

    def draw(self, size: Measurements, design: OutfitDesign, *, rise: float, mends: frozenset[Mend]) -> Component:
        """The skirt as long as its own section says."""
        return self.cut(size, design, rise=rise, length=self.length(size, design, rise), mends=mends)


def _circle(
    size: Measurements, design: OutfitDesign, *, rise: float, length: float, mends: frozenset[Mend], tag: str = ""
) -> Component:
    return circle_skirt(size, design.flare_skirt, rise=rise, length=length, tag=tag)


def _asymmetric_circle(
    size: Measurements, design: OutfitDesign, *, rise: float, length: float, mends: frozenset[Mend], tag: str = ""
) -> Component:
    return asymmetric_circle_skirt(size, design.flare_skirt, rise=rise, length=length, tag=tag)


def _gathered(
    size: Measurements, design: OutfitDesign, *, rise: float, length: float, mends: frozenset[Mend], tag: str = ""
) -> Component:
    return gathered_skirt(size, design.skirt, rise=rise, length=length, mends=mends, tag=tag)


def _pencil(
    size: Measurements, design: OutfitDesign, *, rise: float, length: float, mends: frozenset[Mend], tag: str = ""
) -> Component:
    return pencil_skirt(size, design.pencil_skirt, rise=rise, length=length, tag=tag)


def _flare_rise(design: OutfitDesign) -> float:
    return design.flare_skirt.rise


def _flare_length(size: Measurements, design: OutfitDesign, rise: float) -> float:
    return flare_skirt_length(size, design.flare_skirt, rise=rise)


SKIRTS: Mapping[Bottom, _Skirt] = {
    Bottom.CIRCLE: _Skirt(_circle, _flare_rise, _flare_length),
    Bottom.ASYMMETRIC_CIRCLE: _Skirt(_asymmetric_circle, _flare_rise, _flare_length),
    Bottom.GATHERED: _Skirt(
        _gathered,
        lambda design: design.skirt.rise,
        lambda size, design, rise: gathered_skirt_length(size, design.skirt, rise=rise),
    ),
    Bottom.PENCIL: _Skirt(
        _pencil,
        lambda design: design.pencil_skirt.rise,
        lambda size, design, rise: pencil_skirt_length(size, design.pencil_skirt, rise=rise),
    ),
}


def _panels(size: Measurements, design: OutfitDesign, *, rise: float, mends: frozenset[Mend]) -> Component:
    flare, length = design.flare_skirt, _flare_length(size, design, rise)
    return panel_skirt(size, flare.skirt_many_panels, suns=flare.suns, rise=rise, length=length)


def _godets(size: Measurements, design: OutfitDesign, *, rise: float, mends: frozenset[Mend]) -> Component:
    base = _godet_base(design).draw(size, _closed(design), rise=rise, mends=mends)
    return with_godets(base, design.godet_skirt)


def _godet_base(design: OutfitDesign) -> _Skirt:
    return SKIRTS[Bottom(design.godet_skirt.base.value)]


def _levels(size: Measurements, design: OutfitDesign, *, rise: float, mends: frozenset[Mend]) -> Component:
    """A base and levels, none with slits; the levels have no gathers but those of ``level_ruffle``."""
    plan, closed = design.levels_skirt, _closed(design)
    base, level = SKIRTS[Bottom(plan.base.value)], SKIRTS[Bottom(plan.level.value)]
    as_level = replace(closed, skirt=replace(closed.skirt, ruffle=1.0))
    level_rise = 1.0 if Mend.LEVEL_GIRTH in mends else level.rise(design)
    base_length, level_length = level_lengths(size, plan, rise=rise, mends=mends)
    return with_levels(
        base.cut(size, closed, rise=rise, length=base_length, mends=mends),
        lambda wearer, tag: level.cut(wearer, as_level, rise=level_rise, length=level_length, mends=mends, tag=tag),
        plan,
        size=size,
        tilt=design.pencil_skirt.low_angle if plan.base is LevelsBase.PENCIL else 0,
    )


def _levels_length(size: Measurements, design: OutfitDesign, rise: float) -> float:
    base, level = level_lengths(size, design.levels_skirt, rise=rise, mends=ALL_MENDS)
    return base + design.levels_skirt.num_levels * level


def _closed(design: OutfitDesign) -> OutfitDesign:
    """The design without slits and cuts, which would be in the way of what is sewn to a hem."""
    return replace(
        design,
        skirt=replace(design.skirt, bottom_cut=0.0),
        pencil_skirt=without_slits(design.pencil_skirt),
        flare_skirt=replace(design.flare_skirt, cut=replace(design.flare_skirt.cut, add=False)),
    )


BOTTOMS: Mapping[Bottom, BottomProgram] = {
    **{kind: BottomProgram(skirt.draw, skirt.rise, skirt.length) for kind, skirt in SKIRTS.items()},
    Bottom.PANELS: BottomProgram(_panels, _flare_rise, _flare_length),
    Bottom.GODET: BottomProgram(
        _godets,
        lambda design: _godet_base(design).rise(design),
        lambda size, design, rise: _godet_base(design).length(size, design, rise),
    ),
    Bottom.LEVELS: BottomProgram(_levels, lambda design: design.levels_skirt.rise, _levels_length),
    Bottom.PANTS: BottomProgram(
        lambda size, design, *, rise, mends: pants(size, design.pants, rise=rise),
        lambda design: design.pants.rise,
        lambda size, design, rise: pants_length(size, design.pants, rise=rise),
    ),
}
