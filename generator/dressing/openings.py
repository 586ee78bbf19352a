"""Openings of the sewn garment: closed chains of edges that are not joined."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import sample_curve
from gcd_dataset.records import Closure, EdgeRef, Panel, Pattern

ASIDE = 8.0  # cm from the middle to the centre of an opening: openings further out belong to an arm or a leg
POINTS = 9  # sample points of an edge
PAIRED = 40  # largest number of openings compared in pairs, the longest; garments have up to ten
UNPAIRED = 15.0  # cm: cost of an opening without a mirror image


@dataclass(frozen=True, eq=False)
class Opening:
    """A closed chain of free edges of the sewn garment: a neckline, a waist, a hem, the end of a sleeve."""

    edges: tuple[EdgeRef, ...]
    """In their order round the opening."""
    length: float
    """[cm]"""
    centre: Float[np.ndarray, "3"]
    """Mean of its edges before sewing, weighted by length [cm]."""
    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]
    """Corners of its bounding box before sewing [cm]."""


def openings_of(pattern: Pattern) -> tuple[Opening, ...]:
    """All openings, the highest first."""
    found = [_opening(pattern, chain) for chain in _chains(pattern)]
    return tuple(sorted(found, key=lambda opening: (-opening.centre[1], opening.edges[0].panel, opening.edges[0].edge)))


def middle_of(openings: Sequence[Opening]) -> float:
    """The x [cm] of the approximate symmetry plane of the openings."""
    if not openings:
        return 0.0
    if len(openings) > PAIRED:
        openings = sorted(openings, key=lambda opening: -opening.length)[:PAIRED]
    centres = np.array([o.centre[0] for o in openings])
    kinds = np.array([[0.2 * o.length, 0.5 * o.centre[1]] for o in openings])
    unlike = np.abs(kinds[:, None] - kinds).sum(axis=2)
    tried = sorted({0.5 * (a + b) for a in centres.tolist() for b in centres.tolist()})
    uneven = [(np.abs(centres[:, None] + centres - 2 * x) + unlike).min(axis=1, initial=UNPAIRED).sum() for x in tried]
    return float(tried[int(np.argmin(uneven))])


def edge_points(panel: Panel, index: int) -> Float[np.ndarray, "n 3"]:
    """Points along an edge or line from start to end, in space [cm]."""
    return panel.placement.apply(sample_curve(*panel.edge_ends(index), panel.edge(index).curve, POINTS))


def panel_outline(panel: Panel, points: int = POINTS) -> Float[np.ndarray, "n 2"]:
    """Points along all edges of a panel, ``points`` on each with both ends, in the panel's plane [cm]."""
    edges = range(len(panel.edges))
    return np.concatenate([sample_curve(*panel.edge_ends(i), panel.edges[i].curve, points)[:-1] for i in edges])


def _opening(pattern: Pattern, edges: tuple[EdgeRef, ...]) -> Opening:
    lines = [edge_points(pattern.panel(ref.panel), ref.edge) for ref in edges]
    lengths = [float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines]
    middles = np.array([line.mean(axis=0) for line in lines])
    points = np.concatenate(lines)
    return Opening(
        edges, sum(lengths), np.average(middles, axis=0, weights=lengths), points.min(axis=0), points.max(axis=0)
    )


def _chains(pattern: Pattern) -> Iterable[tuple[EdgeRef, ...]]:
    """The chains of free edges, followed across the seams between them."""
    sizes = {panel.name: len(panel.edges) for panel in pattern.panels}
    partner: dict[EdgeRef, tuple[EdgeRef, int]] = {}
    for seam in pattern.seams:
        if seam.closure == Closure.OPEN or any(ref.edge >= sizes[ref.panel] for ref in (seam.left, seam.right)):
            continue
        sign = -1 if seam.right_wrong else 1
        partner[seam.left], partner[seam.right] = (seam.right, sign), (seam.left, sign)
    free = [EdgeRef(name, i) for name, size in sizes.items() for i in range(size) if EdgeRef(name, i) not in partner]
    seen: set[EdgeRef] = set()
    for first in free:
        chain, at, direction = [], first, 1
        while at not in seen:
            seen.add(at)
            chain.append(at)
            at = _next(at, direction, sizes)
            # Continue on the other panel of a seam; a seam of right to wrong side reverses the direction.
            while at in partner:
                at, sign = partner[at]
                direction *= sign
                at = _next(at, direction, sizes)
        if chain:
            yield tuple(chain)


def _next(at: EdgeRef, direction: int, sizes: dict[str, int]) -> EdgeRef:
    return EdgeRef(at.panel, (at.edge + direction) % sizes[at.panel])
