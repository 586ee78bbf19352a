"""A substep of every vertex: symplectic Euler, then displacements by contacts, holds and the body."""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import keep_off_body, skin_friction
from gcd_dataset.generator.drape.kernels.elastic import LOOK_AHEAD, Rows, elastic_force
from gcd_dataset.generator.drape.kernels.push import take_contact_weight, take_pressure, take_push
from gcd_dataset.generator.drape.kernels.world import RUNNING, ClothArrays, SearchState, World, sewn_share

wp.set_module_options({"enable_backward": False})

HOLDING_SPEED = 60.0  # cm/s, speed limit of a held edge that returns to its half-space


@wp.func
def accelerate(i: int, world: World, time: float, cloth: ClothArrays, v: wp.vec3, elastic: wp.vec3) -> wp.vec3:
    """Velocity after a substep under elastic forces, weight and drag [cm/s].

    Where forces decelerate a vertex the drag is larger: swinging and ringing end in a cycle or two, and free fall is
    not delayed.
    """
    force = elastic
    drag = world.sewing_damping
    if time >= world.weight_from:
        force += wp.vec3(0.0, -cloth.mass[i] * world.gravity, 0.0)
    if time >= world.sewing_time:
        drag = world.damping
    if wp.dot(v, force) < 0.0:
        drag = wp.max(drag, world.braking)
    return limit_speed((v + (world.dt / cloth.inertia[i]) * force) * wp.exp(-drag * world.dt), world.max_speed)


@wp.func
def limit_speed(v: wp.vec3, limit: float) -> wp.vec3:
    speed = wp.length(v)
    if speed > limit:
        return v * (limit / speed)
    return v


@wp.func
def hold(i: int, here: wp.vec3, before: wp.vec3, world: World, cloth: ClothArrays) -> wp.vec3:
    """Displacement of a held vertex toward its half-space [cm]."""
    normal = cloth.hold_normal[i]
    depth = cloth.hold_offset[i] - wp.dot(here, normal)
    if depth <= 0.0 or wp.length_sq(normal) == 0.0:
        return wp.vec3(0.0)
    approach = wp.max(-wp.dot(here - before, normal), 0.0)
    return wp.min(depth, approach + HOLDING_SPEED * world.dt) * normal


# H200, 894 000 vertices: 123 µs; with Warp's defaults, which take 80 registers a thread, 147 µs.
@wp.kernel(grid_stride=False, launch_bounds=(256, 4))
def step(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    rows: Rows,
    before_search: bool,
    # state in
    status: wp.array(dtype=int),
    time: wp.array(dtype=float),
    held: wp.array(dtype=int),
    ahead_in: wp.array(dtype=wp.vec3),
    # state in and out
    search: SearchState,
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=int),
    # state out
    ahead_out: wp.array(dtype=wp.vec3),
    contact_weight: wp.array(dtype=float),
):
    """Integrate every vertex, then apply its contacts, hold and body contact; mark worlds that need a search."""
    i = wp.tid()
    w = cloth.vertex_world[i]
    if status[w] != RUNNING:
        return
    world = worlds[w]
    before = x[i]
    elastic = elastic_force(i, sewn_share(world, time[w]), rows, ahead_in)
    along = wp.vec3(0.0)
    if world.skin != wp.uint64(0):  # drag on, and limit of, the motion relative to the skin: it is no air
        along = cloth.skin_velocity[i]
    velocity = along + accelerate(i, world, time[w], cloth, v[i] - along, elastic)
    moved = wp.vec3(0.0)
    pressure = float(0.0)
    if search.listed[i] != 0:
        moved = take_push(push, i)
        pressure = take_pressure(push, i)
        contact_weight[i] = take_contact_weight(push, i)
    here = before + world.dt * velocity
    if held[w] != 0:
        moved += hold(i, here + moved, before, world, cloth)
    skin = search.skin[i]
    carried = wp.vec3(0.0)
    if world.skin != wp.uint64(0):  # the plane that stands for the skin moves with it
        carried = world.dt * along
        skin[3] -= carried[0] * skin[0] + carried[1] * skin[1] + carried[2] * skin[2]
        search.skin[i] = skin
        if i == world.first:
            cloth.skin_lag[w] = cloth.skin_lag[w] + world.dt
        if before_search and wp.length_sq(carried) > 0.0:
            search.moved_far[w] = 1
    if skin[3] < world.clear:
        friction = skin_friction(world, held[w], cloth.keeper[i] != wp.uint8(0))
        moved += keep_off_body(here + moved, before + carried, pressure, friction, world, skin, search.x[i])
    here += moved
    velocity = along + limit_speed(velocity + moved / world.dt - along, world.max_speed)
    x[i] = here
    v[i] = velocity
    ahead_out[i] = here + (LOOK_AHEAD * world.dt) * velocity
    if before_search and wp.length_sq(here - search.x[i]) > world.travel * world.travel:
        search.moved_far[w] = 1
