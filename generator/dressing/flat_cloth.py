"""Smooth coordinates on cloth: distances along edges, and harmonic functions."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu

from gcd_dataset.generator.mesh.rows import distinct, stable_order
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
        return distinct(self.faces, self.size)

    @cached_property
    def edges(self) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
        """The ends of each edge, and its flat length [cm]; on a seam, the shorter of both lengths."""
        low, high, length = self._sides
        first = np.flatnonzero(self._key_changes)
        return np.stack([low[first], high[first]], axis=1), np.minimum.reduceat(length, first)

    @cached_property
    def border(self) -> Int[np.ndarray, " b"]:
        """The vertices of the edges that belong to one face only."""
        low, high, _ = self._sides
        start = np.flatnonzero(self._key_changes)
        alone = start[np.diff(start, append=len(low)) == 1]
        return distinct(np.stack([low[alone], high[alone]]), self.size)

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
        n, row = len(self.vertices), np.full(self.size, -1)
        row[self.vertices] = np.arange(n)
        corner, u, v = row[self.faces.T], self.uv[:, :, 0].T, self.uv[:, :, 1].T
        start, end, weight = [], [], []
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            au, av, bu, bv = u[a] - u[k], v[a] - v[k], u[b] - u[k], v[b] - v[k]
            twice_area = np.maximum(np.abs(au * bv - av * bu), 1e-9)
            weight.append(np.maximum((au * bu + av * bv) / twice_area, LEAST_WEIGHT))
            start.append(corner[a])
            end.append(corner[b])
        i, j, w = (np.concatenate(part) for part in (start, end, weight))
        total, diagonal = np.bincount(i, w, minlength=n) + np.bincount(j, w, minlength=n), np.arange(n)
        at = np.concatenate([i, j, diagonal]), np.concatenate([j, i, diagonal])
        laplacian = csr_array((np.concatenate([-w, -w, total]), at), shape=(n, n))
        result = np.zeros(self.size)
        result[fixed] = values
        known = result[self.vertices]
        is_fixed = np.zeros(self.size, bool)
        is_fixed[fixed] = True
        is_fixed = is_fixed[self.vertices]
        _, piece = connected_components(laplacian, directed=False)
        bounded = np.zeros(piece.max(initial=0) + 1, bool)
        bounded[piece[is_fixed]] = True
        free = np.flatnonzero(bounded[piece] & ~is_fixed)
        if len(free):
            rows = laplacian[free]
            # Symmetric and positive definite: no pivots off the diagonal.
            factors = splu(
                rows[:, free].tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
            result[self.vertices[free]] = factors.solve(-(rows @ known))
        return result

    @cached_property
    def _sides(self) -> tuple[Int[np.ndarray, " s"], Int[np.ndarray, " s"], Float[np.ndarray, " s"]]:
        """Lower and higher end, and flat length, of the faces' sides, sorted by ends."""
        a, b = self.faces.T.ravel(), self.faces.T[[1, 2, 0]].ravel()
        u, v = self.uv[:, :, 0].T, self.uv[:, :, 1].T
        length = np.hypot(u[[1, 2, 0]] - u, v[[1, 2, 0]] - v).ravel()
        low, high = np.minimum(a, b), np.maximum(a, b)
        order = stable_order(low * np.int64(self.size) + high)
        return low[order], high[order], length[order]

    @cached_property
    def _key_changes(self) -> np.ndarray:
        """Marks the first side of each edge."""
        low, high, _ = self._sides
        return np.diff(low * np.int64(self.size) + high, prepend=-1) != 0
