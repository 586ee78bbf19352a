"""Skirts with godets, and skirts in levels."""

from math import hypot, isclose, sqrt

import pytest

from gcd_dataset.curves import curve_length
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.garments.assembly import bottom_rise
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.records import Measurements
from tests.generator.garments.skirts import BOTH, ends, length, lengths, skirt

# -------------------------------------------------------------------------------------------------------------- godets


GODETS = [
    {"insert_w": 15, "insert_depth": 20, "num_inserts": 4, "cuts_distance": 5},
    {"insert_w": 10, "insert_depth": 10, "num_inserts": 4, "cuts_distance": 0},  # the side is too short: shallow cuts
    {"insert_w": 20, "insert_depth": 15, "num_inserts": 12, "cuts_distance": 10},  # the hem is too short: 1 cm cuts
    {"insert_w": 15, "insert_depth": 15, "num_inserts": 6, "cuts_distance": 0},
    {"insert_w": 15, "insert_depth": 15, "num_inserts": 6, "cuts_distance": 1},
]


@pytest.mark.parametrize("godets", GODETS)
@pytest.mark.parametrize("base", ["Skirt2", "PencilSkirt"])
def test_the_sides_of_a_godet_are_as_long_as_its_cut(wearer: Measurements, base: str, godets: dict[str, int]) -> None:
    design = {"godet-skirt": godets | {"base": base}, "skirt": {"length": 0.6, "bottom_cut": 0.5}}
    pattern = skirt(wearer, Bottom.GODET, design | {"pencil-skirt": {"length": 0.6, "left_slit": 0.4}})
    inserts = [panel for panel in pattern.panels if panel.name.startswith("ins_")]
    assert len(inserts) == godets["num_inserts"]
    by_name = {panel.name: panel for panel in pattern.panels}
    for seam in pattern.seams:
        if "ins" not in seam.left.panel:
            continue
        left, right = (by_name[side.panel].edges[side.edge] for side in (seam.left, seam.right))
        spans = [
            curve_length(*by_name[side.panel].edge_ends(side.edge), edge.curve)
            for side, edge in ((seam.left, left), (seam.right, right))
        ]
        assert spans[0] == pytest.approx(spans[1])
        assert right.name == f"cut_{seam.left.panel[-1]}_{left.name}"
    names = {edge.name for panel in pattern.panels for edge in panel.edges}
    assert not {"left_slit", "right_slit", "slit.0"} & names


def test_godets_divide_the_hem_and_are_numbered_from_the_right(woman: Measurements) -> None:
    pattern = skirt(woman, Bottom.GODET, {"godet-skirt": GODETS[0], "pencil-skirt": {"length": 0.6}})
    hem = woman.hips - woman.hip_back_width
    front, back = (pattern.panel(name) for name in BOTH)
    assert length(front, "bottom") == pytest.approx(2 * 5)  # the rest of the hem is cut open
    cut = hem / 2 - 5
    assert length(front, "cut_0_left") == pytest.approx(hypot(7.5, 20))
    (_, low), (_, high) = sorted(ends(front, "cut_0_left"), key=lambda point: point[1])
    assert high - low == pytest.approx(sqrt(hypot(7.5, 20) ** 2 - (cut / 2) ** 2))
    for panel in (front, back):
        tips = [min(ends(panel, f"cut_{i}_right"), key=lambda point: -point[1])[0] for i in range(2)]
        godets = [pattern.panel(f"ins_{panel.name}_{i}") for i in range(2)]
        places = [float(p.placement.apply(p.vertices)[:, 0].mean()) for p in godets]
        assert tips == sorted(tips)
        assert places == sorted(places)


def test_a_godet_too_narrow_for_its_share_of_the_hem_gets_a_flat_cut(woman: Measurements) -> None:
    pattern = skirt(woman, Bottom.GODET, {"godet-skirt": GODETS[1], "pencil-skirt": {"length": 0.6, "flare": 1.5}})
    (_, low), (_, high) = ends(pattern.panel("skirt_front"), "cut_0_left")
    assert abs(high - low) == pytest.approx(1.0)


def test_cuts_that_leave_no_hem_are_a_centimetre_wide(woman: Measurements) -> None:
    pattern = skirt(woman, Bottom.GODET, {"godet-skirt": GODETS[2], "pencil-skirt": {"length": 0.6, "flare": 0.8}})
    front = pattern.panel("skirt_front")
    (ax, _), (bx, _) = ends(front, "cut_3_left")
    assert abs(bx - ax) == pytest.approx(0.5)
    hem = woman.hips - woman.hip_back_width - 0.1 * woman.hips
    assert length(front, "bottom") == pytest.approx(hem - 6)


