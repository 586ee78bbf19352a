"""What the encodings share: edges as vectors, the placement by a panel's top, stitch tags and their pairing.

Definitions follow the public code of NeuralTailor (Korosteleva and Lee, 2022), on which SewFormer, SewingLDM and
AIpparel build.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Line, Point, Quadratic, curve_points, to_frame
from gcd_dataset.errors import PatternError, shown
from gcd_dataset.records import Edge, EdgeRef, EdgeRole, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import euler_angles
from gcd_dataset.tensors import require_closed, seam_rows

GAP = 3.0  # cm in x and in y: a wider gap between the ends of an outline takes one more edge; pattern_converter.py
LARGEST = 1e12  # larger numbers have no place in a specification file
LEVEL = 1e-6  # cm: sides of a bounding box that hang this close count as equally high


@dataclass(frozen=True)
class Scaling:
    """The shift and scale with which a network standardises its values."""

    shift: tuple[float, ...]
    scale: tuple[float, ...]

    def apply(self, values: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n d"]:
        """Values of the pattern to those of the network."""
        return (values - np.array(self.shift)) / np.array(self.scale)

    def undo(self, values: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n d"]:
        """Values of the network to those of the pattern."""
        return values * np.array(self.scale) + np.array(self.shift)


# --------------------------------------------------------------------------------------------------------------- panels


def loop_corners(panel: Panel) -> Float[np.ndarray, "e 2"]:
    """Start of every edge, in the panel's plane [cm]. Raises ``PatternError`` for an open loop."""
    require_closed(panel)
    return panel.vertices[[edge.start for edge in panel.edges]]


def edge_vectors(panel: Panel) -> Float[np.ndarray, "e 2"]:
    """Step from start to end of every edge, in the panel's plane [cm]. Raises ``PatternError`` for an open loop."""
    corners = loop_corners(panel)
    return np.roll(corners, -1, axis=0) - corners


def top_of(corners: Float[np.ndarray, "e 2"], matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "2"]:
    """Middle of the side of the corners' bounding box that hangs highest, in the panel's plane [cm].

    Its position in space is the translation of a panel in these encodings. Of equally high sides the first of: upper,
    lower, right, left. ``matrix``: rotation of the panel.
    """
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    middles = np.array([[x, y1], [x, y0], [x1, y], [x0, y]])
    heights = middles @ matrix[1, :2]
    return middles[int(np.argmax(heights >= heights.max() - LEVEL))]


def quaternion(placement: Placement) -> Float[np.ndarray, "4"]:
    """The rotation as (x, y, z, w); its sign is that of the product of the three half turns, as in SciPy."""
    return Rotation.from_euler("xyz", placement.rotation).as_quat()


def placement_rows(pattern: Pattern, max_panels: int) -> tuple[Float[np.ndarray, "p 4"], Float[np.ndarray, "p 3"]]:
    """Quaternion (x, y, z, w) and top in space [cm] of each panel, padded with zeros."""
    turns, tops = np.zeros((max_panels, 4)), np.zeros((max_panels, 3))
    for row, panel in enumerate(pattern.panels):
        turns[row] = quaternion(panel.placement)
        tops[row] = panel.placement.apply(top_of(loop_corners(panel), panel.placement.matrix))
    return turns, tops


def edge_places(pattern: Pattern, max_edges: int) -> list[int]:
    """Row of every edge in arrays with ``max_edges`` rows a panel."""
    return [row * max_edges + edge for row, panel in enumerate(pattern.panels) for edge in range(len(panel.edges))]


def panel_from_vectors(
    name: str,
    steps: Float[np.ndarray, "e 2"],
    curves: Sequence[Curve],
    labels: Sequence[EdgeRole | str],
    turn: Float[np.ndarray, "4"],
    top: Float[np.ndarray, "3"],
) -> Panel:
    """The panel of edges drawn one after the other from (0, 0), hung by its top; see ``top_of``.

    The last edge ends at the first corner if it comes within ``GAP`` of it; else a straight edge closes the outline,
    as their count of edges assumes. An arc too small for its chord becomes a half circle. ``turn``: quaternion
    (x, y, z, w) of any length but 0. Raises ``PatternError``.
    """
    ends = np.cumsum(steps, axis=0)
    closes = bool(np.all(np.abs(ends[-1]) <= GAP))
    vertices = np.concatenate([np.zeros((1, 2)), ends[:-1] if closes else ends])
    count = len(vertices)
    chords = np.linalg.norm(np.roll(vertices, -1, axis=0) - vertices, axis=1).tolist()
    edges = [
        Edge(i, (i + 1) % count, spanning(curve, chords[i]), label)
        for i, (curve, label) in enumerate(zip(curves, labels, strict=True))
    ]
    if not closes:
        edges.append(Edge(count - 1, 0))
    if not np.linalg.norm(turn) > 0:
        raise PatternError(f"panel {shown(name)}: its quaternion is zero: give a rotation for each panel")
    matrix = Rotation.from_quat(turn).as_matrix()
    translation = top - matrix[:, :2] @ top_of(vertices, matrix)
    return Panel(name, vertices, tuple(edges), Placement(translation, euler_angles(matrix)))


# --------------------------------------------------------------------------------------------------------------- curves


def spanning(curve: Curve, chord: float) -> Curve:
    """The curve over a chord of this length [cm]; an arc with a radius under half of it becomes a half circle."""
    if not isinstance(curve, Arc) or curve.radius >= 0.5 * chord:
        return curve
    return replace(curve, radius=0.5 * chord)


