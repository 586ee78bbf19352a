"""The tags of an outfit are the tailor's names for its style."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.garments import TAGS, design_from_dict, draw_garment, garment_tags
from gcd_dataset.generator.garments.description import Tag
from gcd_dataset.generator.garments.drawn import hem_depth
from gcd_dataset.records import Measurements, PanelRole, Pattern
from tests.generator.worn import Worn, drawn, edges, sampled_wardrobe

BARE, SLEEVE = {"enable_asym": True, "shirt": {"strapless": True}}, {"sleeveless": False, "length": 0.3}
ALONE = (
    {"strapless", "one-shoulder"},
    {"sleeveless", "short sleeves", "long sleeves", "uneven sleeves"},
    {"round neck", "v-neck", "square neck", "curved neck", "uneven neck"},
)
"""Tags of which a garment has at most one."""
SKIRT, SHIRT = {"upper": None, "bottom": "SkirtCircle"}, {"upper": "Shirt", "bottom": None}


def tags(size: Measurements, **values: Any) -> set[str]:
    return set(garment_tags(*drawn(size, **values)))


@pytest.mark.parametrize(("suns", "tag"), [(1.0, "circle skirt"), (0.5, "half-circle skirt"), (0.25, "a-line skirt")])
def test_a_flared_skirt_is_named_by_its_share_of_a_circle(woman: Measurements, suns: float, tag: str) -> None:
    found = tags(woman, meta=SKIRT, flare_skirt={"suns": suns})
    assert {"skirt", tag} <= found
    assert len(found & {"circle skirt", "half-circle skirt", "a-line skirt"}) == 1


@pytest.mark.parametrize(("length", "tag"), [(0.2, "mini"), (0.5, "knee-length"), (0.7, "midi"), (0.9, "maxi")])
def test_the_length_of_a_skirt_has_a_name(woman: Measurements, length: float, tag: str) -> None:
    assert tag in tags(woman, meta=SKIRT, flare_skirt={"length": length})


def test_a_maxi_reaches_below_four_fifths_of_hips_to_floor(woman: Measurements, wardrobe: list[Worn]) -> None:
    """Measured on the pattern: the skirt from waist to hem is longer than waist to hips and 0.8 of the leg."""
    skirts = [worn for worn in wardrobe if worn.design.meta.bottom and not worn.design.meta.upper]
    maxis = [worn for worn in skirts if "maxi" in garment_tags(*worn)]
    assert maxis
    assert all(hem_depth(worn.size, worn.design) > 0.8 for worn in maxis)
    pencil = design_from_dict({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"length": 0.9, "flare": 1.0}})
    pattern = draw_garment(woman, pencil)
    front = pattern.panel("skirt_front")
    assert "maxi" in garment_tags(woman, pencil, pattern)
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
        ({"meta": {"upper": "FittedShirt"}, "left": BARE}, {"fitted bodice", "one-shoulder", "sleeveless"}),
        ({"meta": {"upper": "FittedShirt"}, "left": BARE, "sleeve": SLEEVE}, {"one-shoulder", "uneven sleeves"}),
        ({"meta": SHIRT, "left": {"enable_asym": True}, "sleeve": SLEEVE}, {"uneven sleeves", "round neck"}),
        ({"meta": SHIRT, "left": {"enable_asym": True, "sleeve": SLEEVE}, "sleeve": SLEEVE}, {"short sleeves"}),
        (
            {"meta": SHIRT, "left": {"enable_asym": True, "sleeve": SLEEVE | {"length": 0.9}}, "sleeve": SLEEVE},
            {"uneven sleeves"},
        ),
        ({"meta": SHIRT, "left": {"enable_asym": True, "collar": {"f_collar": "VNeckHalf"}}}, {"uneven neck"}),
        ({"meta": {"upper": "Shirt", "bottom": "Pants"}}, {"jumpsuit", "trousers"}),
        ({"meta": {"bottom": "Pants", "wb": "StraightWB"}}, {"trousers", "with waistband"}),
        ({"meta": {"bottom": "PencilSkirt"}}, {"pencil skirt"}),
        ({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"flare": 1.3}}, {"a-line skirt"}),
        ({"meta": {"bottom": "Skirt2", "wb": "StraightWB"}, "skirt": {"ruffle": 1.5}}, {"gathered skirt", "ruffled"}),
        (
            {"meta": {"bottom": "SkirtLevels"}, "levels-skirt": {"base": "SkirtCircle"}},
            {"tiered skirt", "circle skirt"},
        ),
        ({"meta": {"bottom": "AsymmSkirtCircle"}}, {"circle skirt", "asymmetric"}),
        ({"meta": {"upper": "Cape"}}, {"top", "cape"}),
    ],
)
def test_styles_have_their_tailors_names(woman: Measurements, values: dict[str, Any], expected: set[str]) -> None:
    design = design_from_dict(values)
    assert expected <= set(garment_tags(woman, design, draw_garment(woman, design)))


def test_a_strapless_bodice_has_no_neckline(woman: Measurements) -> None:
    found = tags(woman, meta={"upper": "FittedShirt"}, shirt={"strapless": True})
    assert not found & {"round neck", "v-neck", "sleeveless"}


def test_every_outfit_has_one_kind_and_words_of_the_vocabulary(wardrobe: list[Worn]) -> None:
    for worn in wardrobe:
        found = garment_tags(*worn)
        assert set(found) <= set(TAGS)
        assert list(found) == sorted(set(found), key=TAGS.index)
        assert len({"top", "dress", "jumpsuit", "skirt"} & set(found)) == (0 if found[0] == "trousers" else 1)
        assert all(len(group & set(found)) <= 1 for group in ALONE)


# ------------------------------------------------------------------------------------------------------- drawn pattern


@pytest.mark.parametrize("combined", ["GodetSkirt", "SkirtLevels"])
def test_a_skirt_whose_base_is_sewn_without_slits_has_no_slit(woman: Measurements, combined: str) -> None:
    slits = {"front_slit": 0.5, "left_slit": 0.5}
    base = {"godet_skirt": {"base": "PencilSkirt"}, "levels_skirt": {"base": "PencilSkirt"}}
    assert "slit" in tags(woman, meta={"bottom": "PencilSkirt"}, pencil_skirt=slits)
    found = tags(woman, meta={"bottom": combined}, pencil_skirt=slits, **base)
    assert "pencil skirt" in found
    assert "slit" not in found


def test_a_slit_too_short_to_see_has_no_tag(woman: Measurements) -> None:
    """A hundredth of the skirt's part below the hips is less than a centimetre."""
    assert "slit" not in tags(woman, meta={"bottom": "PencilSkirt"}, pencil_skirt={"back_slit": 0.01})


