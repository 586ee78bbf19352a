"""Structs of the kernels: parameters of a world, the cloth of all worlds, contact lists, and counters of a frame."""

import warp as wp

wp.set_module_options({"enable_backward": False})

RUNNING = 0
DONE = 1
DIVERGED = 2
STOPPED = 3  # out of frames, slid off, below the floor, or out of room for contacts


@wp.struct
class World:
    """Parameters of one garment on one body."""

    first: int  # its first vertex
    size: int  # number of its vertices
    room: int  # vertices for which its contact lists have room: more than it has where they have run over before
    stiffness: float  # g/s², median over its vertices
    dt: float  # s, length of a substep
    damping: float  # 1/s, drag after sewing
    sewing_damping: float  # 1/s, drag during sewing
    braking: float  # 1/s, drag where forces decelerate a vertex
    sewing_time: float  # s
    held_time: float  # s after sewing, shortest hold of waist and collar
    longest_hold: float  # s after sewing
    gravity: float  # cm/s²
    weight_from: float  # s, time at which gravity starts
    max_speed: float  # cm/s
    friction: float
    layer_friction: float
    leaving_speed: float  # cm/s, speed limit of cloth that leaves the body's inside
    untangling: float  # cm/s², acceleration of crossing cloth that shortens the intersection contour
    pulling: float  # cm/s², acceleration of crossing cloth toward its own body part
    thickness: float  # cm, distance of layers
    body_gap: float  # cm, distance of cloth from the skin
    margin: float  # cm, the narrow phase lists pairs nearer than this
    near: float  # cm, the broad phase lists vertices nearer than this
    travel: float  # cm that a vertex may move before the next search
    clear: float  # cm: a vertex further from the skin cannot reach it before the next search
    max_frames: int
    still: float  # cm in a frame: a vertex that moves less is at rest
    calm: float  # cm in a frame: ``still`` rises to this by the last frame, see ``still_limit``
    restless: float  # a garment is at rest when at most this number of its vertices moves
    falling: float  # the hold may end when at most this number of vertices is fast
    frame: float  # s, length of a frame
    lowest: float  # cm, mean height of the keepers below which the garment has slid off
    floor: float  # cm, height below which a garment has fallen
    keepers: int  # number of vertices that keep the garment up
    holds: int  # number of vertices with a hold
    field: wp.array(dtype=float)  # signed distance from the body of each voxel, z fastest [cm]
    field_parts: wp.array(dtype=wp.uint8)  # body part nearest to each voxel
    field_size: wp.vec3i  # voxels along x, y, z
    field_origin: wp.vec3  # cm, centre of the first voxel
    field_cell: float  # cm
    skin: wp.uint64  # mesh of a skin that moves, which stands for the field; 0 for one that stands still
    face_parts: wp.array(dtype=wp.uint8)  # body part of each face of the skin
    tucked_below: float  # cm, height below which the cloth is tucked into another garment
    tuck: float  # cm, largest distance of tucked cloth from the skin
    sleeve: float  # cm, largest distance of sleeves from the skin
    worn: wp.array(dtype=wp.uint64)  # meshes of the garments under this one
    worn_gap: float  # cm, distance from these garments beyond ``body_gap``


@wp.struct
class ClothArrays:
    """The cloth of all worlds; ``v e f``: vertices, edges and faces of all garments together."""

    vertex_world: wp.array(dtype=int)
    mass: wp.array(dtype=float)  # (v) gravitational mass [g]
    inertia: wp.array(dtype=float)  # (v) inertial mass: the mass, or more where stability needs it [g]
    faces: wp.array(dtype=wp.vec3i)
    edges: wp.array(dtype=wp.vec2i)
    edge_opposite: wp.array(dtype=wp.vec2i)  # (e) opposite vertices of its two faces, -1 for no second face
    vertex_faces: wp.array(dtype=int)  # faces of vertex v: entries first_face[v] to first_face[v + 1]
    first_face: wp.array(dtype=int)
    vertex_edges: wp.array(dtype=int)
    first_edge: wp.array(dtype=int)
    hold_normal: wp.array(dtype=wp.vec3)  # (v) normal of the hold half-space; zero for no hold
    hold_offset: wp.array(dtype=float)  # (v) the hold is ``x · hold_normal >= hold_offset`` [cm]
    own_part: wp.array(dtype=int)  # (v) body part that the vertex covers, a column of ``axes``; -1 for none
    axes: wp.array2d(dtype=wp.vec3)  # (2 w, parts) upper and lower end of the axis of every body part [cm]
    keeper: wp.array(dtype=wp.uint8)  # (v) 1 where a vertex keeps the garment up
    ignored_parts: wp.array(dtype=int)  # (v) bit set of the body parts that the vertex passes through
    body_mesh: wp.array(dtype=wp.uint64)  # (w) mesh of the skin
    skin_velocity: wp.array(dtype=wp.vec3)  # (v) velocity of the nearest skin at the last search [cm/s]
    skin_lag: wp.array(dtype=float)  # (w) time since a skin that moves was where its mesh is [s]


