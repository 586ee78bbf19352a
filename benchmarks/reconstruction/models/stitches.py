"""A network from the panels of a pattern to its stitches (task T3), independent of order, names and starts of loops.

Edges of all panels are the tokens of a transformer whose attention is biased by relations of pairs: same panel, next in
the loop, ratio of lengths, likeness of curves, angles that meet. Each edge chooses a partner or stays free. Identical
panels make the choice ambiguous: front and back of a skirt may be exchanged, but not for one seam only. The network is
therefore trained with some of the true seams given, those that it is surest of, and predicts in rounds: confident seams
of the best matching are fixed first, and of equally likely seams one; the next round is given the fixed seams. The
boundary of the partly sewn garment is a relation too: two edges that meet where a seam ends are often sewn next.

Seams between one long edge and several edges become pairs once the long edge is subdivided: a second head predicts the
points of subdivision (``cuts``), which then move to agree with the lengths of the edges sewn to the parts.

``StitchConfig.autosew()`` is the baseline: GraphSAGE over the loops, Sinkhorn, one round (AutoSew, WACV 2026).
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import networkx
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.garments import Arrays, GarmentSet, pattern_of
from benchmarks.reconstruction.learners import Learner, uploaded
from benchmarks.reconstruction.stitching.gluing import glued
from benchmarks.reconstruction.stitching.graphs import (
    MAX_CUTS,
    SAMPLES,
    EdgeBatch,
    EdgeGraph,
    PackedGraphs,
    edge_refs,
    graph_of,
    with_seams,
)
from benchmarks.reconstruction.stitching.merging import Cuts, aligned, merged, needed, split, subdivided
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import EdgeRef, Pattern

__all__ = [
    "SMOKE",
    "USUAL",
    "StitchBatch",
    "StitchConfig",
    "StitchExamples",
    "StitchLearner",
    "StitchNet",
    "Subdivision",
    "build",
    "greedy_by_length",
    "sew",
]

USUAL: Mapping[str, Any] = {"batch": 256, "lr": 8e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {"steps": 240, "batch": 8, "lr": 1.5e-3, "ema": 0.98, "log_every": 20}
SMALL: Mapping[str, Any] = {"width": 64, "heads": 4, "layers": 3, "pair_width": 24}
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""

Stitch = tuple[int, int, bool]
"""Two rows of a graph, and whether the seam is ``right_wrong``."""

NEVER = -1e4  # logit of an impossible pair; finite, since rows of padding have no possible pair
USUAL_LENGTH = 20.0  # cm
PLACED_UNIT = 50.0  # cm
LOOP_STEPS = 3  # neighbours in the loop that are told apart, each way
WIDTHS = (0.003, 0.01, 0.03, 0.1, 0.3)  # scales on which differences are compared
WAVES = 4
SEAMS_AT_CORNER = 4  # most seams that end in a corner of the partly sewn garment
RARE = -8.0  # logit of a cut at first: one bin in some thousands has one
LEAST = 1e-3  # probability of a seam that may be predicted
CUT_BINS = 24  # an edge has at most one cut in each
WEIGHTS = {"pairs": 1.0, "right_wrong": 0.1, "cuts": 0.2, "cut_offsets": 1.0}
SIZES = 0.1  # standard deviation of the logarithm of a garment's size in training
MISPLACED = 0.02  # standard deviation of the points at which training garments are subdivided again, by length
VARIANTS = (0.5, 0.75)  # shares of the training garments up to which they are as drawn, and with joined edges
MOST_FOREIGN = 0.25  # largest share of the fourth variant, which takes the place of the third
SPREAD = 0.5  # range of the random numbers that vary the order in which seams are given
SUBDIVIDED = 0.1  # share of the seams that are cut in two in the third variant
FOREIGN_SHARES = (0.2, 0.4, 0.7)  # shares of the edges that are subdivided in the fourth variant, one by chance
GLUED = 0.7  # share of the straight seams in the fourth variant whose panels become one
FOREIGN_CUTS = 2  # most cuts of a seam in the fourth variant
PARTS = 4  # a batch is computed in parts of garments of like size: less padding
REVISIONS = 3  # most times that needless points of subdivision are taken back
ALIGNED = 0.04  # a cut moves by at most this share of the length to agree with the lengths that are sewn to it


@dataclass(frozen=True, slots=True)
class StitchConfig:
    """Sizes and parts of a ``StitchNet``."""

    width: int = 256
    heads: int = 8
    layers: int = 8
    pair_width: int = 48
    encoder: str = "attention"
    """``attention``, or ``sage``: mean over the neighbours in the loop."""
    sinkhorn: int = 0
    """Iterations; 0 for a softmax over each edge's choices."""
    temperature: float = 1.0
    """Of the Sinkhorn iterations."""
    relations: bool = True
    """Whether pairs are scored by their relations, too."""
    rounds: int = 24
    """Most rounds of a prediction; 1 predicts all seams at once, and trains without given seams."""
    confident: float = 0.7
    """Probability of the seams that are fixed together in a round."""
    placed: bool = False
    """Whether the network sees the placement of the panels in space (variant B)."""
    foreign: float = 0.0
    """Share of the training garments that are subdivided as another source might, at most 0.25."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.foreign <= MOST_FOREIGN:
            raise ConfigError(f"foreign is {self.foreign}: give a share between 0 and {MOST_FOREIGN}")

    @property
    def variety(self) -> int:
        """Variants of a training garment."""
        return 4 if self.foreign else 3

    @staticmethod
    def autosew(*, placed: bool = False) -> "StitchConfig":
        """The baseline: five GraphSAGE layers of 512, 128 features for the scores, 100 iterations at 0.4."""
        return StitchConfig(
            width=512, layers=5, pair_width=128, encoder="sage", sinkhorn=100, temperature=0.4, relations=False,
            rounds=1, placed=placed,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Subdivision:
    """How the points are chosen at which edges are subdivided."""

    logit: float = 0.0
    """Points of a greater log-odds are taken."""
    revised: bool = False
    """Whether points that separate no two seams are taken back, after which all seams are predicted again."""


@dataclass(frozen=True)
class Scores:
    """Logits of a round."""

    pairs: Float[Tensor, "b e e"]
    """Symmetric."""
    free: Float[Tensor, "b e"]
    right_wrong: Float[Tensor, "b e e"]
    cuts: Float[Tensor, "b e bins"]
    """That a bin of the edge contains a point of subdivision."""
    cut_offsets: Float[Tensor, "b e bins"]
    """Position within the bin, in [0, 1]."""

    def log_probabilities(self, config: StitchConfig) -> Float[Tensor, "b e e+1"]:
        """Of each choice of each edge; the last is to stay free."""
        pairs, free = self.pairs.float(), self.free.float()
        if not config.sinkhorn:
            return torch.cat([pairs, free[..., None]], dim=-1).log_softmax(dim=-1)
        pairs, free = pairs / config.temperature, free / config.temperature
        potential = torch.zeros_like(free)
        for _ in range(config.sinkhorn):  # the scaling of a symmetric matrix is one vector
            total = torch.cat([pairs + potential[:, None], free[..., None]], dim=-1).logsumexp(dim=-1)
            potential = 0.5 * (potential - total)
        chosen = pairs + potential[:, None] + potential[..., None]
        return torch.cat([chosen, (free + potential)[..., None]], dim=-1)


class StitchNet(nn.Module):
    """Edges, and the seams known so far, to ``Scores``."""

    def __init__(self, config: StitchConfig) -> None:
        super().__init__()
        self.config, width = config, config.width
        n_features, n_relations = _sizes(config)
        self.enter = _mlp(n_features, width, width)
        self.sewn = nn.Embedding(2, width)
        if config.encoder == "sage":
            self.sage = nn.ModuleList(nn.Linear(2 * width, width) for _ in range(config.layers))
        else:
            self.blocks = nn.ModuleList(_Block(width, config.heads) for _ in range(config.layers))
            self.relate = nn.Sequential(
                nn.Linear(n_relations, config.pair_width), nn.GELU(), nn.Linear(config.pair_width, config.pair_width),
                nn.GELU(),
            )  # fmt: skip
            self.bias = nn.Linear(config.pair_width, config.heads * config.layers)
        self.norm = nn.LayerNorm(width)
        self.key = nn.Linear(width, 128)
        self.free = nn.Linear(width, 1)
        self.cut = _mlp(width, width, 2 * CUT_BINS)
        nn.init.constant_(self.cut[2].bias[:CUT_BINS], RARE)  # type: ignore[index]
        if config.relations:
            self.side = nn.Linear(width, config.pair_width)
            self.judge = _mlp(config.pair_width, config.pair_width, 2)

    def forward(self, batch: EdgeBatch, known: Int[Tensor, "b e"]) -> Scores:
        """``known``: partners of the edges that are already sewn, -1 for the others."""
        config, valid = self.config, batch.valid
        shapes = _Shapes.of(batch)
        edges = self.enter(shapes.features(config)) + self.sewn((known >= 0).long())
        related: Tensor | None = None
        if config.encoder == "sage":
            back = _inverse(batch.following)
            for layer in self.sage:
                around = 0.5 * (_rows(edges, batch.following) + _rows(edges, back))
                edges = functional.normalize(functional.gelu(layer(torch.cat([edges, around], dim=-1))), dim=-1)
        else:
            related = self.relate(shapes.relations(config, known))
            biases = self.bias(related).unflatten(-1, (config.layers, config.heads)).permute(3, 0, 4, 1, 2)
            biases = (biases + torch.where(valid, 0.0, NEVER)[None, :, None, None, :].to(biases)).contiguous()
            for block, bias in zip(self.blocks, biases, strict=True):
                edges = block(edges, bias)
        return self._scores(self.norm(edges), related, valid, known)

    def _scores(self, edges: Tensor, related: Tensor | None, valid: Tensor, known: Tensor) -> Scores:
        with torch.autocast(edges.device.type, enabled=False):  # bfloat16 would round logits to steps of 0.1
            keys = self.key(edges.float())
            pairs = keys @ keys.transpose(1, 2) / math.sqrt(keys.shape[-1])
        wrong = torch.zeros_like(pairs)
        if related is not None and self.config.relations:
            sides = self.side(edges)
            judged = self.judge(functional.gelu(sides[:, :, None] + sides[:, None] + related))
            judged = judged + judged.transpose(1, 2)
            pairs, wrong = pairs + judged[..., 0], judged[..., 1]
        possible = valid & (known < 0)
        itself = torch.eye(pairs.shape[1], dtype=torch.bool, device=pairs.device)
        allowed = possible[:, :, None] & possible[:, None] & ~itself
        cuts, offsets = self.cut(edges).chunk(2, dim=-1)
        return Scores(
            pairs=torch.where(allowed, pairs.float(), NEVER),
            free=self.free(edges)[..., 0].float(),
            right_wrong=wrong.float(),
            cuts=cuts.float(),
            cut_offsets=offsets.float().sigmoid(),
        )


class _Block(nn.Module):
    """A transformer layer whose attention has a bias for each pair."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norms = nn.ModuleList([nn.LayerNorm(width), nn.LayerNorm(width)])
        self.project = nn.Linear(width, 3 * width)
        self.merge = nn.Linear(width, width)
        self.feed = _mlp(width, 4 * width, width)

    def forward(self, edges: Tensor, bias: Tensor) -> Tensor:
        parts = self.project(self.norms[0](edges)).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        query, key, value = parts.unbind(0)
        seen = functional.scaled_dot_product_attention(query, key, value, attn_mask=bias.to(query.dtype))
        edges = edges + self.merge(seen.transpose(1, 2).flatten(2))
        return edges + self.feed(self.norms[1](edges))


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.GELU(), nn.Linear(hidden, outputs))


