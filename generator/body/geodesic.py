"""Shortest way over the skin between two vertices."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.records import Record

__all__ = ["GeodesicGraph", "graph_between"]


WAY_BAND = 0.035  # of the way's length: how far from the rough way the shortest one is looked for


@dataclass(frozen=True, eq=False)
class GeodesicGraph(Record):
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
    squares: csr_matrix
    """What each way's squared length takes of the squared lengths of the edges (w, e)."""
    ends: tuple[int, int]

    @classmethod
    def over(cls, faces: Int[np.ndarray, "f 3"], start: int, end: int, *, points_per_edge: int) -> Self:
        """The net over ``faces`` for the way from vertex ``start`` to vertex ``end``."""
        corners = np.unique(faces)
        edges, face_edges = unique_edges(faces)
        on_edge = len(corners) + np.arange(len(edges) * points_per_edge).reshape(-1, points_per_edge)
        turned = (faces != edges[face_edges, 0])[:, :, None]
        on_sides = np.where(turned, on_edge[face_edges][:, :, ::-1], on_edge[face_edges])
        around = np.concatenate([np.searchsorted(corners, faces)[:, :, None], on_sides], axis=2)
        nodes = around.reshape(len(faces), -1)
        count = len(corners) + on_edge.size
        # As one number each: quicker than as rows.
        pairs, first = np.unique(nodes[:, :, None] * count + nodes[:, None, :], return_index=True)
        ways = np.stack(np.divmod(pairs, count)).astype(np.int32).T  # as sparse graphs keep them
        apart = ways[:, 0] != ways[:, 1]
        ways, first = ways.T[:, apart].T, first[apart]
        shares = np.arange(1, points_per_edge + 1) / (points_per_edge + 1)
        face, pair = np.divmod(first, nodes.shape[1] ** 2)
        squares = _by_row(_side_shares(shares)[pair], face_edges[face], len(edges))
        ends = np.searchsorted(corners, [start, end])
        return cls(corners, edges, shares, ways, _starts(ways, count), squares, (int(ends[0]), int(ends[1])))

    def without_detours(self, vertices: Float[np.ndarray, "v 3"], *, least: float) -> Self:
        """The net without ways that turn aside: their cosine with the straight line is under ``least``."""
        nodes = self._nodes(vertices)
        ahead = nodes[self.ends[1]] - nodes[self.ends[0]]
        along = nodes[self.ways[:, 1]] - nodes[self.ways[:, 0]]
        kept = along @ ahead > least * np.linalg.norm(along, axis=1) * np.linalg.norm(ahead)
        return self._with(kept)

    def near_shortest(self, vertices: Float[np.ndarray, "v 3"], *, most: float) -> Self:
        """The net without ways that only serve longer ones: by more than ``most`` than the shortest [their unit]."""
        graph = self._graph(vertices)
        there, back = (dijkstra(one, indices=end) for one, end in zip((graph, graph.T), self.ends, strict=True))
        through = there[self.ways[:, 0]] + graph.data + back[self.ways[:, 1]]
        return self._with(through <= there[self.ends[1]] + most)

    def _with(self, kept: Bool[np.ndarray, " w"]) -> Self:
        """The net with some of its ways."""
        ways = self.ways.T[:, kept].T
        return replace(self, ways=ways, starts=_starts(ways, len(self.starts) - 1), squares=self.squares[kept])

    def length(self, vertices: Float[np.ndarray, "v 3"]) -> float:
        """Length of the shortest way on the mesh with these vertices [their unit]."""
        return float(dijkstra(self._graph(vertices), indices=self.ends[0])[self.ends[1]])

    def path(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "n 3"]:
        """The points of the shortest way, from the end back to the start."""
        _, before = dijkstra(self._graph(vertices), indices=self.ends[0], return_predecessors=True)
        way = [self.ends[1]]
        while way[-1] != self.ends[0]:
            way.append(int(before[way[-1]]))
        return self._nodes(vertices)[way]

    def _nodes(self, vertices: np.ndarray) -> Float[np.ndarray, "n 3"]:
        a, b = vertices[self.edges[:, 0]], vertices[self.edges[:, 1]]
        between = a[:, None] + self.shares[:, None] * (b - a)[:, None]
        return np.concatenate([vertices[self.corners], between.reshape(-1, 3)])

    def _graph(self, vertices: np.ndarray) -> csr_matrix:
        along = vertices[self.edges[:, 1]] - vertices[self.edges[:, 0]]
        squares = self.squares @ np.einsum("ei,ei->e", along, along)
        lengths = np.sqrt(np.maximum(squares, 0.0))  # below 0 by rounding, where a sliver's points coincide
        count = len(self.starts) - 1
        return csr_matrix((lengths, self.ways[:, 1], self.starts), shape=(count, count))


