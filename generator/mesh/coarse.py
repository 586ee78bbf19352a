"""Coarse box meshes, and the interpolation from a coarse mesh to the fine one.

A coarse mesh keeps every second point of each border, the same points on both sides of a seam; the inside of each panel
is triangulated anew. ``rows`` are row numbers of ``BoxMesh.uv``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.rows import stable_order
from gcd_dataset.generator.mesh.stitch import MOST_POINTS, proper_faces
from gcd_dataset.generator.mesh.triangulate import Quality, barycentric, lattice_size, triangulator
from gcd_dataset.records import BoxMesh

STRAIGHT = np.cos(np.radians(25.0))  # border points where the outline turns by more than 25 degrees are kept


@dataclass(frozen=True)
class PanelLoops:
    """The border of every panel as a closed loop, with its panel on the same side of all segments."""

    rows: Int[np.ndarray, " b"]
    """Rows of ``uv``, loop after loop."""
    after: Int[np.ndarray, " b"]
    """The row after each on its loop."""
    panel: Int[np.ndarray, " b"]
    """The panel of each, ascending: one loop for each panel that has faces."""

    @staticmethod
    def of(mesh: BoxMesh) -> "PanelLoops":
        """The borders of a mesh. Raises ``MeshError`` for a panel with a hole or one that touches itself at a point."""
        sides = _border_sides(mesh)
        start, end = mesh.corners.ravel()[sides], mesh.corners[sides // 3, (sides + 1) % 3]
        panel = mesh.panel_id[sides // 3]
        place = np.full(len(mesh.uv), -1)
        place[start] = np.arange(len(start))
        if (place[start] != np.arange(len(start))).any() or (place[end] < 0).any():
            raise MeshError("a panel touches itself at a point: it cannot be made coarser")
        order = np.array(list(_walk(mesh, panel, place[end])), int)
        return PanelLoops(start[order], end[order], panel[order])


def _border_sides(mesh: BoxMesh) -> Int[np.ndarray, " b"]:
    """The sides of one face only; side ``3 f + k`` starts at corner ``k`` of face ``f``.

    The faces round an inner row have the same rows before it as after it. The faces round a row on one border differ in
    the first row and the last one; the sums could be equal only where two borders touch, which leaves a gap in both.
    """
    start, (a, b, c) = mesh.corners.ravel(), mesh.corners.T
    after_less_before = np.stack([b - c, c - a, a - b], axis=1).ravel()
    on_border = (np.bincount(start, after_less_before, minlength=len(mesh.uv)) != 0.0)[mesh.corners]
    near = np.flatnonzero(on_border & on_border[:, [1, 2, 0]])
    start, end = start[near], mesh.corners[near // 3, (near + 1) % 3]
    key = np.minimum(start, end) * np.int64(len(mesh.uv)) + np.maximum(start, end)
    order = stable_order(key)
    changed = np.diff(key[order], prepend=-1, append=-1) != 0
    return np.sort(near[order[changed[:-1] & changed[1:]]])


def _walk(mesh: BoxMesh, panel: Int[np.ndarray, " b"], after: Int[np.ndarray, " b"]) -> Iterator[int]:
    """The sides along each loop, panel by panel, each loop from its first side."""
    numbers, first, counts = np.unique(panel, return_index=True, return_counts=True)
    following = after.tolist()
    for number, start, count in zip(numbers.tolist(), first.tolist(), counts.tolist(), strict=True):
        side, length = start, 0
        while side != start or not length:
            yield side
            side, length = following[side], length + 1
        if length != count:
            raise MeshError(f"panel {mesh.panel_names[number]} has a hole: it cannot be made coarser")


@dataclass(frozen=True)
class Thinned:
    """The border vertices that the coarse mesh keeps, and the positions of the dropped ones between them."""

    kept: Bool[np.ndarray, " v"]
    between: Int[np.ndarray, "k 2"]
    """The kept vertices before and after each dropped vertex."""
    dropped: Int[np.ndarray, " k"]
    share: Float[np.ndarray, " k"]
    """Position of the dropped vertex between those two, 0 to 1."""


def thin(mesh: BoxMesh, borders: PanelLoops) -> Thinned:
    """Every second vertex between corners and ends of seams, and these."""
    graph = _Graph.of(mesh, borders)
    path, chain = graph.chains(_corners(mesh, borders))
    same = np.diff(chain) == 0
    along = np.concatenate([[0.0], np.cumsum(np.where(same, graph.lengths_of(path[:-1], path[1:], same), 0.0))])
    first = np.flatnonzero(np.diff(chain, prepend=-1))
    segments = np.diff(first, append=len(path)) - 1
    closed = path[first] == path[first + segments]
    pieces = np.minimum(np.maximum((segments + 1) // 2, np.where(closed, 3, 2)), segments)
    stop = np.zeros(len(path), bool)
    number = np.arange(pieces.sum() + len(pieces)) - np.repeat(np.cumsum(pieces + 1) - pieces - 1, pieces + 1)
    stop[np.repeat(first, pieces + 1) + np.rint(number * np.repeat(segments / pieces, pieces + 1)).astype(int)] = True
    kept = np.zeros(len(mesh.vertices), bool)
    kept[path[stop]] = True
    at, stops = np.flatnonzero(~stop), np.flatnonzero(stop)
    after = np.searchsorted(stops, at)
    low, high = stops[after - 1], stops[after]
    share = (along[at] - along[low]) / (along[high] - along[low])
    return Thinned(kept, path[np.stack([low, high], axis=1)], path[at], share)


def _corners(mesh: BoxMesh, borders: PanelLoops) -> Int[np.ndarray, " k"]:
    """The vertices where an outline turns by more than ``STRAIGHT``."""
    step = mesh.uv[borders.after] - mesh.uv[borders.rows]
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    onward = np.empty(len(mesh.uv), int)
    onward[borders.rows] = np.arange(len(step))
    turned = (step[onward[borders.after]] * step).sum(axis=1) < STRAIGHT
    return mesh.uv_vertex[borders.after[turned]]


@dataclass(frozen=True)
class _Graph:
    """The vertices on borders, and the segments between them, each once for both panels of a seam."""

    size: int  # number of vertices of the mesh
    key: Int[np.ndarray, " h"]  # ``start * size + end`` of each segment in both directions, ascending
    length: Float[np.ndarray, " h"]  # flat lengths [cm]

    @staticmethod
    def of(mesh: BoxMesh, borders: PanelLoops) -> "_Graph":
        size = np.int64(len(mesh.vertices))
        start, end = mesh.uv_vertex[borders.rows], mesh.uv_vertex[borders.after]
        length = np.linalg.norm(mesh.uv[borders.after] - mesh.uv[borders.rows], axis=1)
        proper = start != end
        start, end, length = start[proper], end[proper], length[proper]
        keys = np.stack([start * size + end, end * size + start], axis=1)[::-1]
        key, last = np.unique(keys, return_index=True)  # on a seam, the length of the later panel
        return _Graph(int(size), key, length[::-1][last // 2])

    def lengths_of(
        self, start: Int[np.ndarray, " n"], end: Int[np.ndarray, " n"], known: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """The length of each segment [cm]; of any segment where it is not ``known``."""
        return self.length[np.searchsorted(self.key, np.where(known, start * self.size + end, self.key[0]))]

    def chains(self, corners: Int[np.ndarray, " k"]) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """The segments as chains of vertices, one after the other: the vertices, and the chain of each.

        A chain runs between corners or vertices without exactly two neighbours. A closed border without one becomes a
        chain that starts and stops at the same vertex.
        """
        start, end = np.divmod(self.key, self.size)
        stops = np.bincount(start, minlength=self.size) != 2
        stops[corners] = True
        both = np.bincount(start, end, minlength=self.size).astype(int).tolist()  # the sum of two neighbours
        stopping, seen = stops.tolist(), bytearray(self.size)
        path: list[int] = []
        sizes: list[int] = []

        def follow(first: int, onward: int) -> None:
            before, here, begin = first, onward, len(path)
            path.append(first)
            while not stopping[here] and here != first:
                path.append(here)
                seen[here] = True
                before, here = here, both[here] - before
            path.append(here)
            sizes.append(len(path) - begin)

        leaving = stops[start]
        for first, onward in zip(start[leaving].tolist(), end[leaving].tolist(), strict=True):
            if not seen[onward] and (not stopping[onward] or first < onward):
                follow(first, onward)
        for vertex, onward in zip(start[~leaving].tolist(), end[~leaving].tolist(), strict=True):
            if not seen[vertex]:
                follow(vertex, onward)
                seen[vertex] = True
        return np.array(path, int), np.repeat(np.arange(len(sizes)), sizes)


FEW = 1000  # vertices: a smaller mesh drapes as fast without a coarse start
TYPICAL = 0.75  # quantile of a border's segments that is its spacing
COARSE = Quality(longest=1.6, sharpest=float(np.radians(20.0)))  # a tenth of the seeds that the fine mesh's limits add
SMALL, SAMPLE = 200, 4  # a panel of 200 vertices or more is placed by every fourth


@dataclass(frozen=True)
class CoarseMesh:
    """A coarse mesh of the same panels and seams, with interpolation weights for the fine vertices."""

    mesh: BoxMesh
    corners: Int[np.ndarray, "v 3"]
    """The coarse vertices that each fine vertex is interpolated from."""
    weights: Float[np.ndarray, "v 3"]
    """Their barycentric weights, which add up to 1."""


def coarse_start(mesh: BoxMesh) -> CoarseMesh | None:
    """The coarse mesh that a drape starts with; ``None`` if the mesh is small or a panel too narrow."""
    if len(mesh.vertices) < FEW or len(mesh.folds):  # a coarse mesh would lose the folds
        return None
    try:
        return coarsen(mesh)
    except MeshError:
        return None


def coarsen(mesh: BoxMesh) -> CoarseMesh:
    """The same garment at twice the spacing. Raises ``MeshError`` where a panel is too narrow, or sewn along a line."""
    borders = PanelLoops.of(mesh)
    inner = np.ones(len(mesh.uv), bool)
    inner[borders.rows] = False
    if np.isin(mesh.uv_vertex[inner], mesh.seams[:, 0]).any():
        raise MeshError("a seam runs inside a panel: it cannot be made coarser")
    thinned = thin(mesh, borders)
    return _join(mesh, borders, thinned, _fill(mesh, borders, thinned))


@dataclass(frozen=True)
class _Filled:
    """The coarse panels: the kept points of all borders, then seeds panel by panel; ``q`` counts both."""

    panels: Int[np.ndarray, " p"]  # rows of ``panel_names``: the panels that have faces
    fine_panel: Int[np.ndarray, " c"]
    """The row of ``panels`` of each row of the fine mesh's ``uv``; -1 for rows without a face."""
    rows: Int[np.ndarray, " b"]  # the rows of the borders' points in the fine mesh
    flat: Float[np.ndarray, "q 2"]
    """Positions in the planes of the panels [cm]."""
    panel: Int[np.ndarray, " q"]
    """Row of ``panels``."""
    faces: Int[np.ndarray, "f 3"]
    """Panel by panel, counter-clockwise from outside or inside as the borders are."""
    inner: Int[np.ndarray, " i"]
    """The fine mesh's rows on no border."""
    holding: Int[np.ndarray, " i"]
    """The coarse triangle that holds each of them, or the one that it lies least beyond."""


