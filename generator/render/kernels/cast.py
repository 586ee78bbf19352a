"""Rays of the camera, the light that reaches it along them, and the pixels that they make."""

import warp as wp

from gcd_dataset.generator.render.kernels.places import place_behind
from gcd_dataset.generator.render.kernels.prepare import floor_at
from gcd_dataset.generator.render.kernels.rays import (
    FAR,
    GARMENT,
    LAYERS,
    STEP,
    light_through,
    ray_through,
    sample_offset,
    towards_key,
)
from gcd_dataset.generator.render.kernels.records import ClothRow, Scenes, Shot
from gcd_dataset.generator.render.kernels.surface import Hit, hit_at, surface_at
from gcd_dataset.generator.render.kernels.textures import fraction, mixed, unit

wp.set_module_options({"enable_backward": False})

LIFT = 0.25  # cm from a surface to the start of a shadow ray
SHADOW_RAYS = 2  # of each sample
GRAIN = 0.02  # of the light of a pixel
LEVELS = 255
# Of plain pictures: lights fixed to the camera.
KEY, FILL, SKY = 0.74, 0.18, 0.26  # intensities
KEY_LIGHT = wp.constant(wp.vec3(-0.451, -0.551, -0.702))  # right, down, forward: from the upper left
FILL_LIGHT = wp.constant(wp.vec3(0.843, -0.105, -0.527))
DARKEST = 0.25  # least share of the sky's light: stands in for indirect light
WRAP = 0.2  # cosine past the terminator that is still lit, since cloth scatters light


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
def shade_plain(scenes: Scenes, shots: wp.array(dtype=Shot), cloth_of_panel: wp.array(dtype=int),
                cloths: wp.array(dtype=ClothRow), sky: wp.array2d(dtype=float), side: int,
                hit_face: wp.array4d(dtype=int), hit_uv: wp.array4d(dtype=wp.vec2), least: wp.array(dtype=float),
                # out
                picture: wp.array4d(dtype=wp.uint8)):  # fmt: skip
    """Each pixel of the plain shots in sRGB: the mean colour of its rays, without shadows, prints or film.

    Cloth has the ground colour of its print, the figure wears a suit of the colour of its underwear.
    """
    number, row, column = wp.tid()
    shot = shots[number]
    if shot.plain == 0:
        return
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(hit_face.shape[3]):
        face = hit_face[number, row, column, k]
        if face == -1:
            total += shot.wall
        else:
            offset = sample_offset(shot, row, column, k, side)
            size = float(hit_face.shape[1])
            direction = ray_through(shot, float(column) + offset[0], float(row) + offset[1], size)
            s = hit_at(scenes, shot, sky, face, hit_uv[number, row, column, k], direction)
            colour = shot.underwear
            if s.kind == GARMENT:
                panel = scenes.panel[scenes.first_cloth_face[shot.scene] + face]
                cloth = cloth_of_panel[shot.first_panel + panel]
                colour = cloths[cloth].ground
                if s.wrong == 1:
                    colour = colour * cloths[cloth].wrong_side
            normal = wp.vec3(wp.dot(s.normal, shot.right), wp.dot(s.normal, shot.down), wp.dot(s.normal, shot.forward))
            clear = wp.max(DARKEST, s.clear)
            key = wp.max(0.0, (wp.dot(normal, KEY_LIGHT) + WRAP) / (1.0 + WRAP))
            fill = 0.5 + 0.5 * wp.dot(normal, FILL_LIGHT)
            total += colour * (clear * (KEY * key + SKY) + FILL * fill * wp.sqrt(clear))
    for channel in range(3):
        picture[number, row, column, channel] = to_srgb(total[channel] / float(hit_face.shape[3]), least)


@wp.kernel
def shade_pixels(scenes: Scenes, shots: wp.array(dtype=Shot), cloth_of_panel: wp.array(dtype=int),
                 cloths: wp.array(dtype=ClothRow), texel: wp.array(dtype=wp.vec3), glow: wp.array2d(dtype=wp.vec3),
                 middle: wp.array(dtype=wp.vec3), sky: wp.array2d(dtype=float), floor: wp.array3d(dtype=float),
                 side: int, hit_face: wp.array4d(dtype=int), hit_uv: wp.array4d(dtype=wp.vec2),
                 least: wp.array(dtype=float),
                 # out
                 picture: wp.array4d(dtype=wp.uint8)):  # fmt: skip
    """Each pixel in sRGB: the mean of its rays, each developed like film, so that lights do not ring."""
    number, row, column = wp.tid()
    shot = shots[number]
    if shot.plain == 1:
        return
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
            origin = s.smooth + s.flat * LIFT
            if toward < 0.0 and s.transmission > 0.0:
                origin = s.point - s.flat * LIFT
            lit = float(0.0)
            if toward > -0.3 or s.transmission > 0.0:
                lit = share_of_key(scenes, shot, cloth_of_panel, cloths, origin, k, hit_face.shape[3], turn)
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
                start = b.point + b.normal * 0.05
                arriving = share_of_key(scenes, shot, cloth_of_panel, cloths, start, k, hit_face.shape[3], turn)
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


# -------------------------------------------------------------------------------------------------------------- light


@wp.func
def share_of_key(scenes: Scenes, shot: Shot, cloth_of_panel: wp.array(dtype=int), cloths: wp.array(dtype=ClothRow),
                 start: wp.vec3, k: int, samples: int, turn: float) -> float:  # fmt: skip
    """Share of the key light that reaches a point, by the shadow rays of sample ``k`` of its pixel."""
    lit = float(0.0)
    for r in range(SHADOW_RAYS):
        share = (float(k * SHADOW_RAYS + r) + 0.5) / float(samples * SHADOW_RAYS)
        key = towards_key(shot, share, fraction(turn + float(r) * 0.381966))
        lit += light_through(scenes, shot, cloth_of_panel, cloths, start, key) / float(SHADOW_RAYS)
    return lit


