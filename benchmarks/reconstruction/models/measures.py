"""From points of a dressed person, as four cameras see it, to the 26 measures of the body underneath (task T5).

Points are grouped into regions, and each region becomes a token, as in ``panel_set``; the measures come from a
token of their own, and from the mean and the largest features of all tokens.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Learner, TensorExamples, sizes_from, squared_distances, uploaded
from benchmarks.reconstruction.surface_net import FREQUENCIES, LAYER_OPTIONS, mlp, waves
from benchmarks.reconstruction.surfaces import METRE
from gcd_dataset.errors import ConfigError
from gcd_dataset.measurements import ANGLES, MEASURES

TASKS = ("T5",)
POINT = 7  # numbers of a point: position, normal, whether on the garment
REGION_SCALE = 10.0  # scales offsets within a region to about 1
MOST_YAW = 0.3  # rad, of the augmentation
MOST_GROWTH = 0.08  # share, of the augmentation: lengths grow with the points, angles do not
LEAST_DEVIATION = 1e-3  # cm, degrees
DIVISIONS = 4  # of a scan, to answer: which points a network sees is a sixth of its error
USUAL: Mapping[str, Any] = {"batch": 128, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 300, "batch": 8, "lr": 2e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "width": 64, "heads": 4, "layers": 2, "tokens": 48, "neighbours": 16, "points": 512, "augmented": 0,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


@dataclass(frozen=True, slots=True)
class MeasureConfig:
    """Sizes of a network."""

    width: int = 256
    heads: int = 8
    layers: int = 6
    tokens: int = 256
    """Regions."""
    neighbours: int = 32
    """Points of a region."""
    points: int = 2048
    """Points of a person in a step, drawn from all of its scan."""
    augmented: int = 1
    """1 to draw points, turn and scale persons at random in training; 0: always the same points."""


@dataclass(frozen=True)
class Scans(TensorExamples):
    """Scans of dressed persons, with the measures of their bodies."""

    points: Float[Tensor, "b n 7"]
    """Positions relative to ``CENTRE`` [m], normals, whether on the garment; in random order."""
    measures: Float[Tensor, "b m"]
    """[cm, degrees]"""


@dataclass(frozen=True)
class _Drawn:
    """Scans; each batch draws some of the points, turned about the vertical and scaled."""

    whole: Scans
    points: int
    augmented: bool

    def __len__(self) -> int:
        return len(self.whole)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> Scans:
        found = self.whole.batch(rows)
        if chance is None or not self.augmented:
            return found
        device = found.points.device
        chosen = uploaded(torch.randperm(found.points.shape[1], generator=chance)[: self.points], device)
        draws = 2 * uploaded(torch.rand(len(self), 2, generator=chance)[rows], device) - 1
        yaw, growth = MOST_YAW * draws[:, 0], 1 + MOST_GROWTH * draws[:, 1]
        zero, one = torch.zeros_like(yaw), torch.ones_like(yaw)
        columns = [yaw.cos(), zero, yaw.sin(), zero, one, zero, -yaw.sin(), zero, yaw.cos()]
        turn = torch.stack(columns, dim=1).reshape(-1, 3, 3).transpose(1, 2)
        points = found.points[:, chosen]
        # The floor stays at its height: CENTRE is a metre above it.
        lift = (torch.arange(3, device=device) == 1).float()  # made there: the device is not waited for
        place = ((points[..., :3] + lift) @ turn) * growth[:, None, None] - lift
        grown = torch.where(_angles(device), found.measures, found.measures * growth[:, None])
        return Scans(torch.cat([place, points[..., 3:6] @ turn, points[..., 6:]], dim=-1), grown)


class MeasureNet(Learner[Scans, np.ndarray]):
    """Scan to measures."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, config: MeasureConfig | None = None) -> None:
        super().__init__()
        self.config = config or MeasureConfig()
        width = self.config.width
        self.region = nn.Sequential(*mlp(POINT, width // 2, width))
        self.place = nn.Linear(POINT + 6 * FREQUENCIES, width)
        self.merge = nn.Sequential(nn.GELU(), nn.Linear(width, width))
        self.query = nn.Parameter(torch.randn(width))
        layer = nn.TransformerEncoderLayer(width, self.config.heads, 4 * width, **LAYER_OPTIONS)  # type: ignore[arg-type]
        self.layers = nn.TransformerEncoder(layer, self.config.layers, nn.LayerNorm(width), enable_nested_tensor=False)
        self.head = nn.Sequential(*mlp(3 * width, width, len(MEASURES)))
        self.register_buffer("mean", torch.zeros(len(MEASURES)))
        self.register_buffer("deviation", torch.zeros(len(MEASURES)))

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> _Drawn:
        """The scans. The first set prepared, the training set, gives the mean and the deviation of the measures."""
        whole = Scans(scans_of(garments).to(device), torch.from_numpy(garments.measures).float().to(device))
        if not self.deviation.any():
            self.mean.copy_(whole.measures.mean(dim=0))
            self.deviation.copy_(whole.measures.std(dim=0, correction=0).clamp(min=LEAST_DEVIATION))
        return _Drawn(whole, self.config.points, bool(self.config.augmented))

    def loss(self, batch: Scans) -> dict[str, Tensor]:
        said = self._standard(batch.points[:, : self.config.points]).float()
        return {"measures": (said - (batch.measures - self.mean) / self.deviation).abs().mean()}

    def predict(self, batch: Scans) -> list[np.ndarray]:
        """The mean of the answers to parts of each scan, in ``DIVISIONS`` random divisions."""
        size, count = self.config.points, batch.points.shape[1]
        orders = [torch.randperm(count, generator=torch.Generator().manual_seed(seed)) for seed in range(DIVISIONS)]
        parts = [part for order in orders for part in torch.split(order, size) if len(part) == min(size, count)]
        if not self.config.augmented:
            parts = [torch.arange(min(size, count))]  # it knows no others
        with torch.no_grad():
            said = torch.stack([self._standard(batch.points[:, part]).float() for part in parts]).mean(dim=0)
        return list((said * self.deviation + self.mean).double().cpu().numpy())

    def compile_parts(self) -> None:
        self.layers.compile()

    def _standard(self, points: Float[Tensor, "b n 7"]) -> Float[Tensor, "b m"]:
        """Measures in deviations from the mean."""
        centres = points[:, : self.config.tokens]
        with torch.no_grad():
            distances = squared_distances(centres[..., :3], points[..., :3])
            nearest = distances.topk(min(self.config.neighbours, points.shape[1]), largest=False).indices
        region = points[torch.arange(len(points), device=points.device)[:, None, None], nearest]
        offsets = (region[..., :3] - centres[:, :, None, :3]) * REGION_SCALE
        features = self.region(torch.cat([offsets, region[..., 3:]], dim=-1)).amax(dim=2)
        tokens = self.merge(features + self.place(torch.cat([centres, waves(centres[..., :3])], dim=-1)))
        query = self.query.expand(len(tokens), 1, -1).to(tokens)
        tokens = self.layers(torch.cat([query, tokens], dim=1))
        pooled = torch.cat([tokens[:, 0], tokens[:, 1:].mean(dim=1), tokens[:, 1:].amax(dim=1)], dim=-1)
        said: Tensor = self.head(pooled)
        return said


def build(config: Mapping[str, Any]) -> MeasureNet:
    """The learner; ``config``: fields of ``MeasureConfig``. Raises ``ConfigError`` for others."""
    sizes, _ = sizes_from("measures", MeasureConfig, config, least={"augmented": 0}, heads={"width": "heads"})
    return MeasureNet(sizes)


def scans_of(garments: GarmentSet) -> Float[Tensor, "g n 7"]:
    """The scans of a set, their points in an order that is random and the same for all.

    Positions relative to ``CENTRE`` [m], normals, 1 on cloth. Raises ``ConfigError`` where no camera sees the garment.
    """
    found = np.stack([garments.ragged["person"][k] for k in range(len(garments))])
    for key, points in zip(garments.keys, found, strict=True):
        if not np.isfinite(points).all():
            raise ConfigError(f"garment {key}: no camera sees it: leave it out of the set")
    found[..., :3] = (found[..., :3] - CENTRE) / METRE
    return torch.from_numpy(found[:, np.random.default_rng(0).permutation(found.shape[1])])


@cache
def _angles(device: torch.device) -> Tensor:
    return torch.tensor([name in ANGLES for name in MEASURES], device=device)
