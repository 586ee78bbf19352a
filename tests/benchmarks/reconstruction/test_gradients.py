"""Every parameter that is trained has a gradient: ranks of a distributed training wait for all of them."""

from types import ModuleType

import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models import edge_tokens, panel_set, parameters


@pytest.mark.parametrize("module", [edge_tokens, panel_set, parameters])
def test_every_trained_parameter_has_a_gradient(module: ModuleType, six: GarmentSet) -> None:
    torch.manual_seed(0)
    learner = module.build(smoke=True, options={"points": 128, "stored_points": 512})
    batch = learner.prepare(six, device=torch.device("cpu")).batch(torch.arange(6))
    torch.autograd.backward(torch.stack(list(learner.loss(batch).values())).sum())
    assert [name for name, p in learner.named_parameters() if p.requires_grad and p.grad is None] == []
