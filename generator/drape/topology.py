"""Topology of a batch on its device: edges, hinges and rows of elastic weights, from the box meshes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
import warp as wp

from gcd_dataset.generator.device import to_host
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.fabrics import DYNE_CM
from gcd_dataset.generator.drape.kernels import rows as row_kernels
from gcd_dataset.generator.drape.kernels import topology as kernels
from gcd_dataset.generator.drape.kernels.elastic import USUAL, Bend, Corner, Rows, Spring
from gcd_dataset.generator.drape.kernels.sheet import Sheet, sheet_of
from gcd_dataset.generator.drape.loading import load_drape
from gcd_dataset.generator.drape.tucked import widths
from gcd_dataset.records import BoxMesh

PRESSED = 10.0  # 1/cm: stiffness of a pressed crease, over the bending rigidity
FOLDED_GAP = 0.3  # cm between the layers of a fold, at the apexes of its faces
WARP = 32  # threads of a CUDA warp


@dataclass(frozen=True)
class Topology:
    """Arrays over the vertices ``v``, edges ``e`` and faces ``f`` of all garments, one garment after the other."""

    vertex_world: wp.array
    """(v) world of each vertex."""
    start: wp.array
    """(v) positions before sewing [cm]."""
    surface: kernels.ClothSurface
    hinges: kernels.Hinges
    mass: wp.array
    """(v) mass [g]."""
    stiffness: wp.array
    """(v) upper bound of the vertex's contribution to the largest eigenvalue of the stiffness matrix [g/s²]."""
    rows: Rows
    keeper: wp.array
    """(v) 1 at keepers: vertices that keep their garment up."""
    vertex_offset: np.ndarray
    """(w + 1) first vertex of each garment, and the number of vertices."""
    face_offset: np.ndarray
    """(w + 1) first face of each garment, and the number of faces."""
    edge_offset: np.ndarray
    """(w + 1) first edge of each garment, and the number of edges."""


def build_topology(
    jobs: Sequence[DrapeJob], config: DrapeConfig, keepers: Sequence[np.ndarray], device: str
) -> Topology:
    """The topology of all garments, in the order of the jobs; ``keepers``: vertex indices for each garment."""
    load_drape(device)
    meshes = [job.box_mesh for job in jobs]
    batch = MeshBatch.of(meshes, device)
    start = batch.joined([mesh.vertices for mesh in meshes], np.float32, wp.vec3)
    sizes = np.diff(batch.vertices)
    world = wp.array(np.repeat(np.arange(len(jobs), dtype=np.int32), sizes), dtype=int, device=device)
    sheets = wp.array([sheet_of(job.fabric) for job in jobs], dtype=Sheet, device=device)
    surface = batch.surface(meshes)
    panel = batch.joined([mesh.panel_id for mesh in meshes], np.int32, int)
    hinges, edge_offset = batch.describe_edges(surface, panel, start, world, sheets)
    if any(np.isfinite(job.tucked_below) for job in jobs):
        width = batch.joined([widths(job, config) for job in jobs], np.float32, float)
        batch.launch(kernels.take_in, len(surface.edges), [surface.edges, start, width], [hinges.spring])
    batch.find_faces(surface)
    batch.find_edges(surface)
    folds = [folds_of(job) for job in jobs]
    most = max((np.bincount(each.apexes.ravel()).max(initial=0) for each in folds), default=0)
    rows = batch.rows(surface, coupled=not all(job.fabric.isotropic for job in jobs), further=int(most))
    keeper = batch.marked(keepers)
    n = int(batch.vertices[-1])
    mass, stiffness = batch.empty(n, float), batch.empty(n, float)
    if folded := sum(len(each.edges) for each in folds):
        edges = batch.joined([each.edges for each in folds], np.int32, wp.vec2i, batch.vertices)
        batch.launch(row_kernels.free_hinges, folded, [edges, surface], [hinges])
    batch.launch(row_kernels.weigh_rows, n, [surface, hinges, world, keeper, sheets], [mass, stiffness, rows])
    if folded:
        apexes = batch.joined([each.apexes for each in folds], np.int32, wp.vec2i, batch.vertices)
        springs = batch.joined([each.springs for each in folds], np.float32, wp.vec3)
        batch.launch(row_kernels.press_folds, 1, [apexes, springs], [stiffness, rows])
    return Topology(
        vertex_world=world,
        start=start,
        surface=surface,
        hinges=hinges,
        mass=mass,
        stiffness=stiffness,
        rows=rows,
        keeper=keeper,
        vertex_offset=batch.vertices,
        face_offset=batch.faces,
        edge_offset=edge_offset,
    )


