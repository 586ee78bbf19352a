"""The seams of patterns, as a ``StitchNet`` predicts them in rounds, and the points at which it subdivides edges."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import networkx
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from torch import nn

from benchmarks.reconstruction.stitching.graphs import (
    CUT_BINS,
    EdgeBatch,
    PackedGraphs,
    edge_refs,
    graph_of,
    with_seams,
)
from benchmarks.reconstruction.stitching.merging import Cuts, aligned, needed, split
from benchmarks.reconstruction.stitching.placing import placed
from gcd_dataset.records import Pattern
from gcd_dataset.scoring.joining import MAX_CUTS

if TYPE_CHECKING:
    from benchmarks.reconstruction.stitching.net import StitchNet

BATCH = 64  # patterns at once
LEAST = 1e-3  # probability of a seam that may be predicted
REVISIONS = 3  # most times that needless points of subdivision are taken back
ALIGNED = 0.04  # a cut moves by at most this share of the length to agree with the lengths that are sewn to it


@torch.no_grad()
def sew(net: "StitchNet", patterns: Sequence[Pattern], *, cuts_above: float | None = None) -> list[Pattern]:
    """The patterns with predicted seams instead of their own; of panels of equal shape, those close in space are sewn.

    ``cuts_above``: edges are subdivided at points of a greater log-odds, for seams that join one edge to several;
    points that then separate no two seams are taken back, and the seams predicted again. ``None``: no edge is
    subdivided. Rows are shuffled, so that the order of panels, or of the edges in a loop, cannot help; it breaks ties
    between equally likely seams.
    """
    bare = [replace(pattern, seams=()) for pattern in patterns]
    if cuts_above is None:
        return [placed(pattern, {}, answer) for pattern, answer in zip(patterns, _sewn(net, bare), strict=True)]
    cuts = _cuts_of(net, bare, cuts_above)
    parts = _sewn(net, [split(pattern, own) for pattern, own in zip(bare, cuts, strict=True)])
    for _ in range(REVISIONS):
        fewer = [needed(*three) for three in zip(bare, cuts, parts, strict=True)]
        changed = [k for k, own in enumerate(fewer) if own != cuts[k]]
        if not changed:
            break
        again = _sewn(net, [split(bare[k], fewer[k]) for k in changed])
        cuts = list(fewer)
        for k, pattern in zip(changed, again, strict=True):
            parts[k] = pattern
    return [_moved(*three) for three in zip(bare, cuts, parts, strict=True)]


def _cuts_of(net: "StitchNet", patterns: Sequence[Pattern], logit: float) -> list[Cuts]:
    """The predicted points of subdivision of a greater log-odds."""
    cuts: list[Cuts] = []
    for first in range(0, len(patterns), BATCH):
        some = patterns[first : first + BATCH]
        graphs = PackedGraphs.of([graph_of(pattern) for pattern in some]).to(_device(net))
        found = predict_cuts(net, graphs[torch.arange(len(some))], logit=logit)
        cuts += [
            {ref: tuple(own[row]) for row, ref in enumerate(edge_refs(pattern)) if row in own}
            for pattern, own in zip(some, found, strict=True)
        ]
    return cuts


def _moved(pattern: Pattern, cuts: Cuts, parts: Pattern) -> Pattern:
    """The subdivided pattern with cuts that agree with the lengths of the seams, where they nearly do; placed."""
    better = {
        ref: tuple(new if abs(new - old) < ALIGNED else old for new, old in zip(own, cuts[ref], strict=True))
        for ref, own in aligned(pattern, cuts, parts).items()
    }
    return placed(pattern, better, replace(split(pattern, better), seams=parts.seams))


def _sewn(net: "StitchNet", patterns: Sequence[Pattern]) -> list[Pattern]:
    if not patterns:
        return []
    graphs = PackedGraphs.of([graph_of(pattern) for pattern in patterns]).to(_device(net))
    chance = torch.Generator().manual_seed(0)
    found: dict[int, Pattern] = {}
    for rows in torch.split(graphs.counts.argsort(), BATCH):
        part = graphs[rows]
        order = torch.rand(part.panels.shape, generator=chance).argsort(dim=1).to(part.panels.device)
        stitches = predict_stitches(net, part.permuted(order))
        for row, own, places in zip(rows.tolist(), stitches, order.tolist(), strict=True):
            found[row] = with_seams(patterns[row], [(places[left], places[right], w) for left, right, w in own])
    return [found[row] for row in range(len(patterns))]


def _device(net: nn.Module) -> torch.device:
    return next(net.parameters()).device


@torch.no_grad()
def predict_stitches(net: "StitchNet", batch: EdgeBatch) -> list[list[tuple[int, int, bool]]]:
    """Rows of the edges of each stitch, and whether it is ``right_wrong``."""
    config = net.config
    known = torch.full_like(batch.partners, -1)
    wrong = torch.zeros_like(batch.right_wrong)
    open_rows = np.arange(len(batch))
    for number in range(config.rounds):
        rows = torch.from_numpy(open_rows).to(known.device)
        part = batch if len(rows) == len(batch) else batch.select(rows)
        scores = net(part, known[rows])
        choices = scores.log_probabilities().cpu().double().numpy()
        turned = (scores.right_wrong > 0).cpu().numpy()
        partners, flags, still = known[rows].cpu().numpy(), wrong[rows].cpu().numpy(), []
        for at, row in enumerate(open_rows.tolist()):
            is_last = number == config.rounds - 1
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
    gain[~(np.isfinite(gain) & (gain > 0) & (mutual > math.log(LEAST)))] = 0.0
    np.fill_diagonal(gain, 0.0)
    return best_pairs(gain)


def best_pairs(gain: Float[np.ndarray, "e e"]) -> list[tuple[int, int]]:
    """The pairs of rows of greatest total weight, each row at most once.

    ``gain``: symmetric weights, 0 for what is no pair.

    The best assignment of rows to columns weighs at least twice as much as any pairs. Its cycles of even length, and
    those with a link of weight 0, are two sets of pairs each, of which one weighs at least half; so these are the best
    pairs. Only rows that are linked to another cycle need the search by blossoms (Edmonds, 1965), which takes longer.
    """
    found: list[tuple[int, int]] = []
    _, piece = connected_components(csr_array(gain > 0), directed=False)
    searched = np.zeros(len(gain), bool)
    for cycle in _cycles(linear_sum_assignment(gain, maximize=True)[1]):
        weights = gain[cycle, np.roll(cycle, -1)]
        is_odd = bool(len(cycle) % 2)
        if is_odd and (weights > 0).all():
            searched |= piece == piece[cycle[0]]
            continue
        if is_odd:  # a path that begins after its missing link
            first = int(weights.argmin()) + 1
            cycle, weights = np.roll(cycle, -first), np.roll(weights, -first)[:-1]
        ends, start = np.roll(cycle, -1), int(weights[1::2].sum() > weights[::2].sum())
        found += [(int(cycle[k]), int(ends[k])) for k in range(start, len(weights), 2) if weights[k] > 0]
    found = [pair for pair in found if not searched[pair[0]]] + _pairs_by_search(gain, piece, searched)
    return sorted((min(pair), max(pair)) for pair in found)


def _cycles(permutation: Int[np.ndarray, " n"]) -> list[Int[np.ndarray, " k"]]:
    """The cycles of a permutation, without fixed rows."""
    found, seen = list[np.ndarray](), np.zeros(len(permutation), bool)
    for row in range(len(permutation)):
        cycle = list[int]()
        while not seen[row]:
            seen[row] = True
            cycle.append(row)
            row = int(permutation[row])
        if len(cycle) > 1:
            found.append(np.array(cycle))
    return found


def _pairs_by_search(
    gain: Float[np.ndarray, "e e"], piece: Int[np.ndarray, " e"], searched: Bool[np.ndarray, " e"]
) -> list[tuple[int, int]]:
    """The best pairs of the rows ``searched``, each ``piece`` by itself."""
    found: list[tuple[int, int]] = []
    for one in np.unique(piece[searched]):
        rows = np.flatnonzero(piece == one)
        graph = networkx.Graph()
        for left, right in zip(*np.nonzero(np.triu(gain[np.ix_(rows, rows)])), strict=True):
            graph.add_edge(int(rows[left]), int(rows[right]), weight=float(gain[rows[left], rows[right]]))
        found += networkx.max_weight_matching(graph)
    return found


def predict_cuts(net: "StitchNet", batch: EdgeBatch, *, logit: float = 0.0) -> list[dict[int, list[float]]]:
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
