"""Shortest way over the skin between two vertices."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.records import Record

__all__ = ["WayNet"]


@dataclass(frozen=True, eq=False)
class WayNet(Record):
    """A net of straight ways over some faces: between their corners and points evenly spaced on their edges.

    Its shortest ways are geodesics but for the spacing of the points (Lanthier, Maheshwari and Sack, 1997).
    """

    corners: Int[np.ndarray, " n"]
    """Vertices of the mesh that are nodes, before the points on edges."""
    edges: Int[np.ndarray, "e 2"]
    shares: Float[np.ndarray, " k"]
    """Where on an edge its points lie, 0 to 1."""
    ways: Int[np.ndarray, "w 2"]
    """Pairs of nodes, both ways, sorted by the first."""
    starts: Int[np.ndarray, " m"]
    """Row of ``ways`` where each node's begin."""
    ends: tuple[int, int]

    @classmethod
    def over(cls, faces: Int[np.ndarray, "f 3"], start: int, end: int, *, points_per_edge: int) -> Self:
        """The net over ``faces`` for the way from vertex ``start`` to vertex ``end``."""
        corners = np.unique(faces)
        edges, face_edges = unique_edges(faces)
        on_edge = len(corners) + np.arange(len(edges) * points_per_edge).reshape(-1, points_per_edge)
        around = np.concatenate([np.searchsorted(corners, faces)[:, :, None], on_edge[face_edges]], axis=2)
        nodes = around.reshape(len(faces), -1)
        pairs = np.stack(np.broadcast_arrays(nodes[:, :, None], nodes[:, None, :]), axis=-1).reshape(-1, 2)
        ways = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        starts = np.searchsorted(ways[:, 0], np.arange(len(corners) + on_edge.size + 1))
        shares = np.arange(1, points_per_edge + 1) / (points_per_edge + 1)
        ends = np.searchsorted(corners, [start, end])
        return cls(corners, edges, shares, ways, starts, (int(ends[0]), int(ends[1])))

    def leading_on(self, vertices: Float[np.ndarray, "v 3"], *, least: float) -> Self:
        """The net without ways that turn aside: their cosine with the straight line is under ``least``."""
        nodes = self._nodes(vertices)
        ahead = nodes[self.ends[1]] - nodes[self.ends[0]]
        along = nodes[self.ways[:, 1]] - nodes[self.ways[:, 0]]
        kept = along @ ahead > least * np.linalg.norm(along, axis=1) * np.linalg.norm(ahead)
        ways = self.ways[kept]
        return replace(self, ways=ways, starts=np.searchsorted(ways[:, 0], np.arange(len(self.starts))))

    def length(self, vertices: Float[np.ndarray, "v 3"]) -> float:
        """Length of the shortest way on the mesh with these vertices [their unit]."""
        return float(self._search(self._nodes(vertices))[0][self.ends[1]])

    def path(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "n 3"]:
        """The points of the shortest way, from the end back to the start."""
        nodes = self._nodes(vertices)
        _, before = self._search(nodes)
        way = [self.ends[1]]
        while way[-1] != self.ends[0]:
            way.append(int(before[way[-1]]))
        return nodes[way]

    def _nodes(self, vertices: np.ndarray) -> Float[np.ndarray, "n 3"]:
        a, b = vertices[self.edges[:, 0]], vertices[self.edges[:, 1]]
        between = a[:, None] + self.shares[:, None] * (b - a)[:, None]
        return np.concatenate([vertices[self.corners], between.reshape(-1, 3)])

    def _search(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along = nodes[self.ways[:, 0]] - nodes[self.ways[:, 1]]
        lengths = np.sqrt(np.einsum("wi,wi->w", along, along))
        graph = csr_matrix((lengths, self.ways[:, 1], self.starts), shape=(len(nodes), len(nodes)))
        return dijkstra(graph, indices=self.ends[0], return_predecessors=True)
