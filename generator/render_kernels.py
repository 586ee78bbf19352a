"""Ray casting of several scenes, each from several sides: the kernels of ``render_batch``.

Passes: the normals of vertices, what each ray meets, how much sky each vertex seen has over it, and the sRGB bytes of
each pixel. Vertices, faces and colours of all scenes are numbered through.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = 1.0e6  # cm
LIFT = 0.6  # cm a ray to the sky starts over the surface: past cloth that lies on it, whose hem would show as dark dots
REACH = 16.0  # cm: what is further away does not darken a fold
SKY_RAYS = 24
GOLDEN_ANGLE = 2.39996323
KEY, FILL, SKY = 0.74, 0.18, 0.26  # shares of the light
DARKEST = 0.25  # of the sky: light that comes round every corner
FIXED = 2.0**36  # steps of fixed-point normals in a cm²: sums of integers do not depend on their order
LEVELS = 255
WRAP = 0.2  # cloth scatters: light creeps this far past the terminator


@wp.struct
class Scenes:
    """What there is to see."""

    mesh: wp.array(dtype=wp.uint64)  # of each scene
    first_face: wp.array(dtype=int)  # of each scene
    corner: wp.array(dtype=int)  # three of each face
    position: wp.array(dtype=wp.vec3)
    normal: wp.array(dtype=wp.vec3)  # at vertices
    paint: wp.array(dtype=int)  # row of ``colour`` of each face
    colour: wp.array(dtype=wp.vec3)  # linear, right side
    inside: wp.array(dtype=wp.vec3)  # linear, wrong side
    background: wp.vec3


@wp.struct
class Camera:
    """Where it is seen from: a pinhole looking along ``forward``. The lights go with it."""

    eye: wp.vec3
    right: wp.vec3
    up: wp.vec3
    forward: wp.vec3
    focal: float  # in half pictures
    key_light: wp.vec3  # direction to it
    fill_light: wp.vec3


@wp.kernel
def sum_normals(corner: wp.array(dtype=int), position: wp.array(dtype=wp.vec3),
                total: wp.array2d(dtype=wp.int64)):  # fmt: skip
    """Add the normal of each face, twice its area long, to its corners (v, 3)."""
    face = wp.tid()
    a = wp.vec3d(position[corner[3 * face]])
    normal = wp.cross(wp.vec3d(position[corner[3 * face + 1]]) - a, wp.vec3d(position[corner[3 * face + 2]]) - a)
    for axis in range(3):
        share = wp.int64(wp.round(normal[axis] * wp.float64(FIXED)))
        for k in range(3):
            wp.atomic_add(total, corner[3 * face + k], axis, share)


@wp.kernel
def scale_normals(total: wp.array2d(dtype=wp.int64), normal: wp.array(dtype=wp.vec3)):
    """Unit normals at vertices."""
    i = wp.tid()
    normal[i] = wp.vec3(wp.normalize(wp.vec3d(
        wp.float64(total[i, 0]), wp.float64(total[i, 1]), wp.float64(total[i, 2]))))  # fmt: skip


@wp.func
def ray_through(camera: Camera, column: float, row: float, size: float) -> wp.vec3:
    """Direction through a point of a picture of ``size``, measured from its upper left corner."""
    u = 2.0 * column / size - 1.0
    v = 1.0 - 2.0 * row / size
    return wp.normalize(camera.forward * camera.focal + camera.right * u + camera.up * v)


@wp.kernel
def cast_rays(scenes: Scenes, cameras: wp.array(dtype=Camera), views: int, samples: int,
              hit_face: wp.array4d(dtype=int), hit_place: wp.array4d(dtype=wp.vec2),
              seen: wp.array2d(dtype=int)):  # fmt: skip
    """The face that each ray meets, -1 for none, and where on it; ``seen`` (side, v): the scene of vertices looked at.

    The ``samples`` × ``samples`` rays of a pixel stand together, the ``views`` of a scene follow each other. Faces seen
    from their wrong side are stored from -2 down.
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
    hit_place[shot, row, column, k] = wp.vec2(hit.u, hit.v)
    for corner in range(3):
        seen[side, scenes.corner[3 * face + corner]] = scene  # whoever writes, writes the same


@wp.kernel
def look_up(scenes: Scenes, seen: wp.array2d(dtype=int), sky: wp.array2d(dtype=float)):
    """The share of the sky over each vertex seen that nothing near covers; the sky is brighter above.

    Directions are spread with the cosine to the normal (a sunflower spiral on the disc, lifted to the hemisphere).
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
def shade(scenes: Scenes, camera: Camera, sky: wp.array2d(dtype=float), hit: int, place: wp.vec2) -> wp.vec3:
    """The colour of a point on a face, linear."""
    face = hit
    side = int(0)
    if hit < 0:
        face = -2 - hit
        side = int(1)
    weights = wp.vec3(place[0], place[1], 1.0 - place[0] - place[1])
    normal = wp.vec3(0.0, 0.0, 0.0)
    clear = float(0.0)
    for k in range(3):
        corner = scenes.corner[3 * face + k]
        normal += scenes.normal[corner] * weights[k]
        clear += sky[side, corner] * weights[k]
    normal = wp.normalize(normal)
    colour = scenes.colour[scenes.paint[face]]
    if side == 1:
        normal = -normal
        colour = scenes.inside[scenes.paint[face]]
    key = wp.max(0.0, (wp.dot(normal, camera.key_light) + WRAP) / (1.0 + WRAP))
    fill = 0.5 + 0.5 * wp.dot(normal, camera.fill_light)
    return colour * (clear * (KEY * key + SKY) + FILL * fill * wp.sqrt(clear))


@wp.func
def encode(value: float, least: wp.array(dtype=float)) -> wp.uint8:
    """The sRGB byte of a linear value: how many of the ``LEVELS`` thresholds in ``least`` it reaches."""
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
def develop(scenes: Scenes, cameras: wp.array(dtype=Camera), hit_face: wp.array4d(dtype=int),
            hit_place: wp.array4d(dtype=wp.vec2), sky: wp.array2d(dtype=float), least: wp.array(dtype=float),
            picture: wp.array4d(dtype=wp.uint8)):  # fmt: skip
    """Each pixel, the mean of its rays, in sRGB."""
    shot, row, column = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    samples = hit_face.shape[3]
    for k in range(samples):
        hit = hit_face[shot, row, column, k]
        if hit == -1:
            total += scenes.background
        else:
            total += shade(scenes, cameras[shot], sky, hit, hit_place[shot, row, column, k])
    for channel in range(3):
        picture[shot, row, column, channel] = encode(total[channel] / float(samples), least)
