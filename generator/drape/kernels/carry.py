"""The watched contacts of a garment that goes on in another batch."""

import warp as wp

from gcd_dataset.generator.drape.kernels.world import Contacts, World, entries

wp.set_module_options({"enable_backward": False})


@wp.struct
class Move:
    """A garment's place in the batch it leaves and in the one it joins."""

    leaves: int  # world
    joins: int
    edges: int  # what is added to the number of an edge
    faces: int


@wp.kernel
def carry_contacts(
    old_worlds: wp.array(dtype=World),
    new_worlds: wp.array(dtype=World),
    moves: wp.array(dtype=Move),
    threads: int,
    left: Contacts,
    # state out
    joined: Contacts,
):
    """Copy the lists, in which vertices, edges and faces get their new numbers; counts are copied already."""
    m, thread = wp.tid()
    move = moves[m]
    world = old_worlds[move.leaves]
    target = new_worlds[move.joins]
    shift = target.first - world.first
    start = left.room * world.first
    end = joined.room * target.first
    for k in range(thread, entries(left.point_count, move.leaves, world, left), threads):
        joined.points[end + k] = left.points[start + k] + wp.vec4i(shift, shift, shift, shift)
        joined.sides[end + k] = left.sides[start + k]
    for k in range(thread, entries(left.edge_count, move.leaves, world, left), threads):
        joined.edges[end + k] = left.edges[start + k] + wp.vec4i(shift, shift, shift, shift)
        joined.normals[end + k] = left.normals[start + k]
    for k in range(thread, entries(left.long_count, move.leaves, world, left), threads):
        joined.long_edges[end + k] = left.long_edges[start + k] + wp.vec2i(shift, shift)
    for k in range(thread, entries(left.crossing_count, move.leaves, world, left), threads):
        joined.crossings[end + k] = left.crossings[start + k] + wp.vec2i(move.edges, move.faces)
