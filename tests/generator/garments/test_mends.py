"""Mends of lengths and darts: a waistband adds nothing to a bottom's length, and no dart is too narrow to sew."""

from collections.abc import Iterator
from dataclasses import replace
from math import dist
from typing import Any

import numpy as np
import pytest

from gcd_dataset.curves import sample_curve
from gcd_dataset.faults import Rule, check_pattern
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.drawn import hem_depth
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.waistband import Waistband
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.records import Measurements, Panel, Pattern
from tests.generator.garments.skirts import length

STRAIGHT: dict[str, Any] = {
    "skirt": {"flare": 0, "length": 0.6}, "flare-skirt": {"length": 0.6}, "pants": {"length": 0.6},
    "pencil-skirt": {"length": 0.6}, "levels-skirt": {"length": 0.6}, "godet-skirt": {"insert_depth": 10},
}  # fmt: skip
SECTION = {Bottom.PANTS: "pants", Bottom.PENCIL: "pencil-skirt", Bottom.GODET: "pencil-skirt", Bottom.GATHERED: "skirt",
    Bottom.LEVELS: "levels-skirt"}  # fmt: skip


def middle(panel: Panel, name: str) -> np.ndarray:
    """The middle of an edge."""
    (index,) = (index for index, edge in enumerate(panel.edges) if edge.name == name)
    return sample_curve(*panel.edge_ends(index), panel.edges[index].curve, 3)[1]


def drawn_length(pattern: Pattern, kind: Bottom) -> float:
    """From the top of a bottom to its hem in the middle of a panel, its levels one under the other [cm]."""
    if kind in (Bottom.CIRCLE, Bottom.ASYMMETRIC_CIRCLE, Bottom.PANELS):
        panel = pattern.panel("skirt_panel_0" if kind is Bottom.PANELS else "skirt_back")
        return dist(middle(panel, "top"), middle(panel, "bottom"))
    fronts = [panel for panel in pattern.panels if panel.name.startswith(("skirt_front", "pant_f_r"))]
    return sum(float(np.ptp(panel.vertices[:, 1])) for panel in fronts)


@pytest.mark.parametrize("band", [None, *Waistband])
@pytest.mark.parametrize("kind", Bottom)
def test_the_hem_hangs_where_the_length_says_with_any_waistband(
    wearer: Measurements, kind: Bottom, band: Waistband | None
) -> None:
    for rise, width in ((0.6, 0.3), (0.8, 0.9)):
        values = STRAIGHT | {"meta": {"bottom": kind.value, "wb": band and band.value}, "waistband": {"width": width}}
        section = SECTION.get(kind, "flare-skirt")
        design = design_from_dict(values | {section: STRAIGHT[section] | {"rise": rise}})
        pattern = draw_garment(wearer, design)
        height = length(pattern.panel("wb_back"), "right") if band else 0.0
        top = min(rise + width, 1.0) if band else rise
        worn = top * wearer.hips_line + 0.6 * wearer.leg_length
        assert height + drawn_length(pattern, kind) == pytest.approx(worn, abs=0.5)
        assert hem_depth(wearer, design) == pytest.approx(0.6)  # to which captions and tags give words


def narrowing(size: Measurements) -> Iterator[Measurements]:
    """Wearers whose waist approaches bust and hips; the first one has a flat chest."""
    yield replace(size, waist_over_bust_line=size.waist_line + 0.3)
    for share in np.linspace(0.0, 0.9, 10):
        waist, back = (share * wide + (1 - share) * narrow for narrow, wide in
                       ((size.waist, size.hips), (size.waist_back_width, size.hip_back_width)))  # fmt: skip
        yield replace(size, waist=waist, waist_back_width=back)


@pytest.mark.parametrize(
    ("values", "top"),
    [
        ({"bottom": "Pants"}, "top"),
        ({"bottom": "PencilSkirt"}, "top"),
        ({"bottom": "GodetSkirt"}, "top"),
        ({"bottom": "SkirtLevels"}, "top"),
        ({"upper": "FittedShirt"}, "bottom"),
    ],
)
def test_darts_under_half_a_centimetre_are_folded_into_the_side(
    woman: Measurements, values: dict[str, str], top: str
) -> None:
    """The seam to the waistband keeps its length, and the side seams match."""
    narrow = set()
    for size in narrowing(woman):
        design = design_from_dict({"meta": values, "godet-skirt": {"insert_depth": 10}})
        unmended, mended = (
            draw_garment(size, design, mends=mends) for mends in (ALL_MENDS - {Mend.FOLDED_DART}, ALL_MENDS)
        )
        for panel in mended.panels:
            assert length(panel, top) == pytest.approx(length(unmended.panel(panel.name), top), abs=0.01)
        before, after = check_pattern(unmended), check_pattern(mended)
        narrow |= {fault.panel for fault in before if fault.rule is Rule.NARROW_DART}
        assert {fault.rule for fault in after} <= {fault.rule for fault in before} & {Rule.SEAM_LENGTHS}
    assert len(narrow) > 1


def test_the_shortest_trousers_under_a_band_down_to_the_hips_have_their_length(woman: Measurements) -> None:
    """A centimetre above the hips is drawn, and a centimetre less below them."""
    values = {"meta": {"bottom": "Pants", "wb": "StraightWB"}, "waistband": {"width": 1.0}, "pants": {"length": 0.2}}
    pattern = draw_garment(woman, design_from_dict(values))
    assert not [fault for fault in check_pattern(pattern) if fault.rule is not Rule.SEAM_LENGTHS]
    side = sum(length(pattern.panel("pant_f_r"), edge) for edge in ("outside", "hip"))
    assert side == pytest.approx(0.2 * woman.leg_length, abs=0.1)
