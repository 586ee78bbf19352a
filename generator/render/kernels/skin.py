"""Skin, underwear, eyes and hair."""

import warp as wp

from gcd_dataset.generator.render.kernels.noise import inside, noise2
from gcd_dataset.generator.render.kernels.records import Shot

wp.set_module_options({"enable_backward": False})

BRIEFS = wp.constant(0)
TOP = wp.constant(1)
INNER = wp.constant(3)


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
    colour = wp.lerp(colour, shot.eyes, wp.clamp(mask[INNER], 0.0, 1.0))
    cover = float(0.0)
    if shot.bare == 0:
        cover = inside(-mask[BRIEFS], width)
        if shot.top == 1:
            cover = wp.max(cover, inside(-mask[TOP], width))
    return wp.lerp(colour, shot.underwear, cover)


@wp.func
def hair_slope(p: wp.vec3, middle: wp.vec3) -> wp.vec3:
    """A direction by which strands tilt the normal: strands run from the crown downwards."""
    around = wp.atan2(p[0] - middle[0], p[2] - middle[2])
    strand = noise2(wp.vec2(around * 14.0, 0.25 * p[1]), 23) + 0.5 * noise2(wp.vec2(around * 37.0, 0.4 * p[1]), 29)
    return wp.vec3(wp.cos(around), 0.0, -wp.sin(around)) * (0.45 * strand)
