"""Bounding boxes of the faces, for the BVH."""

import warp as wp

from gcd_dataset.generator.drape.kernels.world import ClothArrays

wp.set_module_options({"enable_backward": False})


@wp.kernel
def bound_faces(
    cloth: ClothArrays,
    x: wp.array(dtype=wp.vec3),
    # out
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
):
    """The axis-aligned bounding box of every face [cm]."""
    f = wp.tid()
    a = x[cloth.faces[f][0]]
    b = x[cloth.faces[f][1]]
    c = x[cloth.faces[f][2]]
    lower[f] = wp.min(wp.min(a, b), c)
    upper[f] = wp.max(wp.max(a, b), c)
