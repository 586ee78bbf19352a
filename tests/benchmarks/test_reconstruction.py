"""The reconstruction benchmark on small garments: the tests take seconds."""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.data import (
    Arrays,
    GarmentBatch,
    ToTargets,
    fitted_curve,
    pattern_of,
    patterns_from,
    shares,
)
from benchmarks.reconstruction.evaluate import predict, scores_of
from benchmarks.reconstruction.models import NetConfig, PatternNet, Predicted, match_panels, rotation_of, set_loss
from benchmarks.reconstruction.nearest import chamfer_distances, most_typical, nearest_garments
from benchmarks.reconstruction.train import add_arguments, learning_rate, load, train
from benchmarks.run import main
from gcd_dataset.curves import LINE, Arc, Cubic, Curve, curve_points
from gcd_dataset.errors import ConfigError
from gcd_dataset.metrics import mean_scores

PLAIN = """
[meta]
upper = { options = ["Shirt", "none"] }
bottom = { options = ["SkirtCircle", "none"] }
[sleeve]
cuff.type = "none"
[collar]
component.style = "none"
[left]
enable_asym = false
"""
TINY = NetConfig(queries=40, contour_points=64, tokens=16, neighbours=8, width=32, heads=2, layers=1)


def options(**changes: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    small = {"train": 4, "test": 0, "resolution": 4.0, "points": 128, "stored_points": 512, "batch": 4, "lr": 3e-3}
    network = {"queries": 40, "tokens": 16, "neighbours": 8, "width": 64, "heads": 2, "layers": 1}
    return argparse.Namespace(**{**vars(parser.parse_args([])), **small, **network, **changes})


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[GarmentBatch, list[Arrays]]]:
    """Four plain generated garments; tiny networks are fastest on one thread."""
    plain = tmp_path_factory.mktemp("designs") / "plain.toml"
    plain.write_text(PLAIN)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield load(options(design=str(plain)))
    torch.set_num_threads(threads)


def predicted_for(garments: GarmentBatch) -> list[Predicted]:
    torch.manual_seed(0)
    with torch.no_grad():
        return PatternNet(TINY)(garments.points[:, :128].float())


def loss_of(predicted: list[Predicted], true: GarmentBatch) -> float:
    return float(sum(part.item() for part in set_loss(predicted, true).values()))


def shuffled(garments: GarmentBatch) -> GarmentBatch:
    order = torch.randperm(garments.exists.shape[1], generator=torch.Generator().manual_seed(1))
    panels = {name: value[:, order] for name, value in vars(garments).items() if name != "points"}
    return replace(garments, **panels)


def started_elsewhere(garments: GarmentBatch) -> GarmentBatch:
    return replace(garments, contours=garments.contours.roll(11, dims=2), corners=garments.corners.roll(11, dims=2))


@pytest.mark.parametrize("change", [shuffled, started_elsewhere])
def test_the_loss_ignores_the_order_of_panels_and_the_start_of_contours(
    change: Callable[[GarmentBatch], GarmentBatch], four: tuple[GarmentBatch, list[Arrays]]
) -> None:
    predicted = predicted_for(four[0])
    assert loss_of(predicted, change(four[0])) == pytest.approx(loss_of(predicted, four[0]), rel=1e-5)


def as_predicted(garments: GarmentBatch) -> Predicted:
    """The targets in the form of a network's output."""
    edges = torch.nn.functional.one_hot(garments.edge_counts, 41).float()
    return Predicted(
        exists=20.0 * (2.0 * garments.exists.float() - 1.0),
        contours=garments.contours,
        corners=20.0 * (2.0 * garments.corners - 1.0),
        centres=garments.centres,
        rotations=garments.rotations,
        edges=40.0 * edges,
    )


def test_the_targets_as_prediction_have_zero_loss(four: tuple[GarmentBatch, list[Arrays]]) -> None:
    said = as_predicted(shuffled(four[0]))
    assert loss_of([said], four[0]) == pytest.approx(0.0, abs=1e-5)
    rows, queries, panels = match_panels(as_predicted(four[0]), four[0])
    assert torch.equal(queries, panels)
    assert len(rows) == int(four[0].exists.sum())


