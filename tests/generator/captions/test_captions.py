"""Captions and tags state what is drawn, in the tailor's words."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from gcd_dataset.captions import LEVELS, caption_text, read_captions
from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import ShardError
from gcd_dataset.generator.captions import captions, garment_facts, say
from gcd_dataset.generator.captions.facts import AT_KNEE, KNEE_HEIGHT
from gcd_dataset.generator.captions.sentences import MOST_SHORT_WORDS
from gcd_dataset.generator.garments import (
    TAGS,
    GarmentDesign,
    Reject,
    design_from_dict,
    draw_garment,
    garment_tags,
    sample_design,
    try_on,
)
from gcd_dataset.generator.garments.assembly import bottom_rise
from gcd_dataset.generator.garments.circle_skirt import VISIBLE_CUT
from gcd_dataset.generator.garments.description import RUFFLES, Tag
from gcd_dataset.generator.garments.drawn import hem_depth
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Bottom, Upper
from gcd_dataset.records import Closure, Measurements, Panel, Pattern
from tests.generator.garments.conftest import MAN, SHIRT, SKIRT, STOUT, WOMAN


class Worn(NamedTuple):
    """A design, drawn for a wearer."""

    size: Measurements
    design: GarmentDesign
    pattern: Pattern

    def captions(self, index: int = 0) -> dict[str, str]:
        return dict(captions(self.size, self.design, self.pattern, seed=5, index=index))


def drawn(size: Measurements, **values: object) -> Worn:
    """A design of sections, with underscores in their names, drawn for a wearer."""
    design = design_from_dict({name.replace("_", "-"): part for name, part in values.items()})
    return Worn(size, design, draw_garment(size, design))


def sampled(count: int, *overlays: Mapping[str, Any]) -> Iterator[Worn]:
    """Accepted random designs, on a woman, a man and a stout woman in turn."""
    random = np.random.default_rng(21)
    for overlay in overlays or ({},):
        narrowed = Overlay.from_dict(overlay)
        for number in range(count):
            size = (WOMAN, MAN, STOUT)[number % 3]
            design = sample_design(random, [size], overlay=narrowed)
            pattern = try_on(size, design, name="sampled")
            if not isinstance(pattern, Reject):
                yield Worn(size, design, pattern)


@pytest.fixture(scope="module")
def wardrobe() -> list[Worn]:
    """Sampled designs, with capes and other garments that only overlays choose."""
    alone = {"upper": "none", "wb": "none", "bottom": "none"}
    members = [("upper", upper) for upper in Upper] + [("bottom", bottom) for bottom in Bottom]
    rare = [{"meta": {**alone, part: member.value}} for part, member in members if not member.garment.weight]
    rare += [{"meta": {**alone, "upper": "Shirt"}, "front": {"closure": how.value}} for how in Closure if how != "sewn"]
    rare += [{"meta": {**alone, "upper": "Shirt"}, "pocket": {"chest": "left"}}]
    levels, pants = ({"meta": {"upper": "none", "bottom": name}} for name in ("SkirtLevels", "Pants"))
    return [*sampled(120), *sampled(8, *rare), *sampled(20, levels, pants)]


def edges(pattern: Pattern) -> set[str]:
    """The names of all edges, without number."""
    return {edge.name.partition(".")[0] for panel in pattern.panels for edge in panel.edges}


def hem_cut_depth(pattern: Pattern) -> float:
    """Distance from the tip of a hem cut to the middle of its mouth [cm]; 0 without a cut."""
    for panel in pattern.panels:
        ends = {edge.name: panel.edge_ends(index) for index, edge in enumerate(panel.edges)}
        if "hem_cut.0" in ends:
            (a, b), (c, d) = (ends[f"hem_cut.{number}"] for number in (0, 1))
            tip, *mouth = (b, a, d) if np.allclose(b, c) else (a, b, c)
            return float(np.linalg.norm(np.asarray(tip) - np.mean(mouth, axis=0)))
    return 0.0


def test_every_garment_of_the_wardrobe_has_captions(wardrobe: list[Worn]) -> None:
    worn = {part for each in wardrobe for part in (each.design.meta.upper, each.design.meta.bottom) if part}
    assert {part.value for part in worn} == {garment.name for garment in GARMENTS}
    for each in wardrobe:
        assert list(each.captions()) == list(LEVELS)


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


def test_a_collar_that_differing_halves_leave_out_is_not_mentioned() -> None:
    hood = {"component": {"style": "Hood2Panels"}}
    both = drawn(WOMAN, meta={"upper": "Shirt"}, collar=hood)
    halves = drawn(WOMAN, meta={"upper": "Shirt"}, collar=hood, left={"enable_asym": True, "collar": {"width": 0.9}})
    assert "hood" in both.captions()["full"]
    assert "hood" not in halves.captions()["full"]


def middle_length(panel: Panel) -> float:
    """Length of a skirt's front along its middle, from top to hem [cm]."""
    ends = [(*panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges) if edge.name in ("top", "bottom")]
    x, y = np.concatenate([sample_curve(*edge, 65) for edge in ends]).T
    off = np.abs(x - 0.5 * (panel.vertices[:, 0].min() + panel.vertices[:, 0].max()))
    return float(np.ptp(y[off < off.min() + 0.5]))


