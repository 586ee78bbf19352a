"""Edges that cross triangles: found, marked, counted, and moved apart.

Cloth that has crossed is moved so that the curve along which it crosses gets shorter (after Volino and
Magnenat-Thalmann, SIGGRAPH 2006), which needs no knowledge of sides. Displacing an edge by ``d`` against a triangle
with normal ``N`` moves their crossing point by ``d - (N·d / N·E) E``, ``E`` along the edge; so its projections on the
curve's directions ``R`` into the edge's faces grow fastest along ``R - (E·R / E·N) N``.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.push import add_push
from gcd_dataset.generator.drape.kernels.self_contact import has_vertex, take_slot
from gcd_dataset.generator.drape.kernels.world import RUNNING, World

wp.set_module_options({"enable_backward": False})

GLANCING = 0.1  # least |E·N| that the step is divided by
PARTING_ACCELERATION = 8000.0  # cm/s²


@wp.func
def segment_crosses(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> bool:
    """Whether segment pq crosses triangle abc (Möller–Trumbore, both ends included)."""
    along = q - p
    ab = b - a
    ac = c - a
    h = wp.cross(along, ac)
    det = wp.dot(ab, h)
    if wp.abs(det) < 1.0e-12:
        return False
    s = (p - a) / det
    u = wp.dot(s, h)
    if u < 0.0 or u > 1.0:
        return False
    g = wp.cross(s, ab)
    v = wp.dot(along, g)
    if v < 0.0 or u + v > 1.0:
        return False
    t = wp.dot(ac, g)
    return t >= 0.0 and t <= 1.0


@wp.kernel
def find_crossings(
    # model
    vertex_world: wp.array(dtype=int),
    edges: wp.array(dtype=wp.vec2i),
    faces: wp.array(dtype=wp.vec3i),
    bvh: wp.uint64,
    capacity: int,
    # state in
    status: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    tangled: wp.array(dtype=int),
    crossings: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=int),
    overfull: wp.array(dtype=int),
):
    """List (edge, triangle) for every crossing of the cloth with itself, and mark the vertices of both."""
    e = wp.tid()
    i = edges[e][0]
    j = edges[e][1]
    w = vertex_world[i]
    if status[w] != RUNNING:
        return
    p = x[i]
    q = x[j]
    query = wp.bvh_query_aabb(bvh, wp.min(p, q), wp.max(p, q), wp.bvh_get_group_root(bvh, w))
    f = int(0)
    while wp.bvh_query_next(query, f):
        face = faces[f]
        if has_vertex(face, i) or has_vertex(face, j):
            continue
        if segment_crosses(p, q, x[face[0]], x[face[1]], x[face[2]]):
            tangled[i] = 1
            tangled[j] = 1
            tangled[face[0]] = 1
            tangled[face[1]] = 1
            tangled[face[2]] = 1
            slot = take_slot(count, w, overfull, capacity)
            if slot >= 0:
                crossings[slot] = wp.vec2i(e, f)


@wp.func
def into_face(along: wp.vec3, start: wp.vec3, opposite: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """Direction of the crossing curve from an edge into one of its faces."""
    across = opposite - start
    inward = across - wp.dot(across, along) * along
    curve = wp.normalize(wp.cross(wp.cross(along, inward), normal))
    if wp.dot(curve, inward) < 0.0:
        curve = -curve
    return curve


@wp.kernel
def part_crossings(
    # model
    worlds: wp.array(dtype=World),
    vertex_world: wp.array(dtype=int),
    edges: wp.array(dtype=wp.vec2i),
    edge_opposite: wp.array(dtype=wp.vec2i),
    faces: wp.array(dtype=wp.vec3i),
    inertia: wp.array(dtype=float),
    stride: int,
    capacity: int,
    # state in
    status: wp.array(dtype=int),
    crossings: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    push: wp.array2d(dtype=int),
):
    """Accelerate edges and triangles that still cross against each other, so that the crossing curve shortens."""
    slot = int(wp.tid())
    total = wp.min(count[0], capacity)
    while slot < total:
        e = crossings[slot][0]
        face = faces[crossings[slot][1]]
        slot += stride
        i = edges[e][0]
        j = edges[e][1]
        w = vertex_world[i]
        a = x[face[0]]
        b = x[face[1]]
        c = x[face[2]]
        if status[w] != RUNNING or not segment_crosses(x[i], x[j], a, b, c):
            continue
        normal = wp.normalize(wp.cross(b - a, c - a))
        along = wp.normalize(x[j] - x[i])
        curve = into_face(along, x[i], x[edge_opposite[e][0]], normal)
        if edge_opposite[e][1] >= 0:
            curve += into_face(along, x[i], x[edge_opposite[e][1]], normal)
        steep = wp.dot(along, normal)
        if wp.abs(steep) < GLANCING:
            steep = wp.sign(steep) * GLANCING
        way = curve - (wp.dot(along, curve) / steep) * normal
        way = way / wp.sqrt(wp.length_sq(way) + 0.25)
        dt = worlds[w].dt
        lever = 0.5 * (1.0 / inertia[i] + 1.0 / inertia[j])
        step = (PARTING_ACCELERATION * dt * dt / lever) * way
        add_push(push, i, (0.5 / inertia[i]) * step)
        add_push(push, j, (0.5 / inertia[j]) * step)
        for corner in range(3):
            add_push(push, face[corner], (-1.0 / 3.0 / inertia[face[corner]]) * step)


@wp.kernel
def count_self_crossings(
    # model
    vertex_world: wp.array(dtype=int),
    edges: wp.array(dtype=wp.vec2i),
    faces: wp.array(dtype=wp.vec3i),
    bvh: wp.uint64,
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges that cross at least one triangle with which they share no vertex."""
    e = wp.tid()
    i = edges[e][0]
    j = edges[e][1]
    w = vertex_world[i]
    p = x[i]
    q = x[j]
    query = wp.bvh_query_aabb(bvh, wp.min(p, q), wp.max(p, q), wp.bvh_get_group_root(bvh, w))
    f = int(0)
    while wp.bvh_query_next(query, f):
        face = faces[f]
        if has_vertex(face, i) or has_vertex(face, j):
            continue
        if segment_crosses(p, q, x[face[0]], x[face[1]], x[face[2]]):
            wp.atomic_add(crossings, w, 1)
            return


@wp.kernel
def count_body_crossings(
    # model
    vertex_world: wp.array(dtype=int),
    edges: wp.array(dtype=wp.vec2i),
    body_mesh: wp.array(dtype=wp.uint64),
    # state in
    x: wp.array(dtype=wp.vec3),
    # out
    crossings: wp.array(dtype=int),
):
    """Count the edges that cross the body's skin."""
    e = wp.tid()
    i = edges[e][0]
    w = vertex_world[i]
    along = x[edges[e][1]] - x[i]
    length = wp.length(along)
    if length > 0.0:
        hit = wp.mesh_query_ray(body_mesh[w], x[i], along / length, length)
        if hit.result:
            wp.atomic_add(crossings, w, 1)
