"""Random designs can be worn and follow GarmentCode's rule; redraws change what their rule names, and are counted."""

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.garments import (
    GarmentDesign,
    Kind,
    Redraw,
    Reject,
    attempted_design,
    drafted_design,
    sample_design,
    sample_kind,
    try_on,
)
from gcd_dataset.generator.garments.design import kind_of
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.rules import DrawnGarment, check_design, garment_length, room_to_floor
from gcd_dataset.generator.garments.sewable import SewingFault
from gcd_dataset.generator.garments.space import leaves, to_dict, value_at
from gcd_dataset.generator.garments.wardrobe import Upper
from gcd_dataset.generator.garments.wearable import TRIES, Redrawing, Remedy
from gcd_dataset.records import Measurements, Pattern
from gcd_dataset.seeding import Stage, rng

COUNT = 60


@cache
def wearers() -> tuple[Measurements, ...]:
    return tuple(measure(build_body(draw_shape(rng(1, number, Stage.BODY)))) for number in range(8))


@cache
def designs() -> tuple[GarmentDesign, ...]:
    return tuple(sample_design(rng(1, n, Stage.DESIGN), [wearers()[n % 8]]) for n in range(COUNT))


def test_hardly_any_design_is_rejected() -> None:
    found = [try_on(wearers()[number % 8], design) for number, design in enumerate(designs())]
    assert sum(isinstance(pattern, Reject) for pattern in found) <= 0.06 * COUNT


def test_choices_and_free_parameters_have_their_shares() -> None:
    """Kinds are equally likely; a fifth of uppers have halves that differ."""
    kinds = Counter(sample_kind(rng(0, number, Stage.KIND)) for number in range(450))
    assert [kinds[kind] / 450 for kind in Kind] == pytest.approx([1 / 3] * 3, abs=0.07)
    metas = [design.meta for design in designs()]
    assert len({meta.upper for meta in metas} | {meta.bottom for meta in metas} | {meta.wb for meta in metas}) == 13
    uppers = [design for design in designs() if design.meta.upper]
    assert np.mean([design.left.enable_asym for design in uppers]) == pytest.approx(0.2, abs=0.15)
    # ``sleeve_angle`` is uniform; ``smoothing_coeff`` keeps its default with probability 0.8.
    sleeves = [design.sleeve for design in uppers]
    assert np.mean([sleeve.sleeve_angle for sleeve in sleeves]) == pytest.approx(30, abs=5)
    assert np.mean([sleeve.smoothing_coeff == 0.25 for sleeve in sleeves]) == pytest.approx(0.8, abs=0.15)


@pytest.mark.parametrize("kind", Kind)
def test_a_kind_has_its_parts(kind: Kind) -> None:
    for seed in range(6):
        meta = sample_design(np.random.default_rng(seed), kind=kind).meta
        assert (meta.upper is None, meta.bottom is None) == (kind is Kind.LOWER, kind is Kind.UPPER)


def test_unused_sections_keep_their_defaults() -> None:
    plain = to_dict(GarmentDesign())
    for design in designs():
        values, used = to_dict(design), design.sections_used()
        unused = [section for section in plain if section.replace("-", "_") not in used]
        assert all(values[section] == plain[section] for section in unused)


def test_no_hem_reaches_the_floor_and_shirts_with_a_band_or_a_bottom_end_near_the_waist() -> None:
    """A band sits at the waist; sewn to a longer shirt it would pull the hem up."""
    for number, design in enumerate(designs()):
        size = wearers()[number % 8]
        assert garment_length(size, design) <= room_to_floor(size, design) + 1e-6
        if design.meta.upper is Upper.SHIRT and (design.meta.wb or design.meta.bottom):
            assert 0.8 <= design.shirt.length <= 1.3


def test_designs_stay_within_an_overlay() -> None:
    hoodies = Overlay.from_dict(
        {
            "meta": {"upper": {"options": ["Shirt"]}, "bottom": "none"},
            "collar": {"component": {"style": "Hood2Panels"}},
            "left": {"enable_asym": False},
            "sleeve": {"length": {"range": [0.8, 1.1]}},
        }
    )
    assert {sample_kind(rng(0, number, Stage.KIND), hoodies) for number in range(20)} == {Kind.UPPER}
    for seed in range(5):
        design = sample_design(np.random.default_rng(seed), overlay=hoodies)
        assert to_dict(design)["collar"]["component"]["style"] == "Hood2Panels"
        assert 0.8 <= design.sleeve.length <= 1.1


