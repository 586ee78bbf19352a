"""Removes folds and self-intersections from the skin of drawn bodies.

A body far from the mean may have inverted patches of skin: a nipple pushed in, the fold between the thighs, an armpit
under a lowered arm. Such patches, whose normals oppose those of the mean body, are smoothed until the normals agree.
Creases whose sides intersect, as beside the crotch, are smoothed until the sides are apart. Other bodies are unchanged.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix, diags_array

from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Record

ROUNDS = 20  # most rounds of smoothing; one to five suffice
PASSES = 4  # smoothing passes in a round
RINGS = 2  # rings of neighbours that are smoothed with a folded face
CREASED = -0.9  # cosine of the normals at an edge below which its faces are tested; intersecting ones are below -0.97
TURNED = 0.7  # cosine to its reference normal below which a face is tested for a crease


class Smoothed(NamedTuple):
    """A smoothed body."""

    vertices: Float[np.ndarray, "v 3"]
    rounds: int
    """Rounds of smoothing that are left."""
    normals: Float[np.ndarray, "3 f"]
    """Normals of the skin's faces, not normalised."""


@dataclass(frozen=True, eq=False)
class SkinMesh(Record):
    """The part of a mesh to keep free of folds, with reference normals."""

    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "3 f"]
    """Unit normals of the reference body."""
    adjacent: Int[np.ndarray, "f 3"]
    """The face across each edge of a face; on the boundary the face itself."""
    neighbour_means: csr_matrix
    """(v, v): maps vertices to the means of their neighbours; the identity off the skin."""

    @classmethod
    def of(cls, reference: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Self:
        """The skin ``faces`` of a reference body without folds."""
        edges, face_edges, _ = mesh_edges(faces)
        ends = np.concatenate([edges, edges[:, ::-1]]).T
        adjacency = csr_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(reference), len(reference)))
        count = np.asarray(adjacency.sum(axis=1)).ravel()
        isolated = diags_array((count == 0).astype(float))
        means = csr_matrix(diags_array(1 / np.maximum(count, 1)) @ adjacency + isolated)
        normals = _normals(reference, faces)
        return cls(faces, normals / np.linalg.norm(normals, axis=0), _adjacent_faces(face_edges), means)

    def flattened(
        self, vertices: Float[np.ndarray, "v 3"], *, resolve_creases: bool = True
    ) -> Float[np.ndarray, "v 3"]:
        """The vertices with folded patches smoothed, and with ``resolve_creases`` self-intersecting creases too."""
        return self.smoothed(vertices, ROUNDS, resolve_creases=resolve_creases).vertices

    def smoothed(
        self,
        vertices: Float[np.ndarray, "v 3"],
        rounds: int,
        *,
        resolve_creases: bool,
        normals: Float[np.ndarray, "3 f"] | None = None,
    ) -> "Smoothed":
        """The vertices as ``flattened`` after at most ``rounds`` rounds of smoothing.

        ``normals``: those of the vertices, from an earlier call.
        """
        normals = _normals(vertices, self.faces) if normals is None else normals
        while rounds:
            wrong = np.flatnonzero(_dot(normals, self.normals) < 0.0)
            if resolve_creases and not len(wrong):
                wrong = self._intersecting(vertices, normals)
            if not len(wrong):
                break
            patch = self._around(wrong, len(vertices))
            vertices, normals, means = vertices.copy(), normals.copy(), self.neighbour_means[patch]
            for _ in range(PASSES):
                vertices[patch] = means @ vertices
            moved = self._faces_at(patch, len(vertices))
            normals[:, moved] = _normals(vertices, self.faces[moved])
            rounds -= 1
        return Smoothed(vertices, rounds, normals)

    def folded(self, vertices: Float[np.ndarray, "v 3"]) -> Bool[np.ndarray, " f"]:
        """Whether each face is inverted against the reference."""
        return _dot(_normals(vertices, self.faces), self.normals) < 0.0

    def intersecting(self, vertices: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, " n"]:
        """Faces near creases that intersect each other."""
        return self._intersecting(vertices, _normals(vertices, self.faces))

    def _intersecting(self, vertices: np.ndarray, normals: Float[np.ndarray, "3 f"]) -> Int[np.ndarray, " n"]:
        # Every crease has a face turned from its reference normal: a cheaper test than pairs of faces.
        turned = np.flatnonzero(_dot(normals, self.normals) < TURNED * np.sqrt(_dot(normals, normals)))
        normal, other = normals[:, turned, None], normals[:, self.adjacent[turned]]
        creased = _dot(normal, other) < CREASED * np.sqrt(_dot(normal, normal) * _dot(other, other))
        if not creased.any():
            return turned[:0]
        nearby = self._faces_at(self._around(turned[creased.any(axis=1)], len(vertices)), len(vertices))
        return nearby[_intersect(vertices, self.faces[nearby])]

    def _faces_at(self, corners: Int[np.ndarray, " n"], n_vertices: int) -> Int[np.ndarray, " m"]:
        marked = np.zeros(n_vertices, bool)
        marked[corners] = True
        return np.flatnonzero(marked[self.faces[:, 0]] | marked[self.faces[:, 1]] | marked[self.faces[:, 2]])

    def _around(self, faces: Int[np.ndarray, " n"], n_vertices: int) -> Int[np.ndarray, " m"]:
        """The corners of some faces, with ``RINGS`` rings of neighbours."""
        region = np.zeros(n_vertices)
        region[self.faces[faces]] = 1.0
        for _ in range(RINGS):
            region += self.neighbour_means @ region
        return np.flatnonzero(region)


