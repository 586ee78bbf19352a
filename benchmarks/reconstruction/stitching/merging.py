"""Patterns whose seams join one edge to several, made from patterns whose seams join one edge to one.

Patterns of the generator are subdivided: where a sleeve is sewn to front and back of an armhole, its cap is two edges.
``merged`` joins such edges where the outline runs smoothly and the two parts are sewn to different panels; ``split``
subdivides edges again, at the true or at predicted points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Complex, Float, Int

from benchmarks.reconstruction.stitching.graphs import EdgeGraph, edge_refs
from gcd_dataset.curves import LINE, Arc, Curve, curve_length, fitted_curve, sample_curve
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Seam
from gcd_dataset.scoring.joining import edge_runs, partners_of

Cuts = Mapping[EdgeRef, Sequence[float]]
"""Shares of the length at which edges are subdivided, in order."""

SAMPLES = 33  # points of a curve that is fitted
LEAST_PART = 0.06  # share of a length that a part of a subdivided edge has at least
ALIGNMENTS = 20  # passes; a chain of edges that subdivide one another settles in a few


@dataclass(frozen=True)
class Merged:
    """A pattern with joined edges, without the seams of these edges, and how to restore them."""

    pattern: Pattern
    """The pattern with joined edges; its seams join whole edges only."""
    cuts: dict[EdgeRef, tuple[float, ...]]
    parts: Pattern
    """The pattern subdivided at ``cuts``, with all seams: the truth."""


def merged(pattern: Pattern, rng: np.random.Generator | None = None) -> Merged | None:
    """The pattern with edges joined wherever possible; ``None`` if it is possible nowhere.

    ``rng``: join a random half of the places only.
    """
    partner = partners_of(pattern)
    panels = []
    cuts: dict[EdgeRef, tuple[float, ...]] = {}
    new_ref: dict[EdgeRef, EdgeRef] = {}
    for panel in pattern.panels:
        runs = edge_runs(panel, partner, rng)
        edges = []
        for number, (run, curve) in enumerate(runs):
            first = panel.edges[run[0]]
            edges.append(replace(first, end=panel.edges[run[-1]].end, curve=curve) if len(run) > 1 else first)
            if len(run) > 1:
                lengths = [curve_length(*panel.edge_ends(i), panel.edges[i].curve) for i in run]
                cuts[EdgeRef(panel.name, number)] = tuple((np.cumsum(lengths)[:-1] / sum(lengths)).tolist())
        panels.append(replace(panel, edges=tuple(edges)))
        order = [EdgeRef(panel.name, i) for run, _ in runs for i in run]
        new_ref |= {ref: EdgeRef(panel.name, k) for k, ref in enumerate(order)}
    if not cuts:
        return None
    joined = replace(pattern, panels=tuple(panels), seams=())
    seams = tuple(replace(seam, left=new_ref[seam.left], right=new_ref[seam.right]) for seam in pattern.seams)
    parts = replace(split(joined, cuts), seams=seams)
    ref_of = dict(zip(edge_refs(parts), _origins(joined, cuts), strict=True))
    kept = tuple(
        replace(seam, left=ref_of[seam.left], right=ref_of[seam.right])
        for seam in seams
        if not {ref_of[seam.left], ref_of[seam.right]} & set(cuts)
    )
    return Merged(replace(joined, seams=kept), cuts, parts)


def split(pattern: Pattern, cuts: Cuts) -> Pattern:
    """The pattern with edges subdivided at shares of their lengths; its seams follow if they join whole edges."""
    panels = []
    for panel in pattern.panels:
        vertices, edges = [*panel.vertices], list[Edge]()
        for index, edge in enumerate(panel.edges):
            shares = cuts.get(EdgeRef(panel.name, index), ())
            points, curves = _divided(panel, index, shares)
            corners = [edge.start, *range(len(vertices), len(vertices) + len(points)), edge.end]
            vertices += points
            edges += [
                replace(edge, start=a, end=b, curve=curve)
                for (a, b), curve in zip(pairwise(corners), curves, strict=True)
            ]
        panels.append(replace(panel, vertices=np.array(vertices), edges=tuple(edges)))
    whole = replace(pattern, panels=tuple(panels), seams=())
    new_ref: dict[EdgeRef, EdgeRef] = {}
    for new, old in zip(edge_refs(whole), _origins(pattern, cuts), strict=True):
        new_ref.setdefault(old, new)
    seams = tuple(
        Seam(new_ref[seam.left], new_ref[seam.right], seam.right_wrong)
        for seam in pattern.seams
        if seam.left not in cuts and seam.right not in cuts
    )
    return replace(whole, seams=seams)


def subdivided(
    pattern: Pattern, rng: np.random.Generator, *, share: float, most: int = 1, free: bool = False
) -> Pattern:
    """The pattern with a random share of the seams subdivided, each side at the same places of the seam.

    ``most``: most cuts of a seam, whose number is uniform. ``free``: the same share of the unsewn edges is subdivided
    too.
    """
    cuts: dict[EdgeRef, tuple[float, ...]] = {}
    for seam in (seam for seam in pattern.seams if rng.random() < share):
        at = _places(rng, most)
        cuts[seam.left] = tuple(at.tolist())
        cuts[seam.right] = tuple((at if seam.right_wrong else 1 - at[::-1]).tolist())
    if free:
        sewn = {side for seam in pattern.seams for side in (seam.left, seam.right)}
        cuts |= {
            ref: tuple(_places(rng, most).tolist())
            for ref in edge_refs(pattern)
            if ref not in sewn and rng.random() < share
        }
    cut = split(pattern, cuts)
    parts: dict[EdgeRef, list[EdgeRef]] = {}
    for new, old in zip(edge_refs(cut), _origins(pattern, cuts), strict=True):
        parts.setdefault(old, []).append(new)
    seams = []
    for seam in pattern.seams:
        left, right = parts[seam.left], parts[seam.right]
        along = right if seam.right_wrong else right[::-1]
        seams += [Seam(a, b, seam.right_wrong) for a, b in zip(left, along, strict=True)]
    return replace(cut, seams=tuple(seams))


def _places(rng: np.random.Generator, most: int) -> Float[np.ndarray, " n"]:
    """Between one and ``most`` random shares of a length in order; every part is longer than ``LEAST_PART``."""
    count = int(rng.integers(1, most + 1))
    gaps = rng.dirichlet(np.ones(count + 1)) * (1 - (count + 1) * LEAST_PART) + LEAST_PART
    places: Float[np.ndarray, " n"] = np.cumsum(gaps)[:-1]
    return places


def aligned(pattern: Pattern, cuts: Cuts, parts: Pattern) -> dict[EdgeRef, tuple[float, ...]]:
    """Cuts at which the parts of an edge are as long, in proportion, as the edges that they are sewn to.

    ``parts``: the pattern subdivided at ``cuts``, with seams. An edge with a free part keeps its cuts.
    """
    refs, origins = edge_refs(parts), _origins(pattern, cuts)
    length = dict(zip(refs, (value for panel in parts.panels for value in panel.edge_lengths()), strict=True))
    partner = partners_of(parts)
    pieces: dict[EdgeRef, list[EdgeRef]] = {}
    for new, old in zip(refs, origins, strict=True):
        if old in cuts:
            pieces.setdefault(old, []).append(new)
    movable = {old: own for old, own in pieces.items() if all(piece in partner for piece in own)}
    for _ in range(ALIGNMENTS):
        for own in movable.values():
            wanted = np.array([length[partner[piece]] for piece in own])
            wanted *= sum(length[piece] for piece in own) / wanted.sum()
            length |= dict(zip(own, wanted.tolist(), strict=True))
    found = {old: tuple(values) for old, values in cuts.items()}
    for old, own in movable.items():
        lengths = np.array([length[piece] for piece in own])
        found[old] = tuple((np.cumsum(lengths)[:-1] / lengths.sum()).tolist())
    return found


def needed(pattern: Pattern, cuts: Cuts, parts: Pattern) -> dict[EdgeRef, tuple[float, ...]]:
    """The cuts whose two sides are sewn to different edges of the pattern.

    ``parts``: the pattern subdivided at ``cuts``, with seams. A cut beside a free part is dropped, and so is one whose
    two sides are sewn to parts of one edge: without these cuts, one seam joins two whole edges.
    """
    refs = edge_refs(parts)
    origin = dict(zip(refs, _origins(pattern, cuts), strict=True))
    partner = partners_of(parts)
    found: dict[EdgeRef, list[float]] = {}
    pieces: dict[EdgeRef, list[EdgeRef]] = {}
    for ref in refs:
        pieces.setdefault(origin[ref], []).append(ref)
    for old, shares in cuts.items():
        for share, (before, after) in zip(shares, pairwise(pieces[old]), strict=True):
            one, other = partner.get(before), partner.get(after)
            if one is not None and other is not None and origin[one] != origin[other]:
                found.setdefault(old, []).append(share)
    return {old: tuple(shares) for old, shares in found.items()}


def _origins(pattern: Pattern, cuts: Cuts) -> list[EdgeRef]:
    """The edge of the pattern that each edge of the subdivided pattern is a part of."""
    return [ref for ref in edge_refs(pattern) for _ in range(len(cuts.get(ref, ())) + 1)]


# ------------------------------------------------------------------------------------------------------------ splitting


def _divided(panel: Panel, index: int, shares: Sequence[float]) -> tuple[list[np.ndarray], list[Curve]]:
    """Points of subdivision of an edge, and the curves of its parts."""
    edge, (start, end) = panel.edges[index], panel.edge_ends(index)
    if not shares:
        return [], [edge.curve]
    if edge.curve == LINE:
        return [(1 - t) * np.array(start) + t * np.array(end) for t in shares], [LINE] * (len(shares) + 1)
    pieces = [_between(start, end, edge.curve, a, b) for a, b in pairwise([0.0, *shares, 1.0])]
    points = [piece[-1] for piece in pieces[:-1]]
    if isinstance(edge.curve, Arc):
        half = np.pi * edge.curve.radius
        length = curve_length(start, end, edge.curve)
        sizes = [length * (b - a) for a, b in pairwise([0.0, *shares, 1.0])]
        return points, [replace(edge.curve, large=bool(size > half)) for size in sizes]
    return points, [fitted_curve(piece) for piece in pieces]


def _between(
    start: tuple[float, float], end: tuple[float, float], curve: Curve, first: float, last: float
) -> Float[np.ndarray, "n 2"]:
    """Points of a curve from one share of its length to another."""
    fine = sample_curve(start, end, curve, 16 * SAMPLES)
    share = np.linspace(0, 1, len(fine))
    at = np.linspace(first, last, SAMPLES)
    return np.stack([np.interp(at, share, fine[:, axis]) for axis in (0, 1)], axis=1)


STRAIGHT = 0.02  # cm: largest distance of a straight edge's points from its chord
EQUAL = 0.1  # cm: largest difference of the lengths of the two sides


def glued(graph: EdgeGraph, rng: np.random.Generator, *, share: float) -> EdgeGraph:
    """The graph without a random share of the seams that are straight and join two panels, which become one.

    A seam stays if its sides differ in length, if it joins right to wrong side, if the panels would overlap, or if an
    edge of the graph is to be subdivided.
    """
    if (graph.cuts >= 0).any():
        return graph
    points = graph.points.astype(float) @ np.array([1, 1j])
    following, panels = graph.following.copy(), graph.panels.copy()
    gone = np.zeros(len(panels), bool)
    for one in np.flatnonzero(graph.partners > np.arange(len(panels))).tolist():
        other = int(graph.partners[one])
        if panels[one] == panels[other] or graph.right_wrong[one] or rng.random() >= share:
            continue
        if not _straight(points[one]) or not _straight(points[other]):
            continue
        if abs(graph.lengths[one] - graph.lengths[other]) > EQUAL:
            continue
        moved = _moved(points, one, other, panels == panels[other])
        after = following.copy()
        after[np.flatnonzero(following == one)] = following[other]
        after[np.flatnonzero(following == other)] = following[one]
        if not shapely.Polygon(_outline(moved, after, int(following[one]))).is_valid:
            continue
        points, following = moved, after
        panels[panels == panels[other]] = panels[one]
        gone[[one, other]] = True
    return _without(graph, points, following, panels, gone)


def _straight(points: Complex[np.ndarray, " n"]) -> bool:
    chord = points[-1] - points[0]
    if abs(chord) < STRAIGHT:
        return False
    return bool(np.abs(((points - points[0]) * np.conj(chord / abs(chord))).imag).max() <= STRAIGHT)


def _moved(points: Complex[np.ndarray, "e n"], one: int, other: int, rows: np.ndarray) -> Complex[np.ndarray, "e n"]:
    """The points with the panel of ``other`` turned and moved so that its edge runs along ``one``, against it."""
    turn = (points[one, 0] - points[one, -1]) / (points[other, -1] - points[other, 0])
    middle, goal = points[other, [0, -1]].mean(), points[one, [0, -1]].mean()
    placed = (points - middle) * (turn / abs(turn)) + goal
    return np.where(rows[:, None], placed, points)


def _outline(
    points: Complex[np.ndarray, "e n"], following: Int[np.ndarray, " e"], first: int
) -> Float[np.ndarray, "m 2"]:
    """Points of the loop that begins with an edge."""
    loop, row = [first], int(following[first])
    while row != first:
        loop.append(row)
        row = int(following[row])
    along = points[np.array(loop), :-1].ravel()
    return np.stack([along.real, along.imag], axis=1)


def _without(
    graph: EdgeGraph, points: np.ndarray, following: np.ndarray, panels: np.ndarray, gone: np.ndarray
) -> EdgeGraph:
    """The rows that stay, panel by panel, with points about the centroid of their panel."""
    kept = np.flatnonzero(~gone)
    kept = kept[np.argsort(panels[kept], kind="stable")]
    new_row = np.full(len(panels), -1)
    new_row[kept] = np.arange(len(kept))
    _, numbers = np.unique(panels[kept], return_inverse=True)
    at = np.stack([points.real, points.imag], axis=-1)
    for row in {int(kept[np.flatnonzero(numbers == number)[0]]) for number in np.unique(numbers)}:
        centroid = shapely.Polygon(_outline(points, following, row)).centroid
        at[panels == panels[row]] -= [centroid.x, centroid.y]
    partners = graph.partners[kept]
    return replace(
        graph,
        points=at[kept].astype(np.float32),
        lengths=graph.lengths[kept],
        panels=numbers.astype(graph.panels.dtype),
        following=new_row[following[kept]],
        partners=np.where(partners >= 0, new_row[partners], -1),
        right_wrong=graph.right_wrong[kept],
        cuts=graph.cuts[kept],
    )
