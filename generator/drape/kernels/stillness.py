"""The end of a frame: detect garments at rest, slid off, fallen or diverged; and the stretch of every edge."""

import warp as wp

from gcd_dataset.generator.drape.kernels.push import HEIGHT_SCALE
from gcd_dataset.generator.drape.kernels.world import (
    DIVERGED,
    DONE,
    RUNNING,
    STOPPED,
    ClothArrays,
    CrossingWatch,
    FrameCounts,
    World,
)

wp.set_module_options({"enable_backward": False})

CROSSINGS_EVERY = 2  # frames between two searches for crossings of a garment without any
PATIENCE = 40  # frames without a new minimum of crossings after which untangling stops


@wp.func
def still_limit(world: World, frame: int) -> float:
    """Motion in a frame below which a vertex is at rest [cm]; rises linearly over the second half of the frames."""
    late = wp.max(2.0 * float(frame) / float(world.max_frames) - 1.0, 0.0)
    return wp.lerp(world.still, world.calm, late)


@wp.kernel
def watch_frame(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    threads: int,
    # state in
    frames: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state in and out
    status: wp.array(dtype=int),
    x_seen: wp.array(dtype=wp.vec3),
    # state out
    counts: FrameCounts,
):
    """Count moving vertices, fast vertices and vertices above the floor; sum the keepers' heights."""
    w, thread = wp.tid()
    if status[w] != RUNNING:
        return
    world = worlds[w]
    limit = still_limit(world, frames[w] + 1)
    count = int(0)
    fast = int(0)
    height = int(0)
    above = int(0)
    for i in range(world.first + thread, world.first + world.size, threads):
        moved = wp.length(x[i] - x_seen[i])
        if not wp.isfinite(moved):
            status[w] = DIVERGED
        if moved > limit:
            count += 1
        if moved > world.calm:
            fast += 1
        if cloth.keeper[i] != wp.uint8(0):
            height += int(wp.clamp(x[i][1], -1000.0, 1000.0) * HEIGHT_SCALE)
        if x[i][1] > world.floor:
            above += 1
        x_seen[i] = x[i]
    if count > 0:
        wp.atomic_add(counts.moving, w, count)
    if fast > 0:
        wp.atomic_add(counts.fast, w, fast)
    if height != 0:
        wp.atomic_add(counts.keeper_height, w, height)
    if above > 0:
        wp.atomic_add(counts.above_floor, w, above)


@wp.kernel
def end_frame(
    # model
    worlds: wp.array(dtype=World),
    # state in
    time: wp.array(dtype=float),
    # state in and out
    status: wp.array(dtype=int),
    frames: wp.array(dtype=int),
    held: wp.array(dtype=int),
    loose_after: wp.array(dtype=float),
    overfull: wp.array(dtype=int),
    crossing_count: wp.array(dtype=int),
    counts: FrameCounts,
    crossing: CrossingWatch,
):
    """Update the status of each world, end holds, and plan the next search for crossings.

    A hold ends when the garment has fallen into place. The next frame searches for crossings if the garment has moved;
    without crossings, only every second frame. Untangling stops when the number of crossings stops falling, so that the
    garment can come to rest.
    """
    w = wp.tid()
    if status[w] == RUNNING:
        world = worlds[w]
        frames[w] = frames[w] + 1
        if held[w] != 0 and time[w] >= world.sewing_time + world.held_time:
            if float(counts.fast[w]) <= world.falling or time[w] >= world.sewing_time + world.longest_hold:
                held[w] = 0
                loose_after[w] = time[w] + 1.5 * world.frame
        if held[w] == 0 and time[w] > loose_after[w]:
            if float(counts.moving[w]) <= world.restless:
                status[w] = DONE
            if (
                status[w] == RUNNING
                and world.keepers > 0
                and float(counts.keeper_height[w]) / HEIGHT_SCALE < world.lowest * float(world.keepers)
            ):
                status[w] = STOPPED
        if counts.above_floor[w] == 0 and time[w] >= world.sewing_time + world.held_time and status[w] == RUNNING:
            status[w] = STOPPED
        if status[w] == RUNNING and (frames[w] >= world.max_frames or overfull[w] != 0):
            status[w] = STOPPED
    counts.moving[w] = 0
    counts.fast[w] = 0
    counts.keeper_height[w] = 0
    counts.above_floor[w] = 0
    fewer = crossing_count[w] < crossing.least[w] or crossing_count[w] == 0
    if crossing.searched[w] != 0 and (fewer or held[w] != 0):
        crossing.least[w] = crossing_count[w]
        crossing.least_at[w] = frames[w]
    crossing.separated[w] = int(frames[w] - crossing.least_at[w] <= PATIENCE)
    crossing.searched[w] = 0
    if status[w] == RUNNING:
        if crossing.due[w] != 0 and (crossing_count[w] > 0 or frames[w] % CROSSINGS_EVERY == 0):
            crossing.searched[w] = 1
            crossing.due[w] = 0
            crossing_count[w] = 0
            crossing.any_searched[0] = 1


@wp.kernel
def stretch_edges(
    cloth: ClothArrays,
    spring: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    # out
    ratio: wp.array(dtype=float),
):
    """Length over flat length of every edge."""
    e = wp.tid()
    ratio[e] = wp.length(x[cloth.edges[e][1]] - x[cloth.edges[e][0]]) / spring[e][1]
