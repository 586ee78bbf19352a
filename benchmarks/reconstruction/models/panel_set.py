"""From surface points of a garment to the set of its panels, sewn.

A balanced tree divides the points into regions of equal numbers, and each region becomes a token (Point-MAE, Pang et
al., ECCV 2022; Kd-Networks, Klokov and Lempitsky, ICCV 2017); learned queries attend to the tokens, and each query may
become a panel (DETR, Carion et al., ECCV 2020) with corners in the order of its loop. Panels are a set: the loss
matches queries to panels at least cost, and a loop may start at any corner. The edges of all panels then attend to each
other and to the tokens, and move; each chooses the edge that it is sewn to, or none.

Nothing in a training step waits for the device: sizes do not depend on values there.
"""

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any, TypeVar, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.assignment import least_cost
from benchmarks.reconstruction.attention import DecoderLayer, EncoderLayer, hiding
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples
from benchmarks.reconstruction.panel_targets import BENDS, PanelTargets, ToTargets, patterns_from
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Pattern
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS
from gcd_dataset.workers import parallel_map

__all__ = [
    "SMOKE",
    "USUAL",
    "DrawnPoints",
    "Edges",
    "NetConfig",
    "PanelDecoder",
    "PanelSet",
    "PointConfig",
    "PointLearner",
    "PointTokens",
    "Predicted",
    "answers_of",
    "axes_of",
    "best_pairs",
    "build",
    "common_labels",
    "edge_numbers",
    "edges_of",
    "encoder",
    "match_panels",
    "mean_of",
    "panel_losses",
    "regions_of",
    "rotation_of",
    "set_loss",
    "sizes_from",
    "waves",
]

Sizes = TypeVar("Sizes", bound="PointConfig")

FREQUENCIES = 8  # octaves of the positional encoding
REGION_SCALE = 10.0  # scales offsets within a region to about 1
STEP_SCALE = 0.1  # UNIT: size of the moves of corners and bends, 5 cm
WEIGHTS = {
    "exists": 2.0, "corners": 5.0, "bends": 5.0, "areas": 0.5, "extents": 0.5, "centres": 5.0, "rotations": 1.0,
    "edges": 0.5, "labels": 0.2, "partners": 1.0, "turned": 0.2, "kinds": 0.5, "edge_labels": 0.2,
}  # fmt: skip
REFINED = 2.0  # weight of the moved loops, relative to those of all layers of the decoder
OF_EDGES = ("edge_panels", "edge_slots", "edge_kinds", "edge_labels", "partners", "turned")
LEAST_EDGES = 3
FIRST_EXTENT = 0.3  # UNIT, of panels before training
LEAST_EXTENT = 1e-3  # UNIT
TINY = 1e-12  # keeps the slope of square roots finite
NEVER = -1e4  # score of an edge as its own partner
CHUNK = 64  # garments that a process encodes at once
TOGETHER = 8  # garments that a process draws at once
ROOM = 32  # edges: a batch has room for a multiple of this number
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 300, "batch": 8, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "queries": 12, "slots": 24, "edges": 96, "tokens": 32, "width": 64, "heads": 4, "layers": 1,
    "region_width": 32, "edge_width": 64, "edge_heads": 4, "edge_layers": 1, "seam_layers": 1, "points": 256,
    "stored_points": 1024,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


@dataclass(frozen=True, slots=True)
class PointConfig:
    """Sizes of answers and of the point encoder."""

    queries: int = 40
    """Most panels of a garment."""
    slots: int = 40
    """Most edges of a panel."""
    edges: int = 320
    """Most edges of a garment."""
    tokens: int = 256
    """Regions of the points; a power of 2."""
    region_width: int = 128
    """Features of a point."""
    width: int = 384
    heads: int = 6
    layers: int = 6
    """Layers of the encoder; of a ``PanelDecoder``, too."""


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
    """What the queries say about panels; lengths in ``UNIT``. The fields may have a further dimension of layers."""

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
        """What these queries say, in their order; the fields have a dimension of layers."""
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
        """Values of the queries for each edge; a product, whose gradient is faster than that of an index."""
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


