"""Stitches from panels: the network's invariances, n to m by subdivision, and scores up to symmetry."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import fields, replace
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from benchmarks.reconstruction.models.stitches import (
    StitchConfig,
    StitchExamples,
    StitchLearner,
    StitchNet,
    edge_noise,
    mirrored,
    revealed,
    scaled,
)
from benchmarks.reconstruction.recorded import replace_tensors, tensors_of
from benchmarks.reconstruction.stitching.edge_shapes import next_on_boundary
from benchmarks.reconstruction.stitching.gluing import glued
from benchmarks.reconstruction.stitching.graphs import EdgeBatch, PackedGraphs, edge_refs, graph_of
from benchmarks.reconstruction.stitching.intervals import score_intervals
from benchmarks.reconstruction.stitching.merging import aligned, merged, needed, split, subdivided
from benchmarks.reconstruction.stitching.run import _by_kind, write
from benchmarks.reconstruction.stitching.sewing import Subdivision, best_pairs, greedy_by_length, sew, sew_in_ways
from benchmarks.reconstruction.stitching.symmetry import StitchScore, congruences, random_symmetry, score_stitches
from gcd_dataset.curves import LINE, Arc, Curve, Quadratic
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam
from gcd_dataset.tensors import encode_pattern
from gcd_dataset.validate import check_pattern

SMALL = StitchConfig(width=32, heads=2, layers=2, pair_width=16)
HEM, SIDE_R, ARMHOLE_R, SHOULDER_R, NECK, SHOULDER_L, ARMHOLE_L, SIDE_L = range(8)
WRIST, UNDERARM_1, CAP_1, CAP_2, UNDERARM_2 = range(5)


def panel(
    name: str, corners: Sequence[tuple[float, float]], curves: dict[int, Curve], place: tuple[float, ...]
) -> Panel:
    edges = tuple(Edge(i, (i + 1) % len(corners), curves.get(i, LINE)) for i in range(len(corners)))
    return Panel(name, np.array(corners, float), edges, Placement(np.array(place, float), np.zeros(3)))


def rectangle(name: str, width: float, height: float, x: float = 0.0) -> Panel:
    return panel(name, [(0, 0), (width, 0), (width, height), (0, height)], {}, (x, 0.0, 0.0))


def t_shirt() -> Pattern:
    """Front, back and two sleeves in one piece; the cap of a sleeve is two arcs of one circle."""
    corners = [(-25, 0), (25, 0), (25, 40), (20, 60), (8, 62), (-8, 62), (-20, 60), (-25, 40)]
    half, radius = float(np.hypot(5, 20)), 30.0
    angle = half / radius
    end, top = radius * sin(angle), radius * (1 - cos(angle))
    cap = [(-15.0, -30.0), (15.0, -30.0), (end, 0.0), (0.0, top), (-end, 0.0)]
    arc = Arc(radius, large=False, right=True)
    panels = (
        panel("front", corners, {NECK: Quadratic((0.5, 0.5))}, (0, 80, 20)),
        panel("back", corners, {NECK: Quadratic((0.5, 0.1))}, (0, 80, -20)),
        panel("one", cap, {CAP_1: arc, CAP_2: arc}, (60, 120, 0)),
        panel("two", cap, {CAP_1: arc, CAP_2: arc}, (-60, 120, 0)),
    )
    pairs = [
        ("front", SIDE_R, "back", SIDE_L), ("front", SIDE_L, "back", SIDE_R),
        ("front", SHOULDER_R, "back", SHOULDER_L), ("front", SHOULDER_L, "back", SHOULDER_R),
        ("front", ARMHOLE_R, "one", CAP_2), ("back", ARMHOLE_L, "one", CAP_1),
        ("front", ARMHOLE_L, "two", CAP_1), ("back", ARMHOLE_R, "two", CAP_2),
        ("one", UNDERARM_1, "one", UNDERARM_2), ("two", UNDERARM_1, "two", UNDERARM_2),
    ]  # fmt: skip
    return Pattern("t_shirt", panels, tuple(Seam(EdgeRef(a, i), EdgeRef(b, j)) for a, i, b, j in pairs))


def tube() -> Pattern:
    """Two equal rectangles sewn at both sides, with a belt of two at the top."""
    panels = (*(rectangle(name, 40, 60) for name in ("f", "b")), *(rectangle(name, 40, 5) for name in ("bf", "bb")))
    pairs = [("f", 1, "b", 3), ("f", 3, "b", 1), ("bf", 1, "bb", 3), ("bf", 3, "bb", 1), ("f", 2, "bf", 0)]
    pairs.append(("b", 2, "bb", 0))
    return Pattern("tube", panels, tuple(Seam(EdgeRef(a, i), EdgeRef(b, j)) for a, i, b, j in pairs))


def rewritten(pattern: Pattern, rng: np.random.Generator) -> tuple[Pattern, dict[EdgeRef, EdgeRef]]:
    """The same garment in another file: panels reordered, renamed, turned and moved, loops started elsewhere."""
    panels, new_ref = [], {}
    for number in rng.permutation(len(pattern.panels)).tolist():
        old = pattern.panels[number]
        shift, angle = int(rng.integers(len(old.edges))), float(rng.uniform(0, 6))
        turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]])
        name = f"panel {rng.integers(10**9)}"
        edges = old.edges[shift:] + old.edges[:shift]
        panels.append(Panel(name, old.vertices @ turn.T + rng.normal(size=2), edges, old.placement))
        for i in range(len(edges)):
            new_ref[EdgeRef(old.name, (i + shift) % len(edges))] = EdgeRef(name, i)
    seams = tuple(Seam(new_ref[s.left], new_ref[s.right], s.right_wrong) for s in pattern.seams)
    return Pattern("other", tuple(panels), seams), new_ref


def batch_of(*patterns: Pattern) -> EdgeBatch:
    return PackedGraphs.of([graph_of(pattern) for pattern in patterns])[torch.arange(len(patterns))]


def net_of(config: StitchConfig = SMALL) -> StitchNet:
    torch.manual_seed(0)
    return StitchNet(config).eval()


def nothing_known(batch: EdgeBatch) -> torch.Tensor:
    return torch.full_like(batch.partners, -1)


def seams_of(pattern: Pattern) -> set[frozenset[EdgeRef]]:
    return {frozenset((seam.left, seam.right)) for seam in pattern.seams}


# ---------------------------------------------------------------------------------------------------------- the network


@pytest.mark.parametrize(
    "config", [SMALL, replace(StitchConfig.autosew(), width=32, layers=2)], ids=["ours", "autosew"]
)
def test_another_file_of_the_same_garment_gets_the_same_scores(config: StitchConfig) -> None:
    net, pattern = net_of(config), t_shirt()
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


def test_padding_changes_no_score() -> None:
    net, alone, beside = net_of(), batch_of(tube()), batch_of(tube(), t_shirt())
    with torch.no_grad():
        ours, theirs = net(alone, nothing_known(alone)), net(beside, nothing_known(beside))
    assert torch.allclose(ours.pairs[0, :16, :16], theirs.pairs[0, :16, :16], atol=1e-4)


def test_placement_is_seen_only_if_asked_for() -> None:
    pattern = t_shirt()
    panels = tuple(replace(p, placement=Placement(3 * p.placement.translation, np.ones(3))) for p in pattern.panels)
    here, there = batch_of(pattern), batch_of(replace(pattern, panels=panels))
    with torch.no_grad():
        for placed in (False, True):
            net = net_of(replace(SMALL, placed=placed))
            ours, theirs = net(here, nothing_known(here)), net(there, nothing_known(there))
            assert torch.allclose(ours.pairs, theirs.pairs, atol=1e-4) != placed


def test_the_boundary_turns_at_a_sewn_seam() -> None:
    pattern = t_shirt()
    batch, rows = batch_of(pattern), {ref: row for row, ref in enumerate(edge_refs(pattern))}
    known = nothing_known(batch)
    side, other = rows[EdgeRef("front", SIDE_R)], rows[EdgeRef("back", SIDE_L)]
    known[0, side], known[0, other] = other, side
    after = next_on_boundary(batch.following, known)
    assert after[0, rows[EdgeRef("front", HEM)]] == rows[EdgeRef("back", HEM)]
    assert after[0, rows[EdgeRef("back", ARMHOLE_L)]] == rows[EdgeRef("front", ARMHOLE_R)]


def test_a_mirror_image_of_a_mirror_image_is_the_garment() -> None:
    batch = batch_of(t_shirt())
    chosen = torch.tensor([True])
    twice = mirrored(mirrored(batch, chosen), chosen)
    assert all(torch.allclose(value, getattr(batch, name)) for name, value in vars(twice).items())


def test_a_garment_of_twice_the_size_has_edges_of_twice_the_length() -> None:
    batch = scaled(batch_of(t_shirt()), torch.tensor([2.0]))
    steps = batch.points.diff(dim=2).norm(dim=-1).sum(dim=-1)
    assert torch.allclose(steps, batch.lengths, rtol=1e-2)


@pytest.mark.parametrize("seed", range(4))
def test_the_fourth_variant_has_seams_of_many_parts_and_each_joins_two_edges(seed: int) -> None:
    """Runs of edges: the part after one end of a seam is sewn to the part before the other end."""
    pattern = t_shirt()
    found = subdivided(pattern, np.random.default_rng(seed), share=1.0, most=3, free=True)
    lengths = dict(zip(edge_refs(found), (v for p in found.panels for v in p.edge_lengths()), strict=True))
    assert 20 <= len(found.seams) <= 40
    assert all(lengths[seam.left] == pytest.approx(lengths[seam.right], rel=1e-2) for seam in found.seams)
    graph = graph_of(found)
    before = np.argsort(graph.following)
    runs = [
        row
        for row in np.flatnonzero(graph.partners >= 0)
        if graph.partners[graph.following[row]] == before[graph.partners[row]]
    ]
    assert len(runs) >= 20
    free = sum(len(p.edges) for p in pattern.panels) - 2 * len(pattern.seams)
    assert (graph.partners < 0).sum() >= 2 * free
    assert sum(lengths.values()) == pytest.approx(sum(v for p in pattern.panels for v in p.edge_lengths()), rel=1e-3)


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


@pytest.mark.parametrize("config", [SMALL, replace(SMALL, rounds=1, sinkhorn=10)], ids=["rounds", "sinkhorn"])
def test_each_edge_is_sewn_once(config: StitchConfig) -> None:
    for found in sew(net_of(config), [tube(), t_shirt()]):
        sides = [side for seam in found.seams for side in (seam.left, seam.right)]
        assert len(sides) == len(set(sides))


def test_sinkhorn_gives_each_edge_one_partner_in_the_mean() -> None:
    config = replace(SMALL, sinkhorn=200)
    net, batch = net_of(config), batch_of(t_shirt())
    with torch.no_grad():
        choices = net(batch, nothing_known(batch)).log_probabilities(config)[0, :26].exp()
    assert torch.allclose(choices.sum(dim=-1), torch.ones(26), atol=1e-3)


@pytest.mark.parametrize("foreign", [0.0, 0.25])
def test_foreign_variants_are_trained_on_where_asked_for(foreign: float) -> None:
    """All edges of the square tube's belts are seen whole, unless a quarter of the garments is subdivided."""
    learner = StitchLearner(replace(SMALL, foreign=foreign))
    examples = learner.examples([encode(tube())] * 12, device=torch.device("cpu"))
    assert len(examples.graphs) == 12 * (4 if foreign else 3)
    counts = {
        count
        for seed in range(8)
        for count in examples.batch(torch.arange(12), torch.Generator().manual_seed(seed)).counts.tolist()
    }
    assert (max(counts) > 20) == (foreign > 0)
    with pytest.raises(ConfigError, match="foreign"):
        replace(SMALL, foreign=0.5)


