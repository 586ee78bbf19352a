"""Random designs: each parameter by GarmentCode's rule, within limits that keep the outfit wearable.

Each parameter keeps its default with its ``keep`` probability, and is uniform over its range otherwise. A value outside
the limits set by the rest of the design and by the wearers' measures is drawn again within them; ``rules.py`` catches
the rest. Unlike GarmentCode's sampler, this one

- draws the kind of garment first: upper, lower or full-body, with equal probability (GarmentCode redraws a rejected
  design completely, which favours kinds that are rarely rejected);
- leaves sections that the garment does not use at their defaults;
- shortens a bottom that would reach the floor, and ends a shirt near the waist if a band or bottom is sewn to it;
- fits a bottom without upper to the trunk, puts a gathered one on a snug band, and limits flares without a firm band;
- redraws armholes, necklines, slits, cuts and godets until the panels can be sewn, and trousers and sleeves until legs
  and arms fit through their cuffs.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments.design import LeftDesign, MetaDesign, OutfitDesign
from gcd_dataset.generator.garments.garment import UpperGarment
from gcd_dataset.generator.garments.kind import HAS_UPPER_AND_BOTTOM, Kind, choice_of, possible_kinds, upper_choice
from gcd_dataset.generator.garments.neckline import LeftNecklineDesign
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.garments.parameter import Choice, Space
from gcd_dataset.generator.garments.rules import (
    LIGHT_LENGTH,
    LIGHT_SUNS,
    garment_length,
    has_firm_band,
    has_snug_band,
    has_tight_cuffs,
    is_flared,
    is_gathered,
    room_to_floor,
    top_girth,
    top_of_bottom,
)
from gcd_dataset.generator.garments.sewable import bottom_is_sewable, half_is_sewable, sleeve_is_tight, upper_is_sewable
from gcd_dataset.generator.garments.shirt import ShirtDesign
from gcd_dataset.generator.garments.space import DesignSpace, draw, from_dict, to_dict
from gcd_dataset.generator.garments.upper import Shirt
from gcd_dataset.generator.garments.upper_half import UpperHalf
from gcd_dataset.records import Measurements

__all__ = ["design_from_dict", "design_to_dict", "sample_design", "sample_kind"]

# A shirt with a band or bottom sewn to its hem ends near the waist, where both have about the same girth.
JOINED_SHIRT = (0.8, 1.3)  # limits of shirt.length
NECKLINE_TRIES, UPPER_TRIES, BOTTOM_TRIES = 10, 5, 10


def sample_kind(rng: np.random.Generator, overlay: Overlay = NO_OVERLAY) -> Kind:
    """One of the kinds of garment that the overlay allows, with equal probability."""
    kinds = possible_kinds(_sections(overlay)["meta"])
    return kinds[int(rng.integers(len(kinds)))]


def sample_design(
    rng: np.random.Generator,
    wearers: Iterable[Measurements] = (),
    *,
    kind: Kind | None = None,
    overlay: Overlay = NO_OVERLAY,
) -> OutfitDesign:
    """A random outfit that all ``wearers`` (by default the neutral body) can most likely wear."""
    draft = _Draft(rng, _sections(overlay), tuple(wearers) or (_neutral(),))
    design = draft.with_parts(kind or sample_kind(rng, overlay))
    if design.meta.wb:
        design = draft.with_band(design)
    if design.meta.upper:
        design = draft.with_upper(design)
    return draft.with_bottom(design) if design.meta.bottom else design


def design_to_dict(design: OutfitDesign) -> dict[str, Any]:
    """The design as nested plain values, under GarmentCode's names."""
    return to_dict(design)


def design_from_dict(values: Mapping[str, Any]) -> OutfitDesign:
    """The design from nested plain values; omitted parameters keep their defaults.

    Raises ``ConfigError`` with the path of an unknown parameter, or of a value outside its range.

    >>> design_from_dict({"meta": {"upper": None, "bottom": "SkirtCircle"}, "flare-skirt": {"suns": 1}}).meta.bottom
    <Bottom.CIRCLE: 'SkirtCircle'>
    """
    return from_dict(OutfitDesign, values)


# --------------------------------------------------------------------------------------------------------------- steps