class PointLearner(Learner[PanelTargets, Pattern]):
    """Base of networks from points and normals to a pattern."""

    def __init__(self, config: PointConfig, *, points: int = 4096, stored_points: int = 8192) -> None:
        """``points``: points of a garment in a step, drawn from the first ``stored_points``.

        Raises ``ConfigError`` unless the number of tokens is a power of 2, at most ``points``.
        """
        super().__init__()
        self.config = config
        if not 1 <= config.tokens <= points or config.tokens & (config.tokens - 1):
            raise ConfigError(f"{config.tokens} tokens of {points} points: give a power of 2, at most the points")
        self.points, self.stored_points = points, stored_points
        self.tokens = PointTokens(config)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> "DrawnPoints":
        """Targets of the garments."""
        bare = replace(garments, points=garments.points[:, :0])
        parts = (bare.select(range(k, min(k + CHUNK, len(bare)))) for k in range(0, len(bare), CHUNK))
        targets = PanelTargets.join(list(parallel_map(self.encoder(), parts, workers)))
        edges = (targets.edge_panels >= 0).sum(dim=1)
        whole = replace(targets, points=self.encoder().scaled(garments.points)).to(device)
        return DrawnPoints(whole, self.points, edges)

    def drawn_from(self, encoded: TensorExamples) -> "DrawnPoints":
        return DrawnPoints(cast(PanelTargets, encoded), self.points)

    def encoder(self) -> ToTargets:
        config = self.config
        return ToTargets(config.queries, config.slots, config.edges, self.stored_points)

    def predict(self, batch: PanelTargets) -> list[Pattern]:
        return patterns_from(self._predicted(batch))

    def answers(
        self, examples: Examples[PanelTargets], count: int, *, batch: int, workers: int = 0
    ) -> Iterator[Pattern]:
        rows = torch.split(torch.arange(count), batch)
        said = PanelTargets.join([self._predicted(examples.batch(part)).to(torch.device("cpu")) for part in rows])
        parts = (said[k : k + TOGETHER] for k in range(0, count, TOGETHER))
        return chain.from_iterable(parallel_map(patterns_from, parts, workers))

    def _predicted(self, batch: PanelTargets) -> PanelTargets:
        with torch.no_grad():
            return self.decoded(self.tokens(batch.points[:, : self.points]))

    @abstractmethod
    def decoded(self, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
        """The predictions in the form of the targets, from the tokens of the points."""


class PanelSet(PointLearner):
    """Points and normals to a pattern, by queries for panels."""

    def __init__(self, config: NetConfig | None = None, *, points: int = 4096, stored_points: int = 8192) -> None:
        """See ``PointLearner``."""
        config = config or NetConfig()
        super().__init__(config, points=points, stored_points=stored_points)
        self.decoder = PanelDecoder(config)

    def compile_parts(self) -> None:
        # Layer by layer: equal layers share their code. The number of edges differs between batches.
        for part in (self.tokens.features, *self.tokens.encoder.layers, *self.decoder.layers):
            part.compile()
        for layer in (*self.decoder.mover.layers, *self.decoder.seams.layers.layers):
            layer.compile(dynamic=True)

    def loss(self, batch: PanelTargets) -> dict[str, Tensor]:
        return set_loss(self.decoder, self.tokens(batch.points), batch)

    def decoded(self, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
        return answers_of(self.decoder, tokens)


def build(*, smoke: bool, options: Mapping[str, Any]) -> PanelSet:
    """The learner; ``options``: fields of ``NetConfig``, ``points`` and ``stored_points``."""
    sizes, own = sizes_from("panel_set", NetConfig, {**(SMALL if smoke else {}), **options})
    return PanelSet(sizes, **own)


def sizes_from(model: str, kind: type[Sizes], options: Mapping[str, Any]) -> tuple[Sizes, dict[str, Any]]:
    """The configuration of a network, and the arguments of ``PointLearner``. Raises ``ConfigError``."""
    given = dict(options)
    own: dict[str, Any] = {name: given.pop(name) for name in ("points", "stored_points") if name in given}
    names = [field.name for field in fields(kind)]
    unknown = set(given) - set(names)
    if unknown:
        known = ", ".join([*names, "points", "stored_points"])
        raise ConfigError(f"no size {min(unknown)} of {model}: choose of {known}")
    return kind(**given), own


@dataclass(frozen=True)
class DrawnPoints:
    """Targets whose batches have some of the stored points, others in each step."""

    whole: PanelTargets
    points: int
    edges: Int[Tensor, " g"] | None = None
    """Edges of each garment, on the CPU, if they do not change: batches then leave out rows that are empty in all."""

    def __len__(self) -> int:
        return len(self.whole)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> PanelTargets:
        found = self.whole.batch(rows)
        if self.edges is not None and len(rows):
            room = ROOM * math.ceil(max(1, int(self.edges[rows].max())) / ROOM)
            found = replace(found, **{name: getattr(found, name)[:, :room] for name in OF_EDGES})
        return found if chance is None else found.with_points(self.points, chance)


# ---------------------------------------------------------------------------------------------------------- the network


class PointTokens(nn.Module):
    """Points and normals to tokens of regions, related to each other."""

    def __init__(self, config: PointConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.features = RegionFeatures(config.region_width, width)
        self.position = nn.Linear(6 * FREQUENCIES + 6, width)
        self.merge = nn.Sequential(nn.GELU(), nn.Linear(width, width))
        self.encoder = encoder(config)

    def forward(self, points: Float[Tensor, "b n 6"]) -> Float[Tensor, "b t w"]:
        """Tokens of the regions."""
        with torch.autocast(points.device.type, enabled=False), torch.no_grad():
            regions = regions_of(points.float(), self.config.tokens)
            middles = regions.mean(dim=2)
            offsets = (regions[..., :3] - middles[:, :, None, :3]) * REGION_SCALE
            inputs = torch.cat([offsets, regions[..., 3:]], dim=-1)
            places = torch.cat([waves(middles[..., :3]), middles], dim=-1)
        tokens: Tensor = self.encoder(self.merge(self.features(inputs) + self.position(places)).float())
        return tokens


class RegionFeatures(nn.Module):
    """A feature vector of the points in each region."""

    def __init__(self, inner: int, width: int) -> None:
        """``inner``: features of a point."""
        super().__init__()
        self.point = nn.Sequential(nn.Linear(6, inner), nn.GELU(), nn.Linear(inner, inner))
        self.own, self.shared = nn.Linear(inner, 2 * inner), nn.Linear(inner, 2 * inner, bias=False)
        self.region = nn.Sequential(nn.GELU(), nn.Linear(2 * inner, 2 * inner))
        self.form = nn.Linear(2 * inner, width)

    def forward(self, points: Float[Tensor, "b t m 6"]) -> Float[Tensor, "b t w"]:
        features = self.point(points)
        features = self.own(features) + self.shared(features.amax(dim=2))[:, :, None]
        found: Tensor = self.form(self.region(features).amax(dim=2))
        return found


def regions_of(points: Float[Tensor, "b n 6"], count: int) -> Float[Tensor, "b t m 6"]:
    """The points in ``count`` regions of equal numbers; some points are left out unless ``count`` divides their number.

    Each region is halved at the median of its longest side until there are enough; ``count`` is a power of 2.
    """
    batch, total = len(points), points.shape[1] // count * count
    places = points[:, :total, :3]
    order = torch.arange(total, device=points.device).expand(batch, -1)
    parts = 1
    while parts < count:
        places, order = places.reshape(batch * parts, -1, 3), order.reshape(batch * parts, -1)
        side = (places.amax(dim=1) - places.amin(dim=1)).argmax(dim=1)
        along = places.gather(2, side[:, None, None].expand(-1, places.shape[1], 1))[..., 0]
        rank = along.argsort(dim=1)
        places, order = places.gather(1, rank[..., None].expand(-1, -1, 3)), order.gather(1, rank)
        parts *= 2
    order = order.reshape(batch, total, 1).expand(-1, -1, points.shape[2])
    return points.gather(1, order).view(batch, count, -1, points.shape[2])


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
        """What the queries say after each layer, and their features after the last."""
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
        """``said`` with moved corners and bends, and the features of the edges."""
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


def encoder(config: PointConfig) -> nn.TransformerEncoder:
    """Attention among the tokens of an input."""
    layer = EncoderLayer(config.width, config.heads, 4 * config.width)
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
        parts, queries, shifts = panel_losses(layers, true)
    edges = _true_edges(true, queries, shifts)
    # Detached: moves and seams teach the tokens, not the first loops.
    moved, features = decoder.mover(edges, panels, layers[-1].detach(), tokens)
    fixed = replace(moved, corners=moved.corners.detach(), bends=moved.bends.detach())
    sewn = decoder.seams(edges, features, fixed)
    with torch.autocast(tokens.device.type, enabled=False):
        refined = _loop_losses(moved[None].of_queries(queries), true, shifts[None])
        parts |= {name: parts[name] + REFINED * part for name, part in refined.items()}
        parts |= _seam_losses(sewn, true, edges.exists)
    return {name: WEIGHTS[name] * part for name, part in parts.items()}


def panel_losses(
    layers: Predicted, true: PanelTargets
) -> tuple[dict[str, Tensor], Int[Tensor, "b p"], Int[Tensor, "b p"]]:
    """Mean losses of the layers, the query of each true panel, and the corner of its loop at which the query's starts.

    The last layer's match of queries and panels holds for all. Rows beyond the panels of a garment hold no meaning.
    """
    queries = match_panels(layers[-1], true)
    said = layers.of_queries(queries)
    shifts = _shifts(said.corners, true)
    count = len(layers.exists)
    slots, kinds = said.edges.shape[-1], said.labels.shape[-1]
    numbers, labels = (column.expand(count, -1, -1).flatten() for column in (true.edge_counts, true.labels))
    of_panels = {
        "extents": (said.extents.log() - true.extents.clamp(min=LEAST_EXTENT).log()).abs().mean(dim=-1),
        "centres": (said.centres - true.centres).abs().mean(dim=-1),
        # Of the columns as they are: rotations half a turn away from the truth would be a local minimum.
        "rotations": (said.axes - axes_of(true.rotations)).abs().mean(dim=-1),
        "edges": functional.cross_entropy(said.edges.reshape(-1, slots), numbers, reduction="none"),
        "labels": functional.cross_entropy(said.labels.reshape(-1, kinds), labels, reduction="none"),
    }
    existing = true.exists.expand(count, -1, -1)
    parts = {name: mean_of(values.view(existing.shape), existing) for name, values in of_panels.items()}
    parts["exists"] = _existence_loss(layers.exists, queries, true.exists)
    return {**parts, **_loop_losses(said, true, shifts)}, queries, shifts[-1]


def match_panels(predicted: Predicted, true: PanelTargets) -> Int[Tensor, "b p"]:
    """The query of each true panel, at least total cost (``least_cost``); 0 beyond the panels of a garment."""
    with torch.no_grad():
        likelihood = predicted.edges.log_softmax(dim=-1).clamp(min=-10.0)
        counts = true.edge_counts[:, None].expand(-1, likelihood.shape[1], -1)
        cost = (
            2.0 * torch.cdist(predicted.centres, true.centres)
            + 0.5 * torch.cdist(predicted.axes, axes_of(true.rotations))
            + 1.0 * torch.cdist(predicted.extents.log(), true.extents.clamp(min=LEAST_EXTENT).log(), p=1.0)
            - 0.1 * likelihood.gather(2, counts)
            - predicted.exists.sigmoid()[..., None]
        )
        return least_cost(cost.transpose(1, 2), true.exists)


def _existence_loss(logits: Float[Tensor, "l b q"], queries: Int[Tensor, "b p"], exists: Bool[Tensor, "b p"]) -> Tensor:
    """Of garments with panels; one beyond the network's sizes has none, and teaches nothing."""
    chosen = torch.zeros_like(logits[0]).scatter_add(1, queries, exists.to(logits.dtype)).expand_as(logits)
    losses = functional.binary_cross_entropy_with_logits(logits, chosen, reduction="none")
    return mean_of(losses, exists.any(dim=1)[:, None].expand_as(losses))


def axes_of(rotations: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 6"]:
    """The first two columns of rotations."""
    return rotations[..., :2].transpose(-1, -2).flatten(-2)


def _shifts(corners: Float[Tensor, "l b p n 2"], true: PanelTargets) -> Int[Tensor, "l b p"]:
    """The corner of each true loop at which the predicted loop starts: that of the least mean square distance."""
    with torch.no_grad():
        counts = true.edge_counts.clamp(min=1)[..., None]
        slot = torch.arange(true.corners.shape[2], device=counts.device)
        starts = slot[:, None].expand(*counts.shape[:2], -1, 1)[..., 0]
        rolled = _rolled(true.corners, starts.movedim(-1, 0), counts[..., 0])  # shift, garment, panel, slot
        rolled = torch.where((slot < counts)[..., None], rolled, 0.0).flatten(-2)
        # The distance is least where the product is largest: the squares do not depend on the shift.
        products = torch.einsum("lbpk,sbpk->lbps", corners.flatten(-2), rolled)
        return torch.where(slot < counts, products, -torch.inf).argmax(dim=-1)


def _rolled(
    values: Float[Tensor, "b p n *d"], shifts: Int[Tensor, "l b p"], counts: Int[Tensor, "b p"]
) -> Float[Tensor, "l b p n *d"]:
    """Values of loops that start at the corners ``shifts``."""
    slot = torch.arange(values.shape[2], device=values.device)
    turned = (slot + shifts[..., None]) % counts[..., None]
    garments, panels = (torch.arange(size, device=values.device) for size in values.shape[:2])
    return values[garments[:, None, None], panels[:, None], turned]


def _loop_losses(said: Predicted, true: PanelTargets, shifts: Int[Tensor, "l b p"]) -> dict[str, Tensor]:
    """Losses of corners and bends of the true panels' loops, which start at the corners ``shifts`` of the true ones.

    ``areas``: log(1 + d · perimeter / area), where d is the mean distance of corners and bends: for small d about the
    share of the area that differs, so that a centimetre counts more for a cuff than for a skirt.
    """
    counts = true.edge_counts.clamp(min=1)
    within = torch.arange(true.corners.shape[2], device=counts.device) < counts[..., None]
    corners = said.corners - _rolled(true.corners, shifts, counts)
    bends = said.bends - _rolled(true.bends, shifts, counts)
    distances = (corners.square().sum(dim=-1) + TINY).sqrt() + (bends.square().sum(dim=-1) + TINY).sqrt().mean(dim=-1)
    existing = true.exists.expand_as(shifts)
    values = {
        "corners": _mean_of_rows(corners.abs().mean(dim=-1), within),
        "bends": _mean_of_rows(bends.abs().mean(dim=(-2, -1)), within),
        "areas": torch.log1p(_mean_of_rows(distances, within) * true.slimness),
    }
    return {name: mean_of(value, existing) for name, value in values.items()}


def _mean_of_rows(values: Float[Tensor, "*m n"], within: Bool[Tensor, "*k n"]) -> Float[Tensor, " *m"]:
    return torch.where(within, values, 0.0).sum(dim=-1) / within.sum(dim=-1)


def _true_edges(true: PanelTargets, queries: Int[Tensor, "b p"], shifts: Int[Tensor, "b p"]) -> Edges:
    """The true edges, as slots of the queries that are matched to their panels."""
    panels = true.edge_panels.long().clamp(min=0)
    counts = true.edge_counts.gather(1, panels).clamp(min=1)
    slots = (true.edge_slots.long() - shifts.gather(1, panels)) % counts
    return Edges(queries.gather(1, panels), slots, (slots + 1) % counts, true.edge_panels >= 0)


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
    means = {name: mean_of(values.view_as(exists), exists) for name, values in of_edges.items()}
    return {**means, "turned": mean_of(of_seams, is_sewn)}


def mean_of(values: Float[Tensor, "*b e"], chosen: Bool[Tensor, "*b e"]) -> Tensor:
    """Mean of the chosen values; 0 if there are none."""
    return torch.where(chosen, values, 0.0).sum() / chosen.sum().clamp(min=1)


# ---------------------------------------------------------------------------------------------------------- the answers


def answers_of(decoder: PanelDecoder, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
    """The predictions in the form of the targets, with the panels whose probability exceeds 1/2, at least one."""
    layers, panels = decoder(tokens)
    last = layers[-1]
    exists = (last.exists > 0) | (last.exists == last.exists.amax(dim=1, keepdim=True))
    counts = LEAST_EDGES + last.edges[..., LEAST_EDGES:].argmax(dim=-1)
    edges = edges_of(exists, counts, decoder.config.edges)
    moved, features = decoder.mover(edges, panels, last, tokens)
    sewn = decoder.seams(edges, features, moved)
    partners = _partners(sewn.partners, edges.exists)
    mutual = partners.clamp(min=0)[..., None]
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
        edge_labels=common_labels(sewn.labels, partners),
        partners=partners,
        turned=sewn.turned.gather(2, mutual)[..., 0] > 0,
    )


def edges_of(exists: Bool[Tensor, "b q"], counts: Int[Tensor, "b q"], room: int) -> Edges:
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
    return best_pairs(pairs - free[:, :, None] - free[:, None], exists)


def best_pairs(gains: Float[Tensor, "b e e"], exists: Bool[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The partner of each edge, or -1: pairs in the order of their gains, while these are above 0.

    Of ``gains`` only the upper triangle is read.
    """
    partners = np.full(exists.shape, -1)
    for gain, known, chosen in zip(gains.cpu().numpy(), exists.cpu().numpy(), partners, strict=True):
        left, right = np.nonzero(np.triu((gain > 0) & known[:, None] & known[None], 1))
        for k in np.argsort(-gain[left, right], kind="stable").tolist():
            if chosen[left[k]] < 0 and chosen[right[k]] < 0:
                chosen[left[k]], chosen[right[k]] = right[k], left[k]
    return torch.from_numpy(partners).to(gains.device)


def common_labels(logits: Float[Tensor, "b e l"], partners: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The likeliest label of each edge, of both edges of a seam: sewn edges with different labels are a fault."""
    others = logits.gather(1, partners.clamp(min=0)[..., None].expand_as(logits))
    return (logits + torch.where((partners >= 0)[..., None], others, 0.0)).argmax(dim=-1)
