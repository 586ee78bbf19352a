"""Positions along panel outlines as arc lengths, and the map from a predicted outline to the true one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.metrics.shapes import PanelShape

GAPS = (0.5, 10.0)  # cm: bounds of the cost of a corner without a match
NOISE = 2.0  # gaps for each cm between corners and their nearest corner: matched corners are less than two gaps apart


@dataclass(frozen=True, eq=False)
class Outline:
    """Arc lengths along an outline from its first corner, counter-clockwise from the right side of the cloth [cm]."""

    ends: Float[np.ndarray, "e 2"]
    """Start and end of every edge."""
    corners: Float[np.ndarray, "e 2"]
    """Start of every edge about the panel's centroid, seen from the right side [cm]."""
    length: float

    @staticmethod
    def of(shape: PanelShape) -> "Outline":
        """The outline of a panel."""
        lengths = np.array(shape.panel.edge_lengths())
        reached = np.concatenate([[0.0], np.cumsum(lengths)])
        corners = shape.panel.vertices[[edge.start for edge in shape.panel.edges]]
        return Outline(np.stack([reached[:-1], reached[1:]], axis=1), shape.seen(corners), float(reached[-1]))


@dataclass(frozen=True, eq=False)
class OutlineMap:
    """A monotone map between the arc lengths of two outlines, linear between matched corners."""

    source: Float[np.ndarray, " a"]
    """Increasing arc lengths; the last is the first, once round [cm]."""
    target: Float[np.ndarray, " a"]

    @staticmethod
    def between(predicted: Outline, true: Outline) -> "OutlineMap":
        """The map that sends the corners of the predicted outline to the true corners near them.

        Corners are matched in their cyclic order at least total distance (sequence alignment by dynamic programming). A
        corner without a match, such as the point of a subdivided edge, lies where the arc lengths of its neighbours
        put it. How far apart matched corners may be depends on the median error of the corners. Both outlines have a
        length.
        """
        distance = np.linalg.norm(predicted.corners[:, None] - true.corners[None], axis=2)
        first = np.unravel_index(distance.argmin(), distance.shape)
        turned = np.roll(distance, (-int(first[0]), -int(first[1])), axis=(0, 1))
        noise = min(float(np.median(distance.min(axis=axis))) for axis in (0, 1))
        pairs = np.array([(0, 0), *((i + 1, j + 1) for i, j in aligned(turned[1:, 1:], np.clip(NOISE * noise, *GAPS)))])
        ends = []
        for side, outline in enumerate((predicted, true)):
            at = np.roll(outline.ends[:, 0], -int(first[side]))[pairs[:, side]]
            at = at[0] + (at - at[0]) % outline.length
            ends.append(np.append(at, at[0] + outline.length))
        return OutlineMap(*ends)

    def apply(self, positions: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Positions on the true outline [cm], unwrapped: once round the one outline is once round the other."""
        length, target = self.source[-1] - self.source[0], self.target[-1] - self.target[0]
        turns = np.floor((positions - self.source[0]) / length)
        return np.interp(positions - turns * length, self.source, self.target) + turns * target


def aligned(distance: Float[np.ndarray, "n m"], gap: float) -> Sequence[tuple[int, int]]:
    """Pairs (row, column), both increasing, at least total cost: the distance of a pair, ``gap`` for each one left out.

    Needleman and Wunsch, J. Mol. Biol. 48 (1970).
    """
    rows, columns = distance.shape
    steps = gap * np.arange(columns + 1)
    cost = np.empty((rows + 1, columns + 1))
    cost[0] = steps
    for row in range(rows):
        reached = cost[row] + gap
        reached[1:] = np.minimum(reached[1:], cost[row, :-1] + distance[row])
        cost[row + 1] = steps + np.minimum.accumulate(reached - steps)
    pairs, row, column = [], rows, columns
    while row and column:
        here = cost[row, column]
        if np.isclose(here, cost[row - 1, column - 1] + distance[row - 1, column - 1], rtol=0, atol=1e-9):
            row, column = row - 1, column - 1
            pairs.append((row, column))
        elif np.isclose(here, cost[row - 1, column] + gap, rtol=0, atol=1e-9):
            row -= 1
        else:
            column -= 1
    return pairs[::-1]
