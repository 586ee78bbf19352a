"""GarmentDiffusion's array (Li et al., 2025): 37 panels of 39 edges, each edge placed in space.

An edge is its start, its two control points, the parameters of an arc, the stitch tag and whether it has a seam: 16
numbers, named by ``TokenColumn``. Points are positions in space [cm]; there is no other placement. The authors
published the paper (arXiv 2504.21476) and no code: the order of the numbers is that of the paper's list, for patterns
with cubic curves, and the rows are not standardised.

Not held: the directions of a panel's axes in its plane, so that a decoded panel lies where it was but has a local frame
of its own; the plane of a panel whose corners lie in one line, as those of a half circle skirt: it is decoded upright,
facing outward; names and labels; which seams are ``right_wrong``. Quadratic curves become equal cubic ones.
"""

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Point, control_points, sample_curve, signed_area, to_frame
from gcd_dataset.encodings.rows import (
    control_of,
    loop_corners,
    pair_edges,
    require_finite,
    require_room,
    seam_ends,
    seam_tags,
    seams_of,
    spanning,
)
from gcd_dataset.errors import PatternError
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement
from gcd_dataset.spec import euler_angles

__all__ = ["WIDTH", "TokenColumn", "decode", "encode"]

MAX_PANELS, MAX_EDGES = 37, 39
LEAST_EDGES = 3  # a panel with fewer is padding
ABSENT = 3.0  # cm: a point this close to the origin, the middle of the ground, is none
IN_LINE = 1e-3  # share of the length of a row of points by which they may lie beside their line
SAMPLES = 9  # points of an edge, to tell the direction of an outline
FRONT = np.array([0.0, 0.0, 1.0])
LEAST_RADIUS = 0.5  # cm: a smaller radius is none


class TokenColumn(IntEnum):
    """Columns of the array; a name with several numbers is its first column."""

    START = 0
    """Position of the edge's start [cm]."""
    CONTROL0 = 3
    """First control point of a cubic curve [cm]; zeros for lines and arcs."""
    CONTROL1 = 6
    """Second control point [cm]."""
    RADIUS = 9
    """Of an arc [cm]; 0 for other edges."""
    LARGE = 10
    """1 for an arc longer than half a circle."""
    RIGHT = 11
    """1 for an arc that bulges to the right, seen from where the polygon of the corners runs counter-clockwise."""
    TAG = 12
    """Stitch tag [cm]; zeros for an edge without a seam."""
    SEWN = 15
    """1 for an edge with a seam."""


WIDTH = 16


def encode(
    pattern: Pattern, *, max_panels: int = MAX_PANELS, max_edges: int = MAX_EDGES
) -> Float[np.ndarray, "p e 16"]:
    """The pattern's panels, in their order, as GarmentDiffusion's array.

    Raises ``PatternError`` for too many panels or edges, an open loop or a seam to a missing edge.
    """
    pattern = pattern.without_lines()
    require_room(pattern, panels=max_panels, edges=max_edges, what="GarmentDiffusion's arrays")
    array = np.zeros((max_panels, max_edges, WIDTH))
    for number, panel in enumerate(pattern.panels):
        rows = array[number, : len(panel.edges)]
        rows[:, TokenColumn.START : TokenColumn.CONTROL0] = panel.placement.apply(loop_corners(panel))
        behind = _runs_clockwise(panel)
        for index, edge in enumerate(panel.edges):
            if isinstance(edge.curve, Arc):
                arc = edge.curve
                rows[index, TokenColumn.RADIUS : TokenColumn.TAG] = arc.radius, arc.large, arc.right != behind
            elif edge.curve != LINE:
                cubic = control_points(*panel.edge_ends(index), Cubic(*control_of(edge.curve)))[1:3]
                rows[index, TokenColumn.CONTROL0 : TokenColumn.RADIUS] = panel.placement.apply(np.array(cubic)).reshape(
                    -1
                )
    places = [(number, e) for number, panel in enumerate(pattern.panels) for e in range(len(panel.edges))]
    for ends, tag in zip(seam_ends(pattern), seam_tags(pattern), strict=True):
        for end in ends:
            array[places[end]][TokenColumn.TAG :] = (*tag, 1.0)
    return array


