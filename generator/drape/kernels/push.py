"""Sums of contact displacements at each vertex, in fixed point.

The order of integer additions does not change their sum, so the sum is the same on every run and in any batch. The sum
of floating-point atomics depends on the order.

Several contacts of a vertex must share its displacement. So every contact adds its weight to its vertices one substep
ahead, and divides its impulse by the largest weight sum among its vertices. Both elements of a pair get the same
impulse.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

PUSH_SCALE = 16777216.0  # 2**24 units in a centimetre: resolution 6e-8 cm, overflow at 128 cm
WEIGHT_SCALE = 65536.0  # units in a contact weight of 1
HEIGHT_SCALE = 256.0  # units in a centimetre of height


@wp.func
def add_weight(push: wp.array2d(dtype=int), i: int, weight: float):
    """Add a contact's weight at vertex ``i``, for the next substep."""
    wp.atomic_add(push, i, 3, int(wp.round(weight * WEIGHT_SCALE)))


@wp.func
def take_contact_weight(push: wp.array2d(dtype=int), i: int) -> float:
    """The sum of weights at vertex ``i``, at least 1; resets the sum."""
    total = float(push[i, 3]) / WEIGHT_SCALE
    push[i, 3] = 0
    return wp.max(total, 1.0)


@wp.func
def add_push(push: wp.array2d(dtype=int), i: int, displacement: wp.vec3):
    """Add a displacement to vertex ``i`` [cm]."""
    wp.atomic_add(push, i, 0, int(wp.round(displacement[0] * PUSH_SCALE)))
    wp.atomic_add(push, i, 1, int(wp.round(displacement[1] * PUSH_SCALE)))
    wp.atomic_add(push, i, 2, int(wp.round(displacement[2] * PUSH_SCALE)))


@wp.func
def add_pressure(push: wp.array2d(dtype=int), i: int, displacement: float):
    """Add to the displacement of vertex ``i`` off the skin by long edges, the measure of their friction [cm]."""
    wp.atomic_add(push, i, 4, int(wp.round(displacement * PUSH_SCALE)))


@wp.func
def take_pressure(push: wp.array2d(dtype=int), i: int) -> float:
    """The sum of displacements of vertex ``i`` off the skin by long edges [cm]; resets the sum."""
    total = float(push[i, 4]) / PUSH_SCALE
    push[i, 4] = 0
    return total


@wp.func
def take_push(push: wp.array2d(dtype=int), i: int) -> wp.vec3:
    """The sum of displacements of vertex ``i`` [cm]; resets the sum."""
    total = wp.vec3(float(push[i, 0]), float(push[i, 1]), float(push[i, 2])) / PUSH_SCALE
    push[i, 0] = 0
    push[i, 1] = 0
    push[i, 2] = 0
    return total
