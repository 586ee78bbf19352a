"""What changes during a drape, and how it begins."""

from dataclasses import dataclass

import warp as wp

from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.kernels.world import Contacts
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
    x_searched: wp.array
    """(v) positions at the last search for contacts [cm]."""
    skin: wp.array
    """(v) distance from the skin then [cm]."""
    push: wp.array
    """(v, 4) displacements asked for by contacts, as whole numbers."""
    crowd: wp.array
    """(v) weights of the contacts that were expected for this step."""
    beside: wp.array
    """(v) whether another vertex was near at the last search."""
    listed: wp.array
    """(v) whether the vertex is in any list of contacts."""
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
    moving: wp.array
    """(w) vertices that moved in this frame, those that moved fast, and the sum of the keepers' heights."""
    hasty: wp.array
    kept_height: wp.array
    above_floor: wp.array
    """(w) vertices that are not below the floor."""
    moved_far: wp.array
    """(w) whether a vertex has moved so far that contacts must be searched anew."""
    fewest: wp.array
    """(w) the fewest crossings so far since it was let go, and the frame they were found in."""
    fewest_at: wp.array
    parting: wp.array
    """(w) whether what crosses is pushed apart."""
    searching: wp.array
    crossing_due: wp.array
    untangling: wp.array
    any_search: wp.array
    any_crossing: wp.array
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
    return ClothState(
        x=wp.clone(start),
        v=zeros(n, wp.vec3),
        ahead=wp.clone(start),
        ahead_next=wp.clone(start),
        x_seen=wp.clone(start),
        x_searched=wp.clone(start),
        skin=zeros(n, float),
        push=wp.zeros((n, 4), dtype=int, device=model.device),
        crowd=wp.ones(n, dtype=float, device=model.device),
        beside=wp.ones(n, dtype=int, device=model.device),
        listed=zeros(n, int),
        tangled=zeros(n, int),
        passed=zeros(n, int),
        time=zeros(worlds, float),
        held=wp.ones(worlds, dtype=int, device=model.device),
        loose_after=zeros(worlds, float),
        status=zeros(worlds, int),
        frames=zeros(worlds, int),
        moving=zeros(worlds, int),
        hasty=zeros(worlds, int),
        kept_height=zeros(worlds, int),
        above_floor=zeros(worlds, int),
        moved_far=wp.ones(worlds, dtype=int, device=model.device),
        fewest=wp.full(worlds, NEVER_COUNTED, dtype=int, device=model.device),
        fewest_at=zeros(worlds, int),
        parting=wp.ones(worlds, dtype=int, device=model.device),
        searching=zeros(worlds, int),
        crossing_due=zeros(worlds, int),
        untangling=wp.ones(worlds, dtype=int, device=model.device),
        any_search=zeros(1, int),
        any_crossing=wp.ones(1, dtype=int, device=model.device),
        newest=zeros(1 << (2 * n - 1).bit_length(), int),
        older=zeros(n, int),
        lower=zeros(faces, wp.vec3),
        upper=zeros(faces, wp.vec3),
        contacts=lists,
    )
