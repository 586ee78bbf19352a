"""Coarse box meshes, and the interpolation from a coarse mesh to the fine one.

A coarse mesh keeps every second point of each border, the same points on both sides of a seam; the inside of each panel
is triangulated anew. All panels are laid side by side on one lattice and triangulated together: one by one they take
twice as long. ``rows`` are row numbers of ``BoxMesh.uv``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.lattice import PITCH, ROW, Grid, Lattice, build_lattice
from gcd_dataset.generator.mesh.stitch import MOST_POINTS, proper_faces
from gcd_dataset.generator.mesh.triangulate import Loops, Quality, triangulate_loops
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
        start, end, panel = mesh.corners.ravel()[sides], _ends(mesh)[sides], mesh.panel_id[sides // 3]
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
    start, end = mesh.corners.ravel(), _ends(mesh)
    on_border = np.bincount(start, end - mesh.corners[:, [2, 0, 1]].ravel(), minlength=len(mesh.uv)) != 0.0
    near = np.flatnonzero(on_border[start] & on_border[end])
    start, end = start[near], end[near]
    key = np.minimum(start, end) * np.int64(len(mesh.uv)) + np.maximum(start, end)
    order = np.argsort(key)
    changed = np.diff(key[order], prepend=-1, append=-1) != 0
    return np.sort(near[order[changed[:-1] & changed[1:]]])


def _ends(mesh: BoxMesh) -> Int[np.ndarray, " s"]:
    return mesh.corners[:, [1, 2, 0]].ravel()


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


def barycentric(
    points: Float[np.ndarray, "m 2"], triangles: Int[np.ndarray, "n 3"], queries: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 n"]:
    """The barycentric weights of each query point in its triangle of ``points``."""
    (ax, bx, cx), (ay, by, cy) = (np.ascontiguousarray(axis)[triangles.T] for axis in points.T)
    bx, by, cx, cy = bx - ax, by - ay, cx - ax, cy - ay
    x, y, area = queries[:, 0] - ax, queries[:, 1] - ay, bx * cy - by * cx
    second, third = (x * cy - y * cx) / area, (bx * y - by * x) / area
    return np.stack([1 - second - third, second, third])


def locate(
    points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], queries: Float[np.ndarray, "n 2"], cell: float
) -> Int[np.ndarray, " n"]:
    """The triangle that holds each query point; for a point outside all of them, the one that it lies least beyond.

    The query points are sorted into square cells of side ``cell``; each triangle is compared with the points in the
    cells that it may touch.
    """
    triangle, point = _near_pairs(points[faces], queries, cell)
    least = _least(barycentric(points, faces[triangle], queries[point]))
    found = np.full(len(queries), -1)
    inside = least >= 0.0
    found[point[inside]] = triangle[inside]
    beside = np.flatnonzero((found < 0)[point])
    beside = beside[np.argsort(least[beside], kind="stable")]
    found[point[beside]] = triangle[beside]  # assigned in order, so the greatest counts
    lost = np.flatnonzero(found < 0)
    if len(lost):
        found[lost] = cKDTree(points[faces].mean(axis=1)).query(queries[lost])[1]  # the nearest centroid
    return found


def _near_pairs(
    corners: Float[np.ndarray, "f 3 2"], queries: Float[np.ndarray, "n 2"], cell: float
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Pairs of a triangle and a query point in the cells that the triangle's bounding box touches."""
    if not len(queries):
        return np.zeros(0, int), np.zeros(0, int)
    low = queries.min(axis=0)
    at = np.floor((queries - low) / cell).astype(int)
    columns, rows = (at.max(axis=0) + 1).tolist()
    number = at[:, 1] * columns + at[:, 0]
    order = np.argsort(number, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=rows * columns))])
    x, y = (corners - low).transpose(2, 1, 0) / cell
    left, right = (np.floor(bound).astype(int) for bound in (_least(x), -_least(-x)))
    bottom, top = (np.floor(bound).astype(int) for bound in (_least(y), -_least(-y)))
    left, bottom = np.maximum(left, 0), np.maximum(bottom, 0)
    right, top = np.minimum(right, columns - 1), np.minimum(top, rows - 1)
    triangle, row = _runs(bottom, np.where(left <= right, top + 1 - bottom, 0))
    begin, end = first[row * columns + left[triangle]], first[row * columns + right[triangle] + 1]
    run, place = _runs(begin, end - begin)
    return triangle[run], order[place]


def _least(values: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, " n"]:
    return np.minimum(np.minimum(values[0], values[1]), values[2])  # three times as fast as a reduction


