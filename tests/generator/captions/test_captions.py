"""Captions state what is drawn, in words that agree with the drawing's measures."""

import re

import numpy as np
import pytest

from gcd_dataset.captions import LEVELS, caption_text, read_captions
from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.captions import caption, captions, garment_facts, say
from gcd_dataset.generator.captions.facts import AT_KNEE, KNEE_HEIGHT
from gcd_dataset.generator.captions.sentences import MOST_SHORT_WORDS
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.assembly import bottom_rise
from gcd_dataset.generator.garments.circle_skirt import VISIBLE_CUT
from gcd_dataset.generator.garments.description import RUFFLES
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Bottom
from gcd_dataset.records import Panel, Pattern
from tests.generator.garments.conftest import OUTFITS, WOMAN
from tests.generator.worn import Worn, drawn, edges, hem_cut_depth, sampled_wardrobe


@pytest.fixture(scope="module")
def wardrobe() -> list[Worn]:
    return sampled_wardrobe()


def test_every_garment_of_the_wardrobe_has_captions(wardrobe: list[Worn]) -> None:
    worn = {
        garment.value for each in wardrobe for garment in (each.design.meta.upper, each.design.meta.bottom) if garment
    }
    assert worn == {garment.name for garment in GARMENTS}
    for each in wardrobe:
        assert list(each.captions()) == list(LEVELS)


@pytest.mark.parametrize("name", OUTFITS)
def test_the_outfits_of_the_battery_have_captions(name: str) -> None:
    design = design_from_dict(OUTFITS[name])
    texts = captions(WOMAN, design, draw_garment(WOMAN, design))
    assert all(texts.values())


def test_captions_are_plain_sentences(wardrobe: list[Worn]) -> None:
    for number, each in enumerate(wardrobe):
        texts = each.captions(number)
        for text in texts.values():
            assert re.fullmatch(r"[A-Z][A-Za-z, -]*(\. [A-Z][A-Za-z, -]*)*\.", text), text
            assert not re.search(r"  | ,| \.|,,|\ba [aeio](?!ne-)|\ban [^aeioA]", text), text
        assert len(texts["short"].split()) <= MOST_SHORT_WORDS, texts["short"]
        assert texts["medium"].count(".") <= 2


def test_a_longer_caption_states_all_facts_of_a_shorter_one_and_differs(wardrobe: list[Worn]) -> None:
    for number, each in enumerate(wardrobe):
        said = say(garment_facts(*each), np.random.default_rng(number))
        for entry in said.values():
            assert all(fact.lower() in entry.text.lower() for fact in entry.facts), entry
        short, medium, full = (set(said[level].facts) for level in LEVELS)
        assert short < medium <= full
        assert len({entry.text for entry in said.values()}) == len(LEVELS)


def mentions(text: str, *words: str) -> bool:
    return any(re.search(rf"\b{word}\b", text, re.IGNORECASE) for word in words)


def test_a_caption_mentions_the_parts_that_are_drawn_and_no_others(wardrobe: list[Worn]) -> None:
    seen: set[str] = set()
    for each in wardrobe:
        panels, full = " ".join(panel.name for panel in each.pattern.panels), each.captions()["full"]
        darts = any(seam.left.panel == seam.right.panel for seam in each.pattern.seams)
        parts = {
            "hood": (("hood",), "right_hood" in panels),
            "sleeves": (("sleeves?",), "sleeve_f" in panels),
            "cuffs": (("cuffs?", "frills"), "cuff" in panels),
            "band": (("waistband", "band at the hem"), "wb_front" in panels),
            "godets": (("godets",), "ins_" in panels),
            "darts": (("darts",), darts),
            "notch": (("notch", "cut on", "cut in"), hem_cut_depth(each.pattern) >= VISIBLE_CUT),
            "collar": (("lapels?", "lapel collar", "turtleneck", "standing collar"), "collar_back" in panels),
            "trousers": (("trousers", "shorts"), "pant_" in panels),
            "skirt": (("skirt",), "skirt_" in panels.replace("cuff_skirt_", "")),
            "sleeveless": (("sleeveless",), "torso" in panels and "sleeve_f" not in panels and "strap" not in full
                           and "shoulder" not in full.replace("raised shoulder", "")),
        }  # fmt: skip
        for part, (words, is_drawn) in parts.items():
            said = mentions(full.replace("no waistband", ""), *words)
            if part != "sleeveless" or "one-shoulder" not in full:
                assert said == is_drawn, (part, full, panels)
            seen.update([part] if said else [])
    assert len(seen) == 11


def test_slits_left_out_of_the_drawing_are_not_mentioned() -> None:
    """A godet skirt's base is sewn without its slits."""
    slits = {"front_slit": 0.5, "left_slit": 0.5}
    plain = drawn(WOMAN, meta={"bottom": "PencilSkirt"}, pencil_skirt=slits)
    godets = drawn(WOMAN, meta={"bottom": "GodetSkirt"}, pencil_skirt=slits, godet_skirt={"base": "PencilSkirt"})
    assert "slit" in plain.captions()["full"]
    assert "slit" not in godets.captions()["full"]


