"""Smooth coordinates on cloth: distances along edges, and harmonic functions."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csc_array, csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import SuperLU, splu

from gcd_dataset.generator.mesh.rows import distinct, stable_order
from gcd_dataset.generator.mesh.triangulate import flat_areas
from gcd_dataset.records import BoxMesh

WEAK = 1e-9  # weight of the values of ``integrated``, beside 1 for each side
HEATED = 8.0  # cm²: how far heat spreads in ``towards``: a few centimetres, a small part of a skirt
HELD = 1e6  # cm²: weight that holds the temperature, beside areas of a few cm²
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
        low, high, length, _ = self._sides
        first = np.flatnonzero(self._key_changes)
        return np.stack([low[first], high[first]], axis=1), np.minimum.reduceat(length, first)

    @cached_property
    def border(self) -> Int[np.ndarray, " b"]:
        """The vertices of the edges that belong to one face only."""
        low, high, _, _ = self._sides
        start = np.flatnonzero(self._key_changes)
        alone = start[np.diff(start, append=len(low)) == 1]
        return distinct(np.stack([low[alone], high[alone]]), self.size)

    def distance_from(self, start: Int[np.ndarray, " s"]) -> Float[np.ndarray, " v"]:
        """(v) shortest path along edges from the ``start`` vertices to each vertex [cm]; 0 without a path."""
        ends, length = self.edges
        graph = _graph(length, ends[:, 0], ends[:, 1], self.size)
        distance = dijkstra(graph, directed=False, indices=start, min_only=True)
        return np.where(np.isfinite(distance), distance, 0.0)

    def harmonic(self, fixed: Int[np.ndarray, " c"], values: Float[np.ndarray, " c"]) -> Float[np.ndarray, " v"]:
        """(v) the function that is harmonic in the flat cloth and has ``values`` at the ``fixed`` vertices.

        Discretised with the cotangent weights of Pinkall and Polthier (Experimental Mathematics 2(1), 1993), at least
        ``LEAST_WEIGHT``. 0 in connected components without fixed vertices.
        """
        low, high, weight, total = self._laplacian()
        result, is_free = np.zeros(self.size), np.ones(self.size, bool)
        result[fixed], is_free[fixed] = values, False
        known, is_free = result[self.vertices], is_free[self.vertices]
        _, piece = connected_components(_graph(weight, low, high, len(total)), directed=False)
        bounded = np.zeros(piece.max(initial=0) + 1, bool)
        bounded[piece[~is_free]] = True
        is_free &= bounded[piece]
        if is_free.any():
            row, size = np.cumsum(is_free) - 1, int(is_free.sum())
            inner, rising, falling = (
                np.flatnonzero(marks)
                for marks in (
                    is_free[low] & is_free[high],
                    is_free[high] & ~is_free[low],
                    is_free[low] & ~is_free[high],
                )
            )
            a, b, diagonal = row[low[inner]], row[high[inner]], np.arange(size)
            at = np.concatenate([a, diagonal, b]), np.concatenate([b, diagonal, a])  # each column in order of its rows
            entries = np.concatenate([-weight[inner], total[is_free], -weight[inner]])
            factors = _factors(csc_array((entries, at), shape=(size, size)))
            from_fixed = np.concatenate([-weight[rising] * known[low[rising]], -weight[falling] * known[high[falling]]])
            to = np.concatenate([row[high[rising]], row[low[falling]]])
            result[self.vertices[is_free]] = factors.solve(-np.bincount(to, from_fixed, minlength=size))
        return result

    def integrated(self, gradient: Float[np.ndarray, "f 2"], near: Float[np.ndarray, " v"]) -> Float[np.ndarray, " v"]:
        """(v) the function whose rise along the faces' sides is nearest to a gradient in their planes.

        Least squares. In each connected component it has the mean of ``near``; 0 off the faces.
        """
        wanted = np.einsum("fkd,fd->kf", self.uv[:, [2, 0, 1]] - self.uv[:, [1, 2, 0]], gradient).ravel()
        (along, weighted), row, result = self._differences, self.vertices, np.zeros(self.size)
        matrix = weighted @ along + WEAK * eye_array(len(row))
        result[row] = _factors(matrix, width=1).solve(weighted @ wanted + WEAK * near[row])
        return result

    def towards(self, top: Int[np.ndarray, " t"]) -> Float[np.ndarray, "f 2"]:
        """Unit vectors in the faces' planes along the shortest ways to the ``top`` vertices.

        They run up the heat that flows from there: Crane, Weischedel and Wardetzky, ACM Trans. Graph. 32(5), 2013. The
        ``top`` is held at one temperature: the ways at its edge are at right angles to it.
        """
        (along, weighted), areas = self._differences, np.abs(flat_areas(self.uv))
        corner = np.searchsorted(self.vertices, self.faces)
        share, held = np.bincount(corner.ravel(), np.repeat(areas / 3, 3)), HELD * np.isin(self.vertices, top)
        heat = _factors(diags_array(share + held) + HEATED * weighted @ along, width=1).solve(held)
        return uphill(self.uv, np.log(np.maximum(heat, np.finfo(float).tiny))[corner])

    def _laplacian(
        self,
    ) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"], Float[np.ndarray, " e"], Float[np.ndarray, " n"]]:
        """Rows of ``vertices`` at the ends of each edge, the edge's cotangent weight, and the sum at each vertex."""
        n, row = len(self.vertices), np.full(self.size, -1)
        row[self.vertices] = np.arange(n)
        corner, weights = row[self.faces.T], self._cotangents
        starts, ends = (
            np.bincount(corner[[k, k - 2, k - 1]].ravel(), np.concatenate(weights), minlength=n) for k in (1, 2)
        )
        low, high = row[self.edges[0].T]
        of_sides = np.concatenate([weights[2], weights[0], weights[1]])[self._sides[3]]  # opposite the corner before
        return low, high, np.add.reduceat(of_sides, np.flatnonzero(self._key_changes)), starts + ends

    @cached_property
    def _cotangents(self) -> list[Float[np.ndarray, " f"]]:
        """Weights of the sides opposite the first, second and third corner of each face."""
        weights, u, v = [], self.uv[:, :, 0].T, self.uv[:, :, 1].T
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            au, av, bu, bv = u[a] - u[k], v[a] - v[k], u[b] - u[k], v[b] - v[k]
            twice_area = np.maximum(np.abs(au * bv - av * bu), 1e-9)
            weights.append(np.maximum((au * bu + av * bv) / twice_area, LEAST_WEIGHT))
        return weights

    @cached_property
    def _differences(self) -> tuple[csr_array, csr_array]:
        """(3 f, n) differences along the sides opposite first, second and third corners; transposed and weighted."""
        corner, side = np.searchsorted(self.vertices, self.faces.T), np.arange(self.faces.size)
        at = np.concatenate([side, side]), np.concatenate([corner[[2, 0, 1]].ravel(), corner[[1, 2, 0]].ravel()])
        along = csr_array((np.repeat([1.0, -1.0], len(side)), at), shape=(len(side), len(self.vertices)))
        return along, along.T @ diags_array(np.concatenate(self._cotangents))

    @cached_property
    def _sides(
        self,
    ) -> tuple[Int[np.ndarray, " s"], Int[np.ndarray, " s"], Float[np.ndarray, " s"], Int[np.ndarray, " s"]]:
        """Lower and higher end, flat length and number of the faces' sides, sorted by ends.

        Side ``k f + i`` of ``f`` faces runs from corner ``k`` of face ``i`` to the next one.
        """
        a, b = self.faces.T.ravel(), self.faces.T[[1, 2, 0]].ravel()
        u, v = self.uv[:, :, 0].T, self.uv[:, :, 1].T
        length = np.hypot(u[[1, 2, 0]] - u, v[[1, 2, 0]] - v).ravel()
        low, high = np.minimum(a, b), np.maximum(a, b)
        order = stable_order(low * np.int64(self.size) + high)
        return low[order], high[order], length[order], order

    @cached_property
    def _key_changes(self) -> np.ndarray:
        """Marks the first side of each edge."""
        low, high, _, _ = self._sides
        return np.diff(low * np.int64(self.size) + high, prepend=-1) != 0


