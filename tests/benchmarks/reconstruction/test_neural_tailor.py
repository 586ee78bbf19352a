"""The NeuralTailor-like baseline: its targets, its parts, that its answers can be sewn, and that it learns."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from benchmarks.reconstruction.derived import PANEL_NAMES
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.neural_tailor import (
    Drawn,
    NamedPanels,
    NeuralTailor,
    _counts,
    _edges_of_loops,
    _finer,
    _placed,
    build,
)
from benchmarks.reconstruction.tailor_net import EdgeConv, SlotEncodings, TailorConfig, nearest, sparsemax
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.metrics import score_pattern
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS

CPU = torch.device("cpu")
FINER = torch.from_numpy(_finer())


def learner(**sizes: int) -> NeuralTailor:
    torch.manual_seed(0)
    return build(smoke=True, options={"points": 64, "stored_points": 512, **sizes})


@pytest.fixture(scope="module")
def targets(six: GarmentSet) -> NamedPanels:
    whole = learner().prepare(six, device=CPU).drawn.whole
    assert isinstance(whole, NamedPanels)
    return whole


def loss_of(network: NeuralTailor, batch: NamedPanels) -> float:
    with torch.no_grad():
        return float(sum(part.item() for part in network.loss(batch).values()))


def as_drawn(true: NamedPanels, **changes: Any) -> Drawn:
    """The targets in the form of a network's output."""
    shape = true.corners.shape[:3]
    zeros = torch.zeros(shape)
    within = torch.arange(shape[2]) < true.edge_counts[..., None]
    values: dict[str, Any] = {
        "edges": _edges_of_loops(true), "bends": true.bends, "steps": 20.0 * (2.0 * within - 1.0), "kinds": zeros,
        "free": zeros, "edge_labels": torch.zeros(*shape, len(EDGE_LABELS)), "quaternions": true.quaternions,
        "centres": true.centres, "labels": torch.zeros(*shape[:2], len(PANEL_LABELS)),
    }  # fmt: skip
    return Drawn(**{**values, **changes})


def test_a_slot_at_the_border_of_its_share_has_a_finite_gradient() -> None:
    torch.manual_seed(0)
    net = SlotEncodings(TailorConfig())
    scores = net.scores[-1]
    assert isinstance(scores, torch.nn.Linear)
    with torch.no_grad():
        scores.weight.zero_()
        scores.bias.fill_(-1.0)
        scores.bias[:2] = torch.tensor([1.0, 0.0])  # sparsemax shares (1, 0): the second is 0 without being cut off
    encodings, exists = net(torch.randn(2, 16, 6 + 2 * TailorConfig().width))
    torch.autograd.backward(encodings.sum() + exists.sum())
    assert all(weight.grad is None or bool(weight.grad.isfinite().all()) for weight in net.parameters())


def test_slots_are_the_names_of_the_panels(six: GarmentSet, targets: NamedPanels) -> None:
    named = [{PANEL_NAMES[row] for row in rows[rows >= 0].tolist()} for rows in targets.names]
    assert all(len(names) == len(six.ragged["panels"][k]) for k, names in enumerate(named))
    assert all({"skirt_front", "skirt_back"} <= names for names in named)


def test_true_edges_and_quaternions_place_the_true_panels(targets: NamedPanels) -> None:
    placed = _placed(as_drawn(targets), targets.edge_counts, FINER)
    within = torch.arange(targets.corners.shape[2]) < targets.edge_counts[..., None]
    assert torch.allclose(placed.corners[within], targets.corners[within], atol=1e-3)
    assert torch.allclose(placed.rotations[targets.exists], targets.rotations[targets.exists], atol=1e-5)


def test_a_quaternion_and_its_negative_are_the_same_rotation(targets: NamedPanels) -> None:
    flipped = as_drawn(targets, quaternions=-targets.quaternions)
    found = _placed(flipped, targets.edge_counts, FINER).rotations
    assert torch.allclose(found[targets.exists], targets.rotations[targets.exists], atol=1e-5)
    network = learner()
    network.edge_deviation.fill_(1.0)
    parts = network._panel_losses(flipped, targets, targets.exists)
    assert [float(parts[name]) for name in ("rotations", "edges", "bends", "gaps", "centres")] == pytest.approx(
        [0.0] * 5, abs=1e-6
    )


def test_a_gap_is_spread_over_the_edges(targets: NamedPanels) -> None:
    shifted = as_drawn(targets, edges=_edges_of_loops(targets) + 0.01)
    placed = _placed(shifted, targets.edge_counts, FINER)
    within = torch.arange(targets.corners.shape[2]) < targets.edge_counts[..., None]
    assert torch.allclose(placed.corners[within], targets.corners[within], atol=1e-3)


