"""Scores of stitches of patterns whose edges are to be subdivided, by intervals of the outlines.

A seam joins two intervals of outlines. An interval of a prediction stands for one of the truth if their intersection
over union is at least ``SAME``: for a seam of 20 cm its ends are within about 1 cm.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from benchmarks.reconstruction.stitching.graphs import EdgeGraph, edge_refs, graph_of
from benchmarks.reconstruction.stitching.merging import Merged
from benchmarks.reconstruction.stitching.symmetry import best_symmetry, partners_of, score_stitches
from gcd_dataset.records import EdgeRef, Pattern

SAME = 0.9  # intersection over union of intervals that count as one


@dataclass(frozen=True, slots=True)
class IntervalScore:
    """Scores of the stitches of one garment, in [0, 1]."""

    f1: float
    """Of all seams."""
    f1_symmetric: float
    """Up to the symmetries of the subdivided panels."""
    perfect_symmetric: float
    f1_several: float
    """Of the seams with a side that is a part of an edge."""
    f1_several_symmetric: float
    cut_recall: float
    """Share of the parts of edges whose two ends are found."""


def score_intervals(true: Merged, predicted: Pattern) -> IntervalScore:
    """The score of ``predicted``: the panels of ``true.pattern`` with seams, of which edges may be subdivided."""
    graph, row_of = graph_of(true.parts), _rows_of_truth(true.parts, predicted)
    stitches = [(row_of.get(seam.left, -1), row_of.get(seam.right, -1)) for seam in predicted.seams]
    known = [pair for pair in stitches if min(pair) >= 0]
    score = score_stitches(graph, known, others=len(stitches) - len(known))
    several = _rows_of_several(true)
    extra = sum(any(row < 0 for row in pair) for pair in stitches)
    partners = partners_of(graph, known)
    moved = best_symmetry(graph, partners)
    parts = _parts(true)
    return IntervalScore(
        f1=score.f1,
        f1_symmetric=score.f1_symmetric,
        perfect_symmetric=score.perfect_symmetric,
        f1_several=_f1_of(graph, partners, np.arange(len(moved)), several, extra),
        f1_several_symmetric=max(
            _f1_of(graph, partners, rows, several, extra) for rows in (np.arange(len(moved)), moved)
        ),
        cut_recall=float(np.isin(parts, list(row_of.values())).mean()) if len(parts) else 1.0,
    )


def _f1_of(
    graph: EdgeGraph, partners: Int[np.ndarray, " e"], moved: Int[np.ndarray, " e"], several: set[int], extra: int
) -> float:
    """F1 of the true stitches of ``several`` rows, and the predicted stitches that touch them or no true edge."""
    wanted = {(row, int(graph.partners[row])) for row in several if graph.partners[row] > row}
    found = set()
    for row in np.flatnonzero(partners >= 0).tolist():
        pair = int(moved[row]), int(moved[partners[row]])
        if pair[0] < pair[1] and several & set(pair):
            found.add(pair)
    right = len(wanted & found)
    return 2 * right / (len(wanted) + len(found) + extra) if wanted or found or extra else 1.0


def _rows_of_several(true: Merged) -> set[int]:
    """Rows of both sides of the seams that have a side which is a part of an edge."""
    row_of = {ref: row for row, ref in enumerate(edge_refs(true.parts))}
    seams = [true.parts.seams[number] for number in true.seams_of_several]
    return {row_of[side] for seam in seams for side in (seam.left, seam.right)}


def _parts(true: Merged) -> Int[np.ndarray, " k"]:
    """Rows of the subdivided pattern that are parts of an edge."""
    counts = [len(true.cuts.get(ref, ())) + 1 for ref in edge_refs(true.pattern)]
    return np.flatnonzero(np.repeat(counts, counts) > 1)


def _rows_of_truth(true: Pattern, predicted: Pattern) -> dict[EdgeRef, int]:
    """The row of the true edge that lies on the same interval of the outline as each predicted edge."""
    row_of = {ref: row for row, ref in enumerate(edge_refs(true))}
    found = {}
    for ours, theirs in zip(predicted.panels, true.panels, strict=True):
        one, other = (_ends(panel.edge_lengths()) for panel in (ours, theirs))
        overlap = np.minimum(one[:, None, 1], other[:, 1]) - np.maximum(one[:, None, 0], other[:, 0])
        union = np.maximum(one[:, None, 1], other[:, 1]) - np.minimum(one[:, None, 0], other[:, 0])
        for edge, row in zip(*np.nonzero(overlap / union >= SAME), strict=True):
            found[EdgeRef(ours.name, int(edge))] = row_of[EdgeRef(theirs.name, int(row))]
    return found


def _ends(lengths: list[float]) -> Float[np.ndarray, "n 2"]:
    """Start and end of each edge along the outline [share]."""
    reached = np.concatenate([[0.0], np.cumsum(lengths)]) / sum(lengths)
    return np.stack([reached[:-1], reached[1:]], axis=1)
