"""The tasks: the same test garments for every task and size, and none of them trained on."""

from typing import Any

import numpy as np
import pytest

from benchmarks.reconstruction.tasks import TASKS, task_named
from gcd_dataset.errors import ConfigError
from gcd_dataset.metrics import PatternScore
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
