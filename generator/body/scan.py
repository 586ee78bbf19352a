"""A mesh as it comes, made measurable: seams between equal positions welded, slivers dropped, holes patched."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.records import Record

__all__ = ["Scan"]

FEWEST_FACES = 500  # with fewer a body's girths are off by more than a centimetre: see the case `measures`
WELD = 1e-5  # of the mesh's size: positions nearer than this are one


@dataclass(frozen=True, eq=False)
class Scan(Record):
    """Triangles of one closed skin, and what of them is patches over holes."""

    vertices: Float[np.ndarray, "v 3"]
    """[cm]; the last ones are the middles of patches."""
    faces: Int[np.ndarray, "f 3"]
    patched: Bool[np.ndarray, " f"]
    """Faces that are patches."""
    source: Int[np.ndarray, " u"]
    """The vertex here of each vertex of the mesh as it came."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "u 3"], faces: Int[np.ndarray, "g 3"], name: str) -> Self:
        """The mesh, welded and patched. Raises ``BodyError`` where it can be no body."""
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise BodyError(f"{name}: a face names vertex {faces.max()} of {len(vertices)}: export the mesh again")
        used = np.unique(faces)
        if not np.isfinite(vertices[used]).all():
            bad = used[~np.isfinite(vertices[used]).all(axis=1)]
            raise BodyError(f"{name}: vertex {bad[0]} and {len(bad) - 1} more have positions that are no numbers")
        welded, source = _welded(vertices, used)
        faces = source[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        if len(faces) < FEWEST_FACES:
            raise BodyError(f"{name}: {len(faces)} triangles, a body has {FEWEST_FACES} and more: give a finer mesh")
        middles, patches = _patches(welded, faces)
        return cls(
            np.concatenate([welded, middles]),
            np.concatenate([faces, patches]),
            np.arange(len(faces) + len(patches)) >= len(faces),
            source,
        )


def _welded(vertices: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Used vertices without doubles, and which of them each vertex is; unused ones are the first."""
    size = WELD * max(float(np.ptp(vertices[used], axis=0).max(initial=0.0)), 1e-9)
    _, first, back = np.unique(np.round(vertices[used] / size), axis=0, return_index=True, return_inverse=True)
    source = np.zeros(len(vertices), int)
    source[used] = back.ravel()
    return vertices[used[first]], source


def _patches(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the holes' rims, and fans of triangles from them to the rims."""
    edges, face_edges = unique_edges(faces)
    rim = edges[np.bincount(face_edges.ravel(), minlength=len(edges)) == 1]
    if not len(rim):
        return np.empty((0, 3)), np.empty((0, 3), int)
    corners, ends = np.unique(rim, return_inverse=True)
    ends = ends.reshape(-1, 2)
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(corners), len(corners)))
    count, hole = connected_components(graph, directed=False)
    size = np.bincount(hole, minlength=count)
    middles = np.stack([np.bincount(hole, vertices[corners, i], count) for i in range(3)], axis=1) / size[:, None]
    fans = np.concatenate([rim, len(vertices) + hole[ends[:, :1]]], axis=1)
    return middles, fans
