"""Ray casting of several scenes from several views: the kernels of ``plain_batch``.

Passes: vertex normals; the face each ray hits; ambient occlusion of the vertices that are seen; shading to sRGB bytes.
Vertices, faces and colours of all scenes are concatenated.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = 1.0e6  # cm; length of a camera ray
LIFT = 0.6  # cm from the surface to the start of a sky ray: without it, cloth lying on cloth darkens in dots at hems
REACH = 16.0  # cm; surfaces further away do not occlude
SKY_RAYS = 24
GOLDEN_ANGLE = 2.39996323
KEY, FILL, SKY = 0.74, 0.18, 0.26  # intensities of the three lights
DARKEST = 0.25  # least share of the sky's light: stands in for indirect light
FIXED = 2.0**36  # fixed-point steps in a cm²: integer sums do not depend on the order of the threads
LEVELS = 255
WRAP = 0.2  # wrap lighting: cosine past the terminator that is still lit, since cloth scatters light


@wp.struct
class Scenes:
    """The meshes and colours of all scenes."""

    mesh: wp.array(dtype=wp.uint64)  # id of each scene's BVH
    first_face: wp.array(dtype=int)  # row of each scene's first face
    corner: wp.array(dtype=int)  # vertices, three a face
    position: wp.array(dtype=wp.vec3)
    normal: wp.array(dtype=wp.vec3)  # at vertices
    colour_of_face: wp.array(dtype=int)  # row of ``colour`` of each face
    colour: wp.array(dtype=wp.vec3)  # linear, right side
    wrong_side_colour: wp.array(dtype=wp.vec3)  # linear
    background: wp.vec3


@wp.struct
class Camera:
    """A pinhole camera looking along ``forward``, with two lights fixed to it."""

    eye: wp.vec3
    right: wp.vec3
    up: wp.vec3
    forward: wp.vec3
    focal: float  # focal length, in half picture widths
    key_light: wp.vec3  # direction to the light
    fill_light: wp.vec3


@wp.kernel
def sum_normals(corner: wp.array(dtype=int), position: wp.array(dtype=wp.vec3),
                total: wp.array2d(dtype=wp.int64)):  # fmt: skip
    """Add each face's normal, of length twice its area, to ``total`` (v, 3) at its corners, in fixed point."""
    face = wp.tid()
    a = wp.vec3d(position[corner[3 * face]])
    normal = wp.cross(wp.vec3d(position[corner[3 * face + 1]]) - a, wp.vec3d(position[corner[3 * face + 2]]) - a)
    for axis in range(3):
        share = wp.int64(wp.round(normal[axis] * wp.float64(FIXED)))
        for k in range(3):
            wp.atomic_add(total, corner[3 * face + k], axis, share)


@wp.kernel
def scale_normals(total: wp.array2d(dtype=wp.int64), normal: wp.array(dtype=wp.vec3)):
    """Normalise the summed normals."""
    i = wp.tid()
    normal[i] = wp.vec3(wp.normalize(wp.vec3d(
        wp.float64(total[i, 0]), wp.float64(total[i, 1]), wp.float64(total[i, 2]))))  # fmt: skip


@wp.func
def ray_through(camera: Camera, column: float, row: float, size: float) -> wp.vec3:
    """Unit direction of the ray through (column, row) of a ``size`` × ``size`` grid, from the upper left corner."""
    u = 2.0 * column / size - 1.0
    v = 1.0 - 2.0 * row / size
    return wp.normalize(camera.forward * camera.focal + camera.right * u + camera.up * v)


@wp.kernel
def cast_rays(scenes: Scenes, cameras: wp.array(dtype=Camera), views: int, samples: int,
              hit_face: wp.array4d(dtype=int), hit_uv: wp.array4d(dtype=wp.vec2),
              seen: wp.array2d(dtype=int)):  # fmt: skip
    """The face that each ray hits, with barycentric coordinates; ``seen`` (side, v): the scene number of seen vertices.

    ``hit_face`` is -1 for a miss, and ``-2 - face`` for a hit on the wrong side. The last axis of a pixel holds its
    ``samples`` × ``samples`` rays; shots are ordered by scene, then view.
    """
    shot, row, column, k = wp.tid()
    scene, camera = shot // views, cameras[shot]
    across, down = column * samples + k % samples, row * samples + k // samples
    size = float(hit_face.shape[1] * samples)
    direction = ray_through(camera, float(across) + 0.5, float(down) + 0.5, size)
    hit = wp.mesh_query_ray(scenes.mesh[scene], camera.eye, direction, FAR)
    hit_face[shot, row, column, k] = -1
    if not hit.result:
        return
    face = scenes.first_face[scene] + hit.face
    side = int(0)
    hit_face[shot, row, column, k] = face
    if wp.dot(hit.normal, direction) > 0.0:
        side = int(1)
        hit_face[shot, row, column, k] = -2 - face
    hit_uv[shot, row, column, k] = wp.vec2(hit.u, hit.v)
    for corner in range(3):
        seen[side, scenes.corner[3 * face + corner]] = scene  # a benign race: all threads write the same value


