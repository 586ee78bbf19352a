"""The network of stitches: its invariances, its training, and how its scores become pairs of edges."""

from dataclasses import astuple, replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.stitching.edge_shapes import next_on_boundary
from benchmarks.reconstruction.stitching.graphs import edge_refs, graph_of
from benchmarks.reconstruction.stitching.losses import revealed
from benchmarks.reconstruction.stitching.merging import aligned, glued, merged, split
from benchmarks.reconstruction.stitching.net import StitchNet
from benchmarks.reconstruction.stitching.placing import exchanged, placed
from benchmarks.reconstruction.stitching.scores import congruences, score_intervals, score_stitches
from benchmarks.reconstruction.stitching.sewing import best_pairs, predict_cuts, sew
from gcd_dataset.faults import check_pattern
from gcd_dataset.records import EdgeRef, Pattern, Placement, Seam
from tests.benchmarks.reconstruction.toys import (
    ARMHOLE_L,
    ARMHOLE_R,
    CAP_1,
    HEM,
    SIDE_L,
    SIDE_R,
    SMALL,
    batch_of,
    net_of,
    nothing_known,
    rectangle,
    rewritten,
    rows_of,
    seams_of,
    t_shirt,
    tube,
)
from tests.generator.mesh.shapes import panel


def test_another_file_of_the_same_garment_gets_the_same_scores() -> None:
    net, pattern = net_of(), t_shirt()
    other, new_ref = rewritten(pattern, np.random.default_rng(1))
    rows = {ref: row for row, ref in enumerate(edge_refs(other))}
    moved = torch.tensor([rows[new_ref[ref]] for ref in edge_refs(pattern)])
    one, two = batch_of(pattern), batch_of(other)
    with torch.no_grad():
        ours, theirs = net(one, nothing_known(one)), net(two, nothing_known(two))
    count = len(moved)
    assert torch.allclose(ours.pairs[0, :count, :count], theirs.pairs[0][moved][:, moved], atol=1e-3)
    assert torch.allclose(ours.free[0, :count], theirs.free[0, moved], atol=1e-3)
    assert torch.allclose(ours.cuts[0, :count], theirs.cuts[0, moved], atol=1e-3)


def test_the_boundary_turns_at_a_sewn_seam() -> None:
    pattern = t_shirt()
    batch, rows = batch_of(pattern), {ref: row for row, ref in enumerate(edge_refs(pattern))}
    known = nothing_known(batch)
    side, other = rows[EdgeRef("front", SIDE_R)], rows[EdgeRef("back", SIDE_L)]
    known[0, side], known[0, other] = other, side
    after = next_on_boundary(batch.following, known)
    assert after[0, rows[EdgeRef("front", HEM)]] == rows[EdgeRef("back", HEM)]
    assert after[0, rows[EdgeRef("back", ARMHOLE_L)]] == rows[EdgeRef("front", ARMHOLE_R)]


def test_half_of_the_seams_are_given_the_surest_first() -> None:
    batch = batch_of(t_shirt())
    sure = torch.where(batch.partners >= 0, torch.minimum(batch.partners, torch.arange(32)), 0).float()
    draw = torch.rand(batch.panels.shape, generator=torch.Generator().manual_seed(0))
    known = revealed(batch, torch.tensor([0.5]), sure, draw)
    rows = (known[0] >= 0).nonzero()[:, 0]
    assert len(rows) == 10
    assert torch.equal(known[0, known[0, rows]], rows)
    given = torch.zeros(32, dtype=torch.bool).index_fill_(0, rows, True)
    assert sure[0, given].min() >= sure[0, ~given & (batch.partners[0] >= 0)].max()
    assert torch.equal(revealed(batch, torch.tensor([0.0]), sure, draw), nothing_known(batch))


def test_each_edge_is_sewn_once() -> None:
    for found in sew(net_of(), [tube(), t_shirt()]):
        sides = [side for seam in found.seams for side in (seam.left, seam.right)]
        assert len(sides) == len(set(sides))


