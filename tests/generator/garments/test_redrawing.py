"""A redraw changes the parameters named by its rule and no others, and is counted."""

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.garments import GarmentDesign, Redraw, attempted_design, drafted_design, try_on
from gcd_dataset.generator.garments.design import Kind, kind_of
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.sewable import SewingFault
from gcd_dataset.generator.garments.space import leaves, value_at
from gcd_dataset.generator.garments.wearable import TRIES, Redrawing, Remedy
from gcd_dataset.records import Measurements, Pattern

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


def test_a_rule_that_never_holds_costs_all_tries_and_leaves_the_design(redrawing: Redrawing) -> None:
    design = redrawing.repaired(GarmentDesign(), failing(99), lambda _: (SHORT, NARROW))
    assert redrawing.counts == {Redraw("too_long", path): TRIES for path in ("sleeve.length", "shirt.width")}
    assert design == GarmentDesign()


def test_a_sound_design_costs_nothing(redrawing: Redrawing) -> None:
    assert redrawing.repaired(GarmentDesign(), failing(0), lambda _: (SHORT,)) == GarmentDesign()
    assert not redrawing.counts


def test_a_remedy_draws_below_the_value_at_fault(redrawing: Redrawing) -> None:
    lengths = [
        design.shirt.length
        for design in redrawing.tried(GarmentDesign(), "too_long", Remedy(("shirt.length",), low=True))
    ]
    assert sorted(lengths, reverse=True) == lengths
    assert all(length < GarmentDesign().shirt.length for length in lengths)
    assert len(lengths) == TRIES  # a default at fault is not kept


def test_a_value_within_its_limits_is_not_drawn_again(redrawing: Redrawing) -> None:
    kept = redrawing.within(GarmentDesign(), "too_long", "shirt.length", 0.5, 1.2)
    assert kept == GarmentDesign()
    shorter = redrawing.within(GarmentDesign(), "too_long", "shirt.length", 0.5, 1.0)
    assert 0.5 <= shorter.shirt.length <= 1.0
    assert redrawing.counts == {Redraw("too_long", "shirt.length"): 1}


def test_a_section_drawn_again_keeps_its_garments(redrawing: Redrawing) -> None:
    for _ in range(20):
        skirt = redrawing.again(GarmentDesign(), "unsewable", "levels-skirt").levels_skirt
        assert (skirt.base, skirt.level) == (GarmentDesign().levels_skirt.base, GarmentDesign().levels_skirt.level)


# ------------------------------------------------------------------------------------------------------ whole designs


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


def test_the_next_attempts_keep_the_choices_of_the_draft() -> None:
    for number in range(8):
        drafts = [drafted_design(3, number, attempt) for attempt in range(5)]
        assert all(draft == drafts[0] for draft in drafts)


def test_a_hopeless_choice_is_given_up_after_five_attempts() -> None:
    drafts = [(drafted_design(3, number, 4).meta, drafted_design(3, number, 5).meta) for number in range(30)]
    assert any(before != after for before, after in drafts)
    for before, after in drafts:  # the kind stays
        assert (before.upper is None, before.bottom is None) == (after.upper is None, after.bottom is None)


def test_after_twenty_attempts_uppers_and_bottoms_take_turns() -> None:
    """First those that the attempts before did not have; so each of them comes, however chance has it."""
    drafts = [[drafted_design(3, number, attempt).meta for attempt in range(0, 100, 5)] for number in range(15)]
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
    assert renewed >= 8


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
    for number in range(60):
        draft, design = drafted_design(5, number, 0), attempted_design(5, number, 0, [woman]).design
        assert (draft.sleeve.sleeveless, draft.left.enable_asym) == (design.sleeve.sleeveless, design.left.enable_asym)
        assert (draft.meta.upper, draft.meta.bottom) == (design.meta.upper, design.meta.bottom)
        worn += isinstance(try_on(woman, design), Pattern)
    assert worn >= 59
