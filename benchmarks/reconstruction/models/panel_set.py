"""From surface points of a garment to the set of its panels, sewn.

Points are grouped into regions, and each region becomes a token (Point-MAE, Pang et al., ECCV 2022); learned queries
attend to the tokens, and each query may become a panel (DETR, Carion et al., ECCV 2020). Panels are a set: the loss
matches queries to panels at least cost, and a contour may start anywhere. The outline points of each panel then attend
to each other, to their neighbours along the outline, and to the tokens, and move. Edges between corners are sewn: each
attends to all edges of the garment and chooses its partner, or none.
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
from benchmarks.reconstruction.panel_targets import MAX_EDGES, PanelTargets, ToTargets, patterns_from
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Pattern
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS
from gcd_dataset.workers import parallel_map

__all__ = [
    "SMOKE",
    "USUAL",
    "Matched",
    "NetConfig",
    "PanelDecoder",
    "PanelSet",
    "PointTokens",
    "Predicted",
    "answers_of",
    "build",
    "encoder",
    "match_panels",
    "set_loss",
]

FREQUENCIES = 8  # octaves of the positional encoding
REGION_SCALE = 10.0  # scales offsets within a region to about 1
STEP_SCALE = 0.1  # UNIT: size of the moves of outline points, 5 cm
LAYER_OPTIONS: dict[str, Any] = {"activation": "gelu", "batch_first": True, "norm_first": True, "dropout": 0.0}
WEIGHTS = {
    "exists": 2.0, "contours": 5.0, "areas": 0.5, "corners": 1.0, "centres": 5.0, "rotations": 1.0, "edges": 0.5,
    "labels": 0.2, "partners": 1.0, "turned": 0.2, "kinds": 0.5, "edge_labels": 0.2,
}  # fmt: skip
REFINED = 2.0  # weight of the moved outlines, relative to those of all layers of the decoder
LEAST_EDGES = 3
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {"steps": 240, "batch": 8, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 20}
SMALL: Mapping[str, Any] = {
    "queries": 24, "tokens": 32, "neighbours": 16, "width": 64, "heads": 4, "layers": 1, "outline_width": 48,
    "outline_layers": 1, "seam_layers": 1, "edges": 160, "points": 256, "stored_points": 1024,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""
CHUNK = 64  # garments that a process encodes at once
NEVER = -1e4  # score of an edge as its own partner


@dataclass(frozen=True, slots=True)
class NetConfig:
    """Sizes of a network."""

    queries: int = 40
    contour_points: int = 64
    edges: int = 320
    """Most edges of a garment."""
    tokens: int = 384
    neighbours: int = 32
    width: int = 384
    heads: int = 6
    layers: int = 6
    """Layers of the encoder, and of the decoder."""
    outline_width: int = 192
    """Features of an outline point, and of an edge; a multiple of ``heads``."""
    outline_layers: int = 3
    """Layers that move outline points."""
    seam_layers: int = 3
    """Layers among the edges."""


@dataclass(frozen=True)
class Predicted:
    """What the queries say about panels; lengths in ``UNIT``."""

    exists: Float[Tensor, "b q"]
    """Logits."""
    contours: Float[Tensor, "b q c 2"]
    corners: Float[Tensor, "b q c"]
    """Logits."""
    centres: Float[Tensor, "b q 3"]
    rotations: Float[Tensor, "b q 3 3"]
    edges: Float[Tensor, "b q n"]
    """Logits of the number of edges."""
    labels: Float[Tensor, "b q l"]
    """Logits of ``PANEL_LABELS``."""


@dataclass(frozen=True)
class Matched:
    """Pairs of queries and true panels, one row for each."""

    garments: Int[Tensor, " m"]
    queries: Int[Tensor, " m"]
    panels: Int[Tensor, " m"]


@dataclass(frozen=True)
class Edges:
    """Edges between outline points, padded to one number for each garment."""

    rows: Int[Tensor, "b e"]
    """Row of the panel of each edge among the moved outlines; 0 where there is no edge."""
    points: Int[Tensor, "b e 2"]
    """Outline points where the edge begins and ends."""
    exists: Bool[Tensor, "b e"]


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
        """Targets of the garments. Raises ``ConfigError`` for a garment beyond the network's sizes."""
        bare = replace(garments, points=garments.points[:, :0])
        parts = (bare.select(range(k, min(k + CHUNK, len(bare)))) for k in range(0, len(bare), CHUNK))
        targets = PanelTargets.join(list(parallel_map(self.encoder(), parts, workers)))
        return self.drawn_from(replace(targets, points=self.encoder().scaled(garments.points)).to(device))

    def drawn_from(self, encoded: TensorExamples) -> "DrawnPoints":
        return DrawnPoints(cast(PanelTargets, encoded), self.points)

    def encoder(self) -> ToTargets:
        config = self.config
        return ToTargets(config.queries, config.contour_points, config.edges, self.stored_points)

    def compile_parts(self) -> None:
        self.tokens.compile()
        for layer in self.decoder.layers:
            layer.compile()

    def loss(self, batch: PanelTargets) -> dict[str, Tensor]:
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
        """Tokens of the regions around the first points of each garment; points are in random order."""
        points = points.float()
        centres = points[:, : self.config.tokens]
        with torch.no_grad():
            distances = torch.cdist(centres[..., :3], points[..., :3])
            nearest = distances.topk(min(self.config.neighbours, points.shape[1]), largest=False).indices
        region = points[torch.arange(len(points), device=points.device)[:, None, None], nearest]
        offsets = (region[..., :3] - centres[:, :, None, :3]) * REGION_SCALE
        features = self.region(torch.cat([offsets, region[..., 3:]], dim=-1)).amax(dim=2)
        place = self.position(torch.cat([waves(centres[..., :3]), centres], dim=-1))
        tokens: Tensor = self.encoder(self.merge(features + place))
        return tokens


