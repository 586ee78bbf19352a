"""Places behind the figure: gradients, paper sweeps, rooms, blurred colours, users' pictures."""

import warp as wp

from gcd_dataset.generator.render.kernels.records import Shot
from gcd_dataset.generator.render.kernels.textures import bilinear, fractal2, fraction, noise2, ramp, random2

wp.set_module_options({"enable_backward": False})

SWEEP = wp.constant(1)
ROOM = wp.constant(2)
NOISE = wp.constant(3)
PHOTOGRAPH = wp.constant(4)
PANORAMA = wp.constant(5)
CEILING = 275.0  # cm


@wp.struct
class Behind:
    """What a ray meets beside the figure."""

    point: wp.vec3
    normal: wp.vec3
    colour: wp.vec3  # linear
    lit: float  # 1: the colour is an albedo under the lights; 0: it is the light itself
    floor: float  # share of the figure's shadow that shows


@wp.func
def place_behind(shot: Shot, middle: wp.vec3, direction: wp.vec3, u: float, v: float,
                 texel: wp.array(dtype=wp.vec3)) -> Behind:  # fmt: skip
    """What lies in a direction; (u, v) is the place in the picture, 0 to 1, and ``middle`` the figure's stand."""
    b = Behind()
    b.lit = 0.0
    b.floor = 0.0
    b.normal = wp.vec3(0.0, 1.0, 0.0)
    b.point = shot.eye + direction * 1000.0
    if shot.place == SWEEP:
        return paper_sweep(b, shot, middle, direction)
    if shot.place == ROOM:
        return room(b, shot, middle, direction)
    if shot.place == NOISE:
        b.colour = blurred_colours(shot, direction)
        return b
    if shot.place == PHOTOGRAPH:
        side = wp.min(float(shot.width), float(shot.height))
        x = 0.5 + (u - 0.5) * side / float(shot.width)
        y = 0.5 + (v - 0.5) * side / float(shot.height)
        b.colour = bilinear(texel, shot.texels, shot.width, shot.height, x, y, 0) / shot.exposure
        return b
    if shot.place == PANORAMA:
        x = 0.5 + wp.atan2(direction[0], -direction[2]) / 6.2831853 + wp.atan2(shot.turn[1], shot.turn[0]) / 6.2831853
        y = wp.acos(wp.clamp(direction[1], -1.0, 1.0)) / 3.14159265
        b.colour = bilinear(texel, shot.texels, shot.width, shot.height, x, y, 1)
        return b
    b.colour = wp.lerp(shot.wall, shot.floor, ramp(0.0, 1.0, v)) / shot.exposure
    return b


@wp.func
def paper_sweep(b: Behind, shot: Shot, middle: wp.vec3, direction: wp.vec3) -> Behind:
    """A floor that curves up into a wall at ``place_size`` from the figure, whichever way the camera looks."""
    flat = wp.normalize(wp.vec3(direction[0], 0.0, direction[2]))
    rise = float(1.0)
    b.lit = 1.0
    if direction[1] < -1.0e-4:
        b.point = shot.eye - direction * (shot.eye[1] / direction[1])
        away = wp.vec2(b.point[0] - middle[0], b.point[2] - middle[2])
        behind = flat[0] * away[0] + flat[2] * away[1]
        rise = ramp(0.35 * shot.place_size, 1.1 * shot.place_size, behind)
        b.floor = 1.0 - rise
    angle = 1.5707963 * rise
    b.normal = wp.vec3(0.0, wp.cos(angle), 0.0) - flat * wp.sin(angle)
    b.colour = wp.lerp(shot.floor, shot.wall, rise)
    return b


@wp.func
def turned(shot: Shot, p: wp.vec3) -> wp.vec3:
    """A vector in the room's axes."""
    return wp.vec3(shot.turn[0] * p[0] - shot.turn[1] * p[2], p[1], shot.turn[1] * p[0] + shot.turn[0] * p[2])


@wp.func
def unturned(shot: Shot, p: wp.vec3) -> wp.vec3:
    """A vector of the room in world axes."""
    return wp.vec3(shot.turn[0] * p[0] + shot.turn[1] * p[2], p[1], -shot.turn[1] * p[0] + shot.turn[0] * p[2])


@wp.func
def room(b: Behind, shot: Shot, middle: wp.vec3, direction: wp.vec3) -> Behind:
    """A room seen from inside; a wall between the camera and the room is not shown."""
    eye = turned(shot, shot.eye - wp.vec3(middle[0], 0.0, middle[2]))
    d = turned(shot, direction)
    half = shot.place_size
    t = float(1.0e5)
    wall = int(0)
    for axis in range(3):
        low = -half
        high = half
        if axis == 1:
            low = 0.0
            high = CEILING
        if wp.abs(d[axis]) > 1.0e-5:
            end = wp.max((low - eye[axis]) / d[axis], (high - eye[axis]) / d[axis])
            if end < t:
                t = end
                wall = axis
    p = eye + d * t
    b.lit = 1.0
    normal = wp.vec3(0.0, 0.0, 0.0)
    normal[wall] = -wp.sign(d[wall])
    b.colour = shot.wall
    if wall == 1 and d[1] < 0.0:
        b.colour = floor_tiles(shot, p)
        b.floor = 1.0
    elif wall == 1:
        b.colour = wp.vec3(0.8, 0.8, 0.78)
    else:
        side = p[2]
        if wall == 2:
            side = p[0]
        number = 2 * wall + int(d[wall] > 0.0)
        b.colour = wall_colour(shot, side, p[1], number)
        if b.colour[0] > 1.0:
            b.lit = 0.0
    # Corners between walls, floor and ceiling are darker.
    edge = float(1.0e3)
    if wall != 0:
        edge = wp.min(edge, half - wp.abs(p[0]))
    if wall != 1:
        edge = wp.min(edge, wp.min(p[1], CEILING - p[1]))
    if wall != 2:
        edge = wp.min(edge, half - wp.abs(p[2]))
    # Before a camera outside, floor and walls go on.
    b.colour = b.colour * (1.0 - 0.35 * b.lit * wp.exp(-wp.max(edge, 0.0) / 35.0))
    b.normal = unturned(shot, normal)
    b.point = unturned(shot, p) + wp.vec3(middle[0], 0.0, middle[2])
    return b


