"""From surface points of a garment to the set of its panels, sewn.

Points are grouped into regions, and each region becomes a token (Point-MAE, Pang et al., ECCV 2022); learned queries
attend to the tokens, and each query may become a panel (DETR, Carion et al., ECCV 2020) with corners in the order of
its loop. Panels are a set: the loss matches queries to panels at least cost, and a loop may start at any corner. The
edges of all panels then attend to each other and to the tokens, and move; each chooses the edge that it is sewn to, or
none.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Learner, TensorExamples
from benchmarks.reconstruction.panel_targets import BENDS, PanelTargets, ToTargets, patterns_from
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Pattern
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS
from gcd_dataset.workers import parallel_map

__all__ = [
    "SMOKE",
    "USUAL",
    "NetConfig",
    "PanelDecoder",
    "PanelSet",
    "PointTokens",
    "Predicted",
    "answers_of",
    "build",
    "encoder",
    "match_panels",
    "panel_losses",
    "rotation_of",
    "set_loss",
]

FREQUENCIES = 8  # octaves of the positional encoding
REGION_SCALE = 10.0  # scales offsets within a region to about 1
STEP_SCALE = 0.1  # UNIT: size of the moves of corners and bends, 5 cm
LAYER_OPTIONS: dict[str, Any] = {"activation": "gelu", "batch_first": True, "norm_first": True, "dropout": 0.0}
WEIGHTS = {
    "exists": 2.0, "corners": 5.0, "bends": 5.0, "areas": 0.5, "extents": 0.5, "centres": 5.0, "rotations": 1.0,
    "edges": 0.5, "labels": 0.2, "partners": 1.0, "turned": 0.2, "kinds": 0.5, "edge_labels": 0.2,
}  # fmt: skip
REFINED = 2.0  # weight of the moved loops, relative to those of all layers of the decoder
LEAST_EDGES = 3
FIRST_EXTENT = 0.3  # UNIT, of panels before training
LEAST_EXTENT = 1e-3  # UNIT
TINY = 1e-12  # keeps the slope of square roots finite
NO_PANEL = 1e6  # cost of a query for a place without a true panel
NEVER = -1e4  # score of an edge as its own partner
CHUNK = 64  # garments that a process encodes at once
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 300, "batch": 8, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "queries": 12, "slots": 24, "edges": 96, "tokens": 32, "width": 64, "heads": 4, "layers": 1,
    "edge_width": 64, "edge_heads": 4, "edge_layers": 1, "seam_layers": 1, "points": 256, "stored_points": 1024,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


@dataclass(frozen=True, slots=True)
class NetConfig:
    """Sizes of a network."""

    queries: int = 40
    slots: int = 40
    """Most edges of a panel."""
    edges: int = 320
    """Most edges of a garment."""
    tokens: int = 384
    width: int = 384
    heads: int = 6
    layers: int = 6
    """Layers of the encoder, and of the decoder."""
    edge_width: int = 256
    """Features of an edge."""
    edge_heads: int = 8
    edge_layers: int = 3
    """Layers that move edges."""
    seam_layers: int = 3
    """Layers among the moved edges."""


@dataclass(frozen=True)
class Predicted:
    """What the queries say about panels; lengths in ``UNIT``."""

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


@dataclass(frozen=True)
class Matched:
    """Pairs of queries and true panels, one row for each."""

    garments: Int[Tensor, " m"]
    queries: Int[Tensor, " m"]
    panels: Int[Tensor, " m"]


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


@dataclass(frozen=True)
class Sewn:
    """What is said about edges."""

    partners: Float[Tensor, "b e f"]
    """Logits of the partner of each edge; the last column stands for none."""
    turned: Float[Tensor, "b e e"]
    """Logits of ``Seam.right_wrong`` for each pair."""
    kinds: Float[Tensor, "b e"]
    """Logits of a curve."""
    labels: Float[Tensor, "b e l"]
    """Logits of ``EDGE_LABELS``."""


# ---------------------------------------------------------------------------------------------------------- the learner


class PanelSet(Learner[PanelTargets, Pattern]):
    """Points and normals to a pattern."""

    def __init__(self, config: NetConfig | None = None, *, points: int = 4096, stored_points: int = 8192) -> None:
        """``points``: points of a garment in a step, drawn from the first ``stored_points``."""
        super().__init__()
        self.config = config or NetConfig()
        self.points, self.stored_points = points, stored_points
        self.tokens = PointTokens(self.config)
        self.decoder = PanelDecoder(self.config)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> "DrawnPoints":
        """Targets of the garments."""
        bare = replace(garments, points=garments.points[:, :0])
        parts = (bare.select(range(k, min(k + CHUNK, len(bare)))) for k in range(0, len(bare), CHUNK))
        targets = PanelTargets.join(list(parallel_map(self.encoder(), parts, workers)))
        return self.drawn_from(replace(targets, points=self.encoder().scaled(garments.points)).to(device))

    def drawn_from(self, encoded: TensorExamples) -> "DrawnPoints":
        return DrawnPoints(cast(PanelTargets, encoded), self.points)

    def encoder(self) -> ToTargets:
        config = self.config
        return ToTargets(config.queries, config.slots, config.edges, self.stored_points)

    def compile_parts(self) -> None:
        self.tokens.compile()
        for layer in self.decoder.layers:
            layer.compile()

    def loss(self, batch: PanelTargets) -> dict[str, Tensor]:
        batch = batch[batch.exists.any(dim=1)]  # without garments beyond the network's sizes
        return set_loss(self.decoder, self.tokens(batch.points), batch)

    def predict(self, batch: PanelTargets) -> list[Pattern]:
        with torch.no_grad():
            return patterns_from(answers_of(self.decoder, self.tokens(batch.points[:, : self.points])))


def build(*, smoke: bool, options: Mapping[str, Any]) -> PanelSet:
    """The learner; ``options``: fields of ``NetConfig``, ``points`` and ``stored_points``."""
    given = {**(SMALL if smoke else {}), **options}
    own = {name: given.pop(name) for name in ("points", "stored_points") if name in given}
    unknown = set(given) - set(NetConfig.__dataclass_fields__)
    if unknown:
        known = ", ".join([*NetConfig.__dataclass_fields__, "points", "stored_points"])
        raise ConfigError(f"no size {min(unknown)} of a panel_set network: choose of {known}")
    return PanelSet(NetConfig(**given), **own)


@dataclass(frozen=True)
class DrawnPoints:
    """Targets whose batches have some of the stored points, others in each step."""

    whole: PanelTargets
    points: int

    def __len__(self) -> int:
        return len(self.whole)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> PanelTargets:
        found = self.whole.batch(rows)
        return found if chance is None else found.with_points(self.points, chance)


# ---------------------------------------------------------------------------------------------------------- the network


class PointTokens(nn.Module):
    """Points and normals to tokens of regions, related to each other."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.region = nn.Sequential(nn.Linear(6, width // 2), nn.GELU(), nn.Linear(width // 2, width))
        self.position = nn.Linear(6 * FREQUENCIES + 6, width)
        self.merge = nn.Sequential(nn.GELU(), nn.Linear(width, width))
        self.encoder = encoder(config)

    def forward(self, points: Float[Tensor, "b n 6"]) -> Float[Tensor, "b t w"]:
        """Tokens of the regions around the first points of each garment; points are in random order.

        A region holds the points that are nearest to its centre: a choice of so many neighbours would take longer than
        all of the network.
        """
        points = points.float()
        centres = points[:, : self.config.tokens]
        with torch.no_grad():
            region = torch.cdist(points[..., :3], centres[..., :3]).argmin(dim=2)
        own = centres[..., :3].gather(1, region[..., None].expand(-1, -1, 3))
        offsets = (points[..., :3] - own) * REGION_SCALE
        features = self.region(torch.cat([offsets, points[..., 3:]], dim=-1))
        features = _largest_of_groups(features, region, centres.shape[1])
        place = self.position(torch.cat([waves(centres[..., :3]), centres], dim=-1))
        tokens: Tensor = self.encoder(self.merge(features + place))
        return tokens


