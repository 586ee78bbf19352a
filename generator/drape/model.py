"""The data of a batch on a device: flat arrays, one garment ("world") after the other; and the initial state.

``ClothModel`` holds all that stays constant during a drape, ``ClothState`` all that changes.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import warp as wp

from gcd_dataset.generator.device import to_host
from gcd_dataset.generator.drape.body_field import AXES, BodyField, HostField, body_fields
from gcd_dataset.generator.drape.config import GRAVITY, DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.dressed import MOST_GAP, dressed_fields
from gcd_dataset.generator.drape.holds import BodyConstraints
from gcd_dataset.generator.drape.kernels.elastic import LOOK_AHEAD, Rows
from gcd_dataset.generator.drape.kernels.place import EDGES, FACES, NOT_COUNTED
from gcd_dataset.generator.drape.kernels.rows import add_inertia, sample_scales
from gcd_dataset.generator.drape.kernels.world import (
    ClothArrays,
    Contacts,
    CrossingWatch,
    FrameCounts,
    SearchState,
    World,
)
from gcd_dataset.generator.drape.topology import Topology, build_topology, empty_rows

STABLE = 4.0 / (1.0 + 2.0 * LOOK_AHEAD)  # stability limit of (omega h)², see kernels/elastic.py
SAFETY = 0.9  # share of that limit
LEAVING_SPEED = 80.0  # cm/s, of cloth that leaves the body's inside
UNTANGLING = 24000.0  # cm/s², acceleration that shortens intersection contours
PULLING = 12000.0  # cm/s², acceleration of crossing cloth toward its own body part
SAMPLE = 8  # medians are taken over every eighth vertex or edge
COARSE_GAP = 2.5  # layer distance of coarse cloth, as a multiple of that of fine cloth
TUCK = 0.4  # cm, largest distance of tucked cloth from the skin, besides the gap of all cloth
SLEEVE = 2.0  # cm, largest distance of sleeves under sleeves from the skin
WORN_GAP = 0.125  # of the edge length: a chord as long as the radius of a fold cuts so deep into it, 1 - cos(30°)
INERTIA_GAIN = 4.0  # inertia over mass at the median vertex: added inertia allows a longer time step


@dataclass(frozen=True)
class ClothModel:
    """Garments, bodies and parameters of a batch. ``w v e f``: worlds, vertices, edges, faces."""

    device: str
    worlds: wp.array
    """(w) ``World``: parameters of each garment."""
    parameters: np.ndarray
    """(w) ``worlds`` in host memory."""
    cloth: ClothArrays
    rows: Rows
    springs: wp.array
    """(e) stiffness over the membrane stiffness, flat length and start length of each edge [1, cm, cm]."""
    start: wp.array
    """(v) positions before sewing [cm]."""
    face_world: wp.array
    """(f) world of each face."""
    bodies: list[BodyField | None]
    """(w) fields of the bodies, whose arrays and meshes ``worlds`` and ``cloth`` refer to; ``None`` for no garment."""
    vertices: list[slice]
    """(w) the vertices of each garment."""
    edges: list[slice]
    """(w) the edges of each garment."""
    faces: list[slice]
    """(w) the faces of each garment."""

    @property
    def n_worlds(self) -> int:
        return len(self.bodies)

    @property
    def n_vertices(self) -> int:
        return len(self.start)

    @property
    def n_edges(self) -> int:
        return len(self.springs)


def build_model(
    jobs: Sequence[DrapeJob],
    config: DrapeConfig,
    device: str,
    *,
    coarse: Container[int] = (),
    sewing_times: Sequence[float] | None = None,
    rooms: Sequence[int] | None = None,
    constraints: Sequence[BodyConstraints] | None = None,
    fields: Sequence[HostField | None] | None = None,
) -> ClothModel:
    """The model of a batch on a device: world ``k`` is ``jobs[k]``, one garment after the other.

    ``coarse``: the worlds that drape a coarse mesh; their layers keep a larger distance, since refinement turns
    straight chords into folds, which would cross. ``sewing_times``: the time over which the seams of each garment
    close [s]; ``config.sewing_time`` if missing. ``rooms``: factor of each garment's room for contacts.
    ``constraints`` and ``fields``: precomputed for the jobs; computed here if missing.
    """
    jobs = [replace(job, fabric=job.fabric.softened(config.stiffest)) for job in jobs]
    constraints = constraints or [BodyConstraints.of(job) for job in jobs]
    topology = build_topology(jobs, config, [each.keepers for each in constraints], device)
    vertices, edges, faces = (
        [slice(int(a), int(b)) for a, b in pairwise(ends)]
        for ends in (topology.vertex_offset, topology.edge_offset, topology.face_offset)
    )
    ratios, medians, lengths = _scales(topology, vertices, edges, device)
    # Stable at ``INERTIA_GAIN`` times the median mass per stiffness.
    steps = np.sqrt(SAFETY * STABLE * INERTIA_GAIN * np.array(ratios))
    cloth = _cloth(constraints, config, topology, _inertia(topology, steps, device), device)
    # After the reads and large copies above: those would wait until the fields are filled.
    naked = body_fields([job.body for job in jobs], device, fields)
    gaps = [min(WORN_GAP * float(length), MOST_GAP) for length in lengths]
    bodies = dressed_fields(naked, [job.under for job in jobs], gaps)
    times = sewing_times or [config.sewing_time] * len(jobs)
    worlds = [_world(job, config, COARSE_GAP if k in coarse else 1.0, times[k]) for k, job in enumerate(jobs)]
    for k, (world, median) in enumerate(zip(worlds, medians, strict=True)):
        world.stiffness = float(median)
        world.max_frames = config.max_frames // 2 if k in coarse else config.max_frames
        _add_garment(world, config, float(steps[k]), float(lengths[k]), vertices[k])
        world.room = world.size * (rooms[k] if rooms else 1)
    for world, body, each, gap in zip(worlds, bodies, constraints, gaps, strict=True):
        world.keepers, world.lowest, world.floor = len(each.keepers), each.lowest, each.floor_height
        world.holds = each.held if config.holds else 0
        world.field, world.field_parts = body.distance.flatten(), body.part.flatten()
        world.field_size = wp.vec3i(*body.distance.shape)
        world.field_origin = wp.vec3(*body.origin)
        world.field_cell, world.face_parts = body.cell, body.face_parts
        if body.worn is not None:
            world.worn, world.worn_gap = body.worn.ids, gap
    cloth.axes = wp.array(np.concatenate([body.axes for body in bodies]), dtype=wp.vec3, device=device)
    cloth.body_mesh = wp.array([body.mesh.id for body in bodies], dtype=wp.uint64, device=device)
    cloth.skin_lag = wp.zeros(len(jobs), dtype=float, device=device)
    cloth.skin_velocity = wp.zeros(len(topology.mass), dtype=wp.vec3, device=device)
    face_world = np.repeat(np.arange(len(jobs), dtype=np.int32), np.diff(topology.face_offset))
    parameters = wp.array(worlds, dtype=World, device="cpu").numpy()
    return ClothModel(
        device=device,
        worlds=wp.array(parameters, dtype=World, device=device),
        parameters=parameters,
        cloth=cloth,
        rows=topology.rows,
        springs=topology.hinges.spring,
        start=topology.start,
        face_world=wp.array(face_world, dtype=int, device=device),
        bodies=list(bodies),
        vertices=vertices,
        edges=edges,
        faces=faces,
    )


def empty_model(room: int, worlds: int, width: int, device: str, *, coupled: bool) -> ClothModel:
    """A model without garments, with room for ``room`` vertices in ``worlds`` worlds; its last world stays empty.

    ``width``: most edges, or faces, of a vertex. ``coupled``: with room for the corners that fabrics with a grain need.
    All vertices belong to the last world, and each face to one of its own; all faces and edges have their ends in
    vertex 0.
    """
    make = partial(_zeros, device)
    cloth, edges, faces = ClothArrays(), int(EDGES) * room, int(FACES) * room
    cloth.vertex_world = wp.full(room, worlds, dtype=int, device=device)
    cloth.mass, cloth.inertia = make(room, float), make(room, float)
    cloth.faces, cloth.edges, cloth.edge_opposite = make(faces, wp.vec3i), make(edges, wp.vec2i), make(edges, wp.vec2i)
    cloth.vertex_faces, cloth.first_face = make(3 * faces, int), make(room, int)
    cloth.vertex_edges, cloth.first_edge = make(2 * edges, int), make(room, int)
    cloth.hold_normal, cloth.hold_offset = make(room, wp.vec3), make(room, float)
    cloth.own_part, cloth.keeper, cloth.ignored_parts = make(room, int), make(room, wp.uint8), make(room, int)
    cloth.axes = wp.zeros((2 * worlds + 2, len(AXES)), dtype=wp.vec3, device=device)
    cloth.body_mesh, cloth.skin_lag = make(worlds + 1, wp.uint64), make(worlds + 1, float)
    cloth.skin_velocity = make(room, wp.vec3)
    nowhere = slice(0, 0)
    return ClothModel(
        device=device,
        worlds=make(worlds + 1, World),
        parameters=np.zeros(worlds + 1, World.numpy_dtype()),  # type: ignore[attr-defined]
        cloth=cloth,
        rows=empty_rows(room, width, device, coupled=coupled),
        springs=make(edges, wp.vec3),
        start=make(room, wp.vec3),
        face_world=wp.array(worlds + np.arange(faces, dtype=np.int32), dtype=int, device=device),
        bodies=[None] * (worlds + 1),
        vertices=[nowhere] * (worlds + 1),
        edges=[nowhere] * (worlds + 1),
        faces=[nowhere] * (worlds + 1),
    )


def _cloth(
    constraints: Sequence[BodyConstraints], config: DrapeConfig, topology: Topology, inertia: wp.array, device: str
) -> ClothArrays:
    """The ``ClothArrays`` struct without the axes and meshes of the bodies, which the caller adds."""

    def put(arrays: Sequence[np.ndarray], kind: type, dtype: type) -> wp.array:
        return wp.array(np.concatenate(arrays).astype(kind, copy=False), dtype=dtype, device=device)

    cloth = ClothArrays()
    cloth.vertex_world, cloth.mass, cloth.inertia = topology.vertex_world, topology.mass, inertia
    surface = topology.surface
    cloth.faces, cloth.edges, cloth.edge_opposite = surface.faces, surface.edges, surface.opposite
    cloth.vertex_faces, cloth.first_face = surface.vertex_faces, surface.first_face
    cloth.vertex_edges, cloth.first_edge = surface.vertex_edges, surface.first_edge
    cloth.hold_normal = put([config.holds * each.hold_normal for each in constraints], np.float32, wp.vec3)
    cloth.hold_offset = put([each.hold_offset for each in constraints], np.float32, float)
    cloth.keeper = topology.keeper
    cloth.ignored_parts = put([config.part_filters * each.ignored_parts for each in constraints], np.int32, int)
    cloth.own_part = put([each.own_part for each in constraints], np.int32, int)
    return cloth


def _scales(
    topology: Topology, vertices: Sequence[slice], edges: Sequence[slice], device: str
) -> tuple[list[np.floating], ...]:
    """Medians over each garment: mass over stiffness [s²] and stiffness [g/s²] of its vertices, length of its edges."""
    spans = [*vertices, *edges]
    ends = np.cumsum([-(-(span.stop - span.start) // SAMPLE) for span in spans])
    rows = np.concatenate([np.arange(span.start, span.stop, SAMPLE, dtype=np.int32) for span in spans])
    scales, of_vertices = wp.empty(len(rows), dtype=wp.vec2, device=device), int(ends[len(vertices) - 1])
    inputs = [wp.array(rows, dtype=int, device=device), of_vertices]
    inputs += [topology.mass, topology.stiffness, topology.hinges.spring]
    wp.launch(sample_scales, dim=len(rows), inputs=inputs, outputs=[scales], device=device)
    parts = np.split(to_host(scales), ends[:-1])
    mass, stiffness = zip(*(part.T for part in parts[: len(vertices)]), strict=True)
    ratios = [m / np.maximum(k, 1e-9) for m, k in zip(mass, stiffness, strict=True)]
    lengths = [part[:, 0] for part in parts[len(vertices) :]]
    return tuple([np.median(each) for each in values] for values in (ratios, stiffness, lengths))


def _inertia(topology: Topology, steps: np.ndarray, device: str) -> wp.array:
    inertia = wp.empty_like(topology.mass)
    step_sq = wp.array((steps**2 / (SAFETY * STABLE)).astype(np.float32), dtype=float, device=device)
    inputs = [topology.vertex_world, topology.mass, topology.stiffness, step_sq]
    wp.launch(add_inertia, dim=len(inertia), inputs=inputs, outputs=[inertia], device=device)
    return inertia


def _world(job: DrapeJob, config: DrapeConfig, gap_factor: float, sewing_time: float) -> World:
    """The parameters that follow from options and fabric; ``gap_factor`` multiplies the layer distance."""
    world = World()
    world.damping = config.damping
    world.sewing_damping = config.sewing_damping
    world.braking = config.braking
    world.sewing_time = sewing_time
    world.held_time = config.held_time
    world.longest_hold = config.longest_hold
    world.gravity = GRAVITY
    world.weight_from = sewing_time if config.gravity_free_start else 0.0
    world.max_speed = config.max_speed
    world.friction, world.layer_friction = job.fabric.friction, job.fabric.layer_friction
    world.leaving_speed = LEAVING_SPEED if config.pull_from_body else 0.0
    world.untangling = UNTANGLING if config.untangle else 0.0
    world.pulling = PULLING if config.pull_to_parts else 0.0
    world.thickness = gap_factor * max(job.fabric.thickness, config.layer_gap)
    world.body_gap = config.body_gap
    world.tucked_below, world.tuck = job.tucked_below, config.body_gap + TUCK
    world.sleeve = SLEEVE if job.under_sleeves else np.inf
    world.margin = max(config.contact_margin, 1.5 * world.thickness)
    world.travel = 0.4 * (world.margin - world.thickness)
    return world


def _add_garment(world: World, config: DrapeConfig, step: float, length: float, vertices: slice) -> None:
    """Add the parameters that follow from time step [s], median edge length [cm] and vertices."""
    frame, size = config.substeps * step, vertices.stop - vertices.start
    world.first, world.size, world.dt = vertices.start, size, step
    # Reach of the broad phase, which lists pairs of vertices. Worst case: edges of lengths a and b that cross in their
    # midpoints at right angles, a margin apart, have their ends hypot(margin, hypot(a, b) / 2) from each other. Covered
    # are thus two edges of 1.41 medians, or a median edge and one of 1.73; of the flat edges of 12 sampled garments the
    # longest has 1.47, and 0.4 % exceed 1.41. A point is nearer to a corner of its triangle than these ends.
    world.near = float(np.hypot(world.margin, length))
    world.clear = config.body_gap + world.travel + config.search_every * config.max_speed * step
    world.frame = frame
    world.still, world.calm = config.still_speed * frame, config.calm_speed * frame
    world.restless = config.moving_share * size
    world.falling = config.falling_share * size


@dataclass(frozen=True)
class ClothState:
    """All that changes during a drape, on the model's device. ``w v f``: worlds, vertices, faces."""

    x: wp.array
    """(v) positions [cm]."""
    v: wp.array
    """(v) velocities [cm/s]."""
    ahead: wp.array
    """(v) predicted positions at which elastic forces are evaluated, see ``kernels.elastic`` [cm]."""
    ahead_next: wp.array
    """(v) predicted positions for the next substep; the two buffers swap after each substep [cm]."""
    x_seen: wp.array
    """(v) positions at the end of the last frame [cm]."""
    push: wp.array
    """(v, 5) fixed-point sums over the contacts of a vertex: displacement x, y, z, contact weight, and displacement off
    the skin by long edges, see ``kernels.push``."""
    contact_weight: wp.array
    """(v) sum of the weights of a vertex's contacts, from the last substep."""
    beside: wp.array
    """(v) 1 where the last search found another vertex nearby."""
    tangled: wp.array
    """(v) 1 where an edge or a face of the vertex crosses the cloth."""
    passed: wp.array
    """(v) 1 where the vertex was on the wrong side of cloth at the last search."""
    time: wp.array
    """(w) simulated time [s]."""
    held: wp.array
    """(w) 1 while waist and collar are held."""
    loose_after: wp.array
    """(w) earliest time at which a released garment may count as at rest [s]."""
    status: wp.array
    """(w) ``RUNNING``, ``DONE``, ``DIVERGED`` or ``STOPPED``."""
    frames: wp.array
    """(w) frames run so far."""
    search: SearchState
    counts: FrameCounts
    crossing: CrossingWatch
    newest: wp.array
    """(buckets) hash grid of the broad phase: the first vertex of each bucket's linked list."""
    older: wp.array
    """(v) the next vertex in the linked list."""
    lower: wp.array
    """(f) lower corners of the faces' bounding boxes [cm]."""
    upper: wp.array
    """(f) upper corners of the faces' bounding boxes [cm]."""
    contacts: Contacts


