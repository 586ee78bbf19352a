"""A network on the vertices of meshes: edge convolutions, and attention among geodesic clusters.

Edge convolutions (Wang et al., Dynamic Graph CNN, ACM TOG 2019) on the edges of the mesh see some centimetres; means of
clusters are tokens that attend to each other, and so to the whole garment. Both alternate.
"""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.surfaces import SHAPE, SurfaceBatch
from gcd_dataset.errors import ConfigError

FREQUENCIES = 8  # octaves of the positional encoding
EDGE_SCALE = 20.0  # scales offsets along edges to about 1: 5 cm
EDGE_FEATURES = 7
LAYER_OPTIONS = {"activation": "gelu", "batch_first": True, "norm_first": True, "dropout": 0.0}


@dataclass(frozen=True, slots=True)
class SurfaceNetConfig:
    """Sizes of a network."""

    width: int = 192
    """Features of a vertex."""
    rounds: int = 3
    """Alternations of edge convolutions and attention."""
    convolutions: int = 2
    """Edge convolutions of a round, and after the last."""
    tokens: int = 256
    """Clusters of a garment."""
    token_width: int = 256
    heads: int = 8
    layers: int = 2
    """Attention layers of a round."""

    def __post_init__(self) -> None:
        if self.token_width % self.heads:
            raise ConfigError(f"token_width {self.token_width} is no multiple of heads {self.heads}: change one")


class SurfaceNet(nn.Module):
    """Vertices with features to features of vertices and of clusters."""

    def __init__(self, config: SurfaceNetConfig, features: int) -> None:
        """``features``: numbers given for each vertex, besides position and normal."""
        super().__init__()
        self.config = config
        self.stem = nn.Linear(6 + 6 * FREQUENCIES + SHAPE + features, config.width)
        self.rounds = nn.ModuleList(_Round(config) for _ in range(config.rounds))
        self.last = _convolutions(config)
        self.norm = nn.LayerNorm(config.width)

    def forward(
        self, batch: SurfaceBatch, given: Float[Tensor, "v f"], context: Float[Tensor, "b c w"] | None = None
    ) -> tuple[Float[Tensor, "v w"], Float[Tensor, "b t u"], Bool[Tensor, "b t"]]:
        """Features of the vertices; the tokens, and which of them exist. ``context``: further tokens to attend to."""
        place = torch.cat([batch.positions, batch.normals], dim=-1)
        features = self.stem(torch.cat([place, waves(batch.positions), batch.shape, given], dim=-1))
        along = edge_features(batch)
        room = batch.size * batch.tokens
        members = torch.bincount(batch.clusters, minlength=room).clamp(min=1)
        centres = pooled(batch.positions, batch, members)
        exists = (torch.bincount(batch.clusters, minlength=room) > 0).view(batch.size, batch.tokens)
        tokens: Tensor | None = None
        for one in self.rounds:
            features, tokens = one(features, tokens, batch, along, members, centres, exists, context)
        assert tokens is not None  # at least one round
        for convolution in self.last:
            features = convolution(features, batch, along)
        return self.norm(features), tokens, exists

    def compile_convolutions(self) -> None:
        """Compile the edge convolutions, for any number of vertices."""
        for part in self.modules():
            if isinstance(part, EdgeConvolution):
                part.compile(dynamic=True)


class _Round(nn.Module):
    def __init__(self, config: SurfaceNetConfig) -> None:
        super().__init__()
        width = config.token_width
        self.convolutions = _convolutions(config)
        self.pool = nn.Sequential(nn.LayerNorm(config.width), nn.Linear(config.width, width))
        self.place = nn.Linear(3 + 6 * FREQUENCIES, width)
        self.layers = nn.ModuleList(
            nn.TransformerEncoderLayer(width, config.heads, 4 * width, **LAYER_OPTIONS)  # type: ignore[arg-type]
            for _ in range(config.layers)
        )
        self.spread = nn.Linear(width + 3, config.width)

    def forward(
        self,
        features: Float[Tensor, "v w"],
        tokens: Float[Tensor, "b t u"] | None,
        batch: SurfaceBatch,
        along: Float[Tensor, "v k e"],
        members: Tensor,
        centres: Float[Tensor, "c 3"],
        exists: Bool[Tensor, "b t"],
        context: Float[Tensor, "b c u"] | None,
    ) -> tuple[Float[Tensor, "v w"], Float[Tensor, "b t u"]]:
        for convolution in self.convolutions:
            features = convolution(features, batch, along)
        means = pooled(self.pool(features), batch, members)
        found = (means + self.place(torch.cat([centres, waves(centres)], dim=-1))).view(*exists.shape, -1)
        tokens = found if tokens is None else tokens + found
        hidden, extra = ~exists, 0
        if context is not None:
            extra = context.shape[1]
            tokens = torch.cat([context.to(tokens), tokens], dim=1)
            hidden = functional.pad(hidden, (extra, 0), value=False)
        for layer in self.layers:
            tokens = layer(tokens, src_key_padding_mask=hidden)
        tokens = tokens[:, extra:]
        own = gathered(tokens.reshape(-1, tokens.shape[-1]), batch.clusters)
        offset = (batch.positions - centres[batch.clusters]) * EDGE_SCALE
        return features + self.spread(torch.cat([own, offset.to(own)], dim=-1)), tokens