class PanelDecoder(nn.Module):
    """Tokens of an encoder to panels, their edges, and their seams."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.queries = nn.Parameter(torch.randn(config.queries, width))
        self.layers = nn.ModuleList(
            nn.TransformerDecoderLayer(width, config.heads, 4 * width, **LAYER_OPTIONS) for _ in range(config.layers)
        )
        sizes = (1, 2 * config.slots * (1 + BENDS), 2, 3, 6, config.slots + 1, len(PANEL_LABELS))
        self.norm = nn.LayerNorm(width)
        self.heads = nn.ModuleList(
            nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, size)) for size in sizes
        )
        self.mover = EdgeMover(config)
        self.seams = SeamHead(config)

    def forward(self, tokens: Float[Tensor, "b t w"]) -> tuple[list[Predicted], Float[Tensor, "b q w"]]:
        """One ``Predicted`` per layer, and the features of the queries after the last."""
        panels = self.queries.expand(len(tokens), -1, -1)
        predicted = []
        for layer in self.layers:
            panels = layer(panels, tokens)
            predicted.append(self._predicted(panels))
        return predicted, panels

    def _predicted(self, panels: Float[Tensor, "b q w"]) -> Predicted:
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
            nn.TransformerDecoderLayer(width, config.edge_heads, 4 * width, **LAYER_OPTIONS)
            for _ in range(config.edge_layers)
        )
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, 2 * (1 + BENDS))
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(
        self, edges: Edges, panels: Float[Tensor, "b q w"], said: Predicted, tokens: Float[Tensor, "b t w"]
    ) -> tuple[Predicted, Float[Tensor, "b e v"]]:
        """``said`` with moved corners and bends, and the features of the edges."""
        garments = torch.arange(len(tokens), device=tokens.device)[:, None]
        features = self.describe(edges, panels[garments, edges.queries], said) + self.slot(edges.slots)
        tokens = self.tokens(tokens)
        for layer in self.layers:
            features = layer(features, tokens, tgt_key_padding_mask=~edges.exists)
        with torch.autocast(features.device.type, enabled=False):
            features = features.float()
            moves = STEP_SCALE * self.head(self.norm(features)).unflatten(-1, (1 + BENDS, 2))
            moves = moves * edges.exists[..., None, None]
            at = (garments, edges.queries, edges.slots)
            corners = said.corners.index_put(at, moves[..., 0, :], accumulate=True)
            bends = said.bends.index_put(at, moves[..., 1:, :], accumulate=True)
        return replace(said, corners=corners, bends=bends), features


class SeamHead(nn.Module):
    """The partner of each edge of a garment, and the kind and label of the edges."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        width = config.edge_width
        self.describe = _EdgeFeatures(config, before=width)
        layer = nn.TransformerEncoderLayer(width, config.edge_heads, 4 * width, **LAYER_OPTIONS)
        self.layers = nn.TransformerEncoder(layer, config.seam_layers, nn.LayerNorm(width), enable_nested_tensor=False)
        self.queries, self.keys = nn.Linear(width, width), nn.Linear(width, width)
        self.turned = nn.Linear(width, width)
        self.no_partner, self.kind = nn.Linear(width, 1), nn.Linear(width, 1)
        self.label = nn.Linear(width, len(EDGE_LABELS))

    def forward(self, edges: Edges, features: Float[Tensor, "b e v"], said: Predicted) -> Sewn:
        """``features``: of the moved edges."""
        related = self.layers(self.describe(edges, features, said), src_key_padding_mask=~edges.exists)
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
            known = _numbers_of(edges, said)
            known = torch.cat([waves(known), known], dim=-1)
        found: Tensor = self.mlp(torch.cat([known, before], dim=-1))
        return found


