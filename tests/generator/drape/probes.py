"""Test kernels: each calls one device function for every element."""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import is_over_same_skin
from gcd_dataset.generator.drape.kernels.elastic import Rows, elastic_force
from gcd_dataset.generator.drape.kernels.geometry import closest_on_triangle, segment_crosses

wp.set_module_options({"enable_backward": False})


@wp.kernel
def nearest_kernel(points: wp.array2d(dtype=wp.vec3), weights: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    weights[i] = closest_on_triangle(points[i, 0], points[i, 1], points[i, 2], points[i, 3])


@wp.kernel
def elastic_kernel(rows: Rows, sewn: float, x: wp.array(dtype=wp.vec3), force: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    force[i] = elastic_force(i, sewn, rows, x)


@wp.kernel
def crossing_kernel(points: wp.array2d(dtype=wp.vec3), crosses: wp.array(dtype=wp.bool)):
    i = wp.tid()
    crosses[i] = segment_crosses(points[i, 0], points[i, 1], points[i, 2], points[i, 3], points[i, 4])


@wp.kernel
def same_skin_kernel(
    x: wp.array(dtype=wp.vec3),
    velocity: wp.vec3,
    asked: wp.array(dtype=wp.vec4),
    lag: float,
    kept: wp.array(dtype=wp.bool),
):
    i = wp.tid()
    kept[i] = is_over_same_skin(x[i], velocity, asked[i], lag, 0.0125)
