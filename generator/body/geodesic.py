"""Geodesics: shortest paths over a mesh between two vertices."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.surface import SkinSurface, near
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Record

BAND = 0.035  # half width of the searched band about the rough path, as a share of the distance


@dataclass(frozen=True, eq=False)
class GeodesicGraph(Record):
    """A graph of straight links across faces, between their corners and points evenly spaced on their edges.

    Its shortest paths approximate geodesics, up to the spacing of the points (Lanthier, Maheshwari and Sack, 1997).
    Lengths are computed for any positions of the vertices, so that one graph serves all bodies with the same mesh.
    """

    corners: Int[np.ndarray, " n"]
    """Vertices of the mesh that are nodes; the points on edges follow them in the numbering."""
    edges: Int[np.ndarray, "e 2"]
    shares: Float[np.ndarray, " k"]
    """Positions of the points on an edge, 0 to 1."""
    links: Int[np.ndarray, "l 2"]
    """Pairs of nodes in both directions, sorted by the first."""
    starts: Int[np.ndarray, " m"]
    """Row of ``links`` where each node's links begin (the row pointer of a CSR matrix)."""
    square_weights: csr_matrix
    """(l, e): the squared length of each link as a linear function of the squared lengths of the edges."""
    ends: tuple[int, int]
    """The nodes between which paths are sought."""

    @classmethod
    def over(cls, faces: Int[np.ndarray, "f 3"], start: int, end: int, *, points_per_edge: int) -> Self:
        """The graph over ``faces`` for paths from vertex ``start`` to vertex ``end``."""
        corners = np.unique(faces)
        edges, face_edges, _ = mesh_edges(faces)
        on_edge = len(corners) + np.arange(len(edges) * points_per_edge).reshape(-1, points_per_edge)
        turned = (faces != edges[face_edges, 0])[:, :, None]
        on_sides = np.where(turned, on_edge[face_edges][:, :, ::-1], on_edge[face_edges])
        around = np.concatenate([np.searchsorted(corners, faces)[:, :, None], on_sides], axis=2)
        nodes = around.reshape(len(faces), -1)
        count = len(corners) + on_edge.size
        # np.unique on scalars is faster than on rows.
        pairs, first = np.unique(nodes[:, :, None] * count + nodes[:, None, :], return_index=True)
        links = np.stack(np.divmod(pairs, count)).astype(np.int32).T  # the index type of scipy.sparse
        distinct = links[:, 0] != links[:, 1]
        links, first = links.T[:, distinct].T, first[distinct]
        shares = np.arange(1, points_per_edge + 1) / (points_per_edge + 1)
        face, pair = np.divmod(first, nodes.shape[1] ** 2)
        values, columns = _square_weights(shares)[pair], face_edges[face]
        rows = np.arange(0, values.size + 1, 3)  # three entries in each
        weights = csr_matrix((values.ravel(), columns.ravel(), rows), shape=(len(values), len(edges)))
        ends = np.searchsorted(corners, [start, end])
        return cls(corners, edges, shares, links, _row_starts(links, count), weights, (int(ends[0]), int(ends[1])))

    def without_detours(self, vertices: Float[np.ndarray, "v 3"], *, least: float) -> Self:
        """The graph without links whose angle to the straight line between the ends has a cosine below ``least``."""
        nodes = self._nodes(vertices)
        ahead = nodes[self.ends[1]] - nodes[self.ends[0]]
        along = nodes[self.links[:, 1]] - nodes[self.links[:, 0]]
        kept = along @ ahead > least * np.linalg.norm(along, axis=1) * np.linalg.norm(ahead)
        return self._with(kept)

    def near_shortest(self, vertices: Float[np.ndarray, "v 3"], *, most: float) -> Self:
        """The graph with only the links on paths up to ``most`` longer than the shortest [unit of ``vertices``]."""
        graph = self._graph(vertices)
        to, back = (dijkstra(one, indices=end) for one, end in zip((graph, graph.T), self.ends, strict=True))
        through = to[self.links[:, 0]] + graph.data + back[self.links[:, 1]]
        return self._with(through <= to[self.ends[1]] + most)

    def _with(self, kept: Bool[np.ndarray, " l"]) -> Self:
        links = self.links.T[:, kept].T
        starts = _row_starts(links, len(self.starts) - 1)
        return replace(self, links=links, starts=starts, square_weights=self.square_weights[kept])

    def length(self, vertices: Float[np.ndarray, "v 3"]) -> float:
        """Length of the shortest path on the mesh with these vertices [their unit]."""
        return float(dijkstra(self._graph(vertices), indices=self.ends[0])[self.ends[1]])

    def path(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "n 3"]:
        """The points of the shortest path, from the end back to the start."""
        _, before = dijkstra(self._graph(vertices), indices=self.ends[0], return_predecessors=True)
        nodes = [self.ends[1]]
        while nodes[-1] != self.ends[0]:
            nodes.append(int(before[nodes[-1]]))
        return self._nodes(vertices)[nodes]

    def _nodes(self, vertices: np.ndarray) -> Float[np.ndarray, "n 3"]:
        a, b = vertices[self.edges[:, 0]], vertices[self.edges[:, 1]]
        between = a[:, None] + self.shares[:, None] * (b - a)[:, None]
        return np.concatenate([vertices[self.corners], between.reshape(-1, 3)])

    def _graph(self, vertices: np.ndarray) -> csr_matrix:
        along = vertices[self.edges[:, 1]] - vertices[self.edges[:, 0]]
        squares = self.square_weights @ np.einsum("ei,ei->e", along, along)
        lengths = np.sqrt(np.maximum(squares, 0.0))  # rounding gives negative squares in slivers
        count = len(self.starts) - 1
        return csr_matrix((lengths, self.links[:, 1], self.starts), shape=(count, count))


