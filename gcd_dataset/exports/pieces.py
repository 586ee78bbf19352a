"""Cut pieces: a panel with sew line, cut line, notches, drill holes, grain line and labels, for cutters and printers.

All pieces lie with the right side of the cloth up: panels drawn with the wrong side up are mirrored. The sew line is
the panel's outline. The cut line lies ``seam_allowance`` outside of it, with mitred corners. It crosses the mouth of a
dart with a cap, so that the folded dart ends in the seam, and keeps to an edge labelled ``fold``. Both lines are
polylines, within 0.001 cm and 0.01 cm of their curves. Notches are match points: where seams meet along an edge, at
equal shares of the length of both edges of a long seam, and at the mouths of darts.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely.geometry.polygon import orient

from gcd_dataset.curves import LINE, Curve, Point, curve_tangents, mirrored, sample_curve
from gcd_dataset.errors import ConfigError, PatternError
from gcd_dataset.faults import require_valid
from gcd_dataset.generator.lay_plan import SheetPanel, lay_out
from gcd_dataset.records import Closure, Panel, Pattern, Record, Seam

FOLD = "fold"
"""Label of an edge at which the cloth is folded: it gets no allowance."""
TOLERANCE = 0.001  # cm between a curve and its polyline: areas of the narrowest panels are true to 0.05 %
CUT_TOLERANCE = 0.005  # cm, of the cut line
NEAR = 0.01  # cm: nearer points are one
LARGEST_ALLOWANCE = 10.0  # cm
GRID = 1e-6  # cm: a gap and the cut line beside it, which differ by roundings, become one
MITRE = 2.5  # reach of a mitred corner, in allowances; corners under 47° are bevelled
SMOOTH = np.radians(25.0)  # a corner with a smaller turn is a point along an edge
TURN = np.radians(12.0)  # a vertex of a cut line with a larger turn is a corner
SLIT, BARE_SLIT = 0.5, 0.3  # cm, depth of a notch: at most half the allowance, and without allowance
PAIR = 0.3  # cm from the centre of a double notch to each of its slits
APART = 0.25  # cm: notches nearer to each other are one
MARKED = (12.0, 30.0, 70.0)  # cm: from these lengths a seam has 1, 2, 3 notches between its ends
DRILL = 1.0  # cm from the tip of a dart to its drill hole
WIDEST_DART = 1.2  # mouth of a dart over its legs
CAP = 1.5  # reach of a dart's cap from the tip, over the length of its legs
MEASURED = 257  # points of an edge at which its length is measured
NAME_HEIGHT = 1.0  # cm that a name may take above and below its centre
GRAIN = 0.6  # length of the grain line, as a share of the room


@dataclass(frozen=True, eq=False)
class Notch(Record):
    """A slit in the seam allowance."""

    point: Float[np.ndarray, "2"]
    """On the cut line [cm]."""
    inward: Float[np.ndarray, "2"]
    """Unit vector into the cloth."""
    depth: float
    """[cm]"""


@dataclass(frozen=True, eq=False)
class EdgeText(Record):
    """The number of a seam beside the middle of its edge."""

    text: str
    point: Float[np.ndarray, "2"]
    """On the sew line [cm]."""
    inward: Float[np.ndarray, "2"]
    """Unit vector into the cloth."""
    room: float
    """Length of the edge [cm]."""


@dataclass(frozen=True, eq=False)
class CutPiece(Record):
    """A panel as it is cut, right side up, in the panel's plane or its mirror image [cm]; the grain runs along y."""

    panel: Panel
    """The panel, mirrored at the y axis if it was drawn with the wrong side up."""
    sew: Float[np.ndarray, "n 2"]
    """The sew line, closed, each point once, counter-clockwise."""
    sew_corner: Bool[np.ndarray, " n"]
    """Whether a point of the sew line is a corner of the panel."""
    cut: Float[np.ndarray, "m 2"]
    """The cut line, closed, each point once, counter-clockwise."""
    cut_corner: Bool[np.ndarray, " m"]
    notches: tuple[Notch, ...]
    drills: Float[np.ndarray, "d 2"]
    """Drill holes before the tips of darts."""
    folds: tuple[Float[np.ndarray, "2 2"], ...]
    """Ends of the edges at folds."""
    lines: tuple[Float[np.ndarray, "n 2"], ...]
    """Points along the lines inside the panel."""
    grain: Float[np.ndarray, "2 2"]
    """Ends of the grain line, lower end first."""
    name_at: Float[np.ndarray, "2"]
    """Centre of the room for the name."""
    name_room: float
    """Width of this room [cm]."""
    numbers: tuple[EdgeText, ...]
    """The number of the seam at each sewn edge."""

    @property
    def name(self) -> str:
        """Name of the panel."""
        return self.panel.name

    @property
    def box(self) -> Float[np.ndarray, "2 2"]:
        """Lower left and upper right corner of the cut line [cm]."""
        return np.stack([self.cut.min(axis=0), self.cut.max(axis=0)])


