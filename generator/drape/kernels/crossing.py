"""Crossings: edges that intersect triangles, of cloth with cloth and with the body; their search, count and untangling.

Untangling moves crossing cloth so that the intersection contour gets shorter (after Volino and Magnenat-Thalmann,
SIGGRAPH 2006); it need not know on which side a layer belongs. Displacing an edge by ``d`` against a triangle with
normal ``N`` moves their crossing point by ``d - (N·d / N·E) E``, ``E`` along the edge. So the crossing point moves
fastest along the contour's directions ``R`` into the edge's faces for a displacement along ``R - (E·R / E·N) N``.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import toward_part
from gcd_dataset.generator.drape.kernels.geometry import has_vertex, segment_crosses
from gcd_dataset.generator.drape.kernels.push import add_push
from gcd_dataset.generator.drape.kernels.world import ClothArrays, Contacts, CrossingWatch, World, take_slot

wp.set_module_options({"enable_backward": False})

GLANCING = 0.1  # lower limit of |E·N| in the division


@wp.kernel
def find_roots(
    worlds: wp.array(dtype=World),
    bvh: wp.uint64,
    # out
    roots: wp.array(dtype=int),
):
    """Look up the root of each world's subtree in the BVH, once for all queries."""
    w = wp.tid()
    if worlds[w].size > 0:  # a search for a world without faces visits all nodes
        roots[w] = wp.bvh_get_group_root(bvh, w)


@wp.kernel
def clear_tangled(
    cloth: ClothArrays,
    # state in
    crossing: CrossingWatch,
    # state out
    tangled: wp.array(dtype=int),
):
    """Unmark the vertices of the worlds that search for crossings."""
    i = wp.tid()
    if crossing.searched[cloth.vertex_world[i]] != 0:
        tangled[i] = 0


@wp.kernel(launch_bounds=(256, 4))
def find_crossings(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    bvh: wp.uint64,
    roots: wp.array(dtype=int),
    # state in
    crossing: CrossingWatch,
    beside: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    tangled: wp.array(dtype=int),
    listed: wp.array(dtype=int),
    contacts: Contacts,
):
    """List (edge, triangle) for every crossing of cloth with cloth, and mark the vertices of both as tangled.

    Skips short edges without another vertex near either end: a crossed triangle of similar size would have one there.
    """
    e = wp.tid()
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    w = cloth.vertex_world[i]
    if crossing.searched[w] == 0:
        return
    p = x[i]
    q = x[j]
    world = worlds[w]
    if beside[i] + beside[j] == 0 and wp.length_sq(q - p) < world.near * world.near:
        return
    query = wp.bvh_query_aabb(bvh, wp.min(p, q), wp.max(p, q), roots[w])
    f = int(0)
    while wp.bvh_query_next(query, f):
        face = cloth.faces[f]
        if has_vertex(face, i) or has_vertex(face, j):
            continue
        if segment_crosses(p, q, x[face[0]], x[face[1]], x[face[2]]):
            tangled[i] = 1
            tangled[j] = 1
            listed[i] = 1
            listed[j] = 1
            for corner in range(3):
                tangled[face[corner]] = 1
                listed[face[corner]] = 1
            slot = take_slot(contacts.crossing_count, w, world, contacts)
            if slot >= 0:
                contacts.crossings[slot] = wp.vec2i(e, f)