def heaviest(gain: np.ndarray, free: tuple[int, ...]) -> float:
    """Weight of the best pairs among rows, by trying all."""
    if len(free) < 2:
        return 0.0
    first, rest = free[0], free[1:]
    paired = [gain[first, row] + heaviest(gain, tuple(r for r in rest if r != row)) for row in rest]
    return float(max([heaviest(gain, rest), *paired]))


@pytest.mark.parametrize("seed", range(9))
def test_the_best_pairs_weigh_as_much_as_any(seed: int) -> None:
    chance = np.random.default_rng(seed)
    count = seed % 9
    drawn = np.triu(chance.random((count, count)) * (chance.random((count, count)) < 0.6), 1)
    drawn = np.round(2 * drawn) if seed % 3 == 0 else drawn  # equal weights, so cycles of any length
    gain = drawn + drawn.T
    pairs = best_pairs(gain)
    rows = [row for pair in pairs for row in pair]
    assert len(set(rows)) == len(rows)
    assert all(gain[pair] > 0 for pair in pairs)
    assert sum(gain[pair] for pair in pairs) == pytest.approx(heaviest(gain, tuple(range(count))))


# ---------------------------------------------------------------------------------------------------------- subdivision


def test_the_cap_of_a_sleeve_becomes_one_edge_and_two_again() -> None:
    pattern = t_shirt()
    found = merged(pattern)
    assert found is not None
    assert found.cuts == {EdgeRef(name, CAP_1): pytest.approx((0.5,)) for name in ("one", "two")}
    assert [len(p.edges) for p in found.pattern.panels] == [8, 8, 4, 4]
    assert seams_of(found.parts) == seams_of(pattern)
    assert len(found.pattern.seams) == 6
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
    assert found.points[:6, -1] == pytest.approx(found.points[found.following[:6], 0], abs=1e-3)
    assert sorted(found.lengths[:6].tolist()) == pytest.approx([20, 20, 20, 20, 60, 60])
    both = graph_of(Pattern("p", (left, right, belt), seams))
    assert len(glued(both, np.random.default_rng(0), share=1.0).lengths) == 8
    assert len(glued(both, np.random.default_rng(0), share=0.0).lengths) == 12
    shirt = graph_of(t_shirt())
    assert (glued(shirt, np.random.default_rng(0), share=0.0).partners == shirt.partners).all()


def test_needless_cuts_are_taken_back() -> None:
    """A network that has learnt nothing subdivides all edges at so low a log-odds."""
    pattern = replace(tube(), seams=())
    torch.manual_seed(3)
    net = StitchNet(replace(SMALL, rounds=1)).eval()
    with torch.no_grad():
        [cuts] = predict_cuts(net, batch_of(pattern), logit=-9.0)
    [whole], [parted] = sew(net, [pattern]), sew(net, [pattern], cuts_above=-9.0)
    counts = [sum(len(panel.edges) for panel in found.panels) for found in (whole, parted)]
    assert len(cuts) == counts[0] == 16
    assert 16 < counts[1] < 16 + sum(map(len, cuts.values()))


def test_intervals_of_the_truth_score_one_and_misplaced_ones_do_not() -> None:
    found = merged(t_shirt())
    assert found is not None
    right = score_intervals(found, found.parts)
    assert (right.f1, right.perfect) == (1.0, 1.0)
    moved = split(found.pattern, {EdgeRef("one", CAP_1): (0.5,), EdgeRef("two", CAP_1): (0.3,)})
    assert score_intervals(found, replace(moved, seams=found.parts.seams)).f1 == pytest.approx(0.8)
    assert score_intervals(found, found.pattern).f1 == pytest.approx(2 * 6 / (6 + 10))


