"""Assemble a component to a pattern: divide edges for their seams, orient loops, number corners."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import dist
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.component import Component
from gcd_dataset.generator.pattern.outline import CLOSED
from gcd_dataset.generator.pattern.piece import Interface, Join, Piece, shared_breaks
from gcd_dataset.generator.pattern.stroke import Stroke
from gcd_dataset.records import Edge, EdgeRef, InnerLine, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import panel_order

DIGITS = 12  # decimals of the joined share of a seam: 1 - 0.7 becomes 0.3


class _WalkedStroke(NamedTuple):
    """A stroke of a piece in the walk of an interface."""

    panel: str
    stroke: int  # its number in the piece's outline; lines follow
    backward: bool  # whether it is walked against its drawing direction
    length: float  # projected length: without the gathers [cm]


@dataclass(frozen=True, slots=True)
class MeasuredJoin:
    """A join with the projected lengths of its two sides."""

    join: Join
    left_length: float
    """Without the gathers [cm]."""
    right_length: float
    """Without the gathers [cm]."""


def assemble(component: Component, name: str) -> Pattern:
    """The finished pattern. Raises ``PatternError`` for a join on a missing or already sewn edge."""
    return assemble_and_measure(component, name)[0]


def assemble_and_measure(component: Component, name: str) -> tuple[Pattern, tuple[MeasuredJoin, ...]]:
    """The finished pattern, and its joins with their lengths. Raises as ``assemble`` does."""
    walks = _walks(component)
    _require_sewn_once(component, walks)
    divisions = _divisions(walks)
    outward = {piece.name: piece.faces_out for piece in component.pieces}
    strokes = {
        piece.name: [
            stroke.split(shares) if (shares := divisions.get((piece.name, index))) else (stroke,)
            for index, stroke in enumerate(piece.strokes)
        ]
        for piece in component.pieces
    }
    panels = {piece.name: _panel(piece, strokes[piece.name], outward[piece.name]) for piece in component.pieces}
    numbers: dict[str, dict[tuple[int, int], int]] = {}
    """Number of the edge in the panel's loop, and after the edges of the line, by (stroke, part)."""
    for piece in component.pieces:
        divided, in_loop = strokes[piece.name], len(piece.outline.strokes)
        keys = [(stroke, part) for stroke, own_parts in enumerate(divided) for part in range(len(own_parts))]
        if not outward[piece.name]:
            count = sum(map(len, divided[:in_loop]))
            keys = [*reversed(keys[:count]), *reversed(keys[count:])]
        numbers[piece.name] = {key: number for number, key in enumerate(keys)}
    seams = []
    for join, walk in zip(component.joins, walks, strict=True):
        closed = _closed_parts(join.closed, walk[0], divisions)
        for (start, end), *sides in zip(closed, *(_parts(side, divisions) for side in walk), strict=True):
            left, right = (EdgeRef(walked.panel, numbers[walked.panel][walked.stroke, part]) for walked, part in sides)
            # The walks and the directions of the loops decide which ends meet.
            with_loop = [outward[walked.panel] != walked.backward for walked, _ in sides]
            part = (start, end) if with_loop[0] else (round(1.0 - end, DIGITS), round(1.0 - start, DIGITS))
            seams.append(Seam(left, right, with_loop[0] == with_loop[1], join.closure, part))
    order = panel_order(tuple(panels.values()))
    return Pattern(name, tuple(panels[panel] for panel in order), tuple(seams)), _measured(component, walks)


def measure_joins(component: Component) -> tuple[MeasuredJoin, ...]:
    """The joins of a component with their lengths. Raises ``PatternError`` for a join on a missing edge."""
    return _measured(component, _walks(component))


def _measured(
    component: Component, walks: Sequence[tuple[list[_WalkedStroke], list[_WalkedStroke]]]
) -> tuple[MeasuredJoin, ...]:
    return tuple(
        MeasuredJoin(join, *(sum(walked.length for walked in side) for side in walk))
        for join, walk in zip(component.joins, walks, strict=True)
    )


def panel_of(piece: Piece) -> Panel:
    """The piece as a panel by itself, no edge divided for a seam."""
    return _panel(piece, [(stroke,) for stroke in piece.strokes], piece.faces_out)


def _walks(component: Component) -> list[tuple[list[_WalkedStroke], list[_WalkedStroke]]]:
    """The strokes of both sides of each join in the order of their walks."""
    edges: dict[tuple[str, str], list[tuple[int, Stroke]]] = {}
    for piece in component.pieces:
        for index, stroke in enumerate(piece.strokes):
            edges.setdefault((piece.name, stroke.name), []).append((index, stroke))

    def walk(interface: Interface) -> list[_WalkedStroke]:
        walked: list[_WalkedStroke] = []
        for section in interface:
            if (section.panel, section.edge) not in edges:
                component.piece(section.panel).outline.run(section.edge)  # raises ``PatternError`` with the known names
            found = edges[section.panel, section.edge]
            for index, stroke in reversed(found) if section.backward else found:
                length = stroke.length / section.ruffle
                walked.append(_WalkedStroke(section.panel, index, section.backward, length))
        return walked

    return [(walk(join.left), walk(join.right)) for join in component.joins]


