"""What holds for every garment on every wearer; a new garment joins by being listed in ``conftest.OUTFITS``."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.curves import curve_length, sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments import (
    OutfitDesign,
    check_outfit,
    design_from_dict,
    design_to_dict,
    outfit,
    sample_design,
)
from gcd_dataset.records import EdgeRef, Measurements, Panel, Pattern
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern
from gcd_dataset.validate import check_pattern

HOLDERS = {"lower_interface", "left_collar", "right_collar", "left_armhole", "right_armhole"}


def length(pattern: Pattern, ref: EdgeRef) -> float:
    panel = pattern.panel(ref.panel)
    return curve_length(*panel.edge_ends(ref.edge), panel.edges[ref.edge].curve)


def signed_area(panel: Panel) -> float:
    loops = [sample_curve(*panel.edge_ends(i), edge.curve, 33)[:-1] for i, edge in enumerate(panel.edges)]
    x, y = np.concatenate(loops).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def unnamed(pattern: Pattern) -> Pattern:
    """Without the names of the drawing, which a specification does not hold."""
    bare = (replace(p, edges=tuple(replace(edge, name="") for edge in p.edges)) for p in pattern.panels)
    return replace(pattern, panels=tuple(bare), extra={})


def test_loops_are_closed_and_seen_from_outside(wearer: Measurements, design: OutfitDesign) -> None:
    for panel in outfit(wearer, design).panels:
        ends = [(edge.start, edge.end) for edge in panel.edges]
        assert ends == [(i, (i + 1) % len(ends)) for i in range(len(ends))]
        assert signed_area(panel) * panel.placement.translation[2] > 0


def test_no_rule_of_validate_is_broken(wearer: Measurements, design: OutfitDesign) -> None:
    assert [fault for fault in check_pattern(outfit(wearer, design)) if fault.severity == "error"] == []


def test_seams_sew_each_edge_once_right_sides_together(wearer: Measurements, design: OutfitDesign) -> None:
    pattern = outfit(wearer, design)
    sewn = [ref for seam in pattern.seams for ref in (seam.left, seam.right)]
    assert len(sewn) == len(set(sewn))
    assert not any(seam.right_wrong for seam in pattern.seams)


def test_seams_along_the_body_match_and_only_rings_and_armholes_gather(
    wearer: Measurements, design: OutfitDesign
) -> None:
    pattern = outfit(wearer, design)
    gathered = {"bottom", "top", "armhole", "opening"}
    for seam in pattern.seams:
        names = {pattern.panel(ref.panel).edges[ref.edge].name for ref in (seam.left, seam.right)}
        if not names & gathered and names != {"side"} and names != {"centre"} and names != {"shoulder"}:
            assert length(pattern, seam.left) == pytest.approx(length(pattern, seam.right), rel=0.05)


def test_a_spec_holds_the_whole_pattern(wearer: Measurements, design: OutfitDesign) -> None:
    pattern = outfit(wearer, design)
    read = pattern_from_spec(json.loads(json.dumps(spec_from_pattern(pattern))), pattern.name)
    assert [panel.name for panel in read.panels] == [panel.name for panel in pattern.panels]
    assert read.seams == pattern.seams
    for ours, theirs in zip(unnamed(pattern).panels, read.panels, strict=True):
        assert theirs.vertices == pytest.approx(ours.vertices)
        assert [edge.label for edge in theirs.edges] == [edge.label for edge in ours.edges]
        assert theirs.placement.matrix == pytest.approx(ours.placement.matrix)


def test_the_same_design_gives_the_same_bytes(woman: Measurements, design: OutfitDesign) -> None:
    first, second = (json.dumps(spec_from_pattern(outfit(woman, design))) for _ in range(2))
    assert first == second


def test_a_design_survives_its_file(design: OutfitDesign) -> None:
    assert design_from_dict(json.loads(json.dumps(design_to_dict(design)))) == design


def test_labels_sit_where_a_drape_looks_for_them(wearer: Measurements, design: OutfitDesign) -> None:
    pattern = outfit(wearer, design)
    labels = {edge.label for panel in pattern.panels for edge in panel.edges if edge.label}
    assert labels <= HOLDERS
    assert ("right_collar" in labels) == (design.meta.upper is not None)
    assert ("lower_interface" in labels) == (design.meta.wb is not None or design.meta.bottom is not None)
    parts = {panel.name: panel.label for panel in pattern.panels}
    assert {label for name, label in parts.items() if "sleeve" in name} <= {"arm"}
    assert {label for name, label in parts.items() if "torso" in name or "wb" in name} <= {"body"}
    assert {label for name, label in parts.items() if "skirt" in name} <= {"leg"}


def test_random_designs_build_or_say_why_not(wearer: Measurements, capsys: pytest.CaptureFixture[str]) -> None:
    accepted, reasons = 0, []
    for seed in range(40):
        design = sample_design(np.random.default_rng(seed))
        try:
            reasons += [str(reject) for reject in check_outfit(wearer, design, outfit(wearer, design))][:1] or [
                "accepted"
            ]
        except PatternError as error:
            reasons.append(str(error))
    accepted = reasons.count("accepted")
    with capsys.disabled():
        print(f" {accepted} of {len(reasons)} accepted", end="")
    assert all(reasons)
    assert accepted > 0.5 * len(reasons)
