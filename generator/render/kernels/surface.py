"""The surface that a ray meets: where it lies, how it is turned, and its material there."""

import warp as wp

from gcd_dataset.generator.render.kernels.cloth import (
    band,
    print_colour,
    repeated,
    weave_slope,
    wrinkle_slope,
    yarn_variation,
)
from gcd_dataset.generator.render.kernels.rays import BODY, EYE, GARMENT, kind_of
from gcd_dataset.generator.render.kernels.records import ClothRow, Scenes, Shot
from gcd_dataset.generator.render.kernels.textures import inside, noise2, ramp

wp.set_module_options({"enable_backward": False})

UNKNOWN = 1.0e3  # cm; distance of a border that a panel lacks
GROOVE = 0.22  # cm; half width of the groove at a seam and of the roll at a hem
THREAD = 0.035  # cm; half width of a stitch's thread
BRIEFS = wp.constant(0)
TOP = wp.constant(1)
BROWS = wp.constant(2)
LIPS = wp.constant(3)


@wp.struct
class Hit:
    """A point on a surface that a ray met, as seen from a camera."""

    kind: int  # GARMENT, BODY or HAIR
    point: wp.vec3
    smooth: wp.vec3  # where the point would lie on the smooth surface: the start of shadow rays
    flat: wp.vec3  # normal of the face, towards the camera
    round: wp.vec3  # interpolated normal, towards the camera
    normal: wp.vec3  # with the relief of the cloth
    wrong: int  # 1 on the wrong side
    clear: float  # share of the sky that is seen
    colour: wp.vec3  # linear albedo
    roughness: float
    specular: float
    sheen: float
    scatter: float  # how far light bleeds past the terminator
    warmth: float  # 1 for skin: red light bleeds further
    transmission: float
    through: float  # share of light that passes straight through


@wp.func
def distance_to_edge(p: wp.vec2, a: wp.vec2, b: wp.vec2) -> float:
    """Distance from a line segment."""
    d = b - a
    t = wp.clamp(wp.dot(p - a, d) / wp.max(wp.dot(d, d), 1.0e-12), 0.0, 1.0)
    return wp.length(p - a - d * t)


@wp.func
def border_at(scenes: Scenes, cloth_face: int, weights: wp.vec3, uv: wp.vec2) -> wp.vec4:
    """Distance to and length along the next seam, then the next hem, interpolated over a face.

    Where all corners of the face lie on the border, the distance is that to the edges of the face.
    """
    a = scenes.uv_corner[3 * cloth_face]
    b = scenes.uv_corner[3 * cloth_face + 1]
    c = scenes.uv_corner[3 * cloth_face + 2]
    found = scenes.border[a] * weights[0] + scenes.border[b] * weights[1] + scenes.border[c] * weights[2]
    flags = scenes.edge_flags[cloth_face]
    if flags == 0:
        return found
    seam = float(UNKNOWN)
    hem = float(UNKNOWN)
    for k in range(3):
        start = scenes.uv[scenes.uv_corner[3 * cloth_face + k]]
        end = scenes.uv[scenes.uv_corner[3 * cloth_face + (k + 1) % 3]]
        distance = distance_to_edge(uv, start, end)
        if (flags >> k) & 1 == 1:
            seam = wp.min(seam, distance)
        if (flags >> (3 + k)) & 1 == 1:
            hem = wp.min(hem, distance)
    if scenes.border[a][0] + scenes.border[b][0] + scenes.border[c][0] < 1.0e-6:
        found[0] = seam
    if scenes.border[a][2] + scenes.border[b][2] + scenes.border[c][2] < 1.0e-6:
        found[2] = hem
    return found


@wp.func
def uv_at(scenes: Scenes, cloth_face: int, weights: wp.vec3) -> wp.vec2:
    """Place in the panel's plane [cm]."""
    first = 3 * cloth_face
    return (
        scenes.uv[scenes.uv_corner[first]] * weights[0]
        + scenes.uv[scenes.uv_corner[first + 1]] * weights[1]
        + scenes.uv[scenes.uv_corner[first + 2]] * weights[2]
    )


