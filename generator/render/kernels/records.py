"""The flat structs of the kernels; ``packing`` fills them."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class ClothRow:
    """Material of a part of a garment. Colours are linear, lengths in cm."""

    print_kind: int
    ground: wp.vec3
    first: wp.vec3
    second: wp.vec3
    third: wp.vec3
    period: float
    fill: float
    across: wp.vec2  # the motif's first axis in the panel's plane
    jitter: float
    matched: int
    seed: int
    texels: int  # row of the first texel of the tile
    width: int
    height: int
    weave_kind: int
    pitch: float
    depth: float
    roughness: float
    specular: float
    sheen: float
    mottle: float
    wrinkles: float
    stitch_colour: wp.vec3
    stitch_length: float
    stitch_seam: float
    stitch_hem: float
    wrong_side: float
    translucency: float
    transmission: float
    thickness: float


@wp.struct
class Shot:
    """A view: camera, lights, place, skin; colours are linear."""

    scene: int
    plain: int  # 1: flat colours on paper, under lights at the camera
    right: wp.vec3
    down: wp.vec3
    forward: wp.vec3
    eye: wp.vec3
    focal: float  # picture widths
    shift: wp.vec2  # picture widths
    seed: int
    # lights
    key_direction: wp.vec3
    key: wp.vec3
    key_size: float
    fill_direction: wp.vec3
    fill: wp.vec3
    exposure: float
    # place
    place: int
    wall: wp.vec3
    floor: wp.vec3
    accent: wp.vec3
    place_size: float
    turn: wp.vec2  # cosine and sine
    place_seed: int
    texels: int
    width: int
    height: int
    # figure
    skin: wp.vec3
    gloss: float
    underwear: wp.vec3
    bare: int
    top: int
    hair: wp.vec3
    eyes: wp.vec3
    # rows of other arrays
    first_panel: int  # in ``cloth_of_panel``
    sheer: int  # whether any cloth is translucent


@wp.struct
class Scenes:
    """The meshes of all scenes, concatenated; ``first_*`` hold the row of each scene's first entry."""

    mesh: wp.array(dtype=wp.uint64)
    first_face: wp.array(dtype=int)
    garment_end: wp.array(dtype=int)  # first face after the garment
    body_end: wp.array(dtype=int)  # first face after the body: the hair begins
    hair_end: wp.array(dtype=int)  # first face after the hair: the eyes begin
    eye: wp.array(dtype=wp.vec4)  # centre and radius of each scene's right, then left eye
    first_body_vertex: wp.array(dtype=int)
    corner: wp.array(dtype=int)  # vertices, three a face
    position: wp.array(dtype=wp.vec3)
    normal: wp.array(dtype=wp.vec3)
    # of the garments' faces; ``first_cloth_face`` is the row of a scene's first
    lowest: wp.array(dtype=float)  # height of each garment's lowest point [cm]
    first_cloth_face: wp.array(dtype=int)
    uv_corner: wp.array(dtype=int)  # rows of ``uv``, three a face
    panel: wp.array(dtype=int)
    edge_flags: wp.array(dtype=int)
    uv: wp.array(dtype=wp.vec2)
    value: wp.array(dtype=float)  # of each row of ``uv``: ``Wanted.channels`` numbers
    border: wp.array(dtype=wp.vec4)  # of each row of ``uv``: distance to and length along the next seam, and hem
    seam: wp.array(dtype=int)  # row of the seam that is next to each row of ``uv``
    # of the bodies' vertices; ``first_mask`` is the row of a scene's first
    first_mask: wp.array(dtype=int)
    mask: wp.array(dtype=wp.vec4)  # briefs, top, brows, lips
    part: wp.array(dtype=wp.uint8)
