"""NeuralTailor's arrays (Korosteleva and Lee, 2022): 23 panels of 14 edges, placements and stitch tags.

An edge is (dx, dy, cx, cy): the step to its end [cm] and the control point of a quadratic curve in the edge frame,
zeros for a straight edge. A panel is placed by the quaternion (x, y, z, w) of its rotation and the position in space of
its top (``rows.top_of``) [cm]. Edges with near stitch tags are sewn together.

Not held: cubic curves and arcs become quadratic curves through the same middle; edge and panel labels; which seams are
``right_wrong``; more panels or edges than there is room for. ``decode`` skips edges that step at most 1.5 cm in x and
in y, which their code takes for padding.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from gcd_dataset.curves import LINE, Curve, Point, Quadratic
from gcd_dataset.encodings.rows import (
    Scaling,
    edge_places,
    edge_vectors,
    pair_edges,
    panel_from_vectors,
    placement_rows,
    quadratic_through_middle,
    require_finite,
    require_room,
    seam_ends,
    seam_tags,
    seams_of,
)
from gcd_dataset.errors import PatternError
from gcd_dataset.records import EdgeRef, Panel, Pattern, Record

__all__ = ["PANEL_CLASSES", "SCALINGS", "NeuralTailorArrays", "decode", "edge_rows", "encode"]

MAX_PANELS, MAX_EDGES = 23, 14
PADDING = 1.5  # cm: an edge with smaller steps in x and y is padding; pattern_converter.py
STRAIGHT = 0.01  # a control point this close to 0 in both coordinates is none; pattern_converter.py

PANEL_CLASSES = (
    "top_front", "top_front_left", "top_back", "sleeve_lf", "sleeve_lb", "sleeve_rf", "sleeve_rb", "hood_left",
    "hood_right", "skirt_front", "skirt_back", "skirt_left", "skirt_right", "skirt_front_left", "skirt_front_right",
    "skirt_back_left", "skirt_back_right", "wb_front", "wb_back", "pant_front_left", "pant_front_right",
    "pant_back_left", "pant_back_right",
)  # fmt: skip
"""Names of the 23 panels, in the order of the arrays (panel_classes_condenced.json)."""

SCALINGS = {
    "outlines": Scaling(
        (0.0, 0.0, 0.14890235662460327, 0.05642016604542732),
        (25.267892837524418, 31.298505783081055, 0.2677369713783264, 0.2352069765329361),
    ),
    "rotations": Scaling(
        (-0.7071067690849304, -0.9238795042037964, -1.0, 0.0),
        (1.7071068286895752, 1.9238795042037964, 1.7071068286895752, 1.0),
    ),
    "translations": Scaling(
        (-55.255470275878906, -20.001333236694336, -17.086795806884766),
        (109.58930206298828, 98.27909088134766, 37.84679412841797),
    ),
    "stitch_tags": Scaling(
        (-59.99139022827149, -78.12358856201172, -52.95616912841797),
        (119.98278045654295, 156.0384521484375, 105.92605590820312),
    ),
}
"""How the released network standardises its values (models/att/att.yaml)."""


@dataclass(frozen=True, eq=False)
class NeuralTailorArrays(Record):
    """A pattern as arrays, padded with zeros; lengths in cm, not standardised."""

    outlines: Float[np.ndarray, "p e 4"]
    """Step (dx, dy) [cm] and control point (cx, cy) in the edge frame."""
    rotations: Float[np.ndarray, "p 4"]
    """Quaternions (x, y, z, w)."""
    translations: Float[np.ndarray, "p 3"]
    """Tops of the panels in space [cm]."""
    stitch_tags: Float[np.ndarray, "p e 3"]
    """Alike for the two edges of a seam [cm]; zeros for edges without a seam."""
    free_edges: Float[np.ndarray, "p e"]
    """Score of an edge without a seam: positive if likelier than not (a logit)."""


def edge_rows(panel: Panel) -> Float[np.ndarray, "e 4"]:
    """(dx, dy, cx, cy) of every edge. Raises ``PatternError`` for an open loop or an arc too small for its chord."""
    rows = np.zeros((len(panel.edges), 4))
    rows[:, :2] = edge_vectors(panel)
    for index, edge in enumerate(panel.edges):
        if edge.curve != LINE:
            curve = quadratic_through_middle(*panel.edge_ends(index), edge.curve)
            rows[index, 2:] = curve.control if isinstance(curve, Quadratic) else 0.0
    return rows


def encode(pattern: Pattern, *, max_panels: int = MAX_PANELS, max_edges: int = MAX_EDGES) -> NeuralTailorArrays:
    """The pattern's panels, in their order, as NeuralTailor's arrays.

    Raises ``PatternError`` for too many panels or edges, an open loop or a seam to a missing edge.
    """
    pattern = pattern.without_lines()
    require_room(pattern, panels=max_panels, edges=max_edges, what="NeuralTailor's arrays")
    outlines = np.zeros((max_panels, max_edges, 4))
    for row, panel in enumerate(pattern.panels):
        outlines[row, : len(panel.edges)] = edge_rows(panel)
    tags, free = np.zeros((max_panels * max_edges, 3)), np.ones(max_panels * max_edges)
    places = edge_places(pattern, max_edges)
    for ends, tag in zip(seam_ends(pattern), seam_tags(pattern), strict=True):
        for end in ends:
            tags[places[end]], free[places[end]] = tag, -1.0
    return NeuralTailorArrays(
        outlines,
        *placement_rows(pattern, max_panels),
        tags.reshape(max_panels, max_edges, 3),
        free.reshape(max_panels, max_edges),
    )


def decode(
    arrays: NeuralTailorArrays, name: str = "", *, names: Sequence[str] | None = None, padding: float = PADDING
) -> Pattern:
    """The pattern of the arrays; seams join the edges with the nearest stitch tags.

    A panel with fewer than three edges is padding. ``names``: of the panels (``panel_0``, ``panel_1``, … if ``None``);
    ``padding``: an edge with steps up to this in x and in y is none [cm]. Raises ``PatternError`` for values that are
    not finite, or arrays of unequal numbers of panels.
    """
    require_shapes(arrays.outlines, arrays.rotations, arrays.translations, width=4)
    tags, freedom = arrays.stitch_tags.reshape(-1, 3), arrays.free_edges.reshape(-1)
    for values, what in ((tags, "stitch_tags"), (freedom, "free_edges")):
        require_finite(values, what)
    panels, refs = decode_panels(
        arrays.outlines, arrays.rotations, arrays.translations, names=names, padding=padding, curve=_curve
    )
    pairs = pair_edges(cdist(tags, tags), freedom > 0, freedom)
    return Pattern(name, panels, seams_of(pairs, refs))


def decode_panels(
    outlines: Float[np.ndarray, "p e d"],
    rotations: Float[np.ndarray, "p 4"],
    translations: Float[np.ndarray, "p 3"],
    *,
    names: Sequence[str] | None,
    padding: float,
    curve: Callable[[Float[np.ndarray, "d"], Point, Point], Curve],
) -> tuple[tuple[Panel, ...], dict[int, EdgeRef]]:
    """The panels of outlines as rows of steps, and the edge of every row that is one, rows counted over all panels.

    ``curve``: the curve of a row, between its start and its end.
    """
    panels, refs = [], dict[int, EdgeRef]()
    for number, rows in enumerate(outlines):
        kept = np.flatnonzero(np.any(np.abs(rows) > padding, axis=1))
        if len(kept) < 3:
            continue
        title = f"panel_{number}" if names is None or number >= len(names) else names[number]
        ends = np.concatenate([np.zeros((1, 2)), np.cumsum(rows[kept, :2], axis=0)]).tolist()
        curves = [
            curve(row, (a[0], a[1]), (b[0], b[1])) for row, (a, b) in zip(rows[kept], pairwise(ends), strict=True)
        ]
        panel = panel_from_vectors(
            title, rows[kept, :2], curves, [""] * len(kept), rotations[number], translations[number]
        )
        panels.append(panel)
        refs |= {number * outlines.shape[1] + int(row): EdgeRef(title, i) for i, row in enumerate(kept)}
    return tuple(panels), refs


def require_shapes(outlines: np.ndarray, rotations: np.ndarray, translations: np.ndarray, *, width: int) -> None:
    """Raise ``PatternError`` for arrays of a wrong shape, or with values that are not finite."""
    if outlines.ndim != 3 or outlines.shape[2] != width:
        raise PatternError(f"outlines have shape {outlines.shape}, not (panels, edges, {width}): give one garment")
    for values, what, columns in ((rotations, "rotations", 4), (translations, "translations", 3)):
        if values.shape != (len(outlines), columns):
            raise PatternError(f"{what} have shape {values.shape}, not ({len(outlines)}, {columns}): one row a panel")
    for values, what in ((outlines, "outlines"), (rotations, "rotations"), (translations, "translations")):
        require_finite(values, what)


def _curve(row: Float[np.ndarray, "4"], start: Point, end: Point) -> Curve:
    a, b = float(row[2]), float(row[3])
    return LINE if max(abs(a), abs(b)) <= STRAIGHT else Quadratic((a, b))
