"""From tokens of an input to panels, their edges, and their seams: the network of ``models/panel_set``.

Learned queries attend to the tokens, and each query may become a panel (DETR, Carion et al., ECCV 2020) with corners in
the order of its loop. The edges of all panels then attend to each other and to the tokens, and move; each chooses the
edge that it is sewn to, or none.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.panel_targets import BENDS
from benchmarks.reconstruction.point_net import FREQUENCIES, DecoderLayer, EncoderLayer, PointConfig, hiding, waves
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS

STEP_SCALE = 0.1  # UNIT: size of the moves of corners and bends, 5 cm
FIRST_EXTENT = 0.3  # UNIT, of panels before training
NEVER = -1e4  # score of an edge as its own partner


@dataclass(frozen=True, slots=True)
class NetConfig(PointConfig):
    """Sizes of a ``PanelSet``."""

    edge_width: int = 256
    """Features of an edge."""
    edge_heads: int = 8
    edge_layers: int = 3
    """Layers that move edges."""
    seam_layers: int = 3
    """Layers among the moved edges."""


@dataclass(frozen=True)
class Predicted:
    """Predicted panels, one per query; lengths in ``UNIT``. The fields may have a leading dimension of layers."""

    exists: Float[Tensor, "b q"]
    """Logits."""
    corners: Float[Tensor, "b q n 2"]
    bends: Float[Tensor, "b q n k 2"]
    extents: Float[Tensor, "b q 2"]
    centres: Float[Tensor, "b q 3"]
    axes: Float[Tensor, "b q 6"]
    """First two columns of the rotations; not orthonormal."""
    edges: Float[Tensor, "b q m"]
    """Logits of the number of edges."""
    labels: Float[Tensor, "b q l"]
    """Logits of ``PANEL_LABELS``."""

    @property
    def rotations(self) -> Float[Tensor, "b q 3 3"]:
        """Rotations of the panels."""
        return rotation_of(self.axes)

    def __getitem__(self, index: Any) -> "Predicted":
        """The same index of each field, such as a layer."""
        return Predicted(*(column[index] for column in self._columns()))

    def detach(self) -> "Predicted":
        """The same numbers, without gradients."""
        return Predicted(*(column.detach() for column in self._columns()))

    def of_queries(self, queries: Int[Tensor, "b p"]) -> "Predicted":
        """The predictions of these queries, in their order; the fields have a dimension of layers."""
        found = []
        for column in self._columns():
            rows = column.flatten(3) if column.ndim > 3 else column[..., None]
            at = queries[None, :, :, None].expand(len(rows), -1, -1, rows.shape[-1])
            found.append(rows.gather(2, at).view(*column.shape[:2], queries.shape[1], *column.shape[3:]))
        return Predicted(*found)

    def _columns(self) -> list[Tensor]:
        return [getattr(self, field.name) for field in fields(self)]


@dataclass(frozen=True)
class Edges:
    """The edges of the queries, padded to one number for each garment."""

    queries: Int[Tensor, "b e"]
    """The query of each edge; 0 where there is no edge."""
    slots: Int[Tensor, "b e"]
    """Number of the edge in the query's loop."""
    following: Int[Tensor, "b e"]
    """Number of the next edge in the loop."""
    exists: Bool[Tensor, "b e"]

    def of(self, values: Float[Tensor, "b q n *d"], slots: Int[Tensor, "b e"]) -> Float[Tensor, "b e *d"]:
        """Values of the queries' slots for each edge."""
        garments = torch.arange(len(slots), device=slots.device)[:, None]
        return values[garments, self.queries, slots]

    def of_panels(self, values: Float[Tensor, "b q w"]) -> Float[Tensor, "b e w"]:
        """Values of the queries for each edge; as a product, since its gradient is faster than that of an index."""
        chosen = functional.one_hot(self.queries, values.shape[1]).to(values.dtype)
        return chosen @ values

    @property
    def hidden(self) -> Bool[Tensor, "b e"]:
        """Edges that others do not attend to; never all of a garment."""
        hidden = ~self.exists
        hidden[:, 0] = False
        return hidden


