"""Skin that has folded over itself, drawn flat again.

A body far from the mean may have a patch of skin turned inside out: a nipple pushed in, the fold between the thighs, an
armpit under a lowered arm. There the normals point away from where they point on the mean body; such a patch is
smoothed until they no longer do. Other bodies are left as they are.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix, diags_array

from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.records import Record

__all__ = ["Skin"]

ROUNDS = 20  # of smoothing, at most: a patch is flat after one to five
PASSES = 4  # of smoothing in a round
RINGS = 2  # of neighbours that are smoothed with a folded face


@dataclass(frozen=True, eq=False)
class Skin(Record):
    """The part of a mesh that is to stay free of folds."""

    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "3 f"]
    """Of the body as it should be, of any length."""
    neighbours: csr_matrix
    """From vertices to the means of their neighbours; vertices off the skin keep their place."""

    @classmethod
    def of(cls, usual: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Self:
        """The skin of a body without folds."""
        edges = unique_edges(faces)[0]
        ends = np.concatenate([edges, edges[:, ::-1]]).T
        beside = csr_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(usual), len(usual)))
        count = np.asarray(beside.sum(axis=1)).ravel()
        alone = diags_array((count == 0).astype(float))
        return cls(faces, _normals(usual, faces), csr_matrix(diags_array(1 / np.maximum(count, 1)) @ beside + alone))

    def flattened(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
        """The vertices with folded patches smoothed."""
        folded = np.flatnonzero(self.folded(vertices))
        for _ in range(ROUNDS):
            if not len(folded):
                break
            patch = self._around(self.faces[folded].ravel(), len(vertices))
            vertices, means = vertices.copy(), self.neighbours[patch]
            for _ in range(PASSES):
                vertices[patch] = means @ vertices
            moved = np.zeros(len(vertices), bool)
            moved[patch] = True
            suspects = np.flatnonzero(moved[self.faces[:, 0]] | moved[self.faces[:, 1]] | moved[self.faces[:, 2]])
            folded = suspects[_looks_away(vertices, self.faces[suspects], self.normals[:, suspects])]
        return vertices

    def folded(self, vertices: Float[np.ndarray, "v 3"]) -> Bool[np.ndarray, " f"]:
        """Faces that look the other way."""
        return _looks_away(vertices, self.faces, self.normals)

    def _around(self, marked: Int[np.ndarray, " n"], n_vertices: int) -> Int[np.ndarray, " m"]:
        region = np.zeros(n_vertices)
        region[marked] = 1.0
        for _ in range(RINGS):
            region += self.neighbours @ region
        return np.flatnonzero(region)


def _looks_away(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], usual: Float[np.ndarray, "3 f"]
) -> Bool[np.ndarray, " f"]:
    found = _normals(vertices, faces)
    return found[0] * usual[0] + found[1] * usual[1] + found[2] * usual[2] < 0.0


def _normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "3 f"]:
    """Of any length; by coordinates, which takes a quarter of the time of ``np.cross``."""
    a, b, c = np.ascontiguousarray(faces.T)
    (ux, uy, uz), (wx, wy, wz) = ([axis[end] - axis[a] for axis in np.ascontiguousarray(vertices.T)] for end in (b, c))
    return np.stack([uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx])