def new_state(model: ClothModel, config: DrapeConfig) -> ClothState:
    """The initial state: every garment at rest where its panels are placed."""
    n, worlds, faces = model.n_vertices, model.n_worlds, len(model.face_world)
    zeros = partial(_zeros, model.device)
    start = model.start
    ones = partial(wp.ones, dtype=int, device=model.device)
    search, counts, crossing = SearchState(), FrameCounts(), CrossingWatch()
    search.x, search.skin, search.listed = wp.clone(start), zeros(n, wp.vec4), zeros(n, int)
    search.asked = zeros(n, wp.vec4)
    search.moved_far, search.searching, search.any_search = ones(worlds), zeros(worlds, int), zeros(1, int)
    counts.moving, counts.fast, counts.keeper_height = (zeros(worlds, int) for _ in range(3))
    counts.above_floor = zeros(worlds, int)
    crossing.due, crossing.searched, crossing.separated = zeros(worlds, int), ones(worlds), ones(worlds)
    crossing.least = wp.full(worlds, NOT_COUNTED, dtype=int, device=model.device)
    crossing.least_at, crossing.any_searched = zeros(worlds, int), ones(1)
    return ClothState(
        x=wp.clone(start),
        v=zeros(n, wp.vec3),
        ahead=wp.clone(start),
        ahead_next=wp.clone(start),
        x_seen=wp.clone(start),
        push=wp.zeros((n, 5), dtype=int, device=model.device),
        contact_weight=wp.ones(n, dtype=float, device=model.device),
        beside=wp.ones(n, dtype=int, device=model.device),
        tangled=zeros(n, int),
        passed=zeros(n, int),
        time=zeros(worlds, float),
        held=wp.ones(worlds, dtype=int, device=model.device),
        loose_after=zeros(worlds, float),
        status=zeros(worlds, int),
        frames=zeros(worlds, int),
        search=search,
        counts=counts,
        crossing=crossing,
        newest=zeros(1 << (2 * n - 1).bit_length(), int),
        older=zeros(n, int),
        lower=zeros(faces, wp.vec3),
        upper=zeros(faces, wp.vec3),
        contacts=_empty_contacts(model, config.contact_capacity),
    )


