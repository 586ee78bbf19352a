"""Skirts: girths, lengths and seams computed from the measures."""

from dataclasses import replace
from math import hypot, isclose, pi, radians, sqrt, tan

import numpy as np
import pytest

from gcd_dataset.curves import Arc
from gcd_dataset.errors import BodyError, PatternError
from gcd_dataset.generator.garments.garment import Cutting
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.pencil_skirt import PencilSkirtDesign, pencil_skirt
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.records import Measurements
from tests.generator.garments.measured import BOTH, ends, errors, length, lengths, ref_length, skirt


def test_a_gathered_skirt_is_gathered_to_the_waist_and_flares_at_each_side(woman: Measurements) -> None:
    pattern = skirt(woman, Bottom.GATHERED, {"skirt": {"ruffle": 1.5, "flare": 7, "length": 0.4}})
    assert lengths(pattern, "top") == pytest.approx(1.5 * woman.waist)
    assert length(pattern.panel("skirt_back"), "top") == pytest.approx(1.5 * woman.waist_back_width)
    assert lengths(pattern, "bottom") == pytest.approx(1.5 * woman.waist + 4 * 7)
    height = woman.hips_line + 0.4 * woman.leg_length
    assert length(pattern.panel("skirt_front"), "right") == pytest.approx(hypot(7, height))


@pytest.mark.parametrize("rise", [0.5, 0.8])
def test_a_low_skirt_is_as_wide_as_the_trunk_where_it_sits(woman: Measurements, rise: float) -> None:
    pattern = skirt(woman, Bottom.GATHERED, {"skirt": {"ruffle": 1.0, "rise": rise}})
    assert lengths(pattern, "top") == pytest.approx(rise * woman.waist + (1 - rise) * woman.hips)


def test_slits_take_their_share_of_the_skirt_below_the_hips(woman: Measurements) -> None:
    design = {"skirt": {"length": 0.6, "bottom_cut": 0.5, "flare": 0}}
    pattern = skirt(woman, Bottom.GATHERED, design)
    assert length(pattern.panel("skirt_front"), "left_slit") == pytest.approx(0.5 * 0.6 * woman.leg_length)
    assert length(pattern.panel("skirt_front"), "left") == pytest.approx(woman.hips_line + 0.3 * woman.leg_length)
    pattern = skirt(woman, Bottom.GATHERED, design, mends=frozenset())
    assert length(pattern.panel("skirt_back"), "right_slit") == pytest.approx(0.3)


@pytest.mark.parametrize("mends", [ALL_MENDS, frozenset()])
def test_a_skirt_that_ends_above_the_hips_has_no_slits(woman: Measurements, mends: frozenset[Mend]) -> None:
    pattern = skirt(woman, Bottom.GATHERED, {"skirt": {"length": -0.1, "bottom_cut": 0.5}}, mends=mends)
    assert len(pattern.panel("skirt_front").edges) == 4


@pytest.mark.parametrize("kind", [Bottom.GATHERED, Bottom.CIRCLE, Bottom.PANELS])
def test_no_skirt_is_shorter_than_five_centimetres(woman: Measurements, kind: Bottom) -> None:
    above_hips = {"length": -0.2, "rise": 0.5}
    pattern = skirt(woman, kind, {"skirt": above_hips | {"flare": 0}, "flare-skirt": above_hips})
    top = max(panel.placement.apply(panel.vertices)[:, 1].max() for panel in pattern.panels)
    assert top == pytest.approx(woman.waist_level)
    assert 5.0 <= min(length(panel, "right") for panel in pattern.panels) + 1e-9 < 7.0


def test_a_pencil_skirt_goes_round_the_hips_and_its_darts_take_it_in_to_the_waist(wearer: Measurements) -> None:
    pattern = skirt(wearer, Bottom.PENCIL, {"pencil-skirt": {"length": 0.5}})
    assert lengths(pattern, "bottom") == pytest.approx(wearer.hips)
    assert lengths(pattern, "top") == pytest.approx(wearer.waist)
    assert length(pattern.panel("skirt_back"), "top") == pytest.approx(wearer.waist_back_width)


def test_a_waist_over_the_hips_needs_no_darts(woman: Measurements) -> None:
    barrel = replace(woman, waist=woman.hips + 6, waist_back_width=woman.hip_back_width + 3)
    pattern = skirt(barrel, Bottom.PENCIL, {})
    assert len(pattern.panel("skirt_back").edges) == 6
    assert lengths(pattern, "top") == pytest.approx(barrel.waist)


