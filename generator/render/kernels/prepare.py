"""Kernels that run once for a scene and serve all its views: normals, distances to borders, light from the sky."""

import warp as wp

from gcd_dataset.generator.render.kernels.records import Scenes

wp.set_module_options({"enable_backward": False})

UNKNOWN = 1.0e3  # cm; distance of a border that a panel lacks
HEM = -2  # as ``geometry.HEM``
LIFT = 0.5  # cm from the surface to the start of a sky ray: cloth lying on cloth does not darken in dots
REACH = 22.0  # cm; surfaces further away do not occlude
SKY_RAYS = 32
FLOOR_RAYS = 64
FLOOR_REACH = 70.0  # cm
FLOOR_CELLS = 64  # along each side of the grid under the figure
FLOOR_SIDE = 320.0  # cm
GOLDEN_ANGLE = 2.39996323
FIXED = 2.0**36  # fixed-point steps in a cm²: integer sums do not depend on the order of the threads


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


@wp.kernel
def border_distances(first_segment: wp.array(dtype=int),
                     panel_of_row: wp.array(dtype=int), uv: wp.array(dtype=wp.vec2), ends: wp.array(dtype=wp.vec2i),
                     segment_seam: wp.array(dtype=int), along: wp.array(dtype=float),
                     # out
                     border: wp.array(dtype=wp.vec4), seam: wp.array(dtype=int)):  # fmt: skip
    """For each row of ``uv``: distance to the next seam and hem of its panel, and the length along them.

    ``panel_of_row`` counts panels over all scenes; ``first_segment`` has an entry for each of them and one more.
    """
    row = wp.tid()
    panel = panel_of_row[row]
    p = uv[row]
    result = wp.vec4(UNKNOWN, 0.0, UNKNOWN, 0.0)
    nearest = int(-1)
    for segment in range(first_segment[panel], first_segment[panel + 1]):
        a = uv[ends[segment][0]]
        d = uv[ends[segment][1]] - a
        t = wp.clamp(wp.dot(p - a, d) / wp.max(wp.dot(d, d), 1.0e-12), 0.0, 1.0)
        distance = wp.length(p - a - d * t)
        place = along[segment] + t * wp.length(d)
        if segment_seam[segment] == HEM:
            if distance < result[2]:
                result[2] = distance
                result[3] = place
        elif distance < result[0]:
            result[0] = distance
            result[1] = place
            nearest = segment_seam[segment]
    border[row] = result
    seam[row] = nearest


@wp.func
def hemisphere(normal: wp.vec3, k: int, count: int, turn: float) -> wp.vec3:
    """Direction ``k`` of ``count`` about a normal, cosine-weighted: a sunflower spiral on the disc, lifted."""
    helper = wp.vec3(0.0, 0.0, 1.0)
    if wp.abs(normal[2]) > 0.9:
        helper = wp.vec3(1.0, 0.0, 0.0)
    tangent = wp.normalize(wp.cross(helper, normal))
    other = wp.cross(normal, tangent)
    share = (float(k) + 0.5) / float(count)
    radius = wp.sqrt(share)
    angle = float(k) * GOLDEN_ANGLE + turn
    return tangent * (radius * wp.cos(angle)) + other * (radius * wp.sin(angle)) + normal * wp.sqrt(1.0 - share)


@wp.kernel
def sky_visibility(scenes: Scenes, seen: wp.array2d(dtype=int), sky: wp.array2d(dtype=float)):
    """Ambient occlusion of seen vertices (side, v): ``seen`` holds the scene, or -1."""
    side, i = wp.tid()
    scene = seen[side, i]
    if scene == -1:
        return
    normal = scenes.normal[i] * (1.0 - 2.0 * float(side))
    start = scenes.position[i] + normal * LIFT
    clear = float(0.0)
    for k in range(SKY_RAYS):
        hit = wp.mesh_query_ray(scenes.mesh[scene], start, hemisphere(normal, k, SKY_RAYS, 0.0), REACH)
        light = float(1.0)
        if hit.result:
            light = hit.t / REACH
        clear += light
    sky[side, i] = clear / float(SKY_RAYS)


@wp.kernel
def floor_visibility(scenes: Scenes, middle: wp.array(dtype=wp.vec3), floor: wp.array3d(dtype=float)):
    """Share of the sky seen from a grid on the floor under each figure: (scene, row along z, column along x)."""
    scene, row, column = wp.tid()
    step = FLOOR_SIDE / float(FLOOR_CELLS - 1)
    x = middle[scene][0] + float(column) * step - 0.5 * FLOOR_SIDE
    z = middle[scene][2] + float(row) * step - 0.5 * FLOOR_SIDE
    clear = float(0.0)
    for k in range(FLOOR_RAYS):
        direction = hemisphere(wp.vec3(0.0, 1.0, 0.0), k, FLOOR_RAYS, 0.0)
        hit = wp.mesh_query_ray(scenes.mesh[scene], wp.vec3(x, 0.05, z), direction, FLOOR_REACH)
        light = float(1.0)
        if hit.result:
            light = wp.sqrt(hit.t / FLOOR_REACH)
        clear += light
    floor[scene, row, column] = clear / float(FLOOR_RAYS)


@wp.func
def floor_at(floor: wp.array3d(dtype=float), scene: int, middle: wp.vec3, p: wp.vec3) -> float:
    """The grid's value at a point of the floor; 1 outside."""
    cells = float(FLOOR_CELLS - 1)
    x = ((p[0] - middle[0]) / FLOOR_SIDE + 0.5) * cells
    z = ((p[2] - middle[2]) / FLOOR_SIDE + 0.5) * cells
    if x <= 0.0 or z <= 0.0 or x >= cells or z >= cells:
        return 1.0
    i = int(wp.floor(x))
    j = int(wp.floor(z))
    s = x - float(i)
    t = z - float(j)
    low = wp.lerp(floor[scene, j, i], floor[scene, j, i + 1], s)
    high = wp.lerp(floor[scene, j + 1, i], floor[scene, j + 1, i + 1], s)
    # The grid ends where occlusion is nearly nought; the rest fades.
    edge = wp.min(wp.min(x, cells - x), wp.min(z, cells - z)) / cells
    return wp.lerp(1.0, wp.lerp(low, high, t), wp.clamp(8.0 * edge, 0.0, 1.0))