def decode(array: Float[np.ndarray, "p e 16"], name: str = "", *, names: Sequence[str] | None = None) -> Pattern:
    """The pattern of an array; seams join the edges with the nearest stitch tags.

    Each panel lies in the plane that fits its corners and control points best, its right side where the polygon of
    the corners runs counter-clockwise; y points up in the plane, or to the back in a level one. A row is no edge if its
    start lies within 3 cm of the origin. ``names``: of the panels (``panel_0``, … if ``None``). Raises
    ``PatternError`` for another shape, or values that are not finite.
    """
    if array.ndim != 3 or array.shape[2] != WIDTH:
        raise PatternError(
            f"GarmentDiffusion's array has shape {array.shape}, not (panels, edges, {WIDTH}): give one garment"
        )
    require_finite(array, "the array")
    panels, refs = list[Panel](), dict[int, EdgeRef]()
    for number, rows in enumerate(array):
        kept = np.flatnonzero(_present(rows[:, TokenColumn.START : TokenColumn.CONTROL0]))
        if len(kept) < LEAST_EDGES:
            continue
        title = f"panel_{number}" if names is None or number >= len(names) else names[number]
        panels.append(_panel(title, rows[kept]))
        refs |= {number * array.shape[1] + int(row): EdgeRef(title, i) for i, row in enumerate(kept)}
    flat = array.reshape(-1, WIDTH)
    tags, sewn = flat[:, TokenColumn.TAG : TokenColumn.SEWN], flat[:, TokenColumn.SEWN]
    pairs = pair_edges(cdist(tags, tags), sewn <= 0.5, -sewn)
    return Pattern(name, tuple(panels), seams_of(pairs, refs))


def _runs_clockwise(panel: Panel) -> bool:
    """Whether the polygon of the corners runs clockwise in the panel's plane; the outline, if they lie in one line."""
    loop = loop_corners(panel)
    if _in_line(loop):
        pieces = [sample_curve(*panel.edge_ends(i), edge.curve, SAMPLES)[:-1] for i, edge in enumerate(panel.edges)]
        loop = np.concatenate(pieces)
    return signed_area(loop) < 0


def _in_line(points: Float[np.ndarray, "n d"]) -> bool:
    spreads = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spreads[1] < IN_LINE * spreads[0])


def _present(points: Float[np.ndarray, "n 3"]) -> np.ndarray:
    return np.linalg.norm(points, axis=1) > ABSENT


def _panel(name: str, rows: Float[np.ndarray, "e 16"]) -> Panel:
    starts = rows[:, TokenColumn.START : TokenColumn.CONTROL0]
    controls = rows[:, TokenColumn.CONTROL0 : TokenColumn.RADIUS].reshape(-1, 2, 3)
    curved = _present(controls[:, 0]) & _present(controls[:, 1]) & (rows[:, TokenColumn.RADIUS] < LEAST_RADIUS)
    matrix = _frame(starts, controls[curved].reshape(-1, 3))
    origin = starts[0]
    vertices = (starts - origin) @ matrix[:, :2]
    ends = np.roll(vertices, -1, axis=0)
    flat = (controls - origin) @ matrix[:, :2]
    edges = []
    for index, row in enumerate(rows):
        start, end = _point(vertices[index]), _point(ends[index])
        curve: Curve = LINE
        if row[TokenColumn.RADIUS] >= LEAST_RADIUS:
            arc = Arc(
                float(row[TokenColumn.RADIUS]), bool(row[TokenColumn.LARGE] > 0.5), bool(row[TokenColumn.RIGHT] > 0.5)
            )
            curve = spanning(arc, float(np.hypot(end[0] - start[0], end[1] - start[1])))
        elif curved[index] and start != end:
            first, second = (to_frame(start, end, _point(point)) for point in flat[index])
            curve = Cubic(first, second)
        edges.append(Edge(index, (index + 1) % len(rows), curve))
    return Panel(name, vertices, tuple(edges), Placement(origin, euler_angles(matrix)))


def _frame(starts: Float[np.ndarray, "e 3"], controls: Float[np.ndarray, "c 3"]) -> Float[np.ndarray, "3 3"]:
    """Axes x, y and the right side of the plane of a panel, as columns."""
    points, middle = np.concatenate([starts, controls]), starts.mean(axis=0)
    axes = np.linalg.svd(points - points.mean(axis=0))[2]
    outward = middle * [1.0, 0.0, 1.0]
    if _in_line(points):
        across = outward if np.linalg.norm(outward) > ABSENT else FRONT
        normal = np.cross(np.cross(axes[0], across), axes[0])
        if np.linalg.norm(normal) < ABSENT / 100:  # the line points outward
            normal = np.cross(axes[0], np.array([0.0, 1.0, 0.0]))
        normal /= np.linalg.norm(normal)
    else:
        normal = axes[2]
    # The loop's area vector (Newell) points to the right side.
    loop = np.concatenate([starts, starts[:1]]) - middle
    side = outward if _in_line(starts) else np.cross(loop[:-1], loop[1:]).sum(axis=0)
    if normal @ side < 0:
        normal = -normal
    up = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < 0.999 else np.array([0.0, 0.0, -1.0])
    y = up - (up @ normal) * normal
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, normal), y, normal], axis=1)


def _point(values: np.ndarray) -> Point:
    return float(values[0]), float(values[1])
