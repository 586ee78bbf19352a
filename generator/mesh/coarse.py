"""Coarse box meshes, and the interpolation from a coarse mesh to the fine one.

A coarse mesh keeps every second point of each border, the same points on both sides of a seam; the inside of each panel
is triangulated anew. ``rows`` are row numbers of ``BoxMesh.uv``.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.triangulate import Fillings, fill_outline
from gcd_dataset.records import BoxMesh

__all__ = ["CoarseMesh", "coarse_start", "coarsen"]

STRAIGHT = np.cos(np.radians(25.0))  # border points where the outline turns by more than 25 degrees are kept
FEW = 1000  # vertices: a smaller mesh drapes as fast without a coarse start


@dataclass(frozen=True)
class CoarseMesh:
    """A coarse mesh of the same panels and seams, with interpolation weights for the fine vertices."""

    mesh: BoxMesh
    corners: Int[np.ndarray, "v 3"]
    """The coarse vertices that each fine vertex is interpolated from."""
    weights: Float[np.ndarray, "v 3"]
    """Their barycentric weights, which add up to 1."""

    def refine(self, values: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "v 3"]:
        """Positions or velocities at the fine vertices, interpolated from the coarse ones."""
        return np.einsum("vk,vkd->vd", self.weights, values[self.corners])


def coarse_start(mesh: BoxMesh) -> CoarseMesh | None:
    """The coarse mesh that a drape starts with; ``None`` if the mesh is small or a panel too narrow."""
    if len(mesh.vertices) < FEW:
        return None
    try:
        return coarsen(mesh)
    except MeshError:
        return None


def coarsen(mesh: BoxMesh) -> CoarseMesh:
    """The same garment at twice the spacing. Raises ``MeshError`` where a panel is too narrow."""
    border = _Border.of(mesh)
    thinned = _thin(mesh, border)
    cache: Fillings = {}
    panels = [
        _panel(mesh, number, loop[thinned.kept[mesh.uv_vertex[loop]]], cache) for number, loop in border.loops.items()
    ]
    return _join(mesh, thinned, panels)


# -------------------------------------------------------------------------------------------------------------- border


@dataclass(frozen=True)
class _Border:
    """The border segments of all panels, directed so that every panel lies on the same side of its segments."""

    names: tuple[str, ...]
    """Names of the panels."""
    start: Int[np.ndarray, " b"]
    end: Int[np.ndarray, " b"]
    """Rows of ``uv``."""
    panel: Int[np.ndarray, " b"]

    @staticmethod
    def of(mesh: BoxMesh) -> "_Border":
        start, end = mesh.corners.ravel(), np.roll(mesh.corners, -1, axis=1).ravel()
        key = np.minimum(start, end) * np.int64(len(mesh.uv)) + np.maximum(start, end)
        order = np.argsort(key)
        first = np.diff(key[order], prepend=-1) != 0
        alone = np.sort(order[first & np.roll(first, -1)])
        start, end = start[alone], end[alone]
        if len(np.unique(start)) < len(start):
            raise MeshError("a panel touches itself at a point: it cannot be made coarser")
        return _Border(mesh.panel_names, start, end, np.repeat(mesh.panel_id, 3)[alone])

    @cached_property
    def loops(self) -> dict[int, Int[np.ndarray, " n"]]:
        """Panel number to the rows of its border, in order. Raises ``MeshError`` for a panel with a hole."""
        after = dict(zip(self.start.tolist(), self.end.tolist(), strict=True))
        loops = {}
        for panel in np.unique(self.panel):
            rows = self.start[self.panel == panel]
            loop = [int(rows[0])]
            while (row := after[loop[-1]]) != loop[0]:
                loop.append(row)
            if len(loop) != len(rows):
                raise MeshError(f"panel {self.names[panel]} has a hole: it cannot be made coarser")
            loops[int(panel)] = np.array(loop)
        return loops


@dataclass(frozen=True)
class _Thinned:
    """The border vertices that the coarse mesh keeps, and the positions of the dropped ones between them."""

    kept: Bool[np.ndarray, " v"]
    between: Int[np.ndarray, "k 2"]
    """The kept vertices before and after each dropped vertex."""
    dropped: Int[np.ndarray, " k"]
    share: Float[np.ndarray, " k"]
    """Position of the dropped vertex between those two, 0 to 1."""


def _thin(mesh: BoxMesh, border: _Border) -> _Thinned:
    neighbours = _neighbours(mesh, border)
    ends = {v for v, around in neighbours.items() if len(around) != 2} | _corners(mesh, border)
    kept = np.zeros(len(mesh.vertices), bool)
    between, dropped, share = [], [], []
    for chain, steps in _chains(neighbours, ends):
        closed = chain[0] == chain[-1]
        pieces = min(max((len(chain)) // 2, 3 if closed else 2), len(chain) - 1)
        stops = np.round(np.linspace(0, len(chain) - 1, pieces + 1)).astype(int)
        kept[np.asarray(chain)[stops]] = True
        along = np.concatenate([[0.0], np.cumsum(steps)])
        for low, high in pairwise(stops):
            for at in range(low + 1, high):
                between.append((chain[low], chain[high]))
                dropped.append(chain[at])
                share.append((along[at] - along[low]) / (along[high] - along[low]))
    return _Thinned(kept, np.array(between, int).reshape(-1, 2), np.array(dropped, int), np.array(share, float))


def _neighbours(mesh: BoxMesh, border: _Border) -> dict[int, dict[int, float]]:
    """Border vertex to its neighbours along the borders, with their flat distances [cm]."""
    first, second = mesh.uv_vertex[border.start].tolist(), mesh.uv_vertex[border.end].tolist()
    lengths = np.linalg.norm(mesh.uv[border.end] - mesh.uv[border.start], axis=1).tolist()
    found: dict[int, dict[int, float]] = {}
    for i, j, length in zip(first, second, lengths, strict=True):
        if i != j:
            found.setdefault(i, {})[j] = length
            found.setdefault(j, {})[i] = length
    return found


def _corners(mesh: BoxMesh, border: _Border) -> set[int]:
    """The vertices where an outline turns by more than ``STRAIGHT``."""
    turned = []
    for loop in border.loops.values():
        step = mesh.uv[np.roll(loop, -1)] - mesh.uv[loop]
        step /= np.linalg.norm(step, axis=1, keepdims=True)
        turned.append(loop[(step * np.roll(step, 1, axis=0)).sum(axis=1) < STRAIGHT])
    return set(mesh.uv_vertex[np.concatenate(turned)].tolist())


def _chains(neighbours: dict[int, dict[int, float]], ends: set[int]) -> list[tuple[list[int], list[float]]]:
    """The borders as chains of vertices between ``ends``, with the lengths of their segments [cm].

    A closed border without such an end becomes one chain that starts and stops at the same vertex.
    """
    chains, seen = [], set[int]()

    def follow(start: int, onward: int) -> None:
        chain, steps = [start, onward], [neighbours[start][onward]]
        while chain[-1] not in ends and chain[-1] != start:
            seen.add(chain[-1])
            ahead = next(v for v in neighbours[chain[-1]] if v != chain[-2])
            steps.append(neighbours[chain[-1]][ahead])
            chain.append(ahead)
        chains.append((chain, steps))

    for end in sorted(ends):
        for onward in sorted(neighbours.get(end, {})):
            if onward not in seen and (onward not in ends or end < onward):
                follow(end, onward)
    for vertex in sorted(neighbours):
        if vertex not in seen and vertex not in ends:
            follow(vertex, min(neighbours[vertex]))
            seen.add(vertex)
    return chains


# -------------------------------------------------------------------------------------------------------------- panels


@dataclass(frozen=True)
class _Panel:
    """A coarse panel: the kept points of its border first, then seeds."""

    number: int
    rows: Int[np.ndarray, " n"]
    """The kept rows of its border in the fine mesh."""
    points: Float[np.ndarray, "m 2"]
    """[cm]"""
    faces: Int[np.ndarray, "f 3"]


def _panel(mesh: BoxMesh, number: int, rows: Int[np.ndarray, " n"], cache: Fillings) -> _Panel:
    border = mesh.uv[rows]
    if len(rows) < 3 or not shapely.Polygon(border).is_valid:
        raise MeshError(f"panel {mesh.panel_names[number]} is too narrow to lose half of its border points")
    spacing = float(np.percentile(np.linalg.norm(np.roll(border, -1, axis=0) - border, axis=1), 75))
    return _Panel(number, rows, *fill_outline(border, spacing, cache))


def _join(mesh: BoxMesh, thinned: _Thinned, panels: list[_Panel]) -> CoarseMesh:
    """The coarse panels joined along the seams of the fine mesh: kept vertices first, in their order, then seeds."""
    number = np.cumsum(thinned.kept) - 1
    count = int(thinned.kept.sum())
    vertices, vertex_of, first = [mesh.vertices[thinned.kept]], [], 0
    corners = np.zeros((len(mesh.vertices), 3), int)
    weights = np.zeros((len(mesh.vertices), 3))
    faces, points = [], []
    for panel in panels:
        seeds = len(panel.points) - len(panel.rows)
        ids = np.concatenate([number[mesh.uv_vertex[panel.rows]], np.arange(count, count + seeds)])
        count += seeds
        faces.append(first + panel.faces)
        first += len(ids)
        points.append(panel.points)
        vertex_of.append(ids)
        fine = _panel_rows(mesh, panel)
        vertices.append(_in_space(mesh, fine, panel.points[len(panel.rows) :]))
        triangle, shares = _locate(panel.points, panel.faces, mesh.uv[fine])
        corners[mesh.uv_vertex[fine]], weights[mesh.uv_vertex[fine]] = ids[panel.faces[triangle]], shares
    _set_border_weights(thinned, number, corners, weights)
    vertex = np.concatenate(vertex_of)
    rows = np.concatenate(faces)
    proper = (vertex[rows] != np.roll(vertex[rows], 1, axis=1)).all(axis=1)
    coarse = BoxMesh(
        vertices=np.concatenate(vertices),
        faces=vertex[rows][proper],
        uv=np.concatenate(points),
        corners=rows[proper],
        uv_vertex=vertex,
        panel_id=np.repeat([panel.number for panel in panels], [len(panel.faces) for panel in panels])[proper],
        panel_names=mesh.panel_names,
        panel_labels=mesh.panel_labels,
        seams=_renumbered(mesh.seams, thinned.kept, number),
        labels={name: number[ids[thinned.kept[ids]]] for name, ids in mesh.labels.items()},
    )
    return CoarseMesh(coarse, corners, weights)


def _renumbered(
    seams: Int[np.ndarray, "s 2"], kept: Bool[np.ndarray, " v"], number: Int[np.ndarray, " v"]
) -> Int[np.ndarray, "k 2"]:
    left = seams[kept[seams[:, 0]]]
    return np.stack([number[left[:, 0]], left[:, 1]], axis=1)


def _panel_rows(mesh: BoxMesh, panel: _Panel) -> Int[np.ndarray, " n"]:
    in_panel = np.zeros(len(mesh.uv), bool)
    in_panel[mesh.corners[mesh.panel_id == panel.number]] = True
    return np.flatnonzero(in_panel)


def _in_space(mesh: BoxMesh, rows: Int[np.ndarray, " n"], points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 3"]:
    """Flat points of a panel in space before sewing [cm], by the affine map of its vertices that lie on no seam."""
    free = rows[mesh.uv_vertex[rows] >= mesh.n_seam_vertices]
    free = free if len(free) > 2 else rows
    uv, vertices = mesh.uv[free], mesh.vertices[mesh.uv_vertex[free]]
    flat_centre, centre = uv.mean(axis=0), vertices.mean(axis=0)
    # Compute ``uv - flat_centre`` anew for each factor: if both factors of A.T @ A are one array, NumPy calls another
    # BLAS routine, which rounds differently.
    gram = (uv - flat_centre).T @ (uv - flat_centre)
    linear = np.linalg.pinv(gram) @ (uv - flat_centre).T @ (vertices - centre)
    return centre + (points - flat_centre) @ linear


def _locate(
    points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], queries: Float[np.ndarray, "n 2"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """The triangle that holds each query point, and the point's barycentric weights in it, none below zero.

    Only the triangles round the nearest corner are tried; a point outside all of them gets the triangle
    with the least negative weight.
    """
    around = _faces_around(faces, len(points))
    _, nearest = cKDTree(points, balanced_tree=False, compact_nodes=False).query(queries)
    a, b, c = points[faces].transpose(1, 0, 2)
    ab, ac = b - a, c - a
    ab, ac = ab / _cross(ab, ac)[:, None], ac / _cross(ab, ac)[:, None]
    best, best_least = np.zeros(len(queries), int), np.full(len(queries), -np.inf)
    weights = np.zeros((len(queries), 3))
    open_ = np.arange(len(queries))
    for column in around.T:
        face = column[nearest[open_]]
        to = queries[open_] - a[face]
        second, third = _cross(to, ac[face]), _cross(ab[face], to)
        found = np.stack([1 - second - third, second, third], axis=1)
        least = found.min(axis=1)
        better = least > best_least[open_]
        at = open_[better]
        best_least[at], best[at], weights[at] = least[better], face[better], found[better]
        open_ = open_[least < 0]
    weights = weights.clip(0.0)
    return best, weights / weights.sum(axis=1, keepdims=True)


def _faces_around(faces: Int[np.ndarray, "f 3"], n: int) -> Int[np.ndarray, "n most"]:
    """The faces round each point; rows of points with fewer faces repeat the last one."""
    owner = faces.ravel()
    order = np.argsort(owner, kind="stable")
    count = np.bincount(owner, minlength=n)
    first = np.cumsum(count) - count
    rank = np.minimum(np.arange(count.max()), np.maximum(count - 1, 0)[:, None])
    return order[np.minimum(first[:, None] + rank, len(order) - 1)] // 3


def _set_border_weights(
    thinned: _Thinned,
    number: Int[np.ndarray, " v"],
    corners: Int[np.ndarray, "v 3"],
    weights: Float[np.ndarray, "v 3"],
) -> None:
    """Set, in place, the weights of border vertices: a kept vertex itself, a dropped one between its neighbours."""
    kept = np.flatnonzero(thinned.kept)
    corners[kept], weights[kept] = number[kept][:, None], (1.0, 0.0, 0.0)
    low, high = number[thinned.between].T
    corners[thinned.dropped] = np.stack([low, high, low], axis=1)
    weights[thinned.dropped] = np.stack([1.0 - thinned.share, thinned.share, np.zeros_like(thinned.share)], axis=1)


def _cross(a: Float[np.ndarray, "*n 2"], b: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
