"""Skin, underwear, eyes and hair."""

import warp as wp

from gcd_dataset.generator.render.kernels.noise import inside, noise2, ramp
from gcd_dataset.generator.render.kernels.records import Shot

wp.set_module_options({"enable_backward": False})

BRIEFS = wp.constant(0)
TOP = wp.constant(1)
BROWS = wp.constant(2)
LIPS = wp.constant(3)


@wp.func
def is_underwear(shot: Shot, mask: wp.vec4) -> bool:
    """Whether underwear covers a point of the body; ``mask`` as in ``Scenes.mask``."""
    if shot.bare == 1:
        return False
    return mask[BRIEFS] > 0.0 or (shot.top == 1 and mask[TOP] > 0.0)


@wp.func
def body_colour(shot: Shot, mask: wp.vec4, p: wp.vec3, width: float) -> wp.vec3:
    """Linear colour of the body at ``p`` [cm]."""
    patchy = noise2(wp.vec2(0.15 * p[0] + 0.11 * p[2], 0.13 * p[1]), 5)
    colour = wp.cw_mul(shot.skin, wp.vec3(1.0 + 0.03 * patchy, 1.0 - 0.02 * patchy, 1.0 - 0.03 * patchy))
    lips = wp.cw_mul(shot.skin, wp.vec3(0.72, 0.42, 0.42))
    colour = wp.lerp(colour, lips, 0.75 * ramp(-0.2, 0.6, mask[LIPS]))
    colour = wp.lerp(colour, lips * 0.12, ramp(1.2, 1.8, mask[LIPS]))
    brows = wp.lerp(shot.hair, shot.skin, 0.25)
    colour = wp.lerp(colour, brows, 0.8 * ramp(-0.12, 0.2, mask[BROWS]))
    cover = float(0.0)
    if shot.bare == 0:
        cover = inside(-mask[BRIEFS], width)
        if shot.top == 1:
            cover = wp.max(cover, inside(-mask[TOP], width))
    return wp.lerp(colour, shot.underwear, cover)


@wp.func
def eye_colour(shot: Shot, d: wp.vec3) -> wp.vec3:
    """Linear colour of an eye in a direction from its middle; it looks ahead."""
    off = wp.sqrt(d[0] * d[0] + d[1] * d[1])
    if d[2] < 0.0:
        off = 1.0
    white = wp.vec3(0.62, 0.58, 0.55)
    colour = wp.lerp(shot.eyes * (0.5 + off), white, ramp(0.40, 0.46, off))
    return colour * ramp(0.14, 0.20, off)


@wp.func
def hair_strand(p: wp.vec3, middle: wp.vec3) -> float:
    """Variation between strands, -1 to 1; they run from the crown downwards."""
    around = wp.atan2(p[0] - middle[0], p[2] - middle[2])
    wave = 0.12 * noise2(wp.vec2(around * 3.0, 0.3 * p[1]), 31)
    coarse = noise2(wp.vec2((around + wave) * 16.0, 0.12 * p[1]), 23)
    fine = noise2(wp.vec2((around + wave) * 60.0, 0.2 * p[1]), 29)
    return 0.55 * coarse + 0.45 * fine