@wp.func
def smooth_point(scenes: Scenes, first: int, weights: wp.vec3, point: wp.vec3, sign: float) -> wp.vec3:
    """The point moved onto the tangent planes of the corners (Hanika, Ray Tracing Gems II, 2021, ch. 4).

    Shadow rays that start there do not meet the facets of a surface that is shaded as smooth.
    """
    moved = wp.vec3(0.0, 0.0, 0.0)
    for k in range(3):
        corner = scenes.corner[first + k]
        normal = scenes.normal[corner] * sign
        height = wp.min(0.0, wp.dot(point - scenes.position[corner], normal))
        moved += (point - normal * height) * weights[k]
    return moved


@wp.func
def hit_at(scenes: Scenes, shot: Shot, sky: wp.array2d(dtype=float), face: int, bary: wp.vec2,
           direction: wp.vec3) -> Hit:  # fmt: skip
    """Place, normals and open sky of a hit, without its material; ``face`` counts within the scene."""
    s = Hit()
    weights = wp.vec3(bary[0], bary[1], 1.0 - bary[0] - bary[1])
    first = 3 * (scenes.first_face[shot.scene] + face)
    i = scenes.corner[first]
    j = scenes.corner[first + 1]
    k = scenes.corner[first + 2]
    p = scenes.position[i]
    q = scenes.position[j]
    r = scenes.position[k]
    s.point = p * weights[0] + q * weights[1] + r * weights[2]
    s.flat = wp.normalize(wp.cross(q - p, r - p))
    smooth = scenes.normal[i] * weights[0] + scenes.normal[j] * weights[1] + scenes.normal[k] * weights[2]
    s.round = wp.normalize(smooth)
    s.wrong = int(wp.dot(s.flat, direction) > 0.0)
    if s.wrong == 1:
        s.flat = -s.flat
        s.round = -s.round
    s.normal = s.round
    s.clear = sky[s.wrong, i] * weights[0] + sky[s.wrong, j] * weights[1] + sky[s.wrong, k] * weights[2]
    s.kind = kind_of(scenes, shot.scene, face)
    s.warmth = 0.0
    s.transmission = 0.0
    s.through = 0.0
    return s


@wp.func
def finished(s: Hit, roughness: float, specular: float, sheen: float, scatter: float) -> Hit:
    """The hit with a gloss."""
    s.roughness = roughness
    s.specular = specular
    s.sheen = sheen
    s.scatter = scatter
    return s


@wp.func
def surface_at(scenes: Scenes, shot: Shot, cloth_of_panel: wp.array(dtype=int), cloths: wp.array(dtype=ClothRow),
               texel: wp.array(dtype=wp.vec3), sky: wp.array2d(dtype=float), face: int, bary: wp.vec2,
               direction: wp.vec3, pixel: float) -> Hit:  # fmt: skip
    """The surface at a hit; ``face`` counts within the scene, ``pixel`` is a pixel's angle [rad]."""
    s = hit_at(scenes, shot, sky, face, bary, direction)
    weights = wp.vec3(bary[0], bary[1], 1.0 - bary[0] - bary[1])
    first = 3 * (scenes.first_face[shot.scene] + face)
    sign = 1.0 - 2.0 * float(s.wrong)
    s.smooth = smooth_point(scenes, first, weights, s.point, sign)
    facing = wp.max(0.25, wp.abs(wp.dot(s.round, direction)))
    width = wp.length(s.point - shot.eye) * pixel / wp.sqrt(facing)
    if s.kind == GARMENT:
        return cloth_surface(s, scenes, shot, cloth_of_panel, cloths, texel, face, weights, width, sign)
    if s.kind == BODY:
        corners = wp.vec3i(scenes.corner[first], scenes.corner[first + 1], scenes.corner[first + 2])
        return body_surface(s, scenes, shot, corners, weights, width)
    if s.kind == EYE:
        return eye_surface(s, shot, scenes)
    return hair_surface(s, shot, scenes)


