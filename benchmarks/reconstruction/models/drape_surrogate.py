"""From box mesh, pattern and body to the draped garment (task T6), in two passes of a network on the mesh.

The first network sees the box mesh, the flat lengths of its edges, the labels of edges and panels, and the body as
tokens; the second sees the garment where the first has put it, beside the nearest points of the body. Each moves all
vertices. With ``--set coarse=3``, they begin with a drape of 3 cm by our solver in place of the box mesh, and an answer
takes the time of both.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.draped_surfaces import GIVEN, DrapeBatch, DrapedSurfaces
from benchmarks.reconstruction.drapes import DrapedVertices
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Learner, sizes_from, squared_distances
from benchmarks.reconstruction.surface_net import FREQUENCIES, SurfaceNet, SurfaceNetConfig, mlp, of_neighbours, waves
from benchmarks.reconstruction.surfaces import METRE, SurfaceBatch

TASKS = ("T6",)
WEIGHTS = {"first": 0.5, "positions": 1.0, "edges": 0.3, "body": 0.5}
UNIT = 0.1  # metres: a distance that costs 1
SKIN = 0.003  # metres: cloth nearer to the body costs
SEEN = 5.0  # scales distances to the body to about 1
NEAR = 7  # numbers about the nearest point of the body
SHARED = 32  # features of the first network that the second sees
USUAL: Mapping[str, Any] = {"batch": 16, "lr": 5e-4, "ema": 0.998}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 200, "batch": 4, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "width": 48, "rounds": 1, "tokens": 48, "token_width": 64, "heads": 4, "layers": 1, "body": 256, "body_tokens": 32,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


class DrapeSurrogate(Learner[DrapeBatch, DrapedVertices]):
    """Box mesh and body to positions."""

    def __init__(
        self,
        config: SurfaceNetConfig | None = None,
        *,
        body: int = 2048,
        body_tokens: int = 256,
        second_rounds: int = 1,
        coarse: int = 0,
    ) -> None:
        """``body``: points of the body; ``body_tokens``: points that are tokens; ``second_rounds``: of the second
        network; ``coarse``: see ``DrapedSurfaces``.
        """
        super().__init__()
        self.config, self.coarse = config or SurfaceNetConfig(), coarse
        self.body_points, self.body_tokens = body, body_tokens
        width = self.config.width
        self.body = nn.Sequential(*mlp(6 + 6 * FREQUENCIES, self.config.token_width, self.config.token_width))
        self.first = SurfaceNet(self.config, features=GIVEN + NEAR)
        self.first_move = nn.Sequential(*mlp(width, width, 3))
        self.shared = nn.Linear(width, SHARED)
        self.second = SurfaceNet(replace(self.config, rounds=second_rounds), features=SHARED + GIVEN + NEAR)
        self.second_move = nn.Sequential(*mlp(width, width, 3))
        for move in (self.first_move, self.second_move):  # at first nothing moves
            nn.init.zeros_(cast(nn.Linear, move[-1]).weight)
            nn.init.zeros_(cast(nn.Linear, move[-1]).bias)
        self._is_warm = False

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> "DrapedSurfaces":
        """The box meshes or coarse drapes with clusters, the bodies, and the drapes."""
        sizes = {"tokens": self.config.tokens, "body": self.body_points, "coarse": self.coarse}
        return DrapedSurfaces(garments, **sizes, device=device, workers=workers)

    def compile_parts(self) -> None:
        for net in (self.first, self.second):
            net.compile_convolutions()

    def loss(self, batch: DrapeBatch) -> dict[str, Tensor]:
        first, second = self._moved(batch)
        weight = 1 / (batch.surface.counts[batch.surface.garments] * batch.surface.size)
        truth = batch.draped

        def mean(values: Float[Tensor, " v"]) -> Float[Tensor, ""]:
            return (values * weight).sum()

        neighbours = batch.surface.neighbours
        lengths = batch.surface.lengths
        edges = (of_neighbours(second, batch.surface) - second[:, None]) - (truth[neighbours] - truth[:, None])
        off = edges.norm(dim=-1) / lengths.clamp(min=1e-3) * (lengths > 0)
        terms = {
            "first": mean(distance(first, truth)) / UNIT,
            "positions": mean(distance(second, truth)) / UNIT,
            "edges": mean(off.sum(dim=-1) / (lengths > 0).sum(dim=-1).clamp(min=1)),
            "body": mean(depth(second, batch.surface, batch.body)) / UNIT,
        }
        return {name: WEIGHTS[name] * term for name, term in terms.items()}

    def predict(self, batch: DrapeBatch) -> list[DrapedVertices]:
        """Positions, and the mean time of a garment in this batch; the first call is repeated for its time."""
        on_gpu = batch.draped.is_cuda
        with torch.no_grad(), torch.autocast("cuda", torch.bfloat16, enabled=on_gpu):
            if not self._is_warm:
                self._moved(batch)
                self._is_warm = True
            begun = _synchronised(batch.draped.device)
            _, found = self._moved(batch)
            seconds = _synchronised(batch.draped.device) - begun
        vertices = found.double().cpu().numpy() * METRE + CENTRE
        counts = batch.surface.counts.tolist()
        parts = np.split(vertices, np.cumsum(counts)[:-1])
        times = (batch.ms + 1e3 * seconds / len(counts)).tolist()
        return [DrapedVertices(part, ms) for part, ms in zip(parts, times, strict=True)]

    def _moved(self, batch: DrapeBatch) -> tuple[Float[Tensor, "v 3"], Float[Tensor, "v 3"]]:
        """Positions after each network [m]."""
        surface = batch.surface
        skin = batch.body[:, : self.body_tokens]
        context = self.body(torch.cat([skin, waves(skin[..., :3])], dim=-1))
        near = nearest_skin(surface.positions, surface, batch.body)
        features, _, _ = self.first(surface, torch.cat([batch.given, near], dim=-1), context)
        first = surface.positions + _in_float32(self.first_move, features)
        # The second network starts from where the first has put the garment, without changing it.
        put = first.detach()
        near = nearest_skin(put, surface, batch.body)
        given = torch.cat([self.shared(features).float(), batch.given, near], dim=-1)
        features, _, _ = self.second(replace(surface, positions=put), given, context)
        second = first + UNIT * _in_float32(self.second_move, features)
        return first, second


def build(config: Mapping[str, Any]) -> DrapeSurrogate:
    """The learner; ``config``: fields of ``SurfaceNetConfig``, and ``own``. Raises ``ConfigError`` for others."""
    own = ("body", "body_tokens", "second_rounds", "coarse")
    least = {"convolutions": 0, "layers": 0, "body_tokens": 0, "coarse": 0}
    sizes, arguments = sizes_from("drape_surrogate", SurfaceNetConfig, config, own=own, least=least)
    return DrapeSurrogate(sizes, **arguments)


def _in_float32(part: nn.Module, features: Float[Tensor, "v w"]) -> Float[Tensor, "v d"]:
    """The output of a part of the network: bfloat16 would round a metre to half a centimetre."""
    with torch.autocast(features.device.type, enabled=False):
        found: Tensor = part(features.float())
    return found


def distance(one: Float[Tensor, "v 3"], other: Float[Tensor, "v 3"]) -> Float[Tensor, " v"]:
    """Distances of points."""
    return (one - other).square().sum(dim=-1).add(1e-10).sqrt()


def _synchronised(device: torch.device) -> float:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


# ------------------------------------------------------------------------------------------------------------- the body


@torch.no_grad()
def nearest_rows(
    positions: Float[Tensor, "v 3"], surface: SurfaceBatch, body: Float[Tensor, "b n 6"]
) -> Int[Tensor, " v"]:
    """The row of ``body``, all bodies one after the other, of the nearest point of the wearer."""
    found = squared_distances(surface.padded(positions), body[..., :3]).argmin(dim=2)
    return found[surface.garments, surface.slots] + surface.garments * body.shape[1]


def nearest_skin(
    positions: Float[Tensor, "v 3"], surface: SurfaceBatch, body: Float[Tensor, "b n 6"]
) -> Float[Tensor, "v 7"]:
    """Offset of the nearest point of the skin, its normal, and the height of the vertex over it."""
    found = body.flatten(0, 1)[nearest_rows(positions, surface, body)]
    offset = found[:, :3] - positions
    height = -(offset * found[:, 3:]).sum(dim=-1, keepdim=True)
    return torch.cat([offset * SEEN, found[:, 3:], height * SEEN], dim=-1)


def depth(positions: Float[Tensor, "v 3"], surface: SurfaceBatch, body: Float[Tensor, "b n 6"]) -> Float[Tensor, " v"]:
    """Depth below ``SKIN`` over the body [m], measured along the normal of its nearest point."""
    found = body.flatten(0, 1)[nearest_rows(positions.detach(), surface, body)]
    height = ((positions - found[:, :3]) * found[:, 3:]).sum(dim=-1)
    return (SKIN - height).clamp(min=0)
