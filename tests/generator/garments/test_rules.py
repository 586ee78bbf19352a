"""Patterns that cannot be worn are turned down with the figures."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.garments import check_outfit, design_from_dict, outfit, sample_design
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
    design = design_from_dict({"sleeve": {"sleeveless": True}, "collar": {"width": 1.0, "f_collar": "VNeckHalf"}})
    narrow = replace(woman, neck_w=10.0, shoulder_w=14.5, bust=60.0, back_width=30.0)
    pattern = outfit(narrow, design)
    texts = [str(reject) for reject in check_outfit(narrow, design, pattern) if reject.rule == "short_edge"]
    assert texts == [] or texts[0].startswith("short_edge: edge ")


def test_outfits_come_in_three_kinds_alike() -> None:
    drawn = [sample_design(np.random.default_rng(seed)).meta for seed in range(600)]
    kinds = [(meta.upper is not None, meta.bottom is not None) for meta in drawn]
    shares = [kinds.count(kind) / 600 for kind in ((True, False), (False, True), (True, True))]
    assert shares == pytest.approx([1 / 3] * 3, abs=0.06)
