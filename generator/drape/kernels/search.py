"""Search for contacts, repeated whenever a garment has moved far enough: broad phase, then narrow phase.

The broad phase lists pairs of near vertices that are not neighbours, by a hash grid. The narrow phase tests the faces
and edges round these vertices. Two elements nearer to each other than the margin have near vertices; only the pair of
their nearest vertices lists the contact.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import (
    FAR,
    find_inside_planes,
    find_skin,
    is_over_same_skin,
    moving_skin,
    sample_field,
)
from gcd_dataset.generator.drape.kernels.geometry import (
    closest_on_edges,
    closest_on_triangle,
    has_vertex,
    segment_crosses,
)
from gcd_dataset.generator.drape.kernels.sides import edges_passed, mark, point_passed
from gcd_dataset.generator.drape.kernels.world import (
    RUNNING,
    ClothArrays,
    Contacts,
    CrossingWatch,
    SearchState,
    World,
    entries,
    take_slot,
    world_of,
)

wp.set_module_options({"enable_backward": False})

STRIDE = wp.constant(8)  # threads that share the faces and edges of a vertex, about six each
THREADS_PER_PAIR = wp.constant(16)  # threads that share a pair of vertices: 2 STRIDE
OWN_CELL = wp.constant(13)  # index of the centre among 27 cells
FIELD_SLACK = wp.constant(0.25)  # cm: interpolated distances of two points differ by more than the points' distance
SHORT_EDGE = 1.5  # cm: longer edges have body contacts along their inside too


@wp.kernel
def plan_search(
    # state in
    status: wp.array(dtype=int),
    # state in and out
    search: SearchState,
    crossing: CrossingWatch,
):
    """Mark the worlds in which contacts are searched now."""
    w = wp.tid()
    search.searching[w] = 0
    if status[w] != RUNNING or search.moved_far[w] == 0:
        return
    search.searching[w] = 1
    crossing.due[w] = 1
    search.any_search[0] = 1
    search.moved_far[w] = 0


@wp.func
def are_neighbours(i: int, j: int, cloth: ClothArrays) -> bool:
    """Whether an edge joins two vertices."""
    for at in range(cloth.first_edge[i], cloth.first_edge[i + 1]):
        ends = cloth.edges[cloth.vertex_edges[at]]
        if ends[0] == j or ends[1] == j:
            return True
    return False


@wp.func
def cell_of(p: wp.vec3, width: float) -> wp.vec3i:
    """The grid cell of a point."""
    return wp.vec3i(int(wp.floor(p[0] / width)), int(wp.floor(p[1] / width)), int(wp.floor(p[2] / width)))


@wp.func
def bucket_of(cell: wp.vec3i, w: int, buckets: int) -> int:
    """Hash bucket of a world's cell (Teschner et al., 2003); ``buckets`` is a power of two."""
    mixed = (cell[0] * 73856093) ^ (cell[1] * 19349663) ^ (cell[2] * 83492791) ^ (w * 28411639)
    return (mixed ^ (mixed >> 15)) & (buckets - 1)


@wp.kernel
def fill_grid(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    # state in
    searching: wp.array(dtype=int),
    tangled: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    newest: wp.array(dtype=int),
    older: wp.array(dtype=int),
    beside: wp.array(dtype=int),
    listed: wp.array(dtype=int),
):
    """Prepend every vertex to its bucket's linked list: ``newest`` is the head, ``older`` the next vertex."""
    i = wp.tid()
    w = cloth.vertex_world[i]
    if searching[w] == 0:
        return
    bucket = bucket_of(cell_of(x[i], worlds[w].near), w, newest.shape[0])
    beside[i] = 0
    listed[i] = tangled[i]
    older[i] = wp.atomic_exch(newest, bucket, i)