def _row_starts(links: Int[np.ndarray, "l 2"], count: int) -> Int[np.ndarray, " m"]:
    return np.searchsorted(links[:, 0], np.arange(count + 1)).astype(np.int32)


def _square_weights(shares: Float[np.ndarray, " k"]) -> Float[np.ndarray, "p 3"]:
    """Squared distance of any two nodes on a triangle as weights of its squared sides |ab|², |bc|², |ca|².

    Nodes are ordered round the triangle: a corner, then the points on the edge after it. A difference in barycentric
    coordinates (da, db, dc), with the sum 0, has the square -(da db |ab|² + db dc |bc|² + dc da |ca|²).
    """
    corner = np.eye(3)
    ahead = np.concatenate([[0.0], shares])[:, None]
    nodes = np.concatenate([(1 - ahead) * corner[i] + ahead * corner[(i + 1) % 3] for i in range(3)])
    step = (nodes[:, None] - nodes).reshape(-1, 3)
    return -step * np.roll(step, -1, axis=1)


def graph_between(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
) -> tuple[GeodesicGraph, Float[np.ndarray, "w 3"]]:
    """A graph for geodesics between two points of the skin, and the vertices with these points appended.

    Searches a tube about the straight line, widened until the faces in it connect the points. Raises ``BodyError`` if
    no tube connects them.
    """
    ends = np.stack([start, end])
    faces, vertices = _with_points(vertices, faces, ends)
    first, last = len(vertices) - 2, len(vertices) - 1
    apart = float(np.linalg.norm(end - start))
    longest = float(np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2).max())
    for width in (0.15, 0.3, 0.6):
        straight = np.linspace(start, end, 100)
        tube = faces[near(vertices, straight, width * apart)[faces].any(axis=1)]
        rough = GeodesicGraph.over(tube, first, last, points_per_edge=1)
        if np.isfinite(rough.length(vertices)):
            path, shares = rough.path(vertices), np.linspace(0.0, 1.0, 5)[:, None, None]
            finer = (path[:-1] + shares * np.diff(path, axis=0)).reshape(-1, 3)  # three more points in each segment
            band = tube[near(vertices, finer, max(BAND * apart, longest))[tube].any(axis=1)]
            return GeodesicGraph.over(band, first, last, points_per_edge=4), vertices
    raise BodyError("no skin leads from the shoulder to the wrist: correct the mesh of the right arm")


def _with_points(
    vertices: np.ndarray, faces: np.ndarray, points: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, "g 3"], Float[np.ndarray, "w 3"]]:
    """The mesh with points of its surface appended as vertices; each splits its triangle into three."""
    for point in points:
        vertices = np.concatenate([vertices, point[None]])
        split = int(SkinSurface.of(vertices, faces).nearest(point[None]).faces[0])
        a, b, c = faces[split]
        new = len(vertices) - 1
        faces = np.concatenate([np.delete(faces, split, axis=0), [(a, b, new), (b, c, new), (c, a, new)]])
    return faces, vertices
