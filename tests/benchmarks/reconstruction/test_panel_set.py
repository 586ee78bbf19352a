"""The panel set network: what its loss ignores, what its answers are, and that it learns."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.panel_set import SMALL, PanelSet, build, match_panels, panel_losses
from benchmarks.reconstruction.panel_net import Predicted
from benchmarks.reconstruction.panel_targets import PanelTargets, ToTargets, patterns_from, simple_panel
from benchmarks.reconstruction.point_net import regions_of
from gcd_dataset.curves import LINE, Arc, Cubic, Curve, curve_points, fitted_curve
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import Rule, Severity, check_pattern
from gcd_dataset.metrics import mean_scores, score_pattern
from gcd_dataset.records import Panel, Pattern
from tests.benchmarks.reconstruction.conftest import shuffled, started_elsewhere
from tests.benchmarks.reconstruction.toys import loss_of
from tests.generator.mesh.shapes import panel, rectangle

CPU = torch.device("cpu")


def learner(**sizes: int) -> PanelSet:
    torch.manual_seed(0)
    return build({**SMALL, "points": 128, "stored_points": 512, **sizes})


@pytest.fixture(scope="module")
def targets(six: GarmentSet) -> PanelTargets:
    return learner().prepare(six, device=CPU).whole


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


def test_regions_hold_equal_numbers_of_near_points() -> None:
    points = torch.rand(2, 513, 6, generator=torch.Generator().manual_seed(0))
    regions = regions_of(points, 8)
    assert regions.shape == (2, 8, 64, 6)
    for found, given in zip(regions, points[:, :512], strict=True):
        assert torch.equal(found.flatten(0, 1).sort(dim=0).values, given.sort(dim=0).values)
    assert (regions[..., :3].amax(dim=2) - regions[..., :3].amin(dim=2)).mean() < 0.6  # halves of a unit cube
    assert not torch.equal(regions[0, :, :, 0].flatten(), points[0, :512, 0])


def test_panels_are_matched_alike_at_every_place(six: GarmentSet) -> None:
    # As a product of matrices, which needs more than 25 rows, distances this far from the origin would be rounded.
    torch.manual_seed(0)
    targets = learner(queries=30).prepare(six, device=CPU).whole
    said = as_predicted(targets)
    said = replace(said, centres=said.centres + 0.01 * torch.randn_like(said.centres), axes=torch.zeros_like(said.axes))
    said = replace(said, extents=torch.ones_like(said.extents), edges=torch.zeros_like(said.edges))
    far = replace(said, centres=said.centres + 8192.0), replace(targets, centres=targets.centres + 8192.0)
    assert torch.equal(match_panels(*far), match_panels(said, targets))


# -------------------------------------------------------------------------------------------------------- panel targets


TARGETS = ToTargets(queries=12, slots=24, edges=96, points=64)


def test_targets_decode_to_nearly_the_same_pattern(six: GarmentSet) -> None:
    truth = [six.pattern(k) for k in range(len(six))]
    found = patterns_from(TARGETS(six))
    score = mean_scores([score_pattern(*pair) for pair in zip(found, truth, strict=True)])
    assert (score.valid, score.panel_count_acc, score.edge_count_acc, score.stitch_f1) == (1, 1, 1, 1)
    assert score.iou > 0.99
    assert score.transl_cm < 0.1
    assert score.rot_deg < 0.01
    for pattern, true in zip(found, truth, strict=True):
        assert [panel.label for panel in pattern.panels] == [panel.label for panel in true.panels]
        assert {seam.right_wrong for seam in pattern.seams} == {seam.right_wrong for seam in true.seams}
        labels = [[edge.label for panel in p.panels for edge in panel.edges] for p in (pattern, true)]
        assert labels[0] == labels[1]


def test_a_garment_beyond_the_sizes_is_refused(six: GarmentSet) -> None:
    for small in ({"queries": 1}, {"slots": 3}, {"edges": 7}):
        with pytest.raises(ConfigError, match="raise queries, edges or slots"):
            replace(TARGETS, **small).of(six.pattern(0))
        assert not replace(TARGETS, **small)(six.select([0])).exists.any()


@pytest.mark.parametrize(
    "crossing",
    [
        panel("front", [(0, 0), (40, 40), (40, 0), (0, 40)]),
        panel("front", rectangle(40, 30), curves={0: Cubic((0.5, 2.0), (0.6, 2.0))}),
        panel("front", [(0, 0), (30, 50), (60, 0), (0, 30), (60, 30)]),
    ],
)
def test_a_repaired_outline_does_not_cross_itself(crossing: Panel) -> None:
    def crosses(tried: Panel) -> bool:
        return Rule.SELF_CROSSING in {fault.rule for fault in check_pattern(Pattern("", (tried,), ()))}

    assert crosses(crossing)
    repaired = simple_panel(crossing)
    assert not crosses(repaired)
    assert len(repaired.edges) == len(crossing.edges)
    assert {tuple(corner) for corner in repaired.vertices} == {tuple(corner) for corner in crossing.vertices}


@pytest.mark.parametrize(
    "curve",
    [LINE, Cubic((0.2, 0.4), (0.7, -0.3)), Arc(12.0, False, True), Arc(12.0, True, False), Arc(30.0, False, False)],
)
def test_a_curve_is_fitted_to_its_own_points(curve: Curve) -> None:
    ends = (3.0, -2.0), (20.0, 9.0)
    fitted = fitted_curve(curve_points(*ends, curve, np.linspace(0, 1, 20)))
    assert fitted.kind == curve.kind
    middle = np.array([0.25, 0.5, 0.9])
    assert np.allclose(curve_points(*ends, fitted, middle), curve_points(*ends, curve, middle), atol=1e-6)