def test_targets_decode_to_nearly_the_same_pattern(four: tuple[GarmentBatch, list[Arrays]]) -> None:
    truth = [pattern_of(arrays) for arrays in four[1]]
    score = mean_scores(scores_of(patterns_from(four[0]), truth))
    assert (score.valid, score.panel_count_acc, score.edge_count_acc) == (1, 1, 1)
    assert score.iou > 0.99
    assert score.transl_cm < 0.1
    assert score.rot_deg < 0.01


def test_training_overfits_four_garments(four: tuple[GarmentBatch, list[Arrays]]) -> None:
    losses: list[float] = []
    args = options(steps=360)
    net = train(four[0], args, torch.device("cpu"), losses)
    assert np.mean(losses[-10:]) < 0.2 * np.mean(losses[:10])
    seen = replace(four[0], points=four[0].points[:, : args.points])
    answer = predict(net, seen, batch=4, device=torch.device("cpu"))
    score = mean_scores(scores_of(answer, [pattern_of(arrays) for arrays in four[1]]))
    assert score.panel_count_acc == 1
    assert score.iou > 0.7


def test_the_same_seed_trains_the_same_network(four: tuple[GarmentBatch, list[Arrays]]) -> None:
    losses: tuple[list[float], list[float]] = ([], [])
    for told in losses:
        train(four[0], options(steps=3), torch.device("cpu"), told)
    assert losses[0] == losses[1]


def test_the_nearest_garment_to_a_training_garment_is_itself(four: tuple[GarmentBatch, list[Arrays]]) -> None:
    points = four[0].points[..., :3].float()
    assert nearest_garments(points[:, :256], points[:, 256:]).tolist() == [0, 1, 2, 3]


def test_chamfer_distance_of_shifted_points() -> None:
    grid = torch.stack(torch.meshgrid(*[torch.arange(3.0)] * 3, indexing="ij"), dim=-1).reshape(-1, 3) * 10
    others = torch.stack([grid, grid + torch.tensor([0.0, 0.0, 3.0])])
    assert torch.allclose(chamfer_distances(grid, others), torch.tensor([0.0, 6.0]), atol=1e-3)


def test_the_most_typical_garment_is_central() -> None:
    cloud = torch.rand(64, 3, generator=torch.Generator().manual_seed(0))
    assert most_typical(torch.stack([cloud + shift for shift in (0.0, 5.0, 9.0)])) == 1


def test_points_are_divided_by_edge_length() -> None:
    assert shares(np.array([30.0, 10.0, 30.0, 10.0]), 20) == [7, 3, 7, 3]
    assert shares(np.array([1000.0, 0.01, 0.01]), 8) == [6, 1, 1]
    with pytest.raises(ConfigError, match="raise --contour-points"):
        shares(np.ones(9), 8)


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


def test_a_garment_with_too_many_panels_is_refused(four: tuple[GarmentBatch, list[Arrays]]) -> None:
    with pytest.raises(ConfigError, match="raise --queries"):
        ToTargets(1, 64, 128).of(pattern_of(four[1][0]))


def test_two_columns_give_a_rotation() -> None:
    rotations = rotation_of(torch.randn(5, 6, generator=torch.Generator().manual_seed(0)))
    assert torch.allclose(rotations @ rotations.transpose(1, 2), torch.eye(3).expand(5, 3, 3), atol=1e-5)
    assert torch.allclose(torch.linalg.det(rotations), torch.ones(5))


def test_the_learning_rate_rises_then_falls() -> None:
    rates = [learning_rate(step, 100) for step in range(100)]
    assert max(rates) == rates[5] == 1.0
    assert rates[0] == pytest.approx(0.2)
    assert rates[-1] < 0.001


def test_the_case_prints_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = vars(options(train=6, test=2, steps=2, queries=40))
    flags = [
        f"--{name.replace('_', '-')}={value}" for name, value in small.items() if name not in ("smoke", "cache_dir")
    ]
    assert main(["reconstruction", "--report", str(tmp_path / "report.md"), *flags]) == 0
    printed = capsys.readouterr().out
    for name in ("network_iou", "nearest_iou", "typical_iou", "ceiling_iou", "load_rate"):
        assert f"reconstruction.{name} " in printed
    report = (tmp_path / "report.md").read_text()
    assert "python -m benchmarks.run reconstruction" in report
    assert "| network |" in report