class EdgeConvolution(nn.Module):
    """A residual layer: the largest and the mean message along the edges of a vertex, and a small network."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.own, self.other = nn.Linear(width, width), nn.Linear(width, width, bias=False)
        self.along = nn.Linear(EDGE_FEATURES, width, bias=False)
        self.merge = nn.Linear(2 * width, width)
        self.inner = nn.Sequential(nn.LayerNorm(width), *mlp(width, 2 * width, width))

    def forward(
        self, features: Float[Tensor, "v w"], batch: SurfaceBatch, along: Float[Tensor, "v k e"]
    ) -> Float[Tensor, "v w"]:
        seen = self.norm(features)
        messages = self.own(seen)[:, None] + of_neighbours(self.other(seen), batch) + self.along(along.to(seen))
        messages = functional.gelu(messages)
        largest = messages.max(dim=1).values  # ``amax`` would share the gradient among equals, in several passes
        features = features + self.merge(torch.cat([largest, messages.mean(dim=1)], dim=-1))
        moved: Tensor = features + self.inner(features)
        return moved


def edge_features(batch: SurfaceBatch) -> Float[Tensor, "v k 7"]:
    """Offset and distance of each neighbour, its distance in the cloth, the turn of the normal, the height."""
    offsets = (batch.positions[batch.neighbours] - batch.positions[:, None]) * EDGE_SCALE
    turn = (batch.normals[batch.neighbours] * batch.normals[:, None]).sum(dim=-1, keepdim=True)
    out = (offsets * batch.normals[:, None]).sum(dim=-1, keepdim=True)
    rest = batch.lengths[..., None] * EDGE_SCALE
    return torch.cat([offsets, offsets.norm(dim=-1, keepdim=True), rest, 1 - turn, out], dim=-1)


def pooled(values: Float[Tensor, "v *d"], batch: SurfaceBatch, members: Tensor) -> Float[Tensor, "c *d"]:
    """Means of the clusters, in float32."""
    total = values.new_zeros((batch.size * batch.tokens, values.shape[-1]), dtype=torch.float32)
    return total.index_add(0, batch.clusters, values.float()) / members[:, None]


def of_neighbours(values: Float[Tensor, "v w"], batch: SurfaceBatch) -> Float[Tensor, "v k w"]:
    """Rows of the neighbours; the gradient gathers, too, instead of adding up row by row."""
    found: Tensor = _OfNeighbours.apply(values, batch.neighbours, batch.reverse)  # type: ignore[no-untyped-call]
    return found


class _OfNeighbours(torch.autograd.Function):
    """``values[neighbours]``; the gradient of a vertex is the sum over its reverse edges."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, neighbours: Tensor, reverse: Tensor) -> Tensor:
        ctx.save_for_backward(reverse)
        return gathered(values, neighbours)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (reverse,) = ctx.saved_tensors
        return gathered(gradient.flatten(0, 1), reverse).sum(dim=1), None, None


def gathered(values: Float[Tensor, "n w"], rows: Int[Tensor, "*v"]) -> Float[Tensor, "*v w"]:
    """``values[rows]`` by ``index_select``: its gradient needs no sorting."""
    return values.index_select(0, rows.flatten()).view(*rows.shape, values.shape[-1])


def waves(positions: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n f"]:
    """Sines and cosines of positions [m] at doubling frequencies, from half a wave in a metre on."""
    scales = torch.pi * 2.0 ** torch.arange(FREQUENCIES, device=positions.device)
    angles = (positions[..., None] * scales).flatten(-2)
    return torch.cat([angles.sin(), angles.cos()], dim=-1)


def mlp(given: int, inner: int, out: int) -> tuple[nn.Module, ...]:
    """Two linear layers."""
    return nn.Linear(given, inner), nn.GELU(), nn.Linear(inner, out)


def _convolutions(config: SurfaceNetConfig) -> nn.ModuleList:
    return nn.ModuleList(EdgeConvolution(config.width) for _ in range(config.convolutions))