@wp.struct
class Contacts:
    """Contact lists: pairs that may touch before the next search. A world's entries begin at ``room * world.first``."""

    room: int  # capacity of each list, for each vertex of a world
    near: wp.array(dtype=wp.vec2i)  # broad phase: pairs of vertices
    points: wp.array(dtype=wp.vec4i)  # point-triangle contacts: vertex, three vertices of the face
    sides: wp.array(dtype=float)  # side of the face on which the point belongs: 1 along its normal, -1 against it
    edges: wp.array(dtype=wp.vec4i)  # edge-edge contacts: two vertices, two vertices
    normals: wp.array(dtype=wp.vec3)  # direction from the first edge to the second when the contact was found
    kept_points: wp.array(dtype=wp.vec4i)  # contacts whose elements have passed through each other
    kept_sides: wp.array(dtype=float)  # ``sides`` of these contacts before the elements passed through each other
    kept_edges: wp.array(dtype=wp.vec4i)
    kept_normals: wp.array(dtype=wp.vec3)
    long_edges: wp.array(dtype=wp.vec2i)  # edges whose inside may touch the body
    long_planes: wp.array(dtype=wp.vec4)  # three for each, of a moving skin, see ``find_inside_planes``
    crossings: wp.array(dtype=wp.vec2i)  # edge, face that it crosses
    near_count: wp.array(dtype=int)  # (w) requested entries, which may exceed the capacity; the same for other counts
    point_count: wp.array(dtype=int)
    edge_count: wp.array(dtype=int)
    kept_point_count: wp.array(dtype=int)
    kept_edge_count: wp.array(dtype=int)
    long_count: wp.array(dtype=int)
    crossing_count: wp.array(dtype=int)
    overfull: wp.array(dtype=int)  # (w) 1 where a list has run over its capacity
    own_work: wp.array(dtype=int)  # (w) the summands of ``work`` or ``near_work``
    work: wp.array(dtype=int)  # (w + 1) prefix sums over running worlds: entries of all lists but ``near``
    near_work: wp.array(dtype=int)  # (w + 1) prefix sums over searching worlds: entries of ``near``


@wp.struct
class SearchState:
    """State of the contact search."""

    x: wp.array(dtype=wp.vec3)  # (v) positions at the last search [cm]
    skin: wp.array(dtype=wp.vec4)  # (v) the skin at the last search: normal, distance [cm], see ``find_skin``
    asked: wp.array(dtype=wp.vec4)  # (v) where a moving skin was last found [cm], and its ``skin_lag`` then [s]
    listed: wp.array(dtype=int)  # (v) 1 where the vertex is in any contact list
    moved_far: wp.array(dtype=int)  # (w) 1 where a vertex has moved more than ``World.travel`` since the last search
    searching: wp.array(dtype=int)  # (w) 1 in the worlds of the present search
    any_search: wp.array(dtype=int)  # (1) 1 if any world searches


@wp.struct
class FrameCounts:
    """Counts of the present frame, (w) each."""

    moving: wp.array(dtype=int)  # vertices that are not at rest
    fast: wp.array(dtype=int)  # vertices faster than ``World.calm``
    keeper_height: wp.array(dtype=int)  # sum of the keepers' heights [cm / HEIGHT_SCALE]
    above_floor: wp.array(dtype=int)  # vertices above the floor


@wp.struct
class CrossingWatch:
    """Schedule of the search for crossings of cloth with cloth, and of untangling, (w) each."""

    due: wp.array(dtype=int)  # 1 where contacts were searched since the last search for crossings
    searched: wp.array(dtype=int)  # 1 where this frame searches for crossings
    least: wp.array(dtype=int)  # fewest crossings found since the hold ended
    least_at: wp.array(dtype=int)  # frame of that count
    separated: wp.array(dtype=int)  # 1 where crossing cloth is untangled
    any_searched: wp.array(dtype=int)  # (1) 1 if any world searches for crossings


@wp.func
def sewn_share(world: World, time: float) -> float:
    """Closed share of the seams, 0 to 1: a smooth step over the sewing time."""
    s = wp.clamp(time / world.sewing_time, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


@wp.func
def take_slot(count: wp.array(dtype=int), w: int, world: World, contacts: Contacts) -> int:
    """The next free slot of a world's list; marks the world overfull and returns -1 if there is none."""
    slot = wp.atomic_add(count, w, 1)
    if slot >= contacts.room * world.room:
        contacts.overfull[w] = 1
        return -1
    return contacts.room * world.first + slot


@wp.func
def entries(count: wp.array(dtype=int), w: int, world: World, contacts: Contacts) -> int:
    """Number of entries in a world's list."""
    return wp.min(count[w], contacts.room * world.room)


@wp.func
def world_of(item: int, work: wp.array(dtype=int)) -> int:
    """The world of a work item, by binary search in the prefix sums ``work``."""
    low = int(0)
    high = int(work.shape[0] - 1)
    while high - low > 1:
        middle = (low + high) // 2
        if work[middle] <= item:
            low = middle
        else:
            high = middle
    return low
