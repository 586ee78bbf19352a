"""Cloth at a place of a panel [cm]: colour of its print, slopes of its relief; ``width`` is a pixel's size there [cm].

Motifs whose period is below two pixels fade to their mean: stripes would alias.
"""

import warp as wp

from gcd_dataset.generator.render.kernels.records import ClothRow
from gcd_dataset.generator.render.kernels.textures import (
    bilinear,
    fractal2,
    fraction,
    inside,
    mixed,
    noise2,
    ramp,
    random2,
    unit,
)

wp.set_module_options({"enable_backward": False})

STRIPES = wp.constant(1)
CHECKS = wp.constant(2)
TARTAN = wp.constant(3)
DOTS = wp.constant(4)
FLORAL = wp.constant(5)
NOISE = wp.constant(6)
GRADIENT = wp.constant(7)
IMAGE = wp.constant(8)
PANELS = wp.constant(9)
TWILL = wp.constant(1)
SATIN = wp.constant(2)
JERSEY = wp.constant(3)
RIB = wp.constant(4)
CORDUROY = wp.constant(5)
CREPE = wp.constant(6)
FELT = wp.constant(7)
TURN = wp.constant(6.2831853)


@wp.func
def print_colour(cloth: ClothRow, uv: wp.vec2, panel: int, rise: float, width: float,
                 texel: wp.array(dtype=wp.vec3)) -> wp.vec3:  # fmt: skip
    """Linear colour of the right side of the cloth; ``rise`` is the height above the garment's lowest point [cm]."""
    kind = cloth.print_kind
    if kind == 0:
        return cloth.ground
    if kind == PANELS:
        return panel_colour(panel, cloth.seed)
    place = uv
    if cloth.matched == 0:
        shift = mixed(wp.uint32(cloth.seed), wp.uint32(panel))
        place = place + wp.vec2(unit(shift), unit(mixed(shift, wp.uint32(1)))) * (7.0 * cloth.period)
    x = cloth.across[0] * place[0] + cloth.across[1] * place[1]
    y = cloth.across[0] * place[1] - cloth.across[1] * place[0]
    if kind == STRIPES:
        return stripes(cloth, x, width)
    if kind == CHECKS:
        return checks(cloth, x, y, width)
    if kind == TARTAN:
        return tartan(cloth, x, y, width)
    if kind == DOTS:
        return dots(cloth, wp.vec2(x, y), width)
    if kind == FLORAL:
        return floral(cloth, wp.vec2(x, y), width)
    if kind == NOISE:
        return blotches(cloth, wp.vec2(x, y), width)
    if kind == GRADIENT:
        share = ramp(0.1, 0.9, rise / cloth.period + 0.15 * fractal2(uv * (2.0 / cloth.period), 3, cloth.seed))
        return wp.lerp(cloth.first, cloth.ground, share)
    if kind == IMAGE:
        height = cloth.period * float(cloth.height) / float(cloth.width)
        return bilinear(texel, cloth.texels, cloth.width, cloth.height, x / cloth.period, -y / height, 1)
    return cloth.ground


@wp.func
def panel_colour(panel: int, seed: int) -> wp.vec3:
    """A colour of its own for each panel: hues in golden steps."""
    hue = 6.0 * fraction(float(panel) * 0.618034 + unit(mixed(wp.uint32(seed), wp.uint32(7))))
    colour = wp.vec3(
        wp.clamp(wp.abs(hue - 3.0) - 1.0, 0.0, 1.0),
        wp.clamp(2.0 - wp.abs(hue - 2.0), 0.0, 1.0),
        wp.clamp(2.0 - wp.abs(hue - 4.0), 0.0, 1.0),
    )
    return wp.vec3(0.12, 0.12, 0.12) + colour * 0.45


@wp.func
def band(x: float, low: float, high: float, width: float) -> float:
    """Share of a pixel between ``low`` and ``high``."""
    return wp.clamp((wp.min(x + 0.5 * width, high) - wp.max(x - 0.5 * width, low)) / width, 0.0, 1.0)


