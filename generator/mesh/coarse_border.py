"""The borders of a box mesh, and the half of their points that a coarse mesh keeps, the same on both sides of seams."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.errors import MeshError
from gcd_dataset.records import BoxMesh

STRAIGHT = np.cos(np.radians(25.0))  # border points where the outline turns by more than 25 degrees are kept


@dataclass(frozen=True)
class Borders:
    """The border of every panel as a closed loop, with its panel on the same side of all segments."""

    rows: Int[np.ndarray, " b"]
    """Rows of ``uv``, loop after loop."""
    after: Int[np.ndarray, " b"]
    """The row after each on its loop."""
    panel: Int[np.ndarray, " b"]
    """The panel of each, ascending: one loop for each panel that has faces."""

    @staticmethod
    def of(mesh: BoxMesh) -> "Borders":
        """The borders of a mesh. Raises ``MeshError`` for a panel with a hole or one that touches itself at a point."""
        sides = _border_sides(mesh)
        start, end, panel = mesh.corners.ravel()[sides], _ends(mesh)[sides], mesh.panel_id[sides // 3]
        place = np.full(len(mesh.uv), -1)
        place[start] = np.arange(len(start))
        if (place[start] != np.arange(len(start))).any() or (place[end] < 0).any():
            raise MeshError("a panel touches itself at a point: it cannot be made coarser")
        order = np.array(list(_walk(mesh, panel, place[end])), int)
        return Borders(start[order], end[order], panel[order])


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


def thin(mesh: BoxMesh, borders: Borders) -> Thinned:
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


def _corners(mesh: BoxMesh, borders: Borders) -> Int[np.ndarray, " k"]:
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

    size: int
    """Number of vertices of the mesh."""
    key: Int[np.ndarray, " h"]
    """``start * size + end`` of each segment in both directions, ascending."""
    length: Float[np.ndarray, " h"]
    """Flat lengths [cm]."""

    @staticmethod
    def of(mesh: BoxMesh, borders: Borders) -> "_Graph":
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
