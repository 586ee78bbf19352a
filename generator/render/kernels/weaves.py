"""Relief of the cloth: slopes of its surface in the panel's plane, and the variation of its yarns."""

import warp as wp

from gcd_dataset.generator.render.kernels.noise import fractal2, noise2, ramp
from gcd_dataset.generator.render.kernels.records import Cloth

wp.set_module_options({"enable_backward": False})

TWILL = wp.constant(1)
SATIN = wp.constant(2)
JERSEY = wp.constant(3)
RIB = wp.constant(4)
CORDUROY = wp.constant(5)
CREPE = wp.constant(6)
FELT = wp.constant(7)
TURN = wp.constant(6.2831853)


@wp.func
def weave_slope(cloth: Cloth, uv: wp.vec2, width: float) -> wp.vec2:
    """Slope of the threads along both axes of the panel; fades where threads are finer than two pixels."""
    kind = cloth.weave_kind
    phase = uv * (TURN / cloth.pitch)
    seen = cloth.depth * (1.0 - ramp(0.25, 0.6, width / cloth.pitch))
    if seen <= 0.0:
        return wp.vec2(0.0, 0.0)
    if kind == TWILL:
        wave = wp.cos(phase[0] + 0.6 * phase[1])
        return wp.vec2(wave, 0.6 * wave) * seen
    if kind == SATIN:
        return wp.vec2(0.4 * wp.cos(phase[0]), 0.0) * seen
    if kind == JERSEY:
        lean = wp.cos(0.5 * phase[0])
        wave = wp.cos(phase[1] + 2.0 * lean)
        return wp.vec2(0.8 * wp.sin(phase[0]) + wave * wp.sin(0.5 * phase[0]), 0.7 * wave) * seen
    if kind == RIB or kind == CORDUROY:
        return wp.vec2(wp.sin(phase[0]), 0.0) * seen
    if kind == CREPE or kind == FELT:
        q = uv * (1.0 / cloth.pitch)
        return wp.vec2(noise2(q, 3), noise2(q, 4)) * seen
    return wp.vec2(wp.sin(phase[0]) * wp.cos(0.5 * phase[1]), wp.sin(phase[1]) * wp.cos(0.5 * phase[0])) * seen


@wp.func
def wrinkle_slope(cloth: Cloth, uv: wp.vec2, panel: int) -> wp.vec2:
    """Slope of wrinkles of a few centimetres: crossing creases with flat cloth between them."""
    q = uv * 0.16
    bend = wp.vec2(fractal2(q * 0.6, 2, 101 + panel), fractal2(q * 0.6, 2, 211 + panel))
    a = q + bend * 0.8
    step = 0.08
    here = ridge(a, panel)
    slope = wp.vec2(ridge(a + wp.vec2(step, 0.0), panel) - here, ridge(a + wp.vec2(0.0, step), panel) - here)
    return slope * (cloth.wrinkles / step * 0.22)


@wp.func
def ridge(p: wp.vec2, panel: int) -> float:
    """Height of creases: noise whose zero lines are ridges."""
    n = noise2(p, 307 + panel)
    return wp.exp(-3.0 * n * n) * (0.5 + 0.5 * noise2(p * 0.7, 401 + panel))


@wp.func
def yarn_variation(cloth: Cloth, uv: wp.vec2, width: float) -> float:
    """Factor of the colour: yarns differ along warp and weft, and wear differs from place to place."""
    if cloth.mottle <= 0.0:
        return 1.0
    fine = 1.0 - ramp(0.1, 0.4, width)
    coarse = 1.0 - ramp(0.3, 1.2, width)
    warp_yarn = noise2(wp.vec2(uv[0] * 9.0, uv[1] * 0.7), 11)
    weft_yarn = noise2(wp.vec2(uv[0] * 0.7, uv[1] * 9.0), 13)
    speckle = noise2(uv * 2.3, 19)
    worn = fractal2(uv * 0.12, 3, 17)
    return 1.0 + cloth.mottle * (0.8 * fine * (warp_yarn + weft_yarn) + 0.7 * coarse * speckle + 0.6 * worn)