@pytest.mark.parametrize("flare", [0.7, 1.4])
def test_flare_scales_the_hem_of_a_pencil_skirt(woman: Measurements, flare: float) -> None:
    pattern = skirt(woman, Bottom.PENCIL, {"pencil-skirt": {"flare": flare, "length": 0.6}})
    assert lengths(pattern, "bottom") == pytest.approx(flare * woman.hips)
    assert not errors(pattern)


@pytest.mark.parametrize("angle", [-20, 15])
def test_the_hem_falls_to_the_wearers_left_by_the_angle(woman: Measurements, angle: int) -> None:
    pattern = skirt(woman, Bottom.PENCIL, {"pencil-skirt": {"low_angle": angle, "length": 0.6}})
    for panel in pattern.panels:
        a, b = ends(panel, "bottom")
        right, left = sorted((a, b))
        assert (right[1] - left[1]) / (left[0] - right[0]) == pytest.approx(tan(radians(angle)))
    assert not errors(pattern)


def test_a_slit_in_the_hem_is_as_deep_as_asked_and_in_its_middle(woman: Measurements) -> None:
    design = {"pencil-skirt": {"front_slit": 0.5, "back_slit": 0.0, "length": 0.6}}
    pattern = skirt(woman, Bottom.PENCIL, design)
    front = pattern.panel("skirt_front")
    assert length(front, "slit.0") == pytest.approx(hypot(1.0, 0.3 * woman.leg_length))
    assert length(front, "bottom") == pytest.approx(woman.hips - woman.hip_back_width - 2.0)
    assert "slit.0" not in {edge.name for edge in pattern.panel("skirt_back").edges}


@pytest.mark.parametrize("flare", [1.0, 1.3])
def test_a_slit_in_the_side_leaves_the_seam_above_it(woman: Measurements, flare: float) -> None:
    design = {"pencil-skirt": {"left_slit": 0.25, "flare": flare, "length": 0.6}}
    pattern = skirt(woman, Bottom.PENCIL, design)
    sewn = {(side.panel, side.edge) for seam in pattern.seams for side in (seam.left, seam.right)}
    for panel in pattern.panels:
        below = length(panel, "left", "left_slit")
        assert length(panel, "left_slit") == pytest.approx(0.25 * below)
        assert length(panel, "right") == pytest.approx(below)
        (slit,) = (i for i, edge in enumerate(panel.edges) if edge.name == "left_slit")
        assert (panel.name, slit) not in sewn
        middle = 0.5 * (ends(panel, "bottom")[0][0] + ends(panel, "bottom")[1][0])
        assert ends(panel, "left_slit")[0][0] > middle  # the wearer's left is +x


@pytest.mark.parametrize(
    ("measures", "design", "message"),
    [
        ({}, {"style_side_cut": "Sun"}, r"pencil-skirt\.style_side_cut is Sun, but ornaments are not drawn: set it"),
        ({"bum_points": np.nan}, {}, "measures bum_points are missing"),
        ({"bum_points": 60.0}, {}, "skirt_back: a dart of .* does not fit a top of .* cm: correct the measures"),
    ],
)
def test_a_pencil_skirt_that_cannot_be_drawn_is_refused(
    woman: Measurements, measures: dict[str, float], design: dict[str, str], message: str
) -> None:
    with pytest.raises((BodyError, PatternError), match=message):
        skirt(replace(woman, **measures), Bottom.PENCIL, {"pencil-skirt": design})


def test_a_pencil_skirt_above_the_hips_is_refused(woman: Measurements) -> None:
    with pytest.raises(PatternError, match=r"a pencil skirt ends 12\.6 cm above the hips"):
        pencil_skirt(woman, PencilSkirtDesign(), Cutting(1.0, 10.0, ALL_MENDS))


def test_both_halves_of_an_asymmetric_circle_make_a_disk_with_a_hole(wearer: Measurements) -> None:
    design = {"flare-skirt": {"length": 0.5, "asymm": {"front_length": 0.4}}}
    pattern = skirt(wearer, Bottom.ASYMMETRIC_CIRCLE, design)
    whole = wearer.hips_line + 0.5 * wearer.leg_length
    hole = wearer.waist / (2 * pi)
    radius = hole + 0.5 * (1 + 0.4) * whole
    assert lengths(pattern, "bottom") == pytest.approx(2 * pi * radius)
    assert lengths(pattern, "top") == pytest.approx(wearer.waist)
    sides = {round(length(panel, side), 6) for panel in pattern.panels for side in ("left", "right")}
    assert len(sides) == 1
    front = pattern.panel("skirt_front")
    (hem,) = (edge.curve for edge in front.edges if edge.name == "bottom")
    assert isinstance(hem, Arc)
    (low,) = {round(float(y), 9) for _, y in front.vertices}
    drop = radius - sqrt(radius**2 - (hole + sides.pop()) ** 2)  # depth of the hem's arc
    assert low == 0.0
    assert drop == pytest.approx(hole + 0.4 * whole)


