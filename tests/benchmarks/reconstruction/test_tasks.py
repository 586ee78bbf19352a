"""The tasks, and the references that answer them without training."""

from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models import baselines, load_model
from benchmarks.reconstruction.models.baselines import ceiling, nearest, typical
from benchmarks.reconstruction.tasks import TASKS, task_named
from gcd_dataset.errors import ConfigError
from gcd_dataset.metrics import PatternScore, score_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS

COARSE: dict[str, Any] = {"resolution": 6.0, "design": SKIRTS}


def test_tasks_are_named_by_their_numbers() -> None:
    assert list(TASKS) == ["T0", "T1", "T1-scan", *(f"T{k}" for k in range(2, 8))]
    assert all(task.name == name for name, task in TASKS.items())
    with pytest.raises(ConfigError, match="no task 'T9': choose one of T0, T1"):
        task_named("T9")


def test_the_headlines_of_patterns_are_scores() -> None:
    headlines = {task.headline for task in TASKS.values() if task.answers_patterns}
    assert headlines <= set(PatternScore.__dataclass_fields__)


def test_the_test_set_depends_neither_on_the_task_nor_on_the_size() -> None:
    mesh = TASKS["T0"].load(3, tested=2, **COARSE)
    pattern = TASKS["T3"].load(5, tested=2, design=SKIRTS)
    assert mesh.test.patterns_hash == pattern.test.patterns_hash
    assert mesh.test.keys == pattern.test.keys
    assert mesh.train.patterns_hash == pattern.train.select(range(3)).patterns_hash
    assert mesh.train.points.shape == (3, 8192, 6)
    assert pattern.train.points.shape == (5, 0, 6)
    assert not np.isin(pattern.test.bodies, pattern.train.bodies).any()


CPU = torch.device("cpu")


def test_the_nearest_garment_to_a_training_garment_is_itself(six: GarmentSet) -> None:
    points = torch.from_numpy(six.points[..., :3]).float()
    assert baselines.nearest_garments(points[:, :256], points[:, 256:]).tolist() == [0, 1, 2, 3, 4, 5]
    answers = nearest(six, six.select([4, 1]), device=CPU)
    assert [answer == six.pattern(k) for answer, k in zip(answers, (4, 1), strict=True)] == [True, True]


def test_chamfer_distance_of_shifted_points() -> None:
    grid = torch.stack(torch.meshgrid(*[torch.arange(3.0)] * 3, indexing="ij"), dim=-1).reshape(-1, 3) * 10
    others = torch.stack([grid, grid + torch.tensor([0.0, 0.0, 3.0])])
    assert torch.allclose(baselines.chamfer_distances(grid, others), torch.tensor([0.0, 6.0]), atol=1e-3)


def test_the_most_typical_garment_is_central(six: GarmentSet) -> None:
    cloud = torch.rand(64, 3, generator=torch.Generator().manual_seed(0))
    assert baselines.most_typical(torch.stack([cloud + shift for shift in (0.0, 5.0, 9.0)])) == 1
    answers = typical(six, six.select([0, 1, 2]), device=CPU)
    assert len(answers) == 3
    assert answers[0] == answers[2]


def test_the_ceiling_is_nearly_the_truth(six: GarmentSet) -> None:
    (answer,) = ceiling(six, six.select([3]), device=CPU)
    score = score_pattern(answer, six.pattern(3))
    assert score.iou > 0.99
    assert score.stitch_f1 == 1.0


def test_task_t2_has_points_for_the_typical_garment_and_none_for_networks() -> None:
    assert TASKS["T2"].points >= baselines.POINTS
    for model in ("nearest", "panel_set", "edge_tokens"):
        assert "T2" not in load_model(model).TASKS