@dataclass(frozen=True)
class Folds:
    """The pressed folds of a garment as springs across them, between the apexes of the two faces along an edge."""

    edges: np.ndarray
    """(k, 2) vertices of the edges, whose hinges do not bend back."""
    apexes: np.ndarray
    """(m, 2) vertices that the springs join."""
    springs: np.ndarray
    """(m, 3) stiffness, rest length and start length [g/s², cm, cm]."""


def folds_of(job: DrapeJob) -> Folds:
    """The folds of a garment with a rest angle.

    A spring's rest length is the distance of its ends at the rest angle, its stiffness that of a crease, ``PRESSED``
    times the bending rigidity of a centimetre of cloth: k = B L / (h₁ h₂), for faces of heights h over an edge L.
    """
    mesh = job.box_mesh
    if not len(mesh.folds):
        return Folds(np.zeros((0, 2), int), np.zeros((0, 2), int), np.zeros((0, 3)))
    rows, angles = mesh.folds[:, :2].astype(int), np.radians(mesh.folds[:, 2])
    number = {frozenset(pair): k for k, pair in enumerate(rows.tolist())}
    beside: dict[int, list[int]] = {}
    for a, b, c in mesh.corners[np.isin(mesh.corners, rows).sum(axis=1) > 1].tolist():
        for pair, apex in (((a, b), c), ((b, c), a), ((c, a), b)):
            if (k := number.get(frozenset(pair))) is not None:
                beside.setdefault(k, []).append(apex)
    vertex = mesh.uv_vertex
    inner = [k for k, pair in beside.items() if len(pair) == 2 and vertex[pair[0]] != vertex[pair[1]]]
    across = np.array([beside[k] for k in inner], int).reshape(-1, 2)
    start, end = mesh.uv[rows[inner]].transpose(1, 0, 2)
    length = np.linalg.norm(end - start, axis=1)
    along = (end - start) / np.maximum(length, 1e-9)[:, None]
    out = mesh.uv[across] - start[:, None]
    at = np.einsum("kad,kd->ka", out, along)
    high, low = np.abs(out[..., 0] * along[:, None, 1] - out[..., 1] * along[:, None, 0]).T
    flat = high**2 + low**2 + 2.0 * high * low * np.cos(angles[inner])
    rest = np.sqrt(np.maximum(flat, 0.0) + (at[:, 0] - at[:, 1]) ** 2 + FOLDED_GAP**2)
    apexes = vertex[across]
    now = np.linalg.norm(np.subtract(*mesh.vertices[apexes].transpose(1, 0, 2)), axis=1)
    stiffness = PRESSED * job.fabric.bend.weft * DYNE_CM * length / np.maximum(high * low, 1e-6)
    return Folds(vertex[rows], apexes, np.stack([stiffness, rest, now], axis=1))


