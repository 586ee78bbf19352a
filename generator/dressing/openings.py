"""The sewn garment as a surface: its openings, which are the closed chains of edges that are in no seam."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import sample_curve
from gcd_dataset.records import EdgeRef, Panel, Pattern

__all__ = ["Opening", "edge_points", "openings_of", "panel_outline"]

POINTS = 9  # on an edge


@dataclass(frozen=True, eq=False)
class Opening:
    """A closed chain of free edges of the sewn garment: a neckline, a waist, a hem, the end of a sleeve."""

    edges: tuple[EdgeRef, ...]
    """In the order in which they follow each other."""
    length: float
    """[cm]"""
    centre: Float[np.ndarray, "3"]
    """Mean of its points before sewing [cm]."""
    low: Float[np.ndarray, "3"]
    """Corner of the box round it before sewing [cm]."""
    high: Float[np.ndarray, "3"]


def openings_of(pattern: Pattern) -> tuple[Opening, ...]:
    """All openings, the highest first."""
    found = [_measured(pattern, chain) for chain in _chains(pattern)]
    return tuple(sorted(found, key=lambda opening: (-opening.centre[1], opening.edges[0].panel, opening.edges[0].edge)))


def edge_points(panel: Panel, index: int, points: int = POINTS) -> Float[np.ndarray, "n 3"]:
    """Points along an edge where its panel hangs, from its start to its end [cm]."""
    return panel.placement.apply(sample_curve(*panel.edge_ends(index), panel.edges[index].curve, points))


def panel_outline(panel: Panel) -> Float[np.ndarray, "n 2"]:
    """Points along all edges of a panel, in its plane [cm]."""
    edges = range(len(panel.edges))
    return np.concatenate([sample_curve(*panel.edge_ends(i), panel.edges[i].curve, POINTS)[:-1] for i in edges])


def _measured(pattern: Pattern, edges: tuple[EdgeRef, ...]) -> Opening:
    lines = [edge_points(pattern.panel(ref.panel), ref.edge) for ref in edges]
    lengths = [float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines]
    middles = np.array([line.mean(axis=0) for line in lines])
    points = np.concatenate(lines)
    return Opening(
        edges, sum(lengths), np.average(middles, axis=0, weights=lengths), points.min(axis=0), points.max(axis=0)
    )


def _chains(pattern: Pattern) -> Iterable[tuple[EdgeRef, ...]]:
    """The free edges, each chain followed round its seams."""
    partner: dict[EdgeRef, tuple[EdgeRef, int]] = {}
    for seam in pattern.seams:
        turn = -1 if seam.right_wrong else 1
        partner[seam.left], partner[seam.right] = (seam.right, turn), (seam.left, turn)
    sizes = {panel.name: len(panel.edges) for panel in pattern.panels}
    free = [EdgeRef(name, i) for name, size in sizes.items() for i in range(size) if EdgeRef(name, i) not in partner]
    seen: set[EdgeRef] = set()
    for first in free:
        chain, at, way = [], first, 1
        while at not in seen:
            seen.add(at)
            chain.append(at)
            at, way = _next(at, way, sizes), way
            # A seam is crossed to the edge that follows on its other side; with right to wrong the way turns.
            while at in partner:
                at, turn = partner[at]
                way *= turn
                at = EdgeRef(at.panel, (at.edge + way) % sizes[at.panel])
        if chain:
            yield tuple(chain)


def _next(at: EdgeRef, way: int, sizes: dict[str, int]) -> EdgeRef:
    return EdgeRef(at.panel, (at.edge + way) % sizes[at.panel])
