"""A learner that fits a line, for tests of the training loop."""

import os
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from benchmarks.reconstruction.learners import Learner, TensorExamples
from benchmarks.reconstruction.training import TrainConfig, one_of_several_ranks, train


@dataclass(frozen=True)
class Line(TensorExamples):
    """Points of the line y = 2 x0 - x1 + 1."""

    x: Float[Tensor, "b 2"]
    y: Float[Tensor, " b"]


def line(count: int = 64) -> Line:
    x = torch.randn(count, 2, generator=torch.Generator().manual_seed(1))
    return Line(x, x @ torch.tensor([2.0, -1.0]) + 1.0)


class LineLearner(Learner[Line, float]):
    """A line, and dropout, which draws from the global random stream."""

    def __init__(self, dropout: float = 0.0) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.net = nn.Sequential(nn.Dropout(dropout), nn.Linear(2, 1))

    def prepare(self, garments: object, *, device: torch.device, workers: int = 0) -> Line:
        return line().to(device)

    def loss(self, batch: Line) -> dict[str, Tensor]:
        return {"square": (self.net(batch.x)[:, 0] - batch.y).square().mean()}

    def predict(self, batch: Line) -> list[float]:
        with torch.no_grad():
            return self.net(batch.x)[:, 0].tolist()


def train_rank(rank: int, world: int, port: int, steps: int, file: Path) -> None:
    """Train as one rank of several, which meet at a store on ``port``, and write the first rank's weights."""
    os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": str(world), "MASTER_PORT": str(port)}
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "TORCHELASTIC_USE_AGENT_STORE": "True"}
    os.environ["TORCHELASTIC_RESTART_COUNT"] = "0"
    torch.set_num_threads(1)
    with one_of_several_ranks("cpu") as device:
        found = train(LineLearner(), line(), TrainConfig(steps=steps, batch=8, lr=0.1), device=device)
    if rank == 0:
        torch.save(found.learner.state_dict(), file)
