"""Which garments hang still: how many vertices moved too far since the last look."""

import warp as wp

from gcd_dataset.generator.drape.kernels.world import DIVERGED, RUNNING, World

wp.set_module_options({"enable_backward": False})


@wp.kernel
def count_moving(
    # model
    worlds: wp.array(dtype=World),
    vertex_world: wp.array(dtype=int),
    still_speed: float,
    substeps: int,
    # state in and out
    status: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    x_seen: wp.array(dtype=wp.vec3),
    # out
    moving: wp.array(dtype=int),
):
    """Count the vertices faster than ``still_speed`` over the last frame; mark worlds that have diverged."""
    i = wp.tid()
    w = vertex_world[i]
    if status[w] != RUNNING:
        return
    moved = wp.length(x[i] - x_seen[i])
    if not wp.isfinite(moved):
        status[w] = DIVERGED
        return
    if moved > still_speed * worlds[w].dt * float(substeps):
        wp.atomic_add(moving, w, 1)
    x_seen[i] = x[i]
