"""Stretch at each vertex of a draped cloth, its gap to the skin, and its pressure on it."""

import warp as wp

from gcd_dataset.generator.drape.config import GRAVITY
from gcd_dataset.generator.drape.kernels.sheet import Sheet
from gcd_dataset.generator.drape.kernels.topology import ClothSurface

wp.set_module_options({"enable_backward": False})

FURTHEST = wp.constant(1.0e6)  # cm
TOUCHING = 1.0e-4  # cm: below this distance the normal of the nearest face replaces the direction to the skin
THIN = 2.0e-6  # cm²: a face with a smaller doubled flat area has no defined stretch
TINY = 1.0e-12
KPA = 1.0e-4  # one g/(cm s²)
WEIGHT = wp.constant(GRAVITY)


@wp.struct
class Deformed:
    """A face as seen from one of its corners."""

    flat: float  # cm², area in the panel's plane
    stretches: wp.vec2  # the larger and the smaller principal stretch
    force: wp.vec3  # g cm/s², of the face's tension on the corner


@wp.func
def tension(sheet: Sheet, strain: wp.vec3) -> wp.vec3:
    """Tension along weft, warp and between them, from the strains [g/s²].

    Cloth that is compressed buckles: across the larger strain it is taken to be as narrow as without tension there, and
    a face without stretch has no tension.
    """
    a = float(sheet.stretch[0, 0]) * sheet.membrane
    across = float(sheet.stretch[0, 1]) * sheet.membrane
    b = float(sheet.stretch[1, 1]) * sheet.membrane
    shear = float(sheet.stretch[2, 2]) * sheet.membrane
    middle = 0.5 * (strain[0] + strain[1])
    turn = wp.vec2(0.5 * (strain[0] - strain[1]), strain[2])
    spread = wp.length(turn)
    turn = turn / wp.max(spread, TINY)  # cosine and sine of twice the angle to the weft
    along = 0.5 * (1.0 + turn[0])
    aside = 0.5 * (1.0 - turn[0])
    double = 0.25 * turn[1] * turn[1]
    coupling = (a + b - 4.0 * shear) * double + across * (along * along + aside * aside)
    stiffness = a * aside * aside + b * along * along + 2.0 * (across + 2.0 * shear) * double
    large = wp.max(middle + spread, 0.0)
    small = wp.max(middle - spread, -coupling / stiffness * large)
    middle = 0.5 * (large + small)
    turn = 0.5 * (large - small) * turn
    u = middle + turn[0]
    v = middle - turn[0]
    return wp.vec3(a * u + across * v, across * u + b * v, 2.0 * shear * turn[1])


@wp.func
def deformed(surface: ClothSurface, x: wp.array(dtype=wp.vec3), sheet: Sheet, f: int, corner: int) -> Deformed:
    """The deformation gradient is a rotation R times a stretch U; U - 1 gives the tension S, and R S the stress."""
    after = (corner + 1) % 3
    last = (corner + 2) % 3
    origin = x[surface.faces[f][corner]]
    p = x[surface.faces[f][after]] - origin
    q = x[surface.faces[f][last]] - origin
    a = surface.flat[f, after] - surface.flat[f, corner]
    b = surface.flat[f, last] - surface.flat[f, corner]
    doubled = float(a[0] * b[1] - a[1] * b[0])
    found = Deformed()
    found.flat = 0.5 * wp.abs(doubled)
    found.stretches = wp.vec2(1.0, 1.0)
    if wp.abs(doubled) < THIN:
        return found
    au = float(a[0]) / doubled
    av = float(a[1]) / doubled
    bu = float(b[0]) / doubled
    bv = float(b[1]) / doubled
    along_u = bv * p - av * q
    along_v = au * q - bu * p
    uu = wp.dot(along_u, along_u)
    vv = wp.dot(along_v, along_v)
    uv = wp.dot(along_u, along_v)
    middle = 0.5 * (uu + vv)
    spread = wp.length(wp.vec2(0.5 * (uu - vv), uv))
    found.stretches = wp.vec2(wp.sqrt(middle + spread), wp.sqrt(wp.max(middle - spread, 0.0)))
    area = wp.max(wp.length(wp.cross(along_u, along_v)), TINY)
    trace = wp.sqrt(uu + vv + 2.0 * area)
    u = (uu + area) / trace
    v = (vv + area) / trace
    mixed = uv / trace
    pull = (found.flat / area) * tension(sheet, wp.vec3(u - 1.0, v - 1.0, mixed))
    turned_u = v * along_u - mixed * along_v
    turned_v = u * along_v - mixed * along_u
    stress_u = pull[0] * turned_u + pull[2] * turned_v
    stress_v = pull[2] * turned_u + pull[1] * turned_v
    found.force = (bv - av) * stress_u - (bu - au) * stress_v
    return found


@wp.kernel
def describe(
    surface: ClothSurface,
    vertex_world: wp.array(dtype=int),
    sheets: wp.array(dtype=Sheet),
    skins: wp.array(dtype=wp.uint64),
    x: wp.array(dtype=wp.vec3),
    contact: float,
    # out
    maps: wp.array(dtype=wp.vec4),
):
    """Larger and smaller stretch, gap [cm] and pressure [kPa], 0 where the gap is ``contact`` or more."""
    i = wp.tid()
    w = vertex_world[i]
    flat = float(0.0)
    area = float(0.0)
    stretches = wp.vec2(0.0, 0.0)
    force = wp.vec3(0.0, 0.0, 0.0)
    for k in range(surface.first_face[i], surface.first_face[i + 1]):
        f = surface.vertex_faces[k]
        corner = int(surface.faces[f][1] == i) + 2 * int(surface.faces[f][2] == i)
        face = deformed(surface, x, sheets[w], f, corner)
        flat += face.flat
        area += face.flat * face.stretches[0] * face.stretches[1] / 3.0
        stretches += face.flat * face.stretches
        force += face.force
    force[1] = force[1] - sheets[w].mass * WEIGHT * flat / 3.0
    near = wp.mesh_query_point_sign_normal(skins[w], x[i], FURTHEST)
    away = near.sign * (x[i] - wp.mesh_eval_position(skins[w], near.face, near.u, near.v))
    gap = near.sign * wp.length(away)
    if wp.abs(gap) < TOUCHING:
        away = wp.mesh_eval_face_normal(skins[w], near.face)
    pressure = float(0.0)
    if gap < contact:
        pressure = wp.max(-KPA * wp.dot(force, wp.normalize(away)) / wp.max(area, TINY), 0.0)
    stretches = stretches / wp.max(flat, TINY)
    maps[i] = wp.vec4(stretches[0], stretches[1], gap, pressure)