@pytest.mark.parametrize(("place", "panel", "side"), [(0.3, "skirt_front", -1), (-0.3, "skirt_back", 1)])
def test_a_hem_cut_is_counted_along_the_ring_of_the_hem(
    woman: Measurements, place: float, panel: str, side: int
) -> None:
    cut = {"add": True, "place": place, "width": 0.1, "depth": 0.2}
    pattern = skirt(woman, Bottom.CIRCLE, {"flare-skirt": {"length": 0.4, "suns": 0.5, "cut": cut}})
    opened = pattern.panel(panel)
    (tip, *_), _ = ends(opened, "hem_cut.0")
    assert tip * side > 0  # in front counted from the wearer's right (-x), behind from the left
    whole = woman.hips_line + 0.4 * woman.leg_length
    assert length(opened, "hem_cut.0") == pytest.approx(hypot(0.05, 0.2) * whole)
    (other,) = (p for p in pattern.panels if p.name != panel)
    assert len(other.edges) == 4
    assert not errors(pattern)


@pytest.mark.parametrize("place", [1.0, 0.01, -0.01, -1.0])
def test_a_hem_cut_over_the_end_of_the_hem_begins_at_the_side_seam(woman: Measurements, place: float) -> None:
    cut = {"add": True, "place": place, "width": 0.2, "depth": 0.2}
    pattern = skirt(woman, Bottom.CIRCLE, {"flare-skirt": {"length": 0.4, "suns": 0.5, "cut": cut}})
    opened = pattern.panel("skirt_front" if place > 0 else "skirt_back")
    assert sorted(edge.name for edge in opened.edges) == ["bottom", "hem_cut.0", "hem_cut.1", "left", "right", "top"]
    assert not errors(pattern)


@pytest.mark.parametrize("suns", [0.25, 1.0, 1.7])
def test_a_circle_skirt_is_as_wide_as_the_waist_and_its_hem_grows_by_the_suns(woman: Measurements, suns: float) -> None:
    pattern = skirt(woman, Bottom.CIRCLE, {"flare-skirt": {"suns": suns, "length": 0.4}})
    height = woman.hips_line + 0.4 * woman.leg_length
    assert lengths(pattern, "top") == pytest.approx(woman.waist)
    assert lengths(pattern, "right") == pytest.approx(2 * height)
    assert lengths(pattern, "bottom") == pytest.approx(woman.waist + 2 * pi * suns * height)


@pytest.mark.parametrize("count", [4, 7, 15])
def test_panels_share_the_waist_and_widen_as_a_circle_skirt_does(woman: Measurements, count: int) -> None:
    flare = {"length": 0.4, "suns": 0.7, "skirt-many-panels": {"n_panels": count}}
    pattern = skirt(woman, Bottom.PANELS, {"flare-skirt": flare})
    names = tuple(f"skirt_panel_{i}" for i in range(count))
    height = woman.hips_line + 0.4 * woman.leg_length
    assert {panel.name for panel in pattern.panels} == set(names)
    assert lengths(pattern, "top", names) == pytest.approx(woman.waist)
    assert lengths(pattern, "bottom", names) == pytest.approx(woman.waist + 2 * pi * 0.7 * height)


def test_panels_form_a_ring_that_begins_at_the_right(woman: Measurements) -> None:
    pattern = skirt(woman, Bottom.PANELS, {"flare-skirt": {"skirt-many-panels": {"n_panels": 6}}})
    panels = [pattern.panel(f"skirt_panel_{i}") for i in range(6)]
    places = np.array([panel.placement.apply(panel.vertices).mean(axis=0) for panel in panels])
    around = np.unwrap(np.arctan2(places[:, 2], places[:, 0]))
    assert places[0, 0] < 0 and abs(places[0, 2]) < -places[0, 0]
    assert np.diff(around) == pytest.approx(np.full(5, -pi / 3))  # over the front, which is +z, to the left
    joined = {frozenset((seam.left.panel, seam.right.panel)) for seam in pattern.seams}
    assert joined == {frozenset((f"skirt_panel_{i}", f"skirt_panel_{(i + 1) % 6}")) for i in range(6)}
    for panel, place in zip(panels, places, strict=True):
        assert float(panel.placement.matrix[:, 2] @ place) > 0


