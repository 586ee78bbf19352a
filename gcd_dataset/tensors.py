"""Encoding of a pattern as four plain arrays, for networks and storage, and decoding.

One row for each panel, edge, seam, closure of a seam and line inside a panel, in the order of the pattern; edges are
sorted by panel and loop, lines by panel. ``PanelColumn``, ``EdgeColumn``, ``StitchColumn``, ``ClosureColumn`` and
``LineColumn`` name the columns:

>>> from gcd_dataset.records import Edge, Panel, Pattern, Placement
>>> square = Panel("square", np.array([[0, 0], [9, 0], [9, 9], [0, 9]]), tuple(Edge(i, (i + 1) % 4) for i in range(4)),
...                Placement(np.array([1.0, 2.0, 3.0]), np.zeros(3)), label="body")
>>> tensor = encode_pattern(Pattern("napkin", (square,), ()))
>>> tensor.panels[0, [PanelColumn.X, PanelColumn.Y, PanelColumn.Z]].tolist()
[5.5, 6.5, 3.0]
>>> decode_pattern(tensor).panels == (square,)
True

Only the columns ``CENTROID_X`` and ``CENTROID_Y`` depend on a panel's local origin: points are relative to the centroid
of the panel's area, and the placement is the position of the centroid. Numbers are float64: a small error in the ends
of a nearly closed arc rotates the circle about them, and float32 would move its far side by millimetres.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.curves import (
    LINE,
    Arc,
    Cubic,
    Curve,
    Point,
    Quadratic,
    curve_points,
    curve_tangents,
    from_frame,
    to_frame,
)
from gcd_dataset.errors import PatternError, shown
from gcd_dataset.records import (
    Closure,
    Edge,
    EdgeRef,
    EdgeRole,
    InnerLine,
    LineRole,
    Panel,
    PanelRole,
    Pattern,
    Placement,
    Record,
    Seam,
    role_of,
)

__all__ = [
    "CLOSURES", "EDGE_LABELS", "LINE_ROLES", "PANEL_LABELS", "ClosureColumn", "CurveKind", "EdgeColumn", "LineColumn",
    "PanelColumn", "PatternTensor", "StitchColumn", "area_centroid", "decode_pattern", "encode_pattern",
    "require_closed",
]  # fmt: skip

PANEL_LABELS = ("", *(role.value for role in PanelRole))
"""Panel labels with the same number in every tensor; further labels are numbered after them."""
EDGE_LABELS = ("", *(role.value for role in EdgeRole))
"""Edge labels with the same number in every tensor; further labels are numbered after them."""
CLOSURES = tuple(Closure)
"""Closures with the same number in every tensor."""
LINE_ROLES = tuple(LineRole)
"""Roles of lines with the same number in every tensor."""

NO_AREA = 1e-6  # share of the squared extent: the area centroid of a flatter panel is ill-conditioned
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)  # exact to degree 31: a cubic's moments need 8


class PanelColumn(IntEnum):
    """Columns of ``PatternTensor.panels``."""

    X = 0
    """Position in space of the centroid of the panel's area [cm]: X, Y, Z."""
    Y = 1
    Z = 2
    QUATERNION_W = 3
    """The panel's rotation as a unit quaternion, W ≥ 0."""
    QUATERNION_X = 4
    QUATERNION_Y = 5
    QUATERNION_Z = 6
    ANGLE_X = 7
    """The same rotation as Euler angles, as in ``Placement`` [rad]."""
    ANGLE_Y = 8
    ANGLE_Z = 9
    CENTROID_X = 10
    """The centroid in the panel's own coordinates [cm]; decoding restores the local origin from it."""
    CENTROID_Y = 11
    N_EDGES = 12
    LABEL = 13
    """Row of ``panel_labels``."""


class EdgeColumn(IntEnum):
    """Columns of ``PatternTensor.edges``; points lie in the panel's plane, relative to its centroid [cm]."""

    PANEL = 0
    """Row of ``panels``."""
    VERTEX = 1
    """Index of the start among the panel's vertices; the edge ends at the start of the next edge."""
    START_X = 2
    START_Y = 3
    KIND = 4
    """``CurveKind``."""
    CONTROL0_X = 5
    """First control point; for an arc its midpoint; for a line 0."""
    CONTROL0_Y = 6
    CONTROL1_X = 7
    """Second control point of a cubic; otherwise 0."""
    CONTROL1_Y = 8
    RADIUS = 9
    """Radius of an arc [cm]; otherwise 0."""
    LARGE = 10
    """1 for an arc longer than half a circle."""
    RIGHT = 11
    """1 for an arc that bulges to the right of the edge's direction."""
    LABEL = 12
    """Row of ``edge_labels``."""


