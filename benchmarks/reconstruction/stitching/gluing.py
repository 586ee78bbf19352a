"""Patterns with fewer panels: two panels that a straight seam joins become one, as if it were cut without this seam.

The generator draws front and back as two halves with a seam at the middle; other sources cut them on the fold. Edges on
the two sides of such a whole panel are mirror images of equal length, which are not sewn to each other.
"""

from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Complex, Float, Int

from benchmarks.reconstruction.stitching.graphs import EdgeGraph

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
        placed=graph.placed[kept],
        partners=np.where(partners >= 0, new_row[partners], -1),
        right_wrong=graph.right_wrong[kept],
        cuts=graph.cuts[kept],
    )
