"""Scores of seams: as pairs of edges (1:1), and as arc-length intervals of both outlines (n:m).

The interval scores do not depend on how edges are subdivided: one seam between two long edges equals several seams
between the parts of these edges. An edge that is sewn to several others is divided among them in proportion to their
lengths, in the order in which they lie along the edge in space.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from gcd_dataset.metrics.matching import PanelPair, matched_edges
from gcd_dataset.metrics.shapes import OutlineMap, PanelShape, SampledOutline
from gcd_dataset.records import EdgeRef, Pattern

NEAR = 2.0  # cm: the partner of a point is right within this distance along the outline
SHORT = 1e-6  # cm: shorter pieces are rounding errors
WHOLE = 0.9  # of the length of a right seam is right


@dataclass(frozen=True, slots=True)
class SewnPiece:
    """An interval of an outline sewn to an interval of an outline; positions are arc lengths [cm].

    ``left[0]`` meets ``right[0]``, ``left[1]`` meets ``right[1]``. Positions increase counter-clockwise as seen from
    the right side of the cloth, and may exceed the length of the outline: they wrap.
    """

    left_panel: str
    left: tuple[float, float]
    right_panel: str
    right: tuple[float, float]

    @property
    def length(self) -> float:
        """The mean length of both sides [cm]."""
        return 0.5 * (abs(self.left[1] - self.left[0]) + abs(self.right[1] - self.right[0]))


def seam_counts(predicted: Pattern, true: Pattern, pairs: Sequence[PanelPair]) -> tuple[int, int, int, int]:
    """Numbers of seams: right; right, with the right ends (``right_wrong``); predicted; true.

    Edges of matched panels are matched by their midpoints.
    """
    true_edge = {ref: other for pair in pairs for ref, other in matched_edges(pair).items()}
    found = {frozenset((true_edge.get(s.left), true_edge.get(s.right))): s.right_wrong for s in predicted.seams}
    wanted = {frozenset((seam.left, seam.right)): seam.right_wrong for seam in true.seams}
    right = [found[edges] == directed for edges, directed in wanted.items() if edges in found]
    return len(right), sum(right), len(predicted.seams), len(true.seams)


def seam_mismatch(pattern: Pattern, shapes: Mapping[str, PanelShape]) -> float:
    """Mean of the difference of a seam's two lengths over the larger one; 0 without seams.

    ``shapes``: the shape of each panel with a closed outline, by name. A seam to another panel, to a missing edge, or
    of an edge without a length, counts 1.
    """
    lengths = {
        EdgeRef(name, index): length
        for name, shape in shapes.items()
        for index, length in enumerate(shape.panel.edge_lengths())
    }
    sewn = [sorted((lengths.get(seam.left, 0.0), lengths.get(seam.right, 0.0))) for seam in pattern.seams]
    return float(np.mean([1 - short / long if long > 0 else 1.0 for short, long in sewn])) if sewn else 0.0


def sewn_pieces(pattern: Pattern, shapes: Mapping[str, PanelShape]) -> list[SewnPiece]:
    """The seams of a pattern as intervals; ``shapes``: the shape of each panel with a closed outline, by name.

    Seams to a missing edge, or to a panel without a shape, are left out.
    """
    outlines = {name: SampledOutline.of(shape) for name, shape in shapes.items()}
    edges = {EdgeRef(name, row): ends for name, outline in outlines.items() for row, ends in enumerate(outline.ends)}
    seams = [seam for seam in pattern.seams if seam.left in edges and seam.right in edges]
    uses: dict[EdgeRef, list[tuple[int, EdgeRef]]] = defaultdict(list)
    for number, seam in enumerate(seams):
        uses[seam.left].append((number, seam.right))
        if seam.right != seam.left:
            uses[seam.right].append((number, seam.left))
    parts = {
        (number, ref): part
        for ref, partners in uses.items()
        for number, part in _divided(ref, partners, edges, shapes).items()
    }
    pieces = []
    for number, seam in enumerate(seams):
        left, right = parts[number, seam.left], parts[number, seam.right]
        if not seam.right_wrong:
            right = right[::-1]
        pieces.append(SewnPiece(seam.left.panel, left, seam.right.panel, right))
    return pieces


def _divided(
    ref: EdgeRef,
    partners: Sequence[tuple[int, EdgeRef]],
    edges: Mapping[EdgeRef, Float[np.ndarray, "2"]],
    shapes: Mapping[str, PanelShape],
) -> dict[int, tuple[float, float]]:
    """Number of a seam to its interval of the edge, in the direction of the panel's loop."""
    start, end = edges[ref].tolist()
    if len(partners) == 1:
        return {partners[0][0]: (start, end)}
    ends = shapes[ref.panel].panel.placement.apply(np.array(shapes[ref.panel].panel.edge_ends(ref.edge)))

    def along(partner: EdgeRef) -> float:
        panel = shapes[partner.panel].panel
        middle = panel.placement.apply(np.array(panel.edge_ends(partner.edge))).mean(axis=0)
        return float((middle - ends[0]) @ (ends[1] - ends[0]))

    ordered = sorted(partners, key=lambda use: (along(use[1]), use[0]))
    lengths = np.array([abs(edges[partner][1] - edges[partner][0]) for _, partner in ordered])
    shares = np.concatenate([[0.0], np.cumsum(lengths)]) / max(lengths.sum(), SHORT)
    at = (start + shares * (end - start)).tolist()
    return {number: (at[row], at[row + 1]) for row, (number, _) in enumerate(ordered)}


