"""AIpparel's tokens (Nakayama et al., 2025): words for panels and edges, with numbers for some of them.

A garment is ``<pattern_start>``, its panels, ``<pattern_end>``. A panel is ``<panel_start>``, its name, a token
``MOVE``, its edges, ``<panel_end>``. An edge is a token for its curve, followed by a stitch tag that it shares with the
edge sewn to it. The last edge of a panel has a closing token and leaves out its end. Numbers of a token: ``MOVE`` the
position of the panel's top (``rows.top_of``) and its quaternion (x, y, z, w); an edge its end, then its control points
or the middle of its arc, relative to the panel's first corner [cm].

Not held: labels, which seams are ``right_wrong``, more than 108 seams, and panels whose names the model does not know.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Point, Quadratic, from_frame, to_frame
from gcd_dataset.encodings.rows import (
    Scaling,
    arc_through,
    loop_corners,
    middle_of,
    panel_from_vectors,
    quaternion,
    require_finite,
    seam_ends,
    top_of,
)
from gcd_dataset.errors import PatternError, shown
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Record, Seam

__all__ = ["SCALINGS", "TAGS", "AIpparelTokens", "decode", "encode"]

TAGS = 108
"""Number of stitch tags."""
PATTERN_START, PATTERN_END = "<pattern_start>", "<pattern_end>"
PANEL_START, PANEL_END = "<panel_start>", "<panel_end>"
NO_TAG = "<stitch_tag_null>"
TAG_START = "<stitch_tag_"
MOVE = "<pattern_cmd_MOVE>"
POINTS = {"LINE": 1, "CURVE": 2, "CUBIC": 3, "ARC": 2}
"""Kind of an edge to its number of points, end included."""
NUMBERS = {
    MOVE: 7,
    **{f"<pattern_cmd_{kind}>": 2 * points for kind, points in POINTS.items()},
    **{f"<pattern_cmd_C{kind}>": 2 * points - 2 for kind, points in POINTS.items()},
}
"""Command to the number of its values; a ``C`` before the kind marks the closing edge."""
KINDS = {
    **{f"<pattern_cmd_{kind}>": (kind, False) for kind in POINTS},
    **{f"<pattern_cmd_C{kind}>": (kind, True) for kind in POINTS},
}

SCALINGS = {
    "vertices": Scaling((8.44428116, 16.84081321), (24.4920733, 26.60402835)),
    "translations": Scaling((-1.25378371e-02, 1.13507532e02, 2.63046369), (26.06867645, 32.42920198, 22.29905009)),
}
"""How the released network standardises points and tops; quaternions are unchanged (gcd_verts_stats.yaml, …)."""


@dataclass(frozen=True, eq=False)
class AIpparelTokens(Record):
    """A pattern as tokens; lengths in cm, not standardised."""

    tokens: tuple[str, ...]
    values: Mapping[str, Float[np.ndarray, "n d"]]
    """Command to one row of numbers for each time that it occurs, in order; commands without numbers are left out."""


def encode(pattern: Pattern) -> AIpparelTokens:
    """The pattern's panels, in their order, as tokens; stitch tags are the numbers of the seams.

    Raises ``PatternError`` for more than 108 seams, an open loop, or a seam to a missing edge.
    """
    pattern = pattern.without_lines()
    if len(pattern.seams) > TAGS:
        raise PatternError(
            f"{shown(pattern.name)}: {len(pattern.seams)} seams, AIpparel has {TAGS} stitch tags: leave the garment out"
        )
    tag_of = {end: number for number, ends in enumerate(seam_ends(pattern)) for end in ends}
    tokens, values = [PATTERN_START], dict[str, list[list[float]]]()
    row = 0
    for panel in pattern.panels:
        corners = loop_corners(panel)
        top = panel.placement.apply(top_of(corners, panel.placement.matrix))
        tokens += [PANEL_START, panel.name, MOVE]
        values.setdefault(MOVE, []).append([*top.tolist(), *quaternion(panel.placement).tolist()])
        for index, edge in enumerate(panel.edges):
            kind, points = _points(panel, index, edge)
            closing = index == len(panel.edges) - 1
            command = f"<pattern_cmd_{'C' if closing else ''}{kind}>"
            kept = np.array(points[closing:]).reshape(-1, 2) - corners[0]
            tokens += [command, f"{TAG_START}{tag_of[row]}>" if row in tag_of else NO_TAG]
            if len(kept):
                values.setdefault(command, []).append(kept.reshape(-1).tolist())
            row += 1
        tokens.append(PANEL_END)
    return AIpparelTokens((*tokens, PATTERN_END), {command: np.array(rows) for command, rows in values.items()})


def decode(garment: AIpparelTokens, name: str = "") -> Pattern:
    """The pattern of tokens; a stitch tag on two edges is a seam, on more or fewer it is none, as in their code.

    A panel ends at its first closing edge; without one a straight edge closes it. Panels of one name are numbered.
    Raises ``PatternError`` for tokens that do not form a pattern, or a command with too few or wrong numbers.
    """
    rows = {command: iter(_rows(command, values)) for command, values in garment.values.items()}
    panels: list[Panel] = []
    tags: dict[str, list[EdgeRef]] = {}
    for number, words in enumerate(_panels(garment.tokens)):
        commands = [i for i, word in enumerate(words) if word in NUMBERS]
        if not commands:
            continue
        title = " ".join(words[: commands[0]]).strip() or f"panel_{number}"
        while any(panel.name == title for panel in panels):
            title = f"{title}_{number}"
        placement = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        points, curves, closed = [(0.0, 0.0)], list[Curve](), False
        for i in commands:
            command = words[i]
            numbers = next(rows.get(command, iter(())), None) if NUMBERS[command] else np.zeros(0)
            if numbers is None:
                raise PatternError(
                    f"panel {shown(title)}: no numbers are left for {command}: give {NUMBERS[command]} for each"
                )
            if command == MOVE:
                placement = numbers
                continue
            if closed:
                continue  # their code ends a panel at its closing edge
            kind, closed = KINDS[command]
            tag = words[i + 1] if i + 1 < len(words) else NO_TAG
            if tag.startswith(TAG_START) and tag != NO_TAG:
                tags.setdefault(tag, []).append(EdgeRef(title, len(curves)))
            given = [(x, y) for x, y in numbers.reshape(-1, 2).tolist()]
            end, controls = ((0.0, 0.0), given) if closed else (given[0], given[1:])
            curves.append(_curve(kind, points[-1], end, controls))
            points.append(end)
        if curves:
            steps = np.diff(np.array(points), axis=0)
            panels.append(panel_from_vectors(title, steps, curves, [""] * len(curves), placement[3:], placement[:3]))
    seams = tuple(Seam(edges[0], edges[1]) for edges in tags.values() if len(edges) == 2)
    return Pattern(name, tuple(panels), seams)


def _points(panel: Panel, index: int, edge: Edge) -> tuple[str, list[Point]]:
    """The kind of an edge, and its end followed by its other points, in the panel's plane [cm]."""
    start, end = panel.edge_ends(index)
    match edge.curve:
        case Quadratic(control):
            return "CURVE", [end, from_frame(start, end, control)]
        case Cubic(control0, control1):
            return "CUBIC", [end, from_frame(start, end, control0), from_frame(start, end, control1)]
        case Arc():
            return "ARC", [end, from_frame(start, end, middle_of(start, end, edge.curve))]
        case _:
            return "LINE", [end]


