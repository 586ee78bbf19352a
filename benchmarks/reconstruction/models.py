"""A network from surface points of a garment to the set of its panels.

Points are grouped into regions, and each region becomes a token (Point-MAE, Pang et al., ECCV 2022); learned queries
attend to the tokens, and each query may become a panel (DETR, Carion et al., ECCV 2020). Panels are a set: the loss
matches queries to panels at least cost, and a contour may start anywhere.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.data import MAX_EDGES, GarmentBatch

__all__ = ["NetConfig", "PanelDecoder", "PatternNet", "Predicted", "encoder", "match_panels", "set_loss"]

FREQUENCIES = 8  # octaves of the positional encoding
REGION_SCALE = 10.0  # scales offsets within a region to about 1
LAYER_OPTIONS: dict[str, Any] = {"activation": "gelu", "batch_first": True, "norm_first": True, "dropout": 0.0}
WEIGHTS = {"exists": 2.0, "contours": 5.0, "corners": 1.0, "centres": 5.0, "rotations": 1.0, "edges": 0.5}


@dataclass(frozen=True, slots=True)
class NetConfig:
    """Sizes of a ``PatternNet``."""

    queries: int = 40
    contour_points: int = 64
    tokens: int = 256
    neighbours: int = 32
    width: int = 384
    heads: int = 6
    layers: int = 6
    """Layers of the encoder, and of the decoder."""


@dataclass(frozen=True)
class Predicted:
    """The output of the queries; lengths in ``data.UNIT``."""

    exists: Float[Tensor, "b q"]
    """Logits."""
    contours: Float[Tensor, "b q c 2"]
    corners: Float[Tensor, "b q c"]
    """Logits."""
    centres: Float[Tensor, "b q 3"]
    rotations: Float[Tensor, "b q 3 3"]
    edges: Float[Tensor, "b q e"]
    """Logits of the number of edges."""

    def garments(self) -> GarmentBatch:
        """The predictions in the form of the targets, with the panels whose probability exceeds 1/2."""
        return GarmentBatch(
            points=self.centres.new_zeros(len(self.exists), 0, 6),
            exists=self.exists > 0,
            contours=self.contours,
            corners=self.corners,
            centres=self.centres,
            rotations=self.rotations,
            edge_counts=self.edges.argmax(dim=-1),
        )


class PatternNet(nn.Module):
    """Points and normals to one ``Predicted`` per decoder layer; the last is the result."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.region = nn.Sequential(nn.Linear(6, width // 2), nn.GELU(), nn.Linear(width // 2, width))
        self.position = nn.Linear(6 * FREQUENCIES + 6, width)
        self.merge = nn.Sequential(nn.GELU(), nn.Linear(width, width))
        self.encoder = encoder(config)
        self.decoder = PanelDecoder(config)

    def forward(self, points: Float[Tensor, "b n 6"]) -> list[Predicted]:
        return self.decoder(self.encoder(self._tokens(points.float())))

    def _tokens(self, points: Float[Tensor, "b n 6"]) -> Float[Tensor, "b t w"]:
        """Tokens of the regions around the first points of each garment; points are in random order."""
        centres = points[:, : self.config.tokens]
        with torch.no_grad():
            distances = torch.cdist(centres[..., :3], points[..., :3])
            nearest = distances.topk(min(self.config.neighbours, points.shape[1]), largest=False).indices
        region = points[torch.arange(len(points), device=points.device)[:, None, None], nearest]
        offsets = (region[..., :3] - centres[:, :, None, :3]) * REGION_SCALE
        features = self.region(torch.cat([offsets, region[..., 3:]], dim=-1)).amax(dim=2)
        octaves = centres[..., :3, None] * 2.0 ** torch.arange(FREQUENCIES, device=points.device)
        waves = torch.cat([octaves.sin(), octaves.cos()], dim=-1).flatten(2)
        return self.merge(features + self.position(torch.cat([waves, centres], dim=-1)))


class PanelDecoder(nn.Module):
    """Tokens of an encoder to one ``Predicted`` per layer; each query may become a panel."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.queries = nn.Parameter(torch.randn(config.queries, width))
        self.layers = nn.ModuleList(
            nn.TransformerDecoderLayer(width, config.heads, 4 * width, **LAYER_OPTIONS) for _ in range(config.layers)
        )
        sizes = (1, 3 * config.contour_points, 3, 6, MAX_EDGES + 1)
        self.norm = nn.LayerNorm(width)
        self.heads = nn.ModuleList(
            nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, size)) for size in sizes
        )

    def forward(self, tokens: Float[Tensor, "b t w"]) -> list[Predicted]:
        panels = self.queries.expand(len(tokens), -1, -1)
        predicted = []
        for layer in self.layers:
            panels = layer(panels, tokens)
            predicted.append(self._predicted(panels))
        return predicted

    def _predicted(self, panels: Float[Tensor, "b q w"]) -> Predicted:
        # In float32: bfloat16 would round a metre to half a centimetre.
        with torch.autocast(panels.device.type, enabled=False):
            exists, outline, centres, rotations, edges = (head(self.norm(panels.float())) for head in self.heads)
        outline = outline.unflatten(-1, (self.config.contour_points, 3))
        return Predicted(
            exists=exists[..., 0],
            contours=outline[..., :2],
            corners=outline[..., 2],
            centres=centres,
            rotations=rotation_of(rotations),
            edges=edges,
        )


def encoder(config: NetConfig) -> nn.TransformerEncoder:
    """Attention among the tokens of an input."""
    layer = nn.TransformerEncoderLayer(config.width, config.heads, 4 * config.width, **LAYER_OPTIONS)
    return nn.TransformerEncoder(layer, config.layers, nn.LayerNorm(config.width), enable_nested_tensor=False)


def rotation_of(columns: Float[Tensor, "*b 6"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation from two columns by orthonormalisation (Zhou et al., On the Continuity of Rotations, CVPR 2019)."""
    first = functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:] - (first * columns[..., 3:]).sum(-1, keepdim=True) * first
    second = functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