def _require_sewn_once(component: Component, walks: Sequence[tuple[list[_WalkedStroke], list[_WalkedStroke]]]) -> None:
    """Raise ``PatternError`` for an edge in two joins.

    Layers of a stack are sewn to each other within their panel, and the uppermost one to another panel.
    """
    seen: set[tuple[str, int]] = set()
    across = (sides for sides in walks if len({walked.panel for side in sides for walked in side}) > 1)
    for walked in (walked for sides in across for side in sides for walked in side):
        if (walked.panel, walked.stroke) in seen:
            edge = component.piece(walked.panel).strokes[walked.stroke].name
            raise PatternError(f"edge {edge} of panel {walked.panel} is sewn twice: name each edge in one seam only")
        seen.add((walked.panel, walked.stroke))


def _divisions(walks: Sequence[tuple[list[_WalkedStroke], list[_WalkedStroke]]]) -> dict[tuple[str, int], list[float]]:
    """The breaks of each (panel, stroke): shares of the stroke's length, in drawing order."""
    divisions: dict[tuple[str, int], list[float]] = {}
    for left, right in walks:
        shares_left, shares_right = shared_breaks([s.length for s in left], [s.length for s in right])
        for walked, shares in (*zip(left, shares_left, strict=True), *zip(right, shares_right, strict=True)):
            in_drawing_order = [1 - share for share in reversed(shares)] if walked.backward else shares
            if divisions.setdefault((walked.panel, walked.stroke), in_drawing_order) != in_drawing_order:
                raise PatternError(
                    f"panel {walked.panel}: a seam divides a stack of pleats: move the pleats or its ends"
                )
    return divisions


def _parts(
    walk: Sequence[_WalkedStroke], divisions: Mapping[tuple[str, int], list[float]]
) -> list[tuple[_WalkedStroke, int]]:
    """The parts of an interface's divided strokes in the order of its walk: stroke, and number in drawing order."""
    parts = []
    for walked in walk:
        count = len(divisions[walked.panel, walked.stroke]) + 1
        order = reversed(range(count)) if walked.backward else range(count)
        parts += [(walked, part) for part in order]
    return parts


def _closed_parts(
    closed: tuple[float, float], walk: Sequence[_WalkedStroke], divisions: Mapping[tuple[str, int], list[float]]
) -> list[tuple[float, float]]:
    """The joined share of each part of a walk, in the direction of the walk."""
    parts = _parts(walk, divisions)
    if closed == (0.0, 1.0):
        return [closed] * len(parts)
    lengths = []
    for walked, part in parts:
        bounds = [0.0, *divisions[walked.panel, walked.stroke], 1.0]
        lengths.append(walked.length * (bounds[part + 1] - bounds[part]))
    ends = np.cumsum(lengths)
    shares = (np.clip((share * ends[-1] - ends + lengths) / lengths, 0.0, 1.0) for share in closed)
    first, last = (np.round(share, DIGITS).tolist() for share in shares)
    return list(zip(first, last, strict=True))


def _panel(piece: Piece, parts: Sequence[tuple[Stroke, ...]], outward: bool) -> Panel:
    """The finished panel: its loop counter-clockwise from outside, its first corner the origin of its plane."""
    count = len(piece.outline.strokes)
    loop, inner = ([part for own_parts in some for part in own_parts] for some in (parts[:count], parts[count:]))
    if not outward:
        loop, inner = ([stroke.reversed() for stroke in reversed(some)] for some in (loop, inner))
    corners = np.array([stroke.start for stroke in loop])
    after = [*range(1, len(loop)), 0]
    edges = tuple([Edge(i, after[i], stroke.curve, stroke.label, stroke.name) for i, stroke in enumerate(loop)])
    rotation = np.array(piece.rotation) + 0.0  # mirror images have angles of -0.0, which files should not show
    placement = Placement(np.array(piece.in_space(loop[0].start)), rotation)
    vertices, lines = _with_lines(corners, inner) if inner else (corners, ())
    return Panel(piece.name, vertices - corners[0], edges, placement, piece.label, lines)


def _with_lines(
    corners: Float[np.ndarray, "c 2"], inner: Sequence[Stroke]
) -> tuple[Float[np.ndarray, "v 2"], tuple[InnerLine, ...]]:
    """The corners with the further ends of the lines, and the lines; ends that meet a corner take its number."""
    points: list[Point] = [(x, y) for x, y in corners.tolist()]

    def number(point: Point) -> int:
        near = next((i for i, known in enumerate(points) if dist(known, point) <= CLOSED), None)
        if near is None:
            points.append(point)
        return len(points) - 1 if near is None else near

    lines = tuple(
        InnerLine(number(stroke.start), number(stroke.end), stroke.curve, stroke.label, stroke.angle, stroke.name)
        for stroke in inner
    )
    return np.array(points), lines
