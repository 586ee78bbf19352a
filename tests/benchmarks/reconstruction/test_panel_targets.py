"""Targets of panels decode to nearly the same patterns, and repaired outlines do not cross themselves."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.panel_targets import ToTargets, fitted_curve, patterns_from, simple_panel
from gcd_dataset.curves import LINE, Arc, Cubic, Curve, curve_points
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import Rule, check_pattern
from gcd_dataset.metrics import mean_scores, score_pattern
from gcd_dataset.records import Edge, Panel, Pattern, Placement

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


def test_the_garments_of_a_set_are_encoded_one_by_one(six: GarmentSet) -> None:
    whole, part = TARGETS(six), TARGETS(six.select([4]))
    assert all(torch.equal(getattr(whole, name)[4:5], value) for name, value in vars(part).items())
    assert whole.points.shape == (6, 64, 6)
    assert whole.points.dtype == torch.float16


def test_slimness_is_perimeter_over_area() -> None:
    corners = np.array([[0.0, 0.0], [80.0, 0.0], [80.0, 5.0], [0.0, 5.0]])
    edges = tuple(Edge(i, (i + 1) % 4) for i in range(4))
    belt = Panel("belt", corners, edges, Placement(np.zeros(3), np.zeros(3)))
    targets = TARGETS.of(Pattern("", (belt,), ()))
    assert targets.slimness[0, 0].item() == pytest.approx(50 * 170 / 400)
    assert targets.extents[0, 0].tolist() == pytest.approx([0.8, 0.05])


def test_a_garment_beyond_the_sizes_is_refused(six: GarmentSet) -> None:
    for small in ({"queries": 1}, {"slots": 3}, {"edges": 7}):
        with pytest.raises(ConfigError, match="raise queries, edges or slots"):
            replace(TARGETS, **small).of(six.pattern(0))
        assert not replace(TARGETS, **small)(six.select([0])).exists.any()


def panel(corners: list[tuple[float, float]], *curves: Curve) -> Panel:
    drawn = [*curves, *[LINE] * (len(corners) - len(curves))]
    edges = tuple(Edge(i, (i + 1) % len(corners), curve) for i, curve in enumerate(drawn))
    return Panel("front", np.array(corners), edges, Placement(np.zeros(3), np.zeros(3)))


@pytest.mark.parametrize(
    "crossing",
    [
        panel([(0, 0), (40, 40), (40, 0), (0, 40)]),
        panel([(0, 0), (40, 0), (40, 30), (0, 30)], Cubic((0.5, 2.0), (0.6, 2.0))),
        panel([(0, 0), (30, 50), (60, 0), (0, 30), (60, 30)]),
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


def test_a_simple_outline_stays_as_it_is() -> None:
    bent = panel([(0, 0), (40, 0), (40, 30), (0, 30)], Arc(50.0, False, True))
    assert simple_panel(bent) == bent


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