def _curve(kind: str, start: Point, end: Point, controls: Sequence[Point]) -> Curve:
    if kind == "LINE" or start == end:
        return LINE
    framed = [to_frame(start, end, point) for point in controls]
    match kind:
        case "CURVE":
            return Quadratic(framed[0])
        case "CUBIC":
            return Cubic(framed[0], framed[1])
        case _:
            return _arc(start, end, controls[0])


def _arc(start: Point, end: Point, point: Point) -> Curve:
    """The arc through a point that need not be its middle.

    The angle at which the point sees the chord is constant on an arc (inscribed angle): it gives the middle.
    """
    (ax, ay), (bx, by) = ((start[0] - point[0], start[1] - point[1]), (end[0] - point[0], end[1] - point[1]))
    seen = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)  # positive to the left of the chord
    side = np.sign(seen) or 1.0
    return arc_through(start, end, (0.5, float(side / np.tan(abs(seen) / 2) / 2) if abs(seen) > 1e-9 else 0.0))


def _panels(tokens: Sequence[str]) -> list[list[str]]:
    """The words of each panel. Raises ``PatternError`` for starts and ends that do not match."""
    if PATTERN_START not in tokens or PATTERN_END not in tokens:
        raise PatternError(f"no {PATTERN_START} and {PATTERN_END} among {len(tokens)} tokens: give a whole pattern")
    first = tokens.index(PATTERN_START)
    words = list(tokens[first + 1 : tokens.index(PATTERN_END, first)]) if PATTERN_END in tokens[first:] else []
    starts = [i for i, word in enumerate(words) if word == PANEL_START]
    ends = [i for i, word in enumerate(words) if word == PANEL_END]
    if not starts or len(starts) != len(ends) or any(a > b for a, b in zip(starts, ends, strict=True)):
        raise PatternError(
            f"{len(starts)} {PANEL_START} and {len(ends)} {PANEL_END} tokens: give one end for each start"
        )
    return [words[a + 1 : b] for a, b in zip(starts, ends, strict=True)]


def _rows(command: str, values: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    if command not in NUMBERS:
        raise PatternError(f"values of {shown(command)}: no such command: give one of {', '.join(NUMBERS)}")
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] != NUMBERS[command]:
        raise PatternError(f"values of {command} have shape {rows.shape}, not (n, {NUMBERS[command]}): one row a token")
    require_finite(rows, f"values of {command}")
    return rows