def _fill(mesh: BoxMesh, borders: PanelLoops, thinned: Thinned) -> _Filled:
    """The coarse panels. Raises ``MeshError`` where a panel is too narrow to lose half of its border points."""
    kept = thinned.kept[mesh.uv_vertex[borders.rows]]
    rows = borders.rows[kept]
    panels, number = np.unique(borders.panel, return_inverse=True)
    fine_panel = np.full(len(mesh.uv), -1)  # stays -1 for rows of ``uv`` without a face
    fine_panel[mesh.corners] = np.searchsorted(panels, mesh.panel_id)[:, None]
    of_inner = fine_panel.copy()
    of_inner[borders.rows] = -1
    inner = np.split(stable_order(of_inner + 1), np.cumsum(np.bincount(of_inner + 1, minlength=len(panels) + 1))[:-1])
    flat, panel, faces, holding = [mesh.uv[rows]], [number[kept]], [], []
    size, own, n_faces = len(rows), 0, 0
    sizes = np.bincount(panel[0], minlength=len(panels))
    _require_outlines([mesh.panel_names[k] for k in panels], flat[0], panel[0], sizes)
    # Laid with a spacing of 1 about its middle, mirrored if its border is clockwise.
    for k, (border, scale, middle) in enumerate(_scaled(flat[0], sizes)):
        laid = (border - middle) * scale
        if lattice_size(laid, 1.0) > MOST_POINTS:
            raise MeshError(f"panel {mesh.panel_names[panels[k]]} takes over {MOST_POINTS:,} points")
        seeds, triangles = triangulator().fill(laid, 1.0, COARSE)
        flat.append(seeds / scale + middle)
        panel.append(np.full(len(seeds), k))
        faces.append(np.where(triangles < sizes[k], triangles + own, triangles - sizes[k] + size))
        holding.append(n_faces + triangulator().holding((mesh.uv[inner[k + 1]] - middle) * scale))
        size, own, n_faces = size + len(seeds), own + sizes[k], n_faces + len(triangles)
    joined = (np.concatenate(parts) for parts in (flat, panel, faces, inner[1:], holding))
    return _Filled(panels, fine_panel, rows, *joined)


