"""SewFormer's arrays (Liu et al., 2023), and their form with seven numbers an edge used for GarmentCodeData.

Panels and placements are those of ``neuraltailor``. Four numbers an edge are NeuralTailor's. Seven are (dx, dy, x0, y0,
x1, y1, arc): two control points of a cubic curve in the edge frame; for an arc its middle, twice, and ``arc`` = 1.
Seams come from a score of each edge to be sewn, and a similarity of each pair of edges.

Not held: with four numbers, cubic curves and arcs become quadratic curves through the same middle; with seven,
quadratic curves become equal cubic ones. Edge and panel labels, which seams are ``right_wrong``, and more panels or
edges than there is room for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Point, Quadratic
from gcd_dataset.encodings.neuraltailor import (
    MAX_EDGES,
    PADDING,
    PANEL_CLASSES,
    STRAIGHT,
    decode_panels,
    edge_rows,
    require_shapes,
)
from gcd_dataset.encodings.rows import (
    Scaling,
    arc_through,
    control_of,
    edge_places,
    edge_vectors,
    middle_of,
    pair_edges,
    placement_rows,
    require_finite,
    require_room,
    seam_ends,
    seams_of,
)
from gcd_dataset.errors import PatternError
from gcd_dataset.records import Panel, Pattern, Record

__all__ = ["PANEL_CLASSES", "SCALINGS", "SewFormerArrays", "decode", "edge_rows_7", "encode"]

MAX_PANELS = 25
PADDING_7 = 0.004  # cm: the same for seven numbers an edge; AIpparel's pattern_converter.py

SCALINGS = {
    "outlines": Scaling((0.0, 0.0, 0.0, 0.0), (26.674109, 29.560705, 1.0, 1.0)),
    "rotations": Scaling((-0.38268343, -0.9238795, -1.0, 0.0), (1.3826834, 1.9238795, 1.2877939, 1.0)),
    "translations": Scaling((-55.25636, -20.001333, -17.086796), (109.58753, 51.449017, 37.846794)),
}
"""How the released network standardises its values (configs/test.yaml)."""


@dataclass(frozen=True, eq=False)
class SewFormerArrays(Record):
    """A pattern as arrays, padded with zeros; lengths in cm, not standardised."""

    outlines: Float[np.ndarray, "p e d"]
    """Four or seven numbers an edge."""
    rotations: Float[np.ndarray, "p 4"]
    """Quaternions (x, y, z, w)."""
    translations: Float[np.ndarray, "p 3"]
    """Tops of the panels in space [cm]."""
    edge_cls: Float[np.ndarray, "p e"]
    """Score of an edge with a seam: positive if likelier than not (a logit)."""
    edge_similarity: Float[np.ndarray, "n n"]
    """Similarity of edges that may be sewn together; ``n = p e`` rows in the order of ``edge_cls``."""


def edge_rows_7(panel: Panel) -> Float[np.ndarray, "e 7"]:
    """(dx, dy, x0, y0, x1, y1, arc) of every edge. Raises ``PatternError`` as ``neuraltailor.edge_rows`` does."""
    rows = np.zeros((len(panel.edges), 7))
    rows[:, :2] = edge_vectors(panel)
    for index, edge in enumerate(panel.edges):
        if isinstance(edge.curve, Arc):
            rows[index, 2:] = (*middle_of(*panel.edge_ends(index), edge.curve) * 2, 1.0)
        else:
            rows[index, 2:6] = np.ravel(control_of(edge.curve))
    return rows


def encode(
    pattern: Pattern, *, numbers: Literal[4, 7] = 4, max_panels: int = MAX_PANELS, max_edges: int = MAX_EDGES
) -> SewFormerArrays:
    """The pattern's panels, in their order, as SewFormer's arrays. Raises ``PatternError`` as ``neuraltailor`` does."""
    pattern = pattern.without_lines()
    require_room(pattern, panels=max_panels, edges=max_edges, what="SewFormer's arrays")
    count = max_panels * max_edges
    outlines = np.zeros((max_panels, max_edges, numbers))
    for row, panel in enumerate(pattern.panels):
        outlines[row, : len(panel.edges)] = edge_rows(panel) if numbers == 4 else edge_rows_7(panel)
    sewn, similarity = -np.ones(count), np.zeros((count, count))
    places = edge_places(pattern, max_edges)
    for ends in seam_ends(pattern):
        a, b = (places[end] for end in ends)
        sewn[[a, b]] = 1.0
        similarity[[a, b], [b, a]] = 1.0
    return SewFormerArrays(
        outlines, *placement_rows(pattern, max_panels), sewn.reshape(max_panels, max_edges), similarity
    )


def decode(
    arrays: SewFormerArrays, name: str = "", *, names: Sequence[str] | None = None, padding: float | None = None
) -> Pattern:
    """The pattern of the arrays; of the edges likely to be sewn, the most similar pairs are, each edge once.

    ``padding``: an edge with steps up to this in x and in y is none [cm]; 1.5 for four numbers an edge and 0.004 for
    seven if ``None``. Raises ``PatternError`` as ``neuraltailor.decode`` does.
    """
    width = arrays.outlines.shape[-1]
    if width not in (4, 7):
        raise PatternError(f"outlines have {width} numbers an edge, not 4 or 7: give SewFormer's outlines")
    require_shapes(arrays.outlines, arrays.rotations, arrays.translations, width=width)
    scores, similarity = arrays.edge_cls.reshape(-1), arrays.edge_similarity
    if (
        similarity.shape != (len(scores), len(scores))
        or len(scores) != arrays.outlines.shape[0] * arrays.outlines.shape[1]
    ):
        raise PatternError(
            f"edge_cls has {len(scores)} scores and edge_similarity shape {similarity.shape} for outlines of shape "
            f"{arrays.outlines.shape}: give one score an edge and one similarity a pair of edges"
        )
    require_finite(scores, "edge_cls")
    require_finite(similarity, "edge_similarity")
    if padding is None:
        padding = PADDING if width == 4 else PADDING_7
    panels, refs = decode_panels(
        arrays.outlines, arrays.rotations, arrays.translations, names=names, padding=padding, curve=_curve
    )
    pairs = pair_edges(-(similarity + similarity.T), scores <= 0, -scores)
    return Pattern(name, panels, seams_of(pairs, refs))


def _curve(row: Float[np.ndarray, "d"], start: Point, end: Point) -> Curve:
    values = row[2:].tolist()
    if max(abs(value) for value in values) <= STRAIGHT:
        return LINE
    if len(values) == 2:
        return Quadratic((values[0], values[1]))
    if values[4] > 0.5:
        return arc_through(start, end, (values[0], values[1]))
    if max(abs(values[2]), abs(values[3])) <= STRAIGHT:
        return Quadratic((values[0], values[1]))
    return Cubic((values[0], values[1]), (values[2], values[3]))
