"""What pulls and bends at each vertex, as rows of springs, hinges and corners, worked out where the batch lies."""

import warp as wp

from gcd_dataset.generator.drape.kernels.elastic import USUAL, Bend, Corner, Rows, Spring, entry
from gcd_dataset.generator.drape.kernels.sheet import Sheet, springs_of
from gcd_dataset.generator.drape.kernels.topology import flat_area

wp.set_module_options({"enable_backward": False})

TAPE = 10.0  # stiffness of an edge that keeps a garment up, over that of its cloth: it is taped or faced


@wp.func
def corner_stiffness(flat: wp.array2d(dtype=wp.vec2d), f: int, corner: int) -> float:
    """Largest eigenvalue of the two springs of a face at one of its corners, for a membrane of stiffness 1."""
    area = flat_area(flat, f)
    out = flat[f, (corner + 1) % 3] - flat[f, corner]
    back = flat[f, (corner + 2) % 3] - flat[f, corner]
    k = area / wp.length_sq(out)
    g = area / wp.length_sq(back)
    cos_sq = wp.dot(out, back) * wp.dot(out, back) / (wp.length_sq(out) * wp.length_sq(back))
    half = wp.float64(0.5)
    return float(half * (k + g) + wp.sqrt(half * half * (k - g) * (k - g) + k * g * cos_sq))


@wp.func
def grained_stiffness(flat: wp.array2d(dtype=wp.vec2d), f: int, corner: int, springs: wp.mat33d) -> float:
    """The same for a face of a fabric with a grain, coupled as it will be or not, whichever is stiffer.

    Three coupled corners can be half as stiff again, moving together, as two spring ends can.
    """
    area = flat_area(flat, f)
    last = (corner + 2) % 3
    out = flat[f, (corner + 1) % 3] - flat[f, corner]
    back = flat[f, last] - flat[f, corner]
    k = springs[corner, corner] * area / wp.length_sq(out)
    g = springs[last, last] * area / wp.length_sq(back)
    both = springs[corner, last] * area / (wp.length(out) * wp.length(back))
    cos = wp.dot(out, back) / (wp.length(out) * wp.length(back))
    half = wp.float64(0.5)
    apart = half * (k + g) + wp.sqrt(half * half * (k - g) * (k - g) + k * g * cos * cos)
    trace = k + g + wp.float64(2.0) * both * cos
    determinant = (k * g - both * both) * (wp.float64(1.0) - cos * cos)
    coupled = half * trace + wp.sqrt(wp.max(half * half * trace * trace - determinant, wp.float64(0.0)))
    return float(wp.max(apart, wp.float64(1.5) * coupled))


@wp.func
def corner_of(
    faces: wp.array(dtype=wp.vec3i),
    flat: wp.array2d(dtype=wp.vec2d),
    side_edge: wp.array(dtype=int),
    spring: wp.array(dtype=wp.vec3),
    f: int,
    corner: int,
    springs: wp.mat33d,
    membrane: float,
) -> Corner:
    """What couples the edges of a face, seen from one of its corners."""
    across = (corner + 1) % 3
    last = (corner + 2) % 3
    scale = wp.float64(membrane) * flat_area(flat, f)
    to_next = wp.length(flat[f, across] - flat[f, corner])
    to_last = wp.length(flat[f, last] - flat[f, corner])
    between = wp.length(flat[f, last] - flat[f, across])
    return Corner(
        faces[f][across],
        faces[f][last],
        wp.vec3(
            spring[side_edge[3 * f + corner]][1],
            spring[side_edge[3 * f + last]][1],
            spring[side_edge[3 * f + across]][1],
        ),
        float(scale * springs[corner, last] / (to_next * to_last)),
        float(scale * springs[corner, across] / (to_next * between)),
        float(scale * springs[last, across] / (to_last * between)),
    )


@wp.func
def spring_to(
    i: int,
    j: int,
    edges: wp.array(dtype=wp.vec2i),
    vertex_edges: wp.array(dtype=int),
    first_edge: wp.array(dtype=int),
) -> int:
    """The row of the spring from ``i`` to ``j``."""
    for at in range(first_edge[i], first_edge[i + 1]):
        ends = edges[vertex_edges[at]]
        if ends[0] == j or ends[1] == j:
            return at - first_edge[i]
    return -1


@wp.func
def hinge_weight(e: int, i: int, edges: wp.array(dtype=wp.vec2i), hinge: wp.array(dtype=wp.vec4)) -> float:
    """What vertex ``i`` weighs in a hinge that it belongs to as an end."""
    if edges[e][0] == i:
        return hinge[e][0]
    return hinge[e][1]


