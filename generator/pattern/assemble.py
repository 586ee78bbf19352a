"""From a component to a pattern: edges divided for their seams, loops turned outwards, corners numbered."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.component import Component
from gcd_dataset.generator.pattern.piece import Piece
from gcd_dataset.generator.pattern.seam import Interface, Join, shared_breaks
from gcd_dataset.generator.pattern.stroke import Stroke
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import panel_order

__all__ = ["MeasuredJoin", "assemble", "measure_joins", "panel_of", "sew"]


@dataclass(frozen=True, slots=True)
class _WalkedStroke:
    """A stroke of a piece as an interface walks it."""

    panel: str
    stroke: int
    backward: bool
    length: float
    """Projected: its length without the gathers [cm]."""


@dataclass(frozen=True, slots=True)
class _Part:
    """What is left of a stroke after dividing it: the ``part``-th piece in drawing order."""

    panel: str
    stroke: int
    part: int
    backward: bool


@dataclass(frozen=True, slots=True)
class MeasuredJoin:
    """A seam between two interfaces, and how long its sides are without their gathers."""

    join: Join
    left: float
    """[cm]"""
    right: float
    """[cm]"""


def assemble(component: Component, name: str) -> Pattern:
    """The finished pattern. Raises ``PatternError`` for a seam of an edge that is not there or is sewn already."""
    return sew(component, name)[0]


def sew(component: Component, name: str) -> tuple[Pattern, tuple[MeasuredJoin, ...]]:
    """The finished pattern, and the lengths of all that is sewn together in it. Raises as ``assemble`` does."""
    walks = [(_walk(component, join.left), _walk(component, join.right)) for join in component.joins]
    _require_sewn_once(component, walks)
    divisions = _divisions(walks)
    outward = {piece.name: piece.faces_out for piece in component.pieces}
    strokes = {piece.name: _divided(piece, divisions) for piece in component.pieces}
    panels = {piece.name: _panel(piece, strokes[piece.name], outward[piece.name]) for piece in component.pieces}
    places = {panel: _edge_numbers(parts, outward[panel]) for panel, parts in strokes.items()}
    seams = [
        _seam(left, right, places, outward)
        for walk_left, walk_right in walks
        for left, right in zip(_parts(walk_left, divisions), _parts(walk_right, divisions), strict=True)
    ]
    order = panel_order(tuple(panels.values()))
    return Pattern(name, tuple(panels[panel] for panel in order), tuple(seams)), _lengths(component, walks)


def measure_joins(component: Component) -> tuple[MeasuredJoin, ...]:
    """The lengths of all that is to be sewn. Raises ``PatternError`` for a seam of an edge that is not there."""
    return _lengths(
        component, [(_walk(component, join.left), _walk(component, join.right)) for join in component.joins]
    )


def _lengths(
    component: Component, walks: Sequence[tuple[list[_WalkedStroke], list[_WalkedStroke]]]
) -> tuple[MeasuredJoin, ...]:
    return tuple(
        MeasuredJoin(join, *(sum(stretch.length for stretch in side) for side in walk))
        for join, walk in zip(component.joins, walks, strict=True)
    )


def panel_of(piece: Piece) -> Panel:
    """The panel that the piece alone is: with no edge divided for a seam."""
    return _panel(piece, [(stroke,) for stroke in piece.outline.strokes], piece.faces_out)


def _walk(component: Component, interface: Interface) -> list[_WalkedStroke]:
    """The strokes of an interface in the order of its walk."""
    walk: list[_WalkedStroke] = []
    for section in interface:
        outline = component.piece(section.panel).outline
        outline.run(section.edge)  # so that a wrong name is an error
        found = [
            _WalkedStroke(section.panel, index, section.backward, stroke.length / section.ruffle)
            for index, stroke in enumerate(outline.strokes)
            if stroke.name == section.edge
        ]
        walk += reversed(found) if section.backward else found
    return walk


def _require_sewn_once(component: Component, walks: Sequence[tuple[list[_WalkedStroke], list[_WalkedStroke]]]) -> None:
    seen: set[tuple[str, int]] = set()
    for stretch in (stretch for sides in walks for side in sides for stretch in side):
        if (stretch.panel, stretch.stroke) in seen:
            edge = component.piece(stretch.panel).outline.strokes[stretch.stroke].name
            raise PatternError(f"edge {edge} of panel {stretch.panel} is sewn twice: name each edge in one seam only")
        seen.add((stretch.panel, stretch.stroke))


def _divisions(walks: Sequence[tuple[list[_WalkedStroke], list[_WalkedStroke]]]) -> dict[tuple[str, int], list[float]]:
    """Shares of their length, in drawing order, at which strokes are divided."""
    divisions: dict[tuple[str, int], list[float]] = {}
    for left, right in walks:
        shares_left, shares_right = shared_breaks([s.length for s in left], [s.length for s in right])
        for stretch, shares in (*zip(left, shares_left, strict=True), *zip(right, shares_right, strict=True)):
            drawn = [1 - share for share in reversed(shares)] if stretch.backward else shares
            divisions[stretch.panel, stretch.stroke] = drawn
    return divisions


def _divided(piece: Piece, divisions: Mapping[tuple[str, int], list[float]]) -> list[tuple[Stroke, ...]]:
    """The parts of every stroke of the piece, in drawing order."""
    shares = [divisions.get((piece.name, index)) for index in range(len(piece.outline.strokes))]
    return [stroke.split(s) if s else (stroke,) for stroke, s in zip(piece.outline.strokes, shares, strict=True)]


def _parts(walk: Sequence[_WalkedStroke], divisions: Mapping[tuple[str, int], list[float]]) -> list[_Part]:
    """The parts that an interface's strokes were divided into, in the order of its walk."""
    parts = []
    for stretch in walk:
        count = len(divisions[stretch.panel, stretch.stroke]) + 1
        order = reversed(range(count)) if stretch.backward else range(count)
        parts += [_Part(stretch.panel, stretch.stroke, part, stretch.backward) for part in order]
    return parts


