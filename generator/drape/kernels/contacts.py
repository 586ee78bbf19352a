"""What watched pairs ask of their vertices: to keep the cloth's thickness apart, to come apart, to leave the body.

A pair is found in one of the searches, which also settles on which side its two parts belong; until the next search it
is pushed apart whenever it comes nearer than the cloth's thickness. Both parts move, by their inertia.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import push_long_edge
from gcd_dataset.generator.drape.kernels.crossing import part_crossing
from gcd_dataset.generator.drape.kernels.geometry import closest_on_edges, closest_on_triangle, parting
from gcd_dataset.generator.drape.kernels.push import add_push, add_weight, crowd
from gcd_dataset.generator.drape.kernels.world import RUNNING, Cloth, Contacts, World, listed

wp.set_module_options({"enable_backward": False})

PARTING_SPEED = 25.0  # cm/s at which layers that are already too near part


@wp.func
def push_point(
    i: int,
    face: wp.vec3i,
    side: float,
    world: World,
    inertia: wp.array(dtype=float),
    announce: bool,
    x_old: wp.array(dtype=wp.vec3),
    x_new: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=int),
):
    """Push a point and a triangle apart if they came too near."""
    a = x_new[face[0]]
    b = x_new[face[1]]
    c = x_new[face[2]]
    weights = closest_on_triangle(x_new[i], a, b, c)
    away = x_new[i] - (weights[0] * a + weights[1] * b + weights[2] * c)
    normal = side * wp.normalize(wp.cross(b - a, c - a))
    gap = wp.dot(away, normal)
    beside = wp.length_sq(away) - gap * gap  # off the triangle's rim: an edge or a neighbour sees to it
    if wp.max(gap, 0.0) * gap + beside >= world.thickness * world.thickness:
        return
    before = x_old[i] - (weights[0] * x_old[face[0]] + weights[1] * x_old[face[1]] + weights[2] * x_old[face[2]])
    apart = parting(wp.dot(before, normal), gap, world.thickness, PARTING_SPEED * world.dt)
    if apart <= 0.0:
        return
    if announce:
        add_weight(push, i, 1.0)
        for corner in range(3):
            add_weight(push, face[corner], weights[corner])
        return
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


@wp.func
def push_edges(
    first: wp.vec2i,
    second: wp.vec2i,
    found: wp.vec3,
    world: World,
    inertia: wp.array(dtype=float),
    announce: bool,
    x_old: wp.array(dtype=wp.vec3),
    x_new: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=int),
):
    """Push two edges apart if they came too near; ``found`` is the direction between them when they were found."""
    a0 = x_new[first[0]]
    a1 = x_new[first[1]]
    b0 = x_new[second[0]]
    b1 = x_new[second[1]]
    st = closest_on_edges(a0, a1, b0, b1)
    s = st[0]
    t = st[1]
    if s <= 0.0 or s >= 1.0 or t <= 0.0 or t >= 1.0:
        return
    between = wp.lerp(b0, b1, t) - wp.lerp(a0, a1, s)
    normal = wp.normalize(between)
    if wp.dot(normal, found) < 0.0:
        normal = -normal
    gap = wp.dot(between, normal)
    if gap >= world.thickness:
        return
    before = wp.lerp(x_old[second[0]], x_old[second[1]], t) - wp.lerp(x_old[first[0]], x_old[first[1]], s)
    apart = parting(wp.dot(before, normal), gap, world.thickness, PARTING_SPEED * world.dt)
    if apart <= 0.0:
        return
    if announce:
        add_weight(push, first[0], 1.0 - s)
        add_weight(push, first[1], s)
        add_weight(push, second[0], 1.0 - t)
        add_weight(push, second[1], t)
        return
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


@wp.kernel
def push_contacts(
    # model
    worlds: wp.array(dtype=World),
    cloth: Cloth,
    contacts: Contacts,
    announce: bool,
    threads: int,
    # state in
    status: wp.array(dtype=int),
    x_old: wp.array(dtype=wp.vec3),
    x_new: wp.array(dtype=wp.vec3),
    # state in and out
    time: wp.array(dtype=float),
    push: wp.array2d(dtype=int),
):
    """Walk a world's lists: once to announce what is touched, which also ends the step on its clock, once to push."""
    w, thread = wp.tid()
    if status[w] != RUNNING:
        return
    world = worlds[w]
    if announce and thread == 0:
        time[w] = time[w] + world.dt
    at = contacts.room * world.first
    for k in range(thread, listed(contacts.point_count, w, world, contacts), threads):
        point = contacts.points[at + k]
        push_point(
            point[0], cloth.faces[point[1]], float(point[2]), world, cloth.inertia, announce, x_old, x_new, push
        )
    for k in range(thread, listed(contacts.edge_count, w, world, contacts), threads):
        pair = contacts.edges[at + k]
        push_edges(
            cloth.edges[pair[0]],
            cloth.edges[pair[1]],
            contacts.normals[at + k],
            world,
            cloth.inertia,
            announce,
            x_old,
            x_new,
            push,
        )
    for k in range(thread, listed(contacts.long_count, w, world, contacts), threads):
        push_long_edge(cloth.edges[contacts.long_edges[at + k]], world, cloth, announce, x_old, x_new, push)
    if announce:
        return
    for k in range(thread, listed(contacts.crossing_count, w, world, contacts), threads):
        part_crossing(contacts.crossings[at + k], world, cloth, x_new, push)