@wp.func
def repeated(x: float, period: float, fill: float, width: float) -> float:
    """Share of a pixel covered by bands of ``fill`` × ``period`` that repeat: the exact mean over the pixel.

    Near two pixels a period it fades to ``fill``: pixels would beat with the bands.
    """
    w = wp.max(width, 1.0e-3 * period)
    low = (x - 0.5 * w) / period
    high = (x + 0.5 * w) / period
    below = wp.floor(low) * fill + wp.min(fraction(low), fill)
    above = wp.floor(high) * fill + wp.min(fraction(high), fill)
    share = wp.clamp((above - below) * period / w, 0.0, 1.0)
    return wp.lerp(share, fill, ramp(0.25, 0.55, width / period))


@wp.func
def stripes(cloth: ClothRow, x: float, width: float) -> wp.vec3:
    """Stripes; with jitter, a thin second stripe in each gap."""
    colour = wp.lerp(cloth.ground, cloth.first, repeated(x, cloth.period, cloth.fill, width))
    if cloth.jitter > 0.0:
        gap = (1.0 - cloth.fill) * cloth.period
        thin = 0.35 * cloth.jitter * gap
        middle = x - cloth.fill * cloth.period - 0.5 * (gap - thin)
        colour = wp.lerp(colour, cloth.second, repeated(middle, cloth.period, thin / cloth.period, width))
    return colour


@wp.func
def checks(cloth: ClothRow, x: float, y: float, width: float) -> wp.vec3:
    """Gingham: coloured threads both ways, mixed by half where one crosses the ground."""
    warp_share = repeated(x, cloth.period, cloth.fill, width)
    weft_share = repeated(y, cloth.period, cloth.fill, width)
    along = wp.lerp(cloth.ground, cloth.first, warp_share)
    across = wp.lerp(cloth.ground, cloth.first, weft_share)
    return (along + across) * 0.5


@wp.func
def sett(cloth: ClothRow, x: float, width: float) -> wp.vec3:
    """The thread colours of a tartan: bands mirrored about the middle of the sett."""
    period = cloth.period
    w = wp.max(width, 1.0e-3 * period)
    t = wp.abs(fraction(x / period) - 0.5) * 2.0  # 0 in the middle, 1 at the ends
    step = 2.0 * w / period
    colour = cloth.ground
    wide = 0.25 + 0.25 * cloth.fill
    colour = wp.lerp(colour, cloth.first, band(t, -wide, wide, step))
    centre = 0.10 + 0.5 * wide * unit(mixed(wp.uint32(cloth.seed), wp.uint32(11)))
    colour = wp.lerp(colour, cloth.second, band(t, centre - 0.04, centre + 0.04, step))
    outer = wide + (1.0 - wide) * (0.3 + 0.4 * unit(mixed(wp.uint32(cloth.seed), wp.uint32(12))))
    colour = wp.lerp(colour, cloth.third, band(t, outer - 0.035, outer + 0.035, step))
    return wp.lerp(colour, cloth.second, 0.8 * band(t, 0.95, 1.05, step))


@wp.func
def tartan(cloth: ClothRow, x: float, y: float, width: float) -> wp.vec3:
    """The same sett in warp and weft, half of each in view."""
    return (sett(cloth, x, width) + sett(cloth, y, width)) * 0.5


@wp.func
def dots(cloth: ClothRow, p: wp.vec2, width: float) -> wp.vec3:
    """Dots in rows set off by half a period, or scattered with jitter."""
    period = cloth.period
    radius = 0.5 * cloth.fill * period
    before = int(-1)  # a variable: loops of constant length are unrolled
    row = int(wp.floor(p[1] / period))
    colour = cloth.ground
    for dj in range(before, 2):
        j = row + dj
        offset = 0.5 * float(j - 2 * int(wp.floor(0.5 * float(j))))
        column = int(wp.floor(p[0] / period - offset))
        for di in range(before, 2):
            i = column + di
            centre = wp.vec2(
                (float(i) + 0.5 + offset + 0.5 * cloth.jitter * (random2(i, j, cloth.seed, 1) - 0.5)) * period,
                (float(j) + 0.5 + 0.5 * cloth.jitter * (random2(i, j, cloth.seed, 2) - 0.5)) * period,
            )
            size = radius * (1.0 - 0.5 * cloth.jitter * random2(i, j, cloth.seed, 3))
            ink = cloth.first
            if cloth.jitter > 0.0 and random2(i, j, cloth.seed, 4) < 0.33:
                ink = cloth.second
            colour = wp.lerp(colour, ink, inside(wp.length(p - centre) - size, width))
    return colour