@pytest.mark.parametrize("one_shape", [False, True])
def test_a_step_never_reads_a_value_of_the_device(one_shape: bool) -> None:
    learner = StitchLearner(SMALL)
    examples = replace(many(learner), one_shape=one_shape)
    batch = examples.batch(torch.arange(48), torch.Generator().manual_seed(0))
    assert len(batch.parts) > 1
    assert sum(part.given for part in batch.parts) > 0
    with FakeTensorMode(allow_non_fake_inputs=True):  # its tensors have no values; reading one raises
        parts = learner.loss(batch)
    assert all(part.shape == () for part in parts.values())


def test_a_step_copies_nothing_from_the_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a recorded step must not; the device is one without values, for which autocast does not exist."""
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    learner, meta = StitchLearner(SMALL), torch.device("meta")
    batch = learner.of_one_shape(many(learner)).batch(torch.arange(48), torch.Generator().manual_seed(0))
    there: dict[str, Any] = {name: column.to(meta) for name, column in tensors_of(batch).items()}
    there_too = replace(batch, graphs=batch.graphs.to(meta), **there)
    learner.to(meta)
    with Devices() as used:
        torch.autograd.backward(torch.stack(list(learner.loss(there_too).values())).sum())
    assert used.kinds == {"meta"}


class Devices(TorchDispatchMode):
    """The kinds of devices of the tensors that operations in its context read or write."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.kinds: set[str] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        found = func(*args, **(kwargs or {}))
        self.kinds |= {one.device.type for one in tree_leaves((args, kwargs, found)) if isinstance(one, torch.Tensor)}
        return found


