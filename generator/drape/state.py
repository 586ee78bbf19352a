"""What changes during a drape, and how it begins."""

from dataclasses import dataclass
from functools import partial

import warp as wp

from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.kernels.world import Contacts, CrossingWatch, FrameCounts, SearchState
from gcd_dataset.generator.drape.model import ClothModel

__all__ = ["ClothState", "new_state"]

NEVER_COUNTED = 2**31 - 1  # crossings: whatever is found first is fewer


@dataclass(frozen=True)
class ClothState:
    """What changes during a drape, on the model's device."""

    x: wp.array
    """(v) positions [cm]."""
    v: wp.array
    """(v) velocities [cm/s]."""
    ahead: wp.array
    """(v) where forces are taken [cm]."""
    ahead_next: wp.array
    x_seen: wp.array
    """(v) positions one frame ago [cm]."""
    push: wp.array
    """(v, 4) displacements asked for by contacts, as whole numbers."""
    contact_weight: wp.array
    """(v) sum of the weights of the contacts announced for this step."""
    beside: wp.array
    """(v) whether another vertex was near at the last search."""
    tangled: wp.array
    """(v) whether an edge or a face of the vertex crossed the cloth."""
    passed: wp.array
    """(v) whether it was on the wrong side of cloth at the last search."""
    time: wp.array
    """(w) simulated time [s]."""
    held: wp.array
    """(w) whether waist and collar are held."""
    loose_after: wp.array
    """(w) when it may first be found at rest, once it is let go [s]."""
    status: wp.array
    """(w) ``RUNNING``, ``DONE``, ``DIVERGED`` or ``STOPPED``."""
    frames: wp.array
    """(w) frames it has run."""
    search: SearchState
    counts: FrameCounts
    crossing: CrossingWatch
    newest: wp.array
    """The grid in which near vertices are found: the last vertex put into each bucket, and the one before each."""
    older: wp.array
    lower: wp.array
    """(f) boxes round the faces [cm]."""
    upper: wp.array
    contacts: Contacts


def new_state(model: ClothModel, config: DrapeConfig) -> ClothState:
    """The start: every garment where its panels hang, at rest."""
    n, worlds, faces = model.n_vertices, model.n_worlds, len(model.face_world)
    room = config.contact_capacity

    def zeros(size: int, dtype: type) -> wp.array:
        return wp.zeros(size, dtype=dtype, device=model.device)

    lists = Contacts()
    lists.room = room
    lists.near, lists.long_edges, lists.crossings = (zeros(room * n, wp.vec2i) for _ in range(3))
    lists.points, lists.sides = zeros(room * n, wp.vec4i), zeros(room * n, float)
    lists.edges, lists.normals = zeros(room * n, wp.vec4i), zeros(room * n, wp.vec3)
    lists.kept_points, lists.kept_sides = zeros(room * n, wp.vec4i), zeros(room * n, float)
    lists.kept_edges, lists.kept_normals = zeros(room * n, wp.vec4i), zeros(room * n, wp.vec3)
    lists.kept_point_count, lists.kept_edge_count = zeros(worlds, int), zeros(worlds, int)
    lists.near_count, lists.point_count, lists.edge_count = (zeros(worlds, int) for _ in range(3))
    lists.work, lists.near_work = zeros(worlds + 1, int), zeros(worlds + 1, int)
    lists.long_count, lists.crossing_count, lists.overfull = (zeros(worlds, int) for _ in range(3))
    start = model.topology.start
    ones = partial(wp.ones, dtype=int, device=model.device)
    search, counts, crossing = SearchState(), FrameCounts(), CrossingWatch()
    search.x, search.skin, search.listed = wp.clone(start), zeros(n, float), zeros(n, int)
    search.moved_far, search.searching, search.any_search = ones(worlds), zeros(worlds, int), zeros(1, int)
    counts.moving, counts.fast, counts.keeper_height = (zeros(worlds, int) for _ in range(3))
    counts.above_floor = zeros(worlds, int)
    crossing.due, crossing.searched, crossing.separated = zeros(worlds, int), ones(worlds), ones(worlds)
    crossing.least = wp.full(worlds, NEVER_COUNTED, dtype=int, device=model.device)
    crossing.least_at, crossing.any_searched = zeros(worlds, int), ones(1)
    return ClothState(
        x=wp.clone(start),
        v=zeros(n, wp.vec3),
        ahead=wp.clone(start),
        ahead_next=wp.clone(start),
        x_seen=wp.clone(start),
        push=wp.zeros((n, 4), dtype=int, device=model.device),
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
        contacts=lists,
    )