# -------------------------------------------------------------------------------------------------------------- levels


BASES = ("Skirt2", "PencilSkirt", "SkirtCircle", "AsymmSkirtCircle")
LEVELS = ("Skirt2", "SkirtCircle", "AsymmSkirtCircle")
CLOSED = {
    "pencil-skirt": {"front_slit": 0.4, "left_slit": 0.5, "low_angle": 8},
    "skirt": {"bottom_cut": 0.5, "ruffle": 1.4, "flare": 3, "rise": 0.7},
    "flare-skirt": {"suns": 0.4, "rise": 0.6, "cut": {"add": True}},
}


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("base", BASES)
def test_a_level_is_as_wide_as_the_hem_above_times_its_gathers(woman: Measurements, base: str, level: str) -> None:
    plan = {"base": base, "level": level, "num_levels": 2, "level_ruffle": 1.25, "length": 0.7}
    pattern = skirt(woman, Bottom.LEVELS, CLOSED | {"levels-skirt": plan})
    tags = ("", "_0", "_1")
    hems = [lengths(pattern, "bottom", tuple(name + suffix for name in BOTH)) for suffix in tags]
    tops = [lengths(pattern, "top", tuple(name + suffix for name in BOTH)) for suffix in tags]
    assert tops[1:] == pytest.approx([1.25 * hem for hem in hems[:-1]])
    joined = {frozenset((s.left.panel, s.right.panel)) for s in pattern.seams if s.left.panel != s.right.panel}
    assert {frozenset((name, name + "_0")) for name in BOTH} <= joined
    assert not joined & {frozenset(("skirt_front", "skirt_back_0"))}
    assert not {"left_slit", "slit.0", "hem_cut.0"} & {e.name for panel in pattern.panels for e in panel.edges}


@pytest.mark.parametrize("base", BASES[:3])
def test_base_and_levels_together_have_the_requested_length(woman: Measurements, base: str) -> None:
    plan = {"base": base, "level": "Skirt2", "num_levels": 3, "length": 0.8, "base_length_frac": 0.4}
    straight = {"skirt": {"flare": 0}, "levels-skirt": plan}
    pattern = skirt(woman, Bottom.LEVELS, straight)
    base_side = sum(length(pattern.panel("skirt_front"), edge) for edge in ("right", "right_hip"))
    levels = [length(pattern.panel(f"skirt_front_{i}"), "right") for i in range(3)]
    assert levels == pytest.approx([0.6 * 0.8 * woman.leg_length / 3] * 3)
    assert base_side == pytest.approx(woman.hips_line + 0.4 * 0.8 * woman.leg_length, rel=0.01)
    design = design_from_dict({"meta": {"upper": None, "bottom": "SkirtLevels"}, **straight})
    told = Bottom.LEVELS.garment.length(woman, design, bottom_rise(design))
    assert told == pytest.approx(woman.hips_line + 0.8 * woman.leg_length)


def test_levels_of_garmentcode_mix_the_hem_with_the_hips(woman: Measurements) -> None:
    plan = {"base": "Skirt2", "level": "Skirt2", "level_ruffle": 1.2}
    sections = {"levels-skirt": plan, "skirt": {"rise": 0.6, "ruffle": 1.5, "flare": 0}}
    pattern = skirt(woman, Bottom.LEVELS, sections, mends=frozenset())
    hem = 1.5 * woman.waist
    top = lengths(pattern, "top", ("skirt_front_0", "skirt_back_0"))
    assert top == pytest.approx(0.4 * woman.hips + 0.6 * 1.2 * hem)


def test_levels_hang_parallel_to_a_tilted_hem(woman: Measurements) -> None:
    sections = {"levels-skirt": {"base": "PencilSkirt"}, "pencil-skirt": {"low_angle": 15}, "skirt": {"flare": 0}}
    pattern = skirt(woman, Bottom.LEVELS, sections)
    (ax, ay), (bx, by) = ends(pattern.panel("skirt_front"), "bottom")
    (cx, cy), (dx, dy) = ends(pattern.panel("skirt_front_0"), "top")
    assert isclose((by - ay) / (bx - ax), (dy - cy) / (dx - cx), abs_tol=1e-9)
    assert max(cy, dy) < max(ay, by)
