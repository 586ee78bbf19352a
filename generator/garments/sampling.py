"""Random designs: each parameter by GarmentCode's rule, within limits that keep the garment wearable.

Each parameter keeps its default with its ``keep`` probability, and is uniform over its range otherwise: the draft. A
value outside the limits set by the rest of the design and by the wearers' measures is drawn again within them
(``wearable.py``); ``rules.py`` rejects remaining faults. Unlike GarmentCode's sampler, this one

- draws the kind of garment first: upper, lower or full-body, with equal probability (GarmentCode redraws a rejected
  design completely, which favours kinds that are rarely rejected);
- leaves sections that the garment does not use at their defaults;
- shortens a bottom that would reach the floor, and ends a shirt near the waist if a band or bottom is sewn to it;
- fits a bottom without upper to the trunk, puts a gathered one on a snug band, and limits flares without a firm band;
- puts a skirt alone on a band, or draws trousers, for a wearer whose hips are hardly wider than the waist;
- shortens a shirt, or lowers a waistband, if a part is too tight for the hips, widens a tapered hem, and narrows a
  neckline that leaves too little shoulder;
- takes cloth off a bottom that is too heavy for shoulder seams or hips;
- redraws the parameter at fault, such as the depth of a neckline or of a godet, until the panels can be sewn and legs
  and arms fit through their cuffs; all other parameters stay;
- counts each redraw with its rule.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments.design import (
    HAS_UPPER_AND_BOTTOM,
    GarmentDesign,
    Kind,
    LeftDesign,
    MetaDesign,
    choice_of,
    possible_kinds,
    upper_choice,
)
from gcd_dataset.generator.garments.front import FrontDesign
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.pocket import PocketDesign
from gcd_dataset.generator.garments.space import DesignSpace, draw, with_new_numbers
from gcd_dataset.generator.garments.trim import TrimDesign
from gcd_dataset.generator.garments.wearable import DrawnDesign, Redraw, wearable
from gcd_dataset.records import Closure, Measurements
from gcd_dataset.seeding import Stage
from gcd_dataset.seeding import rng as stream

# Drapes of 1,200 garments at 1 cm: of the skirts alone with less, 7 of 19 and 5 of 15 slid off; with more, 1 of 143 and
# 1 of 213.
HIPS_UNDER_SKIRT = 10.0  # cm, least difference of hips and waist that holds a skirt without a band
HIPS_UNDER_BAND = 4.0  # cm, the same with a band
SAME_CHOICES = 5  # attempts with the same choices; then others are drawn, since these may suit no wearer
TRIED = 20  # attempts whose choices are random; later ones take every upper and bottom in turn, the new ones first


def sample_kind(rng: np.random.Generator, overlay: Overlay = NO_OVERLAY) -> Kind:
    """One of the kinds of garment that the overlay allows, with equal probability."""
    kinds = possible_kinds(_sections(overlay)["meta"])
    return kinds[int(rng.integers(len(kinds)))]


def sample_draft(
    rng: np.random.Generator,
    *,
    kind: Kind | None = None,
    overlay: Overlay = NO_OVERLAY,
    narrow: Callable[[Choice], Choice] | None = None,
) -> GarmentDesign:
    """A random garment by the declared distributions alone, which may be impossible to sew or wear.

    ``narrow``: maps the uppers and the bottoms to those that are drawn from.
    """
    design = GarmentDesign(meta=_meta(rng, kind or sample_kind(rng, overlay), _sections(overlay)["meta"], narrow))
    design = _with_sections(design, _own_sections(design, overlay), rng, overlay)
    bottom = design.meta.bottom.garment if design.meta.bottom else None
    parts = {part.field for part in bottom.parts(design)} if bottom else set()
    design = _with_sections(design, parts, rng, overlay)
    if design.front.closure is Closure.SEWN:
        design = replace(design, front=FrontDesign())
    if not design.pockets():
        design = replace(design, pocket=PocketDesign())
    if "trim" not in design.sections_used():
        design = replace(design, trim=TrimDesign())
    return design if design.left.enable_asym else replace(design, left=LeftDesign())


def sample_design(
    rng: np.random.Generator,
    wearers: Iterable[Measurements] = (),
    *,
    kind: Kind | None = None,
    overlay: Overlay = NO_OVERLAY,
) -> GarmentDesign:
    """A random garment that all ``wearers`` (by default the neutral body) can most likely wear."""
    sizes = tuple(wearers) or (_neutral(),)
    draft, _ = _held_up(sample_draft(rng, kind=kind, overlay=overlay), sizes, rng, overlay)
    return wearable(draft, sizes, rng, overlay.space).design


def drafted_design(seed: int, number: int, attempt: int, overlay: Overlay = NO_OVERLAY) -> GarmentDesign:
    """The draft of design ``number`` of a seed: the same kind in all attempts, the same choices in most.

    After ``TRIED`` attempts the uppers and bottoms take turns: random ones may all be of a kind that the wearer cannot
    wear, such as fitted shirts. One of 33,600 samples needed this.
    """
    kind = sample_kind(stream(seed, number, Stage.KIND), overlay)
    group, random_groups = attempt // SAME_CHOICES, TRIED // SAME_CHOICES
    rng = stream(seed, number, Stage.DRAFT, group)
    if group < random_groups:
        return sample_draft(rng, kind=kind, overlay=overlay)
    earlier = [drafted_design(seed, number, before, overlay).meta for before in range(0, TRIED, SAME_CHOICES)]
    tried = {option for meta in earlier for option in (meta.upper, meta.bottom)}

    def narrow(choice: Choice) -> Choice:
        options = list(dict.fromkeys(choice.weighted_options))
        stream(seed, number, Stage.DRAFT, random_groups).shuffle(options)
        options.sort(key=lambda option: option in tried)
        return choice.narrowed([options[(group - random_groups) % len(options)]])

    return sample_draft(rng, kind=kind, overlay=overlay, narrow=narrow)


def attempted_design(
    seed: int, number: int, attempt: int, wearers: Iterable[Measurements], overlay: Overlay = NO_OVERLAY
) -> DrawnDesign:
    """Design ``number`` of a seed in its ``attempt``, counted from 0, with its redraws.

    All attempts have the same kind; ``SAME_CHOICES`` attempts have the same choices, such as upper and bottom, and
    different numbers. Otherwise designs that are often rejected would become rare. From attempt ``TRIED`` on, the
    uppers and bottoms take turns.
    """
    draft, rng = drafted_design(seed, number, attempt, overlay), stream(seed, number, Stage.DESIGN, attempt)
    if attempt % SAME_CHOICES:
        spaces = {name: space for name, space in _sections(overlay).items() if name in draft.sections_used()}
        redrawn = {name: with_new_numbers(space, getattr(draft, name), rng) for name, space in spaces.items()}
        draft = replace(draft, **redrawn)
    sizes = tuple(wearers)
    draft, redraws = _held_up(draft, sizes, rng, overlay)
    drawn = wearable(draft, sizes, rng, overlay.space)
    return drawn if not redraws else replace(drawn, redraws={**redraws, **drawn.redraws})


def _meta(
    rng: np.random.Generator, kind: Kind, space: DesignSpace[MetaDesign], narrow: Callable[[Choice], Choice] | None
) -> MetaDesign:
    """A random upper, band and bottom."""
    _, has_bottom = HAS_UPPER_AND_BOTTOM[kind]
    uppers, bottoms = upper_choice(space, kind), choice_of(space, "bottom").only(present=has_bottom)
    if narrow is not None:
        uppers, bottoms = narrow(uppers), narrow(bottoms)
    upper, bottom = uppers.draw(rng), bottoms.draw(rng)
    bands = choice_of(space, "wb")
    bands = bands if upper is None or upper.garment.carries else bands.only(present=False)
    return MetaDesign(upper, bands.draw(rng), bottom)


def _held_up(
    draft: GarmentDesign, wearers: Sequence[Measurements], rng: np.random.Generator, overlay: Overlay
) -> tuple[GarmentDesign, dict[Redraw, int]]:
    """The draft with a skirt that would slide off a wearer put on a band or replaced by trousers, and the redraws.

    A skirt alone is held up by the hips below its top, trousers by the crotch.
    """
    meta, space = draft.meta, _sections(overlay)["meta"]
    if meta.upper or not meta.bottom or meta.bottom.garment.legs:
        return draft, {}
    hips = min((size.hips - size.waist for size in wearers), default=np.inf)
    if hips >= (HIPS_UNDER_BAND if meta.wb else HIPS_UNDER_SKIRT):
        return draft, {}
    bands, bottoms = choice_of(space, "wb"), choice_of(space, "bottom")
    if hips >= HIPS_UNDER_BAND and any(bands.options):
        banded = replace(draft, meta=replace(meta, wb=bands.only(present=True).draw(rng)))
        return _with_sections(banded, {"waistband"}, rng, overlay), {Redraw("nothing_holds", "meta.wb"): 1}
    trousers = [bottom for bottom in bottoms.options if bottom and bottom.garment.legs]
    if not trousers:
        return draft, {}
    replaced = replace(draft, meta=replace(meta, bottom=bottoms.narrowed(trousers).draw(rng)))
    replaced = _with_sections(replaced, _own_sections(replaced, overlay) - {"waistband"}, rng, overlay)
    default, unused = GarmentDesign(), draft.sections_used() - replaced.sections_used()
    replaced = replace(replaced, **{name: getattr(default, name) for name in unused})
    return replaced, {Redraw("nothing_holds", "meta.bottom"): 1}


def _own_sections(design: GarmentDesign, overlay: Overlay) -> set[str]:
    """The fields of the garments of a design, except the parts of a combined bottom.

    The front of a shirt is one of them if the overlay allows a closure, and so are pockets and trim: other data sets
    keep their random numbers.
    """
    meta = design.meta
    sections = {"waistband"} if meta.wb else set()
    if meta.upper:
        sections.update(meta.upper.garment.sections_used(design))
    if design.halves():
        sections.add("left")
        if set(choice_of(_sections(overlay)["front"], "closure").weighted_options) != {Closure.SEWN}:
            sections.add("front")
    for section, names in (("pocket", ("chest", "back")), ("trim", ("tucks", "buttonholes"))):
        spaces = (choice_of(_sections(overlay)[section], name) for name in names)
        if any(set(space.weighted_options) != {None} for space in spaces):
            sections.add(section)
    return sections | ({meta.bottom.garment.field} if meta.bottom else set())


def _with_sections(
    design: GarmentDesign, names: Collection[str], rng: np.random.Generator, overlay: Overlay
) -> GarmentDesign:
    """The design with some of its sections drawn, in the order of the fields."""
    return replace(design, **{name: draw(space, rng) for name, space in _sections(overlay).items() if name in names})


@cache
def _sections(overlay: Overlay) -> Mapping[str, DesignSpace[Any]]:
    """The space of each section of a design, by its field."""
    return {entry.name: entry.space for entry in overlay.space.entries if isinstance(entry.space, DesignSpace)}


@cache
def _neutral() -> Measurements:
    return measure(build_body(neutral_shape()))