def cut_pieces(pattern: Pattern, *, seam_allowance: float = 1.0) -> tuple[CutPiece, ...]:
    """The cut pieces of a pattern, in the order of its panels.

    ``seam_allowance``: width of cloth beyond the sew line [cm]. Raises ``ConfigError`` for an allowance that is
    negative or over 10 cm, ``PatternError`` for a pattern that cannot be sewn.
    """
    if not 0.0 <= seam_allowance <= LARGEST_ALLOWANCE:
        raise ConfigError(f"a seam allowance of {seam_allowance:g} cm: give one from 0 to {LARGEST_ALLOWANCE:g} cm")
    require_valid(pattern, source=pattern.name)
    turned = tuple(
        _mirrored(sheet.panel) if sheet.orientation < 0 else sheet.panel for sheet in lay_out(pattern).panels
    )
    shown = replace(pattern, panels=turned)
    return tuple(_piece(sheet, shown, seam_allowance) for sheet in lay_out(shown).panels)


def _mirrored(panel: Panel) -> Panel:
    edges = tuple(replace(edge, curve=mirrored(edge.curve)) for edge in panel.edges)
    lines = tuple(replace(line, curve=mirrored(line.curve)) for line in panel.lines)
    return replace(panel, vertices=panel.vertices * [-1.0, 1.0], edges=edges, lines=lines)


def _piece(sheet: SheetPanel, pattern: Pattern, allowance: float) -> CutPiece:
    panel = sheet.panel
    edges = [edge_polyline(*panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges)]
    sew = np.concatenate([points[:-1] for points in edges])
    corner = np.concatenate([np.arange(len(points) - 1) == 0 for points in edges])
    darts = tuple(_darts(panel, pattern, edges))
    cut = _cut_line(panel, sew, edges, darts, allowance)
    (x, y), room = sheet.grain_position()
    half = 0.5 * GRAIN * room
    name_at, name_room = _beside_grain(*sheet.name_position(), x, (y - half, y + half))
    return CutPiece(
        panel=panel,
        sew=sew,
        sew_corner=corner,
        cut=cut,
        cut_corner=_turns(cut) > TURN,
        notches=_notches(panel, pattern, darts, cut, allowance),
        drills=np.array([dart.drill for dart in darts]).reshape(-1, 2),
        folds=tuple(np.array(panel.edge_ends(i)) for i, edge in enumerate(panel.edges) if edge.label == FOLD),
        lines=tuple(
            edge_polyline(*panel.edge_ends(i), line.curve) for i, line in enumerate(panel.lines, len(panel.edges))
        ),
        grain=np.array([[x, y - half], [x, y + half]]),
        name_at=name_at,
        name_room=name_room,
        numbers=tuple(_numbers(sheet)),
    )


