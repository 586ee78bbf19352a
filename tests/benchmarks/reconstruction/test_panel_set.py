"""The panel set network: what its loss ignores, what its answers are, and that it learns."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.panel_set import PanelSet, _partners, build, edges_of, match_panels, panel_losses
from benchmarks.reconstruction.panel_net import Predicted, rotation_of
from benchmarks.reconstruction.panel_targets import PanelTargets
from benchmarks.reconstruction.point_net import PointConfig, PointTokens, regions_of, some_of
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.metrics import score_pattern
from tests.benchmarks.reconstruction.conftest import shuffled, started_elsewhere

CPU = torch.device("cpu")


def learner(**sizes: int) -> PanelSet:
    torch.manual_seed(0)
    return build(smoke=True, options={"points": 128, "stored_points": 512, **sizes})


@pytest.fixture(scope="module")
def targets(six: GarmentSet) -> PanelTargets:
    return learner().prepare(six, device=CPU).whole


def loss_of(network: PanelSet, true: PanelTargets) -> float:
    with torch.no_grad():
        return float(sum(part.item() for part in network.loss(true).values()))


@pytest.mark.parametrize("change", [shuffled, started_elsewhere])
def test_the_loss_ignores_the_order_of_panels_and_the_start_of_loops(
    change: Callable[[PanelTargets], PanelTargets], targets: PanelTargets
) -> None:
    network = learner()
    assert not torch.equal(change(targets).corners, targets.corners)
    assert loss_of(network, change(targets)) == pytest.approx(loss_of(network, targets), rel=1e-4)


def as_predicted(true: PanelTargets) -> Predicted:
    """The targets in the form of a network's output."""
    slots = true.corners.shape[2]
    return Predicted(
        exists=20.0 * (2.0 * true.exists.float() - 1.0),
        corners=true.corners,
        bends=true.bends,
        extents=true.extents.clamp(min=1e-3),
        centres=true.centres,
        axes=true.rotations[..., :2].transpose(-1, -2).flatten(-2),
        edges=40.0 * torch.nn.functional.one_hot(true.edge_counts, slots + 1).float(),
        labels=40.0 * torch.nn.functional.one_hot(true.labels, 4).float(),
    )


def test_the_targets_as_prediction_have_zero_loss(targets: PanelTargets) -> None:
    for changed in (targets, shuffled(targets), started_elsewhere(targets)):
        parts, _, _ = panel_losses(as_predicted(changed)[None], targets)
        assert sum(part.item() for part in parts.values()) == pytest.approx(0.0, abs=1e-4)
    queries = match_panels(as_predicted(targets), targets)
    own = torch.arange(queries.shape[1]).expand_as(queries)
    assert torch.equal(queries[targets.exists], own[targets.exists])


def test_an_answer_depends_on_its_own_garment_only(six: GarmentSet) -> None:
    network = learner().eval()
    examples = network.prepare(six, device=CPU)
    whole, alone = (network.predict(examples.batch(torch.tensor(rows))) for rows in ([0, 3, 5], [3]))
    score = score_pattern(whole[1], alone[0])
    assert len(whole) == 3
    assert (score.panel_count_acc, score.edge_count_acc) == (1, 1)
    assert score.iou == pytest.approx(1.0, abs=1e-4)


def test_answers_can_be_sewn_even_before_training(six: GarmentSet) -> None:
    network = learner().eval()
    for pattern in network.predict(network.prepare(six, device=CPU).batch(torch.arange(6))):
        assert pattern.panels
        assert not [fault for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]


def test_processes_encode_the_same_targets(six: GarmentSet) -> None:
    one, two = (learner().prepare(six, device=CPU, workers=workers).whole for workers in (0, 2))
    assert all(torch.equal(value, getattr(two, name)) for name, value in vars(one).items())


def test_regions_hold_equal_numbers_of_near_points() -> None:
    chance = torch.Generator().manual_seed(0)
    points = torch.rand(2, 513, 6, generator=chance)
    regions = regions_of(points, 8)
    assert regions.shape == (2, 8, 64, 6)
    for found, given in zip(regions, points[:, :512], strict=True):
        assert torch.equal(found.flatten(0, 1).sort(dim=0).values, given.sort(dim=0).values)
    assert (regions[..., :3].amax(dim=2) - regions[..., :3].amin(dim=2)).mean() < 0.6  # halves of a unit cube
    one_row = regions[0, :, :, 0].flatten()
    assert not torch.equal(one_row, points[0, :512, 0])


def test_a_training_step_sees_some_of_the_regions_and_an_answer_all() -> None:
    tokens = PointTokens(PointConfig(tokens=16, seen=5, region_width=8, width=12, heads=2, layers=1))
    points = torch.rand(2, 64, 6)
    assert tokens.train()(points).shape == (2, 5, 12)
    assert not torch.equal(tokens(points), tokens(points))
    assert tokens.eval()(points).shape == (2, 16, 12)
    assert torch.equal(tokens(points), tokens(points))