@wp.func
def floral(cloth: ClothRow, p: wp.vec2, width: float) -> wp.vec3:
    """Flowers with leaves, scattered: one in most cells, two layers of different size."""
    colour = cloth.ground
    before = int(-1)  # a variable: loops of constant length are unrolled
    for layer in range(2):
        scale = cloth.period
        if layer == 0:
            scale = 0.53 * cloth.period
        cell = wp.vec2(wp.floor(p[0] / scale), wp.floor(p[1] / scale))
        for dj in range(before, 2):
            for di in range(before, 2):
                i = int(cell[0]) + di
                j = int(cell[1]) + dj
                seed = cloth.seed + 977 * layer
                if random2(i, j, seed, 1) < 0.85:
                    centre = wp.vec2(
                        (float(i) + 0.5 + 0.55 * (random2(i, j, seed, 2) - 0.5)) * scale,
                        (float(j) + 0.5 + 0.55 * (random2(i, j, seed, 3) - 0.5)) * scale,
                    )
                    colour = flower(cloth, colour, p - centre, scale, i, j, seed, layer, width)
    return colour


@wp.func
def flower(cloth: ClothRow, under: wp.vec3, d: wp.vec2, scale: float, i: int, j: int, seed: int, layer: int,
           width: float) -> wp.vec3:  # fmt: skip
    """One flower at the origin over the colour ``under``."""
    size = scale * cloth.fill * (0.34 + 0.22 * random2(i, j, seed, 4))
    distance = wp.length(d)
    colour = under
    if distance > 2.1 * size:
        return colour
    angle = wp.atan2(d[1], d[0]) + 6.2832 * random2(i, j, seed, 5)
    petals = 5.0 + wp.floor(3.0 * random2(cloth.seed, layer, seed, 6))
    leaf = wp.pow(wp.abs(wp.cos(1.5 * angle + 3.0 * random2(i, j, seed, 7))), 6.0)
    colour = wp.lerp(colour, cloth.third, inside(distance - 1.75 * size * leaf, width))
    lobe = wp.abs(wp.cos(0.5 * petals * angle))
    edge = size * (0.55 + 0.45 * wp.sqrt(lobe))
    ink = cloth.first
    if random2(i, j, seed, 8) < 0.35:
        ink = cloth.second
    shade = 0.75 + 0.25 * distance / size
    vein = 1.0 - 0.18 * wp.pow(lobe, 12.0) * ramp(0.2, 0.5, distance / size)
    colour = wp.lerp(colour, ink * (shade * vein), inside(distance - edge, width))
    heart = wp.lerp(cloth.second, wp.vec3(0.75, 0.5, 0.08), 0.6)
    return wp.lerp(colour, heart, inside(distance - 0.22 * size, width))


@wp.func
def blotches(cloth: ClothRow, p: wp.vec2, width: float) -> wp.vec3:
    """Camouflage of four colours; with jitter above a half, soft marbling of two."""
    q = p * (1.0 / cloth.period)
    soft = width / cloth.period
    a = fractal2(q, 4, cloth.seed)
    if cloth.jitter > 0.5:
        vein = wp.abs(fractal2(q * 0.7 + wp.vec2(a, -a) * 1.3, 4, cloth.seed + 31))
        return wp.lerp(cloth.first, cloth.ground, ramp(0.0, 0.12 + 0.3 * cloth.fill + soft, vein))
    b = fractal2(q * 1.3 + wp.vec2(17.0, 5.0), 4, cloth.seed + 57)
    c = noise2(q * 0.9 - wp.vec2(3.0, 11.0), cloth.seed + 91)
    colour = wp.lerp(cloth.ground, cloth.first, inside(0.02 - a, 0.03 + soft))
    colour = wp.lerp(colour, cloth.second, inside(0.16 - b, 0.03 + soft))
    return wp.lerp(colour, cloth.third, inside(0.45 - c, 0.03 + soft))


@wp.func
def weave_slope(cloth: ClothRow, uv: wp.vec2, width: float) -> wp.vec2:
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
def wrinkle_slope(cloth: ClothRow, uv: wp.vec2, panel: int) -> wp.vec2:
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
def yarn_variation(cloth: ClothRow, uv: wp.vec2, width: float) -> float:
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
