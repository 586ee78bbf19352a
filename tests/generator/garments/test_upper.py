"""Tops and their sleeves: lengths computed from the measures."""

from dataclasses import replace
from math import cos, radians, sin, tan
from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.faults import SHORTEST_EDGE
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.records import Measurements, Pattern
from tests.generator.garments.measured import TORSOS, edge_lengths, length, lengths

FITTED = {"upper": "FittedShirt"}
SHIRT = {"upper": "Shirt"}
STRAPLESS = {"meta": FITTED, "shirt": {"strapless": True}}


def labels(pattern: Pattern, panel: str) -> set[str]:
    return {edge.label for edge in pattern.panel(panel).edges} - {""}


def test_a_shirt_is_as_wide_as_the_bust_and_as_long_as_asked(woman: Measurements) -> None:
    design = design_from_dict({"meta": SHIRT, "shirt": {"width": 1.1, "flare": 1.0, "length": 1.3}})
    pattern = draw_garment(woman, design)
    assert lengths(pattern, "bottom", TORSOS) == pytest.approx(1.1 * woman.bust)
    # The armhole hangs from the shoulder line, which rises from the side's upper end to the shoulder's.
    rise = tan(woman.shoulder_incl) * (0.5 * 1.1 * woman.back_width - 0.5 * woman.sleeve_balance)
    side = 1.3 * woman.waist_line + rise - 1.2 * woman.eased_armscye_depth
    assert lengths(pattern, "side", ("right_btorso",)) == pytest.approx(side)


def test_shoulders_wider_than_the_shirt_are_refused(woman: Measurements) -> None:
    broad = replace(woman, shoulder_w=70.0)
    with pytest.raises(PatternError, match=r"has no room for armholes 34\.0 cm from the centre: raise shirt\.width"):
        draw_garment(broad, design_from_dict({"meta": SHIRT}))


@pytest.mark.parametrize("kind", ["ArmholeSquare", "ArmholeAngle", "ArmholeCurve"])
@pytest.mark.parametrize("meta", [SHIRT, FITTED])
def test_armholes_of_all_shapes_end_at_the_same_places(woman: Measurements, meta: dict[str, str], kind: str) -> None:
    plain = draw_garment(woman, design_from_dict({"meta": meta}))
    shaped = draw_garment(woman, design_from_dict({"meta": meta, "sleeve": {"armhole_shape": kind}}))
    for name in TORSOS:
        for edge in ("side", "shoulder", "centre"):
            assert lengths(shaped, edge, (name,)) == pytest.approx(lengths(plain, edge, (name,)))


def test_a_square_armhole_goes_in_and_then_up(woman: Measurements) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": SHIRT, "sleeve": {"armhole_shape": "ArmholeSquare"}}))
    inwards, upwards = sorted(edge_lengths(pattern.panel("left_btorso"), "armhole"))
    assert inwards == pytest.approx(0.5 * (1.05 * woman.back_width - woman.sleeve_balance))
    assert upwards == pytest.approx(1.2 * woman.eased_armscye_depth)


def test_a_fitted_shirt_closes_around_the_waist(wearer: Measurements) -> None:
    pattern = draw_garment(wearer, design_from_dict({"meta": FITTED}))
    fronts, backs = TORSOS[:2], TORSOS[2:]
    assert lengths(pattern, "bottom", fronts) == pytest.approx(wearer.waist - wearer.waist_back_width)
    # The back's waist is curved, and so a little longer than a straight line.
    assert lengths(pattern, "bottom", backs) == pytest.approx(wearer.waist_back_width, rel=0.02)


def test_the_side_dart_points_at_the_bust(woman: Measurements) -> None:
    panel = draw_garment(woman, design_from_dict({"meta": FITTED})).panel("left_ftorso")
    legs = [i for i, edge in enumerate(panel.edges) if edge.name.startswith("side_dart")]
    tip = panel.edge_ends(min(legs))[1]
    under, over = panel.edge_ends(min(legs))[0], panel.edge_ends(max(legs))[1]
    assert tip[1] == pytest.approx(0.5 * (under[1] + over[1]))
    assert abs(over[1] - under[1]) == pytest.approx(woman.waist_over_bust_line - woman.waist_line)


