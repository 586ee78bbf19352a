"""Cloth against itself: pairs of a point and a triangle, and of two edges, found by boxes and pushed apart.

A pair is found in one of the searches, which also settles on which side its two parts belong; until the next search it
is pushed apart whenever it comes nearer than the cloth's thickness. Both parts move, by their inertia.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.push import add_push, add_weight, crowd
from gcd_dataset.generator.drape.kernels.world import RUNNING, World

wp.set_module_options({"enable_backward": False})

PARTING_SPEED = 25.0  # cm/s at which layers that are already too near part


@wp.kernel
def bound_triangles(
    # model
    faces: wp.array(dtype=wp.vec3i),
    # state in
    x: wp.array(dtype=wp.vec3),
    # state out
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
):
    """The box round every triangle."""
    f = wp.tid()
    a = x[faces[f][0]]
    b = x[faces[f][1]]
    c = x[faces[f][2]]
    lower[f] = wp.min(wp.min(a, b), c)
    upper[f] = wp.max(wp.max(a, b), c)


@wp.func
def closest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Barycentric weights of a triangle's point nearest to ``p`` (Ericson, Real-Time Collision Detection, 5.1.5)."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return wp.vec3(1.0 - t, t, 0.0)
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return wp.vec3(1.0 - t, 0.0, t)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - t, t)
    total = va + vb + vc
    return wp.vec3(va / total, vb / total, vc / total)


@wp.func
def closest_on_edges(a0: wp.vec3, a1: wp.vec3, b0: wp.vec3, b1: wp.vec3) -> wp.vec2:
    """Parameters of the two nearest points of two segments (Ericson, 5.1.9)."""
    da = a1 - a0
    db = b1 - b0
    r = a0 - b0
    aa = wp.dot(da, da)
    bb = wp.dot(db, db)
    br = wp.dot(db, r)
    ar = wp.dot(da, r)
    ab = wp.dot(da, db)
    wide = aa * bb - ab * ab
    s = 0.5
    if wide > 1.0e-9 * aa * bb:
        s = wp.clamp((ab * br - ar * bb) / wide, 0.0, 1.0)
    t = (ab * s + br) / wp.max(bb, 1.0e-12)
    if t < 0.0:
        t = 0.0
        s = wp.clamp(-ar / wp.max(aa, 1.0e-12), 0.0, 1.0)
    elif t > 1.0:
        t = 1.0
        s = wp.clamp((ab - ar) / wp.max(aa, 1.0e-12), 0.0, 1.0)
    return wp.vec2(s, t)


@wp.func
def has_vertex(face: wp.vec3i, i: int) -> bool:
    return face[0] == i or face[1] == i or face[2] == i


@wp.func
def take_slot(count: wp.array(dtype=int), world: int, overfull: wp.array(dtype=int), capacity: int) -> int:
    """The next free slot of a list of pairs, or -1 and a mark on the world."""
    slot = wp.atomic_add(count, 0, 1)
    if slot >= capacity:
        overfull[world] = 1
        return -1
    return slot


@wp.kernel
def find_point_triangle(
    # model
    worlds: wp.array(dtype=World),
    vertex_world: wp.array(dtype=int),
    faces: wp.array(dtype=wp.vec3i),
    bvh: wp.uint64,
    margin: float,
    capacity: int,
    # state in
    status: wp.array(dtype=int),
    tangled: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    near: wp.array(dtype=int),
    pairs: wp.array(dtype=wp.vec3i),
    count: wp.array(dtype=int),
    overfull: wp.array(dtype=int),
):
    """List the triangles near every vertex: (vertex, triangle, side)."""
    i = wp.tid()
    w = vertex_world[i]
    if status[w] != RUNNING:
        return
    p = x[i]
    reach = wp.vec3(margin)
    query = wp.bvh_query_aabb(bvh, p - reach, p + reach, wp.bvh_get_group_root(bvh, w))
    f = int(0)
    while wp.bvh_query_next(query, f):
        face = faces[f]
        if has_vertex(face, i):
            continue
        a = x[face[0]]
        b = x[face[1]]
        c = x[face[2]]
        weights = closest_on_triangle(p, a, b, c)
        away = p - (weights[0] * a + weights[1] * b + weights[2] * c)
        if wp.length_sq(away) > margin * margin:
            continue
        near[i] = 1
        near[face[0]] = 1
        near[face[1]] = 1
        near[face[2]] = 1
        crossed = tangled[face[0]] + tangled[face[1]] + tangled[face[2]]
        if tangled[i] != 0 and crossed != 0:
            continue
        side = 1
        if wp.dot(away, wp.cross(b - a, c - a)) < 0.0:
            side = -1
        slot = take_slot(count, w, overfull, capacity)
        if slot >= 0:
            pairs[slot] = wp.vec3i(i, f, side)


@wp.kernel
def find_edge_edge(
    # model
    vertex_world: wp.array(dtype=int),
    edges: wp.array(dtype=wp.vec2i),
    face_edges: wp.array(dtype=wp.vec3i),
    edge_face: wp.array(dtype=int),
    bvh: wp.uint64,
    margin: float,
    capacity: int,
    # state in
    status: wp.array(dtype=int),
    tangled: wp.array(dtype=int),
    near: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    pairs: wp.array(dtype=wp.vec2i),
    normals: wp.array(dtype=wp.vec3),
    count: wp.array(dtype=int),
    overfull: wp.array(dtype=int),
):
    """List the pairs of edges near each other, each pair once, with the direction from the first to the second.

    Edges with no vertex near another triangle are passed over. An edge is met through one of its triangles alone.
    """
    e = wp.tid()
    i0 = edges[e][0]
    i1 = edges[e][1]
    w = vertex_world[i0]
    if status[w] != RUNNING or near[i0] + near[i1] == 0:
        return
    a0 = x[i0]
    a1 = x[i1]
    reach = wp.vec3(margin)
    query = wp.bvh_query_aabb(bvh, wp.min(a0, a1) - reach, wp.max(a0, a1) + reach, wp.bvh_get_group_root(bvh, w))
    f = int(0)
    while wp.bvh_query_next(query, f):
        for corner in range(3):
            other = face_edges[f][corner]
            if edge_face[other] != f or other == e:
                continue
            j0 = edges[other][0]
            j1 = edges[other][1]
            if other < e and near[j0] + near[j1] != 0:
                continue  # that edge lists the pair itself
            if i0 == j0 or i0 == j1 or i1 == j0 or i1 == j1:
                continue
            b0 = x[j0]
            b1 = x[j1]
            st = closest_on_edges(a0, a1, b0, b1)
            if st[0] <= 0.0 or st[0] >= 1.0 or st[1] <= 0.0 or st[1] >= 1.0:
                continue  # nearest at an end: a point and a triangle see to it
            between = wp.lerp(b0, b1, st[1]) - wp.lerp(a0, a1, st[0])
            gap = wp.length(between)
            if gap > margin or gap < 1.0e-6:
                continue
            if tangled[i0] + tangled[i1] != 0 and tangled[j0] + tangled[j1] != 0:
                continue
            slot = take_slot(count, w, overfull, capacity)
            if slot >= 0:
                pairs[slot] = wp.vec2i(e, other)
                normals[slot] = between / gap


@wp.func
def parting(gap_old: float, gap_new: float, thickness: float, max_part: float) -> float:
    """How far a pair is pushed apart [cm]: what it came nearer at once, what was too near before little by little."""
    return wp.clamp(thickness - gap_new, 0.0, wp.max(gap_old - gap_new, 0.0) + max_part)


@wp.kernel
def push_point_triangle(
    # model
    worlds: wp.array(dtype=World),
    vertex_world: wp.array(dtype=int),
    faces: wp.array(dtype=wp.vec3i),
    inertia: wp.array(dtype=float),
    announce: bool,
    stride: int,
    capacity: int,
    # state in
    status: wp.array(dtype=int),
    pairs: wp.array(dtype=wp.vec3i),
    count: wp.array(dtype=int),
    x_old: wp.array(dtype=wp.vec3),
    x_new: wp.array(dtype=wp.vec3),
    # state out
    push: wp.array2d(dtype=int),
):
    """Push listed points and triangles apart where they came too near."""
    slot = int(wp.tid())
    total = wp.min(count[0], capacity)
    while slot < total:
        i = pairs[slot][0]
        face = faces[pairs[slot][1]]
        side = float(pairs[slot][2])
        slot += stride
        w = vertex_world[i]
        if status[w] != RUNNING:
            continue
        world = worlds[w]
        a = x_new[face[0]]
        b = x_new[face[1]]
        c = x_new[face[2]]
        weights = closest_on_triangle(x_new[i], a, b, c)
        away = x_new[i] - (weights[0] * a + weights[1] * b + weights[2] * c)
        normal = side * wp.normalize(wp.cross(b - a, c - a))
        gap = wp.dot(away, normal)
        beside = wp.length_sq(away) - gap * gap  # off the triangle's rim: an edge or a neighbour sees to it
        if wp.max(gap, 0.0) * gap + beside >= world.thickness * world.thickness:
            continue
        before = x_old[i] - (weights[0] * x_old[face[0]] + weights[1] * x_old[face[1]] + weights[2] * x_old[face[2]])
        apart = parting(wp.dot(before, normal), gap, world.thickness, PARTING_SPEED * world.dt)
        if apart <= 0.0:
            continue
        if announce:
            add_weight(push, i, 1.0)
            for corner in range(3):
                add_weight(push, face[corner], weights[corner])
            continue
        lever = 1.0 / inertia[i]
        crowded = crowd(push, i)
        for corner in range(3):
            if weights[corner] > 0.0:
                lever += weights[corner] * weights[corner] / inertia[face[corner]]
                crowded = wp.max(crowded, crowd(push, face[corner]))
        step = (apart / (lever * crowded)) * normal
        add_push(push, i, step / inertia[i])
        for corner in range(3):
            if weights[corner] > 0.0:
                add_push(push, face[corner], (-weights[corner] / inertia[face[corner]]) * step)


@wp.kernel
def push_edge_edge(
    # model
    worlds: wp.array(dtype=World),
    vertex_world: wp.array(dtype=int),
    edges: wp.array(dtype=wp.vec2i),
    inertia: wp.array(dtype=float),
    announce: bool,
    stride: int,
    capacity: int,
    # state in
    status: wp.array(dtype=int),
    pairs: wp.array(dtype=wp.vec2i),
    normals: wp.array(dtype=wp.vec3),
    count: wp.array(dtype=int),
    x_old: wp.array(dtype=wp.vec3),
    x_new: wp.array(dtype=wp.vec3),
    # state out
    push: wp.array2d(dtype=int),
):
    """Push listed pairs of edges apart where they came too near."""
    slot = int(wp.tid())
    total = wp.min(count[0], capacity)
    while slot < total:
        first = edges[pairs[slot][0]]
        second = edges[pairs[slot][1]]
        found = normals[slot]
        slot += stride
        w = vertex_world[first[0]]
        if status[w] != RUNNING:
            continue
        world = worlds[w]
        a0 = x_new[first[0]]
        a1 = x_new[first[1]]
        b0 = x_new[second[0]]
        b1 = x_new[second[1]]
        st = closest_on_edges(a0, a1, b0, b1)
        s = st[0]
        t = st[1]
        if s <= 0.0 or s >= 1.0 or t <= 0.0 or t >= 1.0:
            continue
        between = wp.lerp(b0, b1, t) - wp.lerp(a0, a1, s)
        normal = wp.normalize(between)
        if wp.dot(normal, found) < 0.0:
            normal = -normal
        gap = wp.dot(between, normal)
        if gap >= world.thickness:
            continue
        before = wp.lerp(x_old[second[0]], x_old[second[1]], t) - wp.lerp(x_old[first[0]], x_old[first[1]], s)
        apart = parting(wp.dot(before, normal), gap, world.thickness, PARTING_SPEED * world.dt)
        if apart <= 0.0:
            continue
        if announce:
            add_weight(push, first[0], 1.0 - s)
            add_weight(push, first[1], s)
            add_weight(push, second[0], 1.0 - t)
            add_weight(push, second[1], t)
            continue
        lever = (
            (1.0 - s) * (1.0 - s) / inertia[first[0]]
            + s * s / inertia[first[1]]
            + (1.0 - t) * (1.0 - t) / inertia[second[0]]
            + t * t / inertia[second[1]]
        )
        crowded = wp.max(
            wp.max(crowd(push, first[0]), crowd(push, first[1])), wp.max(crowd(push, second[0]), crowd(push, second[1]))
        )
        step = (apart / (lever * crowded)) * normal
        add_push(push, first[0], ((s - 1.0) / inertia[first[0]]) * step)
        add_push(push, first[1], (-s / inertia[first[1]]) * step)
        add_push(push, second[0], ((1.0 - t) / inertia[second[0]]) * step)
        add_push(push, second[1], (t / inertia[second[1]]) * step)
