"""Signed distance fields of bodies: distance and nearest body part of every voxel, coarse blocks first.

One launch fills the fields of all bodies: for a single body the latency of a launch on a GPU exceeds its work.
"""

import warp as wp

from gcd_dataset.records import BodyPart

wp.set_module_options({"enable_backward": False})

BLOCK = wp.constant(4)  # voxels along a side
HALF_BLOCK = wp.constant(2.6)  # voxels from a block's centre to its furthest voxel centre, rounded up
UNLIMITED = wp.constant(1.0e3)  # cm, search radius
ROUNDING = wp.constant(1.0e-2)  # cm, added to search radii; single precision resolves it 200 m from the origin
NEAR, INSIDE, OUTSIDE, NEAR_INSIDE = wp.constant(0.0), wp.constant(1.0), wp.constant(2.0), wp.constant(3.0)
HEAD = wp.constant(BodyPart.HEAD.value)
LID = wp.constant(128)  # bit of ``Voxels.face_parts``
ON_CLOTH = wp.constant(128)  # bit of the parts of voxels beside worn cloth
UNDER_SKIN = wp.constant(-1.0)  # cm: deeper inside the body, the way out does not depend on the cloth


@wp.struct
class Voxels:
    """The voxels of one body."""

    mesh: wp.uint64
    face_parts: wp.array(dtype=wp.uint8)
    """Body part of each face; with ``LID`` where it shares a vertex with a lid over an opening."""
    low: wp.vec3
    """Centre of the first voxel [cm]."""
    blocks: wp.array3d(dtype=wp.vec4)
    """(x, y, z, kind) of each block: the point of the skin nearest to the block's centre [cm], which limits the search
    radius of its voxels, and ``NEAR``, or ``NEAR_INSIDE`` for a centre inside the body; or ``INSIDE`` or ``OUTSIDE``
    for a block without voxels in the band."""
    distance: wp.array3d(dtype=float)
    """Signed distance of each voxel's centre from the skin [cm], negative inside."""
    part: wp.array3d(dtype=wp.uint8)
    """Body part of the nearest skin."""


@wp.struct
class Hull:
    """A convex hull as half-spaces, and the box of voxels round it in the field of its body."""

    planes: wp.array(dtype=wp.vec4)  # outward normal [1], offset [cm]: negative inside
    first: wp.vec3i  # voxel
    size: wp.vec3i  # voxels
    low: wp.vec3  # centre of the field's first voxel [cm]
    distance: wp.array3d(dtype=float)


@wp.func
def in_body(mesh: wp.uint64, p: wp.vec3):
    """Whether a point is inside: a ray upward hits the back of the skin first."""
    up = wp.vec3(0.0, 1.0, 0.0)
    skin = wp.mesh_query_ray(mesh, p, up, 1.0e4)
    return skin.result and wp.dot(skin.normal, up) >= 0.0