@dataclass(frozen=True)
class _Draft:
    """Random draws for one design: the generator, the spaces of its sections, and the wearers' measures."""

    rng: np.random.Generator
    sections: Mapping[str, DesignSpace[Any]]
    sizes: tuple[Measurements, ...]

    def draw_section(self, section: str) -> Any:
        """A random section of the design, by GarmentCode's rule."""
        return draw(self.sections[section], self.rng)

    def redrawn_within(self, section: str, design: Any, **limits: tuple[float, float]) -> Any:
        """The section with the values outside their limits drawn again within them."""
        changed = {}
        for name, (low, high) in limits.items():
            if not low <= getattr(design, name) <= high:
                changed[name] = _leaf(self.sections[section], name).draw(self.rng, low, high)
        return replace(design, **changed)

    def with_parts(self, kind: Kind) -> OutfitDesign:
        """A design with a random upper, band and bottom."""
        space, (_, has_bottom) = self.sections["meta"], HAS_UPPER_AND_BOTTOM[kind]
        upper = upper_choice(space, kind).draw(self.rng)
        bottom = _only(choice_of(space, "bottom"), has_bottom).draw(self.rng)
        bands = choice_of(space, "wb")
        bands = bands if upper is None or upper.garment.carries else _only(bands, False)
        return OutfitDesign(meta=MetaDesign(upper, bands.draw(self.rng), bottom))

    def with_band(self, design: OutfitDesign) -> OutfitDesign:
        """With a random waistband; without an upper it is no wider than the trunk."""
        design = replace(design, waistband=self.draw_section("waistband"))
        if design.meta.upper:
            return design
        snug = replace(design, waistband=replace(design.waistband, waist=1.0))
        widest = min(max(size.waist, size.hips) / top_girth(size, snug) for size in self.sizes)
        return replace(design, waistband=self.redrawn_within("waistband", design.waistband, waist=(1.0, widest)))

    def with_upper(self, design: OutfitDesign) -> OutfitDesign:
        """With the sections of its upper: the first of ``UPPER_TRIES`` draws that can be sewn, or the last."""
        assert design.meta.upper is not None
        garment = design.meta.upper.garment
        return self._with_shirt(design, garment) if isinstance(garment, Shirt) else self._with_other(design, garment)

    def _with_other(self, design: OutfitDesign, garment: UpperGarment[Any]) -> OutfitDesign:
        for _ in range(UPPER_TRIES):
            design = replace(design, **{garment.field: self.draw_section(garment.field)})
            if all(upper_is_sewable(size, design) for size in self.sizes):
                break
        return design

    def _with_shirt(self, design: OutfitDesign, garment: Shirt) -> OutfitDesign:
        """With the sections of a shirt: body, left half, neckline and sleeves."""
        for _ in range(UPPER_TRIES):
            trial = replace(
                design, shirt=self._shirt(design, garment), sleeve=self.draw_section("sleeve"), left=self._left()
            )
            if self._has_tight_sleeves(trial):
                continue
            for _ in range(NECKLINE_TRIES):
                trial = replace(trial, collar=self.draw_section("collar"))
                if self._is_whole(trial, trial.right_half()):
                    break
            else:
                continue
            if (whole := self._with_left_neckline(trial)) is not None:
                return whole
        return trial

    def _with_left_neckline(self, design: OutfitDesign) -> OutfitDesign | None:
        """With a left neckline that can be sewn, if the left half differs; ``None`` if none was found."""
        for _ in range(NECKLINE_TRIES):
            half = design.left_half()
            if half is None or self._is_whole(design, half):
                return design
            collar = draw(self.sections["left"].of(LeftNecklineDesign), self.rng)
            design = replace(design, left=replace(design.left, collar=collar))
        return None

    def _has_tight_sleeves(self, design: OutfitDesign) -> bool:
        return any(sleeve_is_tight(size, design, half) for half in design.halves() for size in self.sizes)

    def _is_whole(self, design: OutfitDesign, half: UpperHalf) -> bool:
        return all(half_is_sewable(size, design, half) for size in self.sizes)

    def with_bottom(self, design: OutfitDesign) -> OutfitDesign:
        """With the sections of its bottom: the first of ``BOTTOM_TRIES`` draws that can be sewn and worn, or the last.

        Its length and width are limited by the floor and by the waistband.
        """
        for _ in range(BOTTOM_TRIES):
            trial = self._without_heavy_flare(
                self._shortened_to_floor(self._with_snug_band(self._with_bottom_drawn(design)))
            )
            if any(has_tight_cuffs(size, trial) for size in self.sizes):
                continue
            if _is_plain(trial) or all(bottom_is_sewable(size, trial) for size in self.sizes):
                break
        return trial

    def _with_bottom_drawn(self, design: OutfitDesign) -> OutfitDesign:
        assert design.meta.bottom is not None
        garment = design.meta.bottom.garment
        design = replace(design, **{garment.field: self.draw_section(garment.field)})
        for section in dict.fromkeys(part.field for part in garment.parts(design)):
            design = replace(design, **{section: self.draw_section(section)})
        return design

    def _shirt(self, design: OutfitDesign, garment: Shirt) -> ShirtDesign:
        shirt: ShirtDesign = self.draw_section("shirt")
        joined = not garment.at_waist and (design.meta.wb or design.meta.bottom)  # a part is sewn to the hem
        longest = min(room_to_floor(size, design) / size.waist_line for size in self.sizes)
        limits = JOINED_SHIRT if joined else (-np.inf, longest)
        in_limits: ShirtDesign = self.redrawn_within("shirt", shirt, length=limits)
        return in_limits

    def _left(self) -> LeftDesign:
        left: LeftDesign = self.draw_section("left")
        return left if left.enable_asym else LeftDesign()

    def _shortened_to_floor(self, design: OutfitDesign) -> OutfitDesign:
        """With the bottom short enough to end above the floor; lengths are fractions of hips to floor."""
        section = _length_section(design)
        drawn: Any = getattr(design, section)
        excess = max((garment_length(s, design) - room_to_floor(s, design)) / s.leg_length for s in self.sizes)
        if excess <= 0:
            return design
        return replace(
            design, **{section: self.redrawn_within(section, drawn, length=(-np.inf, drawn.length - excess))}
        )

    def _with_snug_band(self, design: OutfitDesign) -> OutfitDesign:
        """With a snug band for a gathered bottom without an upper; without gathers if the overlay allows no band."""
        if design.meta.upper or not is_gathered(design) or has_snug_band(design):
            return design
        bands = choice_of(self.sections["meta"], "wb")
        if all(option is None for option in bands.weighted_options):
            return self._with_top_within(design, "gather_parameter", (1.0, 1.0))
        meta = replace(design.meta, wb=design.meta.wb or _only(bands, True).draw(self.rng))
        band = self.redrawn_within("waistband", self.draw_section("waistband"), waist=(1.0, 1.0))
        return replace(design, meta=meta, waistband=band)

    def _without_heavy_flare(self, design: OutfitDesign) -> OutfitDesign:
        """With a shorter and narrower bottom, if it is flared, without an upper and without a firm band."""
        if design.meta.upper:
            return design
        if is_flared(design) and not has_firm_band(design):
            section, limits = _length_section(design), {"length": (-np.inf, LIGHT_LENGTH)}
            design = replace(design, **{section: self.redrawn_within(section, getattr(design, section), **limits)})
            design = self._with_top_within(design, "fullness_parameter", (-np.inf, LIGHT_SUNS))
        return design

    def _with_top_within(
        self, design: OutfitDesign, role: Literal["gather_parameter", "fullness_parameter"], limits: tuple[float, float]
    ) -> OutfitDesign:
        """With the parameter for the gathers or the width of the bottom's top redrawn within limits."""
        top = top_of_bottom(design)
        name = "" if top is None else getattr(top, role)
        if top is None or not name:
            return design
        return replace(
            design, **{top.field: self.redrawn_within(top.field, top.section_design(design), **{name: limits})}
        )


@cache
def _sections(overlay: Overlay) -> Mapping[str, DesignSpace[Any]]:
    """The space of each section of a design, by its field."""
    return {entry.name: entry.space for entry in overlay.space.entries if isinstance(entry.space, DesignSpace)}


@cache
def _neutral() -> Measurements:
    return measure(build_body(neutral_shape()))


def _leaf(section: DesignSpace[Any], name: str) -> Space:
    """The space of one parameter, by name."""
    return next(entry.space for entry in section.entries if entry.name == name and isinstance(entry.space, Space))


def _only(space: Choice, present: bool) -> Choice:
    """The choice without ``None`` (``present``), or of ``None`` alone."""
    options = [option for option in space.range if (option is not None) == present]
    return space.narrowed([space.read(option) for option in options])


def _is_plain(design: OutfitDesign) -> bool:
    """Whether the bottom needs no sewability check: see ``BottomGarment.always_sewable``."""
    assert design.meta.bottom is not None
    garment = design.meta.bottom.garment
    return garment.always_sewable(garment.section_design(design))


def _length_section(design: OutfitDesign) -> str:
    """The field of the section with the bottom's ``length``."""
    assert design.meta.bottom is not None
    return design.meta.bottom.garment.length_garment(design).field