def test_a_skirt_on_a_band_as_long_as_its_top_is_not_gathered(woman: Measurements) -> None:
    skirt = {"meta": {"bottom": "Skirt2", "wb": "StraightWB"}, "skirt": {"ruffle": 1.5, "rise": 1.0}}
    assert {"gathered skirt", "ruffled"} <= tags(woman, waistband={"waist": 1.0}, **skirt)
    wide = tags(woman, waistband={"waist": 1.5}, **skirt)
    assert "straight skirt" in wide
    assert not wide & {"gathered skirt", "ruffled"}


def test_a_trapezoid_neckline_drawn_as_a_v_is_a_v_neck(woman: Measurements) -> None:
    """Flat sides meet in the middle before they reach the depth."""
    flat = {"f_collar": "TrapezoidNeckHalf", "fc_angle": 110, "fc_depth": 1.6, "width": -0.3}
    steep = flat | {"fc_angle": 90, "fc_depth": 0.4, "width": 0.3}
    pointed = tags(woman, meta=SHIRT, collar=flat)
    assert ("v-neck" in pointed, "square neck" in pointed) == (True, False)
    assert "square neck" in tags(woman, meta=SHIRT, collar=steep)


def test_five_tiers_of_the_least_length_hang_lower_than_declared(woman: Measurements) -> None:
    """The tiers declare 2 cm each and are drawn 5 cm long: the hem is at least 15 cm lower."""
    section = {"length": 0.3, "base_length_frac": 0.6, "num_levels": 5, "base": "SkirtCircle", "level": "Skirt2"}
    worn = drawn(woman, meta={"bottom": "SkirtLevels"}, levels_skirt=section)
    tiers = [np.ptp(worn.pattern.panel(f"skirt_front_{number}").vertices[:, 1]) for number in range(5)]
    assert np.allclose(tiers, 5.0)
    assert 0.3 + 15 / woman.leg_length < hem_depth(woman, worn.design)
    assert "mini" not in garment_tags(*worn)


def test_an_arc_that_bulges_inwards_is_not_round(woman: Measurements) -> None:
    arc = {"f_collar": "CircleArcNeckHalf"}
    assert "round neck" in tags(woman, meta=SHIRT, collar=arc)
    assert "round neck" not in tags(woman, meta=SHIRT, collar=arc | {"f_flip_curve": True})


