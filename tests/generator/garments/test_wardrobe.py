"""Garment records: each garment is one file, listed in the wardrobe; other code uses its record only."""

from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.curves import curve_length
from gcd_dataset.errors import ConfigError
from gcd_dataset.exports.published import garment_type
from gcd_dataset.generator.garments import (
    GarmentDesign,
    Kind,
    Reject,
    design_from_dict,
    design_to_dict,
    draw_garment,
    sample_design,
    sample_kind,
    try_on,
)
from gcd_dataset.generator.garments.design import read_design, write_design
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Bottom, Upper
from gcd_dataset.records import Measurements, Pattern
from tests.generator.garments.conftest import OUTFITS

OWN = [upper for upper in Upper if not upper.garment.weight]


def length(pattern: Pattern, panel: str, *edges: str) -> float:
    """Length of all edges of these names [cm]."""
    drawn = pattern.panel(panel)
    return sum(curve_length(*drawn.edge_ends(i), e.curve) for i, e in enumerate(drawn.edges) if e.name in edges)


def test_garments_have_distinct_names_and_sections_distinct_classes() -> None:
    assert len({garment.name for garment in GARMENTS}) == len(GARMENTS) == len(Upper) + len(Bottom)
    kinds = {(garment.section, garment.design) for garment in GARMENTS}
    assert len({section for section, _ in kinds}) == len(kinds)
    assert all(isinstance(garment.section_design(GarmentDesign()), garment.design) for garment in GARMENTS)


# ------------------------------------------------------------------------------------------ garments beyond GarmentCode


def test_capes_and_ponchos_are_the_garments_beyond_garmentcode() -> None:
    assert [upper.value for upper in OWN] == ["Cape", "Poncho"]


def test_capes_and_ponchos_are_not_sampled_and_other_designs_do_not_name_them() -> None:
    drawn = [sample_design(np.random.default_rng(seed)) for seed in range(12)]
    assert not {design.meta.upper for design in drawn} & {*OWN}
    assert not {"cape", "poncho"} & {key for design in drawn for key in design_to_dict(design)}
    assert Overlay().to_dict() == {}


@pytest.mark.parametrize("upper", OWN)
def test_capes_and_ponchos_are_sampled_if_an_overlay_names_them(woman: Measurements, upper: Upper) -> None:
    asked = Overlay.from_dict(
        {"meta": {"upper": upper.value}, upper.garment.section: {"length": {"range": [1.0, 1.5]}}}
    )
    assert Overlay.from_dict(asked.to_dict()) == asked
    assert {sample_kind(np.random.default_rng(seed), asked) for seed in range(20)} == {Kind.UPPER}
    for seed in range(10):
        design = sample_design(np.random.default_rng(seed), [woman], kind=Kind.UPPER, overlay=asked)
        assert (design.meta.upper, design.meta.wb, design.meta.bottom) == (upper, None, None)
        assert 1.0 <= design_to_dict(design)[upper.garment.section]["length"] <= 1.5
        assert not isinstance(try_on(woman, design), Reject)


def test_capes_and_ponchos_are_sampled_without_band_and_bottom() -> None:
    mixed = Overlay.from_dict({"meta": {"upper": {"options": ["Shirt", "Cape"]}}})
    kinds = {kind: [sample_design(np.random.default_rng(n), kind=kind, overlay=mixed).meta for n in range(20)]
             for kind in (Kind.UPPER, Kind.FULL)}  # fmt: skip
    assert {meta.upper for meta in kinds[Kind.UPPER]} == {Upper.SHIRT, Upper.CAPE}
    assert {meta.upper for meta in kinds[Kind.FULL]} == {Upper.SHIRT}
    assert all(meta.wb is None for meta in kinds[Kind.UPPER] if meta.upper is Upper.CAPE)


def test_an_overlay_that_sews_a_bottom_to_a_cape_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"nothing can be sewn to meta\.upper = Cape, .* set meta\.wb and meta\.bottom to"
    ):
        Overlay.from_dict({"meta": {"upper": "Cape", "bottom": "Pants"}})
    with pytest.raises(ConfigError, match=r"nothing can be sewn to meta\.upper = Cape, Poncho"):
        Overlay.from_dict({"meta": {"upper": {"options": ["Cape", "Poncho"]}, "wb": "FittedWB"}})


def test_a_design_that_sews_a_bottom_to_a_cape_is_rejected(woman: Measurements) -> None:
    found = try_on(woman, design_from_dict({"meta": {"upper": "Cape", "bottom": "Pants"}}))
    assert (
        str(found) == "cannot_be_drawn: nothing can be sewn to the hem of a Cape: set meta.wb and meta.bottom to null"
    )


@pytest.mark.parametrize("upper", OWN)
def test_designs_of_capes_and_ponchos_survive_design_files(tmp_path: Path, upper: Upper) -> None:
    design = design_from_dict({"meta": {"upper": upper.value}, upper.garment.section: {"length": 1.3}})
    write_design(design, tmp_path / "design.yaml")
    assert read_design(tmp_path / "design.yaml") == design


def test_statistics_count_a_cape_as_an_upper() -> None:
    long = design_from_dict({"meta": {"upper": "Cape"}, "cape": {"length": 2.0}})
    assert garment_type(design_to_dict(long))["main"] == "upper_garment"


def test_a_cape_falls_from_nape_to_hem_and_widens_with_its_part_of_a_circle(woman: Measurements) -> None:
    hems = []
    for circle in (0.5, 0.75, 1.0):
        design = {"meta": {"upper": "Cape"}, "cape": {"circle": circle, "length": 1.5}}
        pattern = draw_garment(woman, design_from_dict(design))
        x, y, _ = pattern.panel("cape_back").placement.apply(pattern.panel("cape_back").vertices).T
        assert np.ptp(y[np.abs(x) < 1e-6]) == pytest.approx(1.5 * woman.waist_line)
        hems.append(length(pattern, "cape_back", "hem", "left_hem"))
    assert hems == sorted(hems)
    assert hems[2] == pytest.approx(np.pi * (1.5 * woman.waist_line + 0.1 * woman.neck_w), rel=0.1)


def test_a_cape_opens_below_its_clasp(woman: Measurements) -> None:
    designs = ({"meta": {"upper": "Cape"}, "cape": {"closed": closed}} for closed in (0.25, 1.0))
    clasped, closed = (draw_garment(woman, design_from_dict(design)) for design in designs)
    sewn, free = (length(clasped, "right_cape_front", name) for name in ("closing", "opening"))
    assert sewn == pytest.approx((sewn + free) / 4)
    assert length(closed, "right_cape_front", "closing") == pytest.approx(sewn + free)
    assert length(closed, "right_cape_front", "opening") == 0


@pytest.mark.parametrize("upper", OWN)
def test_the_neckline_of_capes_and_ponchos_goes_round_the_back_of_the_neck(woman: Measurements, upper: Upper) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": {"upper": upper.value}}))
    necks = {panel.name: length(pattern, panel.name, "neck") for panel in pattern.panels}
    behind = necks.pop(f"{upper.garment.section}_back")
    assert 0.8 * woman.neck_w < behind < sum(necks.values()) < 2.5 * woman.neck_w


@pytest.mark.parametrize("name", OUTFITS)
def test_only_the_mends_of_its_garments_change_an_outfit(woman: Measurements, name: str) -> None:
    design = design_from_dict(OUTFITS[name])
    others = ALL_MENDS - design.mends()
    assert draw_garment(woman, design, mends=ALL_MENDS - others) == draw_garment(woman, design)
    assert design.mends() >= {Mend.EXPORT_PIVOT}
