"""Hashes and value noise, the same on every device; lookups in tiles, photographs and panoramas."""

import warp as wp

wp.set_module_options({"enable_backward": False})

GOLDEN = wp.constant(wp.uint32(0x9E3779B9))
SALT = wp.constant(wp.uint32(0x85EBCA6B))
MULTIPLIER = wp.constant(wp.uint32(747796405))
INCREMENT = wp.constant(wp.uint32(2891336453))
SHUFFLE = wp.constant(wp.uint32(277803737))


@wp.func
def mixed(a: wp.uint32, b: wp.uint32) -> wp.uint32:
    """A hash of two words: PCG's output permutation (Jarzynski and Olano, JCGT 9(3), 2020)."""
    state = (a * GOLDEN + b + SALT) * MULTIPLIER + INCREMENT
    word = ((state >> ((state >> wp.uint32(28)) + wp.uint32(4))) ^ state) * SHUFFLE
    return (word >> wp.uint32(22)) ^ word


@wp.func
def fraction(x: float) -> float:
    """Distance from the next whole number below: ``wp.frac`` is negative for negative numbers."""
    return x - wp.floor(x)


@wp.func
def unit(word: wp.uint32) -> float:
    """A hash as a number in [0, 1)."""
    return float(word >> wp.uint32(8)) * (1.0 / 16777216.0)


@wp.func
def random2(i: int, j: int, seed: int, number: int) -> float:
    """A number in [0, 1) for a cell of a plane."""
    return unit(mixed(mixed(wp.uint32(i), wp.uint32(j)), mixed(wp.uint32(seed), wp.uint32(number))))


@wp.func
def smooth(t: float) -> float:
    """Quintic ramp from 0 to 1."""
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@wp.func
def noise2(p: wp.vec2, seed: int) -> float:
    """Value noise of unit wavelength, -1 to 1."""
    x = wp.floor(p[0])
    y = wp.floor(p[1])
    i = int(x)
    j = int(y)
    u = smooth(p[0] - x)
    v = smooth(p[1] - y)
    low = wp.lerp(random2(i, j, seed, 0), random2(i + 1, j, seed, 0), u)
    high = wp.lerp(random2(i, j + 1, seed, 0), random2(i + 1, j + 1, seed, 0), u)
    return 2.0 * wp.lerp(low, high, v) - 1.0


@wp.func
def fractal2(p: wp.vec2, octaves: int, seed: int) -> float:
    """Octaves of value noise, about -1 to 1."""
    total = float(0.0)
    weight = float(0.5)
    q = p
    for octave in range(octaves):
        total += weight * noise2(q, seed + octave)
        q = wp.vec2(1.6 * q[0] + 1.2 * q[1], 1.6 * q[1] - 1.2 * q[0])
        weight *= 0.5
    return total


@wp.func
def ramp(low: float, high: float, x: float) -> float:
    """0 below ``low``, 1 above ``high``, smooth between."""
    t = wp.clamp((x - low) / wp.max(high - low, 1.0e-6), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def inside(distance: float, width: float) -> float:
    """Coverage of a pixel of ``width`` by a shape whose signed distance is negative inside."""
    return wp.clamp(0.5 - distance / wp.max(width, 1.0e-4), 0.0, 1.0)


@wp.func
def wrapped(i: int, n: int, repeat: int) -> int:
    """Row ``i`` of ``n``, repeated or held at the edge."""
    if repeat == 1:
        return i - n * int(wp.floor(float(i) / float(n)))
    return wp.clamp(i, 0, n - 1)


@wp.func
def bilinear(texel: wp.array(dtype=wp.vec3), first: int, width: int, height: int, u: float, v: float,
             repeat: int) -> wp.vec3:  # fmt: skip
    """Colour at (u, v), 0 to 1 from the upper left corner."""
    x = u * float(width) - 0.5
    y = v * float(height) - 0.5
    i = int(wp.floor(x))
    j = int(wp.floor(y))
    left = wrapped(i, width, repeat)
    right = wrapped(i + 1, width, repeat)
    above = first + wrapped(j, height, repeat) * width
    below = first + wrapped(j + 1, height, repeat) * width
    s = x - wp.floor(x)
    t = y - wp.floor(y)
    upper = wp.lerp(texel[above + left], texel[above + right], s)
    lower = wp.lerp(texel[below + left], texel[below + right], s)
    return wp.lerp(upper, lower, t)
