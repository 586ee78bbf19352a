"""Smooth coordinates on cloth: distances along edges, and harmonic functions."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import spsolve

from gcd_dataset.generator.mesh.triangulate import flat_areas
from gcd_dataset.records import BoxMesh

LEAST_WEIGHT = 0.01  # lower limit of cotangent weights: positive weights give the maximum principle


@dataclass(frozen=True, eq=False)
class FlatCloth:
    """Some faces of a mesh, with their flat shape."""

    faces: Int[np.ndarray, "f 3"]
    """Vertex numbers of the whole mesh."""
    uv: Float[np.ndarray, "f 3 2"]
    """Flat positions of the faces' corners [cm]."""
    size: int
    """Number of vertices of the whole mesh."""

    @classmethod
    def of(cls, mesh: BoxMesh, faces: Bool[np.ndarray, " f"]) -> Self:
        """The marked faces of a box mesh."""
        return cls(mesh.faces[faces], mesh.uv[mesh.corners[faces]], len(mesh.vertices))

    @classmethod
    def of_panel(cls, mesh: BoxMesh, faces: Bool[np.ndarray, " f"]) -> Self:
        """The marked faces as cut, before sewing: vertices are rows of ``mesh.uv``."""
        return cls(mesh.corners[faces], mesh.uv[mesh.corners[faces]], len(mesh.uv))

    @property
    def area(self) -> float:
        """Flat area [cm²]."""
        return float(np.abs(flat_areas(self.uv)).sum())

    @cached_property
    def vertices(self) -> Int[np.ndarray, " n"]:
        """The vertices of the faces, in ascending order."""
        return np.unique(self.faces)

    @cached_property
    def edges(self) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
        """The ends of each edge, and its flat length [cm]; on a seam, the shorter of both lengths."""
        low, high, length = self._sides
        first = self._key_changes
        return np.stack([low[first], high[first]], axis=1), length[first]

    @cached_property
    def border(self) -> Int[np.ndarray, " b"]:
        """The vertices of the edges that belong to one face only."""
        low, high, _ = self._sides
        start = np.flatnonzero(self._key_changes)
        alone = start[np.diff(start, append=len(low)) == 1]
        return np.unique([low[alone], high[alone]])

    def distance_from(self, start: Int[np.ndarray, " s"]) -> Float[np.ndarray, " v"]:
        """(v) shortest path along edges from the ``start`` vertices to each vertex [cm]; 0 without a path."""
        ends, length = self.edges
        graph = csr_array((length, (ends[:, 0], ends[:, 1])), shape=(self.size, self.size))
        distance = dijkstra(graph, directed=False, indices=start, min_only=True)
        return np.where(np.isfinite(distance), distance, 0.0)

    def harmonic(self, fixed: Int[np.ndarray, " c"], values: Float[np.ndarray, " c"]) -> Float[np.ndarray, " v"]:
        """(v) the function that is harmonic in the flat cloth and has ``values`` at the ``fixed`` vertices.

        Discretised with the cotangent weights of Pinkall and Polthier (Experimental Mathematics 2(1), 1993), at least
        ``LEAST_WEIGHT``. 0 in connected components without fixed vertices.
        """
        start, end, weight = [], [], []
        for k in range(3):
            a, b = self.uv[:, (k + 1) % 3] - self.uv[:, k], self.uv[:, (k + 2) % 3] - self.uv[:, k]
            twice_area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
            start += [self.faces[:, (k + 1) % 3], self.faces[:, (k + 2) % 3]]
            end += [self.faces[:, (k + 2) % 3], self.faces[:, (k + 1) % 3]]
            weight += 2 * [np.maximum((a * b).sum(axis=1) / np.maximum(twice_area, 1e-9), LEAST_WEIGHT)]
        i, j, w = (np.concatenate(part) for part in (start, end, weight))
        weights = coo_array((w, (i, j)), shape=(self.size, self.size)).tocsr()
        _, piece = connected_components(weights, directed=False)
        bounded = np.isin(piece[self.vertices], piece[fixed])
        laplacian = diags_array(np.asarray(weights.sum(axis=1)).ravel()).tocsr() - weights
        result = np.zeros(self.size)
        result[fixed] = values
        free = np.setdiff1d(self.vertices[bounded], fixed)
        if len(free):
            rows = laplacian[free]
            result[free] = spsolve(rows[:, free].tocsc(), -(rows[:, fixed] @ result[fixed]))
        return result

    @cached_property
    def _sides(self) -> tuple[Int[np.ndarray, " s"], Int[np.ndarray, " s"], Float[np.ndarray, " s"]]:
        """Lower and higher end, and flat length, of the faces' sides: sorted by ends, then by length."""
        ends = np.concatenate([self.faces[:, [k, (k + 1) % 3]] for k in range(3)])
        length = np.concatenate([np.linalg.norm(self.uv[:, (k + 1) % 3] - self.uv[:, k], axis=1) for k in range(3)])
        low, high = np.sort(ends, axis=1).T
        order = np.lexsort((length, high, low))
        return low[order], high[order], length[order]

    @cached_property
    def _key_changes(self) -> np.ndarray:
        """Marks the first side of each edge."""
        low, high, _ = self._sides
        return np.diff(low * np.int64(self.size) + high, prepend=-1) != 0
