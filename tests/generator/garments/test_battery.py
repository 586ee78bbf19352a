"""Properties of every garment of the wardrobe on every wearer; ``conftest.OUTFITS`` lists more designs."""

import json
import re

import numpy as np
import pytest
from jaxtyping import Float

from gcd_dataset.curves import curve_length, sample_curve
from gcd_dataset.faults import require_valid
from gcd_dataset.generator.garments import (
    GarmentDesign,
    Reject,
    design_from_dict,
    design_to_dict,
    draw_garment,
    sample_design,
    try_on,
)
from gcd_dataset.generator.garments.sleeve import SEWABLE
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Bottom
from gcd_dataset.records import EdgeRef, Measurements, Panel, Pattern, Seam
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern
from tests.generator.garments.conftest import OUTFITS

FRONT_OR_BACK = re.compile(r"_(front|back|f|b|ftorso|btorso)(?:_|$)")
GATHERED = {"top", "bottom", "end", "opening", "armhole", "hip", "right_hip", "left_hip"}
HOLDERS = {"lower_interface", "left_collar", "right_collar", "left_armhole", "right_armhole"}


def length(pattern: Pattern, ref: EdgeRef) -> float:
    panel = pattern.panel(ref.panel)
    return curve_length(*panel.edge_ends(ref.edge), panel.edges[ref.edge].curve)


def middle(pattern: Pattern, ref: EdgeRef) -> Float[np.ndarray, "3"]:
    """The middle of an edge in space."""
    panel = pattern.panel(ref.panel)
    return panel.placement.apply(sample_curve(*panel.edge_ends(ref.edge), panel.edges[ref.edge].curve, 3))[1]


def may_gather(pattern: Pattern, seam: Seam) -> bool:
    """Whether the two edges of a seam may differ in length: rings and armholes gather, hips and shirt fronts are eased.

    If the front of a shirt is wider than its back, its side and shoulder are drawn shorter.
    """
    names = {pattern.panel(ref.panel).edges[ref.edge].name for ref in (seam.left, seam.right)}
    is_torso = "torso" in seam.left.panel
    return bool(names & GATHERED) or (is_torso and names <= {"side", "shoulder"})


def signed_area(panel: Panel) -> float:
    loops = [sample_curve(*panel.edge_ends(i), edge.curve, 33)[:-1] for i, edge in enumerate(panel.edges)]
    x, y = np.concatenate(loops).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def test_every_garment_of_the_wardrobe_is_in_the_battery() -> None:
    designs = [design_from_dict(values).meta for values in OUTFITS.values()]
    worn = {part.garment.name for meta in designs for part in (meta.upper, meta.bottom) if part is not None}
    assert worn == {garment.name for garment in GARMENTS}


def loops_are_closed_and_seen_from_outside(pattern: Pattern) -> None:
    for panel in pattern.panels:
        ends = [(edge.start, edge.end) for edge in panel.edges]
        assert ends == [(i, (i + 1) % len(ends)) for i in range(len(ends))]
        x, _, z = panel.placement.apply(panel.vertices).mean(axis=0)
        assert signed_area(panel) * (panel.placement.matrix[:, 2] @ (x, 0.0, z)) > 0


def seams_sew_each_edge_once_right_sides_together(pattern: Pattern) -> None:
    sewn = [ref for seam in pattern.seams for ref in (seam.left, seam.right)]
    assert len(sewn) == len(set(sewn))
    assert not any(seam.right_wrong for seam in pattern.seams)


def seams_that_do_not_gather_join_equal_lengths(pattern: Pattern) -> None:
    # The halves of a sleeve may differ by a gathered surplus that is too short to move.
    plain = [seam for seam in pattern.seams if not may_gather(pattern, seam)]
    assert plain
    for seam in plain:
        assert length(pattern, seam.left) == pytest.approx(length(pattern, seam.right), abs=1.6 * SEWABLE)


def a_spec_holds_the_whole_pattern(pattern: Pattern) -> None:
    read = pattern_from_spec(json.loads(json.dumps(spec_from_pattern(pattern))), pattern.name)
    assert [panel.name for panel in read.panels] == [panel.name for panel in pattern.panels]
    assert read.seams == pattern.seams
    for ours, theirs in zip(pattern.panels, read.panels, strict=True):
        assert np.array_equal(theirs.vertices, ours.vertices)
        assert [(edge.start, edge.end, edge.curve) for edge in theirs.edges] == [
            (edge.start, edge.end, edge.curve) for edge in ours.edges
        ]
        assert [edge.label for edge in theirs.edges] == [edge.label for edge in ours.edges]
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
        if panel.label == "leg":
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
    drawn = [sample_design(np.random.default_rng(seed), [wearer]) for seed in range(20)]
    assert sum(isinstance(try_on(wearer, design), Reject) for design in drawn) <= 2
