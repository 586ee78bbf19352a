"""Fill a body's signed-distance field, and the part of the body nearest to every voxel."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def fill_field(
    mesh: wp.uint64,
    face_parts: wp.array(dtype=wp.uint8),
    origin: wp.vec3,
    cell: float,
    band: float,
    patched_above: float,
    # out
    distance: wp.array3d(dtype=float),
    part: wp.array3d(dtype=wp.uint8),
):
    """Signed distance [cm] of every voxel's centre: exact inside and up to ``band`` outside, ``band`` beyond.

    Above ``patched_above`` openings of the skin were closed.
    """
    i, j, k = wp.tid()
    p = origin + cell * wp.vec3(float(i), float(j), float(k))
    near = wp.mesh_query_point_sign_normal(mesh, p, band)
    sign = near.sign
    if near.result and p[1] > patched_above:
        # Behind lips, where patched skin folds back on itself, normals tell the wrong side; winding numbers cost more.
        winding = wp.mesh_query_point_sign_winding_number(mesh, p, band)
        sign = winding.sign
    if not near.result:
        upwards = wp.mesh_query_ray(mesh, p, wp.vec3(0.0, 1.0, 0.0), 1.0e4)
        if not upwards.result or wp.dot(upwards.normal, wp.vec3(0.0, 1.0, 0.0)) < 0.0:
            distance[i, j, k] = band
            return
        near = wp.mesh_query_point_no_sign(mesh, p, 1.0e3)
        sign = -1.0
    skin = wp.mesh_eval_position(mesh, near.face, near.u, near.v)
    distance[i, j, k] = sign * wp.length(p - skin)
    part[i, j, k] = face_parts[near.face]