@wp.func
def cloth_surface(s: Hit, scenes: Scenes, shot: Shot, cloth_of_panel: wp.array(dtype=int),
                  cloths: wp.array(dtype=ClothRow), texel: wp.array(dtype=wp.vec3), face: int, weights: wp.vec3,
                  width: float, sign: float) -> Hit:  # fmt: skip
    """Material and relief of the cloth."""
    row = scenes.first_cloth_face[shot.scene] + face
    panel = scenes.panel[row]
    cloth = cloths[cloth_of_panel[shot.first_panel + panel]]
    uv = uv_at(scenes, row, weights)
    border = border_at(scenes, row, weights, uv)
    colour = print_colour(cloth, uv, panel, s.point[1] - scenes.lowest[shot.scene], width, texel) * yarn_variation(
        cloth, uv, width
    )
    if s.wrong == 1:
        colour = wp.lerp(cloth.ground * 0.85, colour * 0.8, cloth.wrong_side)
    slope = weave_slope(cloth, uv, width) + wrinkle_slope(cloth, uv, panel)
    # Seams pull the cloth in; hems are rolled and twice as thick up to their stitch.
    near = 1.0 - ramp(GROOVE, 4.0 * GROOVE, width)
    fold = near * falling(border[0], 0.5) + near * falling(border[2], 0.5 + 2.0 * cloth.thickness)
    if cloth.stitch_hem > 0.0:
        ledge = (border[2] - cloth.stitch_hem) / 0.12
        fold -= near * 2.0 * cloth.thickness * wp.exp(-ledge * ledge)
    row_a = scenes.uv_corner[3 * row]
    row_b = scenes.uv_corner[3 * row + 1]
    row_c = scenes.uv_corner[3 * row + 2]
    gradient = border_gradient(scenes, row_a, row_b, row_c, int(border[2] < border[0]))
    slope = slope + gradient * fold
    s.normal = tilted(s.round, scenes, shot, face, row_a, row_b, row_c, slope, sign)
    gap = 0.45 * band(wp.min(border[0], border[2]), -0.08, 0.08, width)
    colour = colour * (1.0 - gap)
    colour = wp.lerp(colour, cloth.stitch_colour, stitches(cloth, border, width))
    s.colour = wp.vec3(wp.clamp(colour[0], 0.0, 0.95), wp.clamp(colour[1], 0.0, 0.95), wp.clamp(colour[2], 0.0, 0.95))
    s = finished(s, cloth.roughness, cloth.specular, cloth.sheen, 0.12)
    s.transmission = cloth.transmission
    s.through = cloth.translucency
    # Seams and hems are several layers thick.
    if wp.min(border[0], border[2]) < wp.max(0.5, cloth.stitch_hem * 0.6):
        s.through = 0.5 * s.through
    return s


@wp.func
def falling(distance: float, height: float) -> float:
    """Slope of a surface that falls off towards a border at distance 0."""
    t = distance / GROOVE
    return height * t * wp.exp(-t * t)


@wp.func
def stitches(cloth: ClothRow, border: wp.vec4, width: float) -> float:
    """Share of a pixel that stitches cover."""
    share = float(0.0)
    if cloth.stitch_seam > 0.0:
        line = band(border[0] - cloth.stitch_seam, -THREAD, THREAD, width)
        share = wp.max(share, line * repeated(border[1], cloth.stitch_length, 0.7, width))
    if cloth.stitch_hem > 0.0:
        line = band(border[2] - cloth.stitch_hem, -THREAD, THREAD, width)
        share = wp.max(share, line * repeated(border[3], cloth.stitch_length, 0.7, width))
    return share