class StitchColumn(IntEnum):
    """Columns of ``PatternTensor.stitches``."""

    LEFT = 0
    """Row of ``edges``; numbers from the number of edges on are rows of ``lines``."""
    RIGHT = 1
    """As ``LEFT``."""
    RIGHT_WRONG = 2
    """1 if the starts of the two edges meet."""


class ClosureColumn(IntEnum):
    """Columns of ``PatternTensor.closures``."""

    KIND = 0
    """Row of ``CLOSURES``."""
    START = 1
    """Joined part of the seam, from and to, as shares of the length from the start of the left edge; of an open seam
    nothing is joined, whatever these numbers are."""
    END = 2


class LineColumn(IntEnum):
    """Columns of ``PatternTensor.lines``; the first twelve are those of ``EdgeColumn``."""

    PANEL = 0
    VERTEX = 1
    """Index of the start among the panel's vertices."""
    START_X = 2
    START_Y = 3
    KIND = 4
    CONTROL0_X = 5
    CONTROL0_Y = 6
    CONTROL1_X = 7
    CONTROL1_Y = 8
    RADIUS = 9
    LARGE = 10
    RIGHT = 11
    ROLE = 12
    """Row of ``LINE_ROLES``."""
    END = 13
    """Index of the end among the panel's vertices."""
    END_X = 14
    END_Y = 15
    ANGLE = 16
    """Rest angle of a fold [degrees]."""


COLUMNS: Mapping[str, type[IntEnum]] = {
    "panels": PanelColumn, "edges": EdgeColumn, "stitches": StitchColumn, "closures": ClosureColumn,
    "lines": LineColumn,
}  # fmt: skip
"""Array of ``PatternTensor`` to the names of its columns."""


class CurveKind(IntEnum):
    """Kinds of edge in ``EdgeColumn.KIND``."""

    LINE = 0
    QUADRATIC = 1
    CUBIC = 2
    ARC = 3


POSITION = slice(PanelColumn.X, PanelColumn.Z + 1)
QUATERNION = slice(PanelColumn.QUATERNION_W, PanelColumn.QUATERNION_Z + 1)
ANGLES = slice(PanelColumn.ANGLE_X, PanelColumn.ANGLE_Z + 1)
CENTROID = slice(PanelColumn.CENTROID_X, PanelColumn.CENTROID_Y + 1)
START = slice(EdgeColumn.START_X, EdgeColumn.START_Y + 1)
CONTROL0 = slice(EdgeColumn.CONTROL0_X, EdgeColumn.CONTROL0_Y + 1)
CONTROL1 = slice(EdgeColumn.CONTROL1_X, EdgeColumn.CONTROL1_Y + 1)
END = slice(LineColumn.END_X, LineColumn.END_Y + 1)
NO_LINES = np.zeros((0, len(LineColumn)))


@dataclass(frozen=True, eq=False)
class PatternTensor(Record):
    """A pattern as arrays, with the names and labels that the rows refer to."""

    panels: Float[np.ndarray, "p 14"]
    """Columns of ``PanelColumn``."""
    edges: Float[np.ndarray, "e 13"]
    """Columns of ``EdgeColumn``."""
    stitches: Int[np.ndarray, "s 3"]
    """Columns of ``StitchColumn``."""
    closures: Float[np.ndarray, "s 3"]
    """Columns of ``ClosureColumn``, of the same seams."""
    panel_names: tuple[str, ...]
    """Name of each row of ``panels``."""
    panel_labels: tuple[str, ...] = PANEL_LABELS
    edge_labels: tuple[str, ...] = EDGE_LABELS
    name: str = ""
    lines: Float[np.ndarray, "n 17"] = field(default_factory=NO_LINES.copy)
    """Columns of ``LineColumn``."""

    @property
    def loops(self) -> Int[np.ndarray, "p+1"]:
        """Rows of ``edges`` where each panel's loop starts; the last is the number of edges."""
        return np.concatenate([[0], np.cumsum(self.panels[:, PanelColumn.N_EDGES].astype(int))])


