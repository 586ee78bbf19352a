"""Sides of contacts: detect pairs that have passed through each other, and keep their old sides.

A pair is listed with its side before it touches. If it is on the other side at the next search, and the point's
projection lies within the triangle both times, the pair has passed through: a path round the rim takes longer than the
time between two searches. Until the pair is back on its old side, its vertices get no new contacts with each other and
keep the old ones.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.geometry import closest_on_edges, closest_on_triangle
from gcd_dataset.generator.drape.kernels.world import RUNNING, Contacts, World, entries, take_slot, world_of

wp.set_module_options({"enable_backward": False})


@wp.func
def height_over(point: wp.vec4i, x: wp.array(dtype=wp.vec3)) -> float:
    """Signed height over a triangle times its double area; 0 if the vertex projects outside the triangle."""
    a = x[point[1]]
    b = x[point[2]]
    c = x[point[3]]
    weights = closest_on_triangle(x[point[0]], a, b, c)
    if wp.min(weights[0], wp.min(weights[1], weights[2])) <= 0.0:
        return 0.0
    return wp.dot(x[point[0]] - a, wp.cross(b - a, c - a))


@wp.func
def gap_between(ends: wp.vec4i, x: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Vector between the nearest points of two edges; zero if one of these points is an end."""
    p = x[ends[0]]
    p1 = x[ends[1]]
    q = x[ends[2]]
    q1 = x[ends[3]]
    st = closest_on_edges(p, p1, q, q1)
    if wp.min(st[0], st[1]) <= 0.0 or wp.max(st[0], st[1]) >= 1.0:
        return wp.vec3(0.0)
    return wp.lerp(q, q1, st[1]) - wp.lerp(p, p1, st[0])


@wp.func
def mark(vertices: wp.vec4i, flags: wp.array(dtype=int)):
    for k in range(4):
        flags[vertices[k]] = 1


@wp.kernel
def mark_passed(
    # model
    worlds: wp.array(dtype=World),
    contacts: Contacts,
    threads: int,
    # state in
    status: wp.array(dtype=int),
    searching: wp.array(dtype=int),
    x_searched: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    # state out
    passed: wp.array(dtype=int),
):
    """Mark the vertices of contacts that are no longer on the listed side."""
    for item in range(wp.tid(), contacts.work[contacts.work.shape[0] - 1], threads):
        w = world_of(item, contacts.work)
        if searching[w] == 0 or status[w] != RUNNING:
            continue
        at = contacts.room * worlds[w].first
        k = item - contacts.work[w]
        points = entries(contacts.point_count, w, worlds[w], contacts)
        if k < points:
            point = contacts.points[at + k]
            if contacts.sides[at + k] * height_over(point, x) < 0.0 and height_over(point, x_searched) != 0.0:
                mark(point, passed)
        elif k < points + entries(contacts.edge_count, w, worlds[w], contacts):
            ends = contacts.edges[at + k - points]
            if wp.dot(contacts.normals[at + k - points], gap_between(ends, x)) < 0.0:
                if wp.length_sq(gap_between(ends, x_searched)) > 0.0:
                    mark(ends, passed)


@wp.func
def point_passed(point: wp.vec4i, passed: wp.array(dtype=int)) -> bool:
    """Whether the vertex and a vertex of the triangle are marked as passed."""
    return passed[point[0]] != 0 and passed[point[1]] + passed[point[2]] + passed[point[3]] != 0


@wp.func
def edges_passed(ends: wp.vec4i, passed: wp.array(dtype=int)) -> bool:
    """Whether both edges have a vertex marked as passed."""
    return passed[ends[0]] + passed[ends[1]] != 0 and passed[ends[2]] + passed[ends[3]] != 0


@wp.kernel
def keep_sides(
    # model
    worlds: wp.array(dtype=World),
    threads: int,
    # state in
    status: wp.array(dtype=int),
    searching: wp.array(dtype=int),
    passed: wp.array(dtype=int),
    # state in and out
    contacts: Contacts,
):
    """Copy the contacts between passed vertices to the ``kept`` lists, before the contact lists are cleared.

    The ``kept`` lists cannot overflow: they have the capacity of the contact lists.
    """
    for item in range(wp.tid(), contacts.work[contacts.work.shape[0] - 1], threads):
        w = world_of(item, contacts.work)
        if searching[w] == 0 or status[w] != RUNNING:
            continue
        world = worlds[w]
        at = contacts.room * world.first
        k = item - contacts.work[w]
        points = entries(contacts.point_count, w, world, contacts)
        if k < points:
            if point_passed(contacts.points[at + k], passed):
                slot = take_slot(contacts.kept_point_count, w, world, contacts)
                contacts.kept_points[slot] = contacts.points[at + k]
                contacts.kept_sides[slot] = contacts.sides[at + k]
        elif k < points + entries(contacts.edge_count, w, world, contacts):
            k = k - points
            if edges_passed(contacts.edges[at + k], passed):
                slot = take_slot(contacts.kept_edge_count, w, world, contacts)
                contacts.kept_edges[slot] = contacts.edges[at + k]
                contacts.kept_normals[slot] = contacts.normals[at + k]


@wp.kernel
def clear_lists(
    searching: wp.array(dtype=int),
    # state out
    contacts: Contacts,
):
    """Clear the contact lists of the searching worlds."""
    w = wp.tid()
    if searching[w] != 0:
        contacts.near_count[w] = 0
        contacts.point_count[w] = 0
        contacts.edge_count[w] = 0
        contacts.long_count[w] = 0


@wp.kernel
def restore_kept(
    # model
    worlds: wp.array(dtype=World),
    threads: int,
    # state in
    searching: wp.array(dtype=int),
    # state in and out
    listed: wp.array(dtype=int),
    contacts: Contacts,
):
    """Append the ``kept`` contacts to the new contact lists."""
    w, thread = wp.tid()
    if searching[w] == 0:
        return
    world = worlds[w]
    at = contacts.room * world.first
    for k in range(thread, entries(contacts.kept_point_count, w, world, contacts), threads):
        slot = take_slot(contacts.point_count, w, world, contacts)
        if slot >= 0:
            contacts.points[slot] = contacts.kept_points[at + k]
            contacts.sides[slot] = contacts.kept_sides[at + k]
            mark(contacts.kept_points[at + k], listed)
    for k in range(thread, entries(contacts.kept_edge_count, w, world, contacts), threads):
        slot = take_slot(contacts.edge_count, w, world, contacts)
        if slot >= 0:
            contacts.edges[slot] = contacts.kept_edges[at + k]
            contacts.normals[slot] = contacts.kept_normals[at + k]
            mark(contacts.kept_edges[at + k], listed)