@wp.func
def wall_colour(shot: Shot, x: float, y: float, number: int) -> wp.vec3:
    """A wall with a skirting board, and on some walls a window or a picture; above 1, light."""
    if y < 9.0:
        return wp.vec3(0.75, 0.74, 0.72) * (0.8 + 0.2 * ramp(8.0, 9.0, y))
    style = random2(number, 1, shot.place_seed, 6)
    centre = (random2(number, 2, shot.place_seed, 6) - 0.5) * shot.place_size
    across = wp.abs(x - centre)
    if style < 0.35:
        wide = 55.0 + 40.0 * random2(number, 3, shot.place_seed, 6)
        if across < wide and y > 85.0 and y < 225.0:
            bar = wp.min(wp.min(wp.abs(across - 0.0), wide - across), wp.min(y - 85.0, 225.0 - y))
            if bar < 4.0:
                return wp.vec3(0.8, 0.8, 0.8)
            return wp.vec3(1.02, 1.06, 1.12) * (1.0 + 0.5 * ramp(85.0, 225.0, y))
    elif style < 0.65:
        wide = 25.0 + 25.0 * random2(number, 4, shot.place_seed, 6)
        if across < wide and wp.abs(y - 160.0) < 0.75 * wide:
            if wp.min(wide - across, 0.75 * wide - wp.abs(y - 160.0)) < 2.5:
                return shot.accent * 0.4
            n = fractal2(wp.vec2(x, y) * 0.05, 3, shot.place_seed + number)
            return wp.lerp(shot.accent, shot.floor, wp.clamp(0.5 + n, 0.0, 1.0))
    return shot.wall * (1.0 + 0.02 * noise2(wp.vec2(x, y) * 0.06, shot.place_seed))


@wp.func
def floor_tiles(shot: Shot, p: wp.vec3) -> wp.vec3:
    """Tiles of slightly different tones."""
    tile = 45.0
    x = fraction(p[0] / tile)
    z = fraction(p[2] / tile)
    gap = wp.min(wp.min(x, 1.0 - x), wp.min(z, 1.0 - z)) * tile
    i = int(wp.floor(p[0] / tile))
    tone = 0.92 + 0.12 * random2(i, int(wp.floor(p[2] / tile)), shot.place_seed, 9)
    return shot.floor * (tone * (0.7 + 0.3 * ramp(0.2, 0.8, gap)))


@wp.func
def blurred_colours(shot: Shot, d: wp.vec3) -> wp.vec3:
    """A place far out of focus: patches of colour and discs of light."""
    # The azimuth jumps behind the camera, where nobody sees it.
    ahead = wp.atan2(shot.forward[0], shot.forward[2])
    aside = wp.atan2(d[0] * shot.forward[2] - d[2] * shot.forward[0], d[0] * shot.forward[0] + d[2] * shot.forward[2])
    q = wp.vec2(ahead + aside, wp.asin(wp.clamp(d[1], -1.0, 1.0))) * 4.0
    a = fractal2(q, 3, shot.place_seed)
    b = fractal2(q * 1.7 + wp.vec2(5.0, 9.0), 2, shot.place_seed + 40)
    colour = wp.lerp(shot.wall, shot.floor, ramp(-0.35, 0.35, a - 0.25 * q[1]))
    colour = wp.lerp(colour, shot.accent, 0.7 * ramp(0.1, 0.4, b))
    cell = q * 2.2
    x = int(wp.floor(cell[0]))
    y = int(wp.floor(cell[1]))
    before = int(-1)  # a variable: loops of constant length are unrolled
    for dj in range(before, 2):
        for di in range(before, 2):
            i = x + di
            j = y + dj
            if random2(i, j, shot.place_seed, 20) < 0.3:
                centre = wp.vec2(
                    float(i) + random2(i, j, shot.place_seed, 21), float(j) + random2(i, j, shot.place_seed, 22)
                )
                radius = 0.25 + 0.4 * random2(i, j, shot.place_seed, 23)
                disc = 1.0 - ramp(0.5 * radius, radius, wp.length(cell - centre))
                colour = wp.lerp(colour, wp.vec3(0.9, 0.85, 0.75), 0.25 * disc * random2(i, j, shot.place_seed, 24))
    return colour