def encode_pattern(pattern: Pattern) -> PatternTensor:
    """The pattern as arrays, without ``extra``, edge names and unused vertices.

    Raises ``PatternError`` for an open loop, an arc that does not span its chord, a seam to a missing edge, or an
    unknown closure or role.
    """
    panel_labels = _table(PANEL_LABELS, (panel.label for panel in pattern.panels))
    edge_labels = _table(EDGE_LABELS, (edge.label for panel in pattern.panels for edge in panel.edges))
    panels = np.zeros((len(pattern.panels), len(PanelColumn)))
    loops, lines = [], []
    for panel in pattern.panels:
        require_closed(panel)
    for row, (panel, centroid) in enumerate(zip(pattern.panels, _area_centroids(pattern.panels), strict=True)):
        panels[row, POSITION] = panel.placement.apply(centroid)
        panels[row, QUATERNION] = _quaternion(panel.placement.rotation)
        panels[row, ANGLES] = panel.placement.rotation
        panels[row, CENTROID] = centroid
        panels[row, PanelColumn.N_EDGES] = len(panel.edges)
        panels[row, PanelColumn.LABEL] = panel_labels.index(panel.label)
        loops.append(_edge_rows(row, panel, centroid, edge_labels))
        lines.append(_line_rows(row, panel, centroid))
    return PatternTensor(
        panels=panels,
        edges=np.concatenate([np.zeros((0, len(EdgeColumn))), *loops]),
        stitches=seam_rows(pattern),
        closures=closure_rows(pattern),
        panel_names=tuple(panel.name for panel in pattern.panels),
        panel_labels=panel_labels,
        edge_labels=edge_labels,
        name=pattern.name,
        lines=np.concatenate([NO_LINES, *lines]),
    )


def decode_pattern(tensor: PatternTensor) -> Pattern:
    """The pattern of the arrays; encoding and decoding moves its outlines by less than 1e-4 cm.

    Raises ``PatternError`` for a wrong number of columns, or a reference to a missing row, label or vertex.
    """
    _require_sound(tensor)
    bounds = [(int(a), int(b)) for a, b in pairwise(tensor.loops)]
    panels = tuple(_panel(tensor, row, tensor.edges[first:last]) for row, (first, last) in enumerate(bounds))
    refs = edges_and_lines(panels)
    rows = zip(tensor.stitches.tolist(), tensor.closures.tolist(), strict=True)
    seams = tuple(
        Seam(refs[left], refs[right], bool(turned), CLOSURES[int(kind)], (start, end))
        for (left, right, turned), (kind, start, end) in rows
    )
    return Pattern(tensor.name, panels, seams)


def edges_and_lines(panels: Iterable[Panel]) -> list[EdgeRef]:
    """All edges, then all lines, of the panels: the rows that ``stitches`` refers to."""
    panels = tuple(panels)
    edges = [EdgeRef(panel.name, i) for panel in panels for i in range(len(panel.edges))]
    lines = [EdgeRef(panel.name, len(panel.edges) + i) for panel in panels for i in range(len(panel.lines))]
    return edges + lines


def area_centroid(panel: Panel) -> Float[np.ndarray, "2"]:
    """Centroid of the panel's area in its own coordinates [cm]; of its corners if it encloses no area.

    By Green's theorem: A = ∮ x dy, A x̄ = ∮ x²/2 dy, A ȳ = -∮ y²/2 dx, by quadrature edge by edge.
    """
    return _area_centroids([panel])[0]


def _area_centroids(panels: Sequence[Panel]) -> list[Float[np.ndarray, "2"]]:
    """``area_centroid`` of each panel: the edges of all panels at once, since each call of NumPy takes its time."""
    loops = [_straight_first(panel) for panel in panels]
    points, tangents = _at_nodes([edge for loop in loops for edge in loop])
    weights = np.tile(0.5 * WEIGHTS, max(map(len, loops), default=0))
    centroids, end = [], 0
    for panel, loop in zip(panels, loops, strict=True):
        rows = slice(end, end := end + len(loop))
        corners = panel.vertices[[edge.start for edge in panel.edges]]
        middle = corners.mean(axis=0)
        x, y = (points[rows].reshape(-1, 2) - middle).T
        dx, dy = weights[: len(x)] * tangents[rows].reshape(-1, 2).T
        area, moment = x @ dy, 0.5 * np.array([(x * x) @ dy, -(y * y) @ dx])
        flat = abs(area) <= NO_AREA * np.ptp(corners, axis=0).max() ** 2
        centroids.append(middle if flat else middle + moment / area)
    return centroids


