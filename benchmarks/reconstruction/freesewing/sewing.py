"""A FreeSewing drawing and its seams as a ``Pattern`` placed round the body.

FreeSewing's curves are cubic Béziers, so no outline is approximated. Edges are divided where the other side of their
seam has a corner, so that every seam joins two edges.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any, TypeAlias

import numpy as np

from benchmarks.reconstruction.freesewing.designs import Cut, Design, Piece, Side
from gcd_dataset.curves import Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.stroke import Stroke
from gcd_dataset.records import Edge, EdgeRef, Panel, PanelRole, Pattern, Placement, Seam
from gcd_dataset.spec import euler_angles

MILLIMETRE = 0.1  # cm
SAME = 0.01  # cm: points closer than this are one
NEAR = 0.5  # cm: corners of the two sides of a seam closer than this meet, and neither side is divided there
HALVED = " /2"
AWAY = 30.0  # cm from the body's middle to the panels before and behind it
ABOVE = 8.0  # cm from the middle of the shoulder joint up to a sleeve
DROP = 5.0  # cm from the highest point of the shoulder down to its end
ARM_ANGLE = np.radians(40.0)  # of the arms below the horizontal

PartKey: TypeAlias = tuple[str, int, int]
"""Panel, stroke, and part of the divided stroke."""


@dataclass(frozen=True)
class Outline:
    """The closed outline of a panel, counter-clockwise, with the names of its corners."""

    strokes: tuple[Stroke, ...]
    corners: Mapping[str, Point]

    def stretch(self, start: str, end: str) -> tuple[list[int], bool]:
        """Numbers of the strokes from one corner to another the shorter way, and whether they run backwards."""
        count = len(self.strokes)
        first, last = self._number(start), self._number(end)
        ahead = [(first + k) % count for k in range((last - first) % count)]
        behind = [(first - 1 - k) % count for k in range((first - last) % count)]
        lengths = [sum(self.strokes[k].length for k in numbers) for numbers in (ahead, behind)]
        backwards = lengths[1] < lengths[0]
        return (behind if backwards else ahead), backwards

    def _number(self, corner: str) -> int:
        if corner not in self.corners:
            raise PatternError(f"no corner {corner}: there are {', '.join(self.corners)}")
        at = self.corners[corner]
        for number, stroke in enumerate(self.strokes):
            if _apart(stroke.start, at) < SAME:
                return number
        raise PatternError(f"corner {corner} does not lie on the outline: name a corner of the outline")


@dataclass(frozen=True)
class Cuts:
    """One side of a seam: strokes of panels in order, with their direction."""

    strokes: tuple[tuple[str, int, bool], ...]
    """(panel, stroke, whether it runs against the panel's outline)."""
    halved: bool
    """Whether the other side is divided at half of this side's length."""

    @property
    def where(self) -> frozenset[tuple[str, int]]:
        """The strokes, whatever their direction."""
        return frozenset((panel, number) for panel, number, _ in self.strokes)


def pattern_of_drawing(name: str, design: Design, drawing: Mapping[str, Any]) -> Pattern:
    """The pattern of a drawing, an output line of ``draw.mjs``.

    Raises ``PatternError`` for a missing part or corner, an open outline, or a seam that would join right to wrong
    side.
    """
    try:
        parts = drawing["parts"]
        outlines = {panel: outline for piece in design.pieces for panel, outline in _panels(piece, design, parts)}
        seams = [_sides(seam, design, outlines) for seam in _both_halves(design)]
        places = {
            panel: (_place(panel, outline, design, drawing["measurements"]), _role(panel, design))
            for panel, outline in outlines.items()
        }
        return _sewn(name, outlines, places, seams)
    except PatternError as error:
        raise PatternError(f"{name}: {error}") from error


# ------------------------------------------------------------------------------------------------------------- outlines


def _panels(name: str, design: Design, parts: Mapping[str, Any]) -> list[tuple[str, Outline]]:
    piece = design.pieces[name]
    if piece.part not in parts:
        raise PatternError(f"part {piece.part} was not drawn: there are {', '.join(parts)}")
    drawn = _drawn(parts[piece.part])
    match piece.cut:
        case Cut.ONE:
            return [(name, _turned(drawn))]
        case Cut.PAIR:
            return [(name, _turned(drawn)), (f"~{name}", _turned(_mirrored(drawn)))]
        case Cut.FOLD:
            return [(name, _turned(_unfolded(drawn, piece)))]


def _drawn(part: Mapping[str, Any]) -> Outline:
    """The outline of a part [cm, y up]; strokes without length are left out."""
    corners = {name: _point(x, y) for name, (x, y) in part["points"].items() if x is not None and y is not None}
    strokes: list[Stroke] = []
    pen: Point | None = None
    for kind, *numbers in part["path"]:
        points = [_point(*pair) for pair in zip(numbers[::2], numbers[1::2], strict=True)]
        if points and pen is not None and _apart(pen, points[-1]) > SAME and kind != "move":
            strokes.append(Stroke(pen, points[-1]).through([pen, *points]))
        pen = points[-1] if points and (pen is None or _apart(pen, points[-1]) > SAME) else pen
    if not strokes:
        raise PatternError("a part has no outline: it was not drawn")
    if _apart(strokes[-1].end, strokes[0].start) > SAME:
        strokes.append(Stroke(strokes[-1].end, strokes[0].start))
    return Outline(tuple(strokes), corners)


def _point(x: float, y: float) -> Point:
    return MILLIMETRE * x, -MILLIMETRE * y


def _mirrored(outline: Outline) -> Outline:
    corners = {name: (-x, y) for name, (x, y) in outline.corners.items()}
    return Outline(tuple(stroke.mirrored() for stroke in outline.strokes), corners)


def _unfolded(half: Outline, piece: Piece) -> Outline:
    """The whole panel of a half; the corners of the other half are called ``~corner``."""
    x, other_x = (half.corners[corner][0] for corner in piece.fold)
    if abs(x - other_x) > SAME:
        raise PatternError(f"{piece.part}: its fold is not vertical: rotate the part")
    on_fold = [k for k, s in enumerate(half.strokes) if max(abs(s.start[0] - x), abs(s.end[0] - x)) < SAME]
    if not on_fold:
        raise PatternError(f"{piece.part}: its outline has no edge on the fold")
    count, last = len(half.strokes), on_fold[-1]
    while (last + 1) % count in on_fold:
        last = (last + 1) % count
    order = [(last + 1 + k) % count for k in range(count)]
    right = [half.strokes[k].moved((-x, 0.0)) for k in order if k not in on_fold]
    left = [stroke.mirrored().reversed() for stroke in reversed(right)]
    moved = {name: (px - x, py) for name, (px, py) in half.corners.items()}
    other = {f"~{name}": (-px, py) for name, (px, py) in moved.items()}
    return Outline((*right, *left), {**moved, **other})


def _turned(outline: Outline) -> Outline:
    """The outline counter-clockwise."""
    if sum(stroke.swept_area for stroke in outline.strokes) > 0:
        return outline
    return Outline(tuple(stroke.reversed() for stroke in reversed(outline.strokes)), outline.corners)


# ---------------------------------------------------------------------------------------------------------------- seams


def _both_halves(design: Design) -> list[tuple[str, str]]:
    """The seams of the design and their mirror images."""
    return [pair for seam in design.seams for pair in (seam, (_mirror(seam[0]), _mirror(seam[1])))]


def _mirror(side: str) -> str:
    stretches = side.removesuffix(HALVED).split()
    mirrored = " ".join(part[1:] if part.startswith("~") else f"~{part}" for part in stretches)
    return mirrored + HALVED * side.endswith(HALVED)


def _sides(seam: tuple[str, str], design: Design, outlines: Mapping[str, Outline]) -> tuple[Cuts, Cuts]:
    """The two sides of a seam; the second is mirrored if only that joins right side to right side."""
    one = _cuts(seam[0], design, outlines)
    for text in (seam[1], _mirror(seam[1])):
        other = _cuts(text, design, outlines)
        if one.where & other.where:
            continue
        if {backwards for *_, backwards in one.strokes}.isdisjoint(backwards for *_, backwards in other.strokes):
            return one, other
    raise PatternError(f"seam {seam[0]} to {seam[1]} joins a right to a wrong side: correct the direction of a stretch")


def _cuts(side: str, design: Design, outlines: Mapping[str, Outline]) -> Cuts:
    strokes: list[tuple[str, int, bool]] = []
    for part in side.removesuffix(HALVED).split():
        mirrored = part.startswith("~")
        name, _, ends = part.lstrip("~").partition(":")
        corners = ends.split(">")
        panel = name
        if mirrored and design.pieces[name].cut is Cut.FOLD:
            corners = [corner[1:] if corner.startswith("~") else f"~{corner}" for corner in corners]
        elif mirrored and design.pieces[name].cut is Cut.PAIR:
            panel = f"~{name}"
        try:
            numbers, backwards = outlines[panel].stretch(*corners)
        except PatternError as error:
            raise PatternError(f"panel {panel}: {error}") from error
        strokes += [(panel, number, backwards) for number in numbers]
    if not strokes:
        raise PatternError(f"stretch {side} has no length: name two corners")
    return Cuts(tuple(strokes), side.endswith(HALVED))


def _role(panel: str, design: Design) -> PanelRole:
    """The part of the body that a panel covers."""
    if design.pieces[panel.lstrip("~")].side is Side.ARM:
        return PanelRole.ARM
    return PanelRole.LEG if design.from_waist else PanelRole.BODY


def _place(panel: str, outline: Outline, design: Design, measurements: Mapping[str, float]) -> Placement:
    """The position of a panel before sewing, for a body with these measurements [mm].

    A sleeve lies above the arm; the drawn copy is the one for the right arm, since its front half lies on its right.
    """
    piece = design.pieces[panel.lstrip("~")]
    height = MILLIMETRE * (measurements["waistToFloor"] + (0 if design.from_waist else measurements["hpsToWaistBack"]))
    middle = outline.corners[piece.middle][0] if piece.middle else 0.0
    match piece.side:
        case Side.FRONT:
            return Placement(np.array([-middle, height, AWAY]), np.zeros(3))
        case Side.BACK:
            return Placement(np.array([middle, height, -AWAY]), np.array([0.0, np.pi, 0.0]))
        case Side.ARM:
            side = 1.0 if panel.startswith("~") else -1.0
            along = np.array([-side * np.cos(ARM_ANGLE), np.sin(ARM_ANGLE), 0.0])  # from the hand to the shoulder
            above = np.array([side * np.sin(ARM_ANGLE), np.cos(ARM_ANGLE), 0.0])
            shoulder = np.array([side * 0.5 * MILLIMETRE * measurements["shoulderToShoulder"], height - DROP, 0.0])
            top = max(stroke.start[1] for stroke in outline.strokes)
            matrix = np.stack([np.cross(along, above), along, above], axis=1)
            return Placement(shoulder + ABOVE * above - top * along, euler_angles(matrix))


def _sewn(
    name: str,
    outlines: Mapping[str, Outline],
    places: Mapping[str, tuple[Placement, PanelRole]],
    sides: Iterable[tuple[Cuts, Cuts]],
) -> Pattern:
    """The pattern: edges divided at the corners of the other side of their seams."""
    parts, joined = _divided(outlines, sides)
    panels: list[Panel] = []
    numbers: dict[PartKey, int] = {}
    for panel, outline in outlines.items():
        runs = [parts.get((panel, k), (stroke,)) for k, stroke in enumerate(outline.strokes)]
        keys = [(panel, k, part) for k, run in enumerate(runs) for part in range(len(run))]
        numbers.update({key: edge for edge, key in enumerate(keys)})
        flat = [stroke for run in runs for stroke in run]
        corners = np.array([stroke.start for stroke in flat])
        edges = tuple(Edge(i, (i + 1) % len(flat), stroke.curve) for i, stroke in enumerate(flat))
        panels.append(Panel(_panel_name(panel), corners, edges, *places[panel]))
    seams = tuple(
        Seam(EdgeRef(_panel_name(a[0]), numbers[a]), EdgeRef(_panel_name(b[0]), numbers[b])) for a, b in joined
    )
    return Pattern(name, tuple(panels), seams)


def _divided(
    outlines: Mapping[str, Outline], sides: Iterable[tuple[Cuts, Cuts]]
) -> tuple[dict[tuple[str, int], tuple[Stroke, ...]], list[tuple[PartKey, PartKey]]]:
    """The parts of every stroke that is sewn, and the pairs of parts that are joined."""
    unique = {frozenset((one.where, other.where)): (one, other) for one, other in sides}
    parts: dict[tuple[str, int], tuple[Stroke, ...]] = {}
    joined: list[tuple[PartKey, PartKey]] = []
    for one, other in unique.values():
        shares = [_corner_shares(side, outlines) for side in (one, other)]
        halves = [0.5] * (one.halved or other.halved)
        length = min(sum(outlines[p].strokes[k].length for p, k, _ in side.strokes) for side in (one, other))
        cuts = [_far_from(sorted({*foreign, *halves}), own, NEAR / length) for own, foreign in (shares, shares[::-1])]
        runs = [
            _divide(side, own, inner, outlines, parts)
            for side, own, inner in zip((one, other), shares, cuts, strict=True)
        ]
        if len(runs[0]) != len(runs[1]):
            raise PatternError(f"{len(runs[0])} edges would be sewn to {len(runs[1])}: two corners lie too close")
        joined += zip(*runs, strict=True)
    return parts, joined


def _panel_name(panel: str) -> str:
    return f"{panel.lstrip('~')}_mirrored" if panel.startswith("~") else panel


def _corner_shares(side: Cuts, outlines: Mapping[str, Outline]) -> list[float]:
    """Shares of the side's length at which its inner corners lie."""
    lengths = [outlines[panel].strokes[number].length for panel, number, _ in side.strokes]
    return [at / sum(lengths) for at in accumulate(lengths)][:-1]


def _far_from(shares: Sequence[float], others: Sequence[float], near: float) -> list[float]:
    """The shares that have no other within ``near``."""
    return [share for share in shares if all(abs(share - other) >= near for other in others)]


def _divide(
    side: Cuts,
    own: Sequence[float],
    cuts: Sequence[float],
    outlines: Mapping[str, Outline],
    parts: dict[tuple[str, int], tuple[Stroke, ...]],
) -> list[PartKey]:
    """Divide the side's strokes at ``cuts``; returns (panel, stroke, part) of its edges in order along the seam."""
    run: list[PartKey] = []
    for (panel, number, backwards), (low, high) in zip(side.strokes, pairwise([0.0, *own, 1.0]), strict=True):
        if (panel, number) in parts:
            raise PatternError(f"panel {panel}: two seams use one stretch of its outline: correct a seam")
        inner = [(cut - low) / (high - low) for cut in cuts if low < cut < high]
        along = [1 - share for share in reversed(inner)] if backwards else inner
        pieces = outlines[panel].strokes[number].split(along)
        parts[panel, number] = pieces
        order = reversed(range(len(pieces))) if backwards else range(len(pieces))
        run += [(panel, number, part) for part in order]
    return run


def _apart(a: Point, b: Point) -> float:
    return float(np.hypot(a[0] - b[0], a[1] - b[1]))