def _require_outlines(
    names: Sequence[str], flat: Float[np.ndarray, "b 2"], number: Int[np.ndarray, " b"], sizes: Int[np.ndarray, " p"]
) -> None:
    """Raise ``MeshError`` for a border of fewer than three points, or one that touches itself.

    ``number``: the border of each point, ascending.
    """
    narrow = sizes < 3
    if not narrow.any():
        narrow = ~shapely.is_valid(shapely.polygons(shapely.linearrings(flat, indices=number)))
    if narrow.any():
        raise MeshError(f"panel {names[int(narrow.argmax())]} is too narrow to lose half of its border points")


def _scaled(
    flat: Float[np.ndarray, "b 2"], sizes: Int[np.ndarray, " p"]
) -> Iterator[tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "2"], Float[np.ndarray, "2"]]]:
    """The points of each loop, the scale that gives it a spacing of 1 and runs it counter-clockwise, and its middle."""
    first, last = np.cumsum(sizes) - sizes, np.cumsum(sizes) - 1
    after = np.arange(1, len(flat) + 1)
    after[last] = first
    ahead = flat[after]
    length = np.linalg.norm(ahead - flat, axis=1)
    area = np.add.reduceat(flat[:, 0] * ahead[:, 1] - flat[:, 1] * ahead[:, 0], first)
    middle = 0.5 * (np.minimum.reduceat(flat, first) + np.maximum.reduceat(flat, first))
    mirror = np.stack([np.where(area > 0.0, 1.0, -1.0), np.ones(len(sizes))], axis=1)
    for k, size in enumerate(sizes.tolist()):
        loop = slice(first[k], first[k] + size)
        yield flat[loop], mirror[k] / np.sort(length[loop])[round(TYPICAL * (size - 1))], middle[k]


