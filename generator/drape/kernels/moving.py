"""A skin that moves: the start of the motion, and the start of each of its frames."""

import warp as wp

from gcd_dataset.generator.drape.kernels.place import NOT_COUNTED
from gcd_dataset.generator.drape.kernels.world import RUNNING, ClothArrays, CrossingWatch, SearchState

wp.set_module_options({"enable_backward": False})


@wp.kernel
def begin_motion(
    w: int,
    first: int,
    rest_from: float,
    # state out
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    ahead: wp.array(dtype=wp.vec3),
    ahead_next: wp.array(dtype=wp.vec3),
    x_seen: wp.array(dtype=wp.vec3),
    time: wp.array(dtype=float),
    status: wp.array(dtype=int),
    frames: wp.array(dtype=int),
    held: wp.array(dtype=int),
    loose_after: wp.array(dtype=float),
    crossing: CrossingWatch,
):
    """Let a garment at rest run again, from its positions: released, and at rest again after ``rest_from`` seconds."""
    k = wp.tid()
    i = first + k
    v[i] = wp.vec3(0.0)
    ahead[i] = x[i]
    ahead_next[i] = x[i]
    x_seen[i] = x[i]
    if k == 0:
        status[w] = RUNNING
        frames[w] = 0
        held[w] = 0
        loose_after[w] = time[w] + rest_from
        crossing.due[w] = 0
        crossing.searched[w] = 1
        crossing.least[w] = NOT_COUNTED
        crossing.least_at[w] = 0
        crossing.separated[w] = 1
        crossing.any_searched[0] = 1


@wp.kernel
def begin_frame(
    w: int,
    # state out
    cloth: ClothArrays,
    search: SearchState,
):
    """The skin of a world is where its mesh is; contacts are searched."""
    cloth.skin_lag[w] = 0.0
    search.moved_far[w] = 1
