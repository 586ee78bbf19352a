"""Copy the contact lists of a garment that continues in another batch."""

import warp as wp

from gcd_dataset.generator.drape.kernels.elastic import LOOK_AHEAD
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


wp.set_module_options({"enable_backward": False})


@wp.kernel
def refine(
    # model
    worlds: wp.array(dtype=World),
    vertex_world: wp.array(dtype=int),
    corners: wp.array(dtype=wp.vec3i),
    weights: wp.array(dtype=wp.vec3),
    # coarse state in
    x_coarse: wp.array(dtype=wp.vec3),
    v_coarse: wp.array(dtype=wp.vec3),
    # state out
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    ahead: wp.array(dtype=wp.vec3),
    x_seen: wp.array(dtype=wp.vec3),
    x_searched: wp.array(dtype=wp.vec3),
):
    """Interpolate each vertex between three coarse vertices; vertices with zero weights keep their state."""
    i = wp.tid()
    weight = weights[i]
    if weight[0] + weight[1] + weight[2] == 0.0:
        return
    corner = corners[i]
    here = weight[0] * x_coarse[corner[0]] + weight[1] * x_coarse[corner[1]] + weight[2] * x_coarse[corner[2]]
    velocity = weight[0] * v_coarse[corner[0]] + weight[1] * v_coarse[corner[1]] + weight[2] * v_coarse[corner[2]]
    x[i] = here
    x_seen[i] = here
    x_searched[i] = here
    v[i] = velocity
    ahead[i] = here + (LOOK_AHEAD * worlds[vertex_world[i]].dt) * velocity