def _numbers_of(edges: Edges, said: Predicted) -> Float[Tensor, "b e n"]:
    """Start, middle and end of edges in the panel and in space, their lengths, their numbers in the loop."""
    device = edges.slots.device
    garments = torch.arange(len(edges.slots), device=device)[:, None]
    start, end = edges.of(said.corners, edges.slots), edges.of(said.corners, edges.following)
    share = torch.arange(1, BENDS + 1, device=device)[:, None] / (BENDS + 1)
    chord = (1 - share) * start[..., None, :] + share * end[..., None, :]
    inner = chord + edges.of(said.bends, edges.slots)
    path = torch.cat([start[..., None, :], inner, end[..., None, :]], dim=-2)
    length = path.diff(dim=-2).norm(dim=-1).sum(dim=-1, keepdim=True)
    shown = path[..., [0, (BENDS + 1) // 2, BENDS + 1], :]
    turns, centres = rotation_of(said.axes[garments, edges.queries]), said.centres[garments, edges.queries]
    placed = shown @ turns[..., :2].transpose(-1, -2) + centres[..., None, :]
    numbers = torch.stack([edges.slots, edges.following], dim=-1) / 10.0
    return torch.cat([shown.flatten(-2), placed.flatten(-2), length, numbers], dim=-1)


def _symmetric(one: Float[Tensor, "b e v"], other: Float[Tensor, "b e v"]) -> Float[Tensor, "b e e"]:
    scores = one @ other.transpose(1, 2) / math.sqrt(one.shape[-1])
    return 0.5 * (scores + scores.transpose(1, 2))


def _largest_of_groups(
    values: Float[Tensor, "b n w"], group: Int[Tensor, "b n"], groups: int
) -> Float[Tensor, "b g w"]:
    """The largest value of each feature in each group; 0 for an empty group."""
    found = values.new_zeros(len(values), groups, values.shape[-1])
    return found.scatter_reduce(1, group[..., None].expand_as(values), values, "amax", include_self=False)


def encoder(config: NetConfig) -> nn.TransformerEncoder:
    """Attention among the tokens of an input."""
    layer = nn.TransformerEncoderLayer(config.width, config.heads, 4 * config.width, **LAYER_OPTIONS)
    return nn.TransformerEncoder(layer, config.layers, nn.LayerNorm(config.width), enable_nested_tensor=False)


def waves(numbers: Float[Tensor, "*b n"]) -> Float[Tensor, "*b m"]:
    """Sines and cosines of numbers in ``FREQUENCIES`` octaves."""
    octaves = numbers[..., None] * 2.0 ** torch.arange(FREQUENCIES, device=numbers.device)
    return torch.cat([octaves.sin(), octaves.cos()], dim=-1).flatten(-2)


def rotation_of(columns: Float[Tensor, "*b 6"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation from two columns by orthonormalisation (Zhou et al., On the Continuity of Rotations, CVPR 2019)."""
    first = functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:] - (first * columns[..., 3:]).sum(-1, keepdim=True) * first
    second = functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


# ------------------------------------------------------------------------------------------------------------- the loss


def set_loss(decoder: PanelDecoder, tokens: Float[Tensor, "b t w"], true: PanelTargets) -> dict[str, Tensor]:
    """Weighted loss terms by name, of panels, moved edges and seams.

    Invariant to the order of the true panels and to the start of their loops.
    """
    layers, panels = decoder(tokens)
    with torch.autocast(tokens.device.type, enabled=False):
        parts, matched, shifts = panel_losses(layers, true)
    edges = _true_edges(true, matched, shifts)
    # Detached: moves and seams teach the tokens, not the first loops.
    first = Predicted(*(getattr(layers[-1], name).detach() for name in Predicted.__dataclass_fields__))
    moved, features = decoder.mover(edges, panels, first, tokens)
    fixed = replace(moved, corners=moved.corners.detach(), bends=moved.bends.detach())
    sewn = decoder.seams(edges, features, fixed)
    with torch.autocast(tokens.device.type, enabled=False):
        refined = _loop_losses(moved, true, matched, shifts)
        parts |= {name: parts[name] + REFINED * part for name, part in refined.items()}
        parts |= _seam_losses(sewn, true, edges.exists)
    return {name: WEIGHTS[name] * part for name, part in parts.items()}


def panel_losses(layers: list[Predicted], true: PanelTargets) -> tuple[dict[str, Tensor], Matched, Int[Tensor, " m"]]:
    """Mean losses of the layers; the match of queries and panels by the last layer, which holds for all; its shifts."""
    matched = match_panels(layers[-1], true)
    shifts = [_shifts(layer, true, matched) for layer in layers]
    parts = [_loss_of_layer(layer, true, matched, shift) for layer, shift in zip(layers, shifts, strict=True)]
    return {name: torch.stack([part[name] for part in parts]).mean() for name in parts[0]}, matched, shifts[-1]


def match_panels(predicted: Predicted, true: PanelTargets) -> Matched:
    """Matched rows of garments, queries and true panels, at least total cost (Hungarian method)."""
    with torch.no_grad():
        likelihood = predicted.edges.log_softmax(dim=-1).clamp(min=-10.0)
        counts = true.edge_counts[:, None].expand(-1, likelihood.shape[1], -1)
        cost = (
            2.0 * torch.cdist(predicted.centres, true.centres)
            + 0.5 * torch.cdist(predicted.axes, _axes_of(true.rotations))
            + 1.0 * torch.cdist(predicted.extents.log(), true.extents.clamp(min=LEAST_EXTENT).log(), p=1.0)
            - 0.1 * likelihood.gather(2, counts)
            - predicted.exists.sigmoid()[..., None]
        )
        table = cost.masked_fill(~true.exists[:, None], NO_PANEL).cpu().numpy()  # one copy to the host
    pairs = []
    for garment, costs in enumerate(table):
        known = np.flatnonzero(costs[0] < NO_PANEL)
        queries, chosen = linear_sum_assignment(costs[:, known])
        pairs.append(np.stack([np.full(len(known), garment), queries, known[chosen]]))
    return Matched(*torch.from_numpy(np.concatenate(pairs, axis=1)).to(cost.device))


def _loss_of_layer(
    predicted: Predicted, true: PanelTargets, matched: Matched, shifts: Int[Tensor, " m"]
) -> dict[str, Tensor]:
    ours, theirs = (matched.garments, matched.queries), (matched.garments, matched.panels)
    exists = torch.zeros_like(predicted.exists)
    exists[ours] = 1.0
    extents = true.extents[theirs].clamp(min=LEAST_EXTENT)
    return {
        "exists": functional.binary_cross_entropy_with_logits(predicted.exists, exists),
        **_loop_losses(predicted, true, matched, shifts),
        "extents": functional.l1_loss(predicted.extents[ours].log(), extents.log()),
        "centres": functional.l1_loss(predicted.centres[ours], true.centres[theirs]),
        # Of the columns as they are: rotations half a turn away from the truth would be a local minimum.
        "rotations": functional.l1_loss(predicted.axes[ours], _axes_of(true.rotations[theirs])),
        "edges": functional.cross_entropy(predicted.edges[ours], true.edge_counts[theirs]),
        "labels": functional.cross_entropy(predicted.labels[ours], true.labels[theirs]),
    }


def _axes_of(rotations: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 6"]:
    """The first two columns."""
    return rotations[..., :2].transpose(-1, -2).flatten(-2)


def _shifts(predicted: Predicted, true: PanelTargets, matched: Matched) -> Int[Tensor, " m"]:
    """The corner of each true loop at which the predicted loop starts: that of the least mean distance of corners."""
    with torch.no_grad():
        counts = true.edge_counts[matched.garments, matched.panels]
        corners = true.corners[matched.garments, matched.panels]
        slot = torch.arange(corners.shape[1], device=counts.device)
        turned = (slot[None, :, None] + slot) % counts[:, None, None]  # panel, shift, slot
        rolled = corners[torch.arange(len(counts), device=counts.device)[:, None, None], turned]
        apart = (predicted.corners[matched.garments, matched.queries][:, None] - rolled).abs().sum(dim=-1)
        within = slot < counts[:, None]
        cost = torch.where(within[:, None], apart, 0.0).sum(dim=-1)
        return torch.where(within, cost, torch.inf).argmin(dim=-1)


def _loop_losses(
    predicted: Predicted, true: PanelTargets, matched: Matched, shifts: Int[Tensor, " m"]
) -> dict[str, Tensor]:
    """Losses of corners and bends of loops that start at the corners ``shifts`` of the true ones.

    ``areas``: log(1 + d · perimeter / area), where d is the mean distance of corners and bends: for small d about the
    share of the area that differs, so that a centimetre counts more for a cuff than for a skirt.
    """
    ours, theirs = (matched.garments, matched.queries), (matched.garments, matched.panels)
    counts = true.edge_counts[theirs]
    slot = torch.arange(true.corners.shape[2], device=counts.device)
    turned = (slot + shifts[:, None]) % counts[:, None]
    within, row = slot < counts[:, None], torch.arange(len(counts), device=counts.device)[:, None]
    corners = predicted.corners[ours] - true.corners[theirs][row, turned]
    bends = predicted.bends[ours] - true.bends[theirs][row, turned]
    distances = (corners.square().sum(dim=-1) + TINY).sqrt() + (bends.square().sum(dim=-1) + TINY).sqrt().mean(dim=-1)
    return {
        "corners": _mean_of_rows(corners.abs().mean(dim=-1), within).mean(),
        "bends": _mean_of_rows(bends.abs().mean(dim=(-2, -1)), within).mean(),
        "areas": torch.log1p(_mean_of_rows(distances, within) * true.slimness[theirs]).mean(),
    }


def _mean_of_rows(values: Float[Tensor, "m n"], within: Bool[Tensor, "m n"]) -> Float[Tensor, " m"]:
    return torch.where(within, values, 0.0).sum(dim=1) / within.sum(dim=1)


def _true_edges(true: PanelTargets, matched: Matched, shifts: Int[Tensor, " m"]) -> Edges:
    """The true edges, as slots of the queries that are matched to their panels."""
    query_of, shift_of = torch.zeros_like(true.edge_counts), torch.zeros_like(true.edge_counts)
    query_of[matched.garments, matched.panels] = matched.queries
    shift_of[matched.garments, matched.panels] = shifts
    panels = true.edge_panels.long().clamp(min=0)
    counts = true.edge_counts.gather(1, panels).clamp(min=1)
    slots = (true.edge_slots.long() - shift_of.gather(1, panels)) % counts
    return Edges(query_of.gather(1, panels), slots, (slots + 1) % counts, true.edge_panels >= 0)


def _seam_losses(sewn: Sewn, true: PanelTargets, exists: Bool[Tensor, "b e"]) -> dict[str, Tensor]:
    count = exists.shape[1]
    partners = true.partners.long()
    chosen = torch.where(partners < 0, count, partners)
    of_edges = {
        "partners": functional.cross_entropy(sewn.partners.flatten(0, 1), chosen.flatten(), reduction="none"),
        "kinds": functional.binary_cross_entropy_with_logits(
            sewn.kinds.flatten(), true.edge_kinds.float().flatten(), reduction="none"
        ),
        "edge_labels": functional.cross_entropy(
            sewn.labels.flatten(0, 1), true.edge_labels.long().flatten(), reduction="none"
        ),
    }
    is_sewn = exists & (partners >= 0)
    turned = sewn.turned.gather(2, partners.clamp(min=0)[..., None])[..., 0]
    of_seams = functional.binary_cross_entropy_with_logits(turned, true.turned.float(), reduction="none")
    means = {name: _mean_of(values.view_as(exists), exists) for name, values in of_edges.items()}
    return {**means, "turned": _mean_of(of_seams, is_sewn)}


def _mean_of(values: Float[Tensor, "b e"], chosen: Bool[Tensor, "b e"]) -> Tensor:
    return torch.where(chosen, values, 0.0).sum() / chosen.sum().clamp(min=1)


# ---------------------------------------------------------------------------------------------------------- the answers


def answers_of(decoder: PanelDecoder, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
    """The predictions in the form of the targets, with the panels whose probability exceeds 1/2, at least one."""
    layers, panels = decoder(tokens)
    last = layers[-1]
    exists = (last.exists > 0) | (last.exists == last.exists.amax(dim=1, keepdim=True))
    counts = LEAST_EDGES + last.edges[..., LEAST_EDGES:].argmax(dim=-1)
    edges = _edges_of(exists, counts, decoder.config.edges)
    moved, features = decoder.mover(edges, panels, last, tokens)
    sewn = decoder.seams(edges, features, moved)
    partners = _partners(sewn.partners, edges.exists)
    mutual = partners.clamp(min=0)[..., None]
    labels = sewn.labels + torch.where(  # of both edges: sewn edges with different labels are a fault
        (partners >= 0)[..., None], sewn.labels.gather(1, mutual.expand_as(sewn.labels)), 0.0
    )
    return PanelTargets(
        points=tokens.new_zeros(len(tokens), 0, 6),
        exists=exists,
        corners=moved.corners,
        bends=moved.bends,
        extents=moved.extents,
        centres=moved.centres,
        rotations=moved.rotations,
        edge_counts=counts,
        labels=moved.labels.argmax(dim=-1),
        slimness=torch.zeros_like(last.exists),
        edge_panels=torch.where(edges.exists, edges.queries, -1),
        edge_slots=edges.slots,
        edge_kinds=(sewn.kinds > 0).long(),
        edge_labels=labels.argmax(dim=-1),
        partners=partners,
        turned=sewn.turned.gather(2, mutual)[..., 0] > 0,
    )


def _edges_of(exists: Bool[Tensor, "b q"], counts: Int[Tensor, "b q"], room: int) -> Edges:
    """The edges of the queries that exist; a panel beyond the room gets none."""
    shape = (len(exists), room)
    queries, slots, following = (np.zeros(shape, np.int64) for _ in range(3))
    known = np.zeros(shape, bool)
    for garment, (chosen, numbers) in enumerate(zip(exists.cpu().numpy(), counts.cpu().numpy(), strict=True)):
        filled = 0
        for query in np.flatnonzero(chosen).tolist():
            count = int(numbers[query])
            if filled + count > room:
                continue
            part, loop = slice(filled, filled + count), np.arange(count)
            queries[garment, part], known[garment, part] = query, True
            slots[garment, part], following[garment, part] = loop, np.roll(loop, -1)
            filled += count
    return Edges(*(torch.from_numpy(array).to(counts.device) for array in (queries, slots, following, known)))


def _partners(logits: Float[Tensor, "b e f"], exists: Bool[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The partner of each edge, or -1: the likeliest pairs first, while they are likelier than two free edges."""
    log = logits.float().log_softmax(dim=-1)
    pairs, free = log[..., :-1] + log[..., :-1].transpose(1, 2), log[..., -1]
    gains = (pairs - free[:, :, None] - free[:, None]).cpu().numpy()
    partners = np.full(exists.shape, -1)
    for gain, known, chosen in zip(gains, exists.cpu().numpy(), partners, strict=True):
        left, right = np.nonzero(np.triu((gain > 0) & known[:, None] & known[None], 1))
        for k in np.argsort(-gain[left, right], kind="stable").tolist():
            if chosen[left[k]] < 0 and chosen[right[k]] < 0:
                chosen[left[k]], chosen[right[k]] = right[k], left[k]
    return torch.from_numpy(partners).to(logits.device)