# ------------------------------------------------------------------------------------------------------------- the loss


def set_loss(layers: list[Predicted], true: GarmentBatch) -> dict[str, Tensor]:
    """Weighted loss terms by name; queries are matched to panels by the last layer, for all layers.

    Invariant to the order of the true panels and to the start of their contours.
    """
    pairs = match_panels(layers[-1], true)
    parts = [_loss_of_layer(layer, true, *pairs) for layer in layers]
    return {name: weight * torch.stack([part[name] for part in parts]).mean() for name, weight in WEIGHTS.items()}


def match_panels(
    predicted: Predicted, true: GarmentBatch
) -> tuple[Int[Tensor, " m"], Int[Tensor, " m"], Int[Tensor, " m"]]:
    """Matched rows of garments, queries and true panels, at least total cost (Hungarian method)."""
    with torch.no_grad():
        cost = (
            2.0 * torch.cdist(predicted.centres, true.centres)
            + 0.5 * torch.cdist(predicted.rotations.flatten(2), true.rotations.flatten(2))
            + 2.0 * _outline_distance(predicted.contours, true.contours)
            - predicted.exists.sigmoid()[..., None]
        )
    pairs = []
    for garment, (costs, exists) in enumerate(zip(cost.cpu().numpy(), true.exists.cpu().numpy(), strict=True)):
        panels = np.flatnonzero(exists)
        queries, chosen = linear_sum_assignment(costs[:, panels])
        pairs.append(np.stack([np.full(len(panels), garment), queries, panels[chosen]]))
    garments, queries, panels = torch.from_numpy(np.concatenate(pairs, axis=1)).to(cost.device)
    return garments, queries, panels


def _loss_of_layer(
    predicted: Predicted, true: GarmentBatch, garments: Tensor, queries: Tensor, panels: Tensor
) -> dict[str, Tensor]:
    exists = torch.zeros_like(predicted.exists)
    exists[garments, queries] = 1.0
    contours, outlines = predicted.contours[garments, queries], true.contours[garments, panels]
    shifted = _shifts(contours, outlines)
    corners = true.corners[garments, panels]
    return {
        "exists": functional.binary_cross_entropy_with_logits(predicted.exists, exists),
        "contours": functional.l1_loss(contours, _rolled(outlines, shifted)),
        "corners": functional.binary_cross_entropy_with_logits(
            predicted.corners[garments, queries], _rolled(corners[..., None], shifted)[..., 0]
        ),
        "centres": functional.l1_loss(predicted.centres[garments, queries], true.centres[garments, panels]),
        "rotations": functional.l1_loss(predicted.rotations[garments, queries], true.rotations[garments, panels]),
        "edges": functional.cross_entropy(predicted.edges[garments, queries], true.edge_counts[garments, panels]),
    }


def _correlation(contours: Float[Tensor, "*b c 2"], others: Float[Tensor, "*b c 2"]) -> Float[Tensor, "*b c"]:
    """Sum over the points of contour · other, for every cyclic shift of the contour."""
    ours, theirs = (torch.fft.fft(torch.view_as_complex(points.contiguous())) for points in (contours, others))
    return torch.fft.ifft(ours * theirs.conj()).real


def _outline_distance(contours: Float[Tensor, "b q c 2"], others: Float[Tensor, "b p c 2"]) -> Float[Tensor, "b q p"]:
    """Root mean square distance of contours, each pair at its best cyclic shift."""
    across = _correlation(contours[:, :, None], others[:, None]).amax(dim=-1)
    squares = contours.square().sum(dim=(-2, -1))[:, :, None] + others.square().sum(dim=(-2, -1))[:, None]
    return ((squares - 2 * across).clamp(min=0) / contours.shape[-2]).sqrt()


def _shifts(contours: Float[Tensor, "m c 2"], others: Float[Tensor, "m c 2"]) -> Int[Tensor, " m"]:
    """The cyclic shift by which each contour matches the other best."""
    with torch.no_grad():
        return _correlation(contours, others).argmax(dim=-1)


def _rolled(values: Float[Tensor, "m c d"], shifts: Int[Tensor, " m"]) -> Float[Tensor, "m c d"]:
    """Each contour rolled by its own shift."""
    count = values.shape[1]
    index = (torch.arange(count, device=values.device) - shifts[:, None]) % count
    return values.gather(1, index[..., None].expand_as(values))