def _edge_numbers(parts: Sequence[tuple[Stroke, ...]], outward: bool) -> dict[tuple[int, int], int]:
    """Place in the panel's loop of each part of each stroke."""
    keys = [(stroke, part) for stroke, pieces in enumerate(parts) for part in range(len(pieces))]
    return {key: place if outward else len(keys) - 1 - place for place, key in enumerate(keys)}


def _seam(
    left: _Part,
    right: _Part,
    places: Mapping[str, Mapping[tuple[int, int], int]],
    outward: Mapping[str, bool],
) -> Seam:
    """The seam of two parts; which of their ends meet follows from the walks and the turns of the loops."""
    refs = [EdgeRef(part.panel, places[part.panel][part.stroke, part.part]) for part in (left, right)]
    with_loop = [outward[part.panel] != part.backward for part in (left, right)]
    return Seam(refs[0], refs[1], right_wrong=with_loop[0] == with_loop[1])


def _panel(piece: Piece, parts: Sequence[tuple[Stroke, ...]], outward: bool) -> Panel:
    """The finished panel: its loop counter-clockwise from outside, its first corner the origin of its plane."""
    loop = [stroke for pieces in parts for stroke in pieces]
    if not outward:
        loop = [stroke.reversed() for stroke in reversed(loop)]
    corners = np.array([stroke.start for stroke in loop])
    edges = tuple(
        Edge(i, (i + 1) % len(loop), stroke.curve, stroke.label, stroke.name) for i, stroke in enumerate(loop)
    )
    rotation = np.array(piece.rotation) + 0.0  # a mirror image has angles of -0.0, which nobody wants in a file
    hung = Placement(np.array(piece.in_space(loop[0].start)), rotation)
    return Panel(piece.name, corners - corners[0], edges, hung, piece.label)
