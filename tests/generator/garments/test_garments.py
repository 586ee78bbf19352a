"""Single garments: lengths that a tailor can check with a tape."""

from collections.abc import Iterable
from dataclasses import replace
from math import pi, tan

import pytest

from gcd_dataset.curves import curve_length
from gcd_dataset.errors import BodyError, PatternError
from gcd_dataset.generator.garments import design_from_dict, outfit
from gcd_dataset.records import Measurements, Pattern

SKIRT = {"upper": None, "bottom": "SkirtCircle"}


def lengths(pattern: Pattern, panels: Iterable[str], edge: str) -> float:
    """Length of all edges of that name over these panels [cm]."""
    found = ((pattern.panel(name), name) for name in panels)
    return sum(
        curve_length(*panel.edge_ends(i), drawn.curve)
        for panel, _ in found
        for i, drawn in enumerate(panel.edges)
        if drawn.name == edge
    )


@pytest.mark.parametrize("suns", [0.25, 1.0, 1.7])
def test_a_circle_skirt_is_as_wide_as_the_waist_and_its_hem_grows_by_the_suns(woman: Measurements, suns: float) -> None:
    pattern = outfit(woman, design_from_dict({"meta": SKIRT, "flare-skirt": {"suns": suns, "length": 0.4}}))
    panels = ("skirt_front", "skirt_back")
    length = woman.hips_line + 0.4 * woman.leg_length
    assert lengths(pattern, panels, "top") == pytest.approx(woman.waist)
    assert lengths(pattern, panels, "right") == pytest.approx(2 * length)
    assert lengths(pattern, panels, "bottom") == pytest.approx(woman.waist + 2 * pi * suns * length)


@pytest.mark.parametrize("kind", ["StraightWB", "FittedWB"])
def test_a_waistband_closes_around_the_waist(woman: Measurements, kind: str) -> None:
    pattern = outfit(woman, design_from_dict({"meta": SKIRT | {"wb": kind}, "waistband": {"waist": 1.0}}))
    assert lengths(pattern, ("wb_front", "wb_back"), "top") == pytest.approx(woman.waist)
    assert lengths(pattern, ("wb_back",), "top") == pytest.approx(woman.waist_back_width)


def test_a_fitted_waistband_reaches_down_to_the_hips_girth(woman: Measurements) -> None:
    design = design_from_dict({"meta": SKIRT | {"wb": "FittedWB"}, "waistband": {"width": 1.0}})
    assert lengths(outfit(woman, design), ("wb_front", "wb_back"), "bottom") == pytest.approx(woman.hips)


def test_a_shirt_is_as_wide_as_the_bust_and_as_long_as_asked(woman: Measurements) -> None:
    pattern = outfit(woman, design_from_dict({"shirt": {"width": 1.1, "flare": 1.0, "length": 1.3}}))
    torsos = ("right_ftorso", "left_ftorso", "right_btorso", "left_btorso")
    assert lengths(pattern, torsos, "bottom") == pytest.approx(1.1 * woman.bust)
    # The armhole hangs from the shoulder line, which rises from the side's upper end to the shoulder's.
    rise = tan(woman.shoulder_incl) * (0.5 * 1.1 * woman.back_width - 0.5 * woman.sleeve_balance)
    side = 1.3 * woman.waist_line + rise - 1.2 * woman.eased_armscye_depth
    assert lengths(pattern, ("right_btorso",), "side") == pytest.approx(side)


def test_a_sleeve_fits_its_armhole(woman: Measurements) -> None:
    pattern = outfit(woman, design_from_dict({"sleeve": {"connect_ruffle": 1.0}}))
    armhole = lengths(pattern, ("right_ftorso", "right_btorso"), "armhole")
    assert lengths(pattern, ("right_sleeve_f", "right_sleeve_b"), "opening") == pytest.approx(armhole, abs=1e-3)


def test_both_halves_of_a_sleeve_match_along_the_arm(woman: Measurements) -> None:
    pattern = outfit(woman, design_from_dict({}))
    for edge in ("upper", "under"):
        front, back = (lengths(pattern, (f"right_sleeve_{half}",), edge) for half in "fb")
        assert front == pytest.approx(back)


def test_a_longer_sleeve_ends_nearer_the_wrist(woman: Measurements) -> None:
    short, long = (
        lengths(outfit(woman, design_from_dict({"sleeve": {"length": share}})), ("right_sleeve_f",), "under")
        for share in (0.2, 0.8)
    )
    assert long == pytest.approx(4 * short)
    assert long < woman.arm_length


def test_a_neckline_is_as_wide_as_asked(woman: Measurements) -> None:
    pattern = outfit(woman, design_from_dict({"collar": {"width": 0.0}}))
    panel = pattern.panel("right_ftorso")
    (neck,) = (i for i, edge in enumerate(panel.edges) if edge.name == "neck")
    start, end = panel.edge_ends(neck)
    assert abs(start[0] - end[0]) == pytest.approx(0.5 * woman.neck_w)


def test_a_dress_hangs_together_at_the_waist(woman: Measurements) -> None:
    meta = {"upper": "Shirt", "wb": "StraightWB", "bottom": "SkirtCircle"}
    pattern = outfit(woman, design_from_dict({"meta": meta}))
    joined = {
        frozenset((seam.left.panel.split("_")[-1], seam.right.panel.split("_")[0]))
        for seam in pattern.seams
        if seam.left.panel.split("_")[0] != seam.right.panel.split("_")[0]
    }
    assert frozenset(("ftorso", "wb")) in joined
    assert frozenset(("back", "skirt")) in joined


def test_missing_measures_are_named() -> None:
    with pytest.raises(BodyError, match=r"measures height, .* are missing"):
        outfit(Measurements(waist=80.0), design_from_dict({}))


def test_a_back_as_wide_as_the_girth_is_no_body(woman: Measurements) -> None:
    with pytest.raises(BodyError, match=r"waist_back_width is 90\.0 cm of a waist of 80\.3 cm"):
        outfit(replace(woman, waist_back_width=90.0), design_from_dict({}))


def test_a_neckline_wider_than_the_shirt(woman: Measurements) -> None:
    broad = replace(woman, shoulder_w=70.0)
    with pytest.raises(PatternError, match=r"a neckline of .* cm is wider than the shirt: narrow collar\.width"):
        outfit(broad, design_from_dict({"collar": {"width": 1.0}}))


def test_nothing_to_wear(woman: Measurements) -> None:
    with pytest.raises(PatternError, match="an outfit without upper and bottom"):
        outfit(woman, design_from_dict({"meta": {"upper": None, "wb": "StraightWB"}}))
