"""Two patterns of one design side by side: names, seams, outlines and places of their panels."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.curves import LINE, curve_length, sample_curve
from gcd_dataset.records import EdgeRef, Panel, Pattern

__all__ = ["Comparison", "Difference", "compare"]

STEP = 0.25  # cm between the points of an outline that are compared
CURVE_POINTS = 65


@dataclass(frozen=True, slots=True)
class Difference:
    """One thing in which two patterns differ."""

    panel: str
    what: str

    def __str__(self) -> str:
        return f"panel {self.panel}: {self.what}" if self.panel else self.what


@dataclass(frozen=True)
class Comparison:
    """How far two patterns agree."""

    structure: tuple[Difference, ...]
    """What differs in names, numbers of edges and seams; empty for the same graph."""
    outline: Mapping[str, float]
    """Of each panel that both have: Hausdorff distance of the outlines [cm]."""
    worst_edge: Mapping[str, int]
    """Of each of them: the edge of theirs on which that distance was found."""
    placement: Mapping[str, float]
    """Of each of them: how far apart its two places hold the same corner, at the worst corner [cm]."""


def compare(ours: Pattern, theirs: Pattern) -> Comparison:
    """Our pattern against theirs, panel by panel of the same name.

    A panel is laid onto its twin by its first corner and the direction of its first edge. Which corner of our loop is
    first is settled in space: the one that makes the loops lie together best, so that a loop may begin anywhere.
    """
    shared = [panel.name for panel in ours.panels if any(other.name == panel.name for other in theirs.panels)]
    names = _names_that_differ(ours, theirs)
    pairs = {name: (ours.panel(name), theirs.panel(name)) for name in shared}
    shifts = {name: _shift(*pair) for name, pair in pairs.items()}
    counts = [
        Difference(name, f"{len(mine.edges)} edges instead of {len(other.edges)}")
        for name, (mine, other) in pairs.items()
        if len(mine.edges) != len(other.edges)
    ]
    seams = [] if names or counts else _seams_that_differ(ours, theirs, shifts)
    laid = {name: _laid_onto(*pair, shifts[name]) for name, pair in pairs.items()}
    outlines = {name: _outline_distance(laid[name][0], pairs[name][1]) for name in shared}
    return Comparison(
        structure=(*names, *counts, *seams),
        outline={name: distance for name, (distance, _) in outlines.items()},
        worst_edge={name: edge for name, (_, edge) in outlines.items()},
        placement={name: laid[name][1] for name in shared},
    )


def _names_that_differ(ours: Pattern, theirs: Pattern) -> list[Difference]:
    mine, other = ({panel.name for panel in pattern.panels} for pattern in (ours, theirs))
    missing = [Difference(name, "is missing") for name in sorted(other - mine)]
    return missing + [Difference(name, "is not in theirs") for name in sorted(mine - other)]


def _seams_that_differ(ours: Pattern, theirs: Pattern, shifts: Mapping[str, int]) -> list[Difference]:
    """Seams of one pattern that the other has not, in their edge numbers."""
    counts = {panel.name: len(panel.edges) for panel in theirs.panels}

    def renumbered(ref: EdgeRef) -> EdgeRef:
        return EdgeRef(ref.panel, (ref.edge - shifts[ref.panel]) % counts[ref.panel])

    mine = {frozenset((renumbered(seam.left), renumbered(seam.right))): seam.right_wrong for seam in ours.seams}
    other = {frozenset((seam.left, seam.right)): seam.right_wrong for seam in theirs.seams}
    found = []
    for text, only in (("is not sewn", other.keys() - mine.keys()), ("is sewn here only", mine.keys() - other.keys())):
        found += [Difference("", f"seam {_text(pair)} {text}") for pair in only]
    turned = [pair for pair in mine.keys() & other.keys() if mine[pair] != other[pair]]
    return sorted(found + [Difference("", f"seam {_text(pair)} is sewn the other way") for pair in turned], key=str)


def _text(pair: frozenset[EdgeRef]) -> str:
    return " with ".join(sorted(f"{ref.panel} edge {ref.edge}" for ref in pair))


def _loop(panel: Panel) -> Float[np.ndarray, "e 2"]:
    """The corners in the order of the loop."""
    return panel.vertices[[edge.start for edge in panel.edges]]


def _shift(ours: Panel, theirs: Panel) -> int:
    """The number of our edge that is their first one."""
    mine, other = ours.placement.apply(_loop(ours)), theirs.placement.apply(_loop(theirs))
    if len(mine) != len(other):
        return int(np.argmin(np.linalg.norm(mine - other[0], axis=1)))
    apart = [np.linalg.norm(np.roll(mine, -shift, axis=0) - other, axis=1).sum() for shift in range(len(mine))]
    return int(np.argmin(apart))


def _laid_onto(ours: Panel, theirs: Panel, shift: int) -> tuple[Float[np.ndarray, "n 2"], float]:
    """Our outline in the plane of theirs [cm], and how far apart the two places hold their corners [cm]."""
    mine, other = np.roll(_loop(ours), -shift, axis=0), _loop(theirs)
    turn = _direction(other) @ _direction(mine).T

    def from_ours(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        return (points - mine[0]) @ turn.T + other[0]

    back = (other - other[0]) @ turn + mine[0]  # their corners in the plane of ours
    apart = np.linalg.norm(ours.placement.apply(back) - theirs.placement.apply(other), axis=1)
    return from_ours(np.concatenate([_edge_points(ours, edge) for edge in range(len(ours.edges))])), float(apart.max())


def _direction(loop: Float[np.ndarray, "e 2"]) -> Float[np.ndarray, "2 2"]:
    """The rotation that takes the x axis to the chord of the first edge."""
    x, y = (loop[1] - loop[0]) / np.linalg.norm(loop[1] - loop[0])
    return np.array([[x, -y], [y, x]])


def _outline_distance(ours: Float[np.ndarray, "n 2"], theirs: Panel) -> tuple[float, int]:
    """Hausdorff distance of the outlines [cm], and the edge of theirs where it was found."""
    edges = [_edge_points(theirs, edge) for edge in range(len(theirs.edges))]
    points, edge_of = np.concatenate(edges), np.repeat(np.arange(len(edges)), [len(points) for points in edges])
    there = shapely.distance(shapely.points(points), _ring(ours))
    here = shapely.distance(shapely.points(ours), _ring(points))
    if there.max() >= here.max():
        return float(there.max()), int(edge_of[np.argmax(there)])
    nearest = np.linalg.norm(points - ours[np.argmax(here)], axis=1)
    return float(here.max()), int(edge_of[np.argmin(nearest)])


def _ring(points: Float[np.ndarray, "n 2"]) -> shapely.LineString:
    return shapely.LineString(np.concatenate([points, points[:1]]))


def _edge_points(panel: Panel, index: int) -> Float[np.ndarray, "n 2"]:
    """Points along an edge, the last one left out."""
    edge, (start, end) = panel.edges[index], panel.edge_ends(index)
    count = 2 + int(curve_length(start, end, edge.curve) / STEP) if edge.curve == LINE else CURVE_POINTS
    return sample_curve(start, end, edge.curve, count)[:-1]
