"""What is seen at the centre of each pixel, of pictures and of range images; whether points are seen and lit."""

import warp as wp

from gcd_dataset.generator.render.kernels.rays import BODY, EYE, FAR, GARMENT, kind_of, ray_through
from gcd_dataset.generator.render.kernels.records import Scenes, Shot
from gcd_dataset.generator.render.kernels.surface import border_at, uv_at

wp.set_module_options({"enable_backward": False})

PART_GARMENT = 32  # as ``pictures.GARMENT``
PART_HAIR = 33  # as ``pictures.HAIR``
INTERNAL = 8  # as ``BodyPart.INTERNAL``
SEAM_LINE = 0.3  # cm; least half width of a seam's line
HEM = -2  # as ``geometry.HEM``
LIFT = 0.25  # cm from a surface to the start of a shadow ray, as in ``cast``
TOLERANCE = 0.15  # cm; a surface nearer than this to a point does not hide it
LAMP_TOLERANCE = 0.3  # cm; the same for light of a projector


@wp.struct
class Wanted:
    """The maps that are asked for; the arrays of the others are empty."""

    depth: int
    normals: int
    part: int
    panel_id: int
    seam: int
    silhouette: int
    lit: int
    channels: int  # numbers of ``Scenes.value`` to interpolate


@wp.kernel
def see_centres(scenes: Scenes, shots: wp.array(dtype=Shot), wanted: Wanted, size: int,
                # out
                depth: wp.array3d(dtype=float), normals: wp.array4d(dtype=float), part: wp.array3d(dtype=wp.uint8),
                panel: wp.array3d(dtype=wp.int16), seam: wp.array3d(dtype=wp.int16),
                silhouette: wp.array3d(dtype=wp.uint8), lit: wp.array3d(dtype=wp.uint8),
                values: wp.array4d(dtype=float)):  # fmt: skip
    """The maps of ``Picture.maps``; they hold the values of the background when the kernel starts."""
    number, row, column = wp.tid()
    shot = shots[number]
    direction = ray_through(shot, float(column), float(row), float(size))
    hit = wp.mesh_query_ray(scenes.mesh[shot.scene], shot.eye, direction, FAR)
    if not hit.result:
        return
    first = 3 * (scenes.first_face[shot.scene] + hit.face)
    weights = wp.vec3(hit.u, hit.v, 1.0 - hit.u - hit.v)
    kind = kind_of(scenes, shot.scene, hit.face)
    if wanted.silhouette == 1:
        silhouette[number, row, column] = wp.uint8(255)
    if wanted.depth == 1:
        depth[number, row, column] = hit.t * wp.dot(direction, shot.forward)
    if wanted.lit == 1:
        away = wp.normalize(hit.normal)
        if wp.dot(away, direction) > 0.0:
            away = -away
        start = shot.eye + direction * hit.t + away * LIFT
        if wp.dot(away, shot.key_direction) > 0.0:
            if not wp.mesh_query_ray_anyhit(scenes.mesh[shot.scene], start, shot.key_direction, FAR):
                lit[number, row, column] = wp.uint8(255)
    if wanted.normals == 1:
        normal = wp.vec3(0.0, 0.0, 0.0)
        for k in range(3):
            normal += scenes.normal[scenes.corner[first + k]] * weights[k]
        normal = wp.normalize(normal)
        if wp.dot(hit.normal, direction) > 0.0:
            normal = -normal
        normals[number, row, column, 0] = wp.dot(normal, shot.right)
        normals[number, row, column, 1] = wp.dot(normal, shot.down)
        normals[number, row, column, 2] = wp.dot(normal, shot.forward)
    if wanted.part == 1:
        value = int(PART_HAIR)
        if kind == GARMENT:
            value = PART_GARMENT
        elif kind == BODY:
            nearest = int(0)
            for k in range(1, 3):
                if weights[k] > weights[nearest]:
                    nearest = k
            shift = scenes.first_mask[shot.scene] - scenes.first_body_vertex[shot.scene]
            value = int(scenes.part[scenes.corner[first + nearest] + shift])
        elif kind == EYE:
            value = INTERNAL
        part[number, row, column] = wp.uint8(value)
    if kind != GARMENT:
        return
    face = scenes.first_cloth_face[shot.scene] + hit.face
    if wanted.panel_id == 1:
        panel[number, row, column] = wp.int16(scenes.panel[face])
    for channel in range(wanted.channels):
        mean = float(0.0)
        for k in range(3):
            mean += scenes.value[scenes.uv_corner[3 * face + k] * wanted.channels + channel] * weights[k]
        values[number, row, column, channel] = mean
    if wanted.seam == 1:
        border = border_at(scenes, face, weights, uv_at(scenes, face, weights))
        line = wp.max(SEAM_LINE, 0.75 * hit.t / (shot.focal * float(size)))
        if border[0] < line:
            nearest = int(0)
            for k in range(1, 3):
                a = scenes.border[scenes.uv_corner[3 * face + k]][0]
                if a < scenes.border[scenes.uv_corner[3 * face + nearest]][0]:
                    nearest = k
            seam[number, row, column] = wp.int16(scenes.seam[scenes.uv_corner[3 * face + nearest]])
        elif border[2] < line:
            seam[number, row, column] = wp.int16(HEM)


@wp.kernel
def see_points(scenes: Scenes, shots: wp.array(dtype=Shot), shot_of_point: wp.array(dtype=int),
               point: wp.array(dtype=wp.vec3),
               # out
               visible: wp.array(dtype=wp.uint8)):  # fmt: skip
    """Whether nothing lies between the camera and each point."""
    i = wp.tid()
    shot = shots[shot_of_point[i]]
    away = point[i] - shot.eye
    distance = wp.length(away)
    hit = wp.mesh_query_ray_anyhit(scenes.mesh[shot.scene], shot.eye, away / distance, distance - TOLERANCE)
    if hit:
        visible[i] = wp.uint8(0)
    else:
        visible[i] = wp.uint8(1)


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
    if not wp.mesh_query_ray_anyhit(mesh, lamp, away / distance, distance - LAMP_TOLERANCE):
        lit[i] = wp.uint8(1)