@wp.func
def irradiance(glow: wp.array2d(dtype=wp.vec3), row: int, n: wp.vec3) -> wp.vec3:
    """Light from all around on a surface with normal ``n``: a quadratic in ``n``, as of spherical harmonics.

    Ramamoorthi and Hanrahan, An efficient representation for irradiance environment maps, SIGGRAPH 2001.
    """
    total = glow[row, 0] + glow[row, 1] * n[0] + glow[row, 2] * n[1] + glow[row, 3] * n[2]
    total += glow[row, 4] * (n[0] * n[1]) + glow[row, 5] * (n[1] * n[2]) + glow[row, 6] * (n[2] * n[0])
    total += glow[row, 7] * (n[1] * n[1]) + glow[row, 8] * (n[0] * n[0] - n[2] * n[2])
    return wp.vec3(wp.max(total[0], 0.0), wp.max(total[1], 0.0), wp.max(total[2], 0.0))


@wp.func
def opened(clear: float, colour: wp.vec3) -> wp.vec3:
    """Ambient visibility with light that bounces between surfaces of one colour: a geometric series."""
    return wp.vec3(
        clear / (1.0 - 0.9 * colour[0] * (1.0 - clear)),
        clear / (1.0 - 0.9 * colour[1] * (1.0 - clear)),
        clear / (1.0 - 0.9 * colour[2] * (1.0 - clear)),
    )


@wp.func
def wrapped_cosine(cosine: float, wrap: float) -> float:
    """Cosine that reaches 0 only past the terminator, with the same mean."""
    return wp.max(0.0, cosine + wrap) / ((1.0 + wrap) * (1.0 + wrap))


@wp.func
def highlight(normal: wp.vec3, view: wp.vec3, light: wp.vec3, roughness: float, specular: float) -> float:
    """GGX reflectance times the cosine, with Smith's shadowing by Karis's approximation and Schlick's Fresnel term."""
    cosine = wp.dot(normal, light)
    facing = wp.max(wp.dot(normal, view), 0.05)
    if cosine <= 0.0:
        return 0.0
    half = wp.normalize(view + light)
    a = roughness * roughness
    h = wp.max(wp.dot(normal, half), 0.0)
    spread = h * h * (a * a - 1.0) + 1.0
    d = a * a / (3.14159265 * spread * spread)
    k = 0.5 * a
    g = 1.0 / ((cosine * (1.0 - k) + k) * (facing * (1.0 - k) + k))
    fresnel = specular + (1.0 - specular) * wp.pow(1.0 - wp.max(wp.dot(half, view), 0.0), 5.0)
    return 0.25 * d * g * fresnel * cosine * 3.14159265  # lights are stated in the brightness of white cloth


@wp.func
def reflected(s: Hit, shot: Shot, glow: wp.array2d(dtype=wp.vec3), row: int, direction: wp.vec3,
              lit: float) -> wp.vec3:  # fmt: skip
    """Light from a surface towards the camera; ``lit`` is the share of the key light that arrives."""
    view = -direction
    cosine = wp.dot(s.normal, shot.key_direction)
    wrap = s.scatter
    red = wrapped_cosine(cosine, wrap + 0.12 * s.warmth)
    key = wp.vec3(red, wrapped_cosine(cosine, wrap), wrapped_cosine(cosine, wrap - 0.06 * s.warmth)) * lit
    behind = wp.max(0.0, -cosine) * s.transmission
    around = wp.cw_mul(irradiance(glow, row, s.normal), opened(s.clear, s.colour))
    fill = (0.5 + 0.5 * wp.dot(s.normal, shot.fill_direction)) * wp.sqrt(s.clear)
    arriving = wp.cw_mul(shot.key, key + wp.vec3(behind, behind, behind) * lit) + around + shot.fill * fill
    result = wp.cw_mul(s.colour, arriving)
    gloss = highlight(s.normal, view, shot.key_direction, s.roughness, s.specular) * lit
    result += shot.key * gloss
    result += shot.fill * (highlight(s.normal, view, shot.fill_direction, s.roughness, s.specular) * s.clear)
    facing = wp.clamp(wp.dot(s.normal, view), 0.0, 1.0)
    rim = wp.pow(1.0 - facing, 5.0)
    mirror = direction - s.normal * (2.0 * wp.dot(direction, s.normal))
    gleam = (s.specular + (1.0 - s.roughness) * (1.0 - s.specular) * rim) * (1.0 - 0.5 * s.roughness)
    result += irradiance(glow, row, mirror) * (gleam * s.clear)
    fuzz = s.sheen * wp.pow(1.0 - facing, 3.0)
    tint = wp.vec3(0.3, 0.3, 0.3) + s.colour * 0.7
    return result + wp.cw_mul(tint, around + shot.key * (0.5 * lit * wp.max(0.0, cosine + 0.3))) * fuzz


@wp.func
def developed(light: wp.vec3) -> wp.vec3:
    """Film's response: linear up to a shoulder, then ever slower towards white."""
    return wp.vec3(shoulder(light[0]), shoulder(light[1]), shoulder(light[2]))


@wp.func
def shoulder(x: float) -> float:
    """0.6 and below unchanged; above, an exponential of the same slope that ends at 1."""
    if x <= 0.6:
        return x
    return 0.6 + 0.4 * (1.0 - wp.exp(-(x - 0.6) / 0.4))


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