@dataclass(frozen=True)
class Sewn:
    """Predictions for edges."""

    partners: Float[Tensor, "b e f"]
    """Logits of the partner of each edge; the last column stands for none."""
    turned: Float[Tensor, "b e e"]
    """Logits of ``Seam.right_wrong`` for each pair."""
    kinds: Float[Tensor, "b e"]
    """Logits of a curve."""
    labels: Float[Tensor, "b e l"]
    """Logits of ``EDGE_LABELS``."""


# ---------------------------------------------------------------------------------------------------------- the network


class PanelDecoder(nn.Module):
    """Tokens of an encoder to panels, their edges, and their seams."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.queries = nn.Parameter(torch.randn(config.queries, width))
        self.layers = nn.ModuleList(DecoderLayer(width, config.heads, 4 * width) for _ in range(config.layers))
        sizes = (1, 2 * config.slots * (1 + BENDS), 2, 3, 6, config.slots + 1, len(PANEL_LABELS))
        self.norm = nn.LayerNorm(width)
        self.heads = nn.ModuleList(
            nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, size)) for size in sizes
        )
        self.mover = EdgeMover(config)
        self.seams = SeamHead(config)

    def forward(self, tokens: Float[Tensor, "b t w"]) -> tuple[Predicted, Float[Tensor, "b q w"]]:
        """Predictions after each layer, and the queries' features after the last."""
        panels = self.queries.expand(len(tokens), -1, -1)
        after = []
        for layer in self.layers:
            panels = layer(panels, tokens)
            after.append(panels)
        return self._predicted(torch.stack(after)), panels

    def _predicted(self, panels: Float[Tensor, "l b q w"]) -> Predicted:
        # In float32: bfloat16 would round a metre to half a centimetre.
        with torch.autocast(panels.device.type, enabled=False):
            panels = self.norm(panels.float())
            exists, loops, extents, centres, axes, edges, labels = (head(panels) for head in self.heads)
        extents = FIRST_EXTENT * extents.clamp(-5.0, 5.0).exp()
        loops = loops.unflatten(-1, (self.config.slots, 1 + BENDS, 2)) * extents[..., None, None, :]
        return Predicted(
            exists=exists[..., 0],
            corners=loops[..., 0, :],
            bends=loops[..., 1:, :],
            extents=extents,
            centres=centres,
            axes=axes,
            edges=edges,
            labels=labels,
        )


class EdgeMover(nn.Module):
    """Moves the edges of a garment towards what the tokens show."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        width = config.edge_width
        self.describe = _EdgeFeatures(config, before=config.width)
        self.slot = nn.Embedding(config.slots, width)
        self.tokens = nn.Linear(config.width, width)
        self.layers = nn.ModuleList(
            DecoderLayer(width, config.edge_heads, 4 * width) for _ in range(config.edge_layers)
        )
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, 2 * (1 + BENDS))
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(
        self, edges: Edges, panels: Float[Tensor, "b q w"], said: Predicted, tokens: Float[Tensor, "b t w"]
    ) -> tuple[Predicted, Float[Tensor, "b e v"]]:
        """The predictions ``said`` with moved corners and bends, and the features of the edges."""
        features = self.describe(edges, edges.of_panels(panels), said) + self.slot(edges.slots)
        tokens, hidden = self.tokens(tokens), hiding(edges.hidden)
        for layer in self.layers:
            features = layer(features, tokens, tgt_key_padding_mask=hidden)
        with torch.autocast(features.device.type, enabled=False):
            features = features.float()
            moves = STEP_SCALE * self.head(self.norm(features)) * edges.exists[..., None]
            at = edges.queries * said.corners.shape[2] + edges.slots
            still = moves.new_zeros(len(moves), said.corners.shape[1] * said.corners.shape[2], moves.shape[-1])
            moved = still.scatter_add(1, at[..., None].expand_as(moves), moves)
            moved = moved.view(*said.corners.shape[:3], 1 + BENDS, 2)
            corners, bends = said.corners + moved[..., 0, :], said.bends + moved[..., 1:, :]
        return replace(said, corners=corners, bends=bends), features


class SeamHead(nn.Module):
    """The partner of each edge of a garment, and the kind and label of the edges."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        width = config.edge_width
        self.describe = _EdgeFeatures(config, before=width)
        layer = EncoderLayer(width, config.edge_heads, 4 * width)
        self.layers = nn.TransformerEncoder(layer, config.seam_layers, nn.LayerNorm(width), enable_nested_tensor=False)
        self.queries, self.keys = nn.Linear(width, width), nn.Linear(width, width)
        self.turned = nn.Linear(width, width)
        self.no_partner, self.kind = nn.Linear(width, 1), nn.Linear(width, 1)
        self.label = nn.Linear(width, len(EDGE_LABELS))

    def forward(self, edges: Edges, features: Float[Tensor, "b e v"], said: Predicted) -> Sewn:
        """``features``: of the moved edges."""
        related = self.layers(self.describe(edges, features, said), src_key_padding_mask=edges.hidden)
        with torch.autocast(features.device.type, enabled=False):
            related = related.float()
            return Sewn(
                partners=torch.cat([self._partners(related, edges.exists), self.no_partner(related)], dim=-1),
                turned=_symmetric(self.turned(related), related),
                kinds=self.kind(related)[..., 0],
                labels=self.label(related),
            )

    def _partners(self, related: Float[Tensor, "b e v"], exists: Bool[Tensor, "b e"]) -> Float[Tensor, "b e e"]:
        scores = _symmetric(self.queries(related), self.keys(related))
        own = torch.eye(scores.shape[1], dtype=torch.bool, device=scores.device)
        return scores.masked_fill(own | ~exists[:, None, :], NEVER)