def _join(mesh: BoxMesh, borders: PanelLoops, thinned: Thinned, filled: _Filled) -> CoarseMesh:
    """The coarse panels joined along the seams of the fine mesh: kept vertices first, in their order, then seeds."""
    number = np.cumsum(thinned.kept) - 1
    n, count = len(filled.rows), int(thinned.kept.sum())
    vertex = np.concatenate([number[mesh.uv_vertex[filled.rows]], np.arange(count, count + len(filled.flat) - n)])
    seeds = filled.flat[n:]
    faces = filled.faces[proper_faces(vertex[filled.faces])]
    sewn = mesh.seams[thinned.kept[mesh.seams[:, 0]]]
    coarse = BoxMesh(
        vertices=np.concatenate(
            [mesh.vertices[thinned.kept], _in_space(mesh, filled.fine_panel, seeds, filled.panel[n:])]
        ),
        faces=vertex[faces],
        uv=np.concatenate([mesh.uv[filled.rows], seeds]),
        corners=faces,
        uv_vertex=vertex,
        panel_id=filled.panels[filled.panel[faces[:, 0]]],
        panel_names=mesh.panel_names,
        panel_labels=mesh.panel_labels,
        seams=np.stack([number[sewn[:, 0]], sewn[:, 1]], axis=1),
        labels={name: number[ids[thinned.kept[ids]]] for name, ids in mesh.labels.items()},
    )
    return CoarseMesh(coarse, *_interpolation(mesh, thinned, filled, vertex))


