"""Shortest way over the skin between two vertices."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.generator.body.surface import Surface
from gcd_dataset.records import Record

__all__ = ["WayNet", "net_between"]


WAY_BAND = 0.035  # of the way's length: how far from the rough way the shortest one is looked for


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
        count = len(corners) + on_edge.size
        pairs = np.unique(nodes[:, :, None] * count + nodes[:, None, :])  # as one number each: quicker than as rows
        ways = np.stack(np.divmod(pairs, count), axis=1)
        ways = ways[ways[:, 0] != ways[:, 1]]
        starts = np.searchsorted(ways[:, 0], np.arange(count + 1))
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
        return float(dijkstra(self._graph(self._nodes(vertices)), indices=self.ends[0])[self.ends[1]])

    def path(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "n 3"]:
        """The points of the shortest way, from the end back to the start."""
        nodes = self._nodes(vertices)
        _, before = dijkstra(self._graph(nodes), indices=self.ends[0], return_predecessors=True)
        way = [self.ends[1]]
        while way[-1] != self.ends[0]:
            way.append(int(before[way[-1]]))
        return nodes[way]

    def _nodes(self, vertices: np.ndarray) -> Float[np.ndarray, "n 3"]:
        a, b = vertices[self.edges[:, 0]], vertices[self.edges[:, 1]]
        between = a[:, None] + self.shares[:, None] * (b - a)[:, None]
        return np.concatenate([vertices[self.corners], between.reshape(-1, 3)])

    def _graph(self, nodes: np.ndarray) -> csr_matrix:
        along = nodes[self.ways[:, 0]] - nodes[self.ways[:, 1]]
        lengths = np.sqrt(np.einsum("wi,wi->w", along, along))
        return csr_matrix((lengths, self.ways[:, 1], self.starts), shape=(len(nodes), len(nodes)))


def net_between(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
) -> tuple[WayNet, Float[np.ndarray, "w 3"]]:
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
        rough = WayNet.over(tube, first, last, points_per_edge=1)
        if np.isfinite(rough.length(vertices)):
            path = rough.path(vertices)
            band = tube[_near(vertices, _filled_in(path), max(WAY_BAND * apart, longest))[tube].any(axis=1)]
            return WayNet.over(band, first, last, points_per_edge=4), vertices
    raise BodyError("no skin leads from the shoulder to the wrist: mend the mesh of the right arm")


def _with_points(
    vertices: np.ndarray, faces: np.ndarray, points: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, "g 3"], Float[np.ndarray, "w 3"]]:
    """The mesh with points of its surface as new last vertices, each joined to the corners of its triangle."""
    for point in points:
        vertices = np.concatenate([vertices, point[None]])
        split = int(Surface.of(vertices, faces).nearest(point[None]).faces[0])
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
