"""What a kernel must know of the world, the garment and the body, that a vertex belongs to."""

import warp as wp

wp.set_module_options({"enable_backward": False})

RUNNING = 0
DONE = 1
DIVERGED = 2


@wp.struct
class World:
    """One garment on one body."""

    dt: float  # s
    damping: float  # 1/s
    sewing_damping: float  # 1/s
    sewing_time: float  # s
    held_time: float  # s, after sewing
    gravity: float  # cm/s²
    max_speed: float  # cm/s
    friction: float
    thickness: float  # cm, between layers
    body_gap: float  # cm, from the skin
    field_offset: wp.int64  # first voxel of the body's distance field
    field_size: wp.vec3i  # voxels along x, y, z
    field_origin: wp.vec3  # cm, centre of the first voxel
    field_cell: float  # cm


@wp.func
def sewn_share(world: World, time: float) -> float:
    """How far the seams are closed, 0 to 1; smooth at both ends."""
    s = wp.clamp(time / world.sewing_time, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


@wp.kernel
def tick(
    # model
    worlds: wp.array(dtype=World),
    # state in
    status: wp.array(dtype=int),
    # state out
    time: wp.array(dtype=float),
):
    """Advance the clock of every world that still runs."""
    world = wp.tid()
    if status[world] == RUNNING:
        time[world] = time[world] + worlds[world].dt