def test_congruent_panels_are_exchangeable_and_mirror_images_are_not() -> None:
    slanted = panel("a", [(0, 0), (30, 0), (30, 20), (5, 10)])
    flipped = panel("b", [(0, 0), (30, 0), (25, 10), (0, 20)])
    assert set(congruences(graph_of(Pattern("p", (slanted, flipped), ())))) == {(0, 0), (1, 1)}
    square = congruences(graph_of(Pattern("p", (rectangle("a", 9, 9), rectangle("b", 9, 9)), ())))
    assert square == {(i, j): [0, 1, 2, 3] for i in (0, 1) for j in (0, 1)}
    assert congruences(graph_of(t_shirt()))[2, 3] == [0]


def test_panels_that_are_almost_equal_form_kinds() -> None:
    """b lies on a and on c within the tolerance, c not on a: every exchange within a kind can be completed."""
    graph = graph_of(
        Pattern("p", tuple(rectangle(name, width, 20) for name, width in zip("abc", (9, 9.04, 9.08), strict=True)), ())
    )
    assert set(congruences(graph)) == {(0, 0), (0, 1), (1, 0), (1, 1), (2, 2)}
    assert score_stitches(graph, [(10, 9), (5, 4), (2, 7)]).f1 == 0.0  # the search takes b for c, and c for neither


def test_exchanged_belts_are_right_up_to_symmetry() -> None:
    graph, rows = graph_of(tube()), rows_of(tube())
    exchanged = [(left, (right + 4 - 8) % 8 + 8 if left < 8 <= right else right) for left, right in rows]
    score = score_stitches(graph, exchanged)
    assert (score.perfect, score.perfect_symmetric) == (0.0, 1.0)
    assert score.f1 == pytest.approx(4 / 6)


def test_placements_tell_equal_panels_apart() -> None:
    """A tube with a belt, whose equal panels were exchanged and turned: only as drawn, sewn edges lie together."""
    behind, above = Placement(np.array([40.0, 0.0, -10.0]), np.array([0.0, np.pi, 0.0])), np.array([0.0, 61.0, 0.0])
    places = [Placement(np.zeros(3), np.zeros(3)), behind]
    places += [replace(place, translation=place.translation + above) for place in places]
    panels = (replace(panel, placement=place) for panel, place in zip(tube().panels, places, strict=True))
    pattern = replace(tube(), panels=tuple(panels))
    for image in ([4, 5, 6, 7, 0, 1, 2, 3, *range(8, 16)], [*range(8), 14, 15, 12, 13, 10, 11, 8, 9]):
        answer = exchanged(pattern, {}, pattern, image)
        assert seams_of(answer) != seams_of(pattern)
        assert seams_of(placed(pattern, {}, answer)) == seams_of(pattern)


def test_without_answers_nothing_is_right() -> None:
    """As the evaluator counts: no precision without predicted seams, unless the truth has none, either."""
    score = score_stitches(graph_of(t_shirt()), [])
    assert (score.precision, score.recall, score.f1) == (0.0, 0.0, 0.0)
    bare = graph_of(replace(t_shirt(), seams=()))
    assert set(astuple(score_stitches(bare, []))) == {1.0}
    excess = score_stitches(bare, rows_of(t_shirt()))
    assert (excess.precision, excess.recall, excess.f1) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("seed", range(2))
def test_every_symmetry_of_the_truth_is_right(seed: int) -> None:
    """A ring of six equal gores: any cycle of them is the same skirt."""
    rng = np.random.default_rng(seed)
    gores = tuple(panel(f"{k}", [(0, 0), (20, 0), (15, 50), (5, 50)]) for k in range(6))
    ring = [Seam(EdgeRef(f"{k}", 1), EdgeRef(f"{(k + 1) % 6}", 3)) for k in range(6)]
    graph, order = graph_of(Pattern("skirt", gores, tuple(ring))), rng.permutation(6).tolist()
    cycle = [(4 * order[k] + 1, 4 * order[(k + 1) % 6] + 3) for k in range(6)]
    assert score_stitches(graph, cycle).perfect_symmetric == 1.0
    two_rings = [(4 * a + 1, 4 * b + 3) for a, b in ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3))]
    assert score_stitches(graph, two_rings).perfect_symmetric == 0.0
