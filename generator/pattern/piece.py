"""Pieces: panels under construction, with named edges and a placement round the body.

``assemble.py`` turns pieces into ``records.Panel``: it divides edges for their seams, turns loops counter-clockwise as
seen from outside, and numbers corners.

An interface is a walk along named edges, perhaps of several panels. A join sews two interfaces in the order of their
walks. Where only one side has a corner, the edge on the other side is divided, so that every seam of the finished
pattern joins one edge to one edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Self, TypeAlias

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.outline import Outline
from gcd_dataset.generator.pattern.stroke import Stroke, rotate
from gcd_dataset.records import Closure, PanelRole, Placement

EDGE_BY_EDGE = 0.05  # share of a seam: corners that differ by less are sewn to each other, GarmentCode
SAME_BREAK = 0.01  # share of a seam: breaks that differ by less count as one, GarmentCode
UNDER_HALF = 0.49  # fraction of the shortest edge: limit of SAME_BREAK, so that no break matches both ends of an edge


@dataclass(frozen=True, slots=True)
class Section:
    """One named edge of an interface, with all parts into which cuts have divided it."""

    panel: str
    edge: str
    backward: bool = False
    """Whether it is walked against its drawing direction."""
    ruffle: float = 1.0
    """Gathers: length of the edge over its projected length in the seam."""


Interface: TypeAlias = tuple[Section, ...]


@dataclass(frozen=True, slots=True)
class Join:
    """Two interfaces to sew together, walked in the same direction along the seam."""

    left: Interface
    right: Interface
    gathered: bool = False
    """Whether the longer side is gathered to the shorter; otherwise both should have the same length."""
    closure: Closure = Closure.SEWN
    closed: tuple[float, float] = (0.0, 1.0)
    """The part that is joined, from and to, as shares of the walk along ``left``."""


def backwards(interface: Interface) -> Interface:
    """The interface walked from its other end."""
    return tuple(Section(s.panel, s.edge, not s.backward, s.ruffle) for s in reversed(interface))


def shared_breaks(left: Sequence[float], right: Sequence[float]) -> tuple[list[list[float]], list[list[float]]]:
    """The breaks that divide the edges of two interfaces into equally many parts, from their projected lengths.

    Returns, for each edge of each side, the shares of its length at which to divide it. Breaks of the two sides closer
    than a hundredth of the seam (or nearly half its shortest edge) count as one.

    >>> shared_breaks([10.0, 10.0], [5.0, 15.0])
    ([[0.5], []], [[], [0.3333333333333333]])
    """
    breaks_left, breaks_right = _breaks(left), _breaks(right)
    if len(left) == len(right) and all(
        abs(a - b) <= EDGE_BY_EDGE for a, b in zip(breaks_left, breaks_right, strict=True)
    ):
        return [[] for _ in left], [[] for _ in right]
    tolerance = min(SAME_BREAK, UNDER_HALF * _shortest_share(left), UNDER_HALF * _shortest_share(right))
    missing_left = _missing(breaks_left, breaks_right, tolerance)
    missing_right = _missing(breaks_right, breaks_left, tolerance)
    return _divisions(breaks_left, missing_left), _divisions(breaks_right, missing_right)


def _breaks(lengths: Sequence[float]) -> list[float]:
    """Shares of the total length where one edge ends and the next begins."""
    total = sum(lengths)
    return [length / total for length in accumulate(lengths[:-1])]


def _shortest_share(lengths: Sequence[float]) -> float:
    return min(lengths) / sum(lengths)


def _missing(breaks: Sequence[float], others: Sequence[float], tolerance: float) -> list[float]:
    return [share for share in others if all(abs(share - known) > tolerance for known in breaks)]


def _divisions(breaks: Sequence[float], added: Sequence[float]) -> list[list[float]]:
    """The added breaks by the edge that they divide, as shares of its length."""
    bounds = [0.0, *breaks, 1.0]
    return [[(share - low) / (high - low) for share in added if low < share < high] for low, high in pairwise(bounds)]


Vector: TypeAlias = tuple[float, float, float]

UNTURNED: Vector = (0.0, 0.0, 0.0)

LYING_FLAT = 0.999  # cosine of the angle between a normal and the vertical: within 2.6 degrees


@dataclass(frozen=True, slots=True)
class Piece:
    """A closed outline with its placement before sewing and the part of the body it covers."""

    name: str
    outline: Outline
    translation: Vector = (0.0, 0.0, 0.0)
    """Position of the drawing's origin [cm]."""
    rotation: Vector = (0.0, 0.0, 0.0)
    """Angles about the fixed x, y, z axes, applied in that order [rad]."""
    label: PanelRole | str = ""
    """The part of the body it covers; empty if not decided yet."""
    lines: tuple[Stroke, ...] = ()
    """Lines inside the outline, each labelled with its ``LineRole``; interfaces name them as they name edges."""

    def __post_init__(self) -> None:
        if not self.outline.closed:
            raise PatternError(f"panel {self.name}: the outline is not closed")

    def at(self, x: float, y: float, z: float) -> Self:
        """Moved so that the origin of its drawing is at a point [cm]."""
        return type(self)(self.name, self.outline, (x, y, z), self.rotation, self.label, self.lines)

    def moved(self, by: Vector) -> Self:
        """Shifted in space [cm]."""
        x, y, z = self.translation
        return self.at(x + by[0], y + by[1], z + by[2])

    def turned(self, angle: float) -> Self:
        """Turned about the z axis through the world's origin [rad]."""
        x, y = rotate(self.translation[:2], angle)
        about_x, about_y, about_z = self.rotation
        turned = (about_x, about_y, about_z + angle)  # z is the last axis applied, so turns about it add up
        return type(self)(self.name, self.outline, (x, y, self.translation[2]), turned, self.label, self.lines)

    def mirrored(self, name: str) -> Self:
        """The mirror image about the plane x = 0, with a new name."""
        (x, y, z), (a, b, c) = self.translation, self.rotation
        lines = tuple(line.mirrored() for line in self.lines)
        return type(self)(name, self.outline.mirrored(), (-x, y, z), (a, -b, -c), self.label, lines)

    def labelled(self, label: PanelRole | str) -> Self:
        """With another label."""
        return type(self)(self.name, self.outline, self.translation, self.rotation, label, self.lines)

    def along(self, *edges: str, ruffle: float = 1.0) -> Interface:
        """The interface of these edges in turn, each in drawing direction; ``ruffle``: see ``Section``."""
        return tuple(Section(self.name, edge, ruffle=ruffle) for edge in edges)

    def against(self, *edges: str, ruffle: float = 1.0) -> Interface:
        """The interface of these edges in turn, each against its drawing direction; ``ruffle``: see ``Section``."""
        return tuple(Section(self.name, edge, backward=True, ruffle=ruffle) for edge in edges)

    @property
    def placement(self) -> Placement:
        """Translation and rotation as a record."""
        return Placement(np.array(self.translation), np.array(self.rotation))

    def in_space(self, point: Point) -> Vector:
        """A point of the drawing in space [cm]."""
        if self.rotation == UNTURNED:
            x, y, z = self.translation
            return (x + point[0], y + point[1], z)
        x, y, z = self.placement.apply(np.array(point)).tolist()
        return (x, y, z)

    @property
    def strokes(self) -> tuple[Stroke, ...]:
        """The strokes of the outline, then the lines."""
        return (*self.outline.strokes, *self.lines)

    def length(self, edge: str) -> float:
        """Length of the edge or line of that name, all parts together [cm]."""
        return sum(stroke.length for stroke in self._strokes(edge))

    def points(self, edge: str | None = None) -> Float[np.ndarray, "n 3"]:
        """Points along the outline, or along one edge, in space [cm]."""
        flat = np.concatenate([stroke.points() for stroke in self._strokes(edge)])
        if self.rotation == UNTURNED:
            return np.column_stack([flat, np.zeros(len(flat))]) + self.translation
        return self.placement.apply(flat)

    def bounds(self, edge: str | None = None) -> tuple[Vector, Vector]:
        """Lowest and highest corner of the bounding box of ``points`` [cm]."""
        if self.rotation != UNTURNED:
            points = self.points(edge)
            (x0, y0, z0), (x1, y1, z1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
            return (x0, y0, z0), (x1, y1, z1)
        lows, highs = zip(*(stroke.bounds() for stroke in self._strokes(edge)), strict=True)
        (x0, y0), (x1, y1) = map(min, zip(*lows, strict=True)), map(max, zip(*highs, strict=True))
        x, y, z = self.translation
        return (x0 + x, y0 + y, z), (x1 + x, y1 + y, z)

    def _strokes(self, edge: str | None) -> tuple[Stroke, ...]:
        if edge is None:
            return self.outline.strokes
        return tuple(line for line in self.lines if line.name == edge) or self.outline.run(edge)

    @property
    def faces_out(self) -> bool:
        """Whether the drawing is counter-clockwise as seen from outside the wearer.

        Outside is away from the vertical axis through the wearer, and above for a piece that lies flat. Raises
        ``PatternError`` for a piece that is seen edge-on from outside.
        """
        if self.rotation == UNTURNED:  # nearly all pieces: upright, in front or behind
            return self._runs_outwards(self.translation[2])
        placement = self.placement
        corners = placement.apply(np.array([stroke.start for stroke in self.outline.strokes]))
        centre, normal = corners.mean(axis=0), placement.matrix[:, 2]
        lies_flat = bool(abs(normal[1]) > LYING_FLAT)
        outward = float(normal[1] if lies_flat else normal[0] * centre[0] + normal[2] * centre[2])
        return self._runs_outwards(outward)

    def _runs_outwards(self, outward: float) -> bool:
        """Whether the drawing is counter-clockwise from outside; ``outward`` > 0 if its plane's normal points out."""
        if outward == 0.0:
            raise PatternError(f"panel {self.name} has no outer side: turn it, or move it off the wearer's axis")
        return (outward > 0) == (self.outline.area > 0)
