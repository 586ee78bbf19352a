"""The network of stitches: its invariances, its training, and how its scores become pairs of edges."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from benchmarks.reconstruction.models.stitches import (
    StitchExamples,
    StitchLearner,
    edge_noise,
    mirrored,
    revealed,
    scaled,
)
from benchmarks.reconstruction.stitching.edge_shapes import next_on_boundary
from benchmarks.reconstruction.stitching.graphs import edge_refs, graph_of
from benchmarks.reconstruction.stitching.merging import subdivided
from benchmarks.reconstruction.stitching.sewing import best_pairs, greedy_by_length, sew
from benchmarks.reconstruction.training import replace_tensors, tensors_of
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import EdgeRef, Pattern
from tests.benchmarks.reconstruction.sewn_patterns import (
    ARMHOLE_L,
    ARMHOLE_R,
    HEM,
    SIDE_L,
    SIDE_R,
    SMALL,
    batch_of,
    encode,
    net_of,
    nothing_known,
    rectangle,
    rewritten,
    t_shirt,
    tube,
)


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


def test_padding_changes_no_score() -> None:
    net, alone, beside = net_of(), batch_of(tube()), batch_of(tube(), t_shirt())
    with torch.no_grad():
        ours, theirs = net(alone, nothing_known(alone)), net(beside, nothing_known(beside))
    assert torch.allclose(ours.pairs[0, :16, :16], theirs.pairs[0, :16, :16], atol=1e-4)


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


@pytest.mark.parametrize("seed", range(2))
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


def test_each_edge_is_sewn_once() -> None:
    for found in sew(net_of(), [tube(), t_shirt()]):
        sides = [side for seam in found.seams for side in (seam.left, seam.right)]
        assert len(sides) == len(set(sides))


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


def test_a_step_never_reads_a_value_of_the_device() -> None:
    learner = StitchLearner(SMALL)
    examples = replace(many(60), one_shape=True)
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
    batch = learner.of_one_shape(many()).batch(torch.arange(48), torch.Generator().manual_seed(0))
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


@cache
def many(count: int = 240, *, large: int = 12) -> StitchExamples:
    """Garments of 16 edges, and a few of 26."""
    arrays = [encode(t_shirt() if k < large else tube()) for k in range(count)]
    return StitchLearner(SMALL).examples(arrays, device=torch.device("cpu"))


def test_batches_of_one_shape_can_replace_each_other() -> None:
    """As a recorded step needs; the last of these batches has as many large garments as the set."""
    learner = StitchLearner(SMALL)
    examples = learner.of_one_shape(many())
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


def test_wider_parts_change_no_loss() -> None:
    torch.manual_seed(0)
    learner = StitchLearner(SMALL)
    examples = many()
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
    examples = replace(many(), one_shape=True)
    rows = torch.arange(48) % 12  # the large ones only
    batch = examples.batch(rows, torch.Generator().manual_seed(0))
    small = sum(part.rows for part in batch.parts if part.width < 26)
    assert 0 < (batch.counts == 0).sum() <= small
    assert all(value.isfinite() for value in learner.loss(batch).values())
    everything = replace(many(120, large=60), one_shape=True).batch(rows, torch.Generator().manual_seed(0))
    assert (everything.counts > 0).all()


def test_what_is_drawn_for_a_garment_does_not_depend_on_the_others_of_its_batch() -> None:
    """So that two ranks, each with half of a batch, learn what one process learns."""
    examples = many()
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


def heaviest(gain: np.ndarray, free: tuple[int, ...]) -> float:
    """Weight of the best pairs among rows, by trying all."""
    if len(free) < 2:
        return 0.0
    first, rest = free[0], free[1:]
    paired = [gain[first, row] + heaviest(gain, tuple(r for r in rest if r != row)) for row in rest]
    return float(max([heaviest(gain, rest), *paired]))


@pytest.mark.parametrize("seed", range(18))
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
