"""Contact response: displacements by point-triangle, edge-edge and long-edge contacts, and by untangling.

The search lists a pair and the side on which each element belongs. Until the next search the pair is pushed apart
whenever its predicted positions ``x + dt v`` are nearer than the cloth's thickness. Both elements move, weighted by
inverse inertia.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import push_long_edge
from gcd_dataset.generator.drape.kernels.crossing import untangle_crossing
from gcd_dataset.generator.drape.kernels.geometry import closest_on_edges, closest_on_triangle, separation
from gcd_dataset.generator.drape.kernels.push import add_push, add_weight
from gcd_dataset.generator.drape.kernels.world import (
    RUNNING,
    ClothArrays,
    Contacts,
    CrossingWatch,
    World,
    entries,
    world_of,
)

wp.set_module_options({"enable_backward": False})

SEPARATION_SPEED = 50.0  # cm/s, speed limit at which older overlap of layers is removed


@wp.func
def push_point_triangle(
    i: int,
    face: wp.vec3i,
    side: float,
    world: World,
    inertia: wp.array(dtype=float),
    contact_weight: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=int),
):
    """Add the contact weights and the separating displacements of a point-triangle contact."""
    a = x[face[0]] + world.dt * v[face[0]]
    b = x[face[1]] + world.dt * v[face[1]]
    c = x[face[2]] + world.dt * v[face[2]]
    p = x[i] + world.dt * v[i]
    weights = closest_on_triangle(p, a, b, c)
    away = p - (weights[0] * a + weights[1] * b + weights[2] * c)
    if wp.length_sq(away) > world.margin * world.margin:
        return
    normal = side * wp.normalize(wp.cross(b - a, c - a))
    gap = wp.dot(away, normal)
    before = x[i] - (weights[0] * x[face[0]] + weights[1] * x[face[1]] + weights[2] * x[face[2]])
    gap_old = wp.dot(before, normal)
    lateral_sq = wp.length_sq(away) - gap * gap  # above 0 beside the triangle, where other contacts act too
    if is_near(gap - wp.max(gap_old - gap, 0.0), lateral_sq, world.thickness):
        add_weight(push, i, 1.0)
        for corner in range(3):
            add_weight(push, face[corner], weights[corner])
    apart = separation(gap_old, gap, world.thickness, SEPARATION_SPEED * world.dt)
    if apart <= 0.0 or not is_near(gap, lateral_sq, world.thickness):
        return
    inverse_mass = 1.0 / inertia[i]
    weight_sum = contact_weight[i]
    for corner in range(3):
        if weights[corner] > 0.0:
            inverse_mass += weights[corner] * weights[corner] / inertia[face[corner]]
            weight_sum = wp.max(weight_sum, contact_weight[face[corner]])
    friction = friction_step(away - before, normal, apart, world.layer_friction)
    impulse = (apart * normal + friction) / (inverse_mass * weight_sum)
    add_push(push, i, impulse / inertia[i])
    for corner in range(3):
        if weights[corner] > 0.0:
            add_push(push, face[corner], (-weights[corner] / inertia[face[corner]]) * impulse)


@wp.func
def friction_step(moved: wp.vec3, normal: wp.vec3, apart: float, friction: float) -> wp.vec3:
    """Displacement by Coulomb friction against the sliding of two layers in a substep [cm]."""
    sliding = moved - wp.dot(moved, normal) * normal
    slid = wp.length(sliding)
    if slid == 0.0:
        return wp.vec3(0.0)
    return -wp.min(friction * apart / slid, 1.0) * sliding


@wp.func
def is_near(gap: float, lateral_sq: float, thickness: float) -> bool:
    """Whether a point is nearer to a triangle than ``thickness``, by its height and squared lateral distance."""
    return wp.max(gap, 0.0) * gap + lateral_sq < thickness * thickness


@wp.func
def push_edge_edge(
    ends: wp.vec4i,
    found: wp.vec3,
    world: World,
    inertia: wp.array(dtype=float),
    contact_weight: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=int),
):
    """Add weights and separating displacements of an edge-edge contact; ``found``: its direction when listed."""
    i = ends[0]
    i1 = ends[1]
    j = ends[2]
    j1 = ends[3]
    p = x[i] + world.dt * v[i]
    p1 = x[i1] + world.dt * v[i1]
    q = x[j] + world.dt * v[j]
    q1 = x[j1] + world.dt * v[j1]
    st = closest_on_edges(p, p1, q, q1)
    s = st[0]
    t = st[1]
    if s <= 0.0 or s >= 1.0 or t <= 0.0 or t >= 1.0:
        return
    between = wp.lerp(q, q1, t) - wp.lerp(p, p1, s)
    normal = wp.normalize(between)
    if wp.dot(normal, found) < 0.0:
        normal = -normal
    gap = wp.dot(between, normal)
    before = wp.lerp(x[j], x[j1], t) - wp.lerp(x[i], x[i1], s)
    gap_old = wp.dot(before, normal)
    if gap - wp.max(gap_old - gap, 0.0) < world.thickness:
        add_weight(push, i, 1.0 - s)
        add_weight(push, i1, s)
        add_weight(push, j, 1.0 - t)
        add_weight(push, j1, t)
    apart = separation(gap_old, gap, world.thickness, SEPARATION_SPEED * world.dt)
    if apart <= 0.0:
        return
    inverse_mass = (
        (1.0 - s) * (1.0 - s) / inertia[i]
        + s * s / inertia[i1]
        + (1.0 - t) * (1.0 - t) / inertia[j]
        + t * t / inertia[j1]
    )
    weight_sum = wp.max(wp.max(contact_weight[i], contact_weight[i1]), wp.max(contact_weight[j], contact_weight[j1]))
    friction = friction_step(between - before, normal, apart, world.layer_friction)
    impulse = (apart * normal + friction) / (inverse_mass * weight_sum)
    add_push(push, i, ((s - 1.0) / inertia[i]) * impulse)
    add_push(push, i1, (-s / inertia[i1]) * impulse)
    add_push(push, j, ((1.0 - t) / inertia[j]) * impulse)
    add_push(push, j1, (t / inertia[j1]) * impulse)


@wp.kernel
def count_work(
    worlds: wp.array(dtype=World),
    # state in
    status: wp.array(dtype=int),
    # state in and out
    contacts: Contacts,
):
    """The contact list entries of each running world, 0 for others."""
    w = wp.tid()
    work = int(0)
    if status[w] == RUNNING:
        world = worlds[w]
        work += entries(contacts.point_count, w, world, contacts)
        work += entries(contacts.edge_count, w, world, contacts)
        work += entries(contacts.long_count, w, world, contacts)
        work += entries(contacts.crossing_count, w, world, contacts)
    contacts.own_work[w] = work


@wp.kernel
def scan_work(
    # state in
    own: wp.array(dtype=int),
    # state out
    sums: wp.array(dtype=int),
):
    """(w + 1) prefix sums, with the total in the last entry."""
    w = wp.tid()
    before = int(0)
    for other in range(w):
        before += own[other]
    sums[w] = before


@wp.kernel
def push_contacts(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    contacts: Contacts,
    threads: int,
    # state in
    status: wp.array(dtype=int),
    crossing: CrossingWatch,
    contact_weight: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    # state in and out
    time: wp.array(dtype=float),
    push: wp.array2d(dtype=int),
):
    """Add the displacements of all contacts to ``push``; the first threads also advance the worlds' time."""
    thread = wp.tid()
    for w in range(thread, worlds.shape[0], threads):
        if status[w] == RUNNING:
            time[w] = time[w] + worlds[w].dt
    for item in range(thread, contacts.work[contacts.work.shape[0] - 1], threads):
        w = world_of(item, contacts.work)
        world = worlds[w]
        at = contacts.room * world.first
        k = item - contacts.work[w]
        points = entries(contacts.point_count, w, world, contacts)
        edges = points + entries(contacts.edge_count, w, world, contacts)
        longs = edges + entries(contacts.long_count, w, world, contacts)
        if k < points:
            point = contacts.points[at + k]
            face = wp.vec3i(point[1], point[2], point[3])
            push_point_triangle(
                point[0], face, contacts.sides[at + k], world, cloth.inertia, contact_weight, x, v, push
            )
        elif k < edges:
            k = k - points
            push_edge_edge(
                contacts.edges[at + k], contacts.normals[at + k], world, cloth.inertia, contact_weight, x, v, push
            )
        elif k < longs:
            k = at + k - edges
            push_long_edge(
                contacts.long_edges[k], 3 * k, contacts.long_planes, world, cloth, contact_weight, x, v, push
            )
        elif crossing.separated[w] != 0:
            untangle_crossing(contacts.crossings[at + k - longs], world, cloth, x, push)