def _normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "3 f"]:
    """Face normals, not normalised. Written out by coordinates: a sixth of the time of ``np.cross``."""
    a, b, c = np.ascontiguousarray(faces.T)
    axes = [(axis.take(a), axis.take(b), axis.take(c)) for axis in np.ascontiguousarray(vertices.T)]
    (ux, uy, uz), (wx, wy, wz) = ([ends[end] - ends[0] for ends in axes] for end in (1, 2))
    normals = np.empty((3, len(faces)))
    for normal, p, q, r, s in zip(normals, (uy, uz, ux), (wz, wx, wy), (uz, ux, uy), (wy, wz, wx), strict=True):
        np.multiply(p, q, out=normal)
        normal -= r * s
    return normals


def _dot(a: Float[np.ndarray, "3 *n"], b: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "*n"]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _adjacent_faces(face_edges: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The face across each edge of each face."""
    order = np.argsort(face_edges, axis=None, kind="stable")
    first = np.flatnonzero(face_edges.ravel()[order][1:] == face_edges.ravel()[order][:-1])
    adjacent = np.repeat(np.arange(len(face_edges)), 3)
    adjacent[order[first]], adjacent[order[first + 1]] = order[first + 1] // 3, order[first] // 3
    return adjacent.reshape(-1, 3)


def _intersect(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Whether each face crosses an edge of another, or has an edge crossed; tests all pairs of few faces."""
    edges, face_edges, _ = mesh_edges(faces)
    apart = ~(edges[:, None, :, None] == faces[None, :, None, :]).any(axis=(2, 3))
    edge, face = np.nonzero(apart)
    start, along = vertices[edges[edge, 0]], vertices[edges[edge, 1]] - vertices[edges[edge, 0]]
    corner, u, w = (vertices[faces[face, i]] for i in range(3))
    u, w, to = u - corner, w - corner, start - corner
    # Möller and Trumbore (1997): barycentric coordinates of the intersection of edge and plane.
    turned, lifted = np.cross(along, w), np.cross(to, u)
    flat = np.einsum("ni,ni->n", u, turned)
    scale = np.divide(1.0, flat, out=np.full(len(flat), np.nan), where=flat != 0.0)
    beta, gamma = np.einsum("ni,ni->n", to, turned) * scale, np.einsum("ni,ni->n", along, lifted) * scale
    share = np.einsum("ni,ni->n", w, lifted) * scale
    met = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (share >= 0) & (share <= 1)
    through = np.zeros(len(edges), bool)
    through[edge[met]] = True
    hit = through[face_edges].any(axis=1)
    hit[face[met]] = True
    return hit
