"""A network from the panels of a pattern to its stitches (task T3), independent of order, names and starts of loops.

Edges of all panels are the tokens of a transformer whose attention is biased by relations of pairs: same panel, next in
the loop, ratio of lengths, likeness of curves, angles that meet. Each edge chooses a partner or stays free. Identical
panels make the choice ambiguous: front and back of a skirt may be exchanged, but not for one seam only. The network is
therefore trained with some of the true seams given, those that it is surest of, and predicts in rounds: confident seams
of the best matching are fixed first, and of equally likely seams one; the next round is given the fixed seams. The
boundary of the partly sewn garment is a relation too: two edges that meet where a seam ends are often sewn next.

Seams between one long edge and several edges become pairs once the long edge is subdivided: a second head predicts the
points of subdivision (``cuts``), which then move to agree with the lengths of the edges sewn to the parts.
"""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.garments import Arrays, GarmentSet, Split, pattern_of
from benchmarks.reconstruction.learners import Examples, Learner, sizes_from, uploaded
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.stitching.edge_shapes import EdgeInputs, edges_before, feature_counts
from benchmarks.reconstruction.stitching.evaluation import tables
from benchmarks.reconstruction.stitching.graphs import (
    CUT_BINS,
    EdgeBatch,
    EdgeGraph,
    PackedGraphs,
    Part,
    fixed_parts,
    graph_of,
    ordered,
    parts_of,
    shares_above,
)
from benchmarks.reconstruction.stitching.merging import glued, merged, split, subdivided
from benchmarks.reconstruction.stitching.sewing import Subdivision, sew
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Pattern
from gcd_dataset.workers import parallel_map

TASKS = ("T3",)
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 8e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {"steps": 240, "batch": 8, "lr": 1.5e-3, "ema": 0.98, "log_every": 20}
SMALL: Mapping[str, Any] = {"width": 64, "heads": 4, "layers": 3, "pair_width": 24}
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""

NEVER = -1e4  # logit of an impossible pair; finite, since rows of padding have no possible pair
RARE = -8.0  # logit of a cut at first: one bin in some thousands has one
WEIGHTS = {"pairs": 1.0, "right_wrong": 0.1, "cuts": 0.2, "cut_offsets": 1.0}
SIZES = 0.1  # standard deviation of the logarithm of a garment's size in training
MISPLACED = 0.02  # standard deviation of the points at which training garments are subdivided again, by length
VARIANTS = (0.5, 0.75)  # shares of the training garments up to which they are as drawn, and with joined edges
LEAST = {"foreign": 0}  # sizes; 1 for others
MOST_FOREIGN = 0.25  # largest share of the fourth variant, which takes the place of the third
SPREAD = 0.5  # range of the random numbers that vary the order in which seams are given
SUBDIVIDED = 0.1  # share of the seams that are cut in two in the third variant
FOREIGN_SHARES = (0.2, 0.4, 0.7)  # shares of the edges that are subdivided in the fourth variant, one by chance
GLUED = 0.7  # share of the straight seams in the fourth variant whose panels become one
FOREIGN_CUTS = 2  # most cuts of a seam in the fourth variant


