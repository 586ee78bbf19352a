"""A compiled network learns as the plain one does.

Compiled by ``aot_eager``: the graphs, forward and backward, without the generated C++, whose compilation takes minutes.
"""

from functools import partialmethod

import pytest
import torch

from benchmarks.reconstruction.garments import generated
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.train import train
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.benchmarks.reconstruction.toys import small

CPU = torch.device("cpu")


# Of torch's own code.
@pytest.mark.filterwarnings("ignore:`torch.jit.script_method`:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor:UserWarning")
@pytest.mark.parametrize(("model", "sizes"), [("panel_set", {"points": 128, "stored_points": 256}), ("stitches", {})])
def test_a_compiled_network_learns_the_same(model: str, sizes: dict[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.nn.Module, "compile", partialmethod(torch.nn.Module.compile, backend="aot_eager"))
    garments = generated(8, 0, points=256, drape=None, resolution=6.0, design=SKIRTS)
    losses = []
    for is_compiled in (False, True):
        torch.manual_seed(0)
        learner = small(model, **sizes)
        config = Config(steps=6, batch=3, lr=1e-4, log_every=1, ema=0.0, compile=is_compiled)
        trained = train(learner, learner.prepare(garments, device=CPU), config, device=CPU)
        losses.append([row["loss"] for row in trained.curve])
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