def many(learner: StitchLearner, *, large: int = 12) -> StitchExamples:
    """Garments of 16 edges, and a few of 26."""
    arrays = [encode(t_shirt() if k < large else tube()) for k in range(240)]
    return learner.examples(arrays, device=torch.device("cpu"))


def test_batches_of_one_shape_can_replace_each_other() -> None:
    """As a recorded step needs; the last of these batches has as many large garments as the set."""
    learner = StitchLearner(SMALL)
    examples = learner.of_one_shape(many(learner))
    drawn = torch.stack([torch.randint(240, (48,), generator=torch.Generator().manual_seed(k)) for k in range(8)])
    batches = [examples.batch(rows, torch.Generator().manual_seed(k)) for k, rows in enumerate(drawn)]
    assert len({batch.parts for batch in batches}) == 1
    assert [part.rows for part in batches[0].parts] != [48]
    assert len({tuple(batch.counts.tolist()) for batch in batches}) > 1
    for batch in batches[1:]:
        replace_tensors(batches[0], batch)
        assert all(torch.equal(ours, tensors_of(batch)[name]) for name, ours in tensors_of(batches[0]).items())
    with pytest.raises(ValueError, match="shapes"):
        replace_tensors(batches[0], examples.batch(drawn[0, :40], torch.Generator()))
    other = replace(examples, one_shape=False).batch(drawn[0], torch.Generator())
    with pytest.raises(ValueError, match="parts"):
        replace_tensors(batches[0], other)


