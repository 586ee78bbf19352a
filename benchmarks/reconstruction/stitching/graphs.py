"""Patterns as graphs of edges for stitch prediction: packed arrays of a set of patterns, and padded batches.

An edge is a row with points at equal distances along it, its length, its panel, the next edge of its loop and its ends
in space. Names, labels, kinds of curve, numbers of panels and starts of loops are left out: two files of one pattern
give the same rows, in another order. Loops run counter-clockwise as seen from the right side of the cloth.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from benchmarks.reconstruction.learners import uploaded
from gcd_dataset.curves import LINE, sample_curve
from gcd_dataset.records import EdgeRef, Panel, Pattern, Seam
from gcd_dataset.scoring.joining import MAX_CUTS
from gcd_dataset.tensors import require_closed

SAMPLES = 17  # points of an edge, both ends included
CUT_BINS = 24  # an edge has at most one in each
NO_CUT = -1.0
LEAST_AREA = 1e-3  # cm²: the centroid of a smaller panel is the mean of its points
ALIGNMENT = 8  # rows of a batch are a multiple: attention on a GPU needs aligned biases


@dataclass(frozen=True)
class EdgeGraph:
    """The edges of one pattern, in the order of its panels and their loops."""

    points: Float[np.ndarray, "e 17 2"]
    """About the centroid of the panel, seen from its right side [cm]."""
    lengths: Float[np.ndarray, " e"]
    """[cm]"""
    panels: Int[np.ndarray, " e"]
    following: Int[np.ndarray, " e"]
    """Row of the next edge of the loop."""
    partners: Int[np.ndarray, " e"]
    """Row of the edge that it is sewn to, -1 for none."""
    right_wrong: Bool[np.ndarray, " e"]
    cuts: Float[np.ndarray, "e 6"]
    """Shares of the length at which the edge is subdivided, in order; unused entries are -1."""


@dataclass(frozen=True)
class EdgeBatch:
    """Graphs padded to the same number of edges; ``panels`` is -1 for padding."""

    points: Float[Tensor, "b e 17 2"]
    lengths: Float[Tensor, "b e"]
    panels: Int[Tensor, "b e"]
    following: Int[Tensor, "b e"]
    partners: Int[Tensor, "b e"]
    right_wrong: Bool[Tensor, "b e"]
    cuts: Float[Tensor, "b e 6"]

    @property
    def valid(self) -> Bool[Tensor, "b e"]:
        """Rows that are edges."""
        return self.panels >= 0

    def __len__(self) -> int:
        return len(self.panels)

    def to(self, device: torch.device) -> "EdgeBatch":
        return EdgeBatch(*(getattr(self, field.name).to(device) for field in fields(self)))

    def select(self, rows: Int[Tensor, " r"] | slice) -> "EdgeBatch":
        """Some of the graphs."""
        return EdgeBatch(*(getattr(self, field.name)[rows] for field in fields(self)))

    def permuted(self, order: Int[Tensor, "b e"]) -> "EdgeBatch":
        """The rows in another order: new row k is the old row ``order[k]``."""
        new_row = torch.empty_like(order).scatter_(1, order, torch.arange(order.shape[1]).expand_as(order).to(order))

        def moved(values: Tensor) -> Tensor:
            index = order.view(*order.shape, *[1] * (values.ndim - 2)).expand(*order.shape, *values.shape[2:])
            return values.gather(1, index)

        def renamed(rows: Tensor) -> Tensor:
            return torch.where(rows >= 0, new_row.gather(1, rows.clamp(min=0)), rows)

        changed = {field.name: moved(getattr(self, field.name)) for field in fields(self)}
        changed |= {name: renamed(changed[name]) for name in ("following", "partners")}
        return EdgeBatch(**changed)


class PackedGraphs:
    """The graphs of many patterns as flat tensors on one device; ``graphs[rows]`` is a padded batch.

    The numbers of edges are on the CPU, and so are rows: nothing waits for the device.
    """

    def __init__(self, counts: Int[Tensor, " n"], with_cuts: Bool[Tensor, " n"], flat: Mapping[str, Tensor]) -> None:
        """``counts``: number of edges of each graph; ``with_cuts``: whether some of them are to be subdivided."""
        self.counts, self.with_cuts, self.flat = counts, with_cuts, dict(flat)
        self.first = counts.cumsum(0) - counts

    @property
    def device(self) -> torch.device:
        """The device of the edges."""
        return self.flat["panels"].device

    @staticmethod
    def of(graphs: Sequence[EdgeGraph]) -> "PackedGraphs":
        """At least one graph."""
        flat = {
            field.name: torch.from_numpy(np.concatenate([getattr(graph, field.name) for graph in graphs]))
            for field in fields(EdgeGraph)
        }
        with_cuts = torch.tensor([bool((graph.cuts >= 0).any()) for graph in graphs])
        return PackedGraphs(torch.tensor([len(graph.lengths) for graph in graphs]), with_cuts, flat)

    def to(self, device: torch.device) -> "PackedGraphs":
        return PackedGraphs(self.counts, self.with_cuts, {name: flat.to(device) for name, flat in self.flat.items()})

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, rows: Int[Tensor, " b"]) -> EdgeBatch:
        first, counts = (uploaded(values[rows], self.device) for values in (self.first, self.counts))
        return self.padded(first, counts, aligned(int(self.counts[rows].max())))

    def padded(self, first: Int[Tensor, " b"], counts: Int[Tensor, " b"], width: int) -> EdgeBatch:
        """Graphs of ``counts`` edges from the flat rows ``first`` on; both are on the device of the edges."""
        columns = torch.arange(width, device=self.device)
        there = columns < counts[:, None]
        index = torch.where(there, first[:, None] + columns, 0)
        values = {name: flat[index] for name, flat in self.flat.items()}
        for name in ("panels", "partners"):
            values[name] = torch.where(there, values[name], -1)
        values["following"] = torch.where(there, values["following"], columns)
        return EdgeBatch(**values)


def aligned(count: int) -> int:
    """The number of rows of a batch for ``count`` edges."""
    return -(-count // ALIGNMENT) * ALIGNMENT


def edge_refs(pattern: Pattern) -> list[EdgeRef]:
    """The edge of each row of the pattern's graph."""
    return [EdgeRef(panel.name, edge) for panel in pattern.panels for edge in range(len(panel.edges))]


