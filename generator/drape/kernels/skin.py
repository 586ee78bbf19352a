"""The nearest point of the skin to points outside and inside it."""

import warp as wp

wp.set_module_options({"enable_backward": False})

FURTHEST = wp.constant(1.0e3)  # cm
TOUCHING = 1.0e-4  # cm: nearer to the skin the direction to it is that of the face's normal


@wp.kernel
def find_gaps(
    mesh: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    # out
    gaps: wp.array(dtype=wp.vec4),
):
    """Unit direction away from the skin, and signed distance [cm], negative inside."""
    i = wp.tid()
    near = wp.mesh_query_point_sign_normal(mesh, x[i], FURTHEST)
    away = near.sign * (x[i] - wp.mesh_eval_position(mesh, near.face, near.u, near.v))
    distance = wp.length(away)
    if distance < TOUCHING:
        away = wp.mesh_eval_face_normal(mesh, near.face)
    away = wp.normalize(away)
    gaps[i] = wp.vec4(away[0], away[1], away[2], near.sign * distance)
