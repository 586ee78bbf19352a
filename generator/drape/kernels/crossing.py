"""Edges that cross triangles: found, marked, counted, and moved apart.

Cloth that has crossed is moved so that the curve along which it crosses gets shorter (after Volino and
Magnenat-Thalmann, SIGGRAPH 2006), which needs no knowledge of sides. Displacing an edge by ``d`` against a triangle
with normal ``N`` moves their crossing point by ``d - (N·d / N·E) E``, ``E`` along the edge; so its projections on the
curve's directions ``R`` into the edge's faces grow fastest along ``R - (E·R / E·N) N``.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.geometry import has_vertex, segment_crosses
from gcd_dataset.generator.drape.kernels.push import add_push
from gcd_dataset.generator.drape.kernels.world import Cloth, Contacts, CrossingWatch, World, take_slot

wp.set_module_options({"enable_backward": False})

GLANCING = 0.1  # least |E·N| that the step is divided by


@wp.kernel
def find_roots(
    bvh: wp.uint64,
    # out
    roots: wp.array(dtype=int),
):
    """Where the tree of each world begins, which takes a search."""
    w = wp.tid()
    roots[w] = wp.bvh_get_group_root(bvh, w)


@wp.kernel
def forget_crossings(
    cloth: Cloth,
    # state in
    crossing: CrossingWatch,
    # state out
    tangled: wp.array(dtype=int),
):
    """Unmark all vertices before crossings are looked for."""
    i = wp.tid()
    if crossing.searched[cloth.vertex_world[i]] != 0:
        tangled[i] = 0


@wp.kernel
def find_crossings(
    # model
    worlds: wp.array(dtype=World),
    cloth: Cloth,
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
    """List (edge, triangle) for every crossing of the cloth with itself, and mark the vertices of both.

    Where an edge crosses a triangle of its own length, vertices of both are near each other; other edges are passed by.
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
    """Direction of the crossing curve from an edge into one of its faces."""
    across = opposite - start
    inward = across - wp.dot(across, along) * along
    curve = wp.normalize(wp.cross(wp.cross(along, inward), normal))
    if wp.dot(curve, inward) < 0.0:
        curve = -curve
    return curve


@wp.func
def pull_to_part(i: int, world: World, cloth: Cloth, x: wp.array(dtype=wp.vec3), push: wp.array2d(dtype=int)):
    """Accelerate a vertex toward the axis of the part of the body that its cloth covers."""
    part = cloth.own_part[i]
    if part < 0 or world.pulling == 0.0:
        return
    w = cloth.vertex_world[i]
    start = cloth.axes[2 * w, part]
    along = cloth.axes[2 * w + 1, part] - start
    share = wp.clamp(wp.dot(x[i] - start, along) / wp.max(wp.length_sq(along), 1.0e-6), 0.0, 1.0)
    add_push(push, i, (world.pulling * world.dt * world.dt) * wp.normalize(start + share * along - x[i]))


@wp.func
def part_crossing(
    crossing: wp.vec2i, world: World, cloth: Cloth, x: wp.array(dtype=wp.vec3), push: wp.array2d(dtype=int)
):
    """Accelerate an edge and a triangle that still cross against each other, so that the crossing curve shortens."""
    e = crossing[0]
    face = cloth.faces[crossing[1]]
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    a = x[face[0]]
    b = x[face[1]]
    c = x[face[2]]
    if not segment_crosses(x[i], x[j], a, b, c):
        return
    normal = wp.normalize(wp.cross(b - a, c - a))
    along = wp.normalize(x[j] - x[i])
    curve = into_face(along, x[i], x[cloth.edge_opposite[e][0]], normal)
    if cloth.edge_opposite[e][1] >= 0:
        curve += into_face(along, x[i], x[cloth.edge_opposite[e][1]], normal)
    steep = wp.dot(along, normal)
    if wp.abs(steep) < GLANCING:
        steep = wp.sign(steep) * GLANCING
    way = curve - (wp.dot(along, curve) / steep) * normal
    way = way / wp.sqrt(wp.length_sq(way) + 0.25)
    lever = 0.5 * (1.0 / cloth.inertia[i] + 1.0 / cloth.inertia[j])
    if cloth.own_part[i] != cloth.own_part[face[0]]:
        pull_to_part(i, world, cloth, x, push)
        pull_to_part(j, world, cloth, x, push)
        for corner in range(3):
            pull_to_part(face[corner], world, cloth, x, push)
    step = (world.untangling * world.dt * world.dt / lever) * way
    add_push(push, i, (0.5 / cloth.inertia[i]) * step)
    add_push(push, j, (0.5 / cloth.inertia[j]) * step)
    for corner in range(3):
        add_push(push, face[corner], (-1.0 / 3.0 / cloth.inertia[face[corner]]) * step)


@wp.kernel
def count_self_crossings(
    # model
    cloth: Cloth,
    bvh: wp.uint64,
    roots: wp.array(dtype=int),
    asked: wp.array(dtype=int),
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges that cross at least one triangle with which they share no vertex."""
    e = wp.tid()
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    w = cloth.vertex_world[i]
    if asked[w] == 0:
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
class BodyEdges:
    """The edges of one body."""

    mesh: wp.uint64
    ends: wp.array(dtype=wp.vec2i)  # vertices of the mesh


@wp.kernel
def count_body_through(
    # model
    cloth: Cloth,
    bodies: wp.array(dtype=BodyEdges),
    bvh: wp.uint64,
    roots: wp.array(dtype=int),
    asked: wp.array(dtype=int),
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges of each world's body that cross at least one triangle of its cloth."""
    w, e = wp.tid()
    if asked[w] == 0 or e >= bodies[w].ends.shape[0]:
        return
    ends = bodies[w].ends[e]
    mesh = wp.mesh_get(bodies[w].mesh)
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
    """Whether the segment pq meets the skin of a body."""
    length = wp.length(q - p)
    if length == 0.0:
        return False
    hit = wp.mesh_query_ray(mesh, p, (q - p) / length, length)
    return hit.result


@wp.kernel
def count_body_crossings(
    # model
    cloth: Cloth,
    asked: wp.array(dtype=int),
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges that cross the body's skin."""
    e = wp.tid()
    i = cloth.edges[e][0]
    w = cloth.vertex_world[i]
    if asked[w] == 0:
        return
    if crosses_skin(cloth.body_mesh[w], x[i], x[cloth.edges[e][1]]):
        wp.atomic_add(crossings, w, 1)
