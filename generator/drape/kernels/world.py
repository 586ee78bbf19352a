"""What the kernels must know of a garment, its body and its cloth; and which contacts are being watched."""

import warp as wp

wp.set_module_options({"enable_backward": False})

RUNNING = 0
DONE = 1
DIVERGED = 2
STOPPED = 3  # out of frames, sliding off, or below the floor


@wp.struct
class World:
    """One garment on one body."""

    first: int  # its first vertex
    size: int  # its vertices
    dt: float  # s
    damping: float  # 1/s
    sewing_damping: float  # 1/s
    braking: float  # 1/s, where forces slow a vertex down
    sewing_time: float  # s
    held_time: float  # s, after sewing, for which waist and collar are held at least
    longest_hold: float  # s, after sewing
    gravity: float  # cm/s²
    weight_from: float  # s
    max_speed: float  # cm/s
    friction: float
    layer_friction: float
    leaving_speed: float  # cm/s at which cloth that is inside the body comes out
    untangling: float  # cm/s², acceleration of cloth that crosses, along what shortens the curve of crossing
    pulling: float  # cm/s², the same toward its own part of the body
    thickness: float  # cm, between layers
    body_gap: float  # cm, from the skin
    margin: float  # cm, pairs nearer than this are watched
    near: float  # cm, vertices nearer than this may belong to such a pair
    travel: float  # cm that a vertex may move until the next search
    clear: float  # cm from the skin, from where no vertex reaches it before the next search
    max_frames: int
    still: float  # cm in a frame: a vertex that moves less rests
    calm: float  # cm in a frame: one that moves less counts as resting in the last frame
    restless: float  # vertices that may move in a garment at rest
    falling: float  # vertices that may move fast in a garment that is let go
    frame: float  # s
    lowest: float  # cm, below which the mean of the vertices that keep it up has slid off
    floor: float  # cm, below which a garment has fallen
    keepers: int  # how many vertices keep it up
    field_offset: wp.int64  # first voxel of the body's distance field
    field_size: wp.vec3i  # voxels along x, y, z
    field_origin: wp.vec3  # cm, centre of the first voxel
    field_cell: float  # cm


@wp.struct
class Cloth:
    """The cloth of all worlds; ``v e f`` vertices, edges and faces of all garments together."""

    vertex_world: wp.array(dtype=int)
    mass: wp.array(dtype=float)  # (v) what weighs [g]
    inertia: wp.array(dtype=float)  # (v) what resists acceleration [g]
    faces: wp.array(dtype=wp.vec3i)
    edges: wp.array(dtype=wp.vec2i)
    edge_opposite: wp.array(dtype=wp.vec2i)  # (e) the vertices across, -1 for no second face
    vertex_faces: wp.array(dtype=int)  # the faces round each vertex, from first_face[v] to first_face[v + 1]
    first_face: wp.array(dtype=int)
    vertex_edges: wp.array(dtype=int)
    first_edge: wp.array(dtype=int)
    hold_normal: wp.array(dtype=wp.vec3)  # (v) direction in which a held vertex is pushed; zero for none
    hold_offset: wp.array(dtype=float)  # (v) it is pushed while ``x · normal`` is less than this [cm]
    own_part: wp.array(dtype=int)  # (v) row of ``axes``
    axes: wp.array2d(dtype=wp.vec3)  # (2 w, parts) ends of the axis of every part of a body [cm]
    keeper: wp.array(dtype=wp.uint8)  # (v) 1 where a vertex keeps the garment up
    unseen_parts: wp.array(dtype=int)  # (v) bit set of the body parts that do not stop it
    field: wp.array(dtype=float)
    field_parts: wp.array(dtype=wp.uint8)
    body_mesh: wp.array(dtype=wp.uint64)  # (w) the skin