ABOVE, AT = {"mini", "above-the-knee"}, {"knee-length"}
BELOW = {"below-the-knee", "midi", "mid-calf", "maxi", "full-length"}


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
    assert set(words) & ABOVE and set(words) & BELOW


SLEEVES = {0.12: "cap", 0.3: "short", 0.48: "elbow-length", 0.7: "three-quarter", 1.0: "long", 1.12: "extra-long"}


def test_sleeves_and_trousers_are_named_by_their_length() -> None:
    for length, word in SLEEVES.items():
        shirt = drawn(WOMAN, meta={"upper": "Shirt"}, sleeve={"sleeveless": False, "length": length})
        phrases = [detail.words[0] for detail in garment_facts(*shirt).details]
        assert any(phrase.startswith(f"{word} ") and phrase.endswith("sleeves") for phrase in phrases), phrases
    for length, word in {0.22: "shorts", 0.45: "knee-length", 0.7: "trousers", 0.9: "trousers"}.items():
        assert word in drawn(WOMAN, meta={"bottom": "Pants"}, pants={"length": length}).captions()["short"].lower()


def test_halves_that_differ_are_said_to_differ() -> None:
    left = {"enable_asym": True, "collar": {"f_collar": "VNeckHalf"}, "sleeve": LONG}
    shirt = drawn(WOMAN, meta={"upper": "Shirt"}, left=left, collar={"f_collar": "SquareNeckHalf"}).captions()
    assert "square on the right and V-shaped on the left" in shirt["full"]
    assert "sleeve on the left only" in shirt["full"]
    assert "asymmetric" in shirt["short"].lower()
    same = drawn(WOMAN, meta={"upper": "Shirt"}).captions()
    assert "asymmetric" not in same["full"].lower()
    bodice = drawn(WOMAN, meta={"upper": "FittedShirt"}, left=BARE).captions()
    assert "one-shoulder" in bodice["short"]
    assert "on the right only" in bodice["full"]


def test_a_tilted_hem_slants_to_the_side_where_it_is_longer() -> None:
    worn = drawn(WOMAN, meta={"bottom": "PencilSkirt"}, pencil_skirt={"low_angle": 20})
    front = worn.pattern.panel("skirt_front")
    low = front.vertices[front.vertices[:, 1].argmin()]
    side = "left" if low[0] > 0.5 * (front.vertices[:, 0].min() + front.vertices[:, 0].max()) else "right"
    other = {"left": "right", "right": "left"}[side]
    assert any(phrase in worn.captions()["full"] for phrase in (f"down to the {side}", f"higher on the {other}"))


def test_the_wording_is_a_function_of_seed_and_index() -> None:
    worn = drawn(WOMAN, meta={"upper": "Shirt"}, sleeve={"sleeveless": False, "length": 0.7})
    texts = [worn.captions(index)["full"] for index in range(12)]
    assert texts == [worn.captions(index)["full"] for index in range(12)]
    assert len(set(texts)) > 3


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


