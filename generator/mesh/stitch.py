"""Points of panels joined into vertices along the seams."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gcd_dataset.errors import MeshError
from gcd_dataset.records import Seam

__all__ = ["SewnPoints", "mean_positions", "merge_points", "seam_name", "stitch_points"]


@dataclass(frozen=True)
class SewnPoints:
    """Which points of the panels meet in seams; ``c`` counts the points of all panels, ``m`` pairs of points."""

    left: Int[np.ndarray, " m"]
    right: Int[np.ndarray, " m"]
    """The point that ``left`` is sewn to."""
    seam: Int[np.ndarray, " m"]
    """Row of the pattern's seams."""


def seam_name(number: int, seam: Seam) -> str:
    """A seam as it is called in messages."""
    left, right = seam.left, seam.right
    return f"seam {number} ({left.panel} edge {left.edge} to {right.panel} edge {right.edge})"


def stitch_points(
    seams: tuple[Seam, ...], sides: list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]]
) -> SewnPoints:
    """The pairs of points along all seams, each in the order of its left edge.

    ``sides`` holds the points of the left and right edge of each seam, both from start to end.
    """
    if not seams:
        return SewnPoints(*(np.zeros(0, int) for _ in range(3)))
    left = [side for side, _ in sides]
    right = [side if seam.right_wrong else side[::-1] for seam, (_, side) in zip(seams, sides, strict=True)]
    seam = np.repeat(np.arange(len(seams)), [len(side) for side in left])
    return SewnPoints(np.concatenate(left), np.concatenate(right), seam)


def merge_points(sewn: SewnPoints, panel: Int[np.ndarray, " c"], seams: tuple[Seam, ...]) -> Int[np.ndarray, " c"]:
    """The vertex of every point: those of seams first, in the order of the seams, then the rest in their own order.

    ``panel`` is the panel of each point. Raises ``MeshError`` for a seam whose ends fall together, and for one that
    joins two points of a panel though no seam within the panel, as a dart is one, asks for it.
    """
    group = _groups(len(panel), sewn.left, sewn.right)
    _require_open_seams(group, sewn, seams)
    _require_darts(group, sewn, panel, seams)
    free = np.ones(len(panel), bool)
    free[sewn.left] = free[sewn.right] = False
    order = group[np.concatenate([sewn.left, np.flatnonzero(free)])]
    first = np.empty(group.max() + 1, int)
    first[order[::-1]] = np.arange(len(order))[::-1]  # of those of a group the first is written last, and stays
    vertex = np.empty(len(first), int)
    vertex[np.argsort(first)] = np.arange(len(first))
    return vertex[group]


def mean_positions(positions: Float[np.ndarray, "c 3"], vertex: Int[np.ndarray, " c"]) -> Float[np.ndarray, "v 3"]:
    """The mean of the points of each vertex."""
    members = np.bincount(vertex)
    return np.stack([np.bincount(vertex, column) / members for column in positions.T], axis=1)


def _groups(n: int, a: Int[np.ndarray, " m"], b: Int[np.ndarray, " m"]) -> Int[np.ndarray, " c"]:
    """A number for each of n points, equal where pairs (a, b) connect them."""
    _, group = connected_components(coo_array((np.ones(len(a), bool), (a, b)), shape=(n, n)), directed=False)
    return group.astype(int)


def _require_open_seams(group: Int[np.ndarray, " c"], sewn: SewnPoints, seams: tuple[Seam, ...]) -> None:
    """Raise ``MeshError`` for a seam whose two ends are one vertex."""
    starts = np.flatnonzero(np.diff(sewn.seam, prepend=-1))
    ends = np.flatnonzero(np.diff(sewn.seam, append=-1))
    closed = np.flatnonzero(group[sewn.left[starts]] == group[sewn.left[ends]])
    if len(closed):
        number = int(closed[0])
        raise MeshError(f"{seam_name(number, seams[number])}: its two ends fall together; split both edges in two")


def _require_darts(
    group: Int[np.ndarray, " c"], sewn: SewnPoints, panel: Int[np.ndarray, " c"], seams: tuple[Seam, ...]
) -> None:
    """Raise ``MeshError`` for points of one panel that are joined, but not by seams within that panel."""
    within = panel[sewn.left] == panel[sewn.right]
    explained = _groups(len(panel), sewn.left[within], sewn.right[within])
    members = np.unique(np.concatenate([sewn.left, sewn.right]))
    # Among the points of a panel that are one vertex, all must be one group by the seams within it.
    place = np.unique(np.stack([panel[members], group[members], explained[members]]), axis=1)
    double = np.flatnonzero((np.diff(place[:2], axis=1) == 0).all(axis=0))
    if len(double):
        joined = (panel == place[0, double[0]]) & (group == place[1, double[0]])
        guilty = np.flatnonzero(joined[sewn.left] | joined[sewn.right])
        number = int(sewn.seam[guilty[-1]])
        raise MeshError(
            f"{seam_name(number, seams[number])} joins two points of one panel that no dart brings together: "
            "check its direction, or sew the edges between the points as a dart"
        )
