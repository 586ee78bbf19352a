"""How two layers of cloth lie on a body: edges of one through the other, and which of them is nearer to the skin."""

import warp as wp

from gcd_dataset.generator.drape.kernels.crossing import crosses_skin

wp.set_module_options({"enable_backward": False})

FURTHEST = wp.constant(1.0e3)  # cm
OUTWARD = wp.constant(30.0)  # cm: an outer garment further away than this does not cover a vertex
DEEP = wp.constant(1.0)  # cm: cloth is less deep under the skin; deeper points lie beyond the limb's end
TOUCHING = 1.0e-4  # cm: below this distance the normal of the skin replaces the direction from the skin
ARMS = wp.constant(2)  # the skins of both arms, the first rows of ``skins``, and then that of trunk and legs


@wp.kernel
def count_edges_through(
    points: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.vec2i),
    other: wp.uint64,
    # out
    count: wp.array(dtype=int),
):
    """Count the edges that cross a mesh."""
    ends = edges[wp.tid()]
    if crosses_skin(other, points[ends[0]], points[ends[1]]):
        wp.atomic_add(count, 0, 1)


@wp.func
def from_skin(skin: wp.uint64, p: wp.vec3) -> wp.vec4:
    """Direction from the nearest skin to ``p``, and distance [cm]; outward and 0 for a point under the skin."""
    near = wp.mesh_query_point_no_sign(skin, p, FURTHEST)
    if not near.result:
        return wp.vec4(0.0, 1.0, 0.0, FURTHEST)
    away = p - wp.mesh_eval_position(skin, near.face, near.u, near.v)
    outward = wp.mesh_eval_face_normal(skin, near.face)
    distance = wp.length(away)
    if distance < TOUCHING or (distance < DEEP and wp.dot(away, outward) < 0.0):
        return wp.vec4(outward[0], outward[1], outward[2], 0.0)
    return wp.vec4(away[0] / distance, away[1] / distance, away[2] / distance, distance)


@wp.func
def is_nearest(limb: int, skins: wp.array(dtype=wp.uint64), p: wp.vec3, reach: float) -> bool:
    """Whether no other of the first skins is nearer to ``p`` than that of ``limb``, at most ``reach`` away [cm]."""
    least = reach
    own = wp.mesh_query_point_no_sign(skins[limb], p, reach)
    if own.result:
        least = wp.length(p - wp.mesh_eval_position(skins[limb], own.face, own.u, own.v))
    for other in range(ARMS + 1):
        if other != limb:
            near = wp.mesh_query_point_no_sign(skins[other], p, least)
            if near.result:
                return False
    return True


@wp.kernel
def order_layers(
    skins: wp.array(dtype=wp.uint64),
    limbs: wp.array(dtype=int),
    points: wp.array(dtype=wp.vec3),
    outer: wp.uint64,
    # out
    covered: wp.array(dtype=int),
    wrong: wp.array(dtype=int),
):
    """Whether the outer garment lies before or behind each vertex of the inner one, and whether behind.

    Behind: between the vertex and the nearest skin of its limb, whose row of ``skins`` is in ``limbs``. Before: on the
    same line, outside the vertex. Cloth nearer to another limb does not count: a sleeve beside a trunk covers nothing.
    """
    i = wp.tid()
    p = points[i]
    skin = from_skin(skins[limbs[i]], p)
    outward = wp.vec3(skin[0], skin[1], skin[2])
    limb = wp.min(limbs[i], ARMS)
    behind = wp.mesh_query_ray(outer, p, -outward, skin[3])
    if behind.result and is_nearest(limb, skins, p - behind.t * outward, skin[3] + DEEP):
        covered[i] = 1
        wrong[i] = 1
        return
    before = wp.mesh_query_ray(outer, p, outward, OUTWARD)
    if before.result and is_nearest(limb, skins, p + before.t * outward, skin[3] + before.t + DEEP):
        covered[i] = 1
