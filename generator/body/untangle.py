"""Skin that has folded over itself, drawn flat again.

A body far from the mean may have a patch of skin turned inside out: a nipple pushed in, the fold between the thighs, an
armpit under a lowered arm. There the normals point away from where they point on the mean body; such a patch is
smoothed until they no longer do. Skin creased so sharply that one side passes through the other, as beside
the crotch, is smoothed until it no longer does. Other bodies are left as they are.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix, diags_array

from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.records import Record

__all__ = ["SkinMesh"]

ROUNDS = 20  # of smoothing, at most: a patch is flat after one to five
PASSES = 4  # of smoothing in a round
RINGS = 2  # of neighbours that are smoothed with a folded face
CREASED = (
    -0.9
)  # cosine between the normals beside an edge where skin may pass through itself; where it does, under -0.97
TURNED = 0.7  # cosine between usual normal and found one on one side of such an edge at least


@dataclass(frozen=True, eq=False)
class SkinMesh(Record):
    """The part of a mesh that is to stay free of folds."""

    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "3 f"]
    """Of the body as it should be, of length 1."""
    across: Int[np.ndarray, "f 3"]
    """The face beyond each side of a face; itself where there is none."""
    neighbours: csr_matrix
    """From vertices to the means of their neighbours; vertices off the skin keep their place."""

    @classmethod
    def of(cls, usual: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Self:
        """The skin of a body without folds."""
        edges, sides = unique_edges(faces)
        ends = np.concatenate([edges, edges[:, ::-1]]).T
        beside = csr_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(usual), len(usual)))
        count = np.asarray(beside.sum(axis=1)).ravel()
        alone = diags_array((count == 0).astype(float))
        means = csr_matrix(diags_array(1 / np.maximum(count, 1)) @ beside + alone)
        normals = _normals(usual, faces)
        return cls(faces, normals / np.linalg.norm(normals, axis=0), _across(sides), means)

    def flattened(self, vertices: Float[np.ndarray, "v 3"], *, parted: bool = True) -> Float[np.ndarray, "v 3"]:
        """The vertices with folded patches smoothed, then, if ``parted``, creases that pass through themselves."""
        normals = _normals(vertices, self.faces)
        for _ in range(ROUNDS):
            wrong = np.flatnonzero(_dot(normals, self.normals) < 0.0)
            if parted and not len(wrong):
                wrong = self._crossed(vertices, normals)
            if not len(wrong):
                break
            patch = self._around(wrong, len(vertices))
            vertices, means = vertices.copy(), self.neighbours[patch]
            for _ in range(PASSES):
                vertices[patch] = means @ vertices
            moved = self._faces_at(patch, len(vertices))
            normals[:, moved] = _normals(vertices, self.faces[moved])
        return vertices

    def folded(self, vertices: Float[np.ndarray, "v 3"]) -> Bool[np.ndarray, " f"]:
        """Faces that look the other way."""
        return _dot(_normals(vertices, self.faces), self.normals) < 0.0

    def crossed(self, vertices: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, " n"]:
        """Faces about a crease that pass through each other."""
        return self._crossed(vertices, _normals(vertices, self.faces))

    def _crossed(self, vertices: np.ndarray, normals: Float[np.ndarray, "3 f"]) -> Int[np.ndarray, " n"]:
        # A crease takes a face that has turned, which is quicker to see than all pairs of faces.
        turned = np.flatnonzero(_dot(normals, self.normals) < TURNED * np.sqrt(_dot(normals, normals)))
        here, beyond = normals[:, turned, None], normals[:, self.across[turned]]
        creased = _dot(here, beyond) < CREASED * np.sqrt(_dot(here, here) * _dot(beyond, beyond))
        if not creased.any():
            return turned[:0]
        about = self._faces_at(self._around(turned[creased.any(axis=1)], len(vertices)), len(vertices))
        return about[_pass_through(vertices, self.faces[about])]

    def _faces_at(self, corners: Int[np.ndarray, " n"], n_vertices: int) -> Int[np.ndarray, " m"]:
        marked = np.zeros(n_vertices, bool)
        marked[corners] = True
        return np.flatnonzero(marked[self.faces[:, 0]] | marked[self.faces[:, 1]] | marked[self.faces[:, 2]])

    def _around(self, faces: Int[np.ndarray, " n"], n_vertices: int) -> Int[np.ndarray, " m"]:
        """The corners of some faces and their neighbours."""
        region = np.zeros(n_vertices)
        region[self.faces[faces]] = 1.0
        for _ in range(RINGS):
            region += self.neighbours @ region
        return np.flatnonzero(region)


def _normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "3 f"]:
    """Of any length; by coordinates, which takes a quarter of the time of ``np.cross``."""
    a, b, c = np.ascontiguousarray(faces.T)
    (ux, uy, uz), (wx, wy, wz) = ([axis[end] - axis[a] for axis in np.ascontiguousarray(vertices.T)] for end in (b, c))
    return np.stack([uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx])


def _dot(a: Float[np.ndarray, "3 *n"], b: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "*n"]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _across(sides: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The face beyond each side, from the edges of each face."""
    order = np.argsort(sides, axis=None, kind="stable")
    first = np.flatnonzero(sides.ravel()[order][1:] == sides.ravel()[order][:-1])
    beyond = np.repeat(np.arange(len(sides)), 3)
    beyond[order[first]], beyond[order[first + 1]] = order[first + 1] // 3, order[first] // 3
    return beyond.reshape(-1, 3)


def _pass_through(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Few faces that an edge of another one crosses, and those others, all held against all."""
    edges, sides = unique_edges(faces)
    apart = ~(edges[:, None, :, None] == faces[None, :, None, :]).any(axis=(2, 3))
    edge, face = np.nonzero(apart)
    start, along = vertices[edges[edge, 0]], vertices[edges[edge, 1]] - vertices[edges[edge, 0]]
    corner, u, w = (vertices[faces[face, i]] for i in range(3))
    u, w, to = u - corner, w - corner, start - corner
    # Möller and Trumbore (1997): the point of the edge in the corners' coordinates.
    turned, lifted = np.cross(along, w), np.cross(to, u)
    flat = np.einsum("ni,ni->n", u, turned)
    scale = np.divide(1.0, flat, out=np.full(len(flat), np.nan), where=flat != 0.0)
    beta, gamma = np.einsum("ni,ni->n", to, turned) * scale, np.einsum("ni,ni->n", along, lifted) * scale
    share = np.einsum("ni,ni->n", w, lifted) * scale
    met = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (share >= 0) & (share <= 1)
    through = np.zeros(len(edges), bool)
    through[edge[met]] = True
    hit = through[sides].any(axis=1)
    hit[face[met]] = True
    return hit