def _empty_contacts(model: ClothModel, capacity: int) -> Contacts:
    """Empty lists with room for ``capacity`` entries for each vertex of a world."""
    size, worlds = capacity * model.n_vertices, model.n_worlds
    zeros = partial(_zeros, model.device)
    lists = Contacts()
    lists.room = capacity
    lists.near, lists.long_edges, lists.crossings = (zeros(size, wp.vec2i) for _ in range(3))
    lists.long_planes = zeros(3 * size, wp.vec4)
    lists.points, lists.sides = zeros(size, wp.vec4i), zeros(size, float)
    lists.edges, lists.normals = zeros(size, wp.vec4i), zeros(size, wp.vec3)
    lists.kept_points, lists.kept_sides = zeros(size, wp.vec4i), zeros(size, float)
    lists.kept_edges, lists.kept_normals = zeros(size, wp.vec4i), zeros(size, wp.vec3)
    lists.kept_point_count, lists.kept_edge_count = zeros(worlds, int), zeros(worlds, int)
    lists.near_count, lists.point_count, lists.edge_count = (zeros(worlds, int) for _ in range(3))
    lists.own_work, lists.work, lists.near_work = zeros(worlds, int), zeros(worlds + 1, int), zeros(worlds + 1, int)
    lists.long_count, lists.crossing_count, lists.overfull = (zeros(worlds, int) for _ in range(3))
    return lists


def _zeros(device: str, size: int, dtype: type) -> wp.array:
    return wp.zeros(size, dtype=dtype, device=device)
