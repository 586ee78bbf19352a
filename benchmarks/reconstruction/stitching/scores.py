"""Scores of stitches up to the symmetries of a pattern.

The panels alone do not determine the stitches where panels are congruent. Front and back of a skirt are often one
polygon cut twice, a cuff is a rectangle that may be turned by half a turn, and gores of a skirt may be sewn in any
cycle. Let G be the group of all permutations of congruent panels, composed with the turns that map a panel to itself
(a turned-over panel is another panel: cloth has a right side). For g in G, a prediction P and g(P) are the same garment
in other words, so P is scored by ``max over g of F1(g(P), truth)``. The strict score is that of g = 1.

The garment is right up to symmetry exactly if some g maps P to the truth. ``best_symmetry`` follows the seams from one
panel, which finds such a g wherever there is one and P has the truth's seams; for other predictions a local search
improves it, and the score is a lower bound of the maximum.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from benchmarks.reconstruction.stitching.graphs import EdgeGraph, edge_refs, graph_of
from benchmarks.reconstruction.stitching.merging import Merged
from gcd_dataset.records import EdgeRef, Pattern

CONGRUENT = 0.05  # cm: largest distance of points of congruent outlines
PASSES = 4  # of the local search

Turns = dict[tuple[int, int], list[int]]
"""The shifts s of pairs of panels for which edge k of the first lies on edge k + s of the second."""
Images = dict[int, tuple[int, int]]
"""The image of each panel, and its shift."""


@dataclass(frozen=True, slots=True)
class StitchScore:
    """Scores of the predicted stitches of one garment, in [0, 1]."""

    precision: float
    recall: float
    f1: float
    perfect: float
    """1 if all stitches are right, and no other is predicted."""
    f1_symmetric: float
    """Up to the symmetries of the pattern."""
    perfect_symmetric: float


def score_stitches(graph: EdgeGraph, stitches: Iterable[Sequence[int]], *, others: int = 0) -> StitchScore:
    """The score of pairs of rows of the graph against its seams. Which ends meet (``right_wrong``) is not scored.

    ``others``: further predicted stitches, which are wrong.
    """
    predicted = partners_of(graph, stitches)
    moved = best_symmetry(graph, predicted)
    rows = np.arange(len(predicted))
    precision, recall, f1 = _f1(graph, predicted, rows, others)
    symmetric = max(f1, _f1(graph, predicted, moved, others)[2])
    return StitchScore(precision, recall, f1, float(f1 == 1.0), symmetric, float(symmetric == 1.0))


def partners_of(graph: EdgeGraph, stitches: Iterable[Sequence[int]]) -> Int[np.ndarray, " e"]:
    """The partner of each row in the stitches, -1 for none."""
    partners = np.full(len(graph.lengths), -1)
    for left, right, *_ in stitches:
        partners[left], partners[right] = right, left
    return partners


def best_symmetry(graph: EdgeGraph, predicted: Int[np.ndarray, " e"]) -> Int[np.ndarray, " e"]:
    """The symmetry of the panels that makes the most predicted stitches right: the image of each row."""
    if np.array_equal(predicted, graph.partners):
        return np.arange(len(predicted))
    return Search(graph, predicted).best()


def _f1(
    graph: EdgeGraph, predicted: Int[np.ndarray, " e"], moved: Int[np.ndarray, " e"], others: int
) -> tuple[float, float, float]:
    """Precision, recall and F1 of stitches after a symmetry moved their edges."""
    sewn = predicted >= 0
    right = int((graph.partners[moved[sewn]] == moved[predicted[sewn]]).sum())
    found, wanted = int(sewn.sum()) + 2 * others, int((graph.partners >= 0).sum())
    if not found + wanted:
        return 1.0, 1.0, 1.0
    return right / max(found, 1), right / max(wanted, 1), 2 * right / (found + wanted)


def congruences(graph: EdgeGraph) -> Turns:
    """The turns of every pair of congruent panels, and of each panel onto itself.

    Two panels are congruent if both lie on the first of their kind: lying on each other within a tolerance is no
    equivalence, which permutations of congruent panels need.
    """
    panels = [np.flatnonzero(graph.panels == panel) for panel in range(graph.panels.max() + 1)]
    kinds = list[tuple[int, list[int]]]()  # of each panel: the first of its kind, and the turns onto it
    for panel, rows in enumerate(panels):
        for first in (*dict(kinds), panel):
            others = panels[first]
            if len(rows) == len(others):
                shifts = [s for s in range(len(rows)) if _lie_on(graph, rows, np.roll(others, -s))]
                if shifts:
                    kinds.append((first, shifts))
                    break
    return {
        (one, other): sorted({(s - t) % len(panels[one]) for s in turns for t in back})
        for one, (kind, turns) in enumerate(kinds)
        for other, (its, back) in enumerate(kinds)
        if kind == its
    }


def _lie_on(graph: EdgeGraph, rows: Int[np.ndarray, " k"], others: Int[np.ndarray, " k"]) -> bool:
    """Whether a turn and a shift put one loop on another, edge by edge."""
    if np.abs(graph.lengths[rows] - graph.lengths[others]).max() > CONGRUENT:
        return False
    ours, theirs = (np.asarray(graph.points[r], float).reshape(-1, 2) @ np.array([1, 1j]) for r in (rows, others))
    ours, theirs = ours - ours.mean(), theirs - theirs.mean()
    turn = np.vdot(ours, theirs)
    return bool(np.abs(ours * (turn / max(abs(turn), 1e-12)) - theirs).max() <= CONGRUENT)


class Search:
    """The search for the panels' permutation and turns that make the most stitches right."""

    def __init__(self, graph: EdgeGraph, predicted: Int[np.ndarray, " e"]) -> None:
        self.predicted, self.true = predicted, graph.partners
        self.turns = congruences(graph)
        self.panel_of = graph.panels
        self.first = np.flatnonzero(np.diff(graph.panels, prepend=-1))
        self.sizes = np.bincount(graph.panels)
        self.place = np.arange(len(predicted)) - self.first[graph.panels]

    def best(self) -> Int[np.ndarray, " e"]:
        """The image of each row for the best permutation and turns found."""
        images: Images = {}
        for component in self._components():
            tried = [
                self._followed(panel, target, shift, images)
                for panel in component
                for target in range(len(self.sizes))
                for shift in self.turns.get((panel, target), [])
                if target not in {image for image, _ in images.values()}
            ]
            images = max(tried, key=lambda found: self.value(self._completed(found)), default=images)
        identity = {panel: (panel, 0) for panel in range(len(self.sizes))}
        starts = (self._completed(images), identity)
        return self.moved(max((self._improved(start) for start in starts), key=self.value))

    def _components(self) -> list[list[int]]:
        """Panels that predicted seams connect."""
        left = set(range(len(self.sizes)))
        components = []
        while left:
            front, found = [min(left)], {min(left)}
            while front:
                rows = self._rows(front.pop())
                for other in {int(self.panel_of[p]) for p in self.predicted[rows] if p >= 0} - found:
                    found.add(other)
                    front.append(other)
            components.append(sorted(found))
            left -= found
        return components

    def _followed(self, panel: int, target: int, shift: int, given: Images) -> Images:
        """Images of the panels that follow from one image, seam by seam: (panel, shift)."""
        images = {**given, panel: (target, shift)}
        used = {image for image, _ in images.values()}
        front = [panel]
        while front:
            at = front.pop(0)
            for row in self._rows(at):
                partner = int(self.predicted[row])
                if partner < 0 or (other := int(self.panel_of[partner])) in images:
                    continue
                if (aim := self.aim(int(row), partner, images)) < 0:
                    continue
                goal = int(self.panel_of[aim])
                turn = int(self.place[aim] - self.place[partner]) % int(self.sizes[other])
                if goal not in used and turn in self.turns.get((other, goal), []):
                    images[other] = (goal, turn)
                    used.add(goal)
                    front.append(other)
        return images

    def _completed(self, images: Images) -> Images:
        """Images for the other panels, too: themselves where that is free."""
        images = dict(images)
        free = set(range(len(self.sizes))) - {image for image, _ in images.values()}
        for panel in sorted(set(range(len(self.sizes))) - set(images), key=lambda panel: panel not in free):
            target = panel if panel in free else next(t for t in sorted(free) if (panel, t) in self.turns)
            images[panel] = (target, self.turns[panel, target][0])
            free.remove(target)
        return images

    def _improved(self, images: Images) -> Images:
        """The images after exchanges of two of them, and turns, as long as they help."""
        best = self.value(images)
        for _ in range(PASSES):
            before = best
            for one, other in self.turns:
                if one <= other:
                    tried = [{**images, **change} for change in self._changes(one, other, images)]
                    counts = [self.value(changed) for changed in tried]
                    if counts and max(counts) > best:
                        best = max(counts)
                        images = tried[counts.index(best)]
            if best == before:
                break
        return images

    def _changes(self, one: int, other: int, images: Images) -> Iterator[Images]:
        """Other turns of a panel's image, or two panels with their images exchanged."""
        (a, _), (b, _) = images[one], images[other]
        for s in self.turns[one, b]:
            for t in self.turns[other, a] if one != other else [s]:
                yield {one: (b, s), other: (a, t)}

    def value(self, images: Images) -> float:
        """Number of edges with the right partner."""
        moved, sewn = self.moved(images), self.predicted >= 0
        return int((self.true[moved[sewn]] == moved[self.predicted[sewn]]).sum())

    def moved(self, images: Images) -> Int[np.ndarray, " e"]:
        """The image of each row."""
        target, shift = np.array([images[panel] for panel in range(len(self.sizes))]).T
        target, shift = target[self.panel_of], shift[self.panel_of]
        return self.first[target] + (self.place + shift) % self.sizes[target]

    def aim(self, row: int, partner: int, images: Images) -> int:
        """The edge that the image of ``row``'s partner should be; -1 for none."""
        return int(self.true[self.image(row, images)])

    def image(self, row: int, images: Images) -> int:
        panel, shift = images[int(self.panel_of[row])]
        return int(self.first[panel] + (self.place[row] + shift) % self.sizes[panel])

    def _rows(self, panel: int) -> Int[np.ndarray, " k"]:
        return np.arange(self.first[panel], self.first[panel] + self.sizes[panel])


SAME = 0.9  # intersection over union of intervals that count as one


def score_intervals(true: Merged, predicted: Pattern) -> StitchScore:
    """The score of ``predicted``: the panels of ``true.pattern`` with seams; its edges may be subdivided."""
    row_of = _rows_of_truth(true.parts, predicted)
    stitches = [(row_of.get(seam.left, -1), row_of.get(seam.right, -1)) for seam in predicted.seams]
    known = [pair for pair in stitches if min(pair) >= 0]
    return score_stitches(graph_of(true.parts), known, others=len(stitches) - len(known))


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