def _straight_first(panel: Panel) -> list[tuple[Point, Point, Curve]]:
    """Start, end and curve of each edge, straight ones first."""
    edges = [(*panel.edge_ends(index), edge.curve) for index, edge in enumerate(panel.edges)]
    return sorted(edges, key=lambda edge: edge[2] != LINE)


def _at_nodes(edges: Sequence[tuple[Point, Point, Curve]]) -> tuple[np.ndarray, np.ndarray]:
    """Points and tangents of edges at the nodes of the quadrature [cm], each [e, nodes, 2]."""
    nodes = 0.5 * (NODES + 1)
    starts, ends = (np.array([edge[end] for edge in edges], float).reshape(-1, 1, 2) for end in (0, 1))
    tangents = np.repeat(ends - starts, len(nodes), axis=1)
    points = starts + nodes[:, None] * tangents
    for row, (start, end, curve) in enumerate(edges):
        if curve != LINE:
            points[row] = curve_points(start, end, curve, nodes)
            tangents[row] = curve_tangents(start, end, curve, nodes)
    return points, tangents


def require_closed(panel: Panel) -> None:
    """Raise ``PatternError`` with the first edge that does not start at the end of the edge before.

    Also for an edge or a line from or to a missing vertex.
    """
    if not panel.edges:
        raise PatternError(f"panel {panel.name}: no edges: draw its outline")
    drawn: tuple[Edge | InnerLine, ...] = (*panel.edges, *panel.lines)
    for index, edge in enumerate(drawn):
        is_line = index >= len(panel.edges)
        where = f"panel {panel.name}, " + (f"line {index - len(panel.edges)}" if is_line else f"edge {index}")
        if min(edge.start, edge.end) < 0 or max(edge.start, edge.end) >= len(panel.vertices):
            raise PatternError(f"{where}: no vertex {edge.start} or {edge.end}: correct its ends")
        if not is_line and panel.edges[index - 1].end != edge.start:
            raise PatternError(f"{where}: does not start where the edge before ends: join them")


def _table(known: tuple[str, ...], labels: Iterable[str]) -> tuple[str, ...]:
    """The known labels, followed by further ones in order of first use."""
    return tuple(dict.fromkeys((*known, *labels)))


def _edge_rows(row: int, panel: Panel, centroid: np.ndarray, labels: tuple[str, ...]) -> Float[np.ndarray, "e 13"]:
    starts, used = [edge.start for edge in panel.edges], _used_vertices(panel)
    rows = np.zeros((len(panel.edges), len(EdgeColumn)))
    rows[:, EdgeColumn.PANEL] = row
    rows[:, EdgeColumn.VERTEX] = [used[vertex] for vertex in starts]
    rows[:, START] = panel.vertices[starts] - centroid
    rows[:, EdgeColumn.LABEL] = [labels.index(edge.label) for edge in panel.edges]
    for index in [index for index, edge in enumerate(panel.edges) if edge.curve != LINE]:
        _describe_curve(rows[index], *panel.edge_ends(index), panel.edges[index].curve, centroid)
    return rows


def _line_rows(row: int, panel: Panel, centroid: np.ndarray) -> Float[np.ndarray, "n 17"]:
    rows, used = np.zeros((len(panel.lines), len(LineColumn))), _used_vertices(panel)
    for number, (line, entry) in enumerate(zip(panel.lines, rows, strict=True)):
        if line.role not in LINE_ROLES:
            raise PatternError(
                f"panel {panel.name}, line {number}: role {shown(line.role)}: give one of {', '.join(LINE_ROLES)}"
            )
        entry[LineColumn.PANEL], entry[LineColumn.ROLE] = row, LINE_ROLES.index(LineRole(line.role))
        entry[LineColumn.ANGLE] = line.angle
        entry[LineColumn.VERTEX], entry[LineColumn.END] = used[line.start], used[line.end]
        ends = panel.edge_ends(len(panel.edges) + number)
        entry[START], entry[END] = np.array(ends) - centroid
        _describe_curve(entry, *ends, line.curve, centroid)
    return rows