def middle_of(start: Point, end: Point, curve: Curve) -> Point:
    """The point of the curve at half its parameter, in the edge frame."""
    x, y = curve_points(start, end, curve, np.array([0.5]))[0].tolist()
    return to_frame(start, end, (x, y))


def quadratic_through_middle(start: Point, end: Point, curve: Curve) -> Quadratic | Line:
    """The quadratic curve with the same ends and middle: exact for lines and quadratic curves."""
    if isinstance(curve, Line | Quadratic):
        return curve
    a, b = middle_of(start, end, curve)
    return Quadratic((2 * a - 0.5, 2 * b))


def control_of(curve: Curve) -> tuple[Point, Point]:
    """The control points of a curve as a cubic curve, in the edge frame; zeros for a line, exact for all but arcs."""
    match curve:
        case Quadratic((a, b)):
            return (2 / 3 * a, 2 / 3 * b), (1 / 3 + 2 / 3 * a, 2 / 3 * b)
        case Cubic(control0, control1):
            return control0, control1
        case _:
            return (0.0, 0.0), (0.0, 0.0)


def arc_through(start: Point, end: Point, middle: Point) -> Arc | Line:
    """The arc from start to end through its middle, given in the edge frame; a line if the three are in line.

    The middle of an arc lies on the perpendicular through the middle of the chord: only its distance from the chord is
    used, the sagitta h. The radius is (c²/4 + h²) / 2h for a chord c.
    """
    chord = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    sagitta = middle[1] * chord
    if chord == 0.0 or abs(sagitta) <= 1e-6 * chord:
        return LINE
    height = abs(sagitta)
    return Arc((chord * chord / 4 + height * height) / (2 * height), height > chord / 2, sagitta < 0)


# ------------------------------------------------------------------------------------------------------------- stitches


def seam_ends(pattern: Pattern) -> list[tuple[int, int]]:
    """The rows of the edges that each seam joins, edges counted over all panels. Raises ``PatternError``."""
    return [(left, right) for left, right, _ in seam_rows(pattern).tolist()]


def seam_tags(pattern: Pattern) -> Float[np.ndarray, "s 3"]:
    """Stitch tag of each seam: the mean of the middles of the chords of its two edges, in space [cm]."""
    middles = np.concatenate(
        [
            np.zeros((0, 3)),
            *(panel.placement.apply(loop_corners(panel) + 0.5 * edge_vectors(panel)) for panel in pattern.panels),
        ]
    )
    return np.array([middles[list(ends)].mean(axis=0) for ends in seam_ends(pattern)]).reshape(-1, 3)


def pair_edges(
    distances: Float[np.ndarray, "n n"], free: Bool[np.ndarray, " n"], freedom: Float[np.ndarray, " n"]
) -> list[tuple[int, int]]:
    """Pairs of the edges that are not ``free``: the nearest pair first, each edge once.

    Of an odd number the edge with the largest ``freedom`` score is left out, as in NeuralTailor. Ties go to the first
    pair in row order.
    """
    sewn = np.flatnonzero(~free)
    if len(sewn) % 2:
        sewn = np.delete(sewn, np.argmax(freedom[sewn]))
    first, second = np.triu_indices(len(sewn), 1)
    order = np.argsort(distances[np.ix_(sewn, sewn)][first, second], kind="stable")
    taken: set[int] = set()
    pairs = []
    for a, b in zip(sewn[first[order]].tolist(), sewn[second[order]].tolist(), strict=True):
        if a not in taken and b not in taken:
            taken |= {a, b}
            pairs.append((a, b))
    return pairs


def seams_of(
    pairs: Sequence[tuple[int, int]], refs: Mapping[int, EdgeRef], turned: Sequence[bool] | None = None
) -> tuple[Seam, ...]:
    """Seams between rows of arrays; ``refs`` gives the edge of a row, and pairs with a row without an edge are dropped.

    ``turned``: for each pair, whether its starts meet.
    """
    flags = [False] * len(pairs) if turned is None else turned
    return tuple(
        Seam(refs[a], refs[b], right_wrong=bool(flag))
        for (a, b), flag in zip(pairs, flags, strict=True)
        if a in refs and b in refs
    )


# --------------------------------------------------------------------------------------------------------------- checks


def require_room(pattern: Pattern, *, panels: int, edges: int, what: str) -> None:
    """Raise ``PatternError`` if a pattern has more panels, or a panel more edges, than an encoding holds."""
    if len(pattern.panels) > panels:
        raise PatternError(
            f"{shown(pattern.name)}: {len(pattern.panels)} panels, {what} hold {panels}: raise max_panels, or "
            "leave the garment out"
        )
    for panel in pattern.panels:
        if len(panel.edges) > edges:
            raise PatternError(
                f"{shown(pattern.name)}, panel {shown(panel.name)}: {len(panel.edges)} edges, {what} hold {edges}: "
                "raise max_edges, or leave the garment out"
            )


def require_finite(values: np.ndarray, what: str) -> None:
    """Raise ``PatternError`` with the first place where a value is not finite, or larger than ``LARGEST``."""
    bad = np.argwhere(~(np.abs(values) <= LARGEST))
    if len(bad):
        raise PatternError(f"{what}{bad[0].tolist()} is {values[tuple(bad[0])]}: give finite numbers up to {LARGEST:g}")
