"""Seams n to m: edges that are joined, and subdivided again where seams meet."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.models.stitches import (
    StitchNet,
)
from benchmarks.reconstruction.stitching.graphs import edge_refs, graph_of
from benchmarks.reconstruction.stitching.merging import aligned, glued, merged, needed, split, subdivided
from benchmarks.reconstruction.stitching.scores import score_intervals
from benchmarks.reconstruction.stitching.sewing import Subdivision, sew, sew_in_ways
from gcd_dataset.records import EdgeRef, Pattern, Seam
from gcd_dataset.validate import check_pattern
from tests.benchmarks.reconstruction.sewn_patterns import (
    ARMHOLE_L,
    ARMHOLE_R,
    CAP_1,
    CAP_2,
    NECK,
    SIDE_L,
    SIDE_R,
    SMALL,
    net_of,
    rectangle,
    seams_of,
    t_shirt,
    tube,
)


def test_the_cap_of_a_sleeve_becomes_one_edge_and_two_again() -> None:
    pattern = t_shirt()
    found = merged(pattern)
    assert found is not None
    assert found.cuts == {EdgeRef(name, CAP_1): pytest.approx((0.5,)) for name in ("one", "two")}
    assert [len(p.edges) for p in found.pattern.panels] == [8, 8, 4, 4]
    assert seams_of(found.parts) == seams_of(pattern)
    assert len(found.pattern.seams) == 6
    assert {found.parts.seams[k].left.panel for k in found.seams_of_several} == {"front", "back"}
    for ours, theirs in zip(found.parts.panels, pattern.panels, strict=True):
        assert ours.edge_lengths() == pytest.approx(theirs.edge_lengths(), abs=1e-3)
    assert [str(f) for f in check_pattern(found.parts)] == [str(f) for f in check_pattern(pattern)]


def test_a_cut_moves_to_where_the_lengths_agree() -> None:
    found = merged(t_shirt())
    assert found is not None
    wrong = dict.fromkeys(found.cuts, (0.45,))
    parts = replace(split(found.pattern, wrong), seams=found.parts.seams)
    assert aligned(found.pattern, wrong, parts) == {ref: pytest.approx((0.5,)) for ref in found.cuts}


def test_two_halves_that_a_straight_seam_joins_become_the_whole_panel() -> None:
    left, right, belt = rectangle("left", 20, 60), rectangle("right", 20, 60), rectangle("belt", 20, 5)
    seams = (Seam(EdgeRef("left", 1), EdgeRef("right", 3)), Seam(EdgeRef("right", 2), EdgeRef("belt", 0)))
    found = glued(graph_of(Pattern("p", (left, right, belt), seams[:1])), np.random.default_rng(0), share=1.0)
    assert found.panels.tolist() == [0] * 6 + [1] * 4
    whole = found.points[:6].reshape(-1, 2)
    assert np.ptp(whole, axis=0) == pytest.approx([40, 60], abs=1e-3)
    assert np.abs(whole).max(axis=0) == pytest.approx([20, 30], abs=1e-3)
    ends = found.points[found.following[:6], 0]
    assert found.points[:6, -1] == pytest.approx(ends, abs=1e-3)
    assert sorted(found.lengths[:6].tolist()) == pytest.approx([20, 20, 20, 20, 60, 60])
    both = graph_of(Pattern("p", (left, right, belt), seams))
    assert len(glued(both, np.random.default_rng(0), share=1.0).lengths) == 8
    assert len(glued(both, np.random.default_rng(0), share=0.0).lengths) == 12
    assert (
        glued(graph_of(t_shirt()), np.random.default_rng(0), share=0.0).partners == graph_of(t_shirt()).partners
    ).all()


@pytest.mark.parametrize("share", [0.2, 0.35, 0.8])
def test_a_cut_within_a_seam_of_two_whole_edges_is_not_needed(share: float) -> None:
    """Whatever the needless subdivision, the cut of the cap, which is sewn to two panels, stays."""
    found = merged(t_shirt())
    assert found is not None
    side, other = EdgeRef("front", SIDE_R), EdgeRef("back", SIDE_L)
    cuts = {**found.cuts, side: (share,), other: (1 - share,), EdgeRef("front", NECK): (share,)}
    parts = split(found.pattern, cuts)
    seams = [
        *(seam for seam in parts.seams if side.panel not in (seam.left.panel, seam.right.panel)),
        Seam(EdgeRef("front", 1), EdgeRef("back", 8)),
        Seam(EdgeRef("front", 2), EdgeRef("back", 7)),
        Seam(EdgeRef("one", CAP_1), EdgeRef("back", ARMHOLE_L)),
        Seam(EdgeRef("one", CAP_2), EdgeRef("front", ARMHOLE_R + 1)),
        Seam(EdgeRef("two", CAP_1), EdgeRef("front", ARMHOLE_L + 2)),
        Seam(EdgeRef("two", CAP_2), EdgeRef("back", ARMHOLE_R)),
    ]
    assert needed(found.pattern, cuts, replace(parts, seams=tuple(seams))) == found.cuts
    assert needed(found.pattern, found.cuts, split(found.pattern, found.cuts)) == {}


@pytest.mark.parametrize("way", [None, Subdivision(), Subdivision(revised=True)])
def test_no_patterns_are_sewn_into_none(way: Subdivision | None) -> None:
    """Test garments of one kind may have no seam n to m."""
    assert sew(net_of(), [], subdivide=way) == []


def test_ways_of_subdivision_are_those_of_one_way_each() -> None:
    """A network that has learnt nothing subdivides all edges at so low a log-odds; needless cuts are taken back."""
    pattern = replace(tube(), seams=())
    torch.manual_seed(3)
    net = StitchNet(replace(SMALL, rounds=1)).eval()
    several = list(sew_in_ways(net, [pattern], (0.0, -9.0)))
    assert [(way.logit, way.revised) for way, _ in several] == [(0.0, False), (0.0, True), (-9.0, False), (-9.0, True)]
    for way, (found,) in several:
        assert found.seams == sew(net, [pattern], subdivide=way)[0].seams
    counts = [sum(len(panel.edges) for panel in found.panels) for _, (found,) in several]
    assert counts[2] > counts[0] == 16
    assert counts[3] < counts[2]


def test_edges_sewn_to_one_panel_are_not_joined() -> None:
    pattern = t_shirt()
    seams = tuple(
        replace(seam, left=EdgeRef("front", NECK)) if seam.left == EdgeRef("back", ARMHOLE_L) else seam
        for seam in pattern.seams
    )
    found = merged(replace(pattern, seams=seams))
    assert found is not None
    assert set(found.cuts) == {EdgeRef("two", CAP_1)}


def test_a_seam_cut_in_two_is_sewn_in_the_same_places() -> None:
    pattern = t_shirt()
    found = subdivided(pattern, np.random.default_rng(0), share=1.0)
    assert len(found.seams) == 20
    assert {side for seam in found.seams for side in (seam.left, seam.right)} <= set(edge_refs(found))
    lengths = dict(zip(edge_refs(found), (v for p in found.panels for v in p.edge_lengths()), strict=True))
    assert all(lengths[seam.left] == pytest.approx(lengths[seam.right], rel=1e-3) for seam in found.seams)
    assert subdivided(pattern, np.random.default_rng(0), share=0.0).seams == pattern.seams


def test_intervals_of_the_truth_score_one_and_misplaced_ones_do_not() -> None:
    found = merged(t_shirt())
    assert found is not None
    right = score_intervals(found, found.parts)
    assert (right.f1, right.f1_several, right.cut_recall) == (1.0, 1.0, 1.0)
    moved = split(found.pattern, {EdgeRef("one", CAP_1): (0.5,), EdgeRef("two", CAP_1): (0.3,)})
    wrong = score_intervals(found, replace(moved, seams=found.parts.seams))
    assert wrong.f1 == pytest.approx(0.8)
    assert wrong.f1_several == pytest.approx(0.5)
    unsewn = score_intervals(found, found.pattern)
    assert unsewn.f1_several == 0.0
    assert unsewn.f1 == pytest.approx(2 * 6 / (6 + 10))
