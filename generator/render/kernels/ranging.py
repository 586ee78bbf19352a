"""The first surface on the ray of each pixel, and whether given points are lit from a projector."""

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = 1.0e5  # cm; length of a ray
TOLERANCE = 0.3  # cm; a surface nearer than this to a point does not hide it


@wp.kernel
def first_surface(mesh: wp.uint64, eye: wp.array(dtype=wp.vec3), rotation: wp.array(dtype=wp.mat33),
                  intrinsics: wp.array(dtype=wp.mat33),
                  # out
                  face: wp.array3d(dtype=int), weights: wp.array3d(dtype=wp.vec2),
                  depth: wp.array3d(dtype=float)):  # fmt: skip
    """Face, weights of its first two corners, and depth along the optical axis; unhit pixels keep their values."""
    camera, row, column = wp.tid()
    K = intrinsics[camera]
    u = (float(column) - K[0, 2]) / K[0, 0]
    v = (float(row) - K[1, 2]) / K[1, 1]
    axes = rotation[camera]
    ray = wp.transpose(axes) * wp.vec3(u, v, 1.0)
    direction = wp.normalize(ray)
    hit = wp.mesh_query_ray(mesh, eye[camera], direction, FAR)
    if hit.result:
        face[camera, row, column] = hit.face
        weights[camera, row, column] = wp.vec2(hit.u, hit.v)
        depth[camera, row, column] = hit.t / wp.length(ray)


@wp.kernel
def lit_points(mesh: wp.uint64, lamp: wp.vec3, point: wp.array(dtype=wp.vec3),
               # out
               lit: wp.array(dtype=wp.uint8)):  # fmt: skip
    """1 where nothing lies between the lamp and the point."""
    i = wp.tid()
    away = point[i] - lamp
    distance = wp.length(away)
    if not wp.mesh_query_ray_anyhit(mesh, lamp, away / distance, distance - TOLERANCE):
        lit[i] = wp.uint8(1)