def _in_space(
    mesh: BoxMesh, fine_panel: Int[np.ndarray, " c"], points: Float[np.ndarray, "m 2"], panel: Int[np.ndarray, " m"]
) -> Float[np.ndarray, "m 3"]:
    """Flat points of panels in space before sewing [cm], by the affine map of each panel's vertices on no seam."""
    used = fine_panel >= 0
    free = used & (mesh.uv_vertex >= mesh.n_seam_vertices)
    enough = np.bincount(fine_panel[free], minlength=fine_panel.max() + 1) > 2
    rows = np.flatnonzero(np.where(enough[fine_panel], free, used))
    small = np.bincount(fine_panel[rows]) < SMALL
    rows = rows[small[fine_panel[rows]] | (np.arange(len(rows)) % SAMPLE == 0)]
    rows = rows[np.argsort(fine_panel[rows], kind="stable")]
    first = np.flatnonzero(np.diff(fine_panel[rows], prepend=-1))
    size = np.diff(first, append=len(rows))
    both = np.concatenate([mesh.uv[rows].T, mesh.vertices[mesh.uv_vertex[rows]].T])  # rows: sums along them are fast
    centre = np.add.reduceat(both, first, axis=1) / size
    both = both - np.repeat(centre, size, axis=1)
    products = np.add.reduceat(both[:2, None] * both, first, axis=2).transpose(2, 0, 1)
    linear = np.einsum("pij,pjk->pik", np.linalg.pinv(products[:, :, :2]), products[:, :, 2:])
    flat_centre, centre = centre[:2].T, centre[2:].T
    return centre[panel] + np.einsum("mi,mik->mk", points - flat_centre[panel], linear[panel])


def _interpolation(
    mesh: BoxMesh, thinned: Thinned, filled: _Filled, vertex: Int[np.ndarray, " q"]
) -> tuple[Int[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    """The coarse vertices that each fine vertex is interpolated from, and their weights, none below zero.

    Border vertices: a kept one is the coarse vertex itself, a dropped one lies between its kept neighbours.
    """
    number = np.cumsum(thinned.kept) - 1
    rows, triangle = filled.inner, filled.faces[filled.holding]
    found = barycentric(filled.flat, triangle, mesh.uv[rows]).T.clip(0.0)
    corners, weights = np.zeros((len(mesh.vertices), 3), int), np.zeros((len(mesh.vertices), 3))
    corners[mesh.uv_vertex[rows]] = vertex[triangle]
    weights[mesh.uv_vertex[rows]] = found / found.sum(axis=1, keepdims=True)
    kept = np.flatnonzero(thinned.kept)
    corners[kept], weights[kept] = number[kept][:, None], (1.0, 0.0, 0.0)
    low, high = number[thinned.between].T
    corners[thinned.dropped] = np.stack([low, high, low], axis=1)
    weights[thinned.dropped] = np.stack([1.0 - thinned.share, thinned.share, np.zeros_like(thinned.share)], axis=1)
    return corners, weights
