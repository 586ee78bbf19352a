"""Copy the contact lists of a garment that continues in another batch."""

import warp as wp

from gcd_dataset.generator.drape.kernels.world import Contacts, World, entries

wp.set_module_options({"enable_backward": False})


@wp.struct
class Move:
    """A garment that moves from one batch to the next."""

    old_world: int
    new_world: int
    edge_shift: int  # new minus old index of an edge
    face_shift: int


@wp.kernel
def carry_contacts(
    old_worlds: wp.array(dtype=World),
    new_worlds: wp.array(dtype=World),
    moves: wp.array(dtype=Move),
    threads: int,
    old_contacts: Contacts,
    # state out
    new_contacts: Contacts,
):
    """Copy the contact lists with indices shifted to the new batch; the host has copied the counts."""
    m, thread = wp.tid()
    move = moves[m]
    world = old_worlds[move.old_world]
    target = new_worlds[move.new_world]
    shift = target.first - world.first
    at_old = old_contacts.room * world.first
    at_new = new_contacts.room * target.first
    for k in range(thread, entries(old_contacts.point_count, move.old_world, world, old_contacts), threads):
        new_contacts.points[at_new + k] = old_contacts.points[at_old + k] + wp.vec4i(shift, shift, shift, shift)
        new_contacts.sides[at_new + k] = old_contacts.sides[at_old + k]
    for k in range(thread, entries(old_contacts.edge_count, move.old_world, world, old_contacts), threads):
        new_contacts.edges[at_new + k] = old_contacts.edges[at_old + k] + wp.vec4i(shift, shift, shift, shift)
        new_contacts.normals[at_new + k] = old_contacts.normals[at_old + k]
    for k in range(thread, entries(old_contacts.long_count, move.old_world, world, old_contacts), threads):
        new_contacts.long_edges[at_new + k] = old_contacts.long_edges[at_old + k] + wp.vec2i(shift, shift)
    for k in range(thread, entries(old_contacts.crossing_count, move.old_world, world, old_contacts), threads):
        new_contacts.crossings[at_new + k] = old_contacts.crossings[at_old + k] + wp.vec2i(
            move.edge_shift, move.face_shift
        )