def test_a_collar_that_differing_halves_leave_out_is_not_mentioned() -> None:
    hood = {"component": {"style": "Hood2Panels"}}
    both = drawn(WOMAN, meta={"upper": "Shirt"}, collar=hood)
    halves = drawn(WOMAN, meta={"upper": "Shirt"}, collar=hood, left={"enable_asym": True, "collar": {"width": 0.9}})
    assert "hood" in both.captions()["full"]
    assert "hood" not in halves.captions()["full"]


def test_a_trapezoid_neckline_drawn_as_a_v_is_called_a_v() -> None:
    """Flat sides meet in the middle before they reach the depth."""
    flat = {"f_collar": "TrapezoidNeckHalf", "fc_angle": 110, "fc_depth": 1.6, "width": -0.3}
    assert "V-neckline" in drawn(WOMAN, meta={"upper": "Shirt"}, collar=flat).captions()["full"]
    steep = flat | {"fc_angle": 90, "fc_depth": 0.4, "width": 0.3}
    assert "V-neckline" not in drawn(WOMAN, meta={"upper": "Shirt"}, collar=steep).captions()["full"]


def test_a_skirt_is_gathered_if_its_seam_gathers_it() -> None:
    """On a band as long as its top, a skirt declared with gathers hangs straight."""
    skirt = {"meta": {"bottom": "Skirt2", "wb": "StraightWB"}, "skirt": {"ruffle": 1.5, "rise": 1.0}}
    assert "gathered skirt" in drawn(WOMAN, waistband={"waist": 1.0}, **skirt).captions()["full"]
    assert "gathered" not in drawn(WOMAN, waistband={"waist": 1.5}, **skirt).captions()["full"]


# -------------------------------------------------------------------------------------------------------------- lengths


def middle_length(panel: Panel) -> float:
    """Length of a skirt's front along its middle, from top to hem [cm]."""
    heights = []
    for index, edge in enumerate(panel.edges):
        if edge.name in ("top", "bottom"):
            curve = sample_curve(*panel.edge_ends(index), edge.curve, 65)
            heights += curve.tolist()
    middle = 0.5 * (panel.vertices[:, 0].min() + panel.vertices[:, 0].max())
    near = min(abs(x - middle) for x, _ in heights)
    at_middle = [y for x, y in heights if abs(x - middle) < near + 0.5]
    return max(at_middle) - min(at_middle)


ABOVE, AT, BELOW = (
    {"mini", "above-the-knee"},
    {"knee-length"},
    {"below-the-knee", "midi", "mid-calf", "maxi", "full-length"},
)


def test_the_length_of_a_drawn_skirt_agrees_with_its_word(wardrobe: list[Worn]) -> None:
    """The hem hangs above, at or below the knee; skirts of several tiers are as long as all of their fronts."""
    plain = {Bottom.CIRCLE, Bottom.GATHERED, Bottom.PENCIL, Bottom.LEVELS}
    words = []
    for size, design, pattern in wardrobe:
        if design.meta.upper or design.meta.bottom not in plain or "hem_cut" in edges(pattern):
            continue
        fronts = [panel for panel in pattern.panels if panel.name.startswith("skirt_front")]
        if "slit" in edges(pattern) or any(edge.name.startswith("dart") for edge in fronts[0].edges):
            continue
        if "AsymmSkirtCircle" in (design.levels_skirt.base.value, design.levels_skirt.level.value):
            continue
        top = size.waist_level - (1 - bottom_rise(design)) * size.hips_line
        hem = top - sum(map(middle_length, fronts))
        knee, near = KNEE_HEIGHT * size.height, AT_KNEE * size.leg_length
        (word,) = garment_facts(size, design, pattern).length[:1]
        expected = ABOVE if hem > knee + near else BELOW if hem < knee - near else AT
        assert word in expected, (word, hem, knee, design.meta.bottom)
        words.append(word)
    assert len(words) > 20
    assert set(words) & ABOVE
    assert set(words) & BELOW


@pytest.mark.parametrize(
    ("length", "word"),
    [
        (0.12, "cap"),
        (0.3, "short"),
        (0.48, "elbow-length"),
        (0.7, "three-quarter"),
        (1.0, "long"),
        (1.12, "extra-long"),
    ],
)
def test_sleeves_are_named_by_their_length(length: float, word: str) -> None:
    shirt = drawn(WOMAN, meta={"upper": "Shirt"}, sleeve={"sleeveless": False, "length": length})
    phrases = [detail.words[0] for detail in garment_facts(*shirt).details]
    assert any(phrase.startswith(f"{word} ") and phrase.endswith("sleeves") for phrase in phrases), phrases


@pytest.mark.parametrize(
    ("length", "expected"), [(0.22, "shorts"), (0.45, "knee-length"), (0.7, "trousers"), (0.9, "trousers")]
)
def test_short_trousers_are_shorts(length: float, expected: str) -> None:
    assert expected in drawn(WOMAN, meta={"bottom": "Pants"}, pants={"length": length}).captions()["short"].lower()


# ------------------------------------------------------------------------------------------------------------- symmetry


