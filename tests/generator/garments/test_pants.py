"""Trousers, and the cuffs of sleeves and trousers."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.cuff import (
    Cuff,
    PantsCuffDesign,
    SleeveCuffDesign,
    cuff,
    sleeve_cuff_length,
    with_sleeve_cuff,
)
from gcd_dataset.generator.garments.pants import PANTS, PantsDesign, pants
from gcd_dataset.generator.garments.sleeve import SleeveDesign
from gcd_dataset.generator.pattern import Component, Outline, Piece, assemble
from gcd_dataset.records import Measurements, PanelRole
from tests.generator.garments.measured import errors

DESIGNS = {
    "plain": PantsDesign(),
    "flared": PantsDesign(length=0.9, flare=1.2),
    "tight": PantsDesign(length=0.9, flare=0.5),
    "band": PantsDesign(length=0.9, cuff=PantsCuffDesign(type=Cuff.BAND, top_ruffle=2.0)),
    "frill": PantsDesign(length=0.5, flare=0.7, cuff=PantsCuffDesign(type=Cuff.SKIRT, skirt_flare=2.0)),
    "both": PantsDesign(length=0.9, cuff=PantsCuffDesign(type=Cuff.BAND_SKIRT, cuff_len=0.4)),
}
SHORT = {  # not for dolls, whose legs are too short: the inside seam leans in by centimetres on every wearer
    "shorts on the hips": PantsDesign(length=0.2, rise=0.5, width=1.5),
    "short and tight": PantsDesign(length=0.21, flare=0.5),
    "mostly cuff": PantsDesign(length=0.9, cuff=PantsCuffDesign(type=Cuff.BAND_SKIRT, cuff_len=0.9)),
}


def halves(size: Measurements, design: PantsDesign, *, rise: float = 1.0) -> tuple[Piece, Piece]:
    drawn = pants(size, design, rise=rise)
    return drawn.piece("pant_f_r"), drawn.piece("pant_b_r")


def across(piece: Piece, first: str, second: str) -> float:
    """Horizontal distance from the end of edge ``first`` to the end of edge ``second`` [cm]."""
    return piece.outline.run(second)[-1].end[0] - piece.outline.run(first)[-1].end[0]


@pytest.mark.parametrize("name", DESIGNS | SHORT)
def test_trousers_can_be_sewn(name: str, wearer: Measurements) -> None:
    if name in SHORT and wearer.height < 100.0:
        return
    design = (DESIGNS | SHORT)[name]
    assert not errors(assemble(pants(wearer, design, rise=design.rise), name))


@pytest.mark.parametrize("rise", [0.5, 0.8, 1.0])
def test_the_waist_is_as_wide_as_the_body_at_the_rise(rise: float, wearer: Measurements) -> None:
    girth = rise * wearer.waist + (1 - rise) * wearer.hips
    assert pants(wearer, PantsDesign(), rise=rise).length("top") == pytest.approx(girth)


def test_the_hips_and_the_crotch_are_as_wide_as_the_body(wearer: Measurements) -> None:
    front, back = halves(wearer, PantsDesign())
    assert 2 * (across(front, "outside", "centre") + across(back, "outside", "centre")) == pytest.approx(wearer.hips)
    front, back = halves(wearer, PantsDesign(width=1.3))
    needed = wearer.leg_circ - wearer.hips / 2 + 5.0
    assert across(front, "centre", "crotch") + across(back, "centre", "crotch") == pytest.approx(1.3 * needed)


@pytest.mark.parametrize("flare", [0.5, 0.8, 1.2])
def test_flare_widens_the_hem_by_its_share_of_the_leg(flare: float, woman: Measurements) -> None:
    hems = [
        sum(np.ptp(piece.points("hem")[:, 0]) for piece in halves(woman, PantsDesign(length=0.8, flare=value)))
        for value in (1.0, flare)
    ]
    assert hems[1] - hems[0] == pytest.approx(woman.leg_circ * (flare - 1))


def test_centre_seams_hang_straight_and_meet_level_at_the_crotch(woman: Measurements) -> None:
    for piece in halves(woman, PantsDesign(length=0.8, flare=1.1)):
        crotch = piece.outline.edge("crotch")
        down, level = crotch.velocity(0.0), crotch.velocity(1.0)
        assert down[0] == pytest.approx(0.0, abs=1e-9)
        assert down[1] < 0 < level[0]
        assert level[1] == pytest.approx(0.0, abs=1e-9)
        assert piece.outline.edge("outside").velocity(1.0)[0] == pytest.approx(0.0, abs=1e-9)


def test_darts_take_in_the_rest_of_the_excess(woman: Measurements) -> None:
    front, back = halves(woman, PantsDesign())
    for piece, darts in ((front, ()), (back, ("inner_dart", "outer_dart"))):  # in front it is under half a centimetre
        mouths = 0.0
        for name in darts:
            into, out = piece.outline.edge(f"{name}.0"), piece.outline.edge(f"{name}.1")
            assert into.length == pytest.approx(out.length)
            mouths += out.end[0] - into.start[0]
        assert piece.outline.length("top") + mouths == pytest.approx(across(piece, "hip", "top"))
    assert across(back, "hip", "top") - back.outline.length("top") > 3.0


@pytest.mark.parametrize("wider", [0.0, 8.0])
def test_a_waist_at_least_as_wide_as_the_hips_has_no_darts_and_leans_out(woman: Measurements, wider: float) -> None:
    stout = replace(woman, waist=woman.hips + wider, waist_back_width=woman.hip_back_width + 0.5 * wider)
    for piece in halves(stout, PantsDesign()):
        assert not [stroke.name for stroke in piece.outline.strokes if "dart" in stroke.name]
        assert across(piece, "outside", "hip") == pytest.approx(-0.25 * wider)


def test_legs_too_thin_for_the_hips_are_refused(woman: Measurements) -> None:
    with pytest.raises(PatternError, match=r"raise pants\.width"):
        pants(replace(woman, leg_circ=45.0), PantsDesign(), rise=1.0)


def test_the_waist_hangs_at_the_waist_and_the_crotch_beside_the_axis(wearer: Measurements) -> None:
    for piece in halves(wearer, PantsDesign()):
        assert piece.points("top")[:, 1] == pytest.approx(wearer.waist_level)
        assert piece.points("crotch")[:, 0].max() == pytest.approx(-0.5)


def test_the_left_leg_is_the_mirror_image_of_the_right(woman: Measurements) -> None:
    drawn = pants(woman, SHORT["mostly cuff"], rise=0.7)
    rights = [piece for piece in drawn.pieces if "_r" in piece.name]
    assert len(rights) == len(drawn.pieces) // 2
    for piece in rights:
        image = drawn.piece(piece.name.replace("_r", "_l"))
        assert image.points() == pytest.approx(piece.points() * [-1, 1, 1])


@pytest.mark.parametrize("cuff_len", [0.05, 0.3, 0.9])
def test_a_cuff_shortens_the_leg_to_no_less_than_a_fifth(cuff_len: float, woman: Measurements) -> None:
    design = PantsDesign(length=0.7, cuff=PantsCuffDesign(type=Cuff.BAND, cuff_len=cuff_len))
    drawn = pants(woman, design, rise=1.0)
    leg = drawn.piece("pant_f_r").outline.length("outside")
    assert leg == pytest.approx(max(0.7 - cuff_len, 0.2) * woman.leg_length)
    assert leg + drawn.piece("pant_r_cuff_f").outline.length("left") == pytest.approx(0.7 * woman.leg_length)
    assert PANTS.length_of(woman, design, 1.0) == pytest.approx(woman.hips_line + 0.7 * woman.leg_length)


def test_a_cuff_is_the_hem_without_its_gathers_and_hangs_under_its_inner_end(woman: Measurements) -> None:
    design = PantsDesign(length=0.7, flare=0.9, cuff=PantsCuffDesign(type=Cuff.BAND, top_ruffle=1.6))
    drawn = pants(woman, design, rise=1.0)
    legs, cuffs = ([drawn.piece(name.format(half)) for half in "fb"] for name in ("pant_{}_r", "pant_r_cuff_{}"))
    girth = sum(cuff.outline.length("top") for cuff in cuffs)
    assert sum(leg.outline.length("hem") for leg in legs) == pytest.approx(1.6 * girth)
    hem = np.concatenate([leg.points("hem") for leg in legs])
    top = np.concatenate([cuff.points("top") for cuff in cuffs])
    assert top[:, 0].max() == pytest.approx(hem[:, 0].max())
    assert top[:, 1] == pytest.approx(0.5 * (hem[:, 1].min() + hem[:, 1].max()) - 5.0)


CUFF = PantsCuffDesign(skirt_fraction=0.25, skirt_flare=1.5, skirt_ruffle=1.2)
CUFF_PANELS = {
    Cuff.BAND: {"leg_cuff_f", "leg_cuff_b"},
    Cuff.SKIRT: {"leg_cuff_skirt_f", "leg_cuff_skirt_b"},
    Cuff.BAND_SKIRT: {"leg_cuff_f", "leg_cuff_b", "leg_cuff_skirt_f", "leg_cuff_skirt_b"},
}


def straight_sleeve(*, end: float) -> Component:
    """A sleeve of two trapezoids along the x axis, its wrist at x = 0."""
    outline = Outline.start(0, 0).line(0, -end, name="end").line(30, -20, name="under")
    outline = outline.line(30, 0, name="opening").close(name="upper")
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
def test_the_top_is_as_long_as_the_girth_of_the_limb_and_the_parts_add_up_to_the_length(kind: Cuff) -> None:
    drawn = cuff("leg", 40.0, 12.0, kind, CUFF)
    gathered = CUFF.skirt_ruffle if kind is Cuff.SKIRT else 1.0
    assert drawn.length("top") == pytest.approx(40.0 * gathered)
    assert {piece.name for piece in drawn.pieces} == CUFF_PANELS[kind]
    fronts = [piece for piece in drawn.pieces if piece.name.endswith("_f")]
    assert sum(np.ptp(piece.outline.points()[:, 1]) for piece in fronts) == pytest.approx(12.0)


def test_the_hem_of_a_skirt_is_its_gathered_top_and_the_flare_at_four_sides() -> None:
    drawn = cuff("leg", 40.0, 12.0, Cuff.SKIRT, CUFF)
    hem = sum(piece.outline.length("bottom") for piece in drawn.pieces)
    assert hem == pytest.approx(40.0 * 1.2 + 4 * 0.5 * 20.0)


def test_the_skirt_hangs_under_the_band() -> None:
    drawn = cuff("leg", 40.0, 12.0, Cuff.BAND_SKIRT, CUFF)
    band, skirt = drawn.piece("leg_cuff_f"), drawn.piece("leg_cuff_skirt_f")
    assert np.ptp(band.outline.points()[:, 1]) == pytest.approx(9.0)
    assert skirt.points("top")[:, 1].max() == pytest.approx(band.points("bottom")[:, 1].min() - 2.0)
    assert skirt.points().mean(axis=0)[[0, 2]] == pytest.approx([0.0, 15.0])


def test_a_cuff_without_length_is_refused() -> None:
    with pytest.raises(PatternError, match=r"pant_r_cuff is 0\.05 cm long"):
        cuff("pant_r", 40.0, 0.05, Cuff.BAND, CUFF)
    with pytest.raises(PatternError, match=r"pant_r_cuff_skirt is 0\.05 cm long"):
        cuff("pant_r", 40.0, 0.2, Cuff.BAND_SKIRT, CUFF)


def test_a_cuff_covers_its_share_of_the_arm_but_no_more_than_seven_tenths_of_the_sleeve(woman: Measurements) -> None:
    assert sleeve_cuff_length(woman, cuffed(None)) == 0.0
    assert sleeve_cuff_length(woman, cuffed(Cuff.BAND, cuff_len=0.2)) == pytest.approx(0.2 * woman.arm_length)
    assert sleeve_cuff_length(woman, cuffed(Cuff.BAND, cuff_len=0.9)) == pytest.approx(0.42 * woman.arm_length)
    sleeve = straight_sleeve(end=14.0)
    assert with_sleeve_cuff(woman, cuffed(None), sleeve) is sleeve


@pytest.mark.parametrize("kind", Cuff)
def test_a_sleeve_with_a_cuff_can_be_sewn(kind: Cuff, wearer: Measurements) -> None:
    sleeve = straight_sleeve(end=14.0 * wearer.wrist / 16.0)
    sewn = with_sleeve_cuff(wearer, cuffed(kind, top_ruffle=1.5), sleeve)
    assert sewn.interface("opening") == sleeve.interface("opening")
    assert {piece.label for piece in sewn.pieces} == {"arm"}
    assert not errors(assemble(sewn, "sleeve"))


def test_gathers_narrow_the_cuff_down_to_the_wrist(woman: Measurements) -> None:
    for gathers, end, girth in ((2.0, 24.0, 24.0), (3.0, 10.0, woman.wrist)):
        sewn = with_sleeve_cuff(woman, cuffed(Cuff.BAND, top_ruffle=gathers), straight_sleeve(end=end))
        tops = [sewn.piece(f"sl_right_cuff_{half}").outline.length("top") for half in "fb"]
        assert sum(tops) == pytest.approx(girth)


@pytest.mark.parametrize("kind", Cuff)
def test_a_cuff_is_placed_beyond_the_wrist_level_with_the_top_of_the_sleeve(kind: Cuff, woman: Measurements) -> None:
    sewn = with_sleeve_cuff(woman, cuffed(kind, skirt_ruffle=1.0), straight_sleeve(end=24.0))
    top = sewn.piece("sl_right_cuff_skirt_f" if kind is Cuff.SKIRT else "sl_right_cuff_f").points("top")
    assert top[:, 0] == pytest.approx([-2.0, -2.0])
    assert top[:, 1].max() == pytest.approx(0.0)
    assert {round(float(piece.translation[2])) for piece in sewn.pieces} == {15, -15}
    assert all(piece.rotation[2] == -pi / 2 for piece in sewn.pieces if "cuff" in piece.name)