@wp.kernel
def weigh_rows(
    faces: wp.array(dtype=wp.vec3i),
    flat: wp.array2d(dtype=wp.vec2d),
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array(dtype=wp.vec2i),
    side_edge: wp.array(dtype=int),
    vertex_faces: wp.array(dtype=int),
    first_face: wp.array(dtype=int),
    vertex_edges: wp.array(dtype=int),
    first_edge: wp.array(dtype=int),
    spring: wp.array(dtype=wp.vec3),
    hinge: wp.array(dtype=wp.vec4),
    hinge_scale: wp.array(dtype=float),
    vertex_world: wp.array(dtype=int),
    keeper: wp.array(dtype=wp.uint8),
    sheets: wp.array(dtype=Sheet),
    # out
    mass: wp.array(dtype=float),
    stiffness: wp.array(dtype=float),
    rows: Rows,
):
    """One row of springs and bending weights for each vertex, by the fabric of its garment.

    A spring's stiffness is Van Gelder's (1998) for a membrane: stiffness × area / length², summed over its faces; that
    of the edges that keep a garment up is ``TAPE`` times as large. In a fabric with a grain it is the spring's own part
    of the face's energy (``springs_of``), and the rest of that couples the edges.
    ``stiffness`` over inertia bounds the squared frequencies, however the faces are turned: a spring's energy is at
    most twice that of its two ends moving alone, and the springs of a face lie in its plane.
    """
    i = wp.tid()
    sheet = sheets[vertex_world[i]]
    springs = first_edge[i + 1] - first_edge[i]
    bends = int(0)
    area = wp.float64(0.0)
    diagonal = float(0.0)
    stretching = float(0.0)
    for row in range(springs):
        e = vertex_edges[first_edge[i] + row]
        j = edges[e][0] + edges[e][1] - i
        k = sheet.membrane * spring[e][0]
        if keeper[i] != wp.uint8(0) and keeper[j] != wp.uint8(0):
            stretching += (TAPE - 1.0) * spring[e][0]
            k *= TAPE
        rows.springs[entry(rows, i, row)] = Spring(j, k, spring[e][1], 0.0)
        rows.start_length[entry(rows, i, row)] = spring[e][2]
    for row in range(springs):
        e = vertex_edges[first_edge[i] + row]
        own = hinge_scale[e] * hinge_weight(e, i, edges, hinge)
        if own == 0.0:
            continue
        j = edges[e][0] + edges[e][1] - i
        diagonal += own * hinge_weight(e, i, edges, hinge)
        rows.springs[entry(rows, i, row)].bend += own * hinge_weight(e, j, edges, hinge)
        for side in range(2):
            to = spring_to(i, opposite[e][side], edges, vertex_edges, first_edge)
            rows.springs[entry(rows, i, to)].bend += own * hinge[e][2 + side]
    for at in range(first_face[i], first_face[i + 1]):
        f = vertex_faces[at]
        area += flat_area(flat, f)
        corner = int(0)
        if faces[f][1] == i:
            corner = 1
        elif faces[f][2] == i:
            corner = 2
        if sheet.grained != 0:
            springs_here = springs_of(flat, f, sheet)
            stretching += grained_stiffness(flat, f, corner, springs_here)
            rows.corners[entry(rows, i, at - first_face[i])] = corner_of(
                faces, flat, side_edge, spring, f, corner, springs_here, sheet.membrane
            )
        else:
            stretching += corner_stiffness(flat, f, corner)
        e = side_edge[3 * f + (corner + 1) % 3]
        own_side = int(-1)
        if opposite[e][1] >= 0:
            if opposite[e][0] == i:
                own_side = 0
            elif opposite[e][1] == i:
                own_side = 1
        if own_side < 0:
            continue
        own = hinge_scale[e] * hinge[e][2 + own_side]
        diagonal += own * hinge[e][2 + own_side]
        for end in range(2):
            to = spring_to(i, edges[e][end], edges, vertex_edges, first_edge)
            rows.springs[entry(rows, i, to)].bend += own * hinge[e][end]
        rows.bends[entry(rows, i, bends)] = Bend(opposite[e][1 - own_side], own * hinge[e][3 - own_side])
        bends += 1
    for row in range(springs, USUAL):
        rows.springs[entry(rows, i, row)] = Spring(i, 0.0, 0.0, 0.0)
        rows.start_length[entry(rows, i, row)] = 0.0
    for row in range(bends, USUAL):
        rows.bends[entry(rows, i, row)] = Bend(i, 0.0)
    mass[i] = sheet.mass * float(area / wp.float64(3.0))
    if rows.coupled != 0:
        rows.corner_count[i] = sheet.grained * (first_face[i + 1] - first_face[i])
    rows.bend_diagonal[i] = diagonal
    rows.count[i] = wp.vec2i(springs, bends)
    bending = wp.abs(diagonal)
    for row in range(springs):
        bending += wp.abs(rows.springs[entry(rows, i, row)].bend)
    for row in range(bends):
        bending += wp.abs(rows.bends[entry(rows, i, row)].weight)
    stiffness[i] = 2.0 * sheet.membrane * stretching + bending


@wp.kernel
def add_inertia(
    vertex_world: wp.array(dtype=int),
    mass: wp.array(dtype=float),
    stiffness: wp.array(dtype=float),
    step_sq: wp.array(dtype=float),
    # out
    inertia: wp.array(dtype=float),
):
    """What resists acceleration: the mass, or more where the time step needs it to be stable."""
    i = wp.tid()
    inertia[i] = wp.max(mass[i], stiffness[i] * step_sq[vertex_world[i]])