def test_halves_that_differ_are_said_to_differ() -> None:
    left = {"enable_asym": True, "collar": {"f_collar": "VNeckHalf"}, "sleeve": {"sleeveless": False, "length": 0.9}}
    shirt = drawn(WOMAN, meta={"upper": "Shirt"}, left=left, collar={"f_collar": "SquareNeckHalf"}).captions()
    assert "square on the right and V-shaped on the left" in shirt["full"]
    assert "sleeve on the left only" in shirt["full"]
    assert "asymmetric" in shirt["short"].lower()
    same = drawn(WOMAN, meta={"upper": "Shirt"}).captions()
    assert "asymmetric" not in same["full"].lower()


def test_a_tilted_hem_slants_to_the_side_where_it_is_longer() -> None:
    worn = drawn(WOMAN, meta={"bottom": "PencilSkirt"}, pencil_skirt={"low_angle": 20})
    front = worn.pattern.panel("skirt_front")
    low = front.vertices[front.vertices[:, 1].argmin()]
    side = "left" if low[0] > 0.5 * (front.vertices[:, 0].min() + front.vertices[:, 0].max()) else "right"
    other = {"left": "right", "right": "left"}[side]
    assert any(phrase in worn.captions()["full"] for phrase in (f"down to the {side}", f"higher on the {other}"))


def test_a_bodice_with_one_strap_is_called_one_shouldered() -> None:
    left = {"enable_asym": True, "shirt": {"strapless": True}}
    text = drawn(WOMAN, meta={"upper": "FittedShirt"}, left=left).captions()
    assert "one-shoulder" in text["short"]
    assert "on the right only" in text["full"]


# -------------------------------------------------------------------------------------------------------------- wording


def test_the_wording_is_a_function_of_seed_and_index() -> None:
    worn = drawn(WOMAN, meta={"upper": "Shirt"}, sleeve={"sleeveless": False, "length": 0.7})
    texts = [worn.captions(index)["full"] for index in range(12)]
    assert texts == [worn.captions(index)["full"] for index in range(12)]
    assert len(set(texts)) > 3
    assert caption(*worn, level="full", seed=5, index=3) == texts[3]


def test_an_unknown_level_is_refused() -> None:
    with pytest.raises(ConfigError, match="give one of short, medium, full"):
        caption(*drawn(WOMAN, meta={"upper": "Shirt"}), level="long")


def test_the_member_holds_one_level_a_line() -> None:
    texts = drawn(WOMAN, meta={"upper": "Shirt"}).captions()
    assert read_captions(caption_text(texts)) == texts
    assert caption_text(texts).splitlines()[1] == f"medium: {texts['medium']}"
    with pytest.raises(ShardError, match="a caption whose lines do not begin with short:, medium:, full:"):
        read_captions("a skirt")


@pytest.mark.parametrize(
    ("limb", "cuff", "noun"), [("right_sleeve_", "sl_right_cuff_", "sleeve"), ("pant_", "pant_r_cuff_", "leg")]
)
def test_words_for_cuffs_follow_the_drawn_gathers(wardrobe: list[Worn], limb: str, cuff: str, noun: str) -> None:
    """Frills are gathered, and limbs are gathered into cuffs, where a seam of the pattern is, and nowhere else."""
    gathered, frilled = [], []
    for number, each in enumerate(wardrobe):
        parts = {panel.name: panel_part(panel.name, limb, cuff) for panel in each.pattern.panels}
        if not {"band", "skirt"} & set(parts.values()) or len(each.design.halves()) > 1:
            continue
        band = "band" in parts.values()
        into = length_ratio(each.pattern, parts, "limb", "band" if band else "skirt")
        frill = length_ratio(each.pattern, parts, "skirt", "band" if band else "limb")
        full = each.captions(number)["full"]
        gathered.append(f"gather the {noun} ends" in full or f"{noun} ends gathered" in full)
        phrases = (f"frills (at|that gather) the {noun}", f"{noun} ends gathered into [a-z ]*frills")
        frilled.append(mentions(full, *phrases))
        assert gathered[-1] == (into >= RUFFLES), (full, into)
        assert frilled[-1] == (frill >= RUFFLES), (full, frill)
    assert {*gathered} == {*frilled} == {True, False}


def panel_part(name: str, limb: str, cuff: str) -> str:
    """``band`` or ``skirt`` of a cuff, ``limb``, or nothing."""
    if name.startswith(cuff):
        return "skirt" if "skirt" in name else "band"
    return "limb" if name.startswith(limb) and "cuff" not in name else ""


def length_ratio(pattern: Pattern, parts: dict[str, str], one: str, other: str) -> float:
    """Total length of the edges of ``one`` part over those of the ``other`` that they are sewn to; 1 without any."""
    lengths, total = {panel.name: panel.edge_lengths() for panel in pattern.panels}, np.zeros(2)
    for seam in pattern.seams:
        for a, b in ((seam.left, seam.right), (seam.right, seam.left)):
            if (parts[a.panel], parts[b.panel]) == (one, other):
                total += [lengths[a.panel][a.edge], lengths[b.panel][b.edge]]
    return float(total[0] / total[1]) if total[1] else 1.0
