"""Stretch, bending, weight and drag: one gather per vertex, and a step in time without contacts.

Stretch is a spring along every mesh edge; bending is the quadratic model of Bergou et al. (2006), a constant matrix. A
vertex reads its row of both at once: ``(spring stiffness, flat length, start length, bending weight)`` by neighbour.

Forces are taken at ``x + theta h v``, a stiffness-proportional damping that fades for slow motions; with it the
symplectic Euler step is stable for ``(omega h)² (1 + 2 theta) < 4``.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.world import RUNNING, World, sewn_share

wp.set_module_options({"enable_backward": False})

LOOK_AHEAD = 0.3


@wp.func
def elastic_force(
    i: int,
    sewn: float,
    row_start: wp.array(dtype=int),
    row_vertex: wp.array(dtype=int),
    row_weight: wp.array(dtype=wp.vec4),
    bend_diagonal: wp.array(dtype=float),
    ahead: wp.array(dtype=wp.vec3),
) -> wp.vec3:
    """Spring and bending force on vertex ``i`` [g cm/s²]."""
    x = ahead[i]
    force = -bend_diagonal[i] * x
    for entry in range(row_start[i], row_start[i + 1]):
        weight = row_weight[entry]
        y = ahead[row_vertex[entry]]
        force -= weight[3] * y
        if weight[0] > 0.0:
            edge = y - x
            length = wp.length(edge)
            rest = wp.lerp(weight[2], weight[1], sewn)
            if length > 1.0e-6:
                force += (weight[0] * (length - rest) / length) * edge
    return force


@wp.kernel
def advance(
    # model
    worlds: wp.array(dtype=World),
    vertex_world: wp.array(dtype=int),
    mass: wp.array(dtype=float),
    inertia: wp.array(dtype=float),
    row_start: wp.array(dtype=int),
    row_vertex: wp.array(dtype=int),
    row_weight: wp.array(dtype=wp.vec4),
    bend_diagonal: wp.array(dtype=float),
    # state in
    status: wp.array(dtype=int),
    time: wp.array(dtype=float),
    x_in: wp.array(dtype=wp.vec3),
    v_in: wp.array(dtype=wp.vec3),
    ahead: wp.array(dtype=wp.vec3),
    # state out
    x_out: wp.array(dtype=wp.vec3),
    v_out: wp.array(dtype=wp.vec3),
):
    """One step of symplectic Euler for every vertex, contacts left for later kernels."""
    i = wp.tid()
    w = vertex_world[i]
    if status[w] != RUNNING:
        return
    world = worlds[w]
    sewn = sewn_share(world, time[w])
    force = elastic_force(i, sewn, row_start, row_vertex, row_weight, bend_diagonal, ahead)
    drag = world.sewing_damping
    if time[w] >= world.sewing_time:
        force += wp.vec3(0.0, -mass[i] * world.gravity, 0.0)
        drag = world.damping
    v = (v_in[i] + (world.dt / inertia[i]) * force) * wp.exp(-drag * world.dt)
    speed = wp.length(v)
    if speed > world.max_speed:
        v = v * (world.max_speed / speed)
    x_out[i] = x_in[i] + world.dt * v
    v_out[i] = v
