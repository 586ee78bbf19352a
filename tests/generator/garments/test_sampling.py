"""Random designs can be worn, and follow GarmentCode's rule: defaults are kept with a probability."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.garments import GarmentDesign, Kind, Reject, sample_design, sample_kind, try_on
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.garments.rules import DrawnGarment, check_design, garment_length, room_to_floor
from gcd_dataset.generator.garments.sampling import attempted_design, drafted_design
from gcd_dataset.generator.garments.space import to_dict
from gcd_dataset.generator.garments.wardrobe import Upper
from gcd_dataset.generator.garments.wearable import Redraw
from gcd_dataset.records import Measurements
from gcd_dataset.seeding import Stage, rng

COUNT = 120


@cache
def wearers() -> tuple[Measurements, ...]:
    return tuple(measure(build_body(draw_shape(rng(1, number, Stage.BODY)))) for number in range(8))


@cache
def designs() -> tuple[GarmentDesign, ...]:
    return tuple(sample_design(rng(1, n, Stage.DESIGN), [wearers()[n % 8]]) for n in range(COUNT))


def test_the_same_seed_gives_the_same_design() -> None:
    assert sample_design(rng(1, 7, Stage.DESIGN), [wearers()[7]]) == designs()[7]


def test_hardly_any_design_is_rejected() -> None:
    found = [try_on(wearers()[number % 8], design) for number, design in enumerate(designs())]
    assert sum(isinstance(pattern, Reject) for pattern in found) <= 0.06 * COUNT


def test_kinds_are_equally_likely() -> None:
    kinds = Counter(sample_kind(rng(0, number, Stage.KIND)) for number in range(900))
    assert [kinds[kind] / 900 for kind in Kind] == pytest.approx([1 / 3] * 3, abs=0.05)


@pytest.mark.parametrize("kind", Kind)
def test_a_kind_has_its_parts(kind: Kind) -> None:
    for seed in range(20):
        meta = sample_design(np.random.default_rng(seed), kind=kind).meta
        assert (meta.upper is not None, meta.bottom is not None) == {
            Kind.UPPER: (True, False),
            Kind.LOWER: (False, True),
            Kind.FULL: (True, True),
        }[kind]


def test_every_part_is_drawn() -> None:
    metas = [design.meta for design in designs()]
    assert len({meta.upper for meta in metas} | {meta.bottom for meta in metas} | {meta.wb for meta in metas}) == 13


def test_halves_differ_in_a_fifth_of_uppers() -> None:
    uppers = [design for design in designs() if design.meta.upper]
    assert np.mean([design.left.enable_asym for design in uppers]) == pytest.approx(0.2, abs=0.1)


def test_unused_sections_keep_their_defaults() -> None:
    plain = to_dict(GarmentDesign())
    for design in designs():
        values, used = to_dict(design), design.sections_used()
        unused = [section for section in plain if section.replace("-", "_") not in used]
        assert all(values[section] == plain[section] for section in unused)


def test_no_hem_reaches_the_floor() -> None:
    for number, design in enumerate(designs()):
        size = wearers()[number % 8]
        assert garment_length(size, design) <= room_to_floor(size, design) + 1e-6


def test_a_shirt_with_a_band_or_a_bottom_ends_near_the_waist() -> None:
    # A band sits at the waist; sewn to a longer shirt it would pull the hem up.
    for design in designs():
        if design.meta.upper is Upper.SHIRT and (design.meta.wb or design.meta.bottom):
            assert 0.8 <= design.shirt.length <= 1.3


def test_free_parameters_follow_their_rule() -> None:
    """``sleeve_angle`` is uniform; ``smoothing_coeff`` keeps its default with probability 0.8."""
    sleeves = [design.sleeve for design in designs() if design.meta.upper]
    assert np.mean([sleeve.sleeve_angle for sleeve in sleeves]) == pytest.approx(30, abs=3.5)
    assert np.mean([sleeve.smoothing_coeff == 0.25 for sleeve in sleeves]) == pytest.approx(0.8, abs=0.1)


def test_designs_stay_within_an_overlay() -> None:
    hoodies = Overlay.from_dict(
        {
            "meta": {"upper": {"options": ["Shirt"]}, "bottom": "none"},
            "collar": {"component": {"style": "Hood2Panels"}},
            "left": {"enable_asym": False},
            "sleeve": {"length": {"range": [0.8, 1.1]}},
        }
    )
    kinds = {sample_kind(rng(0, number, Stage.KIND), hoodies) for number in range(20)}
    assert kinds == {Kind.UPPER}
    for seed in range(10):
        design = sample_design(np.random.default_rng(seed), overlay=hoodies)
        values = to_dict(design)
        assert values["collar"]["component"]["style"] == "Hood2Panels"
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
    for number in range(40):
        drawn = attempted_design(5, number, 0, (straight,))
        meta, before = drawn.design.meta, attempted_design(5, number, 0, (size,)).design.meta
        if meta.upper or before.bottom is None:
            assert "nothing_holds" not in drawn.by_rule()
            continue
        assert meta.bottom is not None
        assert meta.bottom.garment.legs or (with_band and meta.wb)
        held += drawn.by_rule()["nothing_holds"]
    assert held > 5