def _runs(first: Int[np.ndarray, " n"], count: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """For runs of ``count`` consecutive numbers (none if negative), the run of each number, and the number."""
    count = np.maximum(count, 0)
    run = np.repeat(np.arange(len(first)), count)
    return run, np.arange(len(run)) + (first - np.cumsum(count) + count)[run]


FEW = 1000  # vertices: a smaller mesh drapes as fast without a coarse start
TYPICAL = 0.75  # quantile of a border's segments that is its spacing
COARSE = Quality(longest=1.6, sharpest=float(np.radians(20.0)))  # a tenth of the seeds that the fine mesh's limits add
MARGIN = 2  # rows and columns of the lattice round each panel
SMALL, SAMPLE = 200, 4  # a panel of 200 vertices or more is placed by every fourth
CELL = 0.5  # spacings of the coarse mesh: side of the cells of point location


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
    borders = PanelLoops.of(mesh)
    thinned = thin(mesh, borders)
    return _join(mesh, borders, thinned, _fill(mesh, borders, thinned))


# --------------------------------------------------------------------------------------------------------------- sheet


@dataclass(frozen=True)
class _Sheet:
    """The panels laid side by side on one lattice, with a spacing of 1; ``p`` counts the panels that have faces."""

    centre: Float[np.ndarray, "p 2"]  # middle of each panel's bounding box [cm]
    scale: Float[np.ndarray, "p 2"]
    """The factors that lay a panel [1/cm]: one over its spacing, and negative along x if its border is clockwise."""
    place: Float[np.ndarray, "p 2"]  # the lattice point that each centre is laid on
    grid: Grid  # origin, rows and columns of the lattice
    left: Float[np.ndarray, " p"]  # where each panel's part of the lattice begins along x, ascending

    @staticmethod
    def of(loops: Loops) -> "_Sheet":
        """The sheet of panels with these borders. Raises ``MeshError`` if it takes too many lattice points."""
        first = np.flatnonzero(np.diff(loops.number, prepend=-1))
        ahead = loops.points[loops.after]
        (x, y), (x_ahead, y_ahead) = loops.points.T, ahead.T
        clockwise = np.add.reduceat(x * y_ahead - y * x_ahead, first) < 0.0
        length = np.linalg.norm(ahead - loops.points, axis=1)
        length = length[np.lexsort((length, loops.number))]
        spacing = length[first + np.rint(TYPICAL * (np.diff(first, append=len(length)) - 1)).astype(int)]
        low, high = np.minimum.reduceat(loops.points, first), np.maximum.reduceat(loops.points, first)
        half = np.ceil(0.5 * (high - low) / spacing[:, None] / PITCH / (1.0, ROW)).astype(int) + MARGIN
        end, middle_row = np.cumsum(2 * half[:, 0] + 1), 2 * int(-(-half[:, 1].max() // 2))  # an unshifted row
        if (2 * middle_row + 1) * end[-1] > MOST_POINTS:
            raise MeshError(f"the panels take over {MOST_POINTS:,} lattice points: they cannot be made coarser")
        return _Sheet(
            centre=0.5 * (low + high),
            scale=np.stack([np.where(clockwise, -1.0, 1.0), np.ones(len(spacing))], axis=1) / spacing[:, None],
            place=PITCH * np.stack([end - half[:, 0] - 1.0, np.full(len(end), ROW * middle_row)], axis=1),
            grid=(np.zeros(2), (2 * middle_row + 1, int(end[-1]))),
            left=PITCH * (end - 2 * half[:, 0] - 1.5),
        )

    def lay(self, points: Float[np.ndarray, "n 2"], panel: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Points of panels [cm] on the sheet."""
        shift = self.place - self.centre * self.scale
        return points * self.scale[panel] + shift[panel]

    def lift(self, laid: Float[np.ndarray, "n 2"], panel: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Points of the sheet in the planes of their panels [cm]."""
        return (laid - self.place[panel]) / self.scale[panel] + self.centre[panel]

    def panel_at(self, laid: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """The panel of each point of the sheet."""
        return np.searchsorted(self.left, laid[:, 0], side="right") - 1


@dataclass(frozen=True)
class _Filled:
    """The coarse panels: the kept points of all borders, then seeds panel by panel; ``q`` counts both."""

    panels: Int[np.ndarray, " p"]  # rows of ``panel_names``
    rows: Int[np.ndarray, " b"]  # the rows of the borders' points in the fine mesh
    sheet: _Sheet
    laid: Float[np.ndarray, "q 2"]  # positions on the sheet
    panel: Int[np.ndarray, " q"]  # row of ``panels``
    faces: Int[np.ndarray, "f 3"]  # the triangles: of the strip, then of the lattice
    lattice: Lattice

    def holding(self, laid: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """The triangle that holds each point of the sheet."""
        in_strip = len(self.faces) - len(self.lattice.faces)
        found = self.lattice.faces_at(laid)
        left = found < 0
        found[~left] += in_strip
        found[left] = locate(self.laid, self.faces[:in_strip], laid[left], CELL)
        return found


def _fill(mesh: BoxMesh, borders: PanelLoops, thinned: Thinned) -> _Filled:
    """The coarse panels. Raises ``MeshError`` where a panel is too narrow to lose half of its border points."""
    kept = thinned.kept[mesh.uv_vertex[borders.rows]]
    rows = borders.rows[kept]
    panels, number = np.unique(borders.panel, return_inverse=True)
    number = number[kept]
    loops = Loops.numbered(mesh.uv[rows], number)
    _require_outlines(loops, [mesh.panel_names[panel] for panel in panels])
    sheet = _Sheet.of(loops)
    laid = Loops.numbered(sheet.lay(loops.points, number), number)
    lattice = build_lattice(laid.points, 1.0, after=laid.after, grid=sheet.grid)
    made = triangulate_loops(laid, 1.0, lattice, COARSE)
    n = len(rows)
    panel = np.concatenate([number, sheet.panel_at(made.points[n:])])
    order = np.argsort(np.where(np.arange(len(panel)) < n, -1, panel), kind="stable")
    place = np.empty(len(order), int)
    place[order] = np.arange(len(order))
    return _Filled(panels, rows, sheet, made.points[order], panel[order], place[made.faces], made.lattice)


def _require_outlines(loops: Loops, names: Sequence[str]) -> None:
    """Raise ``MeshError`` for a loop of fewer than three points, or one that touches itself."""
    narrow = np.bincount(loops.number, minlength=len(names)) < 3
    if not narrow.any():
        narrow = ~shapely.is_valid(shapely.polygons(shapely.linearrings(loops.points, indices=loops.number)))
    if narrow.any():
        raise MeshError(f"panel {names[int(narrow.argmax())]} is too narrow to lose half of its border points")


# ---------------------------------------------------------------------------------------------------------------- join


def _join(mesh: BoxMesh, borders: PanelLoops, thinned: Thinned, filled: _Filled) -> CoarseMesh:
    """The coarse panels joined along the seams of the fine mesh: kept vertices first, in their order, then seeds."""
    number = np.cumsum(thinned.kept) - 1
    n, count = len(filled.rows), int(thinned.kept.sum())
    vertex = np.concatenate([number[mesh.uv_vertex[filled.rows]], np.arange(count, count + len(filled.laid) - n)])
    seeds, seed_panel = filled.sheet.lift(filled.laid[n:], filled.panel[n:]), filled.panel[n:]
    fine_panel = _panel_of_rows(mesh, filled.panels)
    faces = filled.faces[np.argsort(filled.panel[filled.faces[:, 0]], kind="stable")]
    faces = faces[proper_faces(vertex[faces])]
    sewn = mesh.seams[thinned.kept[mesh.seams[:, 0]]]
    coarse = BoxMesh(
        vertices=np.concatenate([mesh.vertices[thinned.kept], _in_space(mesh, fine_panel, seeds, seed_panel)]),
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
    return CoarseMesh(coarse, *_interpolation(mesh, borders, thinned, filled, vertex, fine_panel))


def _panel_of_rows(mesh: BoxMesh, panels: Int[np.ndarray, " p"]) -> Int[np.ndarray, " c"]:
    """The row of ``panels`` of each row of ``uv``; -1 for rows without a face."""
    found = np.full(len(mesh.uv), -1)
    found[mesh.corners] = np.searchsorted(panels, mesh.panel_id)[:, None]
    return found


def _in_space(
    mesh: BoxMesh,
    fine_panel: Int[np.ndarray, " c"],
    points: Float[np.ndarray, "m 2"],
    panel: Int[np.ndarray, " m"],
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
    mesh: BoxMesh,
    borders: PanelLoops,
    thinned: Thinned,
    filled: _Filled,
    vertex: Int[np.ndarray, " q"],
    fine_panel: Int[np.ndarray, " c"],
) -> tuple[Int[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    """The coarse vertices that each fine vertex is interpolated from, and their weights, none below zero.

    Border vertices: a kept one is the coarse vertex itself, a dropped one lies between its kept neighbours.
    """
    number = np.cumsum(thinned.kept) - 1
    inside = fine_panel >= 0
    inside[borders.rows] = False
    rows = np.flatnonzero(inside)
    laid = filled.sheet.lay(mesh.uv[rows], fine_panel[rows])
    triangle = filled.faces[filled.holding(laid)]
    found = barycentric(filled.laid, triangle, laid).T.clip(0.0)
    corners, weights = np.zeros((len(mesh.vertices), 3), int), np.zeros((len(mesh.vertices), 3))
    corners[mesh.uv_vertex[rows]] = vertex[triangle]
    weights[mesh.uv_vertex[rows]] = found / found.sum(axis=1, keepdims=True)
    kept = np.flatnonzero(thinned.kept)
    corners[kept], weights[kept] = number[kept][:, None], (1.0, 0.0, 0.0)
    low, high = number[thinned.between].T
    corners[thinned.dropped] = np.stack([low, high, low], axis=1)
    weights[thinned.dropped] = np.stack([1.0 - thinned.share, thinned.share, np.zeros_like(thinned.share)], axis=1)
    return corners, weights
