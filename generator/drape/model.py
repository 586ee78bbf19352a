"""A batch of garments as the solver sees it: flat arrays on a device, one garment ("world") after the other.

What stays the same during a drape is the ``ClothModel``; what changes is the ``ClothState``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from jaxtyping import Float, Int

from gcd_dataset.generator.drape.body_field import BodyField, body_field
from gcd_dataset.generator.drape.config import GRAVITY, DrapeConfig, DrapeJob, Fabric
from gcd_dataset.generator.drape.holds import holds, unseen_parts
from gcd_dataset.generator.drape.kernels.elastic import LOOK_AHEAD
from gcd_dataset.generator.drape.kernels.world import World
from gcd_dataset.generator.drape.topology import Topology, build_topology

__all__ = ["ClothModel", "build_model"]

STABLE = 4.0 / (1.0 + 2.0 * LOOK_AHEAD)  # of (omega h)²
SAFETY = 0.9
INERTIA_GAIN = 1.3  # inertia over mass at the typical vertex: a longer step for a slower clock


@dataclass(frozen=True)
class ClothModel:
    """Device arrays of a batch; ``v e f w`` vertices, edges, faces and worlds of all garments together."""

    device: str
    worlds: wp.array
    """(w) ``World``."""
    vertex_world: wp.array
    """(v) the world of each vertex."""
    mass: wp.array
    """(v) what weighs [g]."""
    inertia: wp.array
    """(v) what resists acceleration [g]: the mass, or more where the time step needs it."""
    row_start: wp.array
    row_vertex: wp.array
    row_weight: wp.array
    """Rows of the elastic gather: (stiffness [g/s²], flat length [cm], start length [cm], bending weight [g/s²])."""
    bend_diagonal: wp.array
    edges: wp.array
    edge_opposite: wp.array
    edge_face: wp.array
    face_edges: wp.array
    faces: wp.array
    face_world: wp.array
    hold_normal: wp.array
    """(v) direction in which a held vertex is pushed; zero for none."""
    hold_offset: wp.array
    """(v) it is pushed while ``x · normal`` is less than this [cm]."""
    unseen_parts: wp.array
    """(v) bit set of the body parts that do not stop this vertex."""
    field: wp.array
    field_parts: wp.array
    body_mesh: wp.array
    """(w) handle of each world's skin."""
    start: np.ndarray
    """(v, 3) start positions [cm]."""
    vertex_offset: np.ndarray
    """(w + 1) first vertex of each world."""
    topologies: tuple[Topology, ...]
    bodies: tuple[BodyField, ...]
    """Kept alive for the handles above."""

    @property
    def n_worlds(self) -> int:
        return len(self.topologies)


def build_model(jobs: Sequence[DrapeJob], config: DrapeConfig, device: str) -> ClothModel:
    """The batch on a device, in the order of the jobs."""
    topologies = tuple(build_topology(job.box_mesh) for job in jobs)
    bodies = tuple(body_field(job.body, device) for job in jobs)
    garments = [_garment(job, topology) for job, topology in zip(jobs, topologies, strict=True)]
    vertices = np.cumsum([0, *(len(job.box_mesh.vertices) for job in jobs)])
    edges = np.cumsum([0, *(len(t.edges) for t in topologies)])
    faces = np.cumsum([0, *(len(job.box_mesh.faces) for job in jobs)])
    fields, offsets, parts = _join_fields(bodies, device)

    def put(arrays: Sequence[np.ndarray], dtype: type, shift: np.ndarray | None = None) -> wp.array:
        moved = arrays if shift is None else [a + np.where(a >= 0, s, 0) for a, s in zip(arrays, shift, strict=False)]
        return wp.array(np.ascontiguousarray(np.concatenate(moved)), dtype=dtype, device=device)

    held = [holds(job) for job in jobs]
    row_shift = np.cumsum([0, *(len(g.row_vertex) for g in garments)])
    row_start = [g.row_start[:-1] + s for g, s in zip(garments, row_shift, strict=False)] + [row_shift[-1:]]
    return ClothModel(
        device=device,
        worlds=wp.array(
            [_world(*pair, config) for pair in zip(jobs, garments, bodies, offsets, strict=True)],
            dtype=World,
            device=device,
        ),
        vertex_world=put([np.full(len(j.box_mesh.vertices), w) for w, j in enumerate(jobs)], int),
        mass=put([g.mass for g in garments], float),
        inertia=put([g.inertia for g in garments], float),
        row_start=put(row_start, int),
        row_vertex=put([g.row_vertex for g in garments], int, vertices),
        row_weight=put([g.row_weight for g in garments], wp.vec4),
        bend_diagonal=put([g.bend_diagonal for g in garments], float),
        edges=put([t.edges for t in topologies], wp.vec2i, vertices),
        edge_opposite=put([t.opposite for t in topologies], wp.vec2i, vertices),
        edge_face=put([t.edge_face for t in topologies], int, faces),
        face_edges=put([t.face_edges for t in topologies], wp.vec3i, edges),
        faces=put([job.box_mesh.faces for job in jobs], wp.vec3i, vertices),
        face_world=put([np.full(len(j.box_mesh.faces), w) for w, j in enumerate(jobs)], int),
        hold_normal=put([normal for normal, _ in held], wp.vec3),
        hold_offset=put([offset for _, offset in held], float),
        unseen_parts=put([unseen_parts(job.box_mesh) for job in jobs], int),
        field=fields,
        field_parts=parts,
        body_mesh=wp.array([body.mesh.id for body in bodies], dtype=wp.uint64, device=device),
        start=np.concatenate([job.box_mesh.vertices for job in jobs]).astype(np.float32),
        vertex_offset=vertices,
        topologies=topologies,
        bodies=bodies,
    )


