"""Displacements that many contacts ask of one vertex, added up as whole numbers.

Integer addition does not depend on its order, so the sum is the same on every run and device, whatever else is in the
batch; floating-point atomics would not be.

A vertex in several contacts must not be pushed by all of them in full. So a contact adds its weight to its vertices in
the step before it is expected, and what it pushes is divided by the largest sum of weights among them. Both parts of a
pair still get the same impulse.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

PUSH_SCALE = 16777216.0  # 2**24 units in a centimetre: a quantum of 6e-8 cm, overflow at 128 cm
WEIGHT_SCALE = 65536.0
HEIGHT_SCALE = 256.0


@wp.func
def add_weight(push: wp.array2d(dtype=int), i: int, weight: float):
    """Announce a contact that moves vertex ``i`` by ``weight`` times its depth."""
    wp.atomic_add(push, i, 3, int(wp.round(weight * WEIGHT_SCALE)))


@wp.func
def take_contact_weight(push: wp.array2d(dtype=int), i: int) -> float:
    """The weights announced at vertex ``i``, at least 1; cleared for the next step."""
    announced = float(push[i, 3]) / WEIGHT_SCALE
    push[i, 3] = 0
    return wp.max(announced, 1.0)


@wp.func
def add_push(push: wp.array2d(dtype=int), i: int, displacement: wp.vec3):
    """Ask vertex ``i`` to move by ``displacement`` [cm]."""
    wp.atomic_add(push, i, 0, int(wp.round(displacement[0] * PUSH_SCALE)))
    wp.atomic_add(push, i, 1, int(wp.round(displacement[1] * PUSH_SCALE)))
    wp.atomic_add(push, i, 2, int(wp.round(displacement[2] * PUSH_SCALE)))


@wp.func
def take_push(push: wp.array2d(dtype=int), i: int) -> wp.vec3:
    """What vertex ``i`` was asked for in all [cm]; cleared for the next step."""
    total = wp.vec3(float(push[i, 0]), float(push[i, 1]), float(push[i, 2])) / PUSH_SCALE
    push[i, 0] = 0
    push[i, 1] = 0
    push[i, 2] = 0
    return total
