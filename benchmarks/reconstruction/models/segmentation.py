"""From a draped mesh to the panel, seam and edge label of every vertex (task T4).

The network of ``surface_net`` gives features of vertices and tokens of geodesic clusters. Panels and seams are sets:
queries attend to the tokens, and each vertex chooses a query (MaskFormer, Cheng et al., NeurIPS 2021). The loss assigns
queries to the true panels of a garment at least cost. The order of vertices and faces changes no answer.
"""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.labelled_surfaces import LabelBatch, LabelledSurfaces
from benchmarks.reconstruction.learners import Learner, least_cost, sizes_from
from benchmarks.reconstruction.surface_net import LAYER_OPTIONS, SurfaceNet, SurfaceNetConfig, mlp
from benchmarks.reconstruction.surfaces import (
    SurfaceBatch,
)
from gcd_dataset.metrics import VertexLabels
from gcd_dataset.metrics.answers import PANEL_CLASSES
from gcd_dataset.tensors import EDGE_LABELS

TASKS = ("T4",)
LEAST_VERTICES = 5  # of a panel; at 4 cm the smallest of 2,000 panels has 9
WEIGHTS = {
    "panels": 1.0, "panel_dice": 1.0, "on_seam": 1.0, "seams": 0.5, "seam_dice": 0.5, "classes": 0.5, "edges": 0.5,
}  # fmt: skip
USUAL: Mapping[str, Any] = {"batch": 16, "lr": 6e-4, "ema": 0.998}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 150, "batch": 4, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "width": 48, "rounds": 1, "tokens": 48, "token_width": 64, "heads": 4, "layers": 1, "panels": 24, "seams": 48,
    "decoder_layers": 1,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


class Segmentation(Learner[LabelBatch, VertexLabels]):
    """Mesh to labels of its vertices."""

    def __init__(
        self,
        config: SurfaceNetConfig | None = None,
        *,
        panels: int = 40,
        seams: int = 128,
        decoder_layers: int = 3,
    ) -> None:
        """``panels``, ``seams``: most of a garment; ``decoder_layers``: of each set."""
        super().__init__()
        self.config = config or SurfaceNetConfig()
        self.net = SurfaceNet(self.config, features=0)
        self.panels = SetHead(self.config, panels, decoder_layers)
        self.seams = SetHead(self.config, seams, decoder_layers)
        self.on_seam = nn.Linear(self.config.width, 1)
        self.classes = nn.Linear(self.config.width, len(PANEL_CLASSES))
        self.edges = nn.Linear(self.config.width, len(EDGE_LABELS))

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> "LabelledSurfaces":
        """The meshes with clusters, and their labels."""
        return LabelledSurfaces(garments, tokens=self.config.tokens, device=device, workers=workers)

    def compile_parts(self) -> None:
        self.net.compile_convolutions()

    def loss(self, batch: LabelBatch) -> dict[str, Tensor]:
        features, panels, seams = self._logits(batch.surface)
        exists = batch.surface.exists
        with torch.autocast(exists.device.type, enabled=False):
            features = batch.surface.padded(features.float())
            on_seam = self.on_seam(features)[..., 0]
            panel, panel_dice = set_loss(panels.float(), batch.panels, exists.float())
            seam, seam_dice = set_loss(seams.float(), batch.seams, exists * on_seam.sigmoid())
            sides = torch.stack([batch.seams.any(dim=-1), ~batch.seams.any(dim=-1)], dim=-1)
            terms = {
                "panels": panel,
                "panel_dice": panel_dice,
                "on_seam": any_of_loss(functional.pad(on_seam[..., None], (0, 1)), sides & exists[..., None]),
                "seams": seam,
                "seam_dice": seam_dice,
                "classes": any_of_loss(self.classes(features), batch.classes),
                "edges": any_of_loss(self.edges(features), batch.edges),
            }
        return {name: WEIGHTS[name] * term for name, term in terms.items()}

    def predict(self, batch: LabelBatch) -> list[VertexLabels]:
        with torch.no_grad():
            features, panels, seams = self._logits(batch.surface)
            features = batch.surface.padded(features)
            columns = [
                _without_crumbs(panels, batch.surface.exists),
                self.classes(features).argmax(dim=-1),
                torch.where(self.on_seam(features)[..., 0] > 0, seams.argmax(dim=-1), -1),
                self.edges(features).argmax(dim=-1),
            ]
        counts = batch.surface.counts.tolist()
        found = [column.cpu().numpy() for column in columns]
        return [VertexLabels(*(column[k, :count] for column in found)) for k, count in enumerate(counts)]

    def _logits(self, surface: SurfaceBatch) -> tuple[Tensor, Tensor, Tensor]:
        """Features of the vertices, and for each vertex the logits of the queries of panels and of seams."""
        features, tokens, exists = self.net(surface, surface.positions.new_zeros(len(surface.positions), 0))
        padded = surface.padded(features)
        return features, self.panels(padded, tokens, exists), self.seams(padded, tokens, exists)