def _used_vertices(panel: Panel) -> dict[int, int]:
    """The number of each vertex among those that edges and lines use."""
    used = {edge.start for edge in panel.edges} | {end for line in panel.lines for end in (line.start, line.end)}
    return {vertex: number for number, vertex in enumerate(sorted(used))}


def _describe_curve(
    entry: Float[np.ndarray, " n"], start: Point, end: Point, curve: Curve, centroid: np.ndarray
) -> None:
    """Fill the columns of an edge or a line that describe its curve."""
    match curve:
        case Quadratic(control):
            entry[EdgeColumn.KIND] = CurveKind.QUADRATIC
            entry[CONTROL0] = from_frame(start, end, control) - centroid
        case Cubic(control0, control1):
            entry[EdgeColumn.KIND] = CurveKind.CUBIC
            entry[CONTROL0] = from_frame(start, end, control0) - centroid
            entry[CONTROL1] = from_frame(start, end, control1) - centroid
        case Arc(radius, large, right):
            entry[EdgeColumn.KIND] = CurveKind.ARC
            entry[CONTROL0] = curve_points(start, end, curve, np.array([0.5]))[0] - centroid
            entry[EdgeColumn.RADIUS : EdgeColumn.RIGHT + 1] = radius, large, right


def seam_rows(pattern: Pattern) -> Int[np.ndarray, "s 3"]:
    """The stitches of a pattern, in the columns of ``StitchColumn``. Raises ``PatternError`` for a missing edge."""
    row_of = {ref: row for row, ref in enumerate(edges_and_lines(pattern.panels))}
    for number, seam in enumerate(pattern.seams):
        for side in (seam.left, seam.right):
            if side not in row_of:
                raise PatternError(f"seam {number}: panel {side.panel} has no edge {side.edge}: correct the seam")
    rows = [(row_of[seam.left], row_of[seam.right], seam.right_wrong) for seam in pattern.seams]
    return np.array(rows, int).reshape(-1, len(StitchColumn))


def closure_rows(pattern: Pattern) -> Float[np.ndarray, "s 3"]:
    """The closures of a pattern, in the columns of ``ClosureColumn``. Raises ``PatternError`` for an unknown one."""
    rows = sewn_rows(len(pattern.seams))
    for number, seam in enumerate(pattern.seams):
        if seam.closure not in CLOSURES:
            raise PatternError(f"seam {number}: closure {shown(seam.closure)}: give one of {', '.join(CLOSURES)}")
        rows[number] = CLOSURES.index(Closure(seam.closure)), *seam.closed
    return rows


def sewn_rows(count: int) -> Float[np.ndarray, "s 3"]:
    """``closure_rows`` of seams that are sewn from end to end."""
    return np.tile([0.0, 0.0, 1.0], (count, 1))


