"""A model in one file: points to one feature vector, their maximum (PointNet, Qi et al., CVPR 2017), and to a design.

    python -m benchmarks.reconstruction.train --model benchmarks/examples/tiny_model.py:build --task T0 --smoke \
        --device cpu --out out

Two minutes on two cores. Copy the file, change it, and give its path: nothing else names it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from benchmarks.reconstruction.design_net import DesignDecoder, drawn
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Learner, encoded_by, sizes_from
from benchmarks.reconstruction.models.parameters import Designs, ToDesigns
from gcd_dataset.records import Pattern

TASKS = ("T0", "T1", "T1-scan")
SMOKE: Mapping[str, Any] = {"train": 60, "steps": 120, "batch": 16, "lr": 3e-3, "ema": 0.9, "log_every": 10}
SMALL: Mapping[str, Any] = {"width": 64, "points": 256}
"""Options of a training with ``--smoke``, and the sizes of its network."""


@dataclass(frozen=True, slots=True)
class TinyConfig:
    """Sizes of the network: fields that ``--set`` gives."""

    width: int = 256
    """Features of a point, and of the garment."""
    points: int = 2048
    """Points of a garment."""


class TinyModel(Learner[Designs, Pattern]):
    """Points and normals to the parameters of our own programs, and so to a pattern."""

    def __init__(self, config: TinyConfig) -> None:
        super().__init__()
        self.encode = ToDesigns(config.points, labelled=False)
        self.features = nn.Sequential(nn.Linear(6, config.width), nn.GELU(), nn.Linear(config.width, config.width))
        self.decoder = DesignDecoder(config.width, heads=1, layers=1)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> Designs:
        """Inputs and targets of garments, once; the loop draws batches of their rows."""
        self.decoder.learn_range(garments)
        return encoded_by(self.encode, garments, workers).to(device)

    def loss(self, batch: Designs) -> dict[str, Tensor]:
        return self.decoder.losses(self.decoder(self.tokens(batch), batch), batch)

    def predict(self, batch: Designs) -> list[Pattern]:
        with torch.no_grad():
            return [drawn(answer) for answer in self.decoder.answers(self.tokens(batch))]

    def tokens(self, batch: Designs) -> Float[Tensor, "b 1 w"]:
        """One token for each garment."""
        found: Tensor = self.features(batch.points.float()).amax(dim=1, keepdim=True)
        return found


def build(config: Mapping[str, Any]) -> TinyModel:
    """The learner; ``config``: fields of ``TinyConfig``. Raises ``ConfigError`` for others."""
    return TinyModel(sizes_from("tiny_model", TinyConfig, config)[0])