@pytest.mark.parametrize("config", [SMALL, replace(StitchConfig.autosew(), width=32, layers=2)], ids=["ours", "sage"])
def test_wider_parts_change_no_loss(config: StitchConfig) -> None:
    torch.manual_seed(0)
    learner = StitchLearner(config)
    examples = many(learner)
    rows = torch.randint(240, (48,), generator=torch.Generator().manual_seed(0))
    ours, padded = (
        learner.loss(replace(examples, one_shape=one_shape).batch(rows, torch.Generator().manual_seed(1)))
        for one_shape in (False, True)
    )
    assert {name: value.item() for name, value in padded.items()} == pytest.approx(
        {name: value.item() for name, value in ours.items()}, rel=1e-4
    )


def test_a_garment_without_room_in_a_batch_of_one_shape_is_left_out() -> None:
    learner = StitchLearner(SMALL)
    examples = replace(many(learner), one_shape=True)
    rows = torch.arange(48) % 12  # the large ones only
    batch = examples.batch(rows, torch.Generator().manual_seed(0))
    small = sum(part.rows for part in batch.parts if part.width < 26)
    assert 0 < (batch.counts == 0).sum() <= small
    assert all(value.isfinite() for value in learner.loss(batch).values())
    everything = replace(many(learner, large=120), one_shape=True).batch(rows, torch.Generator().manual_seed(0))
    assert (everything.counts > 0).all()


def test_what_is_drawn_for_a_garment_does_not_depend_on_the_others_of_its_batch() -> None:
    """So that two ranks, each with half of a batch, learn what one process learns."""
    examples = many(StitchLearner(SMALL))
    rows = torch.randperm(240, generator=torch.Generator().manual_seed(0))[:48]
    whole, *halves = (
        sorted(torch.stack([column.double() for column in tensors_of(batch).values()], dim=1).tolist())
        for some in (rows, rows[::2], rows[1::2])
        for batch in [examples.batch(some, torch.Generator().manual_seed(1))]
    )
    assert sorted([*halves[0], *halves[1]]) == whole


def test_numbers_that_vary_the_order_of_seams_are_uniform_and_independent() -> None:
    numbers = edge_noise(torch.arange(2000) * 7919, 64).double()
    assert numbers.min() >= 0 and numbers.max() < 1
    counts = torch.histc(numbers, 64, 0, 1)
    assert ((counts - 2000).square() / 2000).sum() < 120  # chi square of 63 degrees
    centred = numbers - 0.5
    for other in (centred.roll(1, 0), centred.roll(1, 1)):
        assert abs((centred * other).mean() * 12) < 0.015


