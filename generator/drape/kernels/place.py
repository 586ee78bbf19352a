"""Write garments into the places of a batch, clear places, and interpolate the start of a fine pass."""

import warp as wp

from gcd_dataset.generator.drape.kernels.elastic import LOOK_AHEAD, USUAL, Bend, Corner, Rows, Spring, entry
from gcd_dataset.generator.drape.kernels.world import DONE, RUNNING, ClothArrays, Contacts, CrossingWatch, SearchState

wp.set_module_options({"enable_backward": False})

EDGES, FACES = wp.constant(3), wp.constant(2)  # room for edges and faces in a batch with places, for each vertex
NOT_COUNTED = 2**31 - 1  # initial minimum of crossings, above any count


@wp.struct
class Placement:
    """The place of a new garment, and its state at the start. Shifts: index in the batch minus index in ``given``."""

    world: int
    vertex_shift: int
    edge_shift: int
    face_shift: int
    face_entries: int  # shift of the entries of ``vertex_faces``
    edge_entries: int  # shift of the entries of ``vertex_edges``
    last: int  # last vertex in ``given``
    dt: float  # s
    time: float  # s
    held: int
    loose_after: float  # s
    overfull: int


@wp.struct
class VertexState:
    """Arrays of ``ClothState``, (v) each."""

    x: wp.array(dtype=wp.vec3)
    v: wp.array(dtype=wp.vec3)
    ahead: wp.array(dtype=wp.vec3)
    x_seen: wp.array(dtype=wp.vec3)
    contact_weight: wp.array(dtype=float)
    beside: wp.array(dtype=int)
    tangled: wp.array(dtype=int)
    push: wp.array2d(dtype=int)


@wp.kernel
def interpolate(
    corners: wp.array(dtype=wp.vec3i),
    weights: wp.array(dtype=wp.vec3),
    first: int,
    # coarse state in
    x_coarse: wp.array(dtype=wp.vec3),
    v_coarse: wp.array(dtype=wp.vec3),
    # state out
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
):
    """Interpolate the vertices of a garment, from ``first`` on, between three coarse vertices each."""
    k = wp.tid()
    weight = weights[k]
    if weight[0] + weight[1] + weight[2] == 0.0:
        return
    corner = corners[k]
    x[first + k] = weight[0] * x_coarse[corner[0]] + weight[1] * x_coarse[corner[1]] + weight[2] * x_coarse[corner[2]]
    v[first + k] = weight[0] * v_coarse[corner[0]] + weight[1] * v_coarse[corner[1]] + weight[2] * v_coarse[corner[2]]


@wp.func
def copy_row(i: int, j: int, shift: int, given: Rows, rows: Rows):
    """Copy the row of vertex ``i`` of ``given`` to vertex ``j``."""
    count = given.count[i]
    rows.count[j] = count
    rows.bend_diagonal[j] = given.bend_diagonal[i]
    for k in range(wp.max(USUAL, count[0])):
        spring = given.springs[entry(given, i, k)]
        at = entry(rows, j, k)
        rows.springs[at] = Spring(spring.vertex + shift, spring.stiffness, spring.length, spring.bend)
        rows.start_length[at] = given.start_length[entry(given, i, k)]
    for k in range(wp.max(USUAL, count[1])):
        bend = given.bends[entry(given, i, k)]
        rows.bends[entry(rows, j, k)] = Bend(bend.vertex + shift, bend.weight)
    if rows.coupled != 0:
        corners = int(0)
        if given.coupled != 0:
            corners = given.corner_count[i]
        rows.corner_count[j] = corners
        for k in range(corners):
            corner = given.corners[entry(given, i, k)]
            rows.corners[entry(rows, j, k)] = Corner(
                corner.next + shift,
                corner.last + shift,
                corner.lengths,
                corner.next_last,
                corner.next_across,
                corner.last_across,
            )


@wp.kernel
def place_vertices(
    placements: wp.array(dtype=Placement),
    given: ClothArrays,
    given_rows: Rows,
    given_x: wp.array(dtype=wp.vec3),
    given_v: wp.array(dtype=wp.vec3),
    # model out
    cloth: ClothArrays,
    rows: Rows,
    # state out
    state: VertexState,
    search: SearchState,
):
    """Copy the vertices of new garments and their rows, and set their state at the start."""
    i = wp.tid()
    place = placements[given.vertex_world[i]]
    j = i + place.vertex_shift
    cloth.vertex_world[j] = place.world
    cloth.mass[j] = given.mass[i]
    cloth.inertia[j] = given.inertia[i]
    cloth.hold_normal[j] = given.hold_normal[i]
    cloth.hold_offset[j] = given.hold_offset[i]
    cloth.own_part[j] = given.own_part[i]
    cloth.keeper[j] = given.keeper[i]
    cloth.ignored_parts[j] = given.ignored_parts[i]
    cloth.first_face[j] = given.first_face[i] + place.face_entries
    cloth.first_edge[j] = given.first_edge[i] + place.edge_entries
    if i == place.last:  # an empty vertex follows, where the entries of this one end
        cloth.first_face[j + 1] = given.first_face[i + 1] + place.face_entries
        cloth.first_edge[j + 1] = given.first_edge[i + 1] + place.edge_entries
    copy_row(i, j, place.vertex_shift, given_rows, rows)
    here = given_x[i]
    state.x[j] = here
    state.x_seen[j] = here
    search.x[j] = here
    state.v[j] = given_v[i]
    state.ahead[j] = here + (LOOK_AHEAD * place.dt) * given_v[i]
    search.skin[j] = wp.vec4(0.0)
    cloth.skin_velocity[j] = wp.vec3(0.0)
    search.listed[j] = 0
    state.contact_weight[j] = 1.0
    state.beside[j] = 1
    state.tangled[j] = 0
    for k in range(5):
        state.push[j, k] = 0


