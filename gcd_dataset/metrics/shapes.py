"""Outlines of panels for comparison: about the centroid, seen from the right side of the cloth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.curves import LINE, sample_curve, signed_area
from gcd_dataset.errors import PatternError
from gcd_dataset.records import Panel
from gcd_dataset.tensors import area_centroid, require_closed

CURVE_SAMPLES = 33  # points of a curved edge: an error of 1e-4 r for a quarter circle
LARGEST = 1e12  # cm: specification files hold no larger number
GAPS = (0.5, 10.0)  # cm: bounds of the cost of a corner without a match
NOISE = 2.0  # gaps for each cm between corners and their nearest corner: matched corners are less than two gaps apart


@dataclass(frozen=True, eq=False)
class PanelShape:
    """A panel's outline about its centroid, seen from the right side of the cloth, and its position in space."""

    panel: Panel
    centroid: Float[np.ndarray, "2"]
    """In the panel's own coordinates [cm]."""
    side: float
    """1; or -1 for a panel whose loop runs clockwise, drawn from its wrong side."""
    loop: Float[np.ndarray, "n 2"]
    """Counter-clockwise polyline of the outline about the centroid [cm]; starts at the first corner."""
    polygon: shapely.Geometry
    centre: Float[np.ndarray, "3"]
    """The centroid in space [cm]."""
    matrix: Float[np.ndarray, "3 3"]
    """The rotation of ``loop``'s plane."""

    @staticmethod
    def of(panel: Panel) -> "PanelShape":
        """The shape of a panel.

        Raises ``PatternError`` for an open loop, an arc that does not span its chord, and numbers that are not finite.
        """
        outline = _polyline(panel)
        centroid, side = area_centroid(panel), float(np.copysign(1.0, signed_area(outline)))
        loop = (outline - centroid) * [side, 1.0]
        return PanelShape(
            panel=panel,
            centroid=centroid,
            side=side,
            loop=loop,
            polygon=shapely.buffer(shapely.make_valid(shapely.Polygon(loop)), 0.0),
            centre=panel.placement.apply(centroid),
            matrix=panel.placement.matrix @ np.diag([side, 1.0, side]),
        )

    def seen(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Points of the panel's own coordinates about the centroid, as seen from the right side [cm]."""
        return (points - self.centroid) * [self.side, 1.0]


def resample_loop(
    loop: Float[np.ndarray, "n 2"], count: int, offsets: Float[np.ndarray, "*o"] | float = 0.0
) -> Float[np.ndarray, "*o count 2"]:
    """``count`` points equally spaced along a closed polyline; the first lies ``offsets`` after the polyline's start.

    Offsets are arc lengths in the unit of ``loop``; an array of offsets gives one set of points for each.
    """
    closed = np.concatenate([loop, loop[:1]])
    arc_length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    total = arc_length[-1]
    at = (np.asarray(offsets)[..., None] + np.arange(count) / count * total) % total if total else np.zeros(count)
    return np.stack([np.interp(at, arc_length, closed[:, axis]) for axis in (0, 1)], axis=-1)


def shape_or_none(panel: Panel) -> PanelShape | None:
    """The shape of a panel; ``None`` if it has no closed outline."""
    try:
        return PanelShape.of(panel)
    except PatternError:
        return None


@dataclass(frozen=True, eq=False)
class SampledOutline:
    """Arc lengths along an outline from its first corner, counter-clockwise from the right side of the cloth [cm]."""

    ends: Float[np.ndarray, "e 2"]
    """Start and end of every edge."""
    corners: Float[np.ndarray, "e 2"]
    """Start of every edge about the panel's centroid, seen from the right side [cm]."""
    length: float

    @staticmethod
    def of(shape: PanelShape) -> "SampledOutline":
        """The outline of a panel."""
        lengths = np.array(shape.panel.edge_lengths())
        reached = np.concatenate([[0.0], np.cumsum(lengths)])
        corners = shape.panel.vertices[[edge.start for edge in shape.panel.edges]]
        return SampledOutline(np.stack([reached[:-1], reached[1:]], axis=1), shape.seen(corners), float(reached[-1]))


@dataclass(frozen=True, eq=False)
class OutlineMap:
    """A monotone map between the arc lengths of two outlines, linear between matched corners."""

    source: Float[np.ndarray, " a"]
    """Increasing arc lengths; the last is the first, once round [cm]."""
    target: Float[np.ndarray, " a"]

    @staticmethod
    def between(predicted: SampledOutline, true: SampledOutline) -> "OutlineMap":
        """The map that sends the corners of the predicted outline to the true corners near them.

        Corners are matched in their cyclic order at least total distance (sequence alignment by dynamic programming). A
        corner without a match, such as the point of a subdivided edge, lies where the arc lengths of its neighbours
        put it. How far apart matched corners may be depends on the median error of the corners. Both outlines have a
        length.
        """
        distance = np.linalg.norm(predicted.corners[:, None] - true.corners[None], axis=2)
        first = np.unravel_index(distance.argmin(), distance.shape)
        turned = np.roll(distance, (-int(first[0]), -int(first[1])), axis=(0, 1))
        noise = min(float(np.median(distance.min(axis=axis))) for axis in (0, 1))
        pairs = np.array([(0, 0), *((i + 1, j + 1) for i, j in aligned(turned[1:, 1:], np.clip(NOISE * noise, *GAPS)))])
        ends = []
        for side, outline in enumerate((predicted, true)):
            at = np.roll(outline.ends[:, 0], -int(first[side]))[pairs[:, side]]
            at = at[0] + (at - at[0]) % outline.length
            ends.append(np.append(at, at[0] + outline.length))
        return OutlineMap(*ends)

    def apply(self, positions: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Positions on the true outline [cm], unwrapped: once round the one outline is once round the other."""
        length, target = self.source[-1] - self.source[0], self.target[-1] - self.target[0]
        turns = np.floor((positions - self.source[0]) / length)
        return np.interp(positions - turns * length, self.source, self.target) + turns * target


def aligned(distance: Float[np.ndarray, "n m"], gap: float) -> Sequence[tuple[int, int]]:
    """Pairs (row, column), both increasing, at least total cost: the distance of a pair, ``gap`` for each one left out.

    Needleman and Wunsch, J. Mol. Biol. 48 (1970).
    """
    rows, columns = distance.shape
    steps = gap * np.arange(columns + 1)
    cost = np.empty((rows + 1, columns + 1))
    cost[0] = steps
    for row in range(rows):
        reached = cost[row] + gap
        reached[1:] = np.minimum(reached[1:], cost[row, :-1] + distance[row])
        cost[row + 1] = steps + np.minimum.accumulate(reached - steps)
    pairs, row, column = [], rows, columns
    while row and column:
        here = cost[row, column]
        if np.isclose(here, cost[row - 1, column - 1] + distance[row - 1, column - 1], rtol=0, atol=1e-9):
            row, column = row - 1, column - 1
            pairs.append((row, column))
        elif np.isclose(here, cost[row - 1, column] + gap, rtol=0, atol=1e-9):
            row -= 1
        else:
            column -= 1
    return pairs[::-1]


def _polyline(panel: Panel) -> Float[np.ndarray, "n 2"]:
    """The outline with sampled curves. Raises ``PatternError`` if it is not one closed loop."""
    require_closed(panel)
    if not _usable(panel.vertices):
        raise PatternError(f"panel {panel.name}: a vertex is not finite or too large: correct its vertices")
    if not _usable(panel.placement.translation) or not _usable(panel.placement.rotation):
        raise PatternError(f"panel {panel.name}: its placement is not finite or too large: correct it")
    counts = [2 if edge.curve == LINE else CURVE_SAMPLES for edge in panel.edges]
    loop = np.concatenate(
        [sample_curve(*panel.edge_ends(row), edge.curve, counts[row])[:-1] for row, edge in enumerate(panel.edges)]
    )
    if len(loop) < 3:
        raise PatternError(f"panel {panel.name}: {len(loop)} straight edges: close the outline")
    if not _usable(loop):
        raise PatternError(f"panel {panel.name}: a curve is not finite or too large: correct its control points")
    return loop


def _usable(values: np.ndarray) -> bool:
    """Whether all values are finite and of a size that areas can be computed with."""
    return bool(np.all(np.abs(values) <= LARGEST))  # false for NaN