@dataclass(frozen=True)
class MeshBatch:
    """The device of a batch, and the offsets (w + 1) of vertices, corners (rows of ``uv``) and faces."""

    device: str
    vertices: np.ndarray
    corners: np.ndarray
    faces: np.ndarray

    @classmethod
    def of(cls, meshes: Sequence[BoxMesh], device: str) -> Self:
        """The batch of garments in the order of their meshes."""
        counts = [[len(mesh.vertices), len(mesh.uv), len(mesh.faces)] for mesh in meshes]
        return cls(device, *np.cumsum([[0, 0, 0], *counts], axis=0).T)

    def surface(self, meshes: Sequence[BoxMesh]) -> kernels.ClothSurface:
        """Faces with their flat corner coordinates; ``describe_edges`` adds the edges."""
        count = int(self.faces[-1])
        corner = self.joined([mesh.corners for mesh in meshes], np.int32, wp.vec3i, self.corners)
        uv = self.joined([mesh.uv for mesh in meshes], np.float64, wp.vec2d)
        surface = kernels.ClothSurface()
        surface.faces = self.joined([mesh.faces for mesh in meshes], np.int32, wp.vec3i, self.vertices)
        surface.flat = self.empty((count, 3), wp.vec2d)
        surface.side_edge = self.empty(3 * count, int)
        self.launch(kernels.lay_flat, count, [corner, uv], [surface.flat])
        return surface

    def describe_edges(
        self, surface: kernels.ClothSurface, panel: wp.array, start: wp.array, world: wp.array, sheets: wp.array
    ) -> tuple[kernels.Hinges, np.ndarray]:
        """Fills the edges of ``surface``; returns springs and hinges, and the first edge of each garment.

        ``panel``: (f) panel of each face.
        """
        sides = 3 * int(self.faces[-1])
        keys, order, number = self.empty(2 * sides, wp.int64), self.empty(2 * sides, int), self.empty(sides, int)
        self.launch(kernels.key_sides, sides, [surface.faces], [keys, order])
        wp.utils.radix_sort_pairs(keys, order, sides)
        keys = keys[:sides]
        self.launch(kernels.mark_firsts, sides, [panel, keys], [order, number])
        wp.utils.array_scan(number, number, inclusive=True)
        first_sides = wp.array(3 * self.faces.astype(np.int32), dtype=int, device=self.device)
        edge_offset = self.empty(len(self.faces), int)
        self.launch(kernels.count_edges, len(self.faces), [first_sides, number], [edge_offset])
        offsets: np.ndarray = to_host(edge_offset)
        count = int(offsets[-1])
        surface.edges, surface.opposite = self.empty(count, wp.vec2i), self.empty(count, wp.vec2i)
        hinges = kernels.Hinges()
        hinges.spring, hinges.weights = self.empty(count, wp.vec3), self.empty(count, wp.vec4)
        hinges.scale = self.empty(count, float)
        inputs = [start, world, sheets, keys, order, number]
        self.launch(kernels.describe_edges, sides, inputs, [surface, hinges])
        return hinges, offsets

    def find_faces(self, surface: kernels.ClothSurface) -> None:
        """Fill the faces round each vertex in ``surface`` (compressed sparse rows)."""
        sides = 3 * int(self.faces[-1])
        surface.vertex_faces, surface.first_face = self._by_vertex(kernels.key_corners, surface.faces, sides)

    def find_edges(self, surface: kernels.ClothSurface) -> None:
        """Fill the edges round each vertex in ``surface``, after ``describe_edges``."""
        ends = 2 * len(surface.edges)
        surface.vertex_edges, surface.first_edge = self._by_vertex(kernels.key_ends, surface.edges, ends)

    def _by_vertex(self, kernel: wp.Kernel, elements: wp.array, size: int) -> tuple[wp.array, wp.array]:
        """Faces or edges sorted by vertex, and the first entry of each vertex."""
        keys, owner, first = (
            self.empty(2 * size, int),
            self.empty(2 * size, int),
            self.empty(int(self.vertices[-1]) + 1, int),
        )
        self.launch(kernel, size, [elements], [keys, owner])
        wp.utils.radix_sort_pairs(keys, owner, size)
        self.launch(kernels.find_firsts, size + 1, [keys, size], [first])
        return owner[:size], first

    def rows(self, surface: kernels.ClothSurface, *, coupled: bool, further: int) -> Rows:
        """Uninitialised rows for all vertices; ``coupled``: with the corners that fabrics with a grain need.

        ``further``: most springs of a vertex across folds.
        """
        # More faces than edges, and a bend for each face, where more than two panels meet.
        widest, n = wp.zeros(1, dtype=int, device=self.device), int(self.vertices[-1])
        self.launch(kernels.find_widest, n, [surface.first_edge, surface.first_face], [widest])
        return empty_rows(n, int(to_host(widest)[0]) + further, self.device, coupled=coupled)

    def marked(self, vertices: Sequence[np.ndarray]) -> wp.array:
        """(v) 1 at the given vertices of each garment, 0 elsewhere."""
        marks = np.zeros(int(self.vertices[-1]), np.uint8)
        for first, ids in zip(self.vertices, vertices, strict=False):
            marks[first + ids] = 1
        return wp.array(marks, dtype=wp.uint8, device=self.device)

    def joined(
        self, arrays: Sequence[np.ndarray], kind: type, dtype: type, shift: np.ndarray | None = None
    ) -> wp.array:
        """The arrays of all garments concatenated; each garment's ``shift`` is added to its values."""
        joined = np.empty((sum(map(len, arrays)), *arrays[0].shape[1:]), kind)
        first = 0
        for number, array in enumerate(arrays):
            by = 0 if shift is None else shift[number]
            np.add(array, by, out=joined[first : first + len(array)], casting="same_kind")
            first += len(array)
        return wp.array(joined, dtype=dtype, device=self.device)

    def launch(self, kernel: wp.Kernel, dim: int, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def empty(self, size: int | tuple[int, ...], dtype: type) -> wp.array:
        return wp.empty(size, dtype=dtype, device=self.device)


def empty_rows(n: int, width: int, device: str, *, coupled: bool) -> Rows:
    """Uninitialised rows of ``n`` vertices with up to ``width`` edges and faces each; ``coupled``: with corners."""
    empty = partial(wp.empty, device=device)
    rows = Rows()
    rows.count, rows.bend_diagonal = empty(n, dtype=wp.vec2i), empty(n, dtype=float)
    rows.lanes, rows.width = 1 if device == "cpu" else WARP, max(USUAL, width)
    size = -(-n // rows.lanes) * rows.lanes * rows.width
    rows.springs, rows.start_length = empty(size, dtype=Spring), empty(size, dtype=float)
    rows.bends = empty(size, dtype=Bend)
    rows.coupled = int(coupled)
    rows.corners, rows.corner_count = empty(size * coupled, dtype=Corner), empty(n * coupled, dtype=int)
    return rows