@wp.kernel
def find_near_vertices(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    threads: int,
    # state in
    searching: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    newest: wp.array(dtype=int),
    older: wp.array(dtype=int),
    # state in and out
    velocity: wp.array(dtype=wp.vec3),
    asked: wp.array(dtype=wp.vec4),
    x_searched: wp.array(dtype=wp.vec3),
    skin: wp.array(dtype=wp.vec4),
    # state out
    beside: wp.array(dtype=int),
    contacts: Contacts,
):
    """Broad phase: list pairs of near vertices, and store the skin near every vertex.

    A vertex visits its own cell and half of the neighbouring cells; vertices of the other half visit its cell.
    """
    i, thread = wp.tid()
    w = cloth.vertex_world[i]
    if searching[w] == 0:
        return
    world = worlds[w]
    p = x[i]
    if thread == 0:
        plane = skin[i]
        plane[3] += wp.dot(wp.vec3(plane[0], plane[1], plane[2]), p - x_searched[i])
        x_searched[i] = p
        lag = cloth.skin_lag[w]
        if world.skin == wp.uint64(0):
            velocity[i] = wp.vec3(0.0)
            plane = find_skin(i, p, sample_field(world, p), -1, world, cloth)
        elif not is_over_same_skin(p, velocity[i], asked[i], lag, world.frame):
            near, along, part = moving_skin(world, p, lag, velocity[i])
            plane = find_skin(i, p - lag * along, near, part, world, cloth)
            velocity[i] = along
            asked[i] = wp.vec4(p[0], p[1], p[2], lag)
        skin[i] = plane
    own = cell_of(p, world.near)
    for neighbour in range(OWN_CELL + thread, 27, threads):
        cell = own + wp.vec3i(neighbour % 3 - 1, (neighbour // 3) % 3 - 1, neighbour // 9 - 1)
        j = newest[bucket_of(cell, w, newest.shape[0])]
        while j >= 0:
            q = x[j]
            if (neighbour > OWN_CELL or j < i) and wp.length_sq(q - p) <= world.near * world.near:
                same_world = j >= world.first and j < world.first + world.size
                if same_world and cell_of(q, world.near) == cell and not are_neighbours(i, j, cloth):
                    beside[i] = 1
                    beside[j] = 1
                    slot = take_slot(contacts.near_count, w, world, contacts)
                    if slot >= 0:
                        contacts.near[slot] = wp.vec2i(wp.max(i, j), wp.min(i, j))
            j = older[j]


@wp.func
def crosses_near(i: int, j: int, corner: int, cloth: ClothArrays, x: wp.array(dtype=wp.vec3)) -> bool:
    """Whether an edge crosses one of the faces round a vertex."""
    for at in range(cloth.first_face[corner], cloth.first_face[corner + 1]):
        face = cloth.faces[cloth.vertex_faces[at]]
        if not (has_vertex(face, i) or has_vertex(face, j)):
            if segment_crosses(x[i], x[j], x[face[0]], x[face[1]], x[face[2]]):
                return True
    return False


@wp.func
def list_point_triangle(
    i: int,
    j: int,
    f: int,
    w: int,
    world: World,
    cloth: ClothArrays,
    tangled: wp.array(dtype=int),
    passed: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    listed: wp.array(dtype=int),
    contacts: Contacts,
):
    """List vertex ``i`` with face ``f`` if nearer than the margin.

    Only the call with the face's nearest corner ``j`` lists it, so that each contact is listed once.
    """
    face = cloth.faces[f]
    point = wp.vec4i(i, face[0], face[1], face[2])
    if has_vertex(face, i) or point_passed(point, passed):
        return
    a = x[face[0]]
    b = x[face[1]]
    c = x[face[2]]
    weights = closest_on_triangle(x[i], a, b, c)
    corner = int(0)
    if weights[1] > weights[0]:
        corner = 1
    if weights[2] > weights[corner]:
        corner = 2
    if face[corner] != j:
        return
    away = x[i] - (weights[0] * a + weights[1] * b + weights[2] * c)
    if wp.length_sq(away) > world.margin * world.margin:
        return
    if tangled[i] != 0 and tangled[face[0]] + tangled[face[1]] + tangled[face[2]] != 0:
        for at in range(cloth.first_edge[i], cloth.first_edge[i + 1]):
            ends = cloth.edges[cloth.vertex_edges[at]]
            for k in range(3):
                if crosses_near(ends[0], ends[1], face[k], cloth, x):
                    return  # the cloth crosses here: the right side is unknown
    side = float(1.0)
    if wp.dot(away, wp.cross(b - a, c - a)) < 0.0:
        side = -1.0
    slot = take_slot(contacts.point_count, w, world, contacts)
    if slot >= 0:
        contacts.points[slot] = point
        contacts.sides[slot] = side
        mark(point, listed)


@wp.func
def list_edge_edge(
    i: int,
    j: int,
    e: int,
    g: int,
    w: int,
    world: World,
    cloth: ClothArrays,
    tangled: wp.array(dtype=int),
    passed: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    listed: wp.array(dtype=int),
    contacts: Contacts,
):
    """List edges ``e`` and ``g`` if their nearest points lie inside both edges, and are nearer than the margin.

    Only the call with their nearest ends ``i`` and ``j`` lists them, so that each contact is listed once.
    """
    i1 = cloth.edges[e][0] + cloth.edges[e][1] - i
    j1 = cloth.edges[g][0] + cloth.edges[g][1] - j
    ends = wp.vec4i(i, i1, j, j1)
    if i1 == j1 or i1 == j or j1 == i or edges_passed(ends, passed):
        return
    st = closest_on_edges(x[i], x[i1], x[j], x[j1])
    if st[0] <= 0.0 or st[0] > 0.5 or st[1] <= 0.0 or st[1] > 0.5:
        return  # nearest at an end: a point-triangle contact; in another half: the pair of ends there lists the contact
    between = wp.lerp(x[j], x[j1], st[1]) - wp.lerp(x[i], x[i1], st[0])
    gap = wp.length(between)
    if gap > world.margin or gap < 1.0e-6:
        return
    if tangled[i] + tangled[i1] != 0 and tangled[j] + tangled[j1] != 0:
        crossing = crosses_near(i, i1, j, cloth, x) or crosses_near(i, i1, j1, cloth, x)
        if crossing or crosses_near(j, j1, i, cloth, x) or crosses_near(j, j1, i1, cloth, x):
            return
    slot = take_slot(contacts.edge_count, w, world, contacts)
    if slot >= 0:
        contacts.edges[slot] = ends
        contacts.normals[slot] = between / gap
        mark(ends, listed)


@wp.kernel
def count_near_work(
    worlds: wp.array(dtype=World),
    # state in
    searching: wp.array(dtype=int),
    # state in and out
    contacts: Contacts,
):
    """The near pairs of each searching world, 0 for others."""
    w = wp.tid()
    work = int(0)
    if searching[w] != 0:
        work = entries(contacts.near_count, w, worlds[w], contacts)
    contacts.own_work[w] = work


@wp.kernel(launch_bounds=(256, 3))
def find_contacts(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    threads: int,
    # state in
    tangled: wp.array(dtype=int),
    passed: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state in and out
    listed: wp.array(dtype=int),
    contacts: Contacts,
):
    """Narrow phase: list point-triangle and edge-edge contacts round every near pair of vertices."""
    total = THREADS_PER_PAIR * contacts.near_work[contacts.near_work.shape[0] - 1]
    for task in range(wp.tid(), total, threads):
        item = task // THREADS_PER_PAIR
        lane = task % STRIDE
        half = (task % THREADS_PER_PAIR) // STRIDE
        w = world_of(item, contacts.near_work)
        world = worlds[w]
        pair = contacts.near[contacts.room * world.first + item - contacts.near_work[w]]
        i = pair[0]
        j = pair[1]
        p = i
        q = j
        if half == 1:
            p = j
            q = i
        for at in range(cloth.first_face[q] + lane, cloth.first_face[q + 1], STRIDE):
            list_point_triangle(p, q, cloth.vertex_faces[at], w, world, cloth, tangled, passed, x, listed, contacts)
        for at in range(cloth.first_edge[i] + lane, cloth.first_edge[i + 1], STRIDE):
            e = cloth.vertex_edges[at]
            for to in range(cloth.first_edge[j] + half, cloth.first_edge[j + 1], 2):
                g = cloth.vertex_edges[to]
                list_edge_edge(i, j, e, g, w, world, cloth, tangled, passed, x, listed, contacts)


@wp.kernel
def find_long_edges(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    # state in
    searching: wp.array(dtype=int),
    skin: wp.array(dtype=wp.vec4),
    x: wp.array(dtype=wp.vec3),
    # state out
    listed: wp.array(dtype=int),
    contacts: Contacts,
):
    """List long edges whose inside may come near the skin: edges of coarse cloth, and of seams not closed yet."""
    e = wp.tid()
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    w = cloth.vertex_world[i]
    if searching[w] == 0:
        return
    world = worlds[w]
    half = 0.5 * wp.length(x[j] - x[i])
    if half < 0.5 * SHORT_EDGE:
        return
    limit = 0.5 * half + world.clear
    from_skin = skin[i][3]
    if from_skin > limit + half + FIELD_SLACK and from_skin < FAR:
        return  # the midpoint is nearer to the skin by half an edge at most
    if world.skin == wp.uint64(0):
        middle = sample_field(world, wp.lerp(x[i], x[j], 0.5))
        if middle[3] > limit:
            return
    slot = take_slot(contacts.long_count, w, world, contacts)
    if slot >= 0:
        contacts.long_edges[slot] = cloth.edges[e]
        if world.skin != wp.uint64(0):
            find_inside_planes(cloth.edges[e], 3 * slot, world, cloth, x, contacts.long_planes)
        listed[i] = 1
        listed[j] = 1
