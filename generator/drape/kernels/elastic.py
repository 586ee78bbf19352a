"""Stretch, bending, weight and drag: one gather per vertex, and a step in time without contacts.

Stretch is a spring along every mesh edge; bending is the quadratic model of Bergou et al. (2006), a constant matrix. A
vertex walks its springs and then the vertices that only its
bending depends on; entry ``k`` of all vertices lies together, so that neighbouring threads read neighbouring words.

Forces are taken at ``x + theta h v``, a stiffness-proportional damping that fades for slow motions; with it the
symplectic Euler step is stable for ``(omega h)² (1 + 2 theta) < 4``.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.world import RUNNING, Cloth, World, sewn_share

wp.set_module_options({"enable_backward": False})

LOOK_AHEAD = 0.3
USUAL = wp.constant(6)  # neighbours of a vertex in a regular mesh


@wp.struct
class Rows:
    """The elastic forces on each vertex as rows: ``[k, vertex]``."""

    count: wp.array(dtype=wp.vec2i)  # springs, further bending weights
    spring_vertex: wp.array2d(dtype=int)
    spring_stiffness: wp.array2d(dtype=float)  # g/s²
    flat_length: wp.array2d(dtype=float)  # cm
    start_length: wp.array2d(dtype=float)  # cm, before sewing
    spring_bend: wp.array2d(dtype=float)  # g/s²
    bend_vertex: wp.array2d(dtype=int)
    bend_weight: wp.array2d(dtype=float)
    bend_diagonal: wp.array(dtype=float)


@wp.func
def spring_force(k: int, i: int, sewn: float, x: wp.vec3, rows: Rows, ahead: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Of one neighbour: along the edge by its stretch, and by its bending weight."""
    y = ahead[rows.spring_vertex[k, i]]
    rest = rows.flat_length[k, i]
    if sewn < 1.0:
        rest = wp.lerp(rows.start_length[k, i], rest, sewn)
    edge = y - x
    length = wp.length(edge)
    return (rows.spring_stiffness[k, i] * (length - rest) / wp.max(length, 1.0e-6)) * edge - rows.spring_bend[k, i] * y


@wp.func
def elastic_force(i: int, sewn: float, rows: Rows, ahead: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Spring and bending force on vertex ``i`` [g cm/s²].

    The first ``USUAL`` entries are there for every vertex, if need be with no weight: so they are read side by side.
    """
    x = ahead[i]
    force = -rows.bend_diagonal[i] * x
    for k in range(USUAL):
        force += spring_force(k, i, sewn, x, rows, ahead)
    for k in range(USUAL):
        force -= rows.bend_weight[k, i] * ahead[rows.bend_vertex[k, i]]
    count = rows.count[i]
    for k in range(USUAL, count[0]):
        force += spring_force(k, i, sewn, x, rows, ahead)
    for k in range(USUAL, count[1]):
        force -= rows.bend_weight[k, i] * ahead[rows.bend_vertex[k, i]]
    return force


@wp.kernel
def advance(
    # model
    worlds: wp.array(dtype=World),
    cloth: Cloth,
    rows: Rows,
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
    w = cloth.vertex_world[i]
    if status[w] != RUNNING:
        return
    world = worlds[w]
    sewn = sewn_share(world, time[w])
    force = elastic_force(i, sewn, rows, ahead)
    drag = world.sewing_damping
    if time[w] >= world.sewing_time:
        force += wp.vec3(0.0, -cloth.mass[i] * world.gravity, 0.0)
        drag = world.damping
    v = (v_in[i] + (world.dt / cloth.inertia[i]) * force) * wp.exp(-drag * world.dt)
    speed = wp.length(v)
    if speed > world.max_speed:
        v = v * (world.max_speed / speed)
    x_out[i] = x_in[i] + world.dt * v
    v_out[i] = v
