"""Trousers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from gcd_dataset.curves import Line, sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.faults import check_pattern
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments.assembly import bottom_rise
from gcd_dataset.generator.garments.cuff import Cuff, PantsCuffDesign
from gcd_dataset.generator.garments.design import read_design
from gcd_dataset.generator.garments.pants import PANTS, PantsDesign, pants
from gcd_dataset.generator.pattern import Piece, assemble
from gcd_dataset.records import Measurements, Panel
from gcd_dataset.spec import read_pattern

OUTLINE = 0.2  # cm between this package's panels and the reference's

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


@pytest.mark.parametrize("name", DESIGNS)
def test_trousers_can_be_sewn(name: str, wearer: Measurements) -> None:
    pattern = assemble(pants(wearer, DESIGNS[name], rise=DESIGNS[name].rise), name)
    assert not [fault for fault in check_pattern(pattern) if fault.severity.value == "error"]


@pytest.mark.parametrize("name", SHORT)
def test_short_trousers_can_be_sewn(name: str, woman: Measurements) -> None:
    pattern = assemble(pants(woman, SHORT[name], rise=SHORT[name].rise), name)
    assert not [fault for fault in check_pattern(pattern) if fault.severity.value == "error"]


@pytest.mark.parametrize("rise", [0.5, 0.8, 1.0])
def test_the_waist_is_as_wide_as_the_body_at_the_rise(rise: float, wearer: Measurements) -> None:
    girth = rise * wearer.waist + (1 - rise) * wearer.hips
    assert pants(wearer, PantsDesign(), rise=rise).length("top") == pytest.approx(girth)


def test_the_hips_are_as_wide_as_the_body(wearer: Measurements) -> None:
    front, back = halves(wearer, PantsDesign())
    assert 2 * (across(front, "outside", "centre") + across(back, "outside", "centre")) == pytest.approx(wearer.hips)


def test_the_crotch_reaches_between_the_legs(wearer: Measurements) -> None:
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


def test_an_unflared_leg_has_straight_sides(woman: Measurements) -> None:
    front, _ = halves(woman, PantsDesign(flare=1.0))
    assert isinstance(front.outline.edge("outside").curve, Line)


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


def test_a_waist_as_wide_as_the_hips_needs_no_darts(woman: Measurements) -> None:
    straight = replace(woman, waist=woman.hips, waist_back_width=woman.hip_back_width)
    for piece in halves(straight, PantsDesign()):
        assert not [stroke.name for stroke in piece.outline.strokes if "dart" in stroke.name]


def test_a_waist_wider_than_the_hips_leans_out(woman: Measurements) -> None:
    stout = replace(woman, waist=woman.hips + 8, waist_back_width=woman.hip_back_width + 4)
    front, back = halves(stout, PantsDesign())
    assert across(front, "outside", "hip") == pytest.approx(-2.0)
    assert across(back, "outside", "hip") == pytest.approx(-2.0)


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


def test_a_cuff_is_the_hem_without_its_gathers(woman: Measurements) -> None:
    design = PantsDesign(length=0.7, flare=0.9, cuff=PantsCuffDesign(type=Cuff.BAND, top_ruffle=1.6))
    drawn = pants(woman, design, rise=1.0)
    hem, girth = (
        sum(drawn.piece(name.format(half)).outline.length(edge) for half in "fb")
        for name, edge in (("pant_{}_r", "hem"), ("pant_r_cuff_{}", "top"))
    )
    assert hem == pytest.approx(1.6 * girth)


def test_a_cuff_hangs_under_the_inner_end_of_the_hem(woman: Measurements) -> None:
    design = PantsDesign(length=0.7, cuff=PantsCuffDesign(type=Cuff.BAND, top_ruffle=1.6))
    drawn = pants(woman, design, rise=1.0)
    hem = np.concatenate([drawn.piece(f"pant_{half}_r").points("hem") for half in "fb"])
    top = np.concatenate([drawn.piece(f"pant_r_cuff_{half}").points("top") for half in "fb"])
    assert top[:, 0].max() == pytest.approx(hem[:, 0].max())
    assert top[:, 1] == pytest.approx(0.5 * (hem[:, 1].min() + hem[:, 1].max()) - 5.0)


def contour(panel: Panel) -> shapely.LineString:
    points = [sample_curve(*panel.edge_ends(i), edge.curve, 60) for i, edge in enumerate(panel.edges)]
    return shapely.LineString(np.concatenate(points) - panel.vertices[0])


@pytest.mark.parametrize("body", ["default_body", "random_body"])
@pytest.mark.parametrize("name", ["pants_cuff", "jumpsuit"])
def test_trousers_of_the_reference(name: str, body: str, examples: Path) -> None:
    folder = examples / "patterns" / name / body
    (path,) = folder.glob("*_specification.json")
    design = read_design(folder / "design_params.yaml")
    size = read_measurements(folder / "body_measurements.yaml")
    reference, ours = (
        read_pattern(path),
        assemble(pants(size, design.pants, rise=bottom_rise(design, frozenset())), name),
    )
    for panel in ours.panels:
        other = reference.panel(panel.name)
        assert shapely.hausdorff_distance(contour(panel), contour(other)) < OUTLINE
