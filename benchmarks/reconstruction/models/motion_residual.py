"""From body motion and the first frame to the garment in motion (task T8): a network corrects the skinned cloth.

Each frame is predicted alone: the network sees the garment as the skin moves it (``motions``), its ways over the frames
before, and the nearest skin, in the axes of each vertex, which turn with the bones; it moves each vertex in these axes.
At first nothing is moved, so that a training begins with the error of the baseline ``skinned``.
"""

import time
from collections.abc import Iterable, Mapping
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.draped_surfaces import GIVEN
from benchmarks.reconstruction.drapes import DrapedVertices
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, sizes_from
from benchmarks.reconstruction.models.drape_surrogate import NEAR, UNIT, depth, distance, nearest_skin
from benchmarks.reconstruction.motions import HISTORY, MotionBatch, MotionFrames
from benchmarks.reconstruction.surface_net import SurfaceNet, SurfaceNetConfig, mlp
from benchmarks.reconstruction.surfaces import METRE

TASKS = ("T8",)
WEIGHTS = {"positions": 1.0, "body": 2.0}
USUAL: Mapping[str, Any] = {"batch": 32, "lr": 5e-4, "ema": 0.998}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "train": 6, "test": 4, "resolution": 6.0, "steps": 200, "batch": 4, "lr": 2e-3, "weight_decay": 0.0, "ema": 0.9,
    "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "width": 48, "rounds": 1, "tokens": 48, "token_width": 64, "heads": 4, "layers": 1, "body": 256,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


class MotionResidual(Learner[MotionBatch, DrapedVertices]):
    """Skinned cloth to positions."""

    def __init__(self, config: SurfaceNetConfig | None = None, *, body: int = 2048) -> None:
        """``body``: points of the body."""
        super().__init__()
        self.config, self.body_points = config or SurfaceNetConfig(), body
        self.net = SurfaceNet(self.config, features=GIVEN + NEAR + HISTORY)
        self.move = nn.Sequential(*mlp(self.config.width, self.config.width, 3))
        nn.init.zeros_(cast(nn.Linear, self.move[-1]).weight)
        nn.init.zeros_(cast(nn.Linear, self.move[-1]).bias)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> MotionFrames:
        """The garments moved with the skin, and the true positions."""
        return MotionFrames(garments, tokens=self.config.tokens, body=self.body_points, device=device, workers=workers)

    def compile_parts(self) -> None:
        self.net.compile_convolutions()

    def loss(self, batch: MotionBatch) -> dict[str, Tensor]:
        weight = 1 / (batch.surface.counts[batch.surface.garments] * batch.surface.size)
        found = self._moved(batch)
        terms = {"positions": distance(found, batch.true), "body": depth(found, batch.surface, batch.body)}
        return {name: WEIGHTS[name] / UNIT * (values * weight).sum() for name, values in terms.items()}

    def predict(self, batch: MotionBatch) -> list[DrapedVertices]:
        """Positions in the frames of a batch, without their times."""
        with torch.no_grad(), torch.autocast("cuda", torch.bfloat16, enabled=batch.true.is_cuda):
            found = self._moved(batch)
        places = found.double().cpu().numpy() * METRE + CENTRE
        parts = np.split(places, np.cumsum(batch.surface.counts.tolist())[:-1])
        return [DrapedVertices(part, 0.0) for part in parts]

    def answers(
        self, examples: Examples[MotionBatch], count: int, *, batch: int, workers: int = 0
    ) -> Iterable[DrapedVertices]:
        """Each garment in all frames; the time is that of the network."""
        moving = cast(MotionFrames, examples)
        for k in range(count):
            begun = time.perf_counter()
            rows = torch.full((moving.frames - 1,), k)
            later = [frame.vertices for frame in self.predict(moving.at(rows, torch.arange(1, moving.frames)))]
            ms = 1e3 * (time.perf_counter() - begun)
            yield DrapedVertices(np.stack([moving.first(k), *later]), ms)

    def _moved(self, batch: MotionBatch) -> Float[Tensor, "v 3"]:
        """Positions [m]."""
        surface, back = batch.surface, batch.axes.mT
        near = nearest_skin(surface.positions, surface, batch.body)
        own = [(back @ part[..., None])[..., 0] for part in (near[:, :3], near[:, 3:6])]
        features, _, _ = self.net(surface, torch.cat([batch.given, *own, near[:, 6:], batch.history], dim=-1))
        with torch.autocast(features.device.type, enabled=False):  # bfloat16 would round positions to millimetres
            ways: Tensor = batch.axes @ self.move(features.float())[..., None]
        return surface.positions + UNIT * ways[..., 0]


def build(config: Mapping[str, Any]) -> MotionResidual:
    """The learner; ``config``: fields of ``SurfaceNetConfig``, and ``body``. Raises ``ConfigError`` for others."""
    least = {"convolutions": 0, "layers": 0}
    sizes, arguments = sizes_from("motion_residual", SurfaceNetConfig, config, own=("body",), least=least)
    return MotionResidual(sizes, **arguments)
