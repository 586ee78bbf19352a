"""Single garments: lengths of edges computed from the measures."""

from collections.abc import Iterable
from dataclasses import replace
from math import pi

import pytest

from gcd_dataset.curves import curve_length
from gcd_dataset.errors import BodyError, PatternError
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.records import Measurements, Pattern

SKIRT = {"upper": None, "bottom": "SkirtCircle"}


def lengths(pattern: Pattern, panels: Iterable[str], edge: str) -> float:
    """Length of all edges named ``edge`` in the panels [cm]."""
    found = ((pattern.panel(name), name) for name in panels)
    return sum(
        curve_length(*panel.edge_ends(i), drawn.curve)
        for panel, _ in found
        for i, drawn in enumerate(panel.edges)
        if drawn.name == edge
    )


@pytest.mark.parametrize("suns", [0.25, 1.0, 1.7])
def test_a_circle_skirt_is_as_wide_as_the_waist_and_its_hem_grows_by_the_suns(woman: Measurements, suns: float) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": SKIRT, "flare-skirt": {"suns": suns, "length": 0.4}}))
    panels = ("skirt_front", "skirt_back")
    length = woman.hips_line + 0.4 * woman.leg_length
    assert lengths(pattern, panels, "top") == pytest.approx(woman.waist)
    assert lengths(pattern, panels, "right") == pytest.approx(2 * length)
    assert lengths(pattern, panels, "bottom") == pytest.approx(woman.waist + 2 * pi * suns * length)


@pytest.mark.parametrize("kind", ["StraightWB", "FittedWB"])
def test_a_waistband_closes_around_the_waist(woman: Measurements, kind: str) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": SKIRT | {"wb": kind}, "waistband": {"waist": 1.0}}))
    assert lengths(pattern, ("wb_front", "wb_back"), "top") == pytest.approx(woman.waist)
    assert lengths(pattern, ("wb_back",), "top") == pytest.approx(woman.waist_back_width)


def test_a_fitted_waistband_reaches_down_to_the_hips_girth(woman: Measurements) -> None:
    design = design_from_dict({"meta": SKIRT | {"wb": "FittedWB"}, "waistband": {"width": 1.0}})
    assert lengths(draw_garment(woman, design), ("wb_front", "wb_back"), "bottom") == pytest.approx(woman.hips)


def test_a_dress_hangs_together_at_the_waist(woman: Measurements) -> None:
    meta = {"upper": "Shirt", "wb": "StraightWB", "bottom": "SkirtCircle"}
    pattern = draw_garment(woman, design_from_dict({"meta": meta}))
    joined = {
        frozenset((seam.left.panel.split("_")[-1], seam.right.panel.split("_")[0]))
        for seam in pattern.seams
        if seam.left.panel.split("_")[0] != seam.right.panel.split("_")[0]
    }
    assert frozenset(("ftorso", "wb")) in joined
    assert frozenset(("back", "skirt")) in joined


def test_missing_measures_are_named() -> None:
    with pytest.raises(BodyError, match=r"measures height, .* are missing"):
        draw_garment(Measurements(waist=80.0), design_from_dict({}))


def test_a_back_as_wide_as_its_girth_is_refused(woman: Measurements) -> None:
    with pytest.raises(BodyError, match=r"waist_back_width is 90\.0 cm, and waist is 80\.3 cm"):
        draw_garment(replace(woman, waist_back_width=90.0), design_from_dict({}))


def test_an_outfit_without_upper_and_bottom_is_refused(woman: Measurements) -> None:
    with pytest.raises(PatternError, match="a garment without upper and bottom"):
        draw_garment(woman, design_from_dict({"meta": {"upper": None, "wb": "StraightWB"}}))
