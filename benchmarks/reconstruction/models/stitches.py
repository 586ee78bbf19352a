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

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from benchmarks.reconstruction.garments import Arrays, GarmentSet, Split, pattern_of
from benchmarks.reconstruction.learners import Learner, sizes_from, uploaded
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.stitching.edge_shapes import EdgeInputs
from benchmarks.reconstruction.stitching.evaluation import tables
from benchmarks.reconstruction.stitching.graphs import (
    EdgeBatch,
    EdgeGraph,
    PackedGraphs,
    Part,
    graph_of,
    ordered,
    parts_of,
)
from benchmarks.reconstruction.stitching.losses import edge_noise, mirrored, revealed, scaled, stitch_loss
from benchmarks.reconstruction.stitching.merging import glued, merged, split, subdivided
from benchmarks.reconstruction.stitching.net import StitchConfig, StitchNet
from benchmarks.reconstruction.stitching.sewing import sew
from gcd_dataset.records import Pattern
from gcd_dataset.workers import parallel_map

TASKS = ("T3",)
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 8e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {"steps": 240, "batch": 8, "lr": 1.5e-3, "ema": 0.98, "log_every": 20}
SMALL: Mapping[str, Any] = {"width": 64, "heads": 4, "layers": 3, "pair_width": 24}
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""

WEIGHTS = {"pairs": 1.0, "right_wrong": 0.1, "cuts": 0.2, "cut_offsets": 1.0}
SIZES = 0.1  # standard deviation of the logarithm of a garment's size in training
MISPLACED = 0.02  # standard deviation of the points at which training garments are subdivided again, by length
VARIANTS = (0.5, 0.75)  # shares of the training garments up to which they are as drawn, and with joined edges
LEAST = {"foreign": 0}  # sizes; 1 for others
SUBDIVIDED = 0.1  # share of the seams that are cut in two in the third variant
FOREIGN_SHARES = (0.2, 0.4, 0.7)  # shares of the edges that are subdivided in the fourth variant, one by chance
GLUED = 0.7  # share of the straight seams in the fourth variant whose panels become one
FOREIGN_CUTS = 2  # most cuts of a seam in the fourth variant


@dataclass(frozen=True)
class StitchBatch:
    """Garments of a set in the order of the parts, their changes, and the seams that are given.

    The edges are looked up in a step.
    """

    graphs: PackedGraphs
    """All graphs of the set."""
    parts: tuple[Part, ...]
    patterns: tuple[Pattern, ...]
    """The garments' panels, in the order of the request, without seams; empty for batches drawn by chance."""
    first: Int[Tensor, " b"]
    """Flat row of the first edge of each garment."""
    counts: Int[Tensor, " b"]
    """Number of edges."""
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
        parts = parts_of(counts, shares)
        order = ordered(parts, counts, shares)
        columns = (first, counts, flips, sizes, shares, seeds)
        return StitchBatch(
            self.graphs, parts, patterns, *(uploaded(column[order], self.graphs.device) for column in columns)
        )

    @property
    def _chances(self) -> list[float]:
        """Probability of each variant."""
        limits = [0.0, *VARIANTS, *([1 - self.config.foreign] if self.config.foreign else []), 1.0]
        return [high - low for low, high in pairwise(limits)]


class StitchLearner(Learner[StitchBatch, Pattern]):
    """Panels to a pattern with seams (task T3)."""

    def __init__(self, config: StitchConfig) -> None:
        super().__init__()
        self.net = StitchNet(config)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> StitchExamples:
        """The graphs of the garments and of their variants."""
        return self.examples([garments.arrays(k) for k in range(len(garments))], device=device, workers=workers)

    def examples(self, patterns: Sequence[Arrays], *, device: torch.device, workers: int = 0) -> StitchExamples:
        """The graphs of patterns, given as arrays, and of their variants."""
        jobs = [(number, arrays, self.net.config.foreign > 0) for number, arrays in enumerate(patterns)]
        graphs = [graph for variants in parallel_map(_variants, jobs, workers) for graph in variants]
        return StitchExamples(PackedGraphs.of(graphs).to(device), tuple(patterns), self.net.config)

    def compile_parts(self) -> None:
        for block in self.net.blocks:
            block.compile(dynamic=True)

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
        """The patterns with seams."""
        return sew(self.net, batch.patterns)

    def tables(self, split: Split, config: Config, out: Path, *, workers: int) -> dict[str, Any]:
        """The scores of seams: one to one, n to m, by kind (``stitching.evaluation``)."""
        found = tables(self.net, split, out, workers=workers)
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