def test_a_shirt_with_one_sleeve_is_not_sleeveless(woman: Measurements) -> None:
    left = {"enable_asym": True, "sleeve": {"sleeveless": False, "length": 0.3}}
    found = tags(woman, meta=SHIRT, sleeve={"sleeveless": True}, left=left)
    assert found & ALONE[1] == {"uneven sleeves"}


def test_halves_of_the_same_design_are_not_asymmetric(woman: Measurements) -> None:
    neck = {"f_collar": "VNeckHalf", "b_collar": "CircleNeckHalf", "width": 0.3}
    right = {"collar": neck, "shirt": {"width": 1.0}}
    left = {"enable_asym": True, "sleeve": {"sleeveless": True}, "collar": neck, "shirt": {"width": 1.0}}
    assert "asymmetric" not in tags(woman, meta=SHIRT, left=left, **right)
    assert "asymmetric" in tags(woman, meta=SHIRT, left=left | {"collar": neck | {"width": 0.7}}, **right)


def test_a_band_at_the_hem_of_a_top_is_no_waistband(woman: Measurements) -> None:
    assert "with waistband" not in tags(woman, meta=SHIRT | {"wb": "StraightWB"})
    assert "with waistband" in tags(woman, meta={"upper": "Shirt", "bottom": "Pants", "wb": "StraightWB"})


def test_a_cuff_as_wide_as_its_sleeve_is_not_ruffled(woman: Measurements) -> None:
    """A cuff that is a skirt, its top gathered as much as the sleeve would be."""
    cuff = {"type": "CuffSkirt", "top_ruffle": 1.4, "skirt_ruffle": 1.4}
    sleeve = {"sleeveless": False, "length": 0.8, "end_width": 1.0}
    assert "ruffled" not in tags(woman, meta=SHIRT, sleeve=sleeve | {"cuff": cuff})
    assert "ruffled" in tags(woman, meta=SHIRT, sleeve=sleeve | {"cuff": cuff | {"skirt_ruffle": 1.0}})


# ------------------------------------------------------------------------------------------------------------- captions


@pytest.fixture(scope="module")
def wardrobe() -> list[Worn]:
    return sampled_wardrobe()


def longest_ratio(pattern: Pattern) -> float:
    """Largest ratio of the two sides of a seam."""
    lengths = {panel.name: panel.edge_lengths() for panel in pattern.panels}
    sides = [
        [lengths[ref.panel][ref.edge] for ref in (seam.left, seam.right)]
        for seam in pattern.seams
        if seam.left.panel != seam.right.panel
    ]
    return max(max(pair) / min(pair) for pair in sides)


def front_necklines(pattern: Pattern) -> list[tuple[str, ...]]:
    """The kinds of curve of each half of the neckline in front."""
    fronts = [panel for panel in pattern.panels if panel.name.endswith("_ftorso")]
    return [tuple(type(edge.curve).__name__ for edge in panel.edges if edge.name == "neck") for panel in fronts]


def drawn_features(worn: Worn) -> Mapping[str, bool]:
    """Tag to whether the pattern has its feature, by panels, edges and seams alone."""
    names, found = " ".join(panel.name for panel in worn.pattern.panels), edges(worn.pattern)
    darts = {seam.left.panel for seam in worn.pattern.seams if seam.left.panel == seam.right.panel}
    bare = {"shoulder" not in {edge.name for edge in panel.edges} for panel in worn.pattern.panels
            if panel.name.endswith("ftorso")}  # fmt: skip
    sleeves = names.count("sleeve_f")
    sleeve, torso, necks = "sleeve_f" in names, "torso" in names, front_necklines(worn.pattern)
    seams = longest_ratio(worn.pattern)
    return {
        "fitted bodice": "right_ftorso" in darts,
        "shirt": torso and "right_ftorso" not in darts,
        "trousers": "pant_f_r" in names,
        "jumpsuit": "pant_f_r" in names and torso,
        "dress": "skirt" in names.replace("cuff_skirt", "") and torso,
        "pencil skirt": bool(found & {"right_hip"}),
        "panelled skirt": "skirt_panel_3" in names,
        "godet skirt": "ins_skirt_front_0" in names,
        "tiered skirt": "skirt_front_0" in names,
        "slit": bool(found & {"slit", "right_slit", "left_slit", "hem_cut"}),
        "with waistband": "wb_front" in names and any(panel.label == PanelRole.LEG for panel in worn.pattern.panels),
        "strapless": bare == {True},
        "one-shoulder": bare == {True, False},
        "sleeveless": not sleeve,
        "short sleeves": sleeves == 2,
        "long sleeves": sleeves == 2,
        "uneven sleeves": sleeve,
        "with cuffs": "cuff" in names,
        "round neck": ("Arc",) in necks,
        "v-neck": ("Line",) in necks,
        "square neck": ("Line", "Line") in necks,
        "curved neck": bool(set(necks) & {("Arc",), ("Cubic",), ("Quadratic",)}),
        "turtleneck": "collar_front" in names,
        "lapel": "collar_front" in names,
        "hooded": "hood" in names,
        "gathered skirt": seams >= 1.2,
        "ruffled": seams >= 1.2,
    }  # fmt: skip