class _EdgeFeatures(nn.Module):
    """Features of edges: places in the panel and in space, length, number in the loop, and features from before."""

    def __init__(self, config: NetConfig, *, before: int) -> None:
        super().__init__()
        numbers = 3 * 2 + 3 * 3 + 1 + 2
        known = numbers * (2 * FREQUENCIES + 1) + before
        width = config.edge_width
        self.mlp = nn.Sequential(nn.Linear(known, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, edges: Edges, before: Float[Tensor, "b e d"], said: Predicted) -> Float[Tensor, "b e v"]:
        # In float32: bfloat16 would round places before the waves of high frequency are taken.
        with torch.autocast(before.device.type, enabled=False):
            known = edge_numbers(edges, said)
            known = torch.cat([waves(known), known], dim=-1)
        found: Tensor = self.mlp(torch.cat([known, before], dim=-1))
        return found


def edge_numbers(edges: Edges, said: Predicted) -> Float[Tensor, "b e n"]:
    """Start, middle and end of edges in the panel and in space, their lengths, their numbers in the loop."""
    device = edges.slots.device
    garments = torch.arange(len(edges.slots), device=device)[:, None]
    start, end = edges.of(said.corners, edges.slots), edges.of(said.corners, edges.following)
    share = torch.arange(1, BENDS + 1, device=device)[:, None] / (BENDS + 1)
    chord = (1 - share) * start[..., None, :] + share * end[..., None, :]
    inner = chord + edges.of(said.bends, edges.slots)
    path = torch.cat([start[..., None, :], inner, end[..., None, :]], dim=-2)
    length = path.diff(dim=-2).norm(dim=-1).sum(dim=-1, keepdim=True)
    shown = path[..., :: (BENDS + 1) // 2, :]
    turns, centres = rotation_of(said.axes[garments, edges.queries]), said.centres[garments, edges.queries]
    placed = shown @ turns[..., :2].transpose(-1, -2) + centres[..., None, :]
    numbers = torch.stack([edges.slots, edges.following], dim=-1) / 10.0
    return torch.cat([shown.flatten(-2), placed.flatten(-2), length, numbers], dim=-1)


def _symmetric(one: Float[Tensor, "b e v"], other: Float[Tensor, "b e v"]) -> Float[Tensor, "b e e"]:
    scores = one @ other.transpose(1, 2) / math.sqrt(one.shape[-1])
    return 0.5 * (scores + scores.transpose(1, 2))


def axes_of(rotations: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 6"]:
    """The first two columns of rotations."""
    return rotations[..., :2].transpose(-1, -2).flatten(-2)


def rotation_of(columns: Float[Tensor, "*b 6"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation from two columns by orthonormalisation (Zhou et al., On the Continuity of Rotations, CVPR 2019)."""
    first = functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:] - (first * columns[..., 3:]).sum(-1, keepdim=True) * first
    second = functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)
