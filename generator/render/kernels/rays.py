"""Camera rays, and light that reaches a point past the meshes of a scene."""

import warp as wp

from gcd_dataset.generator.render.kernels.records import ClothRow, Scenes, Shot
from gcd_dataset.generator.render.kernels.textures import mixed, unit

wp.set_module_options({"enable_backward": False})

FAR = 1.0e5  # cm; length of a camera ray
STEP = 0.02  # cm; from a sheer surface to the ray that goes on behind it
LAYERS = 4  # layers of sheer cloth that a ray passes
GARMENT = wp.constant(0)
BODY = wp.constant(1)
HAIR = wp.constant(2)
EYE = wp.constant(3)


@wp.func
def ray_through(shot: Shot, column: float, row: float, size: float) -> wp.vec3:
    """Unit direction through a point of the picture; the centre of the upper left pixel is (0, 0)."""
    u = ((column + 0.5) / size - 0.5 - shot.shift[0]) / shot.focal
    v = ((row + 0.5) / size - 0.5 - shot.shift[1]) / shot.focal
    return wp.normalize(shot.forward + shot.right * u + shot.down * v)


@wp.func
def sample_offset(shot: Shot, row: int, column: int, k: int, side: int) -> wp.vec2:
    """Where sample ``k`` of ``side`` × ``side`` lies in its pixel, -0.5 to 0.5: a random place of its own square.

    Of plain shots a grid whose rows and columns are staggered: steep and level edges have all steps of grey.
    """
    if shot.plain == 1:
        i = (float(k % side) + 0.5) / float(side) - 0.5
        j = (float(k // side) + 0.5) / float(side) - 0.5
        return wp.vec2(i + j / float(side), j - i / float(side))
    word = mixed(mixed(wp.uint32(shot.seed), wp.uint32(row)), mixed(wp.uint32(column), wp.uint32(k)))
    x = (float(k % side) + unit(word)) / float(side) - 0.5
    y = (float(k // side) + unit(mixed(word, wp.uint32(1)))) / float(side) - 0.5
    return wp.vec2(x, y)


@wp.func
def kind_of(scenes: Scenes, scene: int, face: int) -> int:
    """``GARMENT``, ``BODY``, ``HAIR`` or ``EYE``; ``face`` counts within the scene."""
    if face < scenes.garment_end[scene]:
        return GARMENT
    if face < scenes.body_end[scene]:
        return BODY
    if face < scenes.hair_end[scene]:
        return HAIR
    return EYE


@wp.func
def sheerness(scenes: Scenes, shot: Shot, cloth_of_panel: wp.array(dtype=int), cloths: wp.array(dtype=ClothRow),
              face: int) -> float:  # fmt: skip
    """Share of light that passes straight through a face of the scene."""
    if kind_of(scenes, shot.scene, face) != GARMENT:
        return 0.0
    panel = scenes.panel[scenes.first_cloth_face[shot.scene] + face]
    return cloths[cloth_of_panel[shot.first_panel + panel]].translucency


@wp.func
def light_through(scenes: Scenes, shot: Shot, cloth_of_panel: wp.array(dtype=int), cloths: wp.array(dtype=ClothRow),
                  start: wp.vec3, direction: wp.vec3) -> float:  # fmt: skip
    """Share of a light's rays that reach ``start``: 0 behind an opaque surface."""
    mesh = scenes.mesh[shot.scene]
    if shot.sheer == 0:
        if wp.mesh_query_ray_anyhit(mesh, start, direction, FAR):
            return 0.0
        return 1.0
    light = float(1.0)
    origin = start
    for _layer in range(LAYERS):
        hit = wp.mesh_query_ray(mesh, origin, direction, FAR)
        if not hit.result:
            return light
        light *= sheerness(scenes, shot, cloth_of_panel, cloths, hit.face)
        if light <= 0.0:
            return 0.0
        origin = origin + direction * (hit.t + STEP)
    return light


@wp.func
def towards_key(shot: Shot, share: float, turn: float) -> wp.vec3:
    """A direction to a place on the key light's disc: ``share`` of its area from the middle, ``turn`` of a circle."""
    helper = wp.vec3(0.0, 1.0, 0.0)
    if wp.abs(shot.key_direction[1]) > 0.9:
        helper = wp.vec3(1.0, 0.0, 0.0)
    tangent = wp.normalize(wp.cross(helper, shot.key_direction))
    other = wp.cross(shot.key_direction, tangent)
    radius = shot.key_size * wp.sqrt(share)
    angle = 6.2831853 * turn
    return wp.normalize(shot.key_direction + tangent * (radius * wp.cos(angle)) + other * (radius * wp.sin(angle)))
