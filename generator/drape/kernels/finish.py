"""Last phase: move cloth off the triangles of the skin and of worn garments, without new crossings of its own cloth.

The distance field has voxels of one centimetre; fingers and toes are finer. A vertex moves by less than half its
distance from other cloth, so that no contact can change sides.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import is_ignored, nearest_part, skin_distance
from gcd_dataset.generator.drape.kernels.crossing import SkinEdges, crosses_skin
from gcd_dataset.generator.drape.kernels.field import UNLIMITED
from gcd_dataset.generator.drape.kernels.geometry import closest_on_edges, closest_on_triangle, segment_crosses
from gcd_dataset.generator.drape.kernels.world import ClothArrays, Contacts, World, entries
from gcd_dataset.records import POSITION_STEP

wp.set_module_options({"enable_backward": False})

SHARE = 0.45  # largest move of a vertex, as a share of its distance from other cloth
STEPS = wp.constant(1.0 / POSITION_STEP)  # in a centimetre
CLEAR = 0.12  # cm, target distance from the skin
DEEPEST = 3.0  # cm: cloth deeper inside stays there


@wp.kernel
def reset_allowed_moves(
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    # state out
    allowed: wp.array(dtype=float),
):
    """Allow every vertex a share of the contact search's margin: cloth without a listed contact is further away."""
    i = wp.tid()
    allowed[i] = SHARE * worlds[cloth.vertex_world[i]].margin


@wp.kernel
def bound_moves(
    worlds: wp.array(dtype=World),
    contacts: Contacts,
    threads: int,
    # state in
    chosen: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state in and out
    allowed: wp.array(dtype=float),
):
    """Limit the allowed move of every vertex to a share of its distance from the cloth in its contacts."""
    w, thread = wp.tid()
    if chosen[w] == 0:
        return
    world = worlds[w]
    start = contacts.room * world.first
    for k in range(thread, entries(contacts.point_count, w, world, contacts), threads):
        pair = contacts.points[start + k]
        weights = closest_on_triangle(x[pair[0]], x[pair[1]], x[pair[2]], x[pair[3]])
        at = weights[0] * x[pair[1]] + weights[1] * x[pair[2]] + weights[2] * x[pair[3]]
        for corner in range(4):
            wp.atomic_min(allowed, pair[corner], SHARE * wp.length(x[pair[0]] - at))
    for k in range(thread, entries(contacts.edge_count, w, world, contacts), threads):
        pair = contacts.edges[start + k]
        st = closest_on_edges(x[pair[0]], x[pair[1]], x[pair[2]], x[pair[3]])
        between = wp.lerp(x[pair[2]], x[pair[3]], st[1]) - wp.lerp(x[pair[0]], x[pair[1]], st[0])
        for corner in range(4):
            wp.atomic_min(allowed, pair[corner], SHARE * wp.length(between))


@wp.func
def outward(skin: wp.uint64, p: wp.vec3) -> wp.vec3:
    """Direction out of the body at ``p``."""
    near = skin_distance(skin, p, UNLIMITED)
    return wp.vec3(near[0], near[1], near[2])


@wp.kernel
def mark_body_crossings(
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    # state in
    chosen: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    through: wp.array(dtype=int),
    height: wp.array(dtype=float),
):
    """Mark the ends of edges that cross the skin or a worn garment, in the chosen worlds.

    ``height``: how far the triangle of the worn garment stands out of the end, away from the skin [cm]. The distance
    from the garment does not tell the way out beside its hem: above the hem the way is outward, below it inward.
    """
    e = wp.tid()
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    w = cloth.vertex_world[i]
    if chosen[w] == 0:
        return
    if crosses_skin(cloth.body_mesh[w], x[i], x[j]):
        through[i] = 1
        through[j] = 1
    length = wp.length(x[j] - x[i])
    if length == 0.0:
        return
    along = (x[j] - x[i]) / length
    for k in range(worlds[w].worn.shape[0]):
        hit = wp.mesh_query_ray(worlds[w].worn[k], x[i], along, length)
        if hit.result:
            worn = wp.mesh_get(worlds[w].worn[k])
            out = outward(cloth.body_mesh[w], x[i] + hit.t * along)
            top = float(-UNLIMITED)
            for corner in range(3):
                top = wp.max(top, wp.dot(worn.points[worn.indices[3 * hit.face + corner]], out))
            for end in range(2):
                through[cloth.edges[e][end]] = 1
                wp.atomic_max(height, cloth.edges[e][end], top - wp.dot(x[cloth.edges[e][end]], out))