def test_a_sleeve_that_ends_narrower_than_the_arm_is_widened_and_else_unchanged() -> None:
    """Of sleeves to the elbow that taper to half their width or less, the end alone is drawn again."""
    tapered = Overlay.from_dict(
        {
            "meta": {"upper": {"options": ["Shirt"]}, "bottom": "none"},
            "left": {"enable_asym": False},
            "sleeve": {
                "sleeveless": False,
                "length": {"range": [0.2, 0.4]},
                "connecting_width": 0.2,
                "connect_ruffle": 1.0,
                "end_width": {"range": [0.2, 1.2], "keep": 0.0},
                "cuff": {"type": "none"},
            },
        }
    )
    widened = 0
    for number in range(8):
        sizes, draft = (wearers()[number % 8],), drafted_design(5, number, 0, tapered).sleeve
        drawn = attempted_design(5, number, 0, sizes, tapered)
        sleeve = drawn.design.sleeve
        assert not any(reject.rule == "tight_cuff" for reject in check_design(DrawnGarment.of(*sizes, drawn.design)))
        assert replace(sleeve, end_width=draft.end_width) == draft
        assert sleeve.end_width >= draft.end_width
        widened += drawn.redraws.get(Redraw("tight_cuff", "sleeve.end_width"), 0) > 0
        assert (sleeve == draft) == (Redraw("tight_cuff", "sleeve.end_width") not in drawn.redraws)
    assert 2 <= widened < 8


@pytest.mark.parametrize(("hips", "with_band"), [(6.0, True), (1.0, False)])
def test_a_skirt_alone_needs_hips_wider_than_the_waist(hips: float, with_band: bool) -> None:
    """With little difference skirts get a band, with hardly any they become trousers; uppers are not concerned."""
    size = measure(build_body(neutral_shape()))
    straight = replace(size, waist=size.hips - hips)
    held = 0
    for number in range(20):
        drawn = attempted_design(5, number, 0, (straight,))
        meta, before = drawn.design.meta, attempted_design(5, number, 0, (size,)).design.meta
        if meta.upper or before.bottom is None:
            assert "nothing_holds" not in drawn.by_rule()
            continue
        assert meta.bottom is not None
        assert meta.bottom.garment.legs or (with_band and meta.wb)
        held += drawn.by_rule()["nothing_holds"]
    assert held > 2


SHORT, NARROW = Remedy(("sleeve.length",)), Remedy(("shirt.width",))
SPACE = NO_OVERLAY.space


@pytest.fixture
def redrawing() -> Redrawing:
    return Redrawing(np.random.default_rng(0), SPACE)


def failing(times: int) -> Callable[[GarmentDesign], SewingFault | None]:
    """A rule that the first ``times`` designs break."""
    faults = iter([SewingFault("too_long", "sleeve")] * times)
    return lambda _: next(faults, None)


def test_a_rule_that_fails_once_costs_one_redraw(redrawing: Redrawing) -> None:
    design = redrawing.repaired(GarmentDesign(), failing(1), lambda _: (SHORT, NARROW))
    assert redrawing.counts == {Redraw("too_long", "sleeve.length"): 1}
    assert design.sleeve.length != GarmentDesign().sleeve.length
    assert design.shirt.width == GarmentDesign().shirt.width


def test_a_sound_design_costs_nothing_and_a_rule_that_never_holds_all_tries(redrawing: Redrawing) -> None:
    """Both leave the design."""
    assert redrawing.repaired(GarmentDesign(), failing(0), lambda _: (SHORT,)) == GarmentDesign()
    assert not redrawing.counts
    design = redrawing.repaired(GarmentDesign(), failing(99), lambda _: (SHORT, NARROW))
    assert redrawing.counts == {Redraw("too_long", path): TRIES for path in ("sleeve.length", "shirt.width")}
    assert design == GarmentDesign()


def test_a_remedy_draws_below_the_value_at_fault(redrawing: Redrawing) -> None:
    remedy = Remedy(("shirt.length",), low=True)
    lengths = [design.shirt.length for design in redrawing.tried(GarmentDesign(), "too_long", remedy)]
    assert sorted(lengths, reverse=True) == lengths
    assert all(length < GarmentDesign().shirt.length for length in lengths)
    assert len(lengths) == TRIES  # a default at fault is not kept


