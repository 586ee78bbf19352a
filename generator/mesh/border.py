"""Borders: the edges of a panel as points, equally many on both sides of every seam."""

from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.curves import curve_length, sample_curve
from gcd_dataset.errors import MeshError, PatternError
from gcd_dataset.records import EdgeRef, Panel, Pattern

MOST_POINTS = 1_500_000  # points of a pattern: the largest panel that ``validate`` accepts, ten metres square, at 1 cm
ROUNDING = 1e-9  # fraction of the spacing: a 10 cm edge gets 11 points even if computed slightly longer


@dataclass(frozen=True)
class Border:
    """The outline of a panel as a closed loop of points, in the order of its edges."""

    points: Float[np.ndarray, "n 2"]
    """[cm]"""
    first: Int[np.ndarray, " e+1"]
    """The first point of each edge; the last entry is the number of points."""

    def edge(self, index: int) -> Int[np.ndarray, " m"]:
        """The points of an edge from start to end, both included."""
        return np.arange(self.first[index], self.first[index + 1] + 1) % len(self.points)


def edge_counts(pattern: Pattern, spacing: float) -> dict[EdgeRef, int]:
    """Number of points on each edge, ends included: ``ceil(length / spacing) + 1`` of the longer side of its seam.

    Raises ``MeshError`` for an edge without a finite length, an edge in two seams, and a seam of a missing edge.
    """
    counts = {
        EdgeRef(panel.name, index): _count(panel, index, spacing)
        for panel in pattern.panels
        for index in range(len(panel.edges))
    }
    seam_of: dict[EdgeRef, int] = {}
    for number, seam in enumerate(pattern.seams):
        for side in (seam.left, seam.right):
            if side not in counts:
                raise MeshError(f"seam {number}: there is no edge {side.edge} of panel {side.panel}; correct the seam")
            if side in seam_of:
                raise MeshError(
                    f"panel {side.panel}, edge {side.edge} is in seams {seam_of[side]} and {number}: "
                    "split the edge, so that each piece is in one seam"
                )
            seam_of[side] = number
        counts[seam.left] = counts[seam.right] = max(counts[seam.left], counts[seam.right])
    return counts


def sample_border(panel: Panel, counts: dict[EdgeRef, int]) -> Border:
    """The points of a panel's outline, equally spaced by arc length along each edge, each corner once.

    Raises ``MeshError`` for a panel without edges or with too many points, and for edges that do not close a loop.
    """
    if not panel.edges:
        raise MeshError(f"panel {panel.name} has no edges: draw its outline or remove the panel")
    total = sum(counts[EdgeRef(panel.name, index)] - 1 for index in range(len(panel.edges)))
    if total > MOST_POINTS:
        raise MeshError(
            f"panel {panel.name} would get {total:.3g} points along its edges, over {MOST_POINTS:,}: "
            "use a coarser spacing"
        )
    pieces = []
    for index, edge in enumerate(panel.edges):
        if edge.end != panel.edges[(index + 1) % len(panel.edges)].start:
            raise MeshError(f"panel {panel.name}: edge {index} does not end where the next begins; close the loop")
        pieces.append(sample_curve(*panel.edge_ends(index), edge.curve, counts[EdgeRef(panel.name, index)])[:-1])
    return Border(np.concatenate(pieces), np.cumsum([0, *map(len, pieces)]))


def _count(panel: Panel, index: int, spacing: float) -> int:
    try:
        length = curve_length(*panel.edge_ends(index), panel.edges[index].curve)
    except PatternError as error:
        raise MeshError(f"panel {panel.name}, edge {index}: {error}") from error
    if not 0.0 < length < np.inf:
        raise MeshError(f"panel {panel.name}, edge {index} has a length of {length} cm: remove it or move an end")
    return max(ceil(length / spacing - ROUNDING), 1) + 1