@pytest.mark.parametrize("bulge", [-0.15, 0.25, 0.45])
def test_a_bent_hem_bulges_by_its_share_of_the_chord(woman: Measurements, bulge: float) -> None:
    flare = {"length": 0.6, "suns": 0.3, "skirt-many-panels": {"n_panels": 8, "panel_curve": bulge}}
    panel = skirt(woman, Bottom.PANELS, {"flare-skirt": flare}).panel("skirt_panel_0")
    (index,) = (i for i, edge in enumerate(panel.edges) if edge.name == "bottom")
    start, end = panel.edge_ends(index)
    arc, chord = panel.edges[index].curve, abs(end[0] - start[0])
    assert isinstance(arc, Arc)
    sagitta = arc.radius - sqrt(arc.radius**2 - 0.25 * chord**2)
    assert sagitta == pytest.approx(abs(bulge) * chord)
    assert panel.vertices[:, 0].argmin() == 0 and end[0] > start[0]  # counter-clockwise
    assert arc.right is (bulge > 0)  # drawn from the wearer's right to left, right of the travel is down


@pytest.mark.parametrize("kind", [Bottom.PANELS, Bottom.ASYMMETRIC_CIRCLE, Bottom.GODET])
def test_an_impossible_cut_is_refused_with_the_parameter_to_change(woman: Measurements, kind: Bottom) -> None:
    wide = {"n_panels": 4, "panel_curve": -0.35}
    cut = {"add": True, "place": 0.5, "depth": 0.9}
    sections = {
        "flare-skirt": {"suns": 1.5, "length": 0.4, "skirt-many-panels": wide, "cut": cut},
        "godet-skirt": {"base": "Skirt2", "insert_depth": 40},
        "skirt": {"length": 0.0},
    }
    named = {
        Bottom.PANELS: r"bends inwards by 70 degrees .*: raise flare-skirt\.skirt-many-panels\.panel_curve",
        Bottom.ASYMMETRIC_CIRCLE: r"skirt_front: the tip .* is off the cloth: lower flare-skirt\.cut\.depth",
        Bottom.GODET: r"a cut .* cm deep in a skirt 22\.6 cm long: lower godet-skirt\.insert_depth",
    }
    with pytest.raises(PatternError, match=named[kind]):
        skirt(woman, kind, sections)


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
    for seam in (seam for seam in pattern.seams if "ins" in seam.left.panel):
        assert ref_length(pattern, seam.left) == pytest.approx(ref_length(pattern, seam.right))
        left, right = (pattern.panel(side.panel).edge(side.edge).name for side in (seam.left, seam.right))
        assert right == f"cut_{seam.left.panel[-1]}_{left}"
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


def test_godets_too_narrow_for_the_hem_or_too_many_get_cuts_a_centimetre_deep_or_wide(woman: Measurements) -> None:
    pattern = skirt(woman, Bottom.GODET, {"godet-skirt": GODETS[1], "pencil-skirt": {"length": 0.6, "flare": 1.5}})
    (_, low), (_, high) = ends(pattern.panel("skirt_front"), "cut_0_left")
    assert abs(high - low) == pytest.approx(1.0)
    pattern = skirt(woman, Bottom.GODET, {"godet-skirt": GODETS[2], "pencil-skirt": {"length": 0.6, "flare": 0.8}})
    front = pattern.panel("skirt_front")
    (ax, _), (bx, _) = ends(front, "cut_3_left")
    assert abs(bx - ax) == pytest.approx(0.5)
    hem = woman.hips - woman.hip_back_width - 0.1 * woman.hips
    assert length(front, "bottom") == pytest.approx(hem - 6)


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
    pattern = skirt(woman, Bottom.LEVELS, {"skirt": {"flare": 0}, "levels-skirt": plan})
    base_side = length(pattern.panel("skirt_front"), "right", "right_hip")
    levels = [length(pattern.panel(f"skirt_front_{i}"), "right") for i in range(3)]
    assert levels == pytest.approx([0.6 * 0.8 * woman.leg_length / 3] * 3)
    assert base_side == pytest.approx(woman.hips_line + 0.4 * 0.8 * woman.leg_length, rel=0.01)


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
