"""The state of a batch during its drape, and the initial state."""

from dataclasses import dataclass
from functools import partial

import warp as wp

from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.kernels.world import Contacts, CrossingWatch, FrameCounts, SearchState
from gcd_dataset.generator.drape.model import ClothModel

NOT_COUNTED = 2**31 - 1  # initial minimum of crossings, above any count


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
    start = model.topology.start
    ones = partial(wp.ones, dtype=int, device=model.device)
    search, counts, crossing = SearchState(), FrameCounts(), CrossingWatch()
    search.x, search.skin, search.listed = wp.clone(start), zeros(n, wp.vec4), zeros(n, int)
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
