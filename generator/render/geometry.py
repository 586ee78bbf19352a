"""Meshes prepared for ray casting: garment, body, hair and eyes in one list, and the borders of the panels."""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.generator.render.figure import Eyes, eyeballs, hair_shell
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.records import Record

HEM = -2
"""In place of a seam's row: an edge of cloth without a seam."""


@dataclass(frozen=True, eq=False)
class PanelBorders(Record):
    """The segments of the panels' outlines, panel by panel."""

    ends: Int[np.ndarray, "b 2"]
    """Rows of ``uv``."""
    seam: Int[np.ndarray, " b"]
    """Row of the pattern's seams, ``HEM`` for an edge without a seam, -1 for a seam of unknown row."""
    along: Float[np.ndarray, " b"]
    """Length of the outline up to the segment [cm]."""
    first: Int[np.ndarray, " p1"]
    """First segment of each panel; ``first[p]:first[p + 1]`` are those of panel p."""
    flags: Int[np.ndarray, " f"]
    """Of each face: bit k for a seam at edge (k, k + 1), bit 3 + k for a hem."""


@dataclass(frozen=True, eq=False)
class Solid(Record):
    """Everything that rays may hit, in the order garment, body, hair, eyes."""

    parts: tuple[tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]], ...]
    """Vertices [cm] and faces of each part; faces count from the part's first vertex."""
    garment_faces: int
    body_faces: int
    hair_faces: int
    garment_vertices: int
    eyes: Eyes

    @property
    def starts(self) -> list[int]:
        """Row of each part's first vertex, and the number of all vertices."""
        return list(accumulate((len(vertices) for vertices, _ in self.parts), initial=0))

    @cached_property
    def position(self) -> Float[np.ndarray, "n 3"]:
        """All vertices [cm]."""
        return np.concatenate([vertices for vertices, _ in self.parts])

    @cached_property
    def faces(self) -> Int[np.ndarray, "m 3"]:
        """All faces, as rows of ``position``."""
        return np.concatenate([faces + begin for (_, faces), begin in zip(self.parts, self.starts, strict=False)])


def solid_of(scene: Scene) -> Solid:
    """The scene as one mesh."""
    body, hair, eyes = scene.body, hair_shell(scene), eyeballs(scene.body)
    return Solid(
        parts=tuple((one.vertices, one.faces) for one in (scene, body, hair, eyes)),
        garment_faces=len(scene.faces),
        body_faces=len(body.faces),
        hair_faces=len(hair.faces),
        garment_vertices=len(scene.vertices),
        eyes=eyes,
    )


def panel_borders(scene: Scene) -> PanelBorders:
    """The outlines of all panels, found in the mesh, with the seam of each segment."""
    face, k, ends = _border_edges(scene.corners, len(scene.uv))
    seam = _seam_of_edge(scene, scene.uv_vertex[ends])
    bits = np.where(seam == HEM, 8, 1) << k
    flags = np.bincount(face, bits, minlength=len(scene.faces)).astype(np.int32)
    panel = scene.panel_of_row[ends[:, 0]]
    order = np.argsort(panel, kind="stable")
    along = _lengths_along(ends, scene.uv, len(scene.uv))
    first = np.searchsorted(panel[order], np.arange(len(scene.panel_names) + 1))
    return PanelBorders(ends[order], seam[order], along[order], first, flags)


def _border_edges(
    corners: Int[np.ndarray, "f 3"], rows: int
) -> tuple[Int[np.ndarray, " b"], Int[np.ndarray, " b"], Int[np.ndarray, "b 2"]]:
    """Face, number in the face, and rows of both ends of each edge on a border, counter-clockwise.

    Round a row, each face (row, x, y) turns from x to y. Inside a panel the turns close and the sums of x - y and
    of x² - y² are 0; on the border they leave first - last and first² - last², from which both follow.
    """
    a, b, c = np.ascontiguousarray(corners.T)
    turns = ((a, b, c), (b, c, a), (c, a, b))  # the row at each corner of all faces, the rows after and before it
    # Whole numbers below 2**53: sums are exact.
    difference = np.add.reduce([np.bincount(row, after - before, minlength=rows) for row, after, before in turns])
    is_open = difference != 0
    near = [np.flatnonzero(is_open.take(row)) for row in (a, b, c)]
    row, after, before = (
        np.concatenate([corner.take(faces) for corner, faces in zip(each, near, strict=True)])
        for each in zip(*turns, strict=True)
    )
    place = np.concatenate([3 * faces + k for k, faces in enumerate(near)])
    turn, squares = difference[row], np.bincount(row, after * after - before * before, minlength=rows)[row]
    # Two fans that meet in one row do not give a row of the mesh: such a row has no border.
    edge = np.flatnonzero(0.5 * (squares / turn + turn) == after)
    edge = edge[np.argsort(place[edge])]
    return place[edge] // 3, place[edge] % 3, np.stack([row[edge], after[edge]], axis=1)


def _seam_of_edge(scene: Scene, edges: Int[np.ndarray, "b 2"]) -> Int[np.ndarray, " b"]:
    """The seam of each border edge, by its vertices; ``HEM`` if one panel alone has it, -1 if the row is unknown."""
    one, other = edges.T
    keys = np.minimum(one, other) * (len(scene.vertices) + 1) + np.maximum(one, other)
    order = np.argsort(keys, kind="stable")
    twins = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    seam = np.full(len(edges), HEM)
    seam[order[twins]] = seam[order[twins + 1]] = -1
    if not len(scene.seams):
        return seam
    by_vertex = scene.seams[np.argsort(scene.seams[:, 0], kind="stable")]
    rows = int(by_vertex[:, 1].max()) + 1
    known = np.sort(by_vertex[:, 0] * rows + by_vertex[:, 1])
    begin = np.searchsorted(by_vertex[:, 0], one)
    end = np.searchsorted(by_vertex[:, 0], one, side="right")
    for offset in range(int((end - begin).max(initial=0)) - 1, -1, -1):
        sewn = np.flatnonzero((begin + offset < end) & (seam != HEM))
        row = by_vertex[begin[sewn] + offset, 1]
        wanted = other[sewn] * rows + row
        at = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
        shared = known[at] == wanted
        seam[sewn[shared]] = row[shared]
    return seam


def _lengths_along(ends: Int[np.ndarray, "b 2"], uv: Float[np.ndarray, "c 2"], rows: int) -> Float[np.ndarray, " b"]:
    """Length of the outline from a fixed point of it up to each segment [cm], by pointer doubling."""
    count = len(ends)
    number = np.full(rows, count)
    number[ends[:, 0]] = np.arange(count)
    before = np.full(count + 1, count)  # the last entry stands for no segment: it is before itself and has no length
    before[number[ends[:, 1]]] = np.arange(count)
    before[count] = count
    before = _cut_loops(before)
    span = uv[ends[:, 1]] - uv[ends[:, 0]]
    lengths = np.append(np.linalg.norm(span, axis=1), 0.0)
    total, jump = lengths[before], before
    while (jump < count).any():
        total += total[jump]
        jump = jump[jump]
    return total[:count]


def _cut_loops(before: Int[np.ndarray, " b1"]) -> Int[np.ndarray, " b1"]:
    """The chain of predecessors, cut at the lowest number of each loop."""
    lowest, jump = np.arange(len(before)), before
    while True:
        # Over twice as many predecessors; where that changes nothing, loops are closed.
        lower = np.minimum(lowest, lowest[jump])
        if (lower == lowest).all():
            break
        lowest, jump = lower, jump[jump]
    return np.where(lowest == np.arange(len(before)), len(before) - 1, before)