@dataclass(frozen=True, slots=True)
class StitchConfig:
    """Sizes and parts of a ``StitchNet``."""

    width: int = 256
    heads: int = 8
    layers: int = 8
    pair_width: int = 48
    rounds: int = 24
    """Most rounds of a prediction; 1 predicts all seams at once, and trains without given seams."""
    confident: float = 0.7
    """Probability of the seams that are fixed together in a round."""
    foreign: float = 0.0
    """Share of the training garments that are subdivided as another source might, at most 0.25."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.foreign <= MOST_FOREIGN:
            raise ConfigError(f"foreign is {self.foreign}: give a share between 0 and {MOST_FOREIGN}")

    @property
    def variety(self) -> int:
        """Variants of a training garment."""
        return 4 if self.foreign else 3


@dataclass(frozen=True)
class StitchLogits:
    """Logits of a round."""

    pairs: Float[Tensor, "b e e"]
    """Symmetric."""
    free: Float[Tensor, "b e"]
    right_wrong: Float[Tensor, "b e e"]
    cuts: Float[Tensor, "b e bins"]
    """Logits: does a bin of the edge contain a point of subdivision?"""
    cut_offsets: Float[Tensor, "b e bins"]
    """Position within the bin, in [0, 1]."""

    def log_probabilities(self) -> Float[Tensor, "b e e+1"]:
        """Log-probability of each partner of each edge; the last column: no partner."""
        return torch.cat([self.pairs.float(), self.free.float()[..., None]], dim=-1).log_softmax(dim=-1)


class StitchNet(nn.Module):
    """Edges, and the seams known so far, to ``StitchLogits``."""

    def __init__(self, config: StitchConfig) -> None:
        super().__init__()
        self.config, width = config, config.width
        n_features, n_relations = feature_counts()
        self.enter = _mlp(n_features, width, width)
        self.sewn = nn.Embedding(2, width)
        self.blocks = nn.ModuleList(_Block(width, config.heads) for _ in range(config.layers))
        self.relate = nn.Sequential(*_mlp(n_relations, config.pair_width, config.pair_width), nn.GELU())
        self.bias = nn.Linear(config.pair_width, config.heads * config.layers)
        self.norm = nn.LayerNorm(width)
        self.key = nn.Linear(width, 128)
        self.free = nn.Linear(width, 1)
        self.cut = _mlp(width, width, 2 * CUT_BINS)
        nn.init.constant_(self.cut[2].bias[:CUT_BINS], RARE)  # type: ignore[index]
        self.side = nn.Linear(width, config.pair_width)
        self.judge = _mlp(config.pair_width, config.pair_width, 2)

    def forward(self, batch: EdgeBatch, known: Int[Tensor, "b e"]) -> StitchLogits:
        """``known``: partners of the edges that are already sewn, -1 for the others."""
        return self.scores(self.inputs(batch), known)

    def inputs(self, batch: EdgeBatch) -> EdgeInputs:
        """The network's inputs that do not depend on the known seams."""
        return EdgeInputs.of(batch)

    def scores(self, seen: EdgeInputs, known: Int[Tensor, "b e"]) -> StitchLogits:
        """The scores of a batch, given its ``inputs``."""
        config, valid = self.config, seen.valid
        # A lookup in a table of two rows; its gradient needs no sort.
        edges = self.enter(seen.edges) + torch.where((known >= 0)[..., None], *self.sewn.weight.flip(0))
        related = self.relate(seen.relations(known))
        biases = self.bias(related).unflatten(-1, (config.layers, config.heads)).permute(3, 0, 4, 1, 2)
        biases = (biases + torch.where(valid, 0.0, NEVER)[None, :, None, None, :].to(biases)).contiguous()
        for block, bias in zip(self.blocks, biases, strict=True):
            edges = block(edges, bias)
        return self._scores(self.norm(edges), related, valid, known)

    def _scores(self, edges: Tensor, related: Tensor, valid: Tensor, known: Tensor) -> StitchLogits:
        with torch.autocast(edges.device.type, enabled=False):  # bfloat16 would round logits to steps of 0.1
            keys = self.key(edges.float())
            pairs = keys @ keys.transpose(1, 2) / math.sqrt(keys.shape[-1])
        sides = self.side(edges)
        judged = self.judge(functional.gelu(sides[:, :, None] + sides[:, None] + related))
        judged = judged + judged.transpose(1, 2)
        pairs, wrong = pairs + judged[..., 0], judged[..., 1]
        possible = valid & (known < 0)
        itself = torch.eye(pairs.shape[1], dtype=torch.bool, device=pairs.device)
        allowed = possible[:, :, None] & possible[:, None] & ~itself
        cuts, offsets = self.cut(edges).chunk(2, dim=-1)
        return StitchLogits(
            pairs=torch.where(allowed, pairs.float(), NEVER),
            free=self.free(edges)[..., 0].float(),
            right_wrong=wrong.float(),
            cuts=cuts.float(),
            cut_offsets=offsets.float().sigmoid(),
        )


class _Block(nn.Module):
    """A transformer layer with an attention bias for each pair."""

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


# --------------------------------------------------------------------------------------------------------- the training


def mirrored(batch: EdgeBatch, chosen: Bool[Tensor, " b"]) -> EdgeBatch:
    """The chosen garments as their mirror images: points, loops and cuts run the other way."""
    one, two = chosen[:, None], chosen[:, None, None]
    flipped = _mirrored(batch.points.flip(2))
    turned = torch.where(batch.cuts >= 0, 1 - batch.cuts, batch.cuts)
    return replace(
        batch,
        points=torch.where(two[..., None], flipped, batch.points),
        following=torch.where(one, edges_before(batch.following), batch.following),
        cuts=torch.where(two, turned, batch.cuts),
    )


def scaled(batch: EdgeBatch, factors: Float[Tensor, " b"]) -> EdgeBatch:
    """The garments in other sizes."""
    wide = factors[:, None, None, None]
    return replace(batch, points=batch.points * wide, lengths=batch.lengths * factors[:, None])


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


def edge_noise(seeds: Int[Tensor, " r"], count: int) -> Float[Tensor, "r e"]:
    """Random numbers in [0, 1) for each of the seeds, which are below 2**31; a hash, the same on every device."""
    mixed = seeds[:, None] + 0x9E3779B1 * torch.arange(1, count + 1, device=seeds.device) & 0xFFFFFFFF
    for _ in range(2):  # https://nullprogram.com/blog/2018/07/31
        mixed = ((mixed >> 16) ^ mixed) * 0x45D9F3B & 0xFFFFFFFF
    return (((mixed >> 16) ^ mixed) >> 8).float() / 2**24