def seam_lengths_score(
    predicted: Pattern,
    true: Pattern,
    pairs: Sequence[PanelPair],
    predicted_shapes: Mapping[str, PanelShape],
    true_shapes: Mapping[str, PanelShape],
) -> tuple[float, float, float, float]:
    """Precision, recall and F1 of the seams by length; 1 if all seams are right and none is missing.

    Predicted intervals are carried to the outlines of the matched true panels (``OutlineMap``). Both sets of seams are
    subdivided at each other's interval ends. A piece is right if the other pattern sews its two ends to the same points
    of the same outline, within ``NEAR``, in the same direction. A seam weighs with the mean length of its sides. It is
    right if ``WHOLE`` of its length is.
    """
    lengths = {name: SampledOutline.of(shape).length for name, shape in true_shapes.items()}
    wanted = sewn_pieces(true, true_shapes)
    found, foreign = _carried(sewn_pieces(predicted, predicted_shapes), pairs)
    drawn = {EdgeRef(name, i) for name, shape in predicted_shapes.items() for i in range(len(shape.panel.edges))}
    lost = sum(not (seam.left in drawn and seam.right in drawn) for seam in predicted.seams)
    n_wanted, n_found = sum(piece.length for piece in wanted), sum(piece.length for piece in found) + foreign
    if not true.seams and not predicted.seams:
        return 1.0, 1.0, 1.0, 1.0
    # A seam to a missing edge has no length: it weighs as much as a mean seam.
    n_found += lost * (n_found / max(len(predicted.seams) - lost, 1))
    ways = [_agreeing(*way, lengths) for way in ((found, wanted), (wanted, found))]
    is_right = not (lost or foreign) and all(
        length >= WHOLE * piece.length
        for pieces, right in zip((found, wanted), ways, strict=True)
        for piece, length in zip(pieces, right, strict=True)
    )
    precision, recall = sum(ways[0]) / max(n_found, SHORT), sum(ways[1]) / max(n_wanted, SHORT)
    return precision, recall, 2 * precision * recall / max(precision + recall, SHORT), float(is_right)


def _carried(pieces: Sequence[SewnPiece], pairs: Sequence[PanelPair]) -> tuple[list[SewnPiece], float]:
    """The pieces between matched panels, on the true outlines; and the total length of the other pieces [cm]."""
    maps, names, carried, rest = {}, {}, [], 0.0
    for pair in pairs:
        name, outlines = pair.predicted.panel.name, (SampledOutline.of(pair.predicted), SampledOutline.of(pair.true))
        if all(outline.length > SHORT for outline in outlines):
            names[name], maps[name] = pair.true.panel.name, OutlineMap.between(*outlines)
    for piece in pieces:
        if piece.left_panel not in maps or piece.right_panel not in maps:
            rest += piece.length
            continue
        left, right = (
            tuple(maps[panel].apply(np.array(ends)).tolist())
            for panel, ends in ((piece.left_panel, piece.left), (piece.right_panel, piece.right))
        )
        carried.append(SewnPiece(names[piece.left_panel], left, names[piece.right_panel], right))
    return carried, rest


def _agreeing(pieces: Sequence[SewnPiece], others: Sequence[SewnPiece], lengths: Mapping[str, float]) -> list[float]:
    """Length of the part of each piece that ``others`` sew in the same way [cm]."""
    between: dict[tuple[str, str], list[SewnPiece]] = defaultdict(list)
    ends: dict[str, list[float]] = defaultdict(list)
    for way in (*others, *(SewnPiece(o.right_panel, o.right, o.left_panel, o.left) for o in others)):
        between[way.left_panel, way.right_panel].append(way)
        ends[way.left_panel] += way.left
    right = []
    for piece in pieces:
        cuts = {0.0, 1.0}
        for panel, (first, last) in ((piece.left_panel, piece.left), (piece.right_panel, piece.right)):
            if (span := abs(last - first)) > SHORT:
                low = min(first, last)
                reached = (np.array(ends[panel]) - low) % lengths[panel] / span
                inside = reached[(reached > 0) & (reached < 1)]
                cuts |= set((inside if last > first else 1 - inside).tolist())
        candidates = between[piece.left_panel, piece.right_panel]
        parts = pairwise(sorted(cuts))
        sewn = [b - a for a, b in parts if any(_sews(other, piece, a, b, lengths) for other in candidates)]
        right.append(sum(sewn) * piece.length)
    return right


def _sews(other: SewnPiece, piece: SewnPiece, start: float, stop: float, lengths: Mapping[str, float]) -> bool:
    """Whether ``other`` sews the part ``start`` to ``stop`` (shares) of a piece, of the same panels, alike."""
    low, span = min(other.left), abs(other.left[1] - other.left[0])
    if span <= SHORT:
        return False
    left, right = (
        np.array([side[0] + u * (side[1] - side[0]) for u in (start, stop)]) for side in (piece.left, piece.right)
    )
    middle = low + (left.mean() - low) % lengths[piece.left_panel]
    if middle > low + span:
        return False
    shares = (left + (middle - left.mean()) - other.left[0]) / (other.left[1] - other.left[0])
    partner = other.right[0] + shares * (other.right[1] - other.right[0])
    length = lengths[piece.right_panel]
    apart = np.abs((partner - right + 0.5 * length) % length - 0.5 * length)
    return bool((apart <= NEAR).all() and (partner[1] - partner[0]) * (right[1] - right[0]) > 0)
