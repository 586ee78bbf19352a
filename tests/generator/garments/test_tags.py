"""The tags of an outfit are the tailor's names for its style."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.garments import TAGS, design_from_dict, outfit, outfit_tags, sample_design
from gcd_dataset.generator.garments.style import hem_depth
from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.records import Measurements

SKIRT, SHIRT = {"upper": None, "bottom": "SkirtCircle"}, {"upper": "Shirt", "bottom": None}


def tags(size: Measurements, **values: Any) -> set[str]:
    return set(outfit_tags(size, design_from_dict({name.replace("_", "-"): part for name, part in values.items()})))


@pytest.mark.parametrize(("suns", "tag"), [(1.0, "circle skirt"), (0.5, "half-circle skirt"), (0.25, "a-line skirt")])
def test_a_flared_skirt_is_named_by_its_share_of_a_circle(woman: Measurements, suns: float, tag: str) -> None:
    found = tags(woman, meta=SKIRT, flare_skirt={"suns": suns})
    assert {"skirt", tag} <= found
    assert len(found & {"circle skirt", "half-circle skirt", "a-line skirt"}) == 1


@pytest.mark.parametrize(("length", "tag"), [(0.2, "mini"), (0.5, "knee-length"), (0.7, "midi"), (0.9, "maxi")])
def test_the_length_of_a_skirt_has_a_name(woman: Measurements, length: float, tag: str) -> None:
    assert tag in tags(woman, meta=SKIRT, flare_skirt={"length": length})


def test_a_maxi_reaches_below_four_fifths_of_hips_to_floor(woman: Measurements) -> None:
    """Measured on the pattern: the skirt from waist to hem is longer than waist to hips and 0.8 of the leg."""
    random = np.random.default_rng(8)
    designs = [sample_design(random, [woman]) for _ in range(150)]
    skirts = [design for design in designs if design.meta.bottom and not design.meta.upper]
    maxis = [design for design in skirts if "maxi" in outfit_tags(woman, design)]
    assert maxis
    assert all(hem_depth(woman, design) > 0.8 for design in maxis)
    pencil = design_from_dict({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"length": 0.9, "flare": 1.0}})
    front = outfit(woman, pencil).panel("skirt_front")
    assert "maxi" in outfit_tags(woman, pencil)
    assert np.ptp(front.vertices[:, 1]) > woman.hips_line + 0.8 * woman.leg_length


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"meta": SHIRT}, {"top", "shirt", "sleeveless", "round neck"}),
        ({"meta": SHIRT, "collar": {"f_collar": "VNeckHalf"}}, {"v-neck"}),
        ({"meta": SHIRT, "collar": {"component": {"style": "Hood2Panels"}}}, {"hooded"}),
        ({"meta": SHIRT, "left": {"enable_asym": True}}, {"asymmetric"}),
        ({"meta": SHIRT, "sleeve": {"sleeveless": False, "length": 0.9}}, {"long sleeves"}),
        ({"meta": {"upper": "FittedShirt"}, "shirt": {"strapless": True}}, {"fitted bodice", "strapless"}),
        ({"meta": {"upper": "Shirt", "bottom": "Pants"}}, {"jumpsuit", "trousers"}),
        ({"meta": {"bottom": "Pants", "wb": "StraightWB"}}, {"trousers", "with waistband"}),
        ({"meta": {"bottom": "PencilSkirt"}}, {"pencil skirt"}),
        ({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"flare": 1.3}}, {"a-line skirt"}),
        ({"meta": {"bottom": "Skirt2"}, "skirt": {"ruffle": 1.5}}, {"gathered skirt", "ruffled"}),
        (
            {"meta": {"bottom": "SkirtLevels"}, "levels-skirt": {"base": "SkirtCircle"}},
            {"tiered skirt", "circle skirt"},
        ),
        ({"meta": {"bottom": "AsymmSkirtCircle"}}, {"circle skirt", "asymmetric"}),
        ({"meta": {"upper": "Cape"}}, {"top", "cape"}),
    ],
)
def test_styles_have_their_tailors_names(woman: Measurements, values: dict[str, Any], expected: set[str]) -> None:
    assert expected <= set(outfit_tags(woman, design_from_dict(values)))


def test_a_strapless_bodice_has_no_neckline(woman: Measurements) -> None:
    found = tags(woman, meta={"upper": "FittedShirt"}, shirt={"strapless": True})
    assert not found & {"round neck", "v-neck", "sleeveless"}


def test_every_outfit_has_one_kind_and_words_of_the_vocabulary(woman: Measurements) -> None:
    random = np.random.default_rng(3)
    seen: set[str] = set()
    for _ in range(300):
        found = outfit_tags(woman, sample_design(random, [woman]))
        assert set(found) <= set(TAGS)
        assert list(found) == sorted(set(found), key=TAGS.index)
        assert len({"top", "dress", "jumpsuit", "skirt"} & set(found)) == (0 if found[0] == "trousers" else 1)
        seen.update(found)
    assert seen == set(TAGS) - {Tag.CAPE.value, Tag.PONCHO.value}  # of weight 0


def test_the_documentation_lists_every_tag_with_its_meaning() -> None:
    listed = (Path(__file__).parents[3] / "docs" / "labels.md").read_text()
    rows = [line for line in listed.splitlines() if line.startswith("| `")]
    assert rows == [f"| `{tag.value}` | {tag.meaning} |" for tag in Tag]