class PanelDecoder(nn.Module):
    """Tokens of an encoder to panels, their moved outlines, and their seams."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.queries = nn.Parameter(torch.randn(config.queries, width))
        self.layers = nn.ModuleList(
            nn.TransformerDecoderLayer(width, config.heads, 4 * width, **LAYER_OPTIONS) for _ in range(config.layers)
        )
        sizes = (1, 3 * config.contour_points, 3, 6, MAX_EDGES + 1, len(PANEL_LABELS))
        self.norm = nn.LayerNorm(width)
        self.heads = nn.ModuleList(
            nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, size)) for size in sizes
        )
        self.outlines = OutlineMover(config)
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
            exists, outline, centres, rotations, edges, labels = (head(panels) for head in self.heads)
        outline = outline.unflatten(-1, (self.config.contour_points, 3))
        return Predicted(
            exists=exists[..., 0],
            contours=outline[..., :2],
            corners=outline[..., 2],
            centres=centres,
            rotations=rotation_of(rotations),
            edges=edges,
            labels=labels,
        )


class OutlineMover(nn.Module):
    """Moves the outline points of some panels towards what the tokens show, and says which are corners."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        width = config.outline_width
        self.panel = nn.Linear(config.width, width)
        self.place = nn.Linear(5 * 2 * FREQUENCIES + 6, width)
        self.layers = nn.ModuleList(_OutlineLayer(config) for _ in range(config.outline_layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, 3)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(
        self,
        panels: Float[Tensor, "m w"],
        contours: Float[Tensor, "m c 2"],
        corners: Float[Tensor, "m c"],
        placed: Float[Tensor, "m c 3"],
        tokens: Float[Tensor, "b t w"],
        garments: Int[Tensor, " m"],
    ) -> tuple[Float[Tensor, "m c 2"], Float[Tensor, "m c"], Float[Tensor, "m c v"]]:
        """Moved outlines, corner logits and features. ``placed``: the points in space; ``garments``: of the panels."""
        known = torch.cat([contours, placed, corners.clamp(-4, 4)[..., None]], dim=-1)
        features = self.place(torch.cat([waves(known[..., :5]), known], dim=-1)) + self.panel(panels)[:, None]
        for layer in self.layers:
            features = layer(features, tokens, garments)
        with torch.autocast(features.device.type, enabled=False):
            change = self.head(self.norm(features.float()))
        return contours + STEP_SCALE * change[..., :2], corners + change[..., 2], features.float()


class _OutlineLayer(nn.Module):
    """Attention to neighbours along the outline, to the whole outline, and to the tokens of the garment."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        width, self.heads = config.outline_width, config.heads
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(4))
        self.along = nn.Conv1d(width, width, 5, padding=2, padding_mode="circular")
        self.whole = nn.MultiheadAttention(width, config.heads, batch_first=True)
        self.query = nn.Linear(width, width)
        self.keys_values = nn.Linear(config.width, 2 * width)
        self.merge = nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(
        self, features: Float[Tensor, "m c v"], tokens: Float[Tensor, "b t w"], garments: Int[Tensor, " m"]
    ) -> Float[Tensor, "m c v"]:
        first, second, third, fourth = self.norms
        features = features + self.along(first(features).transpose(1, 2)).transpose(1, 2)
        x = second(features)
        features = features + self.whole(x, x, x, need_weights=False)[0]
        query = self._split(self.query(third(features)))
        keys, values = (self._split(part[garments]) for part in self.keys_values(tokens).chunk(2, dim=-1))
        seen = functional.scaled_dot_product_attention(query, keys, values)
        features = features + self.merge(seen.transpose(1, 2).flatten(2))
        return features + self.mlp(fourth(features))

    def _split(self, x: Float[Tensor, "m n v"]) -> Float[Tensor, "m h n d"]:
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)


class SeamHead(nn.Module):
    """The partner of each edge of a garment, and the kind and label of the edges."""

    SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
    """Places along an edge where it is described."""

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        width, places = config.outline_width, len(self.SHARES)
        known = places * (width + 5 * (2 * FREQUENCIES + 1)) + 2 * FREQUENCIES + 1 + width
        self.panel = nn.Linear(config.width, width)
        self.describe = nn.Sequential(nn.Linear(known, 2 * width), nn.GELU(), nn.Linear(2 * width, width))
        layer = nn.TransformerEncoderLayer(width, config.heads, 4 * width, **LAYER_OPTIONS)
        self.layers = nn.TransformerEncoder(layer, config.seam_layers, nn.LayerNorm(width), enable_nested_tensor=False)
        self.queries, self.keys = nn.Linear(width, width), nn.Linear(width, width)
        self.turned = nn.Linear(width, width)
        self.no_partner, self.kind = nn.Linear(width, 1), nn.Linear(width, 1)
        self.label = nn.Linear(width, len(EDGE_LABELS))

    def forward(
        self,
        edges: Edges,
        panels: Float[Tensor, "m w"],
        contours: Float[Tensor, "m c 2"],
        placed: Float[Tensor, "m c 3"],
        features: Float[Tensor, "m c v"],
    ) -> Sewn:
        """``panels``, ``contours``, ``placed``, ``features``: of the panels that ``edges.rows`` refers to."""
        described = self._described(edges, panels, contours, placed, features)
        related = self.layers(described, src_key_padding_mask=~edges.exists)
        with torch.autocast(described.device.type, enabled=False):
            related = related.float()
            return Sewn(
                partners=torch.cat([self._partners(related, edges.exists), self.no_partner(related)], dim=-1),
                turned=_symmetric(self.turned(related), related),
                kinds=self.kind(related)[..., 0],
                labels=self.label(related),
            )

    def _described(
        self, edges: Edges, panels: Tensor, contours: Tensor, placed: Tensor, features: Tensor
    ) -> Float[Tensor, "b e v"]:
        count = contours.shape[1]
        start, end = edges.points.unbind(-1)
        span = (end - start - 1) % count + 1
        shares = torch.tensor(self.SHARES, device=span.device)
        at = (start[..., None] + (shares * span[..., None]).round().long()) % count
        rows = edges.rows[..., None]
        points = torch.cat([contours, placed], dim=-1)
        steps = (contours.roll(-1, dims=1) - contours).norm(dim=-1)
        run = functional.pad(torch.cat([steps, steps], dim=1).cumsum(dim=1), (1, 0))
        length = (run[edges.rows, start + span] - run[edges.rows, start])[..., None]
        seen = points[rows, at]
        known = torch.cat([features[rows, at], waves(seen), seen], dim=-1).flatten(2)
        described: Tensor = self.describe(
            torch.cat([known, waves(length), length, self.panel(panels)[edges.rows]], dim=-1)
        )
        return described

    def _partners(self, related: Float[Tensor, "b e v"], exists: Bool[Tensor, "b e"]) -> Float[Tensor, "b e e"]:
        scores = _symmetric(self.queries(related), self.keys(related))
        own = torch.eye(scores.shape[1], dtype=torch.bool, device=scores.device)
        return scores.masked_fill(own | ~exists[:, None, :], NEVER)


def _symmetric(one: Float[Tensor, "b e v"], other: Float[Tensor, "b e v"]) -> Float[Tensor, "b e e"]:
    scores = one @ other.transpose(1, 2) / math.sqrt(one.shape[-1])
    return 0.5 * (scores + scores.transpose(1, 2))


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


def _placed(
    contours: Float[Tensor, "m c 2"], centres: Float[Tensor, "m 3"], rotations: Float[Tensor, "m 3 3"]
) -> Float[Tensor, "m c 3"]:
    """Outline points in space [UNIT]."""
    return contours @ rotations[..., :2].transpose(1, 2) + centres[:, None]


# ------------------------------------------------------------------------------------------------------------- the loss


def set_loss(decoder: PanelDecoder, tokens: Float[Tensor, "b t w"], true: PanelTargets) -> dict[str, Tensor]:
    """Weighted loss terms by name, of panels, moved outlines and seams.

    Invariant to the order of the true panels and to the start of their contours.
    """
    layers, panels = decoder(tokens)
    with torch.autocast(tokens.device.type, enabled=False):
        parts, matched = panel_losses(layers, true)
    rows, last = (matched.garments, matched.queries), layers[-1]
    panels = panels[rows]
    # Detached: moves and seams teach the tokens, not the first outlines.
    first = Predicted(*(getattr(last, name)[rows].detach() for name in Predicted.__dataclass_fields__))
    placed = _placed(first.contours, first.centres, first.rotations)
    moved, corners, features = decoder.outlines(panels, first.contours, first.corners, placed, tokens, matched.garments)
    with torch.autocast(tokens.device.type, enabled=False):
        outlines, shifts = _outline_losses(moved, corners, true, matched)
    placed = _placed(moved.detach(), first.centres, first.rotations)
    edges = _true_edges(true, matched, shifts)
    sewn = decoder.seams(edges, panels, moved.detach(), placed, features)
    with torch.autocast(tokens.device.type, enabled=False):
        parts |= {name: parts[name] + REFINED * part for name, part in outlines.items()}
        parts |= _seam_losses(sewn, true, edges.exists)
    return {name: WEIGHTS[name] * part for name, part in parts.items()}


def panel_losses(layers: list[Predicted], true: PanelTargets) -> tuple[dict[str, Tensor], Matched]:
    """Mean losses of the layers, and the match of queries and panels by the last layer, which holds for all."""
    matched = match_panels(layers[-1], true)
    parts = [_loss_of_layer(layer, true, matched) for layer in layers]
    return {name: torch.stack([part[name] for part in parts]).mean() for name in parts[0]}, matched


def match_panels(predicted: Predicted, true: PanelTargets) -> Matched:
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
    return Matched(*torch.from_numpy(np.concatenate(pairs, axis=1)).to(cost.device))


def _loss_of_layer(predicted: Predicted, true: PanelTargets, matched: Matched) -> dict[str, Tensor]:
    ours, theirs = (matched.garments, matched.queries), (matched.garments, matched.panels)
    exists = torch.zeros_like(predicted.exists)
    exists[ours] = 1.0
    outlines, _ = _outline_losses(predicted.contours[ours], predicted.corners[ours], true, matched)
    return {
        "exists": functional.binary_cross_entropy_with_logits(predicted.exists, exists),
        **outlines,
        "centres": functional.l1_loss(predicted.centres[ours], true.centres[theirs]),
        "rotations": functional.l1_loss(predicted.rotations[ours], true.rotations[theirs]),
        "edges": functional.cross_entropy(predicted.edges[ours], true.edge_counts[theirs]),
        "labels": functional.cross_entropy(predicted.labels[ours], true.labels[theirs]),
    }


def _outline_losses(
    contours: Float[Tensor, "m c 2"], corners: Float[Tensor, "m c"], true: PanelTargets, matched: Matched
) -> tuple[dict[str, Tensor], Int[Tensor, " m"]]:
    """Losses of outlines at their best cyclic shift, and the shifts.

    ``areas``: log(1 + d · perimeter / area), where d is the mean distance of the points: for small d about the share of
    the area that differs, so that a centimetre counts more for a cuff than for a skirt.
    """
    outlines = true.contours[matched.garments, matched.panels]
    shifts = _shifts(contours, outlines)
    true_corners = _rolled(true.corners[matched.garments, matched.panels][..., None], shifts)[..., 0]
    apart = contours - _rolled(outlines, shifts)
    distance = (apart.square().sum(dim=-1) + 1e-12).sqrt().mean(dim=-1)
    losses = {
        "contours": apart.abs().mean(),
        "areas": torch.log1p(distance * true.slimness[matched.garments, matched.panels]).mean(),
        "corners": functional.binary_cross_entropy_with_logits(corners, true_corners),
    }
    return losses, shifts


def _true_edges(true: PanelTargets, matched: Matched, shifts: Int[Tensor, " m"]) -> Edges:
    """The true edges, between the outline points that match their ends."""
    row_of = torch.zeros_like(true.exists, dtype=torch.long)
    row_of[matched.garments, matched.panels] = torch.arange(len(shifts), device=shifts.device)
    rows = row_of.gather(1, true.edge_panels.long().clamp(min=0))
    points = (true.edge_points.long() + shifts[rows][..., None]) % true.contours.shape[2]
    return Edges(rows, points, true.edge_panels >= 0)


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


# ---------------------------------------------------------------------------------------------------------- the answers


def answers_of(decoder: PanelDecoder, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
    """The predictions in the form of the targets, with the panels whose probability exceeds 1/2, at least one."""
    layers, panels = decoder(tokens)
    last = layers[-1]
    exists = (last.exists > 0) | (last.exists == last.exists.amax(dim=1, keepdim=True))
    rows = garments, _ = exists.nonzero(as_tuple=True)
    first = Predicted(*(getattr(last, name)[rows] for name in Predicted.__dataclass_fields__))
    placed = _placed(first.contours, first.centres, first.rotations)
    moved, corners, features = decoder.outlines(panels[rows], first.contours, first.corners, placed, tokens, garments)
    placed = _placed(moved, first.centres, first.rotations)
    edges = _likeliest_edges(first.edges, corners, exists, decoder.config.edges)
    sewn = decoder.seams(edges, panels[rows], moved, placed, features)
    partners = _partners(sewn.partners, edges.exists)
    mutual = partners.clamp(min=0)[..., None]
    labels = sewn.labels + torch.where(  # of both edges: sewn edges with different labels are a fault
        (partners >= 0)[..., None], sewn.labels.gather(1, mutual.expand_as(sewn.labels)), 0.0
    )
    contours = last.contours.clone()
    contours[rows] = moved
    queries = exists.nonzero()[:, 1]
    return PanelTargets(
        points=tokens.new_zeros(len(tokens), 0, 6),
        exists=exists,
        contours=contours,
        corners=last.corners,
        centres=last.centres,
        rotations=last.rotations,
        edge_counts=last.edges.argmax(dim=-1),
        labels=last.labels.argmax(dim=-1),
        slimness=torch.zeros_like(last.exists),
        edge_panels=torch.where(edges.exists, queries[edges.rows], -1),
        edge_points=edges.points,
        edge_kinds=(sewn.kinds > 0).long(),
        edge_labels=labels.argmax(dim=-1),
        partners=partners,
        turned=sewn.turned.gather(2, mutual)[..., 0] > 0,
    )


def _likeliest_edges(
    counts: Float[Tensor, "m n"], corners: Float[Tensor, "m c"], exists: Bool[Tensor, "b q"], room: int
) -> Edges:
    """The edges of each panel between its likeliest corners.

    Their number n maximises p(n) · the probability that the n likeliest points are corners and the others are not.
    """
    ranked = corners.sort(dim=-1, descending=True)
    yes = functional.pad(functional.logsigmoid(ranked.values).cumsum(dim=-1), (1, 0))
    no = functional.pad(functional.logsigmoid(-ranked.values).flip(-1).cumsum(dim=-1), (1, 0)).flip(-1)
    most = min(counts.shape[1], corners.shape[1] + 1)
    likelihood = counts.log_softmax(dim=-1)[:, :most] + (yes + no)[:, :most]
    likelihood[:, :LEAST_EDGES] = -torch.inf
    numbers = likelihood.argmax(dim=-1).tolist()
    panels = exists.sum(dim=1).tolist()
    rows, points = np.zeros((len(panels), room), np.int64), np.zeros((len(panels), room, 2), np.int64)
    known = np.zeros((len(panels), room), bool)
    order, row = ranked.indices.cpu().numpy(), 0
    for garment, count in enumerate(panels):
        filled = 0
        for _ in range(count):
            chosen = np.sort(order[row, : min(numbers[row], room - filled)])
            ends = slice(filled, filled + len(chosen))
            rows[garment, ends], known[garment, ends] = row, True
            points[garment, ends] = np.stack([chosen, np.roll(chosen, -1)], axis=1)
            filled, row = filled + len(chosen), row + 1
    return Edges(*(torch.from_numpy(array).to(corners.device) for array in (rows, points, known)))


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
