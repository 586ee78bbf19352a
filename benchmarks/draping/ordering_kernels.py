"""Kernels of ``benchmarks.draping.ordering``: the additions of contact displacements alone."""

import warp as wp

from gcd_dataset.generator.drape.kernels.push import add_push, add_weight
from gcd_dataset.generator.drape.kernels.world import Contacts, World, entries, world_of

wp.set_module_options({"enable_backward": False})


@wp.kernel
def add_in_fixed_point(
    worlds: wp.array(dtype=World),
    contacts: Contacts,
    threads: int,
    x: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=int),
):
    for item in range(wp.tid(), contacts.work[contacts.work.shape[0] - 1], threads):
        w = world_of(item, contacts.work)
        k = item - contacts.work[w]
        points = entries(contacts.point_count, w, worlds[w], contacts)
        if k < points + entries(contacts.edge_count, w, worlds[w], contacts):
            at = contacts.room * worlds[w].first
            ends = contacts.points[at + k] if k < points else contacts.edges[at + k - points]
            for end in range(4):
                add_weight(push, ends[end], 0.25)
                add_push(push, ends[end], 1.0e-6 * x[ends[end]])


@wp.kernel
def add_in_floating_point(
    worlds: wp.array(dtype=World),
    contacts: Contacts,
    threads: int,
    x: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=float),
):
    for item in range(wp.tid(), contacts.work[contacts.work.shape[0] - 1], threads):
        w = world_of(item, contacts.work)
        k = item - contacts.work[w]
        points = entries(contacts.point_count, w, worlds[w], contacts)
        if k < points + entries(contacts.edge_count, w, worlds[w], contacts):
            at = contacts.room * worlds[w].first
            ends = contacts.points[at + k] if k < points else contacts.edges[at + k - points]
            for end in range(4):
                wp.atomic_add(push, ends[end], 3, 0.25)
                for axis in range(3):
                    wp.atomic_add(push, ends[end], axis, 1.0e-6 * x[ends[end]][axis])