@wp.kernel
def sky_visibility(scenes: Scenes, seen: wp.array2d(dtype=int), sky: wp.array2d(dtype=float)):
    """Ambient occlusion: the share of the sky's light that reaches each seen vertex; the sky is brighter above.

    Directions are cosine-weighted about the normal: a sunflower spiral on the disc, lifted to the hemisphere.
    """
    side, i = wp.tid()
    scene = seen[side, i]
    if scene == -1:
        return
    mesh = scenes.mesh[scene]
    normal = scenes.normal[i] * (1.0 - 2.0 * float(side))
    helper = wp.vec3(0.0, 0.0, 1.0)
    if wp.abs(normal[2]) > 0.9:
        helper = wp.vec3(1.0, 0.0, 0.0)
    tangent = wp.normalize(wp.cross(helper, normal))
    other = wp.cross(normal, tangent)
    start = scenes.position[i] + normal * LIFT
    clear = float(0.0)
    total = float(0.0)
    for k in range(SKY_RAYS):
        share = (float(k) + 0.5) / float(SKY_RAYS)
        radius = wp.sqrt(share)
        angle = float(k) * GOLDEN_ANGLE
        direction = (
            tangent * (radius * wp.cos(angle)) + other * (radius * wp.sin(angle)) + normal * wp.sqrt(1.0 - share)
        )
        light = 1.0 + 0.7 * direction[1]
        total += light
        hit = wp.mesh_query_ray(mesh, start, direction, REACH)
        if hit.result:
            light *= hit.t / REACH
        clear += light
    sky[side, i] = wp.max(DARKEST, clear / total)


@wp.func
def shade(scenes: Scenes, camera: Camera, sky: wp.array2d(dtype=float), hit: int, uv: wp.vec2) -> wp.vec3:
    """Linear colour of a point on a face; ``hit`` and ``uv`` as ``cast_rays`` stores them."""
    face = hit
    side = int(0)
    if hit < 0:
        face = -2 - hit
        side = int(1)
    weights = wp.vec3(uv[0], uv[1], 1.0 - uv[0] - uv[1])
    normal = wp.vec3(0.0, 0.0, 0.0)
    clear = float(0.0)
    for k in range(3):
        corner = scenes.corner[3 * face + k]
        normal += scenes.normal[corner] * weights[k]
        clear += sky[side, corner] * weights[k]
    normal = wp.normalize(normal)
    colour = scenes.colour[scenes.colour_of_face[face]]
    if side == 1:
        normal = -normal
        colour = scenes.wrong_side_colour[scenes.colour_of_face[face]]
    key = wp.max(0.0, (wp.dot(normal, camera.key_light) + WRAP) / (1.0 + WRAP))
    fill = 0.5 + 0.5 * wp.dot(normal, camera.fill_light)
    return colour * (clear * (KEY * key + SKY) + FILL * fill * wp.sqrt(clear))


@wp.func
def to_srgb(value: float, least: wp.array(dtype=float)) -> wp.uint8:
    """The sRGB byte of a linear value: the number of thresholds in ``least`` not above it, by binary search."""
    low = int(0)
    high = int(LEVELS)
    while low < high:
        middle = (low + high) // 2
        if value >= least[middle]:
            low = middle + 1
        else:
            high = middle
    return wp.uint8(low)


@wp.kernel
def shade_pixels(scenes: Scenes, cameras: wp.array(dtype=Camera), hit_face: wp.array4d(dtype=int),
            hit_uv: wp.array4d(dtype=wp.vec2), sky: wp.array2d(dtype=float), least: wp.array(dtype=float),
            picture: wp.array4d(dtype=wp.uint8)):  # fmt: skip
    """Each pixel in sRGB: the mean colour of its rays."""
    shot, row, column = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    samples = hit_face.shape[3]
    for k in range(samples):
        hit = hit_face[shot, row, column, k]
        if hit == -1:
            total += scenes.background
        else:
            total += shade(scenes, cameras[shot], sky, hit, hit_uv[shot, row, column, k])
    for channel in range(3):
        picture[shot, row, column, channel] = to_srgb(total[channel] / float(samples), least)