@wp.func
def unravel_index(number: int, rows: int, columns: int):
    """Index in a 3D array with ``rows`` and ``columns`` along its last two axes."""
    return wp.vec3i(number // (rows * columns), (number // columns) % rows, number % columns)


@wp.kernel
def measure_blocks(bodies: wp.array(dtype=Voxels), cell: float, band: float):
    """Fill ``Voxels.blocks``."""
    b, number = wp.tid()
    body = bodies[b]
    at = unravel_index(number, body.blocks.shape[1], body.blocks.shape[2])
    if at[0] >= body.blocks.shape[0]:
        return
    middle = wp.vec3(float(at[0]), float(at[1]), float(at[2])) + wp.vec3(0.5 - 0.5 / float(BLOCK))
    p = body.low + (cell * float(BLOCK)) * middle
    near = wp.mesh_query_point_no_sign(body.mesh, p, band + HALF_BLOCK * cell)
    where = NEAR
    if not near.result:
        if not in_body(body.mesh, p):
            body.blocks[at[0], at[1], at[2]] = wp.vec4(0.0, 0.0, 0.0, OUTSIDE)
            return
        near = wp.mesh_query_point_no_sign(body.mesh, p, UNLIMITED)
        where = INSIDE
    skin = wp.mesh_eval_position(body.mesh, near.face, near.u, near.v)
    # The side matters for voxels beyond the band alone: round those, no ball through the centre holds any skin.
    if where == NEAR and wp.length(p - skin) > band - HALF_BLOCK * cell and in_body(body.mesh, p):
        where = NEAR_INSIDE
    body.blocks[at[0], at[1], at[2]] = wp.vec4(skin[0], skin[1], skin[2], where)


@wp.kernel
def fill_fields(bodies: wp.array(dtype=Voxels), cell: float, band: float):
    """Fill ``distance`` (exact inside and up to ``band`` outside, ``band`` beyond), and ``part`` where it is exact.

    ``number`` counts the voxels of a block, then the blocks, so that neighbouring threads search the same faces.
    """
    b, number = wp.tid()
    body = bodies[b]
    in_block = unravel_index(number % (BLOCK * BLOCK * BLOCK), BLOCK, BLOCK)
    block_at = unravel_index(number // (BLOCK * BLOCK * BLOCK), body.blocks.shape[1], body.blocks.shape[2])
    at = BLOCK * block_at + in_block
    if at[0] >= body.distance.shape[0] or at[1] >= body.distance.shape[1] or at[2] >= body.distance.shape[2]:
        return
    block = body.blocks[block_at[0], block_at[1], block_at[2]]
    if block[3] == OUTSIDE:
        body.distance[at[0], at[1], at[2]] = band
        return
    p = body.low + cell * wp.vec3(float(at[0]), float(at[1]), float(at[2]))
    reach = wp.length(p - wp.vec3(block[0], block[1], block[2])) + ROUNDING
    sign = -1.0
    if block[3] == INSIDE:
        near = wp.mesh_query_point_no_sign(body.mesh, p, reach)
    else:
        near = wp.mesh_query_point_sign_normal(body.mesh, p, wp.min(reach, band))
        sign = near.sign
        part = int(0)
        if near.result:
            part = int(body.face_parts[near.face])
        if (part & LID) != 0 or (part == HEAD and sign < 0.0):
            # Signs by normals are wrong behind the lips, where a lid folds back on the skin, and beside sharp ears.
            winding = wp.mesh_query_point_sign_winding_number(body.mesh, p, wp.min(reach, band))
            sign = winding.sign
        if not near.result:
            if block[3] == NEAR:
                body.distance[at[0], at[1], at[2]] = band
                return
            near = wp.mesh_query_point_no_sign(body.mesh, p, reach)
            sign = -1.0
    skin = wp.mesh_eval_position(body.mesh, near.face, near.u, near.v)
    body.distance[at[0], at[1], at[2]] = sign * wp.length(p - skin)
    body.part[at[0], at[1], at[2]] = wp.uint8(int(body.face_parts[near.face]) & (LID - 1))


@wp.kernel
def add_hulls(hulls: wp.array(dtype=Hull), cell: float):
    """Lower ``distance`` to the distance from each hull: exact in front of faces, too small in front of edges."""
    h, number = wp.tid()
    hull = hulls[h]
    if number >= hull.size[0] * hull.size[1] * hull.size[2]:
        return
    at = hull.first + unravel_index(number, hull.size[1], hull.size[2])
    p = hull.low + cell * wp.vec3(float(at[0]), float(at[1]), float(at[2]))
    distance = float(-1.0e6)
    for k in range(hull.planes.shape[0]):
        plane = hull.planes[k]
        distance = wp.max(distance, plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] + plane[3])
    hull.distance[at[0], at[1], at[2]] = wp.min(hull.distance[at[0], at[1], at[2]], distance)


@wp.struct
class WornVoxels:
    """The voxels of one body round a garment that it wears; its garments share ``distance`` and ``part``."""

    skin: wp.uint64
    face_parts: wp.array(dtype=wp.uint8)
    """See ``Voxels``."""
    body: wp.array3d(dtype=float)
    """``Voxels.distance``."""
    first: wp.vec3i
    """The voxel at the first voxel of ``body``."""
    mesh: wp.uint64
    """The garment."""
    points: wp.array(dtype=wp.vec3)
    """Its vertices [cm]."""
    parts: wp.array(dtype=wp.uint8)
    """The body part that each vertex covers."""
    low: wp.vec3
    """Centre of the first voxel [cm]."""
    blocks: wp.array3d(dtype=float)
    """Signed distance of each block's centre from the garment [cm]."""
    distance: wp.array3d(dtype=float)
    """Signed distance of each voxel's centre from the nearest garment [cm], where it may lie nearer than the skin."""
    part: wp.array3d(dtype=wp.uint8)
    """Body part that the nearest garment covers there, with ``ON_CLOTH``."""


@wp.struct
class DressedVoxels:
    """The voxels of a body over which a garment is put on."""

    body: wp.array3d(dtype=float)
    body_part: wp.array3d(dtype=wp.uint8)
    first: wp.vec3i
    """The voxel at the first voxel of ``body``."""
    cloth: wp.array3d(dtype=float)
    cloth_part: wp.array3d(dtype=wp.uint8)
    gap: float
    """By how much the garments on the body are thicker [cm]."""
    distance: wp.array3d(dtype=float)
    part: wp.array3d(dtype=wp.uint8)


@wp.func
def is_voxel_of(field: wp.array3d(dtype=float), at: wp.vec3i) -> bool:
    """Whether a field has a voxel with this index."""
    if at[0] < 0 or at[1] < 0 or at[2] < 0:
        return False
    return at[0] < field.shape[0] and at[1] < field.shape[1] and at[2] < field.shape[2]


@wp.func
def distance_at(field: wp.array3d(dtype=float), at: wp.vec3i, beyond: float) -> float:
    """The value of a voxel [cm]; ``beyond`` outside of the field."""
    if is_voxel_of(field, at):
        return field[at[0], at[1], at[2]]
    return beyond


@wp.kernel
def find_parts(worn: wp.array(dtype=WornVoxels), arms: int):
    """Name the part of the arm at each vertex of a sleeve, such as the forearm; ``arms``: bit set of these parts."""
    k, i = wp.tid()
    cloth = worn[k]
    if i >= cloth.parts.shape[0] or ((arms >> int(cloth.parts[i])) & 1) == 0:
        return
    near = wp.mesh_query_point_no_sign(cloth.skin, cloth.points[i], UNLIMITED)
    if near.result:
        part = int(cloth.face_parts[near.face]) & (LID - 1)
        if ((arms >> part) & 1) != 0:
            cloth.parts[i] = wp.uint8(part)


@wp.kernel
def measure_cloth_blocks(worn: wp.array(dtype=WornVoxels), cell: float):
    """Fill ``WornVoxels.blocks``."""
    k, number = wp.tid()
    cloth = worn[k]
    at = unravel_index(number, cloth.blocks.shape[1], cloth.blocks.shape[2])
    if at[0] >= cloth.blocks.shape[0]:
        return
    middle = wp.vec3(float(at[0]), float(at[1]), float(at[2])) + wp.vec3(0.5 - 0.5 / float(BLOCK))
    p = cloth.low + (cell * float(BLOCK)) * middle
    near = wp.mesh_query_point_sign_winding_number(cloth.mesh, p, UNLIMITED)
    away = wp.length(p - wp.mesh_eval_position(cloth.mesh, near.face, near.u, near.v))
    cloth.blocks[at[0], at[1], at[2]] = near.sign * away


@wp.kernel
def lower_to_cloth(worn: wp.array(dtype=WornVoxels), cell: float, band: float, most_gap: float):
    """Lower ``WornVoxels.distance`` to the signed distance from a garment; ``most_gap``: of ``DressedVoxels`` [cm].

    ``number`` counts as in ``fill_fields``.
    """
    k, number = wp.tid()
    cloth = worn[k]
    in_block = unravel_index(number % (BLOCK * BLOCK * BLOCK), BLOCK, BLOCK)
    block_at = unravel_index(number // (BLOCK * BLOCK * BLOCK), cloth.blocks.shape[1], cloth.blocks.shape[2])
    at = BLOCK * block_at + in_block
    if not is_voxel_of(cloth.distance, at):
        return
    middle = cloth.blocks[block_at[0], block_at[1], block_at[2]]
    least = wp.min(distance_at(cloth.body, at - cloth.first, band), cloth.distance[at[0], at[1], at[2]])
    if middle - HALF_BLOCK * cell - most_gap > least or least < UNDER_SKIN:
        return
    p = cloth.low + cell * wp.vec3(float(at[0]), float(at[1]), float(at[2]))
    reach = wp.abs(middle) + HALF_BLOCK * cell
    sign = wp.sign(middle)
    if reach > 2.0 * HALF_BLOCK * cell:  # no cloth lies in the block
        near = wp.mesh_query_point_no_sign(cloth.mesh, p, reach + ROUNDING)
    else:
        near = wp.mesh_query_point_sign_winding_number(cloth.mesh, p, reach + ROUNDING)
        sign = near.sign
    if not near.result:
        return
    away = sign * wp.length(p - wp.mesh_eval_position(cloth.mesh, near.face, near.u, near.v))
    if away < cloth.distance[at[0], at[1], at[2]]:
        cloth.distance[at[0], at[1], at[2]] = away
        part = int(cloth.parts[wp.mesh_get_index(cloth.mesh, 3 * near.face)])
        cloth.part[at[0], at[1], at[2]] = wp.uint8(part | ON_CLOTH)


@wp.kernel
def dress_fields(bodies: wp.array(dtype=DressedVoxels), band: float):
    """Fill ``distance`` and ``part``: of the skin, or of the garments less ``gap`` where these are nearer."""
    b, number = wp.tid()
    body = bodies[b]
    at = unravel_index(number, body.distance.shape[1], body.distance.shape[2])
    if at[0] >= body.distance.shape[0]:
        return
    in_field = at - body.first
    skin = distance_at(body.body, in_field, band)
    away = body.cloth[at[0], at[1], at[2]] - body.gap
    part = wp.uint8(0)
    if away < skin and skin >= UNDER_SKIN:
        skin = away
        part = body.cloth_part[at[0], at[1], at[2]]
    elif is_voxel_of(body.body, in_field):
        part = body.body_part[in_field[0], in_field[1], in_field[2]]
    body.distance[at[0], at[1], at[2]] = skin
    body.part[at[0], at[1], at[2]] = part