# ------------------------------------------------------------------------------------------------------------- geometry


@dataclass(frozen=True)
class _Shapes:
    """Measures of the edges that do not change when a panel is moved or turned, or the edges reordered."""

    batch: EdgeBatch
    log_length: Float[Tensor, "b e"]
    forward: Float[Tensor, "b e k"]
    """Points along the edge, in the frame of its chord, by length."""
    backward: Float[Tensor, "b e k"]
    """The same of the reversed edge."""
    bend: Float[Tensor, "b e"]
    """Total turn between the ends [rad]."""
    corners: Float[Tensor, "b e 2"]
    """Turn of the outline at start and end [rad]."""

    @staticmethod
    def of(batch: EdgeBatch) -> "_Shapes":
        points, lengths = batch.points, batch.lengths.clamp(min=1e-2)
        steps = points.diff(dim=2)
        turns = _turn(steps[:, :, :-1], steps[:, :, 1:])
        first = -3 * points[:, :, 0] + 4 * points[:, :, 1] - points[:, :, 2]
        last = 3 * points[:, :, -1] - 4 * points[:, :, -2] + points[:, :, -3]
        at_end = _turn(last, _rows(first, batch.following))
        at_start = _rows(at_end[..., None], _inverse(batch.following))[..., 0]
        return _Shapes(
            batch=batch,
            log_length=(lengths / USUAL_LENGTH).log(),
            forward=_profile(points, lengths),
            backward=_profile(points.flip(2), lengths),
            bend=turns.sum(dim=-1),
            corners=torch.stack([at_start, at_end], dim=-1),
        )

    def features(self, config: StitchConfig) -> Float[Tensor, "b e f"]:
        """What the network sees of each edge."""
        batch = self.batch
        x, y = batch.points.unbind(-1)
        area = self._of_panel(0.5 * (x[..., :-1] * y[..., 1:] - x[..., 1:] * y[..., :-1]).sum(-1)).abs().clamp(min=1e-2)
        perimeter = self._of_panel(batch.lengths).clamp(min=1e-2)
        count = self._of_panel(torch.ones_like(batch.lengths))
        middle, chord = batch.points[:, :, SAMPLES // 2], batch.points[:, :, -1] - batch.points[:, :, 0]
        size = area.sqrt()
        around = (self.log_length, self.bend)
        neighbours = [_rows(torch.stack(around, -1), rows) for rows in (batch.following, _inverse(batch.following))]
        waves = self.log_length[..., None] * 2.0 ** torch.arange(WAVES, device=x.device)
        inputs = [
            torch.stack([self.log_length, self.bend, (size / USUAL_LENGTH).log(), (perimeter / USUAL_LENGTH).log(),
                         count / 8, size / perimeter, batch.lengths / perimeter, middle.norm(dim=-1) / size,
                         _cross(middle, chord) / size / batch.lengths.clamp(min=1e-2)], dim=-1),
            self.corners.sin(), self.corners.cos(), waves.sin(), waves.cos(), self.forward, *neighbours,
        ]  # fmt: skip
        if config.placed:
            inputs.append(_waves(batch.placed.flatten(2) / PLACED_UNIT))
        return torch.cat(inputs, dim=-1)

    def relations(self, config: StitchConfig, known: Int[Tensor, "b e"]) -> Float[Tensor, "b e e r"]:
        """What the network sees of each pair."""
        batch = self.batch
        same = batch.panels[:, :, None] == batch.panels[:, None]
        hops, row = [], torch.arange(same.shape[1], device=same.device).expand_as(known)
        for _ in range(LOOP_STEPS):
            row = batch.following.gather(1, row)
            hops.append(_one_hot(row))
        meeting = _one_hot(next_on_boundary(batch.following, known))
        sewn = _one_hot(known.clamp(min=0)) * (known >= 0)[..., None]
        difference = self.log_length[:, :, None] - self.log_length[:, None]
        alike = torch.cdist(self.forward, self.backward)
        flip = 1.0 - 2.0 * (torch.arange(self.forward.shape[-1], device=alike.device) % 2)
        mirrored_alike = torch.cdist(self.forward, self.backward * flip)
        start, end = self.corners.unbind(-1)
        meet = [start[:, :, None] + end[:, None], end[:, :, None] + start[:, None]]
        parts = [
            same.float(), *hops, *(hop.transpose(1, 2) for hop in hops), meeting, meeting.transpose(1, 2), sewn,
            difference.clamp(-3, 3), *_near(difference), *_near(alike), *_near(mirrored_alike),
            *(angle.sin() for angle in meet), *(angle.cos() for angle in meet),
        ]  # fmt: skip
        if config.placed:
            first, middle, last = (batch.placed[:, :, k] / PLACED_UNIT for k in range(3))
            gaps = [torch.cdist(first, last), torch.cdist(last, first), torch.cdist(middle, middle)]
            gaps.append(torch.cdist(first, first) + torch.cdist(last, last))
            parts += [*gaps, *(near for gap in gaps for near in _near(gap))]
        return torch.stack(parts, dim=-1)

    def _of_panel(self, values: Float[Tensor, "b e"]) -> Float[Tensor, "b e"]:
        """The sum over each edge's panel."""
        panels = self.batch.panels.clamp(min=0)
        values = torch.where(self.batch.valid, values, 0.0)
        return torch.zeros_like(values).scatter_add_(1, panels, values).gather(1, panels)


def _sizes(config: StitchConfig) -> tuple[int, int]:
    """Number of features of an edge, and of a pair."""
    profile = 2 * ((SAMPLES - 1) // 2)
    placed = 9 * (2 * WAVES + 1) if config.placed else 0
    gaps = 4 * (1 + len(WIDTHS)) if config.placed else 0
    return 9 + 4 + 2 * WAVES + profile + 4 + placed, 1 + 2 * LOOP_STEPS + 3 + 1 + 3 * len(WIDTHS) + 4 + gaps


def _profile(points: Float[Tensor, "b e n 2"], lengths: Float[Tensor, "b e"]) -> Float[Tensor, "b e k"]:
    chord = points[:, :, -1] - points[:, :, 0]
    along = functional.normalize(chord, dim=-1)[:, :, None]
    across = torch.stack([-along[..., 1], along[..., 0]], dim=-1)
    offsets = (points[:, :, 1::2] - points[:, :, :1]) / lengths[..., None, None]
    return torch.stack([(offsets * along).sum(-1), (offsets * across).sum(-1)], dim=-1).flatten(2)


def _mirrored(points: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
    """The points with negative x."""
    return torch.cat([-points[..., :1], points[..., 1:]], dim=-1)


def _turn(before: Tensor, after: Tensor) -> Tensor:
    """Angle from one direction to another [rad]."""
    return torch.atan2(_cross(before, after), (before * after).sum(-1))


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _near(difference: Tensor) -> list[Tensor]:
    return [torch.exp(-((difference / width) ** 2)) for width in WIDTHS]


def _waves(values: Tensor) -> Tensor:
    octaves = (values[..., None] * 2.0 ** torch.arange(WAVES, device=values.device)).flatten(-2)
    return torch.cat([values, octaves.sin(), octaves.cos()], dim=-1)


def _rows(values: Float[Tensor, "b e k"], rows: Int[Tensor, "b e"]) -> Float[Tensor, "b e k"]:
    return values.gather(1, rows[..., None].expand(*rows.shape, values.shape[-1]))


def _one_hot(rows: Int[Tensor, "b e"]) -> Float[Tensor, "b e e"]:
    return functional.one_hot(rows, rows.shape[1]).float()


def _inverse(following: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """Row of the edge before."""
    rows = torch.arange(following.shape[1], device=following.device).expand_as(following)
    return torch.empty_like(following).scatter_(1, following, rows)


def next_on_boundary(following: Int[Tensor, "b e"], known: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The unsewn edge that starts where each edge ends, once the known seams are sewn (start meets end)."""
    row = following
    for _ in range(SEAMS_AT_CORNER):
        partner = known.gather(1, row)
        row = torch.where(partner >= 0, following.gather(1, partner.clamp(min=0)), row)
    return row


# --------------------------------------------------------------------------------------------------------- the training


def mirrored(batch: EdgeBatch, chosen: Bool[Tensor, " b"]) -> EdgeBatch:
    """The chosen garments as their mirror images: points, loops and cuts run the other way."""
    one, two = chosen[:, None], chosen[:, None, None]
    flipped = _mirrored(batch.points.flip(2))
    space = _mirrored(batch.placed.flip(2))
    turned = torch.where(batch.cuts >= 0, 1 - batch.cuts, batch.cuts)
    return replace(
        batch,
        points=torch.where(two[..., None], flipped, batch.points),
        placed=torch.where(two[..., None], space, batch.placed),
        following=torch.where(one, _inverse(batch.following), batch.following),
        cuts=torch.where(two, turned, batch.cuts),
    )


def scaled(batch: EdgeBatch, factors: Float[Tensor, " b"]) -> EdgeBatch:
    """The garments in other sizes."""
    wide = factors[:, None, None, None]
    return replace(
        batch, points=batch.points * wide, placed=batch.placed * wide, lengths=batch.lengths * factors[:, None]
    )


def revealed(
    batch: EdgeBatch, shares: Float[Tensor, " b"], sure: Float[Tensor, "b e"], draw: Float[Tensor, "b e"]
) -> Int[Tensor, "b e"]:
    """Partners of a share of the true seams of each garment, -1 for the others.

    Seams of a high probability ``sure`` come first, as in a prediction; ``draw``, from [0, 1), varies their order.
    """
    partners = batch.partners
    sewn, partner = partners >= 0, partners.clamp(min=0)
    sure = 0.5 * (sure + sure.gather(1, partner))
    varied = SPREAD * torch.minimum(draw, draw.gather(1, partner))
    place = torch.where(sewn, varied - sure, torch.inf).argsort(dim=1).argsort(dim=1)
    shown = sewn & (place < shares[:, None] * sewn.sum(dim=1, keepdim=True))
    return torch.where(shown & shown.gather(1, partner), partners, -1)


def stitch_loss(
    scores: Scores, batch: EdgeBatch, known: Int[Tensor, "b e"], config: StitchConfig
) -> dict[str, tuple[Tensor, Tensor]]:
    """Sums and counts of the loss terms by name.

    An edge without a partner in a garment with joined edges may be sewn to several: its choice is not counted.
    """
    valid, partners = batch.valid, batch.partners
    whole = (batch.cuts >= 0).flatten(1).any(dim=1)
    asked = valid & (known < 0) & (~whole[:, None] | (partners >= 0))
    choices = scores.log_probabilities(config)
    target = torch.where(partners >= 0, partners, choices.shape[-1] - 1)
    chosen = -choices.gather(2, target[..., None])[..., 0]
    logits = scores.right_wrong.gather(2, partners.clamp(min=0)[..., None])[..., 0]
    turned = functional.binary_cross_entropy_with_logits(logits, batch.right_wrong.float(), reduction="none")
    bins, there = _cut_bins(batch.cuts)
    heat = torch.zeros_like(scores.cuts).scatter_reduce_(2, bins, there.float(), "amax")
    cut = functional.binary_cross_entropy_with_logits(scores.cuts, heat, reduction="none").sum(-1)
    missed = (scores.cut_offsets.gather(2, bins) - (batch.cuts * CUT_BINS - bins)).abs()
    return {
        "pairs": _sum(chosen, asked),
        "right_wrong": _sum(turned, asked & (partners >= 0)),
        "cuts": (torch.where(valid, cut, 0.0).sum(), there.sum()),  # few edges have cuts: a mean over all would vanish
        "cut_offsets": _sum(missed, there & valid[..., None]),
    }


def _cut_bins(cuts: Float[Tensor, "b e c"]) -> tuple[Int[Tensor, "b e c"], Bool[Tensor, "b e c"]]:
    return (cuts * CUT_BINS).long().clamp(0, CUT_BINS - 1), cuts >= 0


def _sum(values: Tensor, where: Tensor) -> tuple[Tensor, Tensor]:
    return torch.where(where, values, 0.0).sum(), where.sum()


@dataclass(frozen=True)
class StitchBatch:
    """Garments in parts of like size, with what the network is told of each part."""

    parts: tuple[EdgeBatch, ...]
    shares: tuple[Float[Tensor, " b"], ...]
    """Share of the seams that are given."""
    draws: tuple[Float[Tensor, "b e"], ...]
    """Random numbers in [0, 1) that vary which."""
    patterns: tuple[Pattern, ...]
    """The garments' panels, in the order of the request, without seams; empty for batches drawn by chance."""


@dataclass(frozen=True)
class StitchExamples:
    """Garments in variants: as drawn; with joined edges; parted again; and, if asked for, as of another source.

    In the third variant, edges that were joined are parted again at slightly wrong points, as they are where the points
    are predicted, and some seams are cut in two. In the fourth, many seams are runs of edges, unsewn edges are
    subdivided too, and panels that a straight seam joins are one.
    """

    graphs: PackedGraphs
    """As many rows for each garment as there are variants."""
    arrays: tuple[Arrays, ...]
    """The garments' patterns."""
    config: StitchConfig

    def __len__(self) -> int:
        return len(self.arrays)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> StitchBatch:
        """Garments as drawn; with ``chance`` in a variant, mirrored, in another size, with a part of the seams."""
        device = self.graphs.counts.device
        at = uploaded(rows, device)
        if chance is None:
            part = self.graphs[self.config.variety * at]
            patterns = tuple(replace(pattern_of(self.arrays[row]), seams=()) for row in rows.tolist())
            return StitchBatch(
                (part,), (torch.zeros(len(at), device=device),), (torch.zeros_like(part.lengths),), patterns
            )
        seed = int(torch.randint(2**62, (1,), generator=chance))
        there = torch.Generator(device).manual_seed(seed)  # as many numbers on each rank: for all, not for these rows
        kind, flip, share = torch.rand(3, len(self), generator=there, device=device)[:, at]
        sizes = torch.exp(SIZES * torch.randn(len(self), generator=there, device=device))[at]
        draw = torch.rand(len(self.graphs.flat["panels"]), generator=there, device=device)
        limits = (*VARIANTS, 1 - self.config.foreign)
        kinds = torch.stack([kind > limit for limit in limits]).sum(dim=0)  # a tensor of limits would be uploaded
        variants = self.config.variety * at + kinds
        order = self.graphs.counts[variants].argsort()
        parts, shares, draws = [], [], []
        for chunk in order.chunk(PARTS) if len(order) >= 4 * PARTS else (order,):
            part = scaled(mirrored(self.graphs[variants[chunk]], flip[chunk] < 0.5), sizes[chunk])
            alone = (part.cuts >= 0).flatten(1).any(dim=1) | (self.config.rounds == 1)
            parts.append(part)
            shares.append(torch.where(alone, 0.0, (2 * share[chunk] - 1).clamp(min=0)))
            draws.append(self.graphs.padded(draw, variants[chunk]))
        return StitchBatch(tuple(parts), tuple(shares), tuple(draws), ())


class StitchLearner(Learner[StitchBatch, Pattern]):
    """Panels to a pattern with seams (task T3)."""

    def __init__(self, config: StitchConfig, *, subdivide: bool = False) -> None:
        super().__init__()
        self.net = StitchNet(config)
        self.subdivide = subdivide
        """Whether ``predict`` may subdivide edges."""

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> StitchExamples:
        """The graphs of the garments and of their variants."""
        return self.examples([garments.arrays(k) for k in range(len(garments))], device=device, workers=workers)

    def examples(self, patterns: Sequence[Arrays], *, device: torch.device, workers: int = 0) -> StitchExamples:
        """The graphs of patterns, given as arrays, and of their variants."""
        jobs = [(number, arrays, self.net.config.foreign > 0) for number, arrays in enumerate(patterns)]
        if workers > 1:
            with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
                found = list(pool.map(_variants, jobs, chunksize=32))
        else:
            found = [_variants(job) for job in jobs]
        graphs = [graph for variants in found for graph in variants]
        return StitchExamples(PackedGraphs.of(graphs).to(device), tuple(patterns), self.net.config)

    def loss(self, batch: StitchBatch) -> dict[str, Tensor]:
        """Negative log-likelihood of the partners, of the side and of the points of subdivision."""
        terms = []
        for part, shares, draw in zip(batch.parts, batch.shares, batch.draws, strict=True):
            known = self._given(part, shares, draw)
            terms.append(stitch_loss(self.net(part, known), part, known, self.net.config))
        totals = {
            name: [torch.stack(column) for column in zip(*(t[name] for t in terms), strict=True)] for name in WEIGHTS
        }
        return {
            name: WEIGHTS[name] * values.sum() / counts.sum().clamp(min=1) for name, (values, counts) in totals.items()
        }

    @torch.no_grad()
    def _given(self, part: EdgeBatch, shares: Float[Tensor, " b"], draw: Float[Tensor, "b e"]) -> Int[Tensor, "b e"]:
        """The seams that the network is given: first those that it finds most likely when none is given."""
        known = torch.full_like(part.partners, -1)
        rows = (shares > 0).nonzero()[:, 0]
        if len(rows):
            some = _of_rows(part, rows)
            choices = self.net(some, known[rows]).log_probabilities(self.net.config)
            sure = choices.gather(2, some.partners.clamp(min=0)[..., None])[..., 0].exp()
            known[rows] = revealed(some, shares[rows], sure, draw[rows])
        return known

    def predict(self, batch: StitchBatch) -> list[Pattern]:
        """The patterns with seams, and with subdivided edges where ``subdivide`` allows them."""
        return sew(self.net, batch.patterns, subdivide=Subdivision() if self.subdivide else None)


def build(*, smoke: bool, options: Mapping[str, Any]) -> StitchLearner:
    """The learner; ``options``: fields of ``StitchConfig``. Raises ``ConfigError`` for others."""
    given = {**(SMALL if smoke else {}), **options}
    unknown = set(given) - set(StitchConfig.__dataclass_fields__)
    if unknown:
        raise ConfigError(
            f"no size {min(unknown)} of a stitch network: choose of {', '.join(StitchConfig.__dataclass_fields__)}"
        )
    return StitchLearner(StitchConfig(**given))


def _variants(job: tuple[int, Arrays, bool]) -> list[EdgeGraph]:
    """Graphs of a pattern: as drawn, with joined edges, subdivided elsewhere, and as of another source."""
    number, arrays, with_foreign = job
    pattern, rng = pattern_of(arrays), np.random.default_rng(number)
    joined, again = merged(pattern, rng), pattern
    graphs = [graph_of(pattern)] * 2
    if joined is not None:
        graphs[1] = graph_of(joined.pattern, joined.cuts)
        moved = {
            ref: np.sort(np.clip(np.array(cuts) + MISPLACED * rng.standard_normal(len(cuts)), 0.01, 0.99)).tolist()
            for ref, cuts in joined.cuts.items()
        }
        again = replace(split(joined.pattern, moved), seams=joined.parts.seams)
    graphs.append(graph_of(subdivided(again, rng, share=SUBDIVIDED)))
    if not with_foreign:
        return graphs
    share = float(rng.choice(FOREIGN_SHARES))
    foreign = subdivided(pattern, rng, share=share, most=FOREIGN_CUTS, free=True)
    graphs.append(glued(graph_of(foreign), rng, share=GLUED))
    return graphs


# ------------------------------------------------------------------------------------------------------- the prediction


@torch.no_grad()
def sew(
    net: StitchNet,
    patterns: Sequence[Pattern],
    *,
    subdivide: Subdivision | None = None,
    rounds: int = 0,
    batch: int = 64,
    seed: int = 0,
) -> list[Pattern]:
    """The patterns with predicted seams instead of their own.

    ``rounds``: most rounds, 0 for those of the configuration. ``subdivide``: how edges are subdivided, for seams that
    join one edge to several; ``None``: no edge is. Rows are shuffled by ``seed``, so that the order of panels, or of
    the edges in a loop, cannot help; it breaks ties between equally likely seams.
    """
    bare = [replace(pattern, seams=()) for pattern in patterns]
    if subdivide is None:
        return _sewn(net, bare, rounds, batch, seed)
    cuts: list[dict[EdgeRef, tuple[float, ...]]] = []
    for first in range(0, len(bare), batch):
        some = bare[first : first + batch]
        found = predict_cuts(
            net,
            PackedGraphs.of([graph_of(pattern) for pattern in some]).to(_device(net))[torch.arange(len(some))],
            logit=subdivide.logit,
        )
        cuts += [
            {ref: tuple(own[row]) for row, ref in enumerate(edge_refs(pattern)) if row in own}
            for pattern, own in zip(some, found, strict=True)
        ]
    parts = _sewn(net, [split(pattern, own) for pattern, own in zip(bare, cuts, strict=True)], rounds, batch, seed)
    for _ in range(REVISIONS if subdivide.revised else 0):
        fewer = [needed(*three) for three in zip(bare, cuts, parts, strict=True)]
        changed = [k for k, own in enumerate(fewer) if own != cuts[k]]
        if not changed:
            break
        again = _sewn(net, [split(bare[k], fewer[k]) for k in changed], rounds, batch, seed)
        cuts = fewer
        for k, pattern in zip(changed, again, strict=True):
            parts[k] = pattern
    return [_moved(*three) for three in zip(bare, cuts, parts, strict=True)]


def _moved(pattern: Pattern, cuts: Cuts, parts: Pattern) -> Pattern:
    """The subdivided pattern with cuts that agree with the lengths of the seams, where they nearly do."""
    better = {
        ref: tuple(new if abs(new - old) < ALIGNED else old for new, old in zip(own, cuts[ref], strict=True))
        for ref, own in aligned(pattern, cuts, parts).items()
    }
    return replace(split(pattern, better), seams=parts.seams)


def _sewn(net: StitchNet, patterns: Sequence[Pattern], rounds: int, batch: int, seed: int) -> list[Pattern]:
    graphs = PackedGraphs.of([graph_of(pattern) for pattern in patterns]).to(_device(net))
    chance = torch.Generator().manual_seed(seed)
    found: dict[int, Pattern] = {}
    for rows in torch.split(graphs.counts.argsort(), batch):
        part = graphs[rows]
        order = torch.rand(part.panels.shape, generator=chance).argsort(dim=1).to(rows.device)
        stitches = predict_stitches(net, part.permuted(order), rounds)
        for row, own, places in zip(rows.tolist(), stitches, order.tolist(), strict=True):
            found[row] = with_seams(patterns[row], [(places[left], places[right], w) for left, right, w in own])
    return [found[row] for row in range(len(patterns))]


def _device(net: nn.Module) -> torch.device:
    return next(net.parameters()).device


@torch.no_grad()
def predict_stitches(net: StitchNet, batch: EdgeBatch, rounds: int = 0) -> list[list[tuple[int, int, bool]]]:
    """Rows of the edges of each stitch, and whether it is ``right_wrong``."""
    config, rounds = net.config, rounds or net.config.rounds
    known = torch.full_like(batch.partners, -1)
    wrong = torch.zeros_like(batch.right_wrong)
    open_rows = np.arange(len(batch))
    for number in range(rounds):
        rows = torch.from_numpy(open_rows).to(known.device)
        part = batch if len(rows) == len(batch) else _of_rows(batch, rows)
        scores = net(part, known[rows])
        choices = scores.log_probabilities(config).cpu().double().numpy()
        turned = (scores.right_wrong > 0).cpu().numpy()
        partners, flags, still = known[rows].cpu().numpy(), wrong[rows].cpu().numpy(), []
        for at, row in enumerate(open_rows.tolist()):
            is_last = number == rounds - 1
            pairs = _best_matching(choices[at]) if is_last else _fixed(choices[at], config.confident)
            if pairs and not is_last:
                still.append(row)
            for left, right in pairs:
                partners[at, [left, right]] = right, left
                flags[at, [left, right]] = turned[at, left, right]
        known[rows] = torch.from_numpy(partners).to(known)
        wrong[rows] = torch.from_numpy(flags).to(wrong)
        open_rows = np.array(still, int)
        if not still:
            break
    return [
        [(left, right, flags[left]) for left, right in enumerate(row) if right > left]
        for row, flags in zip(known.tolist(), wrong.tolist(), strict=True)
    ]


def _of_rows(batch: EdgeBatch, rows: Int[Tensor, " r"]) -> EdgeBatch:
    return EdgeBatch(*(value[rows] for value in vars(batch).values()))


def _fixed(logs: Float[np.ndarray, "e e+1"], confident: float) -> list[tuple[int, int]]:
    """The pairs of the best matching that a round fixes: the confident ones, else the likeliest one."""
    pairs = _best_matching(logs)
    chance = {(left, right): 0.5 * (logs[left, right] + logs[right, left]) for left, right in pairs}
    sure = [pair for pair in pairs if chance[pair] > math.log(confident)]
    return sure or sorted(pairs, key=lambda pair: -chance[pair])[:1]


def _best_matching(logs: Float[np.ndarray, "e e+1"]) -> list[tuple[int, int]]:
    """The pairs of greatest total log-odds against staying free; each edge at most once."""
    free = logs[:, -1]
    mutual = 0.5 * (logs[:, :-1] + logs[:, :-1].T)
    gain = mutual - 0.5 * (free[:, None] + free)
    graph = networkx.Graph()
    for left, right in zip(*np.nonzero(np.triu((gain > 0) & (mutual > math.log(LEAST)), 1)), strict=True):
        graph.add_edge(int(left), int(right), weight=float(gain[left, right]))
    return sorted((min(pair), max(pair)) for pair in networkx.max_weight_matching(graph))


def predict_cuts(net: StitchNet, batch: EdgeBatch, *, logit: float = 0.0) -> list[dict[int, list[float]]]:
    """Shares of the length at which edges are subdivided, by row, for each garment: those above a log-odds."""
    scores = net(batch, torch.full_like(batch.partners, -1))
    logits, offsets = (scores.cuts - logit).cpu().numpy(), scores.cut_offsets.cpu().numpy()
    valid = batch.valid.cpu().numpy()
    found: list[dict[int, list[float]]] = []
    for garment in range(len(batch)):
        cuts: dict[int, list[float]] = {}
        for row in np.flatnonzero(valid[garment] & (logits[garment].max(axis=1) > 0)).tolist():
            peaks = _peaks(logits[garment, row])
            cuts[row] = [(peak + float(offsets[garment, row, peak])) / CUT_BINS for peak in peaks]
        found.append(cuts)
    return found


def _peaks(logits: Float[np.ndarray, " bins"]) -> list[int]:
    """Bins that contain a cut; of two neighbours the likelier."""
    around = np.pad(logits, 1, constant_values=-np.inf)
    peak = (logits > 0) & (logits > around[:-2]) & (logits >= around[2:])
    strongest = sorted(np.flatnonzero(peak).tolist(), key=lambda at: -logits[at])[:MAX_CUTS]
    return sorted(strongest)


def greedy_by_length(batch: EdgeBatch) -> list[list[tuple[int, int, bool]]]:
    """The baseline without learning: the two free edges closest in length are sewn, until they differ by over 10 %."""
    found = []
    for lengths, valid in zip(batch.lengths.cpu().double().numpy(), batch.valid.cpu().numpy(), strict=True):
        logs = np.log(lengths[valid].clip(1e-6))
        left, right = np.triu_indices(len(logs), 1)
        difference = np.abs(logs[left] - logs[right])
        used, stitches = set[int](), []
        for at in np.argsort(difference, kind="stable").tolist():
            one, other = int(left[at]), int(right[at])
            if difference[at] > math.log(1.1):
                break
            if not used & {one, other}:
                used |= {one, other}
                stitches.append((one, other, False))
        found.append(stitches)
    return found
