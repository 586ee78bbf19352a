"""Patterns that cannot be worn are turned down with the figures."""

from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.garments import check_outfit, design_from_dict, outfit, sample_design
from gcd_dataset.generator.garments.sampling import draw_neckline
from gcd_dataset.generator.garments.shirt import ShirtDesign
from gcd_dataset.records import Measurements

SKIRT = {"upper": None, "bottom": "SkirtCircle"}


def reasons(size: Measurements, values: dict[str, Any]) -> list[str]:
    design = design_from_dict(values)
    return [reject.rule for reject in check_outfit(size, design, outfit(size, design))]


def test_a_plain_shirt_can_be_worn(woman: Measurements) -> None:
    assert reasons(woman, {}) == []


def test_a_dress_down_to_the_floor(woman: Measurements) -> None:
    meta = {"upper": "Shirt", "bottom": "SkirtCircle"}
    assert reasons(woman, {"meta": meta, "shirt": {"length": 2.0}, "flare-skirt": {"length": 0.9}}) == ["reaches_floor"]
    assert reasons(woman, {"meta": meta, "shirt": {"length": 1.0}, "flare-skirt": {"length": 0.9}}) == []


def test_a_skirt_wider_than_the_trunk_slides(woman: Measurements) -> None:
    meta = SKIRT | {"wb": "StraightWB"}
    assert "slides_off" in reasons(woman, {"meta": meta, "waistband": {"waist": 1.6}})
    assert "slides_off" not in reasons(woman, {"meta": meta, "waistband": {"waist": 1.1}})


@pytest.mark.parametrize("heavy", [{"length": 0.7}, {"suns": 1.5}])
def test_a_heavy_skirt_needs_a_firm_band(woman: Measurements, heavy: dict[str, float]) -> None:
    assert reasons(woman, {"meta": SKIRT, "flare-skirt": heavy}) == ["too_heavy"]
    firm = {"meta": SKIRT | {"wb": "StraightWB"}, "waistband": {"width": 0.3}, "flare-skirt": heavy}
    assert reasons(woman, firm) == []


def test_a_deep_round_neckline_runs_into_the_armhole(woman: Measurements) -> None:
    assert "unsewable" in reasons(woman, {"collar": {"width": 0.6, "fc_depth": 1.8}, "shirt": {"length": 2.0}})


def test_an_edge_too_short_to_sew(woman: Measurements) -> None:
    # A skirt of 5.9 cm with a cut 0.3 cm wide and as deep: legs of √(0.15² + 0.3²) cm.
    cut = {"add": True, "depth": 0.05, "width": 0.05}
    design = design_from_dict({"meta": SKIRT, "flare-skirt": {"length": -0.2, "cut": cut}})
    (reject,) = check_outfit(woman, design, outfit(woman, design))
    assert str(reject).startswith("unsewable: panel skirt_back, edge 3: warning: edge under 0.5 cm: it is 0.3")


def test_a_shirt_with_a_band_or_a_skirt_ends_near_the_waist() -> None:
    # What holds a band up is the waist: sewn to a longer shirt it would drag the hem up with it.
    for seed in range(100):
        design = sample_design(np.random.default_rng(seed))
        if design.meta.upper and (design.meta.wb or design.meta.bottom):
            assert 0.8 <= design.shirt.length <= 1.3


@pytest.mark.parametrize("shirt", [ShirtDesign(0.5, 1.3, 1.6), ShirtDesign(3.5, 1.0, 0.7), ShirtDesign()])
def test_a_neckline_is_found_for_any_shirt(shirt: ShirtDesign) -> None:
    for seed in range(50):
        assert draw_neckline(np.random.default_rng(seed), shirt).fc_depth >= 0.3


def test_outfits_come_in_three_kinds_alike() -> None:
    drawn = [sample_design(np.random.default_rng(seed)).meta for seed in range(600)]
    kinds = [(meta.upper is not None, meta.bottom is not None) for meta in drawn]
    shares = [kinds.count(kind) / 600 for kind in ((True, False), (False, True), (True, True))]
    assert shares == pytest.approx([1 / 3] * 3, abs=0.06)