BARE = {"enable_asym": True, "shirt": {"strapless": True}}
SLEEVE, LONG = ({"sleeveless": False, "length": length} for length in (0.3, 0.9))
ALONE = (
    {"strapless", "one-shoulder"},
    {"sleeveless", "short sleeves", "long sleeves", "uneven sleeves"},
    {"round neck", "v-neck", "square neck", "curved neck", "uneven neck"},
)
"""Tags of which a garment has at most one."""
STRAPLESS = {"meta": {"upper": "FittedShirt"}, "shirt": {"strapless": True}}
FLARED = {"circle skirt", "half-circle skirt", "a-line skirt"}


FLAT_SIDES = {"f_collar": "TrapezoidNeckHalf", "fc_angle": 110, "fc_depth": 1.6, "width": -0.3}
STEEP_SIDES = FLAT_SIDES | {"fc_angle": 90, "fc_depth": 0.4, "width": 0.3}
GATHERED = {"meta": {"bottom": "Skirt2", "wb": "StraightWB"}, "skirt": {"ruffle": 1.5, "rise": 1.0}}
SLITS = {"front_slit": 0.5, "left_slit": 0.5}
BASES = {"godet_skirt": {"base": "PencilSkirt"}, "levels_skirt": {"base": "PencilSkirt"}}
CUFF = {"type": "CuffSkirt", "top_ruffle": 1.4, "skirt_ruffle": 1.4}  # a skirt, gathered as much as the sleeve would be
WIDE_SLEEVE = {"sleeveless": False, "length": 0.8, "end_width": 1.0}
NECK = {"f_collar": "VNeckHalf", "b_collar": "CircleNeckHalf", "width": 0.3}
HALVES = {"meta": SHIRT, "collar": NECK, "shirt": {"width": 1.0}}
LEFT = {"enable_asym": True, "sleeve": {"sleeveless": True}, "collar": NECK, "shirt": {"width": 1.0}}
NAMES: list[tuple[dict[str, Any], set[str]]] = [
    ({"meta": SHIRT}, {"top", "shirt", "sleeveless", "round neck"}),
    ({"meta": SHIRT, "collar": {"f_collar": "VNeckHalf"}}, {"v-neck"}),
    ({"meta": SHIRT, "collar": {"component": {"style": "Hood2Panels"}}}, {"hooded"}),
    ({"meta": SHIRT, "left": {"enable_asym": True}}, {"asymmetric"}),
    ({"meta": SHIRT, "sleeve": LONG}, {"long sleeves"}),
    ({"meta": {"upper": "FittedShirt"}, "left": BARE}, {"fitted bodice", "one-shoulder", "sleeveless"}),
    ({"meta": {"upper": "FittedShirt"}, "left": BARE, "sleeve": SLEEVE}, {"one-shoulder", "uneven sleeves"}),
    ({"meta": SHIRT, "left": {"enable_asym": True}, "sleeve": SLEEVE}, {"uneven sleeves", "round neck"}),
    ({"meta": SHIRT, "left": {"enable_asym": True, "sleeve": SLEEVE}, "sleeve": SLEEVE}, {"short sleeves"}),
    ({"meta": SHIRT, "left": {"enable_asym": True, "sleeve": LONG}, "sleeve": SLEEVE}, {"uneven sleeves"}),
    ({"meta": SHIRT, "left": {"enable_asym": True, "collar": {"f_collar": "VNeckHalf"}}}, {"uneven neck"}),
    ({"meta": {"upper": "Shirt", "bottom": "Pants"}}, {"jumpsuit", "trousers"}),
    ({"meta": {"bottom": "Pants", "wb": "StraightWB"}}, {"trousers", "with waistband"}),
    ({"meta": {"bottom": "PencilSkirt"}}, {"pencil skirt"}),
    ({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"flare": 1.3}}, {"a-line skirt"}),
    ({"meta": {"bottom": "Skirt2", "wb": "StraightWB"}, "skirt": {"ruffle": 1.5}}, {"gathered skirt", "ruffled"}),
    ({"meta": {"bottom": "SkirtLevels"}, "levels-skirt": {"base": "SkirtCircle"}}, {"tiered skirt", "circle skirt"}),
    ({"meta": {"bottom": "AsymmSkirtCircle"}}, {"circle skirt", "asymmetric"}),
    ({"meta": {"upper": "Cape"}}, {"top", "cape"}),
    *(
        ({"meta": SHIRT, "front": {"closure": closure}}, {"top", tag})
        for closure, tag in (("open", "open front"), ("zip", "zip"), ("buttons", "buttons"))
    ),
    ({"meta": SHIRT, "pocket": {"chest": "left"}}, {"top", "pockets"}),
    ({"meta": {"bottom": "Pants"}, "pocket": {"back": "both"}}, {"trousers", "pockets"}),
]
STYLES: list[tuple[dict[str, Any], set[str], set[str]]] = [
    *((values, named, set[str]()) for values, named in NAMES),
    *(
        ({"meta": SKIRT, "flare_skirt": {"suns": suns}}, {"skirt", tag}, FLARED - {tag})
        for suns, tag in ((1.0, "circle skirt"), (0.5, "half-circle skirt"), (0.25, "a-line skirt"))
    ),
    *(
        ({"meta": SKIRT, "flare_skirt": {"length": length}}, {tag}, set())
        for length, tag in ((0.2, "mini"), (0.5, "knee-length"), (0.7, "midi"), (0.9, "maxi"))
    ),
    # A base that is sewn without its slits, and a slit too short to see.
    ({"meta": {"bottom": "PencilSkirt"}, "pencil_skirt": SLITS}, {"slit"}, set()),
    ({"meta": {"bottom": "GodetSkirt"}, "pencil_skirt": SLITS, **BASES}, {"pencil skirt"}, {"slit"}),
    ({"meta": {"bottom": "SkirtLevels"}, "pencil_skirt": SLITS, **BASES}, {"pencil skirt"}, {"slit"}),
    ({"meta": {"bottom": "PencilSkirt"}, "pencil_skirt": {"back_slit": 0.01}}, set(), {"slit"}),
    # On a band as long as its top, a skirt declared with gathers hangs straight.
    ({**GATHERED, "waistband": {"waist": 1.0}}, {"gathered skirt", "ruffled"}, set()),
    ({**GATHERED, "waistband": {"waist": 1.5}}, {"straight skirt"}, {"gathered skirt", "ruffled"}),
    # Flat sides meet in the middle before they reach the depth; an arc may bulge inwards.
    ({"meta": SHIRT, "collar": FLAT_SIDES}, {"v-neck"}, {"square neck"}),
    ({"meta": SHIRT, "collar": STEEP_SIDES}, {"square neck"}, {"v-neck"}),
    ({"meta": SHIRT, "collar": {"f_collar": "CircleArcNeckHalf"}}, {"round neck"}, set()),
    ({"meta": SHIRT, "collar": {"f_collar": "CircleArcNeckHalf", "f_flip_curve": True}}, set(), {"round neck"}),
    (STRAPLESS, {"fitted bodice", "strapless"}, {"round neck", "v-neck", "sleeveless"}),
    ({"meta": SHIRT, "left": LEFT | {"sleeve": SLEEVE}}, {"uneven sleeves"}, {"sleeveless"}),
    ({"meta": SHIRT | {"wb": "StraightWB"}}, set(), {"with waistband"}),
    ({"meta": {"upper": "Shirt", "bottom": "Pants", "wb": "StraightWB"}}, {"with waistband"}, set()),
    ({"meta": SHIRT, "sleeve": WIDE_SLEEVE | {"cuff": CUFF}}, set(), {"ruffled"}),
    ({"meta": SHIRT, "sleeve": WIDE_SLEEVE | {"cuff": CUFF | {"skirt_ruffle": 1.0}}}, {"ruffled"}, set()),
    ({**HALVES, "left": LEFT}, set(), {"asymmetric"}),
    ({**HALVES, "left": LEFT | {"collar": NECK | {"width": 0.7}}}, {"asymmetric"}, set()),
]


