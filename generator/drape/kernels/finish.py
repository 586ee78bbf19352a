"""The last phase: cloth that crosses the skin is moved off the skin itself, and cannot cross other cloth by it.

The distance field is a centimetre coarse; fingers and toes are finer. A vertex may move by less than half of its
distance from any cloth that it could meet, so that no two parts of the cloth can change sides.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import is_unseen, nearest_part
from gcd_dataset.generator.drape.kernels.crossing import crosses_skin
from gcd_dataset.generator.drape.kernels.geometry import closest_on_edges, closest_on_triangle
from gcd_dataset.generator.drape.kernels.world import Cloth, Contacts, World, entries

wp.set_module_options({"enable_backward": False})

SHARE = 0.45  # of the distance from other cloth, by which a vertex may move
CLEAR = 0.12  # cm from the skin that is aimed at
DEEPEST = 3.0  # cm: what is further inside is left there


@wp.kernel
def begin_finish(
    worlds: wp.array(dtype=World),
    cloth: Cloth,
    # state out
    free: wp.array(dtype=float),
):
    """Every vertex may move within the margin of the search to come."""
    i = wp.tid()
    free[i] = SHARE * worlds[cloth.vertex_world[i]].margin


@wp.kernel
def bound_moves(
    worlds: wp.array(dtype=World),
    contacts: Contacts,
    threads: int,
    # state in
    chosen: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state in and out
    free: wp.array(dtype=float),
):
    """Let no vertex move by more than a share of its distance from the cloth that is near it."""
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
            wp.atomic_min(free, pair[corner], SHARE * wp.length(x[pair[0]] - at))
    for k in range(thread, entries(contacts.edge_count, w, world, contacts), threads):
        pair = contacts.edges[start + k]
        st = closest_on_edges(x[pair[0]], x[pair[1]], x[pair[2]], x[pair[3]])
        between = wp.lerp(x[pair[2]], x[pair[3]], st[1]) - wp.lerp(x[pair[0]], x[pair[1]], st[0])
        for corner in range(4):
            wp.atomic_min(free, pair[corner], SHARE * wp.length(between))


@wp.kernel
def mark_body_crossings(
    cloth: Cloth,
    # state in
    chosen: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    through: wp.array(dtype=int),
):
    """Mark the ends of edges that cross the skin."""
    e = wp.tid()
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    w = cloth.vertex_world[i]
    if chosen[w] == 0:
        return
    if crosses_skin(cloth.body_mesh[w], x[i], x[j]):
        through[i] = 1
        through[j] = 1


@wp.func
def nearest_exit(mesh: wp.uint64, p: wp.vec3) -> wp.vec4:
    """Direction out of the body at ``p``, and how far to go until it is clear of the skin [1, cm]."""
    near = wp.mesh_query_point_sign_normal(mesh, p, DEEPEST)
    if not near.result:
        return wp.vec4(0.0)
    skin = wp.mesh_eval_position(mesh, near.face, near.u, near.v)
    away = (p - skin) * near.sign
    distance = wp.length(away)
    normal = wp.mesh_eval_face_normal(mesh, near.face)
    if distance > 1.0e-4:
        normal = away / distance
    return wp.vec4(normal[0], normal[1], normal[2], CLEAR - near.sign * distance)


@wp.kernel
def leave_skin(
    worlds: wp.array(dtype=World),
    cloth: Cloth,
    # state in
    chosen: wp.array(dtype=int),
    through: wp.array(dtype=int),
    free: wp.array(dtype=float),
    x_start: wp.array(dtype=wp.vec3),
    x_in: wp.array(dtype=wp.vec3),
    # state out
    x_out: wp.array(dtype=wp.vec3),
):
    """Move the ends of edges that cross the skin out of it, by what the deepest point of their edges needs."""
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
            part = nearest_part(world, cloth.field_parts, here)
            if not is_unseen(cloth.unseen_parts[i] & cloth.unseen_parts[j], part):
                out = nearest_exit(cloth.body_mesh[w], here)
                if out[3] > deepest[3]:
                    deepest = out
    moved = p + deepest[3] * wp.vec3(deepest[0], deepest[1], deepest[2]) - x_start[i]
    length = wp.length(moved)
    if length > free[i]:
        moved = moved * (free[i] / length)
    x_out[i] = x_start[i] + moved
