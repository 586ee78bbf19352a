"""Kernels that Newton's cloth lacks for a drape: holds, and a count of moving vertices. Lengths in metres."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def hold(
    normal: wp.array(dtype=wp.vec3),
    offset: wp.array(dtype=float),
    held: wp.array(dtype=int),
    # state in and out
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
):
    """Project vertices outside their half-space ``x · normal >= offset`` onto its plane."""
    i = wp.tid()
    gap = offset[i] - wp.dot(x[i], normal[i])
    if held[0] != 0 and wp.length_sq(normal[i]) > 0.0 and gap > 0.0:
        x[i] = x[i] + gap * normal[i]
        v[i] = v[i] - wp.min(wp.dot(v[i], normal[i]), 0.0) * normal[i]


@wp.kernel
def watch(
    world: wp.array(dtype=int),
    still: float,
    x: wp.array(dtype=wp.vec3),
    # state in and out
    x_seen: wp.array(dtype=wp.vec3),
    moving: wp.array(dtype=int),
):
    """Count the vertices of each garment that have moved by more than ``still`` since the previous call."""
    i = wp.tid()
    if wp.length(x[i] - x_seen[i]) > still:
        wp.atomic_add(moving, world[i], 1)
    x_seen[i] = x[i]
