"""Seams n to m: edges that are joined, and subdivided again where seams meet; scores up to symmetries."""

from dataclasses import astuple, fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.models.stitches import (
    StitchNet,
)
from benchmarks.reconstruction.stitching.graphs import edge_refs, graph_of
from benchmarks.reconstruction.stitching.merging import aligned, glued, merged, needed, split, subdivided
from benchmarks.reconstruction.stitching.run import _by_kind, write
from benchmarks.reconstruction.stitching.scores import (
    StitchScore,
    congruences,
    random_symmetry,
    score_intervals,
    score_stitches,
)
from benchmarks.reconstruction.stitching.sewing import Subdivision, sew, sew_in_ways
from gcd_dataset.faults import check_pattern
from gcd_dataset.records import EdgeRef, Pattern, Seam
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
    panel,
    rectangle,
    rows_of,
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


def test_congruent_panels_are_exchangeable_and_mirror_images_are_not() -> None:
    slanted = panel("a", [(0, 0), (30, 0), (30, 20), (5, 10)], {}, (0, 0, 0))
    flipped = panel("b", [(0, 0), (30, 0), (25, 10), (0, 20)], {}, (0, 0, 0))
    assert set(congruences(graph_of(Pattern("p", (slanted, flipped), ())))) == {(0, 0), (1, 1)}
    square = congruences(graph_of(Pattern("p", (rectangle("a", 9, 9), rectangle("b", 9, 9)), ())))
    assert square == {(i, j): [0, 1, 2, 3] for i in (0, 1) for j in (0, 1)}
    assert congruences(graph_of(t_shirt()))[2, 3] == [0]


def test_exchanged_belts_are_right_up_to_symmetry() -> None:
    graph, rows = graph_of(tube()), rows_of(tube())
    exchanged = [(left, (right + 4 - 8) % 8 + 8 if left < 8 <= right else right) for left, right in rows]
    score = score_stitches(graph, exchanged)
    assert (score.perfect, score.perfect_symmetric) == (0.0, 1.0)
    assert score.f1 == pytest.approx(4 / 6)


def test_without_answers_nothing_is_right() -> None:
    """As the evaluator counts: no precision without predicted seams, unless the truth has none, either."""
    score = score_stitches(graph_of(t_shirt()), [])
    assert (score.precision, score.recall, score.f1) == (0.0, 0.0, 0.0)
    bare = graph_of(replace(t_shirt(), seams=()))
    assert set(astuple(score_stitches(bare, []))) == {1.0}
    excess = score_stitches(bare, rows_of(t_shirt()))
    assert (excess.precision, excess.recall, excess.f1) == (0.0, 0.0, 0.0)


def test_half_an_exchange_is_wrong() -> None:
    rows = rows_of(t_shirt())
    one, two = rows.index((ARMHOLE_R, 16 + CAP_2)), rows.index((ARMHOLE_L, 21 + CAP_1))
    half = list(rows)
    half[one], half[two] = (ARMHOLE_R, 21 + CAP_1), (ARMHOLE_L, 16 + CAP_2)
    score = score_stitches(graph_of(t_shirt()), half)
    assert score.f1 == pytest.approx(0.8)
    assert score.perfect_symmetric == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_every_symmetry_of_the_truth_is_right(seed: int) -> None:
    """A ring of six equal gores: any cycle of them is the same skirt."""
    rng = np.random.default_rng(seed)
    gores = tuple(panel(f"{k}", [(0, 0), (20, 0), (15, 50), (5, 50)], {}, (0, 0, 0)) for k in range(6))
    ring = [Seam(EdgeRef(f"{k}", 1), EdgeRef(f"{(k + 1) % 6}", 3)) for k in range(6)]
    graph, order = graph_of(Pattern("skirt", gores, tuple(ring))), rng.permutation(6).tolist()
    cycle = [(4 * order[k] + 1, 4 * order[(k + 1) % 6] + 3) for k in range(6)]
    assert score_stitches(graph, cycle).perfect_symmetric == 1.0
    two_rings = [(4 * a + 1, 4 * b + 3) for a, b in ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3))]
    assert score_stitches(graph, two_rings).perfect_symmetric == 0.0


def test_a_random_symmetry_of_the_truth_is_right() -> None:
    graph = graph_of(tube())
    images = [random_symmetry(graph, np.random.default_rng(seed)) for seed in range(8)]
    scores = [score_stitches(graph, [(moved[a], moved[b]) for a, b in rows_of(tube())]) for moved in images]
    assert all(sorted(moved) == list(range(16)) for moved in images)
    assert {score.perfect_symmetric for score in scores} == {1.0}
    assert min(score.f1 for score in scores) < 1.0


def test_stitches_on_edges_that_the_truth_lacks_are_wrong() -> None:
    rows = rows_of(t_shirt())
    score = score_stitches(graph_of(t_shirt()), rows, others=2)
    assert score.precision == pytest.approx(10 / 12)
    assert score.recall == 1.0


def test_answers_of_an_earlier_run_are_removed(tmp_path: Path) -> None:
    patterns = [replace(t_shirt(), name=f"1_{k:09d}") for k in range(3)]
    (tmp_path / "own.json").write_text("{}")
    write(tmp_path, patterns)
    write(tmp_path, patterns[:2])
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "1_000000000_specification.json", "1_000000001_specification.json", "own.json",
    ]  # fmt: skip


def test_scores_of_kinds_leave_out_missing_ones() -> None:
    """A kind without seams n to m has none."""
    best, least = (StitchScore(*[value] * len(fields(StitchScore))) for value in (1.0, 0.0))
    assert _by_kind(["skirt", "dress", "skirt"], [best, least, least]) == {"dress": [least], "skirt": [best, least]}
    assert _by_kind(["skirt", "dress", "skirt"], [best, None, least]) == {"skirt": [best, least]}