@wp.struct
class Contacts:
    """Lists of what may touch before the next search. Those of a world begin at ``room * world.first``."""

    room: int  # entries for each vertex
    near: wp.array(dtype=wp.vec2i)  # vertices
    points: wp.array(dtype=wp.vec4i)  # vertex, the three of its face
    sides: wp.array(dtype=float)  # of the face: 1 for its right one, -1
    edges: wp.array(dtype=wp.vec4i)  # two vertices, two vertices
    normals: wp.array(dtype=wp.vec3)  # from the first edge to the second
    kept_points: wp.array(dtype=wp.vec4i)  # what has passed through, with the sides it had before
    kept_sides: wp.array(dtype=float)
    kept_edges: wp.array(dtype=wp.vec4i)
    kept_normals: wp.array(dtype=wp.vec3)
    long_edges: wp.array(dtype=wp.vec2i)
    crossings: wp.array(dtype=wp.vec2i)  # edge, face
    near_count: wp.array(dtype=int)  # (w), as the other counts
    point_count: wp.array(dtype=int)
    edge_count: wp.array(dtype=int)
    kept_point_count: wp.array(dtype=int)
    kept_edge_count: wp.array(dtype=int)
    long_count: wp.array(dtype=int)
    crossing_count: wp.array(dtype=int)
    overfull: wp.array(dtype=int)
    work: wp.array(dtype=int)  # (w + 1) entries of all lists but ``near`` in the worlds before, of those that run
    near_work: wp.array(dtype=int)  # (w + 1) entries of ``near`` in the worlds before, of those being searched


@wp.struct
class SearchState:
    """The last search for contacts."""

    x: wp.array(dtype=wp.vec3)  # (v) positions then [cm]
    skin: wp.array(dtype=float)  # (v) distance from the skin then [cm]
    listed: wp.array(dtype=int)  # (v) 1 where the vertex is in any list of contacts
    moved_far: wp.array(dtype=int)  # (w) 1 where a vertex has moved so far since that contacts must be searched anew
    searching: wp.array(dtype=int)  # (w) 1 where contacts are searched now
    any_search: wp.array(dtype=int)  # (1) whether contacts are searched in any world


@wp.struct
class FrameCounts:
    """Counts of this frame, for each world."""

    moving: wp.array(dtype=int)  # vertices that moved
    fast: wp.array(dtype=int)  # vertices that moved fast
    keeper_height: wp.array(dtype=int)  # sum of the heights of the vertices that keep the garment up
    above_floor: wp.array(dtype=int)  # vertices above the floor


@wp.struct
class CrossingWatch:
    """When crossings of the cloth with itself are searched, and whether they are separated, for each world."""

    due: wp.array(dtype=int)  # 1 where the garment has moved since the last search for crossings
    searched: wp.array(dtype=int)  # 1 where crossings are searched in this frame
    least: wp.array(dtype=int)  # fewest crossings since the garment was let go
    least_at: wp.array(dtype=int)  # the frame in which they were found
    separated: wp.array(dtype=int)  # 1 where crossing cloth is pushed apart
    any_searched: wp.array(dtype=int)  # (1) whether crossings are searched in any world


@wp.func
def sewn_share(world: World, time: float) -> float:
    """How far the seams are closed, 0 to 1; smooth at both ends."""
    s = wp.clamp(time / world.sewing_time, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


@wp.func
def take_slot(count: wp.array(dtype=int), w: int, world: World, contacts: Contacts) -> int:
    """The next free slot of a world's list, or -1 and a mark on the world."""
    taken = wp.atomic_add(count, w, 1)
    if taken >= contacts.room * world.size:
        contacts.overfull[w] = 1
        return -1
    return contacts.room * world.first + taken


@wp.func
def entries(count: wp.array(dtype=int), w: int, world: World, contacts: Contacts) -> int:
    """Entries in a world's list."""
    return wp.min(count[w], contacts.room * world.size)


@wp.func
def world_of(item: int, work: wp.array(dtype=int)) -> int:
    """The world that an item of work belongs to; ``work`` holds the items of the worlds before each."""
    low = int(0)
    high = int(work.shape[0] - 1)
    while high - low > 1:
        middle = (low + high) // 2
        if work[middle] <= item:
            low = middle
        else:
            high = middle
    return low