def _beside_grain(
    centre: Float[np.ndarray, "2"], room: float, grain: float, span: tuple[float, float]
) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre and width of the larger part of the room for the name beside the grain line."""
    low, high = span
    left, right = centre[0] - 0.5 * room, centre[0] + 0.5 * room
    if not (left < grain < right and low - NAME_HEIGHT < centre[1] < high + NAME_HEIGHT):
        return centre, room
    left, right = (left, grain) if grain - left > right - grain else (grain, right)
    return np.array([0.5 * (left + right), centre[1]]), float(right - left)


def edge_polyline(start: Point, end: Point, curve: Curve) -> Float[np.ndarray, "n 2"]:
    """Points along an edge, ends included, such that the polyline is within ``TOLERANCE`` of the curve [cm]."""
    if curve == LINE:
        return np.array([start, end])
    count = 3
    while True:
        points = sample_curve(start, end, curve, 2 * count - 1)
        before, middle, after = points[:-1:2], points[1::2], points[2::2]
        if np.linalg.norm(middle - 0.5 * (before + after), axis=1).max() <= TOLERANCE:
            return points[::2]
        count = 2 * count - 1


# --------------------------------------------------------------------------------------------------------------- darts


@dataclass(frozen=True, eq=False)
class _CutDart(Record):
    """A wedge of the outline that is sewn shut."""

    first: Float[np.ndarray, "2"]
    """Mouth, where the outline enters the dart."""
    tip: Float[np.ndarray, "2"]
    second: Float[np.ndarray, "2"]
    """Mouth, where the outline leaves the dart."""
    edges: tuple[int, int]
    filling: Float[np.ndarray, "n 2"]
    """Outline of wedge and cap."""

    @property
    def drill(self) -> Float[np.ndarray, "2"]:
        to_mouth = 0.5 * (self.first + self.second) - self.tip
        depth = float(np.linalg.norm(to_mouth))
        return self.tip + to_mouth * min(DRILL, 0.25 * depth) / depth


def _darts(panel: Panel, pattern: Pattern, edges: list[Float[np.ndarray, "n 2"]]) -> Iterator[_CutDart]:
    """The darts of a panel: consecutive edges sewn together, with no cloth of the panel between them."""
    count, outline = len(edges), shapely.Polygon(np.concatenate([points[:-1] for points in edges]))
    for seam in pattern.seams:
        if not seam.left.panel == seam.right.panel == panel.name or not seam.is_plain:
            continue
        pair = (seam.left.edge, seam.right.edge)
        enter = next((i for i in pair if (i + 1) % count in pair), None)
        if enter is None or count < 4 or max(pair) >= count:
            continue
        leave = (enter + 1) % count
        first, tip, second = edges[enter][0], edges[enter][-1], edges[leave][-1]
        wedge = shapely.Polygon(np.concatenate([edges[enter], edges[leave][1:]]))
        legs = min(np.linalg.norm(first - tip), np.linalg.norm(second - tip))
        if not wedge.is_valid or wedge.area == 0.0 or np.linalg.norm(first - second) > WIDEST_DART * legs:
            continue
        if wedge.intersection(outline).area > 0.01 * wedge.area:  # cloth lies between the legs: a cone, not a dart
            continue
        cap = _cap(first, tip, second, _tangent(panel, enter - 1, 1.0), _tangent(panel, (leave + 1) % count, 0.0))
        filling = np.concatenate([edges[enter], edges[leave][1:], cap[None]])
        yield _CutDart(first, tip, second, (enter, leave), filling)


def _cap(
    first: Float[np.ndarray, "2"],
    tip: Float[np.ndarray, "2"],
    second: Float[np.ndarray, "2"],
    arriving: Float[np.ndarray, "2"],
    leaving: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "2"]:
    """The point on a dart's middle line to which its cloth reaches, so that it ends in the seam when folded over.

    Folded to one side, the cloth of the dart is the mirror image of half the wedge in the leg of this side: the cap is
    where the mirror image of the outline beyond that leg meets the middle line. The further of both sides is taken.
    """
    legs = np.stack([first - tip, second - tip])
    lengths = np.linalg.norm(legs, axis=1)
    leg = legs / lengths[:, None]
    middle = leg.sum(axis=0) / np.linalg.norm(leg.sum(axis=0))
    best, reach = 0.5 * (first + second), 0.0
    for mouth, along, outline in zip((first, second), leg, (-arriving, leaving), strict=True):
        mirrored = 2 * (outline @ along) * along - outline
        matrix = np.stack([middle, -mirrored], axis=1)
        if abs(np.linalg.det(matrix)) < 1e-3:
            continue
        distance, beyond = np.linalg.solve(matrix, mouth - tip)
        if beyond > 0 and reach < distance <= CAP * lengths.max():
            best, reach = tip + distance * middle, float(distance)
    return best


def _tangent(panel: Panel, edge: int, at: float) -> Float[np.ndarray, "2"]:
    """Unit tangent of an edge at a curve parameter."""
    (direction,) = curve_tangents(*panel.edge_ends(edge), panel.edges[edge].curve, np.array([at]))
    length = float(np.linalg.norm(direction))
    if length > 0.0:
        return direction / length
    start, end = np.array(panel.edge_ends(edge))  # a control point on the end
    return (end - start) / np.linalg.norm(end - start)


# ------------------------------------------------------------------------------------------------------------ cut line


def _cut_line(
    panel: Panel,
    sew: Float[np.ndarray, "n 2"],
    edges: list[Float[np.ndarray, "n 2"]],
    darts: tuple[_CutDart, ...],
    allowance: float,
) -> Float[np.ndarray, "m 2"]:
    cloth = shapely.union_all([shapely.Polygon(sew), *(shapely.Polygon(dart.filling).buffer(0) for dart in darts)])
    if allowance:
        cut = cloth.buffer(allowance, join_style="mitre", mitre_limit=MITRE)
        for edge, points in zip(panel.edges, edges, strict=True):
            if edge.label == FOLD:
                cut = cut.difference(_beyond(points, allowance))
        cloth = shapely.union_all([cut, cloth])
        if gaps := _narrow_gaps(cut, 0.5 * allowance):
            cloth = shapely.union_all([cloth, *gaps], grid_size=GRID)
    if not isinstance(cloth, shapely.Polygon):
        raise PatternError(f"panel {panel.name}: its cut line falls into parts: change the seam allowance")
    ring = orient(shapely.Polygon(cloth.exterior).simplify(CUT_TOLERANCE if allowance else 0.0)).exterior
    return np.array(ring.coords)[:-1]


def _beyond(fold: Float[np.ndarray, "n 2"], allowance: float) -> shapely.Polygon:
    """The cloth beyond a fold, to the reach of its corners."""
    start, end = fold[0], fold[-1]
    along = (end - start) / np.linalg.norm(end - start)
    reach = 1.01 * MITRE * allowance
    inner = [start - reach * along, *fold, end + reach * along]
    outward = reach * _outward(along)
    return shapely.Polygon([*inner, inner[-1] + outward, inner[0] + outward])


def _narrow_gaps(cut: shapely.Geometry, width: float) -> list[shapely.Geometry]:
    """Gaps of a cut line under twice ``width`` wide, such as the rest of a slit between two allowances."""
    closed = cut.buffer(width, join_style="mitre", mitre_limit=MITRE).buffer(-width, join_style="mitre")
    parts = shapely.get_parts(closed.difference(cut))
    return [part for part in parts.tolist() if not part.buffer(-2 * NEAR).is_empty]


def _turns(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Angle between the segments at each point of a closed polyline, 0 … π."""
    step = np.roll(points, -1, axis=0) - points
    heading = np.arctan2(step[:, 1], step[:, 0])
    return np.abs((heading - np.roll(heading, 1) + np.pi) % (2 * np.pi) - np.pi)


