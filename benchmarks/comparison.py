"""Comparison of two patterns of one design: names, seams, outlines and placements of panels."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.curves import LINE, curve_length, sample_curve
from gcd_dataset.records import EdgeRef, Panel, Pattern

STEP = 0.25  # cm between compared points of an outline
CURVE_POINTS = 65


@dataclass(frozen=True, slots=True)
class FigureDifference:
    """One difference between two patterns."""

    panel: str
    message: str

    def __str__(self) -> str:
        return f"panel {self.panel}: {self.message}" if self.panel else self.message


@dataclass(frozen=True)
class Comparison:
    """All differences between two patterns."""

    structure: tuple[FigureDifference, ...]
    """Differences in names, edge counts and seams; empty if the graphs are equal."""
    outline: Mapping[str, float]
    """Shared panel to the Hausdorff distance of its outlines [cm]."""
    worst_edge: Mapping[str, int]
    """Shared panel to the edge of ``theirs`` with that distance."""
    placement: Mapping[str, float]
    """Shared panel to the largest distance of a corner between its two placements [cm]."""


def compare(ours: Pattern, theirs: Pattern) -> Comparison:
    """Compare panels of equal name.

    Panels are aligned by their first corner and the direction of their first edge. Loops may start anywhere: our first
    corner is the one that aligns the placed loops best in space.
    """
    shared = [panel.name for panel in ours.panels if any(other.name == panel.name for other in theirs.panels)]
    names = _name_differences(ours, theirs)
    pairs = {name: (ours.panel(name), theirs.panel(name)) for name in shared}
    shifts = {name: _shift(*pair) for name, pair in pairs.items()}
    counts = [
        FigureDifference(name, f"{len(mine.edges)} edges instead of {len(other.edges)}")
        for name, (mine, other) in pairs.items()
        if len(mine.edges) != len(other.edges)
    ]
    seams = [] if names or counts else _seam_differences(ours, theirs, shifts)
    aligned = {name: _aligned(*pair, shifts[name]) for name, pair in pairs.items()}
    outlines = {name: _outline_distance(aligned[name][0], pairs[name][1]) for name in shared}
    return Comparison(
        structure=(*names, *counts, *seams),
        outline={name: distance for name, (distance, _) in outlines.items()},
        worst_edge={name: edge for name, (_, edge) in outlines.items()},
        placement={name: aligned[name][1] for name in shared},
    )


def _name_differences(ours: Pattern, theirs: Pattern) -> list[FigureDifference]:
    mine, other = ({panel.name for panel in pattern.panels} for pattern in (ours, theirs))
    missing = [FigureDifference(name, "is missing") for name in sorted(other - mine)]
    return missing + [FigureDifference(name, "is not in theirs") for name in sorted(mine - other)]


def _seam_differences(ours: Pattern, theirs: Pattern, shifts: Mapping[str, int]) -> list[FigureDifference]:
    """Seams of one pattern that the other lacks, in their edge numbers."""
    counts = {panel.name: len(panel.edges) for panel in theirs.panels}

    def renumbered(ref: EdgeRef) -> EdgeRef:
        return EdgeRef(ref.panel, (ref.edge - shifts[ref.panel]) % counts[ref.panel])

    mine = {frozenset((renumbered(seam.left), renumbered(seam.right))): seam.right_wrong for seam in ours.seams}
    other = {frozenset((seam.left, seam.right)): seam.right_wrong for seam in theirs.seams}
    found = []
    for text, only in (("is not sewn", other.keys() - mine.keys()), ("is sewn here only", mine.keys() - other.keys())):
        found += [FigureDifference("", f"seam {_text(pair)} {text}") for pair in only]
    turned = [pair for pair in mine.keys() & other.keys() if mine[pair] != other[pair]]
    return sorted(
        found + [FigureDifference("", f"seam {_text(pair)} is sewn the other way") for pair in turned], key=str
    )


def _text(pair: frozenset[EdgeRef]) -> str:
    return " with ".join(sorted(f"{ref.panel} edge {ref.edge}" for ref in pair))


def _loop(panel: Panel) -> Float[np.ndarray, "e 2"]:
    """The corners in loop order [cm]."""
    return panel.vertices[[edge.start for edge in panel.edges]]


def _shift(ours: Panel, theirs: Panel) -> int:
    """The number of our edge that corresponds to their first edge."""
    mine, other = ours.placement.apply(_loop(ours)), theirs.placement.apply(_loop(theirs))
    if len(mine) != len(other):
        return int(np.argmin(np.linalg.norm(mine - other[0], axis=1)))
    distances = [np.linalg.norm(np.roll(mine, -shift, axis=0) - other, axis=1).sum() for shift in range(len(mine))]
    return int(np.argmin(distances))


def _aligned(ours: Panel, theirs: Panel, shift: int) -> tuple[Float[np.ndarray, "n 2"], float]:
    """Our outline in their panel's plane [cm], and the largest distance of a corner between the placements [cm]."""
    mine, other = np.roll(_loop(ours), -shift, axis=0), _loop(theirs)
    turn = _direction(other) @ _direction(mine).T

    def to_theirs(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        return (points - mine[0]) @ turn.T + other[0]

    in_ours = (other - other[0]) @ turn + mine[0]  # their corners in the plane of our panel
    distances = np.linalg.norm(ours.placement.apply(in_ours) - theirs.placement.apply(other), axis=1)
    return to_theirs(np.concatenate([_edge_points(ours, edge) for edge in range(len(ours.edges))])), float(
        distances.max()
    )


def _direction(loop: Float[np.ndarray, "e 2"]) -> Float[np.ndarray, "2 2"]:
    """The rotation from the x axis to the chord of the first edge."""
    x, y = (loop[1] - loop[0]) / np.linalg.norm(loop[1] - loop[0])
    return np.array([[x, -y], [y, x]])


def _outline_distance(ours: Float[np.ndarray, "n 2"], theirs: Panel) -> tuple[float, int]:
    """Hausdorff distance of the outlines [cm], and the edge of theirs that has it."""
    edges = [_edge_points(theirs, edge) for edge in range(len(theirs.edges))]
    points, edge_of = np.concatenate(edges), np.repeat(np.arange(len(edges)), [len(points) for points in edges])
    to_ours = shapely.distance(shapely.points(points), _ring(ours))
    to_theirs = shapely.distance(shapely.points(ours), _ring(points))
    if to_ours.max() >= to_theirs.max():
        return float(to_ours.max()), int(edge_of[np.argmax(to_ours)])
    nearest = np.linalg.norm(points - ours[np.argmax(to_theirs)], axis=1)
    return float(to_theirs.max()), int(edge_of[np.argmin(nearest)])


def _ring(points: Float[np.ndarray, "n 2"]) -> shapely.LineString:
    return shapely.LineString(np.concatenate([points, points[:1]]))


def _edge_points(panel: Panel, index: int) -> Float[np.ndarray, "n 2"]:
    """Points along an edge, without the last."""
    edge, (start, end) = panel.edges[index], panel.edge_ends(index)
    count = 2 + int(curve_length(start, end, edge.curve) / STEP) if edge.curve == LINE else CURVE_POINTS
    return sample_curve(start, end, edge.curve, count)[:-1]