LENGTHS = {
    "mini": "mini|above-the-knee|very short|playsuit|short jumpsuit",
    "knee-length": "above-the-knee|knee-length|below-the-knee|cropped|calf-length|playsuit|short jumpsuit",
    "midi": "midi|mid-calf|cropped|calf-length",
    "maxi": "maxi|full-length|long",
}
STATED = LENGTHS | {
    "dress": "dress", "jumpsuit": "jumpsuit|playsuit", "trousers": "trousers|shorts", "cape": "cape",
    "poncho": "poncho", "fitted bodice": "fitted (bodice|top|tunic)|fitted [a-z -]*(bodice|top|tunic)",
    "a-line skirt": "A-line skirt|slightly flared skirt", "half-circle skirt": "half-circle skirt",
    "circle skirt": "circle skirt", "pencil skirt": "pencil skirt", "straight skirt": "straight skirt",
    "gathered skirt": "gathered (A-line )?skirt", "panelled skirt": "-panel|panels", "godet skirt": "godets",
    "tiered skirt": "tiers?", "slit": "slits?|notch|V-shaped cut", "with waistband": "waistband",
    "strapless": "strapless", "one-shoulder": "one-shoulder",
    "uneven sleeves": "sleeve[a-z, -]* on the (right|left)", "uneven neck": "on the right and",
    "short sleeves": "(cap|short|elbow-length) [a-z ]*sleeves?",
    "long sleeves": "(three-quarter|three-quarter-length|long|full-length|extra-long) [a-z ]*sleeves?",
    "with cuffs": "cuffs?|frills?", "round neck": "round|scoop", "v-neck": "V-neckline|V-shaped",
    "square neck": "square|trapezoid", "curved neck": "U-shaped|curved|inward-curving|curved V|curved V-neckline",
    "turtleneck": "turtleneck|standing collar", "lapel": "lapels?", "hooded": "hood",
    "asymmetric": "asymmetric|one-shoulder|off-centre|off centre|high-low|longer behind",
}  # fmt: skip
"""Tag to words of which the full caption has one."""
MUTUAL = {
    "slit", "gathered skirt", "straight skirt", "godet skirt", "tiered skirt", "strapless", "lapel", "with waistband",
    "hooded", "asymmetric", "panelled skirt", "pencil skirt", "dress", "one-shoulder", "with cuffs",
}  # fmt: skip
"""Tags that a garment has if its full caption has one of the words."""


def test_every_tag_is_supported_by_the_drawn_pattern(wardrobe: list[Worn]) -> None:
    seen: set[str] = set()
    for worn in wardrobe:
        found, features = garment_tags(*worn), drawn_features(worn)
        assert not [tag for tag in found if not features.get(tag, True)], (found, worn.captions()["full"])
        seen.update(found)
    assert seen == set(TAGS)


def test_tags_agree_with_the_full_caption(wardrobe: list[Worn]) -> None:
    for number, worn in enumerate(wardrobe):
        found, full = garment_tags(*worn), worn.captions(number)["full"].replace("no waistband", "")
        for tag, words in STATED.items():
            says = re.search(rf"(?<![\w-])({words})(?![\w-])", full, re.IGNORECASE) is not None
            assert says or tag not in found, (tag, full)
            assert tag in found or not says or tag not in MUTUAL, (tag, full)
        assert ("sleeveless" in full.lower()) <= ("sleeveless" in found)
        assert "gather" not in full.replace("gathered frills", "") or "ruffled" in found, full
        assert "asymmetric" in found or "differ" not in full


def test_the_documentation_lists_every_tag_with_its_meaning() -> None:
    listed = (Path(__file__).parents[3] / "docs" / "labels.md").read_text()
    rows = [line for line in listed.splitlines() if line.startswith("| `")]
    assert rows == [f"| `{tag.value}` | {tag.meaning} |" for tag in Tag]