@pytest.mark.parametrize(("values", "named", "others"), STYLES)
def test_tags_and_captions_name_what_is_drawn_and_not_what_is_declared(
    values: dict[str, Any], named: set[str], others: set[str]
) -> None:
    worn = drawn(WOMAN, **values)
    found = set(garment_tags(*worn))
    assert named <= found
    assert not others & found
    agree_with_the_caption(worn, 0)


@pytest.mark.parametrize("size", [WOMAN, MAN, STOUT, replace(WOMAN, waist_line=39.4)])
def test_a_limit_itself_belongs_to_the_same_style_for_every_wearer(size: Measurements) -> None:
    """Gathers of 1.2, a hem at 0.8 of the way to the floor, a waist seam at 0.92 of nape to waist."""
    sleeve = {"sleeveless": False, "connect_ruffle": 1.0, "cuff": {"type": "CuffBand", "top_ruffle": 1.2}}
    assert "ruffled" in garment_tags(*drawn(size, meta=SHIRT, sleeve=sleeve))
    assert "midi" in garment_tags(*drawn(size, meta=SKIRT, flare_skirt={"length": 0.8}))
    dress = drawn(size, meta={"upper": "Shirt", "bottom": "Skirt2"}, shirt={"length": 0.92})
    assert "seam at the natural waist" in dress.captions()["full"]