def uphill(uv: Float[np.ndarray, "f 3 2"], values: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 2"]:
    """Unit vectors in the faces' planes along which a function rises, from its values at the corners; 0 where level."""
    (u, v), (rise, last) = (uv[:, 1:] - uv[:, :1]).transpose(1, 2, 0), (values[:, 1:] - values[:, :1]).T
    up = np.stack([rise * v[1] - last * u[1], last * u[0] - rise * v[0]], axis=1)
    up *= np.sign(u[0] * v[1] - u[1] * v[0])[:, None]
    return up / np.maximum(np.linalg.norm(up, axis=1), np.finfo(float).tiny)[:, None]


def _factors(matrix: csc_array, width: int | None = None) -> SuperLU:
    """The factors of a matrix, symmetric and positive definite: no pivots off the diagonal.

    ``width``: columns that SuperLU does at once (default: its own choice). 1 takes half the time on 20,000 rows, and
    gives other last bits, which would change the start of a drape.
    """
    options = {"SymmetricMode": True}
    return splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, relax=width, panel_size=width, options=options)


def _graph(
    values: Float[np.ndarray, " e"], low: Int[np.ndarray, " e"], high: Int[np.ndarray, " e"], size: int
) -> csr_array:
    """A graph of ``size`` vertices, from edges sorted by their ends."""
    starts = np.concatenate([[0], np.cumsum(np.bincount(low, minlength=size))])
    return csr_array((values, np.ascontiguousarray(high, np.int32), starts.astype(np.int32)), shape=(size, size))
