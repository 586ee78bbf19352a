"""Ray casting of one garment on one body: the kernels of ``render``."""

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = 1.0e6  # cm
LIFT = 0.05  # cm a ray of ambient light starts over the surface, so as not to meet it
REACH = 14.0  # cm: what is further away does not darken a fold
SKY_RAYS = 8
EDGE_SAMPLES = 3  # per axis, in pixels where outlines run
DEPTH_STEP = 1.2  # cm between neighbouring pixels from which an outline runs there
GOLDEN_ANGLE = 2.39996323


@wp.struct
class Scene:
    """What there is to see."""

    mesh: wp.uint64
    face: wp.array(dtype=wp.vec3i)
    normal: wp.array(dtype=wp.vec3)  # at vertices
    paint: wp.array(dtype=int)  # row of ``colour`` of each face
    colour: wp.array(dtype=wp.vec3)  # linear, right side
    inside: wp.array(dtype=wp.vec3)  # linear, wrong side
    background: wp.vec3
    key_light: wp.vec3  # direction to it
    fill_light: wp.vec3


@wp.struct
class Camera:
    """Where it is seen from: a pinhole looking along ``forward``."""

    eye: wp.vec3
    right: wp.vec3
    up: wp.vec3
    forward: wp.vec3
    focal: float  # in half pictures
    size: int  # pixels


@wp.func
def ray_through(camera: Camera, column: float, row: float) -> wp.vec3:
    """Direction through a point of the picture, in pixels from its upper left corner."""
    half = float(camera.size) * 0.5
    u = (column - half) / half
    v = (half - row) / half
    return wp.normalize(camera.forward * camera.focal + camera.right * u + camera.up * v)


@wp.func
def open_sky(mesh: wp.uint64, point: wp.vec3, normal: wp.vec3) -> float:
    """The share of the hemisphere over a point that nothing near covers, weighted by the cosine."""
    helper = wp.vec3(0.0, 1.0, 0.0)
    if wp.abs(normal[1]) > 0.9:
        helper = wp.vec3(1.0, 0.0, 0.0)
    tangent = wp.normalize(wp.cross(helper, normal))
    other = wp.cross(normal, tangent)
    covered = float(0.0)
    for k in range(SKY_RAYS):
        share = (float(k) + 0.5) / float(SKY_RAYS)
        radius = wp.sqrt(share)
        angle = float(k) * GOLDEN_ANGLE
        direction = (
            tangent * (radius * wp.cos(angle)) + other * (radius * wp.sin(angle)) + normal * wp.sqrt(1.0 - share)
        )
        hit = wp.mesh_query_ray(mesh, point + normal * LIFT, direction, REACH)
        if hit.result:
            covered += 1.0 - hit.t / REACH
    return 1.0 - covered / float(SKY_RAYS)


@wp.func
def seen(scene: Scene, eye: wp.vec3, direction: wp.vec3) -> wp.vec3:
    """The colour that comes from a direction, linear."""
    hit = wp.mesh_query_ray(scene.mesh, eye, direction, FAR)
    if not hit.result:
        return scene.background
    corners = scene.face[hit.face]
    normal = wp.normalize(
        scene.normal[corners[0]] * hit.u
        + scene.normal[corners[1]] * hit.v
        + scene.normal[corners[2]] * (1.0 - hit.u - hit.v)
    )
    flat = hit.normal
    paint = scene.paint[hit.face]
    colour = scene.colour[paint]
    if wp.dot(flat, direction) > 0.0:
        colour = scene.inside[paint]
        flat = -flat
    if wp.dot(normal, flat) < 0.0:
        normal = -normal
    point = eye + direction * hit.t
    sky = open_sky(scene.mesh, point, flat)
    key = wp.max(0.0, 0.75 * wp.dot(normal, scene.key_light) + 0.25)  # wrapped: cloth scatters
    fill = wp.max(0.0, 0.5 * wp.dot(normal, scene.fill_light) + 0.5)
    return colour * (sky * (0.22 + 0.78 * key) + 0.16 * fill)


@wp.kernel
def cast_pixels(scene: Scene, camera: Camera, picture: wp.array2d(dtype=wp.vec3), depth: wp.array2d(dtype=float),
                paint: wp.array2d(dtype=int)):  # fmt: skip
    """One ray through the middle of each pixel."""
    row, column = wp.tid()
    direction = ray_through(camera, float(column) + 0.5, float(row) + 0.5)
    hit = wp.mesh_query_ray(scene.mesh, camera.eye, direction, FAR)
    depth[row, column] = FAR
    paint[row, column] = -1
    if hit.result:
        depth[row, column] = hit.t
        paint[row, column] = scene.paint[hit.face]
    picture[row, column] = seen(scene, camera.eye, direction)


@wp.func
def differs(
    depth: wp.array2d(dtype=float), paint: wp.array2d(dtype=int), row: int, column: int, r: int, c: int
) -> bool:
    """Whether an outline runs between two pixels; beyond the picture there is none."""
    if r < 0 or c < 0 or r >= depth.shape[0] or c >= depth.shape[1]:
        return False
    return paint[row, column] != paint[r, c] or wp.abs(depth[row, column] - depth[r, c]) > DEPTH_STEP


@wp.kernel
def smooth_outlines(scene: Scene, camera: Camera, depth: wp.array2d(dtype=float), paint: wp.array2d(dtype=int),
                    picture: wp.array2d(dtype=wp.vec3)):  # fmt: skip
    """Many rays through each pixel that an outline runs through, and their mean."""
    row, column = wp.tid()
    if not (
        differs(depth, paint, row, column, row - 1, column)
        or differs(depth, paint, row, column, row + 1, column)
        or differs(depth, paint, row, column, row, column - 1)
        or differs(depth, paint, row, column, row, column + 1)
    ):
        return
    total = wp.vec3(0.0, 0.0, 0.0)
    for i in range(EDGE_SAMPLES):
        for j in range(EDGE_SAMPLES):
            x = float(column) + (float(j) + 0.5) / float(EDGE_SAMPLES)
            y = float(row) + (float(i) + 0.5) / float(EDGE_SAMPLES)
            total += seen(scene, camera.eye, ray_through(camera, x, y))
    picture[row, column] = total / float(EDGE_SAMPLES * EDGE_SAMPLES)