@wp.kernel
def measure_pierced_faces(
    # model
    cloth: ClothArrays,
    skins: wp.array(dtype=SkinEdges),
    bvh: wp.uint64,
    roots: wp.array(dtype=int),
    # state in
    chosen: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    through: wp.array(dtype=int),
    height: wp.array(dtype=float),
):
    """Mark the corners of faces pierced by edges of the skin or of worn garments.

    ``height``: how far the skin stands out there, or the edge of the worn garment out of the corner [cm].
    """
    number, e = wp.tid()
    skin = skins[number]
    w = skin.world
    if chosen[w] == 0 or e >= skin.ends.shape[0]:
        return
    ends = skin.ends[e]
    mesh = wp.mesh_get(skin.mesh)
    p = mesh.points[ends[0]]
    q = mesh.points[ends[1]]
    query = wp.bvh_query_aabb(bvh, wp.min(p, q), wp.max(p, q), roots[w])
    f = int(0)
    while wp.bvh_query_next(query, f):
        face = cloth.faces[f]
        a = x[face[0]]
        b = x[face[1]]
        c = x[face[2]]
        if not segment_crosses(p, q, a, b, c):
            continue
        across = wp.cross(b - a, c - a)
        at = wp.lerp(p, q, wp.dot(a - p, across) / wp.dot(q - p, across))
        near = wp.mesh_query_point_no_sign(skin.mesh, at, DEEPEST)
        if skin.mesh != cloth.body_mesh[w]:
            away = outward(cloth.body_mesh[w], at)
            top = wp.max(wp.dot(p, away), wp.dot(q, away))
            for corner in range(3):
                through[face[corner]] = 1
                wp.atomic_max(height, face[corner], top - wp.dot(x[face[corner]], away))
        elif near.result:
            normal = wp.mesh_eval_face_normal(skin.mesh, near.face)
            out = wp.max(wp.dot(p - at, normal), wp.dot(q - at, normal))
            for corner in range(3):
                through[face[corner]] = 1
                wp.atomic_max(height, face[corner], out)


@wp.kernel
def leave_skin(
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    # state in
    chosen: wp.array(dtype=int),
    through: wp.array(dtype=int),
    height: wp.array(dtype=float),
    allowed: wp.array(dtype=float),
    x_start: wp.array(dtype=wp.vec3),
    x_in: wp.array(dtype=wp.vec3),
    # state out
    x_out: wp.array(dtype=wp.vec3),
):
    """Move marked vertices outward, by the larger of two distances.

    The first brings the deepest sampled point of the vertex's edges out of the body. The second is the height by which
    the skin, or a worn garment, stands out of the vertex's faces.
    """
    i = wp.tid()
    w = cloth.vertex_world[i]
    p = x_in[i]
    x_out[i] = p
    if chosen[w] == 0 or through[i] == 0:
        return
    world = worlds[w]
    deepest = wp.vec4(0.0)
    for at in range(cloth.first_edge[i], cloth.first_edge[i + 1]):
        ends = cloth.edges[cloth.vertex_edges[at]]
        j = ends[0] + ends[1] - i
        for quarter in range(4):
            here = wp.lerp(p, x_in[j], 0.25 * float(quarter))
            part = nearest_part(world, here)
            if not is_ignored(cloth.ignored_parts[i] & cloth.ignored_parts[j], part):
                near = skin_distance(cloth.body_mesh[w], here, DEEPEST)
                if CLEAR - near[3] > deepest[3]:
                    deepest = wp.vec4(near[0], near[1], near[2], CLEAR - near[3])
    if height[i] > 0.0 and height[i] + CLEAR > deepest[3]:
        if not is_ignored(cloth.ignored_parts[i], nearest_part(world, p)):
            out = outward(cloth.body_mesh[w], p)
            deepest = wp.vec4(out[0], out[1], out[2], height[i] + CLEAR)
    moved = p + deepest[3] * wp.vec3(deepest[0], deepest[1], deepest[2]) - x_start[i]
    length = wp.length(moved)
    if length > allowed[i]:
        moved = moved * (allowed[i] / length)
    x_out[i] = x_start[i] + moved


@wp.kernel
def round_positions(
    cloth: ClothArrays,
    chosen: wp.array(dtype=int),
    # state in and out
    x: wp.array(dtype=wp.vec3),
):
    """Round the positions of the chosen worlds to multiples of 1 / ``STEPS``."""
    i = wp.tid()
    if chosen[cloth.vertex_world[i]] != 0:
        x[i] = wp.vec3(wp.rint(x[i][0] * STEPS), wp.rint(x[i][1] * STEPS), wp.rint(x[i][2] * STEPS)) / STEPS
