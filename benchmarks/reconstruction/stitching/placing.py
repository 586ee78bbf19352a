"""Which of several panels of equal shape is which, and which way up, by their placements.

The network sees shapes alone, so that its seams hold up to the symmetries of the panels. Of these the placed answer is
the one whose sewn edges lie closest in space.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from benchmarks.reconstruction.stitching.graphs import EdgeGraph, edge_refs, graph_of
from benchmarks.reconstruction.stitching.merging import Cuts, split
from benchmarks.reconstruction.stitching.scores import Images, Search
from gcd_dataset.curves import sample_curve
from gcd_dataset.records import EdgeRef, Pattern, Seam

SAMPLES = 65  # points of an edge
AT = np.array([0.25, 0.75])  # shares of a seam whose two sides are compared


def placed(pattern: Pattern, cuts: Cuts, parts: Pattern) -> Pattern:
    """The answer ``parts``, the pattern subdivided at ``cuts`` with seams, with its panels of equal shape in place."""
    refs, graph = edge_refs(pattern), graph_of(replace(pattern, seams=()))
    place_of = _places(pattern, cuts, parts)
    bounds = [list(pairwise([0.0, *cuts.get(ref, ()), 1.0])) for ref in refs]
    sides = np.array(
        [[_sampled(*place_of[ref], bounds) for ref in (seam.left, seam.right)] for seam in parts.seams], int
    ).reshape(-1, 2, 3)
    against = np.array([not seam.right_wrong for seam in parts.seams], bool)
    sides[against, 1, 1:] = sides[against, 1, :0:-1]
    along = [
        sample_curve(*p.edge_ends(i), edge.curve, SAMPLES) for p in pattern.panels for i, edge in enumerate(p.edges)
    ]
    owner = [panel for panel in pattern.panels for _ in panel.edges]
    points = np.array([panel.placement.apply(line) for panel, line in zip(owner, along, strict=True)])
    image = _Placing(graph, points, sides).best().tolist()
    return exchanged(pattern, cuts, parts, image)


def exchanged(pattern: Pattern, cuts: Cuts, parts: Pattern, image: Sequence[int]) -> Pattern:
    """The answer with each edge of the pattern, its cuts and its seams, in place of its image, a row of the graph."""
    refs, place_of = edge_refs(pattern), _places(pattern, cuts, parts)
    moved = {refs[image[row]]: cuts[ref] for row, ref in enumerate(refs) if ref in cuts}
    whole = split(replace(pattern, seams=()), moved)
    ref_of = {place: ref for ref, place in _places(pattern, moved, whole).items()}
    sides = ([place_of[seam.left], place_of[seam.right]] for seam in parts.seams)
    new = [[ref_of[image[row], k] for row, k in two] for two in sides]
    seams = tuple(Seam(a, b, seam.right_wrong) for (a, b), seam in zip(new, parts.seams, strict=True))
    return replace(whole, seams=seams)


def _places(pattern: Pattern, cuts: Cuts, parts: Pattern) -> dict[EdgeRef, tuple[int, int]]:
    """The row of the edge that each edge of the subdivided pattern is a part of, and the number of the part."""
    rows = enumerate(edge_refs(pattern))
    places = [(row, k) for row, ref in rows for k in range(len(cuts.get(ref, ())) + 1)]
    return dict(zip(edge_refs(parts), places, strict=True))


def _sampled(row: int, part: int, bounds: list[list[tuple[float, float]]]) -> list[int]:
    """The row of an edge, and two samples of a part of it."""
    low, high = bounds[row][part]
    return [row, *np.rint((SAMPLES - 1) * (low + AT * (high - low))).astype(int).tolist()]


class _Placing(Search):
    """Finds the symmetry with the least distance of sewn edges in space."""

    def __init__(self, graph: EdgeGraph, points: Float[np.ndarray, "e n 3"], sides: Int[np.ndarray, "s 2 3"]) -> None:
        partners = np.full(len(points), -1)
        for left, right in sides[:, :, 0].tolist():
            partners[left], partners[right] = right, left
        super().__init__(graph, partners)
        self.points, self.sides = points, sides
        middles = points.mean(axis=1)
        self.apart = np.linalg.norm(middles[:, None] - middles, axis=-1)
        self.goals = {row: self._goals(row) for row in np.flatnonzero(partners >= 0).tolist()}

    def _goals(self, row: int) -> list[tuple[int, int]]:
        """The panels that the panel of an edge may be, and the edges of these that the edge then is."""
        return [
            (goal, int(self.first[goal] + (self.place[row] + turn) % self.sizes[goal]))
            for (panel, goal), turns in self.turns.items()
            if panel == self.panel_of[row]
            for turn in turns
        ]

    def value(self, images: Images) -> float:
        rows = self.moved(images)[self.sides[:, :, 0]]
        left, right = (self.points[rows[:, side, None], self.sides[:, side, 1:]] for side in (0, 1))
        return -float(np.linalg.norm(left - right, axis=-1).sum())

    def aim(self, row: int, partner: int, images: Images) -> int:
        """The edge nearest to ``row`` in its place, of those that may be the partner's."""
        used, apart = {target for target, _ in images.values()}, self.apart[self.image(row, images)]
        free = [edge for goal, edge in self.goals[partner] if goal not in used]
        return min(free, key=lambda edge: float(apart[edge]), default=-1)
