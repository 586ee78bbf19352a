"""Properties of every garment of the wardrobe on every wearer; ``conftest.DESIGNS`` lists more designs."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from math import dist
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float

from benchmarks.cases.parity import compare
from gcd_dataset.curves import LINE, curve_points, sample_curve, signed_area
from gcd_dataset.errors import BodyError, ConfigError, PatternError
from gcd_dataset.faults import Rule, check_pattern, require_valid
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments import (
    GarmentDesign,
    Kind,
    Reject,
    design_from_dict,
    design_to_dict,
    draw_garment,
    read_design,
    sample_design,
    sample_kind,
    try_on,
)
from gcd_dataset.generator.garments.drawn import hem_depth
from gcd_dataset.generator.garments.garment import Cutting
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.garments.pencil_skirt import PencilSkirtDesign, pencil_skirt
from gcd_dataset.generator.garments.sleeve import SEWABLE
from gcd_dataset.generator.garments.waistband import Waistband
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Bottom, Upper
from gcd_dataset.generator.pattern import assemble
from gcd_dataset.records import EdgeRef, Measurements, Pattern, Seam
from gcd_dataset.spec import pattern_from_spec, read_pattern, spec_from_pattern
from tests.generator.garments.conftest import DESIGNS, WOMAN
from tests.generator.garments.measured import EXAMPLES, contour, length, lengths, ref_length

FRONT_OR_BACK = re.compile(r"_(front|back|f|b|ftorso|btorso)(?:_|$)")
GATHERED = {"top", "bottom", "end", "opening", "armhole", "hip", "right_hip", "left_hip"}
HOLDERS = {"lower_interface", "left_collar", "right_collar", "left_armhole", "right_armhole"}


def middle(pattern: Pattern, ref: EdgeRef) -> Float[np.ndarray, "3"]:
    """The middle of an edge in space."""
    panel = pattern.panel(ref.panel)
    return panel.placement.apply(sample_curve(*panel.edge_ends(ref.edge), panel.edge(ref.edge).curve, 3))[1]


def may_gather(pattern: Pattern, seam: Seam) -> bool:
    """Whether the two edges of a seam may differ in length: rings and armholes gather, hips and shirt fronts are eased.

    If the front of a shirt is wider than its back, its side and shoulder are drawn shorter.
    """
    names = {pattern.panel(ref.panel).edge(ref.edge).name for ref in (seam.left, seam.right)}
    is_torso = "torso" in seam.left.panel
    return bool(names & GATHERED) or (is_torso and names <= {"side", "shoulder"})


def test_every_garment_of_the_wardrobe_is_in_the_battery() -> None:
    designs = [design_from_dict(values).meta for values in DESIGNS.values()]
    worn = {part.garment.name for meta in designs for part in (meta.upper, meta.bottom) if part is not None}
    assert worn == {garment.name for garment in GARMENTS}


def loops_are_closed_and_seen_from_outside(pattern: Pattern) -> None:
    for panel in pattern.panels:
        ends = [(edge.start, edge.end) for edge in panel.edges]
        assert ends == [(i, (i + 1) % len(ends)) for i in range(len(ends))]
        x, _, z = panel.placement.apply(panel.vertices).mean(axis=0)
        assert signed_area(contour(panel)) * (panel.placement.matrix[:, 2] @ (x, 0.0, z)) > 0


def seams_sew_each_edge_once_right_sides_together(pattern: Pattern) -> None:
    """Beside them the layers of pleats are sewn to each other."""
    sewn = [ref for seam in pattern.seams if not pattern.layers(seam) for ref in (seam.left, seam.right)]
    assert len(sewn) == len(set(sewn))
    assert not any(seam.right_wrong for seam in pattern.seams)


def seams_that_do_not_gather_join_equal_lengths(pattern: Pattern) -> None:
    # The halves of a sleeve may differ by a gathered surplus that is too short to move.
    plain = [seam for seam in pattern.seams if not may_gather(pattern, seam)]
    assert plain
    for seam in plain:
        assert ref_length(pattern, seam.left) == pytest.approx(ref_length(pattern, seam.right), abs=1.6 * SEWABLE)


def a_spec_holds_the_whole_pattern(pattern: Pattern) -> None:
    read = pattern_from_spec(json.loads(json.dumps(spec_from_pattern(pattern))), pattern.name)
    assert [panel.name for panel in read.panels] == [panel.name for panel in pattern.panels]
    assert read.seams == pattern.seams
    for ours, theirs in zip(pattern.panels, read.panels, strict=True):
        assert np.array_equal(theirs.vertices, ours.vertices)
        assert [replace(edge, name="") for edge in theirs.edges] == [replace(edge, name="") for edge in ours.edges]
        assert theirs.placement.apply(ours.vertices) == pytest.approx(ours.placement.apply(ours.vertices), abs=1e-9)


def labels_that_a_drape_needs_are_present(pattern: Pattern, design: GarmentDesign) -> None:
    labels = {edge.label for panel in pattern.panels for edge in panel.edges if edge.label}
    assert labels <= HOLDERS
    assert ("right_collar" in labels) == (design.meta.upper is not None)
    assert ("lower_interface" in labels) == (design.meta.wb is not None or design.meta.bottom is not None)
    parts = {panel.name: panel.label for panel in pattern.panels}
    assert {label for name, label in parts.items() if "sleeve" in name} <= {"arm"}
    assert {label for name, label in parts.items() if "torso" in name or "wb" in name} <= {"body"}
    assert {label for name, label in parts.items() if re.search("cape|poncho|hood", name)} <= {"body"}
    assert {label for name, label in parts.items() if "skirt" in name} <= {"leg"}
    assert set(parts.values()) <= {"arm", "body", "leg"}
    assert ("leg" in parts.values()) == (design.meta.bottom is not None)


def test_a_garment_can_be_sewn_and_draped_on_every_wearer(wearer: Measurements, design: GarmentDesign) -> None:
    pattern = draw_garment(wearer, design)
    loops_are_closed_and_seen_from_outside(pattern)
    assert require_valid(pattern)
    seams_sew_each_edge_once_right_sides_together(pattern)
    seams_that_do_not_gather_join_equal_lengths(pattern)
    a_spec_holds_the_whole_pattern(pattern)
    labels_that_a_drape_needs_are_present(pattern, design)


def sewn_edges_face_each_other(pattern: Pattern) -> None:
    # Before sewing, a swapped or twisted seam would cross the garment.
    for seam in pattern.seams:
        left, right = (middle(pattern, ref) for ref in (seam.left, seam.right))
        assert abs(left[0] - right[0]) < 21.0  # the largest gap, between the halves of a hood
        assert abs(left[1] - right[1]) < 25.0


def panels_are_placed_on_their_side_of_the_body(pattern: Pattern, woman: Measurements) -> None:
    for panel in pattern.panels:
        x, _, z = panel.placement.apply(panel.vertices).mean(axis=0)
        if (side := FRONT_OR_BACK.search(panel.name)) is not None:
            assert z > 10.0 if side[1].startswith("f") else z < -10.0
        assert "left" not in panel.name or x > 0
        assert "right" not in panel.name or x < 0
        if panel.label == "leg" and not panel.lines:  # unfolded, a pleated panel is a fan
            edges = {edge.name: middle(pattern, EdgeRef(panel.name, i))[1] for i, edge in enumerate(panel.edges)}
            low, high = edges.get("bottom", edges.get("hem")), edges.get("top", -np.inf)
            assert low is not None
            assert low < high <= woman.waist_level or panel.name.startswith("ins_")


def a_spec_holds_no_negative_zeros(pattern: Pattern) -> None:
    panels = spec_from_pattern(pattern)["pattern"]["panels"].values()
    numbers = [x for panel in panels for key in ("translation", "rotation", "vertices") for x in np.ravel(panel[key])]
    assert not any(np.signbit(x) and x == 0 for x in numbers)


def test_a_garment_is_placed_round_a_woman_and_its_files_repeat(woman: Measurements, design: GarmentDesign) -> None:
    pattern = draw_garment(woman, design)
    sewn_edges_face_each_other(pattern)
    panels_are_placed_on_their_side_of_the_body(pattern, woman)
    if design.meta.bottom is not Bottom.PANTS:
        # The hem of trousers without flare begins at -0.0, in the bytes of published data sets too.
        a_spec_holds_no_negative_zeros(pattern)
    first, second = (json.dumps(spec_from_pattern(drawn)) for drawn in (pattern, draw_garment(woman, design)))
    assert first == second
    assert design_from_dict(json.loads(json.dumps(design_to_dict(design)))) == design


def test_at_most_a_tenth_of_random_designs_is_rejected(wearer: Measurements) -> None:
    """Designs are sampled for their wearer, who may be a doll or a giant."""
    drawn = [sample_design(np.random.default_rng(seed), [wearer]) for seed in range(10)]
    assert sum(isinstance(try_on(wearer, design), Reject) for design in drawn) <= 1


EXACT = 0.01  # cm between closed forms and the reference's solvers
FITTED = {"sleeve": 0.5, "cuff": 0.5, "hood": 0.3, "pant": 0.1}  # cm: the reference's minimisers stop early
PLACED = 1.7  # cm: the reference shifts a panel by the fractional part of its first corner (a truncated pivot)


@pytest.mark.parametrize("body", ["default_body", "random_body"])
@pytest.mark.parametrize("name", EXAMPLES)
def test_a_pattern_without_mends_equals_the_references(examples: Path, name: str, body: str) -> None:
    """Names, seams, outlines, placements and labels, which the reference loses where a seam divides an edge."""
    folder = examples / "patterns" / name / body
    size, design = read_measurements(folder / "body_measurements.yaml"), read_design(folder / "design_params.yaml")
    ours, theirs = draw_garment(size, design, mends=frozenset()), read_pattern(folder / f"{name}_specification.json")
    found = compare(ours, theirs)
    assert found.structure == ()
    for panel in theirs.panels:
        limit = max((limit for part, limit in FITTED.items() if part in panel.name), default=EXACT)
        assert found.outline[panel.name] < limit
        assert found.placement[panel.name] < PLACED
        drawn = ours.panel(panel.name)
        assert drawn.label == panel.label
        assert all(mine.label == edge.label for mine, edge in zip(drawn.edges, panel.edges, strict=True) if edge.label)


def test_a_flared_pencil_skirt_equals_the_references(examples: Path) -> None:
    theirs = read_pattern(examples / "patterns" / "dress_pencil_specification.json")
    size = read_measurements(examples / "patterns" / "pencil_skirt" / "default_body" / "body_measurements.yaml")
    design = PencilSkirtDesign(length=0.5, flare=0.9, left_slit=0.4, right_slit=0.4)
    cutting = Cutting(1.0, size.hips_line + 0.5 * size.leg_length, ALL_MENDS)
    found = compare(assemble(pencil_skirt(size, design, cutting), "skirt"), theirs)
    assert max(found.outline.values()) < 0.1


SKIRT = {"upper": None, "bottom": "SkirtCircle"}


@pytest.mark.parametrize("kind", ["StraightWB", "FittedWB"])
def test_a_waistband_closes_around_the_waist(woman: Measurements, kind: str) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": SKIRT | {"wb": kind}, "waistband": {"waist": 1.0}}))
    assert lengths(pattern, "top", ("wb_front", "wb_back")) == pytest.approx(woman.waist)
    assert lengths(pattern, "top", ("wb_back",)) == pytest.approx(woman.waist_back_width)
    if kind == "FittedWB":  # down to the girth of the hips
        design = design_from_dict({"meta": SKIRT | {"wb": kind}, "waistband": {"width": 1.0}})
        assert lengths(draw_garment(woman, design), "bottom", ("wb_front", "wb_back")) == pytest.approx(woman.hips)


OWN = [upper for upper in Upper if not upper.garment.weight]


def test_garments_have_distinct_names_and_sections_distinct_classes() -> None:
    assert len({garment.name for garment in GARMENTS}) == len(GARMENTS) == len(Upper) + len(Bottom)
    kinds = {(garment.section, garment.design) for garment in GARMENTS}
    assert len({section for section, _ in kinds}) == len(kinds)
    assert all(isinstance(garment.section_design(GarmentDesign()), garment.design) for garment in GARMENTS)


@pytest.mark.parametrize(
    ("size", "meta", "message"),
    [
        (Measurements(waist=80.0), {}, r"measures height, .* are missing"),
        (replace(WOMAN, waist_back_width=90.0), {}, r"waist_back_width is 90\.0 cm, and waist is 80\.3 cm"),
        (replace(WOMAN, hips_line=-9.0), {}, r"\+ crotch_hip_diff is .* \+ -9\.0 \+ .* cm, and height is 1"),
        (WOMAN, {"wb": "StraightWB"}, "a garment without upper and bottom"),
        (WOMAN, {"upper": "Cape", "bottom": "Pants"}, "nothing can be sewn to the hem of a Cape: set meta.wb and meta"),
    ],
)
def test_an_outfit_that_cannot_be_drawn_is_refused(size: Measurements, meta: dict[str, str], message: str) -> None:
    with pytest.raises((BodyError, PatternError), match=message):
        draw_garment(size, design_from_dict({"meta": meta}))


def test_an_overlay_that_sews_a_bottom_to_a_cape_is_refused() -> None:
    for meta, names in (
        ({"upper": "Cape", "bottom": "Pants"}, "Cape, .* set meta.wb and meta.bottom to"),
        ({"upper": {"options": ["Cape", "Poncho"]}, "wb": "FittedWB"}, "Cape, Poncho"),
    ):
        with pytest.raises(ConfigError, match=rf"nothing can be sewn to meta\.upper = {names}"):
            Overlay.from_dict({"meta": meta})


def test_capes_ponchos_fronts_trim_and_pockets_are_not_sampled_and_other_designs_do_not_name_them() -> None:
    assert {Upper.CAPE, Upper.PONCHO} <= {*OWN}
    drawn = [sample_design(np.random.default_rng(seed)) for seed in range(12)]
    assert not {design.meta.upper for design in drawn} & {*OWN}
    sections = {"front", "trim", "pocket", *(upper.garment.section for upper in OWN)}
    assert not sections & {key for design in drawn for key in design_to_dict(design)}
    assert Overlay().to_dict() == {}


@pytest.mark.parametrize("upper", OWN)
def test_capes_and_ponchos_are_sampled_if_an_overlay_names_them(woman: Measurements, upper: Upper) -> None:
    asked = Overlay.from_dict(
        {"meta": {"upper": upper.value}, upper.garment.section: {"length": {"range": [1.0, 1.5]}}}
    )
    assert Overlay.from_dict(asked.to_dict()) == asked
    assert {sample_kind(np.random.default_rng(seed), asked) for seed in range(8)} == {Kind.UPPER}
    for seed in range(4):
        design = sample_design(np.random.default_rng(seed), [woman], kind=Kind.UPPER, overlay=asked)
        assert (design.meta.upper, design.meta.wb, design.meta.bottom) == (upper, None, None)
        assert 1.0 <= design_to_dict(design)[upper.garment.section]["length"] <= 1.5
        assert not isinstance(try_on(woman, design), Reject)


def test_capes_and_ponchos_are_sampled_without_band_and_bottom() -> None:
    mixed = Overlay.from_dict({"meta": {"upper": {"options": ["Shirt", "Cape"]}}})
    kinds = {kind: [sample_design(np.random.default_rng(n), kind=kind, overlay=mixed).meta for n in range(8)]
             for kind in (Kind.UPPER, Kind.FULL)}  # fmt: skip
    assert {meta.upper for meta in kinds[Kind.UPPER]} == {Upper.SHIRT, Upper.CAPE}
    assert {meta.upper for meta in kinds[Kind.FULL]} == {Upper.SHIRT}
    assert all(meta.wb is None for meta in kinds[Kind.UPPER] if meta.upper is Upper.CAPE)


def test_a_cape_falls_from_nape_to_hem_and_widens_with_its_part_of_a_circle(woman: Measurements) -> None:
    hems = []
    for circle in (0.5, 0.75, 1.0):
        design = {"meta": {"upper": "Cape"}, "cape": {"circle": circle, "length": 1.5}}
        pattern = draw_garment(woman, design_from_dict(design))
        x, y, _ = pattern.panel("cape_back").placement.apply(pattern.panel("cape_back").vertices).T
        assert np.ptp(y[np.abs(x) < 1e-6]) == pytest.approx(1.5 * woman.waist_line)
        hems.append(length(pattern.panel("cape_back"), "hem", "left_hem"))
    assert hems == sorted(hems)
    assert hems[2] == pytest.approx(np.pi * (1.5 * woman.waist_line + 0.1 * woman.neck_w), rel=0.1)


def test_a_cape_opens_below_its_clasp(woman: Measurements) -> None:
    designs = ({"meta": {"upper": "Cape"}, "cape": {"closed": closed}} for closed in (0.25, 1.0))
    clasped, closed = (draw_garment(woman, design_from_dict(design)) for design in designs)
    assert all(seam.is_plain for seam in closed.seams)
    (front,) = (seam for seam in clasped.seams if not seam.is_plain)
    panel = clasped.panel(front.left.panel)
    assert panel.edge(front.left.edge).name == "centre"
    along = curve_points(*panel.edge_ends(front.left.edge), LINE, np.array([0.0, *front.closed]))
    heights = panel.placement.apply(along)[:, 1]
    assert front.closed[1] - front.closed[0] == pytest.approx(0.25)
    assert max(heights) == max(heights[1:])  # the clasp is at the neck


@pytest.mark.parametrize("upper", OWN)
def test_the_neckline_of_capes_and_ponchos_goes_round_the_back_of_the_neck(woman: Measurements, upper: Upper) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": {"upper": upper.value}}))
    necks = {panel.name: length(pattern.panel(panel.name), "neck") for panel in pattern.panels}
    behind = necks.pop(f"{upper.garment.field}_back")
    assert 0.8 * woman.neck_w < behind < sum(necks.values()) < 2.5 * woman.neck_w


@pytest.mark.parametrize("name", DESIGNS)
def test_only_the_mends_of_its_garments_change_an_outfit(woman: Measurements, name: str) -> None:
    design = design_from_dict(DESIGNS[name])
    others = ALL_MENDS - design.mends()
    assert draw_garment(woman, design, mends=ALL_MENDS - others) == draw_garment(woman, design)
    assert design.mends() >= {Mend.EXPORT_PIVOT}


STRAIGHT: dict[str, Any] = {
    "skirt": {"flare": 0, "length": 0.6}, "flare-skirt": {"length": 0.6}, "pants": {"length": 0.6},
    "pencil-skirt": {"length": 0.6}, "levels-skirt": {"length": 0.6}, "godet-skirt": {"insert_depth": 10},
}  # fmt: skip


def drawn_length(pattern: Pattern, kind: Bottom) -> float:
    """From the top of a bottom to its hem in the middle of a panel, its levels one under the other [cm]."""
    if kind in (Bottom.CIRCLE, Bottom.ASYMMETRIC_CIRCLE, Bottom.PANELS):
        panel = pattern.panel("skirt_panel_0" if kind is Bottom.PANELS else "skirt_back")
        names = [edge.name for edge in panel.edges]
        top, bottom = (middle(pattern, EdgeRef(panel.name, names.index(name))) for name in ("top", "bottom"))
        return dist(top, bottom)
    if kind is Bottom.PLEATED:
        front = pattern.panel("skirt_front")
        return front.lengths()[len(front.edges)]  # of a fold
    fronts = [panel for panel in pattern.panels if panel.name.startswith(("skirt_front", "pant_f_r"))]
    return sum(float(np.ptp(panel.vertices[:, 1])) for panel in fronts)


@pytest.mark.parametrize("band", [None, *Waistband])
@pytest.mark.parametrize("kind", Bottom)
def test_the_hem_hangs_where_the_length_says_with_any_waistband(
    wearer: Measurements, kind: Bottom, band: Waistband | None
) -> None:
    for rise, width in ((0.6, 0.3), (0.8, 0.9)):
        values = STRAIGHT | {"meta": {"bottom": kind.value, "wb": band and band.value}, "waistband": {"width": width}}
        section = "pencil-skirt" if kind is Bottom.GODET else kind.garment.section
        design = design_from_dict(values | {section: STRAIGHT.get(section, {"length": 0.6}) | {"rise": rise}})
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
    assert length(pattern.panel("pant_f_r"), "outside", "hip") == pytest.approx(0.2 * woman.leg_length, abs=0.1)
