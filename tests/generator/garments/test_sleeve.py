"""Sleeves fit their armholes, and have the length and width of their design."""

from dataclasses import replace
from math import cos, radians
from typing import Any

import numpy as np
import pytest

from gcd_dataset.curves import curve_length
from gcd_dataset.faults import SHORTEST_EDGE
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.records import Measurements, Panel, Pattern

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


def edge_lengths(panel: Panel, name: str) -> list[float]:
    return [curve_length(*panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges) if edge.name == name]


def length(pattern: Pattern, panel: str, edge: str) -> float:
    return sum(edge_lengths(pattern.panel(panel), edge))


@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
@pytest.mark.parametrize("arm", ARMS)
def test_a_sleeve_without_its_gathers_fits_its_armhole(wearer: Measurements, upper: str, arm: str) -> None:
    pattern = sleeved(wearer, upper=upper, **ARMS[arm])
    cap = sum(length(pattern, f"right_sleeve_{half}", "opening") for half in "fb") / ARMS[arm].get("connect_ruffle", 1)
    armhole = sum(length(pattern, f"right_{half}torso", "armhole") for half in "fb")
    assert cap == pytest.approx(armhole, abs=CAP * max(1.0, wearer.height / 170))


@pytest.mark.parametrize("arm", ARMS)
def test_both_halves_of_a_sleeve_match_along_the_arm(woman: Measurements, arm: str) -> None:
    pattern = sleeved(woman, **ARMS[arm])
    for edge in ("upper", "under"):
        front, back = (length(pattern, f"right_sleeve_{half}", edge) for half in "fb")
        assert front == pytest.approx(back, abs=0.6)


def test_a_sleeve_that_hangs_is_longer_over_the_arm_than_under_it(woman: Measurements) -> None:
    over_under = []
    for angle in (20, 35, 50):
        pattern = sleeved(woman, sleeve_angle=angle)
        over, under = (length(pattern, "right_sleeve_f", edge) for edge in ("upper", "under"))
        over_under.append(over - under)
    assert 0 < over_under[0] < over_under[1] < over_under[2]


def test_a_longer_sleeve_ends_nearer_the_wrist(woman: Measurements) -> None:
    short, long = (sleeved(woman, length=share, end_width=1.0) for share in (0.2, 0.8))
    assert length(long, "right_sleeve_f", "under") > 3 * length(short, "right_sleeve_f", "under")
    assert length(long, "right_sleeve_f", "upper") < woman.arm_length


def test_a_sleeve_of_full_length_ends_at_the_wrist(woman: Measurements) -> None:
    panel = sleeved(woman, length=1.0).panel("left_sleeve_b")
    assert np.ptp(panel.vertices[:, 0]) == pytest.approx(woman.arm_length)


def test_no_sleeve_is_shorter_than_five_centimetres_under_the_arm(woman: Measurements) -> None:
    panel = sleeved(woman, length=0.1, sleeve_angle=50, connecting_width=0.8).panel("right_sleeve_f")
    (under,) = (i for i, edge in enumerate(panel.edges) if edge.name == "under")
    start, end = panel.edge_ends(under)
    assert abs(end[0] - start[0]) == pytest.approx(5.0)


def test_no_sleeve_is_narrower_than_the_wrist(woman: Measurements) -> None:
    pattern = sleeved(replace(woman, wrist=30.0), end_width=0.2)
    assert length(pattern, "right_sleeve_f", "end") == pytest.approx(15.0)
    assert length(pattern, "right_sleeve_b", "end") == pytest.approx(15.0)


def test_a_cuff_is_taken_off_the_sleeve(woman: Measurements) -> None:
    plain = sleeved(woman, end_width=1.0)
    cuffed = sleeved(woman, end_width=1.0, cuff={"type": "CuffBand", "cuff_len": 0.1})
    upper = length(plain, "right_sleeve_f", "upper") - length(cuffed, "right_sleeve_f", "upper")
    assert upper == pytest.approx(0.1 * woman.arm_length)
    assert length(cuffed, "sl_left_cuff_f", "right") == pytest.approx(0.1 * woman.arm_length)


def test_a_standing_shoulder_continues_the_line_of_the_shoulder(woman: Measurements) -> None:
    stands: dict[str, Any] = {"standing_shoulder": True, "standing_shoulder_len": 6.0}
    panel = sleeved(woman, sleeve_angle=40, **stands).panel("right_sleeve_f")
    first, second = sorted(edge_lengths(panel, "upper"))
    assert first == pytest.approx(6.0)
    inwards = 6.0 * cos(radians(40) - woman.shoulder_incl)
    flat = sum(edge_lengths(sleeved(woman, sleeve_angle=40).panel("right_sleeve_f"), "upper"))
    assert second > flat - inwards


def test_a_shoulder_stands_only_where_the_sleeve_hangs(woman: Measurements) -> None:
    stands: dict[str, Any] = {"standing_shoulder": True, "sleeve_angle": 10}
    assert len(edge_lengths(sleeved(woman, **stands).panel("right_sleeve_f"), "upper")) == 1


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
    assert along / np.linalg.norm(along) == pytest.approx(
        [-np.cos(woman.arm_pose_angle), -np.sin(woman.arm_pose_angle)]
    )
