"""Points, segments and triangles: nearest points, intersection test, separation distance."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def closest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Barycentric weights of a triangle's point nearest to ``p`` (Ericson, Real-Time Collision Detection, 5.1.5)."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return wp.vec3(1.0 - t, t, 0.0)
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return wp.vec3(1.0 - t, 0.0, t)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - t, t)
    total = va + vb + vc
    return wp.vec3(va / total, vb / total, vc / total)


@wp.func
def closest_on_edges(a0: wp.vec3, a1: wp.vec3, b0: wp.vec3, b1: wp.vec3) -> wp.vec2:
    """Parameters, 0 to 1, of the two nearest points of two segments (Ericson, 5.1.9)."""
    da = a1 - a0
    db = b1 - b0
    r = a0 - b0
    aa = wp.dot(da, da)
    bb = wp.dot(db, db)
    br = wp.dot(db, r)
    ar = wp.dot(da, r)
    ab = wp.dot(da, db)
    det = aa * bb - ab * ab
    s = 0.5
    if det > 1.0e-9 * aa * bb:  # else parallel
        s = wp.clamp((ab * br - ar * bb) / det, 0.0, 1.0)
    t = (ab * s + br) / wp.max(bb, 1.0e-12)
    if t < 0.0:
        t = 0.0
        s = wp.clamp(-ar / wp.max(aa, 1.0e-12), 0.0, 1.0)
    elif t > 1.0:
        t = 1.0
        s = wp.clamp((ab - ar) / wp.max(aa, 1.0e-12), 0.0, 1.0)
    return wp.vec2(s, t)


@wp.func
def segment_crosses(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> bool:
    """Whether segment pq intersects triangle abc (Möller–Trumbore, both ends included)."""
    along = q - p
    ab = b - a
    ac = c - a
    h = wp.cross(along, ac)
    det = wp.dot(ab, h)
    if wp.abs(det) < 1.0e-12:
        return False
    s = (p - a) / det
    u = wp.dot(s, h)
    if u < 0.0 or u > 1.0:
        return False
    g = wp.cross(s, ab)
    v = wp.dot(along, g)
    if v < 0.0 or u + v > 1.0:
        return False
    t = wp.dot(ac, g)
    return t >= 0.0 and t <= 1.0


@wp.func
def has_vertex(face: wp.vec3i, i: int) -> bool:
    return face[0] == i or face[1] == i or face[2] == i


@wp.func
def separation(gap_old: float, gap_new: float, thickness: float, max_old: float) -> float:
    """How far to push a pair apart [cm]: this substep's approach in full, and up to ``max_old`` of older overlap."""
    return wp.clamp(thickness - gap_new, 0.0, wp.max(gap_old - gap_new, 0.0) + max_old)
