"""Rays of the camera, and the pixels that they make."""

import warp as wp

from gcd_dataset.generator.render.kernels.lighting import developed, irradiance, reflected
from gcd_dataset.generator.render.kernels.noise import fraction, mixed, unit
from gcd_dataset.generator.render.kernels.places import place_behind
from gcd_dataset.generator.render.kernels.prepare import floor_at
from gcd_dataset.generator.render.kernels.rays import (
    FAR,
    LAYERS,
    STEP,
    light_through,
    ray_through,
    sample_offset,
    towards_key,
)
from gcd_dataset.generator.render.kernels.records import Cloth, Scenes, Shot
from gcd_dataset.generator.render.kernels.surface import surface_at
from gcd_dataset.generator.render.plain_kernels import to_srgb

wp.set_module_options({"enable_backward": False})

LIFT = 0.25  # cm from a surface to the start of a shadow ray
SHADOW_RAYS = 2  # of each sample
GRAIN = 0.02  # of the light of a pixel


@wp.func
def spread_noise(row: int, column: int) -> float:
    """A number in [0, 1) whose mean over any 3 × 3 pixels is nearly the same: soft shadows look smooth.

    Interleaved gradient noise (Jimenez, Next generation post processing in Call of Duty, SIGGRAPH 2014).
    """
    return fraction(52.9829189 * fraction(0.06711056 * float(column) + 0.00583715 * float(row)))


@wp.kernel
def cast_rays(scenes: Scenes, shots: wp.array(dtype=Shot), side: int,
              # out
              hit_face: wp.array4d(dtype=int), hit_uv: wp.array4d(dtype=wp.vec2),
              seen: wp.array2d(dtype=int)):  # fmt: skip
    """The face that each ray hits, counted within its scene, with barycentric coordinates; -1 for a miss.

    A pixel has ``side`` × ``side`` rays. ``seen`` (side of the surface, v): the scene of the vertices of such faces.
    """
    number, row, column, k = wp.tid()
    shot = shots[number]
    offset = sample_offset(shot, row, column, k, side)
    direction = ray_through(shot, float(column) + offset[0], float(row) + offset[1], float(hit_face.shape[1]))
    hit = wp.mesh_query_ray(scenes.mesh[shot.scene], shot.eye, direction, FAR)
    hit_face[number, row, column, k] = -1
    if not hit.result:
        return
    hit_face[number, row, column, k] = hit.face
    hit_uv[number, row, column, k] = wp.vec2(hit.u, hit.v)
    away = int(wp.dot(hit.normal, direction) > 0.0)
    first = 3 * (scenes.first_face[shot.scene] + hit.face)
    for corner in range(3):
        seen[away, scenes.corner[first + corner]] = shot.scene  # a benign race: all threads write the same value


@wp.kernel
def shade_pixels(scenes: Scenes, shots: wp.array(dtype=Shot), cloth_of_panel: wp.array(dtype=int),
                 cloths: wp.array(dtype=Cloth), texel: wp.array(dtype=wp.vec3), glow: wp.array2d(dtype=wp.vec3),
                 middle: wp.array(dtype=wp.vec3), sky: wp.array2d(dtype=float), floor: wp.array3d(dtype=float),
                 side: int, hit_face: wp.array4d(dtype=int), hit_uv: wp.array4d(dtype=wp.vec2),
                 least: wp.array(dtype=float),
                 # out
                 picture: wp.array4d(dtype=wp.uint8)):  # fmt: skip
    """Each pixel in sRGB: the mean of its rays, each developed like film, so that lights do not ring."""
    number, row, column = wp.tid()
    shot = shots[number]
    size = float(hit_face.shape[1])
    pixel = 1.0 / (shot.focal * size)
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(hit_face.shape[3]):
        offset = sample_offset(shot, row, column, k, side)
        x = float(column) + offset[0]
        y = float(row) + offset[1]
        direction = ray_through(shot, x, y, size)
        turn = fraction(spread_noise(row, column) + float(k) * 0.618034)
        light = wp.vec3(0.0, 0.0, 0.0)
        weight = float(1.0)
        face = hit_face[number, row, column, k]
        bary = wp.vec2(0.0, 0.0)
        if face != -1:
            bary = hit_uv[number, row, column, k]
        under = float(0.0)
        for _layer in range(LAYERS):
            if face == -1 or weight < 0.01:
                break
            s = surface_at(scenes, shot, cloth_of_panel, cloths, texel, sky, face, bary, direction, pixel)
            # Beneath sheer cloth, the sky that the cloth hides shines through.
            s.clear = wp.lerp(s.clear, 1.0, 0.6 * under)
            toward = wp.dot(s.flat, shot.key_direction)
            lit = float(0.0)
            origin = s.smooth + s.flat * LIFT
            if toward < 0.0 and s.transmission > 0.0:
                origin = s.point - s.flat * LIFT
            if toward > -0.3 or s.transmission > 0.0:
                for r in range(SHADOW_RAYS):
                    share = (float(k * SHADOW_RAYS + r) + 0.5) / float(hit_face.shape[3] * SHADOW_RAYS)
                    key = towards_key(shot, share, fraction(turn + float(r) * 0.381966))
                    lit += light_through(scenes, shot, cloth_of_panel, cloths, origin, key) / float(SHADOW_RAYS)
            opaque = 1.0 - s.through * wp.sqrt(wp.abs(wp.dot(s.flat, direction)))
            light += reflected(s, shot, glow, number, direction, lit) * (weight * opaque)
            weight *= 1.0 - opaque
            under = wp.max(under, s.through)
            if s.through <= 0.0:
                weight = 0.0
                break
            start = s.point + direction * STEP
            hit = wp.mesh_query_ray(scenes.mesh[shot.scene], start, direction, FAR)
            face = -1
            if hit.result:
                face = hit.face
                bary = wp.vec2(hit.u, hit.v)
        if weight > 0.0 and face == -1:
            stand = middle[shot.scene]
            b = place_behind(shot, stand, direction, (x + 0.5) / size, (y + 0.5) / size, texel)
            lit = float(1.0)
            clear = float(1.0)
            if b.floor > 0.0:
                share = (float(k) + 0.5) / float(hit_face.shape[3])
                start = b.point + b.normal * 0.05
                arriving = float(0.0)
                for r in range(SHADOW_RAYS):
                    share = (float(k * SHADOW_RAYS + r) + 0.5) / float(hit_face.shape[3] * SHADOW_RAYS)
                    key = towards_key(shot, share, fraction(turn + float(r) * 0.381966))
                    arriving += light_through(scenes, shot, cloth_of_panel, cloths, start, key) / float(SHADOW_RAYS)
                lit = wp.lerp(1.0, arriving, b.floor)
                clear = wp.lerp(1.0, floor_at(floor, shot.scene, stand, b.point), b.floor)
            cosine = wp.max(0.0, wp.dot(b.normal, shot.key_direction))
            around = irradiance(glow, number, b.normal) * clear
            shown = wp.cw_mul(b.colour, shot.key * (cosine * lit) + around + shot.fill * (0.5 * clear))
            light += wp.lerp(b.colour, shown, b.lit) * weight
        total += developed(light * shot.exposure)
    # Less than a step of the darkest greys: smooth walls would show bands without it.
    word = mixed(mixed(wp.uint32(shot.seed), wp.uint32(row)), mixed(wp.uint32(column), wp.uint32(77)))
    total = total * (1.0 + GRAIN * (unit(word) - 0.5))
    for channel in range(3):
        picture[number, row, column, channel] = to_srgb(total[channel] / float(hit_face.shape[3]), least)