# ------------------------------------------------------------------------------------------------------------- notches


def _notches(
    panel: Panel,
    pattern: Pattern,
    darts: tuple[_CutDart, ...],
    cut: Float[np.ndarray, "m 2"],
    allowance: float,
) -> tuple[Notch, ...]:
    """The notches of a panel, without those that have no way out to the cut line."""
    ring = shapely.LinearRing(cut)
    depth = min(SLIT, 0.5 * allowance) if allowance else BARE_SLIT
    found: list[Notch] = []
    for point, outward, is_single in _match_points(panel, pattern, darts):
        reached = _way_out(point, outward, ring, allowance)
        if reached is None:
            continue
        if is_single and any(np.linalg.norm(reached - notch.point) < APART for notch in found):
            continue
        found.append(Notch(reached, -outward, depth))
    return tuple(found)


def _match_points(
    panel: Panel, pattern: Pattern, darts: tuple[_CutDart, ...]
) -> Iterator[tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], bool]]:
    """Points of the sew line with their outward unit normals, and whether the point is not part of a double notch."""
    in_dart = {edge for dart in darts for edge in dart.edges}
    for dart in darts:
        for mouth in (dart.first, dart.second):
            yield mouth, (mouth - dart.tip) / np.linalg.norm(mouth - dart.tip), True
    seams = [seam for seam in pattern.seams if seam.closure != Closure.OPEN]
    sewn = {ref.edge for seam in seams for ref in (seam.left, seam.right) if ref.panel == panel.name}
    edges = range(len(panel.edges))
    for before, after in pairwise([*edges, 0]):
        arriving, leaving = _tangent(panel, before, 1.0), _tangent(panel, after, 0.0)
        turn = np.arccos(np.clip(arriving @ leaving, -1.0, 1.0))
        if turn < SMOOTH and {before, after} & sewn and not {before, after} & in_dart:
            yield np.array(panel.edge_ends(after)[0]), _outward(arriving + leaving), True
    for seam in seams:
        for ref, flips in ((seam.left, False), (seam.right, not seam.right_wrong)):
            if ref.panel == panel.name and ref.edge in edges and ref.edge not in in_dart:
                yield from _balance_marks(panel, ref.edge, _shares(seam, pattern), flips)