def test_a_waist_as_wide_as_the_bust_needs_no_dart(woman: Measurements) -> None:
    stout = replace(woman, waist=woman.bust + 4.0, waist_back_width=woman.back_width + 1.0)
    pattern = draw_garment(stout, design_from_dict({"meta": FITTED}))
    darts = {edge.name for name in TORSOS for edge in pattern.panel(name).edges if "dart" in edge.name}
    assert darts == {"side_dart.0", "side_dart.1"}
    assert lengths(pattern, "bottom", TORSOS[:2]) == pytest.approx(stout.waist - stout.waist_back_width)


def test_measures_without_room_for_a_side_dart_are_refused(woman: Measurements) -> None:
    flat = replace(woman, waist_over_bust_line=woman.waist_line)
    with pytest.raises(PatternError, match=r"right_ftorso: waist_over_bust_line of 35\.8 cm leaves no side dart"):
        draw_garment(flat, design_from_dict({"meta": FITTED}))


@pytest.mark.parametrize("sleeveless", [True, False])
@pytest.mark.parametrize("meta", [SHIRT, FITTED])
def test_the_deepest_armhole_leaves_side_to_sew(wearer: Measurements, meta: dict[str, str], sleeveless: bool) -> None:
    arm = {"connecting_width": 2.0, "sleeveless": sleeveless}
    pattern = draw_garment(wearer, design_from_dict({"meta": meta, "sleeve": arm, "shirt": {"length": 0.7}}))
    for name in TORSOS:
        assert min(edge_lengths(pattern.panel(name), "side")) >= 1.0 - 1e-9


def test_the_reference_cuts_through_the_side_of_a_back(woman: Measurements) -> None:
    design = design_from_dict({"meta": FITTED, "sleeve": {"connecting_width": 2.0}})
    message = r"an armhole 22\.9 cm deep .* room for 22\.8 cm: lower sleeve\.connecting_width"
    with pytest.raises(PatternError, match=message):
        draw_garment(woman, design, mends=ALL_MENDS - {Mend.ARMHOLE_ROOM})


def test_sides_of_a_strapless_top_are_equally_long(wearer: Measurements) -> None:
    pattern = draw_garment(wearer, design_from_dict(STRAPLESS))
    front, back = (lengths(pattern, "side", (name,)) for name in ("right_ftorso", "right_btorso"))
    assert front == pytest.approx(back)
    assert all(labels(pattern, name) == {"strapless_top"} for name in TORSOS)
    assert not {edge.name for name in TORSOS for edge in pattern.panel(name).edges} & {"neck", "shoulder", "armhole"}


def test_a_strapless_back_without_depth_ends_at_the_level_of_the_shoulder(woman: Measurements) -> None:
    panel = draw_garment(woman, design_from_dict(STRAPLESS | {"collar": {"bc_depth": 0.0}})).panel("right_btorso")
    level = woman.waist_line - tan(woman.shoulder_incl) * 0.5 * (woman.back_width - woman.shoulder_w)
    hollow = 0.25 * tan(woman.shoulder_incl) * 0.5 * woman.back_width
    assert sum(edge_lengths(panel, "centre")) == pytest.approx(level - hollow)


def test_only_fitted_shirts_are_strapless(woman: Measurements) -> None:
    asked = draw_garment(woman, design_from_dict({"meta": SHIRT, "shirt": {"strapless": True}}))
    assert asked == draw_garment(woman, design_from_dict({"meta": SHIRT}))