def test_a_value_within_its_limits_is_not_drawn_again(redrawing: Redrawing) -> None:
    assert redrawing.within(GarmentDesign(), "too_long", "shirt.length", 0.5, 1.2) == GarmentDesign()
    shorter = redrawing.within(GarmentDesign(), "too_long", "shirt.length", 0.5, 1.0)
    assert 0.5 <= shorter.shirt.length <= 1.0
    assert redrawing.counts == {Redraw("too_long", "shirt.length"): 1}


def test_a_section_drawn_again_keeps_its_garments(redrawing: Redrawing) -> None:
    for _ in range(20):
        skirt = redrawing.again(GarmentDesign(), "unsewable", "levels-skirt").levels_skirt
        assert (skirt.base, skirt.level) == (GarmentDesign().levels_skirt.base, GarmentDesign().levels_skirt.level)


@pytest.mark.parametrize("number", range(8))
def test_only_counted_parameters_differ_from_the_draft(woman: Measurements, number: int) -> None:
    drawn, draft = attempted_design(3, number, 0, [woman]), drafted_design(3, number, 0)
    paths = [redraw.path for redraw in drawn.redraws]
    changed = [
        leaf.path
        for leaf in leaves(SPACE)
        if value_at(SPACE, draft, leaf.path) != value_at(SPACE, drawn.design, leaf.path)
    ]
    assert all(any(f"{path}.".startswith(f"{drew}.") for drew in paths) for path in changed)
    assert drawn.by_rule().total() == sum(drawn.redraws.values())


def test_four_more_attempts_keep_the_draft_and_the_next_gives_up_its_choices() -> None:
    drafts = [[drafted_design(3, number, attempt) for attempt in range(6)] for number in range(12)]
    assert all(draft == first for first, *others, _ in drafts for draft in others)
    assert any(first.meta != last.meta for first, *_, last in drafts)
    assert all(kind_of(first.meta) == kind_of(last.meta) for first, *_, last in drafts)


def test_after_twenty_attempts_uppers_and_bottoms_take_turns() -> None:
    """Kinds that the twenty attempts did not draw come first, so every possible kind is tried."""
    drafts = [[drafted_design(3, number, attempt).meta for attempt in range(0, 100, 5)] for number in range(9)]
    possible = defaultdict[tuple[str, Kind], set[Any]](set)
    for metas in drafts:
        for part in ("upper", "bottom"):
            possible[part, kind_of(metas[0])] |= {getattr(meta, part) for meta in metas}
    renewed = 0
    for metas in drafts:
        assert {kind_of(meta) for meta in metas} == {kind_of(metas[0])}
        for part in ("upper", "bottom"):
            options, seen = possible[part, kind_of(metas[0])], [getattr(meta, part) for meta in metas]
            untried = options - set(seen[:4])
            assert set(seen[4 : 4 + len(untried)]) == untried
            assert set(seen[4 : 4 + len(options)]) == set(seen[-len(options) :]) == options
            renewed += bool(untried)
    assert renewed >= 4


def test_an_attempt_has_other_numbers_and_the_same_bottom(woman: Measurements) -> None:
    skirts = Overlay.from_dict({"meta": {"upper": "none"}})
    for number in range(6):
        first, second = (attempted_design(3, number, attempt, [woman], skirts).design for attempt in (0, 1))
        assert first.meta.bottom is second.meta.bottom
        bottom = first.meta.bottom
        assert bottom is not None
        assert bottom.garment.section_design(first) != bottom.garment.section_design(second)
        for leaf in leaves(SPACE):
            if isinstance(leaf.space, Choice) and leaf.path.startswith(f"{bottom.garment.section}."):
                drafts = (drafted_design(3, number, attempt, skirts) for attempt in (0, 1))
                assert len({value_at(SPACE, draft, leaf.path) for draft in drafts}) == 1


def test_first_attempts_have_the_declared_shares_and_nearly_all_can_be_worn(woman: Measurements) -> None:
    """No rule redraws ``sleeveless``, ``enable_asym``, upper or bottom: each design has those of its draft."""
    worn = 0
    for number in range(30):
        draft, design = drafted_design(5, number, 0), attempted_design(5, number, 0, [woman]).design
        assert (draft.sleeve.sleeveless, draft.left.enable_asym) == (design.sleeve.sleeveless, design.left.enable_asym)
        assert (draft.meta.upper, draft.meta.bottom) == (design.meta.upper, design.meta.bottom)
        worn += isinstance(try_on(woman, design), Pattern)
    assert worn >= 29