@wp.kernel
def place_edges(
    placements: wp.array(dtype=Placement),
    given: ClothArrays,
    given_springs: wp.array(dtype=wp.vec3),
    # model out
    cloth: ClothArrays,
    springs: wp.array(dtype=wp.vec3),
):
    """Copy the edges of new garments, and the edges of each vertex: as many entries as ends."""
    e = wp.tid()
    place = placements[given.vertex_world[given.edges[e][0]]]
    shift = place.vertex_shift
    at = e + place.edge_shift
    cloth.edges[at] = given.edges[e] + wp.vec2i(shift, shift)
    opposite = given.edge_opposite[e] + wp.vec2i(shift, shift)
    if given.edge_opposite[e][1] < 0:
        opposite[1] = -1
    cloth.edge_opposite[at] = opposite
    springs[at] = given_springs[e]
    for k in range(2 * e, 2 * e + 2):
        cloth.vertex_edges[k + place.edge_entries] = given.vertex_edges[k] + place.edge_shift


@wp.kernel
def place_faces(
    placements: wp.array(dtype=Placement),
    given: ClothArrays,
    # model out
    cloth: ClothArrays,
    face_world: wp.array(dtype=int),
):
    """Copy the faces of new garments, and the faces of each vertex: as many entries as corners."""
    f = wp.tid()
    place = placements[given.vertex_world[given.faces[f][0]]]
    shift = place.vertex_shift
    at = f + place.face_shift
    cloth.faces[at] = given.faces[f] + wp.vec3i(shift, shift, shift)
    face_world[at] = place.world
    for k in range(3 * f, 3 * f + 3):
        cloth.vertex_faces[k + place.face_entries] = given.vertex_faces[k] + place.face_shift


@wp.kernel
def place_worlds(
    placements: wp.array(dtype=Placement),
    # state out
    time: wp.array(dtype=float),
    status: wp.array(dtype=int),
    held: wp.array(dtype=int),
    loose_after: wp.array(dtype=float),
    frames: wp.array(dtype=int),
    contacts: Contacts,
    search: SearchState,
    crossing: CrossingWatch,
):
    """The state of new garments at the start."""
    place = placements[wp.tid()]
    w = place.world
    time[w] = place.time
    status[w] = RUNNING
    held[w] = place.held
    loose_after[w] = place.loose_after
    frames[w] = 0
    contacts.overfull[w] = place.overfull
    contacts.near_count[w] = 0
    contacts.point_count[w] = 0
    contacts.edge_count[w] = 0
    contacts.long_count[w] = 0
    contacts.crossing_count[w] = 0
    search.moved_far[w] = 1
    crossing.due[w] = 0
    crossing.searched[w] = 1
    crossing.separated[w] = 1
    crossing.least[w] = NOT_COUNTED
    crossing.least_at[w] = 0
    crossing.any_searched[0] = 1


@wp.kernel
def clear_places(
    places: wp.array(dtype=wp.vec3i),
    threads: int,
    empty_world: int,
    # model out
    cloth: ClothArrays,
    face_world: wp.array(dtype=int),
    # state out
    status: wp.array(dtype=int),
):
    """Give places, world, first vertex and number of vertices each, to a world without a garment; end their worlds.

    A world that runs would go on with its contacts, on a skin that is freed.
    """
    place, thread = wp.tid()
    first = places[place][1]
    end = first + places[place][2]
    if thread == 0:
        status[places[place][0]] = DONE
    for i in range(first + thread, end, threads):
        cloth.vertex_world[i] = empty_world
    for f in range(FACES * first + thread, FACES * end, threads):
        cloth.faces[f] = wp.vec3i(0, 0, 0)
        face_world[f] = empty_world + f  # its own group in the BVH: with equal boxes in a group the tree is a list
    for e in range(EDGES * first + thread, EDGES * end, threads):
        cloth.edges[e] = wp.vec2i(0, 0)
