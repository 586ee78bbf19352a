"""Cuffs of sleeves and trousers."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.faults import check_pattern
from gcd_dataset.generator.garments.cuff import (
    Cuff,
    PantsCuffDesign,
    SleeveCuffDesign,
    cuff,
    sleeve_cuff_length,
    with_sleeve_cuff,
)
from gcd_dataset.generator.garments.sleeve import SleeveDesign
from gcd_dataset.generator.pattern import Component, Outline, Piece, assemble
from gcd_dataset.records import Measurements, PanelRole

DESIGN = PantsCuffDesign(skirt_fraction=0.25, skirt_flare=1.5, skirt_ruffle=1.2)
PANELS = {
    Cuff.BAND: {"leg_cuff_f", "leg_cuff_b"},
    Cuff.SKIRT: {"leg_cuff_skirt_f", "leg_cuff_skirt_b"},
    Cuff.BAND_SKIRT: {"leg_cuff_f", "leg_cuff_b", "leg_cuff_skirt_f", "leg_cuff_skirt_b"},
}


def straight_sleeve(*, end: float, height: float = 20.0) -> Component:
    """A sleeve of two trapezoids along the x axis, its wrist at x = 0."""
    outline = (
        Outline.start(0, 0)
        .line(0, -end, name="end")
        .line(30, -height, name="under")
        .line(30, 0, name="opening")
        .close(name="upper")
    )
    front, back = Piece("right_sleeve_f", outline).at(0, 0, 15), Piece("right_sleeve_b", outline).at(0, 0, -15)
    return (
        Component.of(front, back)
        .sewn(front.along("upper"), back.along("upper"))
        .sewn(front.along("under"), back.along("under"))
        .offering(
            opening=front.along("opening") + back.against("opening"), end=front.along("end") + back.against("end")
        )
        .labelled(PanelRole.ARM)
    )


def cuffed(kind: Cuff | None, **values: float) -> SleeveDesign:
    return SleeveDesign(length=0.6, cuff=SleeveCuffDesign(type=kind, **values))


@pytest.mark.parametrize("kind", Cuff)
def test_the_top_is_as_long_as_the_girth_of_the_limb(kind: Cuff) -> None:
    drawn = cuff("leg", 40.0, 12.0, kind, DESIGN)
    gathered = DESIGN.skirt_ruffle if kind is Cuff.SKIRT else 1.0
    assert drawn.length("top") == pytest.approx(40.0 * gathered)
    assert {piece.name for piece in drawn.pieces} == PANELS[kind]


@pytest.mark.parametrize("kind", Cuff)
def test_the_parts_of_a_cuff_add_up_to_its_length(kind: Cuff) -> None:
    fronts = [piece for piece in cuff("leg", 40.0, 12.0, kind, DESIGN).pieces if piece.name.endswith("_f")]
    assert sum(np.ptp(piece.outline.points()[:, 1]) for piece in fronts) == pytest.approx(12.0)


def test_the_hem_of_a_skirt_is_its_gathered_top_and_the_flare_at_four_sides() -> None:
    drawn = cuff("leg", 40.0, 12.0, Cuff.SKIRT, DESIGN)
    hem = sum(piece.outline.length("bottom") for piece in drawn.pieces)
    assert hem == pytest.approx(40.0 * 1.2 + 4 * 0.5 * 20.0)


def test_the_skirt_hangs_under_the_band() -> None:
    drawn = cuff("leg", 40.0, 12.0, Cuff.BAND_SKIRT, DESIGN)
    band, skirt = drawn.piece("leg_cuff_f"), drawn.piece("leg_cuff_skirt_f")
    assert np.ptp(band.outline.points()[:, 1]) == pytest.approx(9.0)
    assert skirt.points("top")[:, 1].max() == pytest.approx(band.points("bottom")[:, 1].min() - 2.0)
    assert skirt.points().mean(axis=0)[[0, 2]] == pytest.approx([0.0, 15.0])


def test_a_cuff_without_length_is_refused() -> None:
    with pytest.raises(PatternError, match=r"pant_r_cuff is 0\.05 cm long"):
        cuff("pant_r", 40.0, 0.05, Cuff.BAND, DESIGN)
    with pytest.raises(PatternError, match=r"pant_r_cuff_skirt is 0\.05 cm long"):
        cuff("pant_r", 40.0, 0.2, Cuff.BAND_SKIRT, DESIGN)


def test_a_cuff_covers_its_share_of_the_arm_but_no_more_than_seven_tenths_of_the_sleeve(woman: Measurements) -> None:
    assert sleeve_cuff_length(woman, cuffed(None)) == 0.0
    assert sleeve_cuff_length(woman, cuffed(Cuff.BAND, cuff_len=0.2)) == pytest.approx(0.2 * woman.arm_length)
    assert sleeve_cuff_length(woman, cuffed(Cuff.BAND, cuff_len=0.9)) == pytest.approx(0.42 * woman.arm_length)


def test_a_sleeve_without_cuff_is_unchanged(woman: Measurements) -> None:
    sleeve = straight_sleeve(end=14.0)
    assert with_sleeve_cuff(woman, cuffed(None), sleeve) is sleeve


@pytest.mark.parametrize("kind", Cuff)
def test_a_sleeve_with_a_cuff_can_be_sewn(kind: Cuff, wearer: Measurements) -> None:
    sleeve = straight_sleeve(end=14.0 * wearer.wrist / 16.0)
    sewn = with_sleeve_cuff(wearer, cuffed(kind, top_ruffle=1.5), sleeve)
    assert sewn.interface("opening") == sleeve.interface("opening")
    assert {piece.label for piece in sewn.pieces} == {"arm"}
    assert not [fault for fault in check_pattern(assemble(sewn, "sleeve")) if fault.severity.value == "error"]


def test_gathers_narrow_the_cuff_down_to_the_wrist(woman: Measurements) -> None:
    wide = with_sleeve_cuff(woman, cuffed(Cuff.BAND, top_ruffle=2.0), straight_sleeve(end=24.0))
    tight = with_sleeve_cuff(woman, cuffed(Cuff.BAND, top_ruffle=3.0), straight_sleeve(end=10.0))
    assert sum(wide.piece(f"sl_right_cuff_{half}").outline.length("top") for half in "fb") == pytest.approx(24.0)
    assert sum(tight.piece(f"sl_right_cuff_{half}").outline.length("top") for half in "fb") == pytest.approx(
        woman.wrist
    )


@pytest.mark.parametrize("kind", Cuff)
def test_a_cuff_is_placed_beyond_the_wrist_level_with_the_top_of_the_sleeve(kind: Cuff, woman: Measurements) -> None:
    sewn = with_sleeve_cuff(woman, cuffed(kind, skirt_ruffle=1.0), straight_sleeve(end=24.0))
    top = sewn.piece("sl_right_cuff_skirt_f" if kind is Cuff.SKIRT else "sl_right_cuff_f").points("top")
    assert top[:, 0] == pytest.approx([-2.0, -2.0])
    assert top[:, 1].max() == pytest.approx(0.0)
    assert {round(float(piece.translation[2])) for piece in sewn.pieces} == {15, -15}
    assert all(piece.rotation[2] == -pi / 2 for piece in sewn.pieces if "cuff" in piece.name)


def test_the_left_cuff_is_the_mirror_image(woman: Measurements) -> None:
    right = with_sleeve_cuff(woman, cuffed(Cuff.BAND_SKIRT), straight_sleeve(end=24.0))
    left = right.mirrored("right", "left")
    assert left.piece("sl_left_cuff_skirt_b").points() == pytest.approx(
        right.piece("sl_right_cuff_skirt_b").points() * [-1, 1, 1]
    )


def test_the_design_may_come_from_trousers_or_sleeves() -> None:
    worn = SleeveCuffDesign(skirt_fraction=0.25, skirt_flare=1.5, skirt_ruffle=1.2)
    assert cuff("leg", 40.0, 12.0, Cuff.SKIRT, worn) == cuff(
        "leg", 40.0, 12.0, Cuff.SKIRT, replace(DESIGN, cuff_len=0.2)
    )
