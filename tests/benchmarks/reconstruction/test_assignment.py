"""Assignments of a batch are those of SciPy's solver."""

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from benchmarks.reconstruction.assignment import least_cost


def test_the_total_cost_is_that_of_scipy() -> None:
    chance = torch.Generator().manual_seed(0)
    cost = 4.0 * torch.randn(24, 9, 13, generator=chance)
    asked = torch.rand(24, 9, generator=chance) < 0.7
    asked[:2] = torch.tensor([[True], [False]])
    found = least_cost(cost, asked)
    for table, rows, columns in zip(cost.numpy(), asked.numpy(), found.numpy(), strict=True):
        best = table[rows][linear_sum_assignment(table[rows])].sum()
        assert len(set(columns[rows].tolist())) == rows.sum()
        np.testing.assert_allclose(table[rows, columns[rows]].sum(), best, atol=1e-4)
        assert not columns[~rows].any()


def test_costs_that_are_no_numbers_are_avoided() -> None:
    nan = float("nan")
    cost = torch.tensor([[[nan, 1.0, 2.0], [nan, 0.0, 5.0]], [[nan] * 3, [nan] * 3]])
    found = least_cost(cost, torch.ones(2, 2, dtype=torch.bool))
    assert found[0].tolist() == [2, 1]
    assert len(set(found[1].tolist())) == 2