@wp.func
def border_gradient(scenes: Scenes, a: int, b: int, c: int, hem: int) -> wp.vec2:
    """Direction away from the border in the panel's plane."""
    first = scenes.uv[b] - scenes.uv[a]
    second = scenes.uv[c] - scenes.uv[a]
    area = first[0] * second[1] - first[1] * second[0]
    if wp.abs(area) < 1.0e-9:
        return wp.vec2(0.0, 0.0)
    rise = scenes.border[b][2 * hem] - scenes.border[a][2 * hem]
    other = scenes.border[c][2 * hem] - scenes.border[a][2 * hem]
    return wp.vec2(rise * second[1] - other * first[1], other * first[0] - rise * second[0]) * (1.0 / area)


@wp.func
def tilted(normal: wp.vec3, scenes: Scenes, shot: Shot, face: int, a: int, b: int, c: int, slope: wp.vec2,
           sign: float) -> wp.vec3:  # fmt: skip
    """The normal of a relief with ``slope`` in the panel's plane."""
    first = 3 * (scenes.first_face[shot.scene] + face)
    p = scenes.position[scenes.corner[first]]
    e = scenes.position[scenes.corner[first + 1]] - p
    f = scenes.position[scenes.corner[first + 2]] - p
    d = scenes.uv[b] - scenes.uv[a]
    g = scenes.uv[c] - scenes.uv[a]
    area = d[0] * g[1] - d[1] * g[0]
    if wp.abs(area) < 1.0e-9:
        return normal
    across = (e * g[1] - f * d[1]) * (1.0 / area)
    along = (f * d[0] - e * g[0]) * (1.0 / area)
    tilt = wp.normalize(across) * slope[0] + wp.normalize(along) * slope[1]
    return wp.normalize(normal - tilt * sign)


@wp.func
def body_surface(s: Hit, scenes: Scenes, shot: Shot, corners: wp.vec3i, weights: wp.vec3,
                 width: float) -> Hit:  # fmt: skip
    """Skin or underwear."""
    shift = scenes.first_mask[shot.scene] - scenes.first_body_vertex[shot.scene]
    mask = (
        scenes.mask[corners[0] + shift] * weights[0]
        + scenes.mask[corners[1] + shift] * weights[1]
        + scenes.mask[corners[2] + shift] * weights[2]
    )
    s.colour = body_colour(shot, mask, s.point, width)
    if is_underwear(shot, mask):
        return finished(s, 0.8, 0.02, 0.04, 0.12)
    s.warmth = 1.0
    return finished(s, 0.5, 0.028 * (0.35 + shot.gloss), 0.04, 0.22)


@wp.func
def hair_surface(s: Hit, shot: Shot, scenes: Scenes) -> Hit:
    """Hair: strands tilt the normal, and differ in colour."""
    middle = (scenes.eye[2 * shot.scene] + scenes.eye[2 * shot.scene + 1]) * 0.5
    centre = wp.vec3(middle[0], middle[1], middle[2] - 7.0)
    strand = hair_strand(s.point, centre)
    around = wp.normalize(wp.cross(wp.vec3(0.0, 1.0, 0.0), s.round) + wp.vec3(1.0e-4, 0.0, 0.0))
    s.normal = wp.normalize(s.round + around * (0.5 * strand))
    s.colour = shot.hair * (1.0 + 0.45 * strand)
    return finished(s, 0.55, 0.025, 0.03, 0.2)


@wp.func
def eye_surface(s: Hit, shot: Shot, scenes: Scenes) -> Hit:
    """An eyeball."""
    eye = scenes.eye[2 * shot.scene]
    other = scenes.eye[2 * shot.scene + 1]
    if wp.abs(s.point[0] - other[0]) < wp.abs(s.point[0] - eye[0]):
        eye = other
    direction = (s.point - wp.vec3(eye[0], eye[1], eye[2])) / eye[3]
    s.normal = wp.normalize(direction)
    s.colour = eye_colour(shot, s.normal)
    s.clear = 0.45  # the sockets' vertices lie behind the eyes
    return finished(s, 0.3, 0.02, 0.0, 0.1)


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
