"""Interpolate a coarse drape to the fine mesh that continues from it."""

import warp as wp

from gcd_dataset.generator.drape.kernels.elastic import LOOK_AHEAD
from gcd_dataset.generator.drape.kernels.world import World

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
