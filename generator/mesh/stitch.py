"""Merge the points of panels into vertices along the seams."""

from dataclasses import dataclass, field
from math import ceil

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.curves import Line, curve_length, sample_curve
from gcd_dataset.errors import MeshError, PatternError
from gcd_dataset.generator.mesh.rows import distinct, stable_order
from gcd_dataset.records import EdgeRef, Panel, Pattern, Seam

MOST_POINTS = 1_500_000  # points of a pattern: the largest panel accepted, ten metres square, at 1 cm
ROUNDING = 1e-9  # fraction of the spacing: a 10 cm edge gets 11 points even if computed slightly longer


@dataclass(frozen=True)
class Border:
    """The outline of a panel as a closed loop of points, in the order of its edges; and the points of its lines."""

    points: Float[np.ndarray, "n 2"]
    """[cm]"""
    first: Int[np.ndarray, " e+1"]
    """The first point of each edge; the last entry is the number of points."""
    inner: Float[np.ndarray, "m 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    """Points of lines off the outline [cm], numbered after its own."""
    lines: tuple[Int[np.ndarray, " l"], ...] = ()
    """The points of each line from start to end, both included."""

    def edge(self, index: int) -> Int[np.ndarray, " m"]:
        """The points of an edge from start to end, both included; after the edges come the lines."""
        if index >= len(self.first) - 1:
            return self.lines[index - len(self.first) + 1]
        return np.arange(self.first[index], self.first[index + 1] + 1) % len(self.points)


def edge_counts(pattern: Pattern, spacing: float) -> dict[EdgeRef, int]:
    """Number of points on each edge and line, ends included: ``ceil(length / spacing) + 1`` of its seam's longer side.

    Raises ``MeshError`` for an edge without a finite length, an edge in two seams, and a seam of a missing edge.
    """
    counts = {
        EdgeRef(panel.name, index): _count(panel, index, spacing)
        for panel in pattern.panels
        for index in range(len(panel.edges) + len(panel.lines))
    }
    seam_of: dict[EdgeRef, int] = {}
    layered = [seam for seam in pattern.seams if pattern.layers(seam)]
    for number, seam in enumerate(pattern.seams):
        for side in (seam.left, seam.right):
            if side not in counts:
                raise MeshError(f"seam {number}: there is no edge {side.edge} of panel {side.panel}; correct the seam")
            if seam in layered:
                continue
            if side in seam_of:
                raise MeshError(
                    f"panel {side.panel}, edge {side.edge} is in seams {seam_of[side]} and {number}: "
                    "split the edge, so that each piece is in one seam"
                )
            seam_of[side] = number
        counts[seam.left] = counts[seam.right] = max(counts[seam.left], counts[seam.right])
    layers = {side for seam in layered for side in (seam.left, seam.right)}
    stack = [seam for seam in pattern.seams if {seam.left, seam.right} & layers]
    while any(counts[seam.left] != counts[seam.right] for seam in stack):
        for seam in stack:
            counts[seam.left] = counts[seam.right] = max(counts[seam.left], counts[seam.right])
    return counts


def sample_border(panel: Panel, counts: dict[EdgeRef, int]) -> Border:
    """The points of a panel's outline, equally spaced by arc length along each edge, each corner once.

    Raises ``MeshError`` for a panel without edges or with too many points, and for edges that do not close a loop.
    """
    if not panel.edges:
        raise MeshError(f"panel {panel.name} has no edges: draw its outline or remove the panel")
    sizes = [counts[EdgeRef(panel.name, index)] - 1 for index in range(len(panel.edges))]
    if (total := sum(sizes)) > MOST_POINTS:
        raise MeshError(
            f"panel {panel.name} would get {total:.3g} points along its edges, over {MOST_POINTS:,}: "
            "use a coarser spacing"
        )
    starts = [edge.start for edge in panel.edges]
    for index, (edge, following) in enumerate(zip(panel.edges, [*starts[1:], starts[0]], strict=True)):
        if edge.end != following:
            raise MeshError(f"panel {panel.name}: edge {index} does not end where the next begins; close the loop")
    # All edges at once as lines, which most are; then the curves.
    corners, number = panel.vertices[starts], np.repeat(np.arange(len(sizes)), sizes)
    first = np.cumsum([0, *sizes])
    share = ((np.arange(total) - first[number]) * (1.0 / np.array(sizes))[number])[:, None]
    points = (1.0 - share) * corners[number] + share * panel.vertices[[*starts[1:], starts[0]]][number] + 0.0
    points[first[:-1]] = corners
    for index, edge in enumerate(panel.edges):
        if not isinstance(edge.curve, Line):
            curve = sample_curve(*panel.edge_ends(index), edge.curve, sizes[index] + 1)
            points[first[index] : first[index + 1]] = curve[:-1]
    return Border(points, first, *_sample_lines(panel, counts, dict(zip(starts, first.tolist(), strict=False)), total))


def _sample_lines(
    panel: Panel, counts: dict[EdgeRef, int], place: dict[int, int], total: int
) -> tuple[Float[np.ndarray, "m 2"], tuple[Int[np.ndarray, " l"], ...]]:
    """The points of lines off the outline, numbered from ``total``, and the points of each line.

    ``place``: vertex to its point on the outline.
    """
    inner: list[Float[np.ndarray, "k 2"]] = [np.zeros((0, 2))]
    lines = []

    def added(points: Float[np.ndarray, "k 2"]) -> list[int]:
        inner.append(points)
        end = total + sum(map(len, inner))
        return list(range(end - len(points), end))

    for index, line in enumerate(panel.lines, len(panel.edges)):
        for vertex in (line.start, line.end):
            if vertex not in place:
                [place[vertex]] = added(panel.vertices[[vertex]])
        between = sample_curve(*panel.edge_ends(index), line.curve, counts[EdgeRef(panel.name, index)])[1:-1]
        lines.append(np.array([place[line.start], *added(between), place[line.end]]))
    return np.concatenate(inner), tuple(lines)


def _count(panel: Panel, index: int, spacing: float) -> int:
    try:
        length = curve_length(*panel.edge_ends(index), panel.edge(index).curve)
    except PatternError as error:
        raise MeshError(f"panel {panel.name}, edge {index}: {error}") from error
    if not 0.0 < length < np.inf:
        raise MeshError(f"panel {panel.name}, edge {index} has a length of {length} cm: remove it or move an end")
    return max(ceil(length / spacing - ROUNDING), 1) + 1


@dataclass(frozen=True)
class SewnPoints:
    """Pairs of points that meet in seams; ``m`` counts the pairs; below, ``c`` counts the points of all panels."""

    left: Int[np.ndarray, " m"]
    right: Int[np.ndarray, " m"]
    """The point that ``left`` is sewn to."""
    seam: Int[np.ndarray, " m"]
    """The seam of each pair, as its number in the pattern."""


def seam_name(number: int, seam: Seam) -> str:
    """A seam in messages: ``seam 3 (front edge 1 to back edge 2)``."""
    left, right = seam.left, seam.right
    return f"seam {number} ({left.panel} edge {left.edge} to {right.panel} edge {right.edge})"


def stitch_points(
    seams: tuple[Seam, ...], sides: list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]]
) -> SewnPoints:
    """The pairs of points that meet in the joined part of each seam, each in the order of its left edge.

    The ends of a joined part are moved to the nearest points; a part without two points joins nothing.
    ``sides``: the points of the left and right edge of each seam, both from start to end.
    """
    if not seams:
        return SewnPoints(*(np.zeros(0, int) for _ in range(3)))
    joined = [_joined_points(seam, len(side)) for seam, (side, _) in zip(seams, sides, strict=True)]
    left = [side[part] for part, (side, _) in zip(joined, sides, strict=True)]
    right = [
        (side if seam.right_wrong else side[::-1])[part]
        for seam, part, (_, side) in zip(seams, joined, sides, strict=True)
    ]
    seam = np.repeat(np.arange(len(seams)), [len(side) for side in left])
    return SewnPoints(np.concatenate(left), np.concatenate(right), seam)


def _joined_points(seam: Seam, count: int) -> slice:
    """The points in the joined part of a seam, of ``count`` along its left edge."""
    first, last = (round(min(max(share, 0.0), 1.0) * (count - 1)) for share in seam.joined)
    return slice(first, last + 1 if last > first else first)


def merge_points(sewn: SewnPoints, panel: Int[np.ndarray, " c"], seams: tuple[Seam, ...]) -> Int[np.ndarray, " c"]:
    """The vertex of every point: seam vertices first, in the order of the seams, then the rest in their own order.

    ``panel``: the panel of each point. Raises ``MeshError`` for a seam whose two ends become one vertex, and for a seam
    that joins two points of one panel, unless seams within that panel, such as darts, join them too.
    """
    group = _groups(len(panel), sewn.left, sewn.right)
    _require_open_seams(group, sewn, seams)
    _require_darts(group, sewn, panel, seams)
    free = np.ones(len(panel), bool)
    free[sewn.left] = free[sewn.right] = False
    order = group[np.concatenate([sewn.left, np.flatnonzero(free)])]
    place = np.arange(len(order))
    first = np.empty(len(panel), int)
    first[order[::-1]] = place[::-1]  # written backwards, so each group ends up with its first point
    begun = order[first[order] == place]
    vertex = np.empty(len(panel), int)
    vertex[begun] = np.arange(len(begun))
    return vertex[group]


def mean_positions(positions: Float[np.ndarray, "c 3"], vertex: Int[np.ndarray, " c"]) -> Float[np.ndarray, "v 3"]:
    """The mean of the points of each vertex."""
    members = np.bincount(vertex)
    return np.stack([np.bincount(vertex, column) / members for column in positions.T], axis=1)


def proper_faces(faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Flags of the faces with three different vertices."""
    a, b, c = faces.T
    return (a != b) & (b != c) & (c != a)


def _groups(n: int, a: Int[np.ndarray, " m"], b: Int[np.ndarray, " m"]) -> Int[np.ndarray, " c"]:
    """The connected component of each of n points under the pairs (a, b), as the number of its first point."""
    group = np.arange(n)
    while len(a):  # a few rounds: chains of seams are short
        np.minimum.at(group, np.maximum(group[a], group[b]), np.minimum(group[a], group[b]))
        while ((further := group[group]) != group).any():
            group = further
        apart = group[a] != group[b]
        a, b = a[apart], b[apart]
    return group


def _require_open_seams(group: Int[np.ndarray, " c"], sewn: SewnPoints, seams: tuple[Seam, ...]) -> None:
    """Raise ``MeshError`` for a seam whose two ends are one vertex."""
    starts = np.flatnonzero(np.diff(sewn.seam, prepend=-1))
    ends = np.flatnonzero(np.diff(sewn.seam, append=-1))
    closed = np.flatnonzero(group[sewn.left[starts]] == group[sewn.left[ends]])
    if len(closed):
        number = int(sewn.seam[starts[closed[0]]])
        raise MeshError(f"{seam_name(number, seams[number])}: its two ends fall together; split both edges in two")


def _require_darts(
    group: Int[np.ndarray, " c"], sewn: SewnPoints, panel: Int[np.ndarray, " c"], seams: tuple[Seam, ...]
) -> None:
    """Raise ``MeshError`` for points of one panel that become one vertex, but not by seams within that panel."""
    members = distinct(np.concatenate([sewn.left, sewn.right]), len(panel))
    place = panel[members] * len(panel) + group[members]
    order = stable_order(place)
    members, double = members[order], np.flatnonzero(np.diff(place[order]) == 0)
    if not len(double):
        return
    within = panel[sewn.left] == panel[sewn.right]
    explained = _groups(len(panel), sewn.left[within], sewn.right[within])[members]
    # All points of one panel in one vertex must be connected by the seams within the panel.
    double = double[explained[double] != explained[double + 1]]
    if len(double):
        first = members[double[0]]
        joined = (panel == panel[first]) & (group == group[first])
        pairs = np.flatnonzero(joined[sewn.left] | joined[sewn.right])
        number = int(sewn.seam[pairs[-1]])
        raise MeshError(
            f"{seam_name(number, seams[number])} joins two points of one panel that no dart joins: "
            "check its direction, or sew the edges between the points as a dart"
        )