def test_regions_that_are_seen_are_regions_each_at_most_once() -> None:
    regions = torch.arange(2 * 16, dtype=torch.float32).view(2, 16, 1, 1).expand(2, 16, 3, 6)
    for garment, seen in enumerate(some_of(regions, 9)[:, :, 0, 0].long().tolist()):
        assert len(set(seen)) == 9
        assert {number // 16 for number in seen} == {garment}
    assert some_of(regions, 99).shape == regions.shape


def test_rows_that_are_empty_in_all_garments_change_no_loss(six: GarmentSet) -> None:
    network = learner()
    examples = network.prepare(six, device=CPU)
    batch = examples.batch(torch.arange(6))
    whole = replace(examples.whole[torch.arange(6)], points=batch.points)
    assert batch.edge_panels.shape[1] < whole.edge_panels.shape[1]
    assert loss_of(network, batch) == pytest.approx(loss_of(network, whole), rel=1e-4)


def test_a_garment_beyond_the_sizes_teaches_nothing(targets: PanelTargets) -> None:
    network = learner()
    empty = replace(targets, exists=targets.exists & (torch.arange(6) > 0)[:, None])
    empty = replace(empty, edge_panels=torch.where(torch.arange(6)[:, None] > 0, empty.edge_panels, -1))
    network.zero_grad()
    torch.autograd.backward(torch.stack(list(network.loss(empty).values())).sum())
    ours = [p.grad.clone() for p in network.parameters() if p.grad is not None]
    network.zero_grad()
    torch.autograd.backward(torch.stack(list(network.loss(empty[1:]).values())).sum())
    theirs = [p.grad for p in network.parameters() if p.grad is not None]
    assert all(torch.allclose(one, other, atol=1e-4) for one, other in zip(ours, theirs, strict=True))


def test_a_step_asks_for_no_value_on_the_device(targets: PanelTargets, monkeypatch: pytest.MonkeyPatch) -> None:
    # Tensors of the device "meta" have no values: whatever would wait for a GPU to read one raises an error.
    def assigned(cost: torch.Tensor, asked: torch.Tensor) -> torch.Tensor:
        return torch.zeros(asked.shape, dtype=torch.int64, device=cost.device)

    def no_autocast(kind: str, *, enabled: bool) -> AbstractContextManager[None]:
        return nullcontext()  # the device has none

    monkeypatch.setattr("benchmarks.reconstruction.models.panel_set.least_cost", assigned)
    monkeypatch.setattr(torch, "autocast", no_autocast)
    meta = torch.device("meta")
    network, batch = learner().to(meta), targets[:2].with_points(128, torch.Generator()).to(meta)
    loss = torch.stack(list(network.loss(batch).values())).sum()
    torch.autograd.backward(loss)
    with pytest.raises(RuntimeError):
        loss.item()


def test_points_are_drawn_anew_for_each_step(six: GarmentSet) -> None:
    examples = learner().prepare(six, device=CPU)
    first, again, other = (
        examples.batch(torch.tensor([2]), torch.Generator().manual_seed(seed)).points for seed in (1, 1, 2)
    )
    assert first.shape == (1, 128, 6)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_the_loss_falls(six: GarmentSet) -> None:
    network = learner(tokens=16)
    config = TrainConfig(steps=20, batch=6, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(network, network.prepare(six, device=CPU), config, device=CPU).curve
    assert curve[-1]["loss"] < 0.8 * curve[0]["loss"]


def test_the_likeliest_pairs_are_sewn_first() -> None:
    logits = torch.tensor([[[-9.0, 5, 4, -9, 0], [5, -9, 3, -9, 0], [4, 3, -9, 0.5, 0], [-9, -9, 0.5, -9, 2]]])
    exists = torch.tensor([[True, True, True, True]])
    assert _partners(logits, exists).tolist() == [[1, 0, -1, -1]]
    assert _partners(logits, exists & torch.tensor([True, False, True, True])).tolist() == [[2, -1, 0, -1]]


def test_edges_follow_each_other_in_the_loops_of_existing_panels() -> None:
    edges = edges_of(torch.tensor([[True, False, True, True]]), torch.tensor([[3, 9, 4, 5]]), room=8)
    assert edges.queries.tolist() == [[0, 0, 0, 2, 2, 2, 2, 0]]
    assert edges.slots.tolist() == [[0, 1, 2, 0, 1, 2, 3, 0]]
    assert edges.following.tolist() == [[1, 2, 0, 1, 2, 3, 0, 0]]
    assert edges.exists.tolist() == [[True] * 7 + [False]]


def test_two_columns_give_a_rotation() -> None:
    rotations = rotation_of(torch.randn(5, 6, generator=torch.Generator().manual_seed(0)))
    assert torch.allclose(rotations @ rotations.transpose(1, 2), torch.eye(3).expand(5, 3, 3), atol=1e-5)
    assert torch.allclose(torch.linalg.det(rotations), torch.ones(5))


def test_regions_are_a_power_of_two() -> None:
    with pytest.raises(ConfigError, match="24 tokens of 128 points: give a power of 2"):
        learner(tokens=24)


def test_panels_are_matched_alike_at_every_place(six: GarmentSet) -> None:
    # As a product of matrices, which needs more than 25 rows, distances this far from the origin would be rounded.
    torch.manual_seed(0)
    targets = learner(queries=30).prepare(six, device=CPU).whole
    said = as_predicted(targets)
    said = replace(said, centres=said.centres + 0.01 * torch.randn_like(said.centres), axes=torch.zeros_like(said.axes))
    said = replace(said, extents=torch.ones_like(said.extents), edges=torch.zeros_like(said.edges))
    far = replace(said, centres=said.centres + 8192.0), replace(targets, centres=targets.centres + 8192.0)
    assert torch.equal(match_panels(*far), match_panels(said, targets))