def _starts(ways: Int[np.ndarray, "w 2"], count: int) -> Int[np.ndarray, " m"]:
    """The row where each node's ways begin, and where the last one's end."""
    return np.searchsorted(ways[:, 0], np.arange(count + 1)).astype(np.int32)


def _side_shares(shares: Float[np.ndarray, " k"]) -> Float[np.ndarray, "p 3"]:
    """What the squared way between any two nodes about a triangle takes of its squared sides.

    The nodes are, side by side, a corner and the points after it. In barycentric coordinates a way is a step
    (da, db, dc) with the sum 0, and its square is -(da db |ab|² + db dc |bc|² + dc da |ca|²).
    """
    corner = np.eye(3)
    ahead = np.concatenate([[0.0], shares])[:, None]
    nodes = np.concatenate([(1 - ahead) * corner[i] + ahead * corner[(i + 1) % 3] for i in range(3)])
    step = (nodes[:, None] - nodes).reshape(-1, 3)
    return -step * np.roll(step, -1, axis=1)


def _by_row(values: Float[np.ndarray, "w 3"], columns: Int[np.ndarray, "w 3"], width: int) -> csr_matrix:
    """The matrix with three entries a row."""
    return csr_matrix((values.ravel(), columns.ravel(), np.arange(0, values.size + 1, 3)), shape=(len(values), width))


def graph_between(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
) -> tuple[GeodesicGraph, Float[np.ndarray, "w 3"]]:
    """A net for the shortest way between two points of the skin, and the vertices with these two added.

    The way is sought in a tube about the straight line, which widens until the skin in it joins the points.
    """
    ends = np.stack([start, end])
    faces, vertices = _with_points(vertices, faces, ends)
    first, last = len(vertices) - 2, len(vertices) - 1
    apart = float(np.linalg.norm(end - start))
    longest = float(np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2).max())
    for width in (0.15, 0.3, 0.6):
        straight = np.linspace(start, end, 100)
        tube = faces[_near(vertices, straight, width * apart)[faces].any(axis=1)]
        rough = GeodesicGraph.over(tube, first, last, points_per_edge=1)
        if np.isfinite(rough.length(vertices)):
            path = rough.path(vertices)
            band = tube[_near(vertices, _filled_in(path), max(WAY_BAND * apart, longest))[tube].any(axis=1)]
            return GeodesicGraph.over(band, first, last, points_per_edge=4), vertices
    raise BodyError("no skin leads from the shoulder to the wrist: mend the mesh of the right arm")


def _with_points(
    vertices: np.ndarray, faces: np.ndarray, points: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, "g 3"], Float[np.ndarray, "w 3"]]:
    """The mesh with points of its surface as new last vertices, each joined to the corners of its triangle."""
    for point in points:
        vertices = np.concatenate([vertices, point[None]])
        split = int(SkinSurface.of(vertices, faces).nearest(point[None]).faces[0])
        a, b, c = faces[split]
        new = len(vertices) - 1
        faces = np.concatenate([np.delete(faces, split, axis=0), [(a, b, new), (b, c, new), (c, a, new)]])
    return faces, vertices


def _near(vertices: np.ndarray, path: np.ndarray, radius: float) -> np.ndarray:
    return cKDTree(path).query(vertices, distance_upper_bound=radius)[0] < radius


def _filled_in(path: np.ndarray) -> np.ndarray:
    """The path with points between its own, so that none of it is far from one."""
    shares = np.linspace(0.0, 1.0, 5)[:, None, None]
    return (path[:-1] + shares * np.diff(path, axis=0)).reshape(-1, 3)