def test_a_step_of_training_lowers_the_loss_of_the_same_batch() -> None:
    torch.manual_seed(0)
    learner = StitchLearner(SMALL)
    examples = learner.examples([encode(t_shirt()), encode(tube())], device=torch.device("cpu"))
    batch = examples.batch(torch.tensor([0, 1]), torch.Generator().manual_seed(0))
    optimizer = torch.optim.SGD(learner.parameters(), lr=1e-2)
    losses = []
    for _ in range(2):
        loss = torch.stack(list(learner.loss(batch).values())).sum()
        losses.append(loss.item())
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
    assert losses[1] < losses[0]


def test_a_learner_answers_with_the_panels_of_the_garment() -> None:
    learner = StitchLearner(SMALL).eval()
    examples = learner.examples([encode(tube()), encode(t_shirt())], device=torch.device("cpu"))
    found = learner.predict(examples.batch(torch.tensor([1, 0])))
    assert [len(pattern.panels) for pattern in found] == [4, 4]
    assert [len(pattern.panels[0].edges) for pattern in found] == [8, 4]


def encode(pattern: Pattern) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    tensor = encode_pattern(pattern)
    return tensor.panels, tensor.edges, tensor.stitches


def rows_of(pattern: Pattern) -> list[tuple[int, int]]:
    rows = {ref: row for row, ref in enumerate(edge_refs(pattern))}
    return [(rows[seam.left], rows[seam.right]) for seam in pattern.seams]


def heaviest(gain: np.ndarray, free: tuple[int, ...]) -> float:
    """Weight of the best pairs among rows, by trying all."""
    if len(free) < 2:
        return 0.0
    first, rest = free[0], free[1:]
    paired = [gain[first, row] + heaviest(gain, tuple(r for r in rest if r != row)) for row in rest]
    return float(max([heaviest(gain, rest), *paired]))


@pytest.mark.parametrize("seed", range(40))
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


def test_three_edges_that_fit_each_other_are_one_pair_and_a_free_edge() -> None:
    gain = np.zeros((7, 7))
    for a, b, weight in [(0, 1, 2.0), (1, 2, 2.0), (0, 2, 2.0), (3, 4, 1.0), (4, 5, 1.5), (5, 6, 1.0)]:
        gain[a, b] = gain[b, a] = weight
    pairs = best_pairs(gain)
    assert pairs[1:] == [(3, 4), (5, 6)]
    assert pairs[0] in [(0, 1), (1, 2), (0, 2)]


def test_greedy_sews_edges_of_equal_length() -> None:
    pattern = Pattern("two", (rectangle("a", 30, 10), rectangle("b", 50, 20)), ())
    assert {frozenset(pair[:2]) for pair in greedy_by_length(batch_of(pattern))[0]} == {
        frozenset(rows) for rows in ((0, 2), (1, 3), (4, 6), (5, 7))
    }


# --------------------------------------------------------------------------------------------------------------- n to m


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


@pytest.mark.parametrize("way", [Subdivision(), Subdivision(-9.0), Subdivision(-9.0, revised=True)], ids=str)
def test_revised_subdivisions_separate_seams(way: Subdivision) -> None:
    """A network that has learnt nothing subdivides all edges at so low a log-odds; needless cuts are taken back."""
    pattern = replace(t_shirt(), seams=())
    found = sew(net_of(), [pattern], subdivide=way, rounds=1)[0]
    count = sum(len(p.edges) for p in found.panels) - sum(len(p.edges) for p in pattern.panels)
    assert (count > 0) == (way.logit < 0)
    if way.revised:
        assert count < sum(
            len(p.edges) for p in sew(net_of(), [pattern], subdivide=Subdivision(way.logit), rounds=1)[0].panels
        ) - sum(len(p.edges) for p in pattern.panels)


def test_ways_of_subdivision_are_those_of_one_way_each() -> None:
    joined = merged(t_shirt())
    assert joined is not None
    torch.manual_seed(3)
    net = StitchNet(replace(SMALL, rounds=1)).eval()
    several = list(sew_in_ways(net, [joined.pattern], (0.0, -9.0)))
    assert [(way.logit, way.revised) for way, _ in several] == [(0.0, False), (0.0, True), (-9.0, False), (-9.0, True)]
    for way, (found,) in several:
        assert found.seams == sew(net, [joined.pattern], subdivide=way)[0].seams
    counts = [sum(len(panel.edges) for panel in found.panels) for _, (found,) in several]
    assert counts[2] > counts[0]
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


# ------------------------------------------------------------------------------------------------------------- symmetry


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