def _quaternion(rotation: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4"]:
    """(w, x, y, z) of ``Rz Ry Rx``, w ≥ 0."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.asarray(rotation) / 2), np.sin(np.asarray(rotation) / 2)
    quaternion = np.array(
        [
            cz * cy * cx + sz * sy * sx,
            cz * cy * sx - sz * sy * cx,
            cz * sy * cx + sz * cy * sx,
            sz * cy * cx - cz * sy * sx,
        ]
    )
    return -quaternion if quaternion[0] < 0 else quaternion


def _require_sound(tensor: PatternTensor) -> None:
    for name, columns in COLUMNS.items():
        shape = getattr(tensor, name).shape
        if len(shape) != 2 or shape[1] != len(columns):
            raise PatternError(f"{name} has shape {shape}, not (n, {len(columns)}): see {columns.__name__}")
    if len(tensor.closures) != len(tensor.stitches):
        raise PatternError(f"{len(tensor.closures)} closures for {len(tensor.stitches)} stitches: give one each")
    if len(tensor.panel_names) != len(tensor.panels):
        raise PatternError(f"{len(tensor.panel_names)} panel names for {len(tensor.panels)} panels: give one each")
    if tensor.loops[-1] != len(tensor.edges):
        raise PatternError(
            f"N_EDGES adds up to {tensor.loops[-1]}, but there are {len(tensor.edges)} edges: correct N_EDGES"
        )
    most_vertices = len(tensor.edges) + 2 * len(tensor.lines)
    numbered = (
        (
            tensor.stitches[:, : StitchColumn.RIGHT + 1],
            len(tensor.edges) + len(tensor.lines),
            "stitches refer to edges",
        ),
        (tensor.closures[:, ClosureColumn.KIND], len(CLOSURES), "closures refer to kinds"),
        (tensor.panels[:, PanelColumn.LABEL], len(tensor.panel_labels), "panels refer to labels"),
        (tensor.edges[:, EdgeColumn.LABEL], len(tensor.edge_labels), "edges refer to labels"),
        (tensor.edges[:, EdgeColumn.KIND], len(CurveKind), "edges refer to kinds"),
        (tensor.edges[:, EdgeColumn.VERTEX], most_vertices, "edges refer to vertices"),
        (tensor.lines[:, LineColumn.PANEL], len(tensor.panels), "lines refer to panels"),
        (tensor.lines[:, LineColumn.ROLE], len(LINE_ROLES), "lines refer to roles"),
        (tensor.lines[:, LineColumn.KIND], len(CurveKind), "lines refer to kinds"),
        (tensor.lines[:, [LineColumn.VERTEX, LineColumn.END]], most_vertices, "lines refer to vertices"),
    )
    if np.isinf(tensor.panels[:, ANGLES].astype(float)).any():
        raise PatternError("an angle of a panel is infinite: correct the rows")
    for numbers, count, what in numbered:
        if numbers.size and not 0 <= numbers.min() <= numbers.max() < count:
            raise PatternError(
                f"{what} {numbers.min():g} to {numbers.max():g}, but there are {count}: correct the rows"
            )


def _panel(tensor: PatternTensor, row: int, loop: Float[np.ndarray, "n 13"]) -> Panel:
    numbers = tensor.panels[row].astype(float)
    placement = Placement(np.zeros(3), numbers[ANGLES])
    placement = Placement(numbers[POSITION] - placement.apply(numbers[CENTROID]), numbers[ANGLES])
    corner = loop[:, EdgeColumn.VERTEX].astype(int).tolist()
    lines = tensor.lines[tensor.lines[:, LineColumn.PANEL] == row].astype(float)
    ends = lines[:, [LineColumn.VERTEX, LineColumn.END]].astype(int)
    vertices = np.zeros((max((*corner, *ends.ravel().tolist()), default=-1) + 1, 2))
    for vertex, points in ((ends[:, 0], lines[:, START]), (ends[:, 1], lines[:, END]), (corner, loop[:, START])):
        vertices[vertex] = points + numbers[CENTROID]
    edges = tuple(
        Edge(
            start,
            end,
            _curve(entry, vertices[start], vertices[end], numbers[CENTROID]),
            role_of(EdgeRole, tensor.edge_labels[int(entry[EdgeColumn.LABEL])]),
        )
        for entry, start, end in zip(loop, corner, corner[1:] + corner[:1], strict=True)
    )
    label = role_of(PanelRole, tensor.panel_labels[int(numbers[PanelColumn.LABEL])])
    drawn = tuple(
        InnerLine(
            start,
            end,
            _curve(entry, vertices[start], vertices[end], numbers[CENTROID]),
            LINE_ROLES[int(entry[LineColumn.ROLE])],
            float(entry[LineColumn.ANGLE]),
        )
        for entry, (start, end) in zip(lines, ends.tolist(), strict=True)
    )
    return Panel(tensor.panel_names[row], vertices, edges, placement, label, drawn)


def _curve(entry: Float[np.ndarray, " n"], start: np.ndarray, end: np.ndarray, centroid: np.ndarray) -> Curve:
    def framed(columns: slice) -> tuple[float, float]:
        return to_frame(_point(start), _point(end), _point(entry[columns] + centroid))

    match CurveKind(int(entry[EdgeColumn.KIND])):
        case CurveKind.QUADRATIC:
            return Quadratic(framed(CONTROL0))
        case CurveKind.CUBIC:
            return Cubic(framed(CONTROL0), framed(CONTROL1))
        case CurveKind.ARC:
            return Arc(float(entry[EdgeColumn.RADIUS]), bool(entry[EdgeColumn.LARGE]), bool(entry[EdgeColumn.RIGHT]))
        case _:
            return LINE


def _point(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])
