"""Reflected light of a surface under key, fill and surroundings."""

import warp as wp

from gcd_dataset.generator.render.kernels.records import Shot
from gcd_dataset.generator.render.kernels.surface import Surface

wp.set_module_options({"enable_backward": False})


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
def reflected(s: Surface, shot: Shot, glow: wp.array2d(dtype=wp.vec3), row: int, direction: wp.vec3,
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