def test_loops_end_where_it_is_likeliest() -> None:
    steps = torch.full((1, 4, 8), -9.0)
    steps[0, 0, :6] = torch.tensor([9.0, 9, 9, 9, -2, 1])
    steps[0, 1, :6] = torch.tensor([9.0, 9, 9, 9, -1, 2])
    steps[0, 2] = 9.0
    assert _counts(steps).tolist() == [[4, 6, 8, 3]]


def test_sparsemax_is_the_nearest_distribution() -> None:
    scores = torch.randn(64, 5, generator=torch.Generator().manual_seed(0)) * 2
    found = sparsemax(scores)
    assert torch.allclose(found.sum(dim=-1), torch.ones(64), atol=1e-6)
    assert (found >= 0).all()
    assert (found == 0).any()
    others = torch.rand(64, 500, 5, generator=torch.Generator().manual_seed(1)).clamp(min=1e-6)
    others = others / others.sum(dim=-1, keepdim=True)
    distance = (found - scores).norm(dim=-1)
    assert (distance <= (others - scores[:, None]).norm(dim=-1).amin(dim=1) + 1e-6).all()


def test_edge_features_are_those_of_the_nearest_points() -> None:
    torch.manual_seed(0)
    layer = EdgeConv(6, TailorConfig(width=8, neighbours=3))
    points = torch.randn(2, 20, 6)
    found = layer(points, points[..., :3])
    near = (points[1, 4, :3] - points[1, :, :3]).norm(dim=-1).argsort()[:3]
    alone = layer.mlp(layer.own(points[1, 4]) + layer.other(points[1, near])).amax(dim=0)
    assert torch.allclose(found[1, 4], alone, atol=1e-6)
    order = torch.randperm(20)
    assert torch.allclose(layer(points[:, order], points[:, order, :3]), found[:, order], atol=1e-6)


def test_the_nearest_points_are_found_far_from_the_origin() -> None:
    torch.manual_seed(0)
    points = torch.randn(1, 40, 3).double()
    near, far = (nearest((points + shift).float(), 5).sort().values for shift in (0.0, 100.0))
    assert torch.equal(near, far)


def test_loops_are_computed_in_float32() -> None:
    network, panels = learner(), torch.randn(1, 2, 96)
    with torch.no_grad():
        exact = network.loops.lstm(panels.flatten(0, 1)[:, None].expand(-1, 3, -1))[0]
        seen: list[torch.Tensor] = []
        network.loops.head.register_forward_pre_hook(lambda _, given: seen.append(given[0]))
        with torch.autocast("cpu", torch.bfloat16):
            network.loops(panels, 3)
    assert torch.equal(seen[0], exact)


def test_empty_rows_and_steps_change_no_loss(six: GarmentSet, targets: NamedPanels) -> None:
    network = learner()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    whole = replace(targets[torch.arange(6)], points=batch.points)
    assert batch.corners.shape[1:3] < whole.corners.shape[1:3]
    # The steps' own loss is a mean over all steps of a batch.
    parts = [
        {name: part.item() for name, part in network.loss(one).items() if name != "steps"} for one in (batch, whole)
    ]
    assert parts[0] == pytest.approx(parts[1], rel=1e-4)


def test_a_panel_of_an_unknown_name_teaches_no_outline(six: GarmentSet) -> None:
    network = learner()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    nameless = replace(batch, names=torch.full_like(batch.names, -1))
    parts = {name: part.item() for name, part in network.loss(nameless).items()}
    assert [parts[name] for name in ("edges", "bends", "rotations", "centres", "gaps")] == [0.0] * 5
    assert parts["exists"] > 0


def test_an_answer_depends_on_its_own_garment_only_and_can_be_sewn(six: GarmentSet) -> None:
    network = learner().eval()
    examples = network.prepare(six, device=CPU)
    whole, alone = (network.predict(examples.batch(torch.tensor(rows))) for rows in ([0, 3, 5], [3]))
    assert score_pattern(whole[1], alone[0]).iou == pytest.approx(1.0, abs=1e-4)
    for pattern in whole:
        assert pattern.panels
        assert not [fault for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]


def test_a_step_never_reads_a_value_of_the_device(six: GarmentSet) -> None:
    network = learner()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    with FakeTensorMode(allow_non_fake_inputs=True):  # its tensors have no values; reading one raises
        parts = network.loss(batch)
    assert all(part.shape == () for part in parts.values())


def test_the_loss_is_finite_in_half_precision(six: GarmentSet) -> None:
    network = learner()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    with torch.autocast("cpu", torch.bfloat16):
        found = loss_of(network, batch)
    assert found == pytest.approx(loss_of(network, batch), rel=0.1)


def test_the_loss_falls(six: GarmentSet) -> None:
    network = learner()
    config = TrainConfig(steps=50, batch=6, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(network, network.prepare(six, device=CPU), config, device=CPU).curve
    assert curve[-1]["loss"] < curve[0]["loss"] / 2


def test_an_unknown_size_is_refused() -> None:
    with pytest.raises(ConfigError, match="no size depth of neural_tailor: choose of panels"):
        learner(depth=3)
