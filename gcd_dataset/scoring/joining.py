"""Edges joined as a tailor draws them: a sleeve cap is one edge, though it is sewn to the front and to the back.

Patterns of the generator are subdivided where seams end. Neighbouring edges are joined where the outline runs smoothly
and the two are sewn to two other panels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import Curve, curve_length, curve_tangents, fitted_curve, sample_curve
from gcd_dataset.records import EdgeRef, Panel, Pattern

MAX_CUTS = 6  # edges of a joined one, less 1
SMOOTH = np.radians(15.0)  # largest turn of the outline at a corner that may vanish
CLOSE = 0.2  # cm: largest distance of the joined curve from the edges
SAMPLES = 33  # points of a curve that is fitted
FEWEST_EDGES = 2  # of a panel


def joined(pattern: Pattern) -> Pattern:
    """The pattern with edges joined wherever possible, without seams, lines, and corners that no edge has."""
    partner = partners_of(pattern)
    panels = []
    for panel in pattern.panels:
        runs = edge_runs(panel, partner)
        corners = panel.vertices[[panel.edges[run[0]].start for run, _ in runs]]
        edges = tuple(
            replace(panel.edges[run[0]], start=k, end=(k + 1) % len(runs), curve=curve)
            for k, (run, curve) in enumerate(runs)
        )
        panels.append(replace(panel, vertices=corners, edges=edges, lines=()))
    return replace(pattern, panels=tuple(panels), seams=())


def partners_of(pattern: Pattern) -> dict[EdgeRef, EdgeRef]:
    """The edge that each sewn edge is sewn to."""
    return {a: b for seam in pattern.seams for a, b in ((seam.left, seam.right), (seam.right, seam.left))}


def edge_runs(
    panel: Panel, partner: Mapping[EdgeRef, EdgeRef], rng: np.random.Generator | None = None
) -> list[tuple[list[int], Curve]]:
    """The panel's edges in runs that become one edge each, and the curve of this edge.

    ``rng``: join a random half of the places only.
    """
    count = len(panel.edges)
    joins = [_may_join(panel, i, partner) and (rng is None or rng.random() < 0.5) for i in range(count)]
    first = next((i for i in range(count) if not joins[i - 1]), 0)  # begin at a corner that stays
    runs: list[tuple[list[int], Curve]] = []
    for number in range(count):
        index = (first + number) % count
        left = count - number - 1 + len(runs)
        if runs and joins[index - 1] and left >= FEWEST_EDGES and len(runs[-1][0]) <= MAX_CUTS:
            curve = _joined(panel, [*runs[-1][0], index])
            if curve is not None:
                runs[-1] = ([*runs[-1][0], index], curve)
                continue
        runs.append(([index], panel.edges[index].curve))
    return runs


def _may_join(panel: Panel, index: int, partner: Mapping[EdgeRef, EdgeRef]) -> bool:
    """Whether an edge and the next are sewn to different panels, and meet smoothly."""
    after = (index + 1) % len(panel.edges)
    sewn = [partner.get(EdgeRef(panel.name, i)) for i in (index, after)]
    if sewn[0] is None or sewn[1] is None or sewn[0].panel == sewn[1].panel:
        return False
    if panel.name in (sewn[0].panel, sewn[1].panel):
        return False
    one, other = (
        curve_tangents(*panel.edge_ends(i), panel.edges[i].curve, np.array([t]))[0]
        for i, t in ((index, 1.0), (after, 0.0))
    )
    return bool(abs(np.arctan2(one[0] * other[1] - one[1] * other[0], one @ other)) < SMOOTH)


def _joined(panel: Panel, run: Sequence[int]) -> Curve | None:
    """One curve along the edges of a run; ``None`` if none lies close."""
    lengths = [curve_length(*panel.edge_ends(i), panel.edges[i].curve) for i in run]
    counts = [max(5, round(4 * SAMPLES * length / sum(lengths))) for length in lengths]
    along = [sample_curve(*panel.edge_ends(i), panel.edges[i].curve, n) for i, n in zip(run, counts, strict=True)]
    points = np.concatenate([along[0], *(piece[1:] for piece in along[1:])])
    even = _resampled(points, SAMPLES)
    curve = fitted_curve(even)
    (x0, y0), (x1, y1) = even[0].tolist(), even[-1].tolist()
    fitted = sample_curve((x0, y0), (x1, y1), curve, SAMPLES)
    return curve if np.linalg.norm(fitted - even, axis=1).max() <= CLOSE else None


def _resampled(points: Float[np.ndarray, "n 2"], count: int) -> Float[np.ndarray, "count 2"]:
    """Points at equal distances along an open polyline."""
    reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, reached[-1], count)
    return np.stack([np.interp(at, reached, points[:, axis]) for axis in (0, 1)], axis=1)