def test_halves_of_one_design_are_mirror_images(wearer: Measurements) -> None:
    for meta in (SHIRT, FITTED):
        pattern = draw_garment(wearer, design_from_dict({"meta": meta, "sleeve": {"sleeveless": False}}))
        for name in (panel.name for panel in pattern.panels if panel.name.startswith("right")):
            right, left = (pattern.panel(n) for n in (name, name.replace("right", "left")))
            # Both run counter-clockwise as seen from outside, so the image's loop runs the other way.
            image = np.roll(left.vertices[::-1], 1, axis=0) * (-1.0, 1.0)
            assert right.vertices == pytest.approx(image, abs=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_top_may_be_strapless_on_one_side(woman: Measurements, side: str) -> None:
    bare: dict[str, Any] = {"strapless": True}
    left = {"enable_asym": True, "shirt": bare if side == "left" else {}}
    values = {"meta": FITTED, "shirt": bare if side == "right" else {}, "collar": {"bc_depth": 0.5}, "left": left}
    pattern = draw_garment(woman, design_from_dict(values))
    other = "left" if side == "right" else "right"
    assert labels(pattern, f"{side}_ftorso") == {"strapless_top"}
    assert labels(pattern, f"{other}_ftorso") == {f"{other}_armhole", f"{other}_collar"}
    centres = {sum(edge_lengths(pattern.panel(f"{s}_btorso"), "centre")) for s in ("left", "right")}
    assert len(centres) == 2  # different lengths, sewn nevertheless
    joined = {frozenset((seam.left.panel, seam.right.panel)) for seam in pattern.seams}
    assert {frozenset(("left_ftorso", "right_ftorso")), frozenset(("left_btorso", "right_btorso"))} <= joined


def test_an_uneven_shirt_is_drawn_from_both_designs(woman: Measurements) -> None:
    values = {"width": 1.2, "flare": 1.0}
    left = {"enable_asym": True, "shirt": values, "collar": {"f_collar": "VNeckHalf", "width": 0.2}}
    right = {"width": 1.0, "flare": 1.0}
    pattern = draw_garment(woman, design_from_dict({"meta": SHIRT, "shirt": right, "left": left}))
    assert lengths(pattern, "bottom", ("right_ftorso", "right_btorso")) == pytest.approx(0.5 * woman.bust)
    assert lengths(pattern, "bottom", ("left_ftorso", "left_btorso")) == pytest.approx(0.6 * woman.bust)
    kinds = {
        side: {edge.curve.kind for edge in pattern.panel(f"{side}_ftorso").edges if edge.name == "neck"}
        for side in ("left", "right")
    }
    assert kinds == {"left": {"line"}, "right": {"circle"}}


def test_an_uneven_top_wears_no_collar(woman: Measurements) -> None:
    values = {"meta": SHIRT, "collar": {"component": {"style": "Turtle"}}, "left": {"enable_asym": True}}
    assert not any("collar" in panel.name for panel in draw_garment(woman, design_from_dict(values)).panels)


CAP = 0.1  # cm between a cap without its gathers and the armhole
ARMS: dict[str, dict[str, Any]] = {
    "plain": {},
    "gathered": {"connect_ruffle": 1.8},
    "raised": {"sleeve_angle": 10},
    "hanging": {"sleeve_angle": 50},
    "narrow": {"connecting_width": 0.0, "end_width": 0.2},
    "wide": {"connecting_width": 1.2, "end_width": 1.8},
    "wide, gathered and hanging": {"connecting_width": 0.8, "sleeve_angle": 45, "connect_ruffle": 1.5},
}


def sleeved(size: Measurements, *, upper: str = "Shirt", mends: frozenset[Mend] = ALL_MENDS, **sleeve: Any) -> Pattern:
    """A shirt with long sleeves; ``sleeve`` changes parameters of the sleeves."""
    values = {"meta": {"upper": upper}, "sleeve": {"length": 0.7, "sleeveless": False} | sleeve}
    return draw_garment(size, design_from_dict(values), mends=mends)


@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
@pytest.mark.parametrize("arm", ARMS)
def test_a_sleeve_without_its_gathers_fits_its_armhole(wearer: Measurements, upper: str, arm: str) -> None:
    pattern = sleeved(wearer, upper=upper, **ARMS[arm])
    cap = lengths(pattern, "opening", ("right_sleeve_f", "right_sleeve_b")) / ARMS[arm].get("connect_ruffle", 1)
    armhole = lengths(pattern, "armhole", ("right_ftorso", "right_btorso"))
    assert cap == pytest.approx(armhole, abs=CAP * max(1.0, wearer.height / 170))
    for edge in ("upper", "under"):
        front, back = (length(pattern.panel(f"right_sleeve_{half}"), edge) for half in "fb")
        assert front == pytest.approx(back, abs=0.6 * max(1.0, wearer.height / 170))


def test_a_sleeve_that_hangs_is_longer_over_the_arm_than_under_it(woman: Measurements) -> None:
    over_under = []
    for angle in (20, 35, 50):
        pattern = sleeved(woman, sleeve_angle=angle)
        over, under = (length(pattern.panel("right_sleeve_f"), edge) for edge in ("upper", "under"))
        over_under.append(over - under)
    assert 0 < over_under[0] < over_under[1] < over_under[2]


def test_sleeves_are_five_centimetres_to_a_whole_arm_long_and_no_narrower_than_the_wrist(woman: Measurements) -> None:
    whole = sleeved(woman, length=1.0).panel("left_sleeve_b")
    assert np.ptp(whole.vertices[:, 0]) == pytest.approx(woman.arm_length)
    panel = sleeved(woman, length=0.1, sleeve_angle=50, connecting_width=0.8).panel("right_sleeve_f")
    start, end = panel.edge_ends([edge.name for edge in panel.edges].index("under"))
    assert abs(end[0] - start[0]) == pytest.approx(5.0)
    pattern = sleeved(replace(woman, wrist=30.0), end_width=0.2)
    assert [length(pattern.panel(f"right_sleeve_{half}"), "end") for half in "fb"] == pytest.approx([15.0, 15.0])


def test_a_cuff_is_taken_off_the_sleeve(woman: Measurements) -> None:
    plain = sleeved(woman, end_width=1.0)
    cuffed = sleeved(woman, end_width=1.0, cuff={"type": "CuffBand", "cuff_len": 0.1})
    upper = length(plain.panel("right_sleeve_f"), "upper") - length(cuffed.panel("right_sleeve_f"), "upper")
    assert upper == pytest.approx(0.1 * woman.arm_length)
    assert length(cuffed.panel("sl_left_cuff_f"), "right") == pytest.approx(0.1 * woman.arm_length)


def test_a_standing_shoulder_continues_the_line_of_the_shoulder(woman: Measurements) -> None:
    stands: dict[str, Any] = {"standing_shoulder": True, "standing_shoulder_len": 6.0}
    panel = sleeved(woman, sleeve_angle=40, **stands).panel("right_sleeve_f")
    first, second = sorted(edge_lengths(panel, "upper"))
    assert first == pytest.approx(6.0)
    inwards = 6.0 * cos(radians(40) - woman.shoulder_incl)
    flat = sum(edge_lengths(sleeved(woman, sleeve_angle=40).panel("right_sleeve_f"), "upper"))
    assert second > flat - inwards
    level = stands | {"sleeve_angle": 10}
    assert len(edge_lengths(sleeved(woman, **level).panel("right_sleeve_f"), "upper")) == 1


def test_a_left_sleeve_can_differ(woman: Measurements) -> None:
    left = {"enable_asym": True, "sleeve": {"sleeveless": False, "length": 0.4, "cuff": {"type": "CuffSkirt"}}}
    pattern = draw_garment(woman, design_from_dict({"meta": {"upper": "Shirt"}, "left": left}))
    names = {panel.name for panel in pattern.panels if "torso" not in panel.name}
    assert names == {"left_sleeve_f", "left_sleeve_b", "sl_left_cuff_skirt_f", "sl_left_cuff_skirt_b"}
    assert all(panel.placement.translation[0] > 0 for panel in pattern.panels if "torso" not in panel.name)


def test_a_surplus_of_the_front_moves_to_the_back_if_it_can_be_sewn(woman: Measurements) -> None:
    def shortest(mends: frozenset[Mend]) -> float:
        sizes = [replace(woman, back_width=float(width)) for width in np.linspace(46.2, 48.4, 9)]
        backs = [sleeved(size, mends=mends).panel("right_sleeve_b") for size in sizes]
        return min(min(edge_lengths(back, "opening")) for back in backs)

    assert shortest(ALL_MENDS) > SHORTEST_EDGE
    assert shortest(ALL_MENDS - {Mend.SLEEVE_SURPLUS}) < SHORTEST_EDGE


def test_a_sleeve_starts_clear_of_a_wide_shirt(woman: Measurements) -> None:
    ours, reference = (
        draw_garment(woman, design_from_dict({"meta": {"upper": "Shirt"}, "shirt": {"width": 1.3, "flare": 1.6},
                                        "sleeve": {"sleeveless": False, "connect_ruffle": 2.0}}), mends=mends)
        for mends in (ALL_MENDS, ALL_MENDS - {Mend.SLEEVE_START})
    )  # fmt: skip
    moved = [p.panel("right_sleeve_f").placement.translation for p in (ours, reference)]
    along = (moved[0] - moved[1])[:2]
    assert np.linalg.norm(along) > 1.0
    assert along / np.linalg.norm(along) == pytest.approx([-cos(woman.arm_pose_angle), -sin(woman.arm_pose_angle)])