def stitch_loss(scores: StitchLogits, batch: EdgeBatch, known: Int[Tensor, "b e"]) -> dict[str, tuple[Tensor, Tensor]]:
    """Sums and counts of the loss terms by name.

    An edge without a partner in a garment with joined edges may be sewn to several: its choice is not counted.
    """
    valid, partners = batch.valid, batch.partners
    whole = (batch.cuts >= 0).flatten(1).any(dim=1)
    asked = valid & (known < 0) & (~whole[:, None] | (partners >= 0))
    choices = scores.log_probabilities()
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


def _mirrored(points: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
    """The points with negative x."""
    return torch.cat([-points[..., :1], points[..., 1:]], dim=-1)


def _cut_bins(cuts: Float[Tensor, "b e c"]) -> tuple[Int[Tensor, "b e c"], Bool[Tensor, "b e c"]]:
    return (cuts * CUT_BINS).long().clamp(0, CUT_BINS - 1), cuts >= 0


def _sum(values: Tensor, where: Tensor) -> tuple[Tensor, Tensor]:
    return torch.where(where, values, 0.0).sum(), where.sum()


@dataclass(frozen=True)
class StitchBatch:
    """Garments of a set in the order of the parts, their changes, and the seams that are given.

    The edges are looked up in a step: then preparing a batch takes little time, and a recorded step does the rest.
    """

    graphs: PackedGraphs
    """All graphs of the set."""
    parts: tuple[Part, ...]
    patterns: tuple[Pattern, ...]
    """The garments' panels, in the order of the request, without seams; empty for batches drawn by chance."""
    first: Int[Tensor, " b"]
    """Flat row of the first edge of each garment."""
    counts: Int[Tensor, " b"]
    """Number of edges; 0 for a garment that is left out."""
    flips: Bool[Tensor, " b"]
    """Garments that are mirrored."""
    sizes: Float[Tensor, " b"]
    """Factors of the garments' sizes."""
    shares: Float[Tensor, " b"]
    """Share of the seams that are given; 0 or less for none."""
    seeds: Int[Tensor, " b"]
    """Seeds of the random choice of the given seams."""

    def edges(self, rows: slice, part: Part) -> EdgeBatch:
        """The edges of a part, whose garments are these rows."""
        found = self.graphs.padded(self.first[rows], self.counts[rows], part.width)
        return scaled(mirrored(found, self.flips[rows]), self.sizes[rows])


@dataclass(frozen=True)
class StitchExamples:
    """Garments in variants: as drawn; with joined edges; parted again; and, if asked for, as of another source.

    In the third variant, edges that were joined are parted again at slightly wrong points, as they are where the points
    are predicted, and some seams are cut in two. In the fourth, many seams are runs of edges, unsewn edges are
    subdivided too, and panels that a straight seam joins are one.
    """

    graphs: PackedGraphs
    """One row per variant of each garment."""
    arrays: tuple[Arrays, ...]
    """The garments' patterns."""
    config: StitchConfig
    one_shape: bool = False
    """Whether all batches of a number of rows have one shape, as recorded steps need.

    A batch with more large garments than there is room for, one in a million, leaves some out.
    """

    def __len__(self) -> int:
        return len(self.arrays)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> StitchBatch:
        """Garments as drawn; with ``chance`` in a variant, mirrored, in another size, with a part of the seams."""
        if chance is None:
            patterns = tuple(replace(pattern_of(self.arrays[row]), seams=()) for row in rows.tolist())
            unchanged, ones = torch.zeros(len(rows), dtype=torch.long), torch.ones(len(rows))
            return self._batch(self.config.variety * rows, unchanged > 0, ones, 0 * ones, unchanged, patterns)
        # As many numbers on each rank: for all garments, not for these rows.
        kind, flip, share = torch.rand(3, len(self), generator=chance)[:, rows]
        sizes = torch.exp(SIZES * torch.randn(len(self), generator=chance))[rows]
        seeds = torch.randint(2**31, (len(self),), generator=chance)[rows]
        limits = torch.tensor(self._chances).cumsum(0)[:-1]
        variants = self.config.variety * rows + (kind > limits[:, None]).sum(dim=0)
        shares = torch.where(self.graphs.with_cuts[variants] | (self.config.rounds == 1), 0.0, 2 * share - 1)
        return self._batch(variants, flip < 0.5, sizes, shares, seeds, ())

    def _batch(
        self,
        variants: Int[Tensor, " b"],
        flips: Bool[Tensor, " b"],
        sizes: Float[Tensor, " b"],
        shares: Float[Tensor, " b"],
        seeds: Int[Tensor, " b"],
        patterns: tuple[Pattern, ...],
    ) -> StitchBatch:
        """The batch of graphs and their changes, in the order of its parts, on the device."""
        first, counts = self.graphs.first[variants], self.graphs.counts[variants]
        parts = self._fixed_parts(len(variants)) if self.one_shape else parts_of(counts, shares)
        order = ordered(parts, counts, shares)
        widths = torch.tensor([part.width for part in parts for _ in range(part.rows)])
        counts[order] = torch.where(counts[order] <= widths, counts[order], 0)
        columns = (first, counts, flips, sizes, shares, seeds)
        return StitchBatch(
            self.graphs, parts, patterns, *(uploaded(column[order], self.graphs.device) for column in columns)
        )

    def _fixed_parts(self, rows: int) -> tuple[Part, ...]:
        return fixed_parts(rows, self._above, garments=len(self), is_given=self.config.rounds > 1)

    @property
    def _chances(self) -> list[float]:
        """Probability of each variant."""
        limits = [0.0, *VARIANTS, *([1 - self.config.foreign] if self.config.foreign else []), 1.0]
        return [high - low for low, high in pairwise(limits)]

    @functools.cached_property
    def _above(self) -> tuple[float, ...]:
        return shares_above(self.graphs.counts.view(len(self), -1), self._chances)


class StitchLearner(Learner[StitchBatch, Pattern]):
    """Panels to a pattern with seams (task T3)."""

    is_recordable = True

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
        graphs = [graph for variants in parallel_map(_variants, jobs, workers) for graph in variants]
        return StitchExamples(PackedGraphs.of(graphs).to(device), tuple(patterns), self.net.config)

    def of_one_shape(self, examples: Examples[StitchBatch]) -> StitchExamples:
        """The examples in batches of fixed parts."""
        assert isinstance(examples, StitchExamples)
        return replace(examples, one_shape=True)

    def loss(self, batch: StitchBatch) -> dict[str, Tensor]:
        """Negative log-likelihood of the partners, of the side and of the points of subdivision."""
        terms, begin = [], 0
        for part in batch.parts:
            rows = slice(begin, begin := begin + part.rows)
            edges = batch.edges(rows, part)
            seen = self.net.inputs(edges)
            known = self._given(seen, edges, part.given, batch.shares[rows], batch.seeds[rows])
            found = stitch_loss(self.net.scores(seen, known), edges, known)
            terms.append(torch.stack([torch.stack(found[name]) for name in WEIGHTS]))
        sums, counts = torch.stack(terms).sum(dim=0).unbind(-1)
        means = (sums / counts.clamp(min=1)).unbind()
        return {name: weight * mean for (name, weight), mean in zip(WEIGHTS.items(), means, strict=True)}

    @torch.no_grad()
    def _given(
        self, seen: EdgeInputs, edges: EdgeBatch, count: int, shares: Float[Tensor, " b"], seeds: Int[Tensor, " b"]
    ) -> Int[Tensor, "b e"]:
        """The seams that the network is given: first those that it finds most likely when none is given.

        ``count``: most garments, the first ones, that are given some.
        """
        known = torch.full_like(edges.partners, -1)
        if not count:
            return known
        some = edges.select(slice(count))
        choices = self.net.scores(seen.first(count), known[:count]).log_probabilities()
        sure = choices.gather(2, some.partners.clamp(min=0)[..., None])[..., 0].exp()
        torch.clear_autocast_cache()  # weights that were cast here would get no gradient
        known[:count] = revealed(some, shares[:count], sure, edge_noise(seeds[:count], sure.shape[1]))
        return known

    def predict(self, batch: StitchBatch) -> list[Pattern]:
        """The patterns with seams, and with subdivided edges where ``subdivide`` allows them."""
        return sew(self.net, batch.patterns, subdivide=Subdivision() if self.subdivide else None)

    def tables(self, split: Split, config: Config, out: Path, *, workers: int) -> dict[str, Any]:
        """The scores of seams: one to one, n to m, by kind, of other patterns (``stitching.evaluation``)."""
        found = tables(self.net, split, out, workers=workers, examples=config.examples)
        return {"arguments": {**asdict(config), **asdict(self.net.config)}, **found}


def build(config: Mapping[str, Any]) -> StitchLearner:
    """The learner; ``config``: fields of ``StitchConfig``. Raises ``ConfigError`` for others."""
    sizes, _ = sizes_from("stitches", StitchConfig, config, least=LEAST, heads={"width": "heads"})
    return StitchLearner(sizes)


def _variants(job: tuple[int, Arrays, bool]) -> list[EdgeGraph]:
    """Variants of a pattern's graph: as drawn, edges joined, subdivided elsewhere, subdivided like another source."""
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