def _shares(seam: Seam, pattern: Pattern) -> tuple[float, ...]:
    """Shares of the length of a seam's left edge at which it has notches; equal shares of both edges are sewn together.

    The first of several is a double notch, which tells the ends of the seam apart.
    """
    lengths = [pattern.panel(ref.panel).lengths()[ref.edge] for ref in (seam.left, seam.right)]
    count = sum(min(lengths) >= limit for limit in MARKED)
    return tuple((i + 1) / (count + 1) for i in range(count))


def _balance_marks(
    panel: Panel, edge: int, shares: tuple[float, ...], flips: bool
) -> Iterator[tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], bool]]:
    points = sample_curve(*panel.edge_ends(edge), panel.edges[edge].curve, MEASURED)
    reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for number, share in enumerate(shares):
        is_double = number == 0 and len(shares) > 1
        at = (1 - share if flips else share) * reached[-1]
        for offset in (-PAIR, PAIR) if is_double else (0.0,):
            here, ahead, behind = (_along(points, reached, at + offset + step) for step in (0.0, 0.05, -0.05))
            yield here, _outward(ahead - behind), not is_double


def _along(
    points: Float[np.ndarray, "n 2"], reached: Float[np.ndarray, " n"], distance: float
) -> Float[np.ndarray, "2"]:
    """The point of a polyline at a distance from its start [cm]."""
    return np.array([np.interp(distance, reached, points[:, 0]), np.interp(distance, reached, points[:, 1])])


def _outward(direction: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    """Unit normal to the right of a direction."""
    return np.array([direction[1], -direction[0]]) / np.linalg.norm(direction)


def _way_out(
    point: Float[np.ndarray, "2"], outward: Float[np.ndarray, "2"], ring: shapely.LinearRing, allowance: float
) -> Float[np.ndarray, "2"] | None:
    """Where a line from the sew line meets the cut line; ``None`` if it does not within twice the allowance."""
    if ring.distance(shapely.Point(point)) < NEAR:
        return point
    line = shapely.LineString([point, point + 2 * max(allowance, NEAR) * outward])
    crossing = line.intersection(ring)
    if crossing.is_empty:
        return None
    candidates = shapely.get_coordinates(crossing)
    return candidates[np.argmin(np.linalg.norm(candidates - point, axis=1))]


def _numbers(sheet: SheetPanel) -> Iterator[EdgeText]:
    panel = sheet.panel
    for edge, (seam, room) in enumerate(zip(sheet.seams, panel.lengths(), strict=True)):
        if seam is None:
            continue
        before, middle, after = sample_curve(*panel.edge_ends(edge), panel.edge(edge).curve, 3)
        yield EdgeText(str(seam), middle, -_outward(after - before), room)
