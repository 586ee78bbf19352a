"""A batch's box meshes as edges, hinges and rows of elastic weights, on the device that drapes them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from gcd_dataset.generator.drape.config import DrapeJob
from gcd_dataset.generator.drape.kernels import rows as row_kernels
from gcd_dataset.generator.drape.kernels import topology as kernels
from gcd_dataset.generator.drape.kernels.elastic import USUAL, Bend, Corner, Rows, Spring
from gcd_dataset.generator.drape.kernels.sheet import Sheet, sheet_of
from gcd_dataset.generator.drape.loading import load_drape

__all__ = ["Topology", "build_topology"]

WARP = 32  # threads of a GPU that read together


@dataclass(frozen=True)
class Topology:
    """``v e f`` vertices, edges and faces of all garments, one garment after the other."""

    vertex_world: wp.array
    """(v) the garment of each vertex."""
    start: wp.array
    """(v) positions before sewing [cm]."""
    faces: wp.array
    edges: wp.array
    """(e) lower and higher vertex, in the order of both."""
    opposite: wp.array
    """(e) the vertices across from the edge in its first and second face; -1 for no second face."""
    spring: wp.array
    """(e) stiffness over the membrane's; flat length; start length [1, cm, cm]."""
    vertex_faces: wp.array
    first_face: wp.array
    """(v + 1) where the faces round each vertex begin among ``vertex_faces``."""
    vertex_edges: wp.array
    first_edge: wp.array
    mass: wp.array
    """(v) [g]"""
    stiffness: wp.array
    """(v) bound on what the vertex adds to the largest eigenvalue of the stiffness matrix [g/s²]."""
    rows: Rows
    keeper: wp.array
    """(v) 1 where a vertex keeps its garment up."""
    vertex_offset: np.ndarray
    """(w + 1) first vertex of each garment; so for faces and edges."""
    face_offset: np.ndarray
    edge_offset: np.ndarray


def build_topology(jobs: Sequence[DrapeJob], keepers: Sequence[np.ndarray], device: str) -> Topology:
    """The topology of all garments, in the order of the jobs; ``keepers`` are the vertices that keep each one up."""
    load_drape(device)
    meshes = [job.box_mesh for job in jobs]
    vertices = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    corners = np.cumsum([0, *(len(mesh.uv) for mesh in meshes)])
    faces = np.cumsum([0, *(len(mesh.faces) for mesh in meshes)])
    n, sides = int(vertices[-1]), 3 * int(faces[-1])

    def launch(kernel: wp.Kernel, dim: int, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device)

    def empty(size: int | tuple[int, ...], dtype: type) -> wp.array:
        return wp.empty(size, dtype=dtype, device=device)

    def put(arrays: Sequence[np.ndarray], kind: type, dtype: type, shift: np.ndarray | None = None) -> wp.array:
        joined = np.empty((sum(map(len, arrays)), *arrays[0].shape[1:]), kind)
        first = 0
        for number, array in enumerate(arrays):
            by = 0 if shift is None else shift[number]
            np.add(array, by, out=joined[first : first + len(array)], casting="same_kind")
            first += len(array)
        return wp.array(joined, dtype=dtype, device=device)

    start = put([mesh.vertices for mesh in meshes], np.float32, wp.vec3)
    world = wp.array(np.repeat(np.arange(len(jobs), dtype=np.int32), np.diff(vertices)), dtype=int, device=device)
    face = put([mesh.faces for mesh in meshes], np.int32, wp.vec3i, vertices)
    sheets = wp.array([sheet_of(job.fabric) for job in jobs], dtype=Sheet, device=device)
    flat = empty((int(faces[-1]), 3), wp.vec2d)
    corner = put([mesh.corners for mesh in meshes], np.int32, wp.vec3i, corners)
    launch(kernels.lay_flat, int(faces[-1]), [corner, put([m.uv for m in meshes], np.float64, wp.vec2d)], [flat])

    keys, order, number = empty(2 * sides, wp.int64), empty(2 * sides, int), empty(sides, int)
    launch(kernels.key_sides, sides, [face], [keys, order])
    wp.utils.radix_sort_pairs(keys, order, sides)
    keys = keys[:sides]
    launch(kernels.mark_firsts, sides, [keys], [number])
    wp.utils.array_scan(number, number, inclusive=True)
    first_sides = wp.array(3 * faces.astype(np.int32), dtype=int, device=device)
    edge_offset = empty(len(jobs) + 1, int)
    launch(kernels.count_edges, len(jobs) + 1, [first_sides, number], [edge_offset])
    edge_offsets = edge_offset.numpy()
    count = int(edge_offsets[-1])
    edges, opposite, spring = empty(count, wp.vec2i), empty(count, wp.vec2i), empty(count, wp.vec3)
    hinge, hinge_scale, side_edge = empty(count, wp.vec4), empty(count, float), empty(sides, int)
    launch(
        kernels.describe_edges,
        sides,
        [face, flat, start, keys, order, number, world, sheets],
        [edges, opposite, spring, hinge, hinge_scale, side_edge],
    )

    def round_vertices(kernel: wp.Kernel, things: wp.array, size: int) -> tuple[wp.array, wp.array]:
        at, owner, first = empty(2 * size, int), empty(2 * size, int), empty(n + 1, int)
        launch(kernel, size, [things], [at, owner])
        wp.utils.radix_sort_pairs(at, owner, size)
        launch(kernels.find_firsts, size + 1, [at, size], [first])
        return owner[:size], first

    vertex_faces, first_face = round_vertices(kernels.key_corners, face, sides)
    vertex_edges, first_edge = round_vertices(kernels.key_ends, edges, 2 * count)
    coupled = not all(job.fabric.alike for job in jobs)
    widest = max(USUAL, int(np.diff(first_edge.numpy()).max()))
    if coupled:
        widest = max(widest, int(np.diff(first_face.numpy()).max()))
    rows = Rows()
    rows.count, rows.bend_diagonal = empty(n, wp.vec2i), empty(n, float)
    rows.lanes, rows.width = 1 if device == "cpu" else WARP, widest
    room = -(-n // rows.lanes) * rows.lanes * widest
    rows.springs, rows.start_length, rows.bends = empty(room, Spring), empty(room, float), empty(room, Bend)
    rows.coupled = int(coupled)
    rows.corners, rows.corner_count = empty(room * coupled, Corner), empty(n * coupled, int)
    kept = np.zeros(n, np.uint8)
    for shift, ids in zip(vertices, keepers, strict=False):
        kept[shift + ids] = 1
    keeper = wp.array(kept, dtype=wp.uint8, device=device)
    mass, stiffness = empty(n, float), empty(n, float)
    launch(
        row_kernels.weigh_rows,
        n,
        [face, flat, edges, opposite, side_edge, vertex_faces, first_face, vertex_edges, first_edge]
        + [spring, hinge, hinge_scale, world, keeper, sheets],
        [mass, stiffness, rows],
    )
    return Topology(
        vertex_world=world,
        start=start,
        faces=face,
        edges=edges,
        opposite=opposite,
        spring=spring,
        vertex_faces=vertex_faces,
        first_face=first_face,
        vertex_edges=vertex_edges,
        first_edge=first_edge,
        mass=mass,
        stiffness=stiffness,
        rows=rows,
        keeper=keeper,
        vertex_offset=vertices,
        face_offset=faces,
        edge_offset=edge_offsets,
    )
