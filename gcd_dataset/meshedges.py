"""The edges of triangle meshes."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.records import Pattern


class MeshEdges(NamedTuple):
    """Every undirected edge once."""

    ends: Int[np.ndarray, "e 2"]
    """The lower vertex first; sorted."""
    of_faces: Int[np.ndarray, "f 3"]
    """The edge of each face from corner i to corner i + 1."""
    counts: Int[np.ndarray, " e"]
    """Faces that have the edge: 1 on a border, 2 inside."""


def mesh_edges(faces: Int[np.ndarray, "f 3"]) -> MeshEdges:
    """The edges of the faces.

    >>> mesh_edges(np.array([[0, 1, 2], [2, 1, 3]])).ends.tolist()
    [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]
    """
    start = faces.astype(np.int64, copy=False)
    end = np.roll(start, -1, axis=1)
    size = int(start.max(initial=0)) + 1
    # Sorting whole numbers takes a tenth of the time of sorting rows.
    keys = np.minimum(start, end) * size + np.maximum(start, end)
    unique, of_faces, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return MeshEdges(np.stack(np.divmod(unique, size), axis=1), of_faces.reshape(-1, 3), counts)


ON_FOLD = 0.01  # cm: vertices nearer than this to a fold lie on it; stored positions are rounded to a thousandth


def fold_edges(
    pattern: Pattern, uv: Float[np.ndarray, "c 2"], corners: Int[np.ndarray, "f 3"], panel_id: Int[np.ndarray, " f"]
) -> Float[np.ndarray, "k 3"]:
    """``BoxMesh.folds``: the sides of faces on folds with a rest angle, and on seams between layers of a pleat."""
    folds = [
        (number, panel.edge_ends(index), line.angle)
        for number, panel in enumerate(pattern.panels)
        for index, line in enumerate(panel.lines, len(panel.edges))
        if line.angle
    ]
    numbers = {panel.name: number for number, panel in enumerate(pattern.panels)}
    layers = [(numbers[s.right.panel], s.right) for s in pattern.seams if pattern.layers(s)]
    folds += [(number, pattern.panels[number].edge_ends(ref.edge), 180.0) for number, ref in layers]
    found = [np.zeros((0, 3))]
    for number, ends, angle in folds:
        own = corners[panel_id == number][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        edges = np.unique(np.sort(own[on_line(uv[own], ends).all(axis=1)], axis=1), axis=0)
        found.append(np.column_stack([edges, np.full(len(edges), angle)]))
    return np.concatenate(found)


def on_line(points: Float[np.ndarray, "*n 2"], ends: Sequence[Any]) -> Bool[np.ndarray, " *n"]:
    """Whether points lie on the straight line between two points [cm]."""
    start, end = np.array(ends)
    length = np.linalg.norm(end - start)
    along, out = (end - start) / length, points - start
    at, off = out @ along, np.abs(out[..., 0] * along[1] - out[..., 1] * along[0])
    return (off < ON_FOLD) & (at > -ON_FOLD) & (at < length + ON_FOLD)