@dataclass(frozen=True)
class _Garment:
    """One garment's share of the model."""

    mass: Float[np.ndarray, " v"]
    inertia: Float[np.ndarray, " v"]
    row_start: Int[np.ndarray, " v+1"]
    row_vertex: Int[np.ndarray, " r"]
    row_weight: Float[np.ndarray, "r 4"]
    bend_diagonal: Float[np.ndarray, " v"]
    dt: float


def _garment(job: DrapeJob, topology: Topology) -> _Garment:
    fabric, n = job.fabric, len(topology.area)
    row_start, row_vertex, row_weight = _rows(topology, fabric, n)
    diagonal = fabric.rigidity * topology.bending.diagonal()
    mass = fabric.mass * topology.area
    stiffness = _largest_stiffness(row_start, row_weight, diagonal)
    dt = float(np.sqrt(SAFETY * STABLE * INERTIA_GAIN * np.median(mass / stiffness)))
    inertia = np.maximum(mass, stiffness * dt**2 / (SAFETY * STABLE))
    return _Garment(mass, inertia, row_start, row_vertex, row_weight, diagonal, dt)


def _rows(topology: Topology, fabric: Fabric, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Springs and bending weights merged into one row for each vertex.

    A spring's stiffness is Van Gelder's (1998) for a membrane: stiffness × area / length², summed over its faces.
    """
    a, b = topology.edges.T
    bending = (fabric.rigidity * topology.bending).tocoo()
    off = bending.row != bending.col
    rows = np.concatenate([a, b, bending.row[off]])
    columns = np.concatenate([b, a, bending.col[off]])
    spring = np.stack([fabric.membrane * topology.spread, topology.flat_length, topology.start_length], axis=1)
    weights = np.zeros((len(rows), 4))
    weights[: 2 * len(a), :3] = np.tile(spring, (2, 1))
    weights[2 * len(a) :, 3] = bending.data[off]
    order = np.lexsort((columns, rows))
    rows, columns, weights = rows[order], columns[order], weights[order]
    first = np.flatnonzero(np.r_[True, (np.diff(rows) != 0) | (np.diff(columns) != 0)])
    merged = np.add.reduceat(weights, first, axis=0)
    return np.searchsorted(rows[first], np.arange(n + 1)), columns[first], merged


def _largest_stiffness(
    row_start: Int[np.ndarray, " v+1"], row_weight: Float[np.ndarray, "r 4"], diagonal: Float[np.ndarray, " v"]
) -> Float[np.ndarray, " v"]:
    """Gershgorin bound on what a vertex's row adds to the stiffness matrix [g/s²]."""
    total = 2 * row_weight[:, 0] + np.abs(row_weight[:, 3])
    return np.maximum(np.add.reduceat(total, row_start[:-1]) + np.abs(diagonal), 1e-9)


def _world(job: DrapeJob, garment: _Garment, body: BodyField, offset: int, config: DrapeConfig) -> World:
    world = World()
    world.dt = garment.dt
    world.damping = config.damping
    world.sewing_damping = config.sewing_damping
    world.sewing_time = config.sewing_time
    world.held_time = config.held_time
    world.gravity = GRAVITY
    world.max_speed = config.max_speed
    world.friction = job.fabric.friction
    world.thickness = job.fabric.thickness
    world.body_gap = config.body_gap
    world.field_offset = offset
    world.field_size = wp.vec3i(*body.distance.shape)
    world.field_origin = wp.vec3(*body.origin)
    world.field_cell = body.cell
    return world


def _join_fields(bodies: Sequence[BodyField], device: str) -> tuple[wp.array, list[int], wp.array]:
    """All different fields in one array, and where each world's begins."""
    different = list({id(body): body for body in bodies}.values())
    starts = np.cumsum([0, *(body.distance.size for body in different)])
    where = {id(body): int(start) for body, start in zip(different, starts, strict=False)}
    values = wp.empty(int(starts[-1]), dtype=float, device=device)
    parts = wp.empty(int(starts[-1]), dtype=wp.uint8, device=device)
    for body in different:
        at, size = where[id(body)], body.distance.size
        wp.copy(values, body.distance.flatten(), dest_offset=at, count=size)
        wp.copy(parts, body.part.flatten(), dest_offset=at, count=size)
    return values, [where[id(body)] for body in bodies], parts