@wp.func
def into_face(along: wp.vec3, start: wp.vec3, opposite: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """Direction of the intersection contour from an edge into one of its faces."""
    across = opposite - start
    inward = across - wp.dot(across, along) * along
    contour = wp.normalize(wp.cross(wp.cross(along, inward), normal))
    if wp.dot(contour, inward) < 0.0:
        contour = -contour
    return contour


@wp.func
def contour_direction(e: int, face: wp.vec3i, cloth: ClothArrays, x: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Direction in which an edge moves against a face that it crosses to shorten the intersection contour.

    At most 1 long, and shorter where the gradient is small.
    """
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    a = x[face[0]]
    normal = wp.normalize(wp.cross(x[face[1]] - a, x[face[2]] - a))
    along = wp.normalize(x[j] - x[i])
    contour = into_face(along, x[i], x[cloth.edge_opposite[e][0]], normal)
    if cloth.edge_opposite[e][1] >= 0:
        contour += into_face(along, x[i], x[cloth.edge_opposite[e][1]], normal)
    steep = wp.dot(along, normal)
    if wp.abs(steep) < GLANCING:
        steep = wp.sign(steep) * GLANCING
    direction = contour - (wp.dot(along, contour) / steep) * normal
    return direction / wp.sqrt(wp.length_sq(direction) + 0.25)


@wp.func
def pull_to_part(i: int, world: World, cloth: ClothArrays, x: wp.array(dtype=wp.vec3), push: wp.array2d(dtype=int)):
    """Accelerate a vertex toward the axis of the body part that it covers."""
    part = cloth.own_part[i]
    if part < 0 or world.pulling == 0.0:
        return
    add_push(push, i, (world.pulling * world.dt * world.dt) * toward_part(i, cloth, x[i]))


@wp.func
def untangle_crossing(
    crossing: wp.vec2i, world: World, cloth: ClothArrays, x: wp.array(dtype=wp.vec3), push: wp.array2d(dtype=int)
):
    """Accelerate a listed edge and triangle in opposite directions, which shortens the contour, if they still cross."""
    e = crossing[0]
    face = cloth.faces[crossing[1]]
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    if not segment_crosses(x[i], x[j], x[face[0]], x[face[1]], x[face[2]]):
        return
    direction = contour_direction(e, face, cloth, x)
    inverse_mass = 0.5 * (1.0 / cloth.inertia[i] + 1.0 / cloth.inertia[j])
    if cloth.own_part[i] != cloth.own_part[face[0]]:
        pull_to_part(i, world, cloth, x, push)
        pull_to_part(j, world, cloth, x, push)
        for corner in range(3):
            pull_to_part(face[corner], world, cloth, x, push)
    impulse = (world.untangling * world.dt * world.dt / inverse_mass) * direction
    add_push(push, i, (0.5 / cloth.inertia[i]) * impulse)
    add_push(push, j, (0.5 / cloth.inertia[j]) * impulse)
    for corner in range(3):
        add_push(push, face[corner], (-1.0 / 3.0 / cloth.inertia[face[corner]]) * impulse)


@wp.kernel
def count_self_crossings(
    # model
    cloth: ClothArrays,
    bvh: wp.uint64,
    roots: wp.array(dtype=int),
    chosen: wp.array(dtype=int),
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges of the chosen worlds that cross a triangle with which they share no vertex."""
    e = wp.tid()
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    w = cloth.vertex_world[i]
    if chosen[w] == 0:
        return
    p = x[i]
    q = x[j]
    query = wp.bvh_query_aabb(bvh, wp.min(p, q), wp.max(p, q), roots[w])
    f = int(0)
    while wp.bvh_query_next(query, f):
        face = cloth.faces[f]
        if has_vertex(face, i) or has_vertex(face, j):
            continue
        if segment_crosses(p, q, x[face[0]], x[face[1]], x[face[2]]):
            wp.atomic_add(crossings, w, 1)
            return


@wp.struct
class SkinEdges:
    """The edges of the skin in a world, or of a garment worn on it."""

    world: int
    mesh: wp.uint64
    ends: wp.array(dtype=wp.vec2i)  # vertices of the mesh


@wp.kernel
def count_body_through(
    # model
    cloth: ClothArrays,
    skins: wp.array(dtype=SkinEdges),
    bvh: wp.uint64,
    roots: wp.array(dtype=int),
    chosen: wp.array(dtype=int),
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges of skins that cross a triangle of the cloth, in the chosen worlds."""
    number, e = wp.tid()
    skin = skins[number]
    w = skin.world
    if chosen[w] == 0 or e >= skin.ends.shape[0]:
        return
    ends = skin.ends[e]
    mesh = wp.mesh_get(skin.mesh)
    p = mesh.points[ends[0]]
    q = mesh.points[ends[1]]
    query = wp.bvh_query_aabb(bvh, wp.min(p, q), wp.max(p, q), roots[w])
    f = int(0)
    while wp.bvh_query_next(query, f):
        face = cloth.faces[f]
        if segment_crosses(p, q, x[face[0]], x[face[1]], x[face[2]]):
            wp.atomic_add(crossings, w, 1)
            return


@wp.func
def crosses_skin(mesh: wp.uint64, p: wp.vec3, q: wp.vec3) -> bool:
    """Whether segment pq intersects the skin of a body."""
    length = wp.length(q - p)
    if length == 0.0:
        return False
    hit = wp.mesh_query_ray(mesh, p, (q - p) / length, length)
    return hit.result


@wp.func
def crosses_body(world: World, skin: wp.uint64, p: wp.vec3, q: wp.vec3) -> bool:
    """Whether segment pq intersects the skin, or a garment worn on it."""
    crosses = crosses_skin(skin, p, q)
    for k in range(world.worn.shape[0]):
        crosses = crosses or crosses_skin(world.worn[k], p, q)
    return crosses


@wp.kernel
def count_body_crossings(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    chosen: wp.array(dtype=int),
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges of the cloth that cross the skin or worn garments, in the chosen worlds."""
    e = wp.tid()
    i = cloth.edges[e][0]
    w = cloth.vertex_world[i]
    if chosen[w] == 0:
        return
    if crosses_body(worlds[w], cloth.body_mesh[w], x[i], x[cloth.edges[e][1]]):
        wp.atomic_add(crossings, w, 1)


@wp.kernel
def bound_faces(
    cloth: ClothArrays,
    x: wp.array(dtype=wp.vec3),
    # out
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
):
    """The axis-aligned bounding box of every face [cm]."""
    f = wp.tid()
    a = x[cloth.faces[f][0]]
    b = x[cloth.faces[f][1]]
    c = x[cloth.faces[f][2]]
    lower[f] = wp.min(wp.min(a, b), c)
    upper[f] = wp.max(wp.max(a, b), c)