def test_every_garment_has_one_kind_and_words_of_the_vocabulary(wardrobe: list[Worn]) -> None:
    for worn in wardrobe:
        found = garment_tags(*worn)
        assert set(found) <= set(TAGS)
        assert list(found) == sorted(set(found), key=TAGS.index)
        assert len({"top", "dress", "jumpsuit", "skirt"} & set(found)) == (0 if found[0] == "trousers" else 1)
        assert all(len(group & set(found)) <= 1 for group in ALONE)


def test_five_tiers_of_the_least_length_hang_lower_than_declared() -> None:
    """The tiers declare 2 cm each and are drawn 5 cm long: the hem is at least 15 cm lower."""
    section = {"length": 0.3, "base_length_frac": 0.6, "num_levels": 5, "base": "SkirtCircle", "level": "Skirt2"}
    worn = drawn(WOMAN, meta={"bottom": "SkirtLevels"}, levels_skirt=section)
    tiers = [np.ptp(worn.pattern.panel(f"skirt_front_{number}").vertices[:, 1]) for number in range(5)]
    assert np.allclose(tiers, 5.0)
    assert 0.3 + 15 / WOMAN.leg_length < hem_depth(WOMAN, worn.design)
    assert "mini" not in garment_tags(*worn)


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
    "open front": "open front|open from neck to hem", "zip": "zip", "buttons": "buttons",
    "pockets": "pockets?",
    "asymmetric": "asymmetric|one-shoulder|off-centre|off centre|high-low|longer behind",
}  # fmt: skip
"""Tag to words of which the full caption has one."""
MUTUAL = {
    "slit", "gathered skirt", "straight skirt", "godet skirt", "tiered skirt", "strapless", "lapel", "with waistband",
    "hooded", "zip", "buttons", "pockets", "asymmetric", "panelled skirt", "pencil skirt", "dress", "one-shoulder",
    "with cuffs",
}  # fmt: skip
"""Tags that a garment has if its full caption has one of the words."""


def test_tags_agree_with_the_full_caption(wardrobe: list[Worn]) -> None:
    for number, worn in enumerate(wardrobe):
        agree_with_the_caption(worn, number)
    assert {tag for worn in wardrobe for tag in garment_tags(*worn)} == set(TAGS)


def agree_with_the_caption(worn: Worn, number: int) -> None:
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
    tags = listed.partition("## Gathers")[0]
    rows = [line for line in tags.splitlines() if line.startswith("| `")]
    assert rows == [f"| `{tag.value}` | {tag.meaning} |" for tag in Tag]
