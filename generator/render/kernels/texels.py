"""Lookups in pictures: tiles, photographs and panoramas, all in one array of linear colours."""

import warp as wp

wp.set_module_options({"enable_backward": False})


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