def graph_of(pattern: Pattern, cuts: Mapping[EdgeRef, Sequence[float]] | None = None) -> EdgeGraph:
    """The graph of a pattern; ``cuts``: shares of the length at which edges are subdivided.

    Raises ``PatternError`` for an open outline or an arc that does not span its chord.
    """
    refs = edge_refs(pattern)
    row_of = {ref: row for row, ref in enumerate(refs)}
    sizes = [len(panel.edges) for panel in pattern.panels]
    first = np.cumsum([0, *sizes[:-1]])
    following = [start + np.roll(np.arange(size), -1) for start, size in zip(first, sizes, strict=True)]
    partners, wrong = np.full(len(refs), -1), np.zeros(len(refs), bool)
    for seam in pattern.seams:
        left, right = row_of[seam.left], row_of[seam.right]
        partners[left], partners[right] = right, left
        wrong[[left, right]] = seam.right_wrong
    shares = np.full((len(refs), MAX_CUTS), NO_CUT, np.float32)
    for ref, values in (cuts or {}).items():
        shares[row_of[ref], : len(values)] = values
    return EdgeGraph(
        points=np.concatenate([_outline(panel) for panel in pattern.panels]).astype(np.float32),
        lengths=np.concatenate([panel.edge_lengths() for panel in pattern.panels]).astype(np.float32),
        panels=np.repeat(np.arange(len(sizes)), sizes),
        following=np.concatenate(following),
        partners=partners,
        right_wrong=wrong,
        cuts=shares,
    )


def with_seams(pattern: Pattern, pairs: Sequence[tuple[int, int, bool]]) -> Pattern:
    """The pattern with seams between rows of its graph; the flag says ``right_wrong``."""
    refs = edge_refs(pattern)
    return replace(pattern, seams=tuple(Seam(refs[left], refs[right], wrong) for left, right, wrong in pairs))


def _outline(panel: Panel) -> Float[np.ndarray, "e 17 2"]:
    """Points of the edges about the centroid, from the right side [cm]."""
    require_closed(panel)
    shares = np.linspace(0, 1, SAMPLES)[:, None]
    edges = []
    for index, edge in enumerate(panel.edges):
        start, end = panel.edge_ends(index)
        straight = edge.curve == LINE
        edges.append((1 - shares) * start + shares * end if straight else sample_curve(start, end, edge.curve, SAMPLES))
    points = np.array(edges)
    middle = points.mean(axis=(0, 1))
    x, y = (points[:, :-1] - middle).reshape(-1, 2).T
    crossed = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = 0.5 * crossed.sum()
    moments = [((v + np.roll(v, -1)) * crossed).sum() / 6 for v in (x, y)]
    centroid = middle + np.array(moments) / area if abs(area) > LEAST_AREA else middle
    return (points - centroid) * [np.copysign(1.0, area), 1.0]


SMALLER = 0.75  # share of a batch, of the fewest edges, that is computed apart from the others
LEAST_APART = 16  # garments of a batch that is computed in parts


@dataclass(frozen=True, slots=True)
class Part:
    """Garments of a batch that are computed together."""

    rows: int
    given: int
    """Number of garments, the first ones, that may be given seams."""
    width: int
    """Edges to which they are padded."""


def parts_of(counts: Int[Tensor, " b"], shares: Float[Tensor, " b"]) -> tuple[Part, ...]:
    """The parts that fit a batch: its smaller garments, and the others. ``shares``: of the seams that are given."""
    order = counts.argsort()
    apart = [int(SMALLER * len(order))] if len(order) >= LEAST_APART else []
    chunks = order.tensor_split(apart)
    return tuple(Part(len(c), int((shares[c] > 0).sum()), aligned(int(counts[c].max()))) for c in chunks)


def ordered(parts: Sequence[Part], counts: Int[Tensor, " b"], shares: Float[Tensor, " b"]) -> Int[Tensor, " b"]:
    """The garments of a batch in the order of its parts, within a part by decreasing share."""
    chunks = torch.split(counts.argsort(), [part.rows for part in parts])
    return torch.cat([chunk[shares[chunk].argsort(descending=True)] for chunk in chunks])