def build(config: Mapping[str, Any]) -> Segmentation:
    """The learner; ``config``: fields of ``SurfaceNetConfig``, and the arguments of ``Segmentation``.

    Raises ``ConfigError`` for others.
    """
    own = ("panels", "seams", "decoder_layers")
    least = {"convolutions": 0, "layers": 0, "decoder_layers": 0}
    sizes, arguments = sizes_from("segmentation", SurfaceNetConfig, config, own=own, least=least)
    return Segmentation(sizes, **arguments)


# ---------------------------------------------------------------------------------------------------------- the network


class SetHead(nn.Module):
    """Queries that attend to tokens, and for each vertex the query that it belongs to."""

    def __init__(self, config: SurfaceNetConfig, count: int, layers: int) -> None:
        super().__init__()
        width = config.token_width
        self.queries = nn.Parameter(torch.randn(count, width))
        self.layers = nn.ModuleList(
            nn.TransformerDecoderLayer(width, config.heads, 4 * width, **LAYER_OPTIONS)  # type: ignore[arg-type]
            for _ in range(layers)
        )
        self.query = nn.Sequential(nn.LayerNorm(width), *mlp(width, width, config.width))
        self.vertex = nn.Sequential(*mlp(config.width, config.width, config.width))

    def forward(
        self, features: Float[Tensor, "b n w"], tokens: Float[Tensor, "b t u"], exists: Bool[Tensor, "b t"]
    ) -> Float[Tensor, "b n q"]:
        queries = self.queries.expand(len(tokens), -1, -1)
        for layer in self.layers:
            queries = layer(queries, tokens, memory_key_padding_mask=~exists)
        logits: Tensor = self.vertex(features) @ self.query(queries).transpose(1, 2)
        return logits / features.shape[-1] ** 0.5


# ------------------------------------------------------------------------------------------------------------- the loss


def set_loss(
    logits: Float[Tensor, "b n q"], true: Bool[Tensor, "b n p"], inside: Float[Tensor, "b n"]
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Cross-entropy of the vertices, and dice loss of the sets, under the assignment of queries at least cost.

    ``logits``: of the queries, for vertices of any set. ``inside``: probability that a vertex is of any set. A vertex
    of several sets may choose any of them.
    """
    log = logits.log_softmax(dim=-1)
    probability = log.exp() * inside[..., None]
    members = true.to(log)
    share = members / members.sum(dim=-1, keepdim=True).clamp(min=1)
    entropy = -share.transpose(1, 2) @ log / share.sum(dim=1).clamp(min=1e-6)[..., None]
    overlap = members.transpose(1, 2) @ probability
    sizes = members.sum(dim=1)
    dice = 1 - 2 * overlap / (sizes[..., None] + probability.sum(dim=1)[:, None] + 1)
    queries = least_cost(entropy + 2 * dice, sizes > 0)
    assigned = functional.one_hot(queries, log.shape[-1]) * (sizes > 0)[..., None].to(log)
    return any_of_loss(log, (members @ assigned) > 0), (dice * assigned).sum() / assigned.sum().clamp(min=1)


def any_of_loss(logits: Float[Tensor, "b n q"], allowed: Bool[Tensor, "b n q"]) -> Float[Tensor, ""]:
    """Negative logarithm of the probability of any allowed column: the mean over the vertices that have one.

    The mean over garments of the means over their vertices.
    """
    known = allowed.any(dim=-1)
    log = logits.log_softmax(dim=-1).masked_fill(~allowed, -torch.inf)
    lost = -log[known].logsumexp(dim=-1)
    weight = (1 / known.sum(dim=1).clamp(min=1))[:, None].expand_as(known)[known]
    return (lost * weight).sum() / len(known)


def _without_crumbs(logits: Float[Tensor, "b n q"], exists: Bool[Tensor, "b n"]) -> Int[Tensor, "b n"]:
    """The likeliest query of each vertex, among those that at least ``LEAST_VERTICES`` vertices choose."""
    chosen = functional.one_hot(logits.argmax(dim=-1), logits.shape[-1]) * exists[..., None]
    few = chosen.sum(dim=1) < LEAST_VERTICES
    return logits.masked_fill(few[:, None], -torch.inf).argmax(dim=-1)
