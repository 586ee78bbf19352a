"""What a batch's triangles say about its edges and hinges, worked out where the batch lies.

Everything is taken from the flat corner coordinates of the faces, so it does not matter where the panels stand. Sides
(``3 face + corner``, from that corner to the next) are sorted by their two vertices; those of one edge then lie beside
each other. Where more than two panels meet along an edge, its first two faces make the hinge.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.elastic import USUAL, Bend, Corner, Rows, Spring, entry
from gcd_dataset.generator.drape.kernels.sheet import Sheet, bend_share, hinge_rigidity, springs_of

wp.set_module_options({"enable_backward": False})

TAPE = 10.0  # stiffness of an edge that keeps a garment up, over that of its cloth: it is taped or faced
LARGEST_BEND_WEIGHT = 8.0  # about two corners of 14°: hinges of sharper slivers bend more easily than they should


@wp.kernel
def lay_flat(
    corners: wp.array(dtype=wp.vec3i),
    uv: wp.array(dtype=wp.vec2d),
    # out
    flat: wp.array2d(dtype=wp.vec2d),
):
    """Flat coordinates of the corners of every face [cm]."""
    f = wp.tid()
    for k in range(3):
        flat[f, k] = uv[corners[f][k]]


@wp.kernel
def key_sides(
    faces: wp.array(dtype=wp.vec3i),
    # out
    keys: wp.array(dtype=wp.int64),
    sides: wp.array(dtype=int),
):
    """The lower and the higher vertex of every side, as one number."""
    side = wp.tid()
    i = faces[side // 3][side % 3]
    j = faces[side // 3][(side + 1) % 3]
    keys[side] = wp.int64(wp.min(i, j)) * wp.int64(4294967296) + wp.int64(wp.max(i, j))
    sides[side] = side


@wp.kernel
def mark_firsts(
    keys: wp.array(dtype=wp.int64),
    # out
    firsts: wp.array(dtype=int),
):
    """1 where an edge begins among the sorted sides."""
    s = wp.tid()
    firsts[s] = int(s == 0 or keys[s] != keys[wp.max(s - 1, 0)])


@wp.kernel
def count_edges(
    first_sides: wp.array(dtype=int),
    number: wp.array(dtype=int),
    # out
    edge_offset: wp.array(dtype=int),
):
    """Edges before each garment, whose sides begin at ``first_sides``."""
    w = wp.tid()
    edge_offset[w] = 0
    if first_sides[w] > 0:
        edge_offset[w] = number[first_sides[w] - 1]


@wp.func
def cotangent(flat: wp.array2d(dtype=wp.vec2d), f: int, corner: int) -> wp.float64:
    """Of the angle of a face at one of its corners."""
    a = flat[f, corner]
    out = flat[f, (corner + 1) % 3] - a
    back = flat[f, (corner + 2) % 3] - a
    across = wp.abs(out[0] * back[1] - out[1] * back[0])
    return wp.dot(out, back) / wp.max(across, wp.float64(1.0e-12))


@wp.func
def flat_area(flat: wp.array2d(dtype=wp.vec2d), f: int) -> wp.float64:
    out = flat[f, 1] - flat[f, 0]
    back = flat[f, 2] - flat[f, 0]
    return wp.float64(0.5) * wp.abs(out[0] * back[1] - out[1] * back[0])


@wp.kernel
def describe_edges(
    faces: wp.array(dtype=wp.vec3i),
    flat: wp.array2d(dtype=wp.vec2d),
    start: wp.array(dtype=wp.vec3),
    keys: wp.array(dtype=wp.int64),
    sides: wp.array(dtype=int),
    number: wp.array(dtype=int),
    vertex_world: wp.array(dtype=int),
    sheets: wp.array(dtype=Sheet),
    # out
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array(dtype=wp.vec2i),
    spring: wp.array(dtype=wp.vec3),
    hinge: wp.array(dtype=wp.vec4),
    hinge_scale: wp.array(dtype=float),
    side_edge: wp.array(dtype=int),
):
    """Ends, vertices across, spring (area over squared length summed over the faces, each times its spring's share of
    the membrane stiffness; flat length, the shorter where a gathered seam joins two; start length) and hinge of every
    edge.

    A hinge is Bergou et al.'s (A Quadratic Bending Model for Inextensible Surfaces, 2006): the weights of the ends and
    of the vertices across in its bending vector, and the factor of its square in the energy [g cm²/s² over cm²].
    """
    s = wp.tid()
    e = number[s] - 1
    side_edge[sides[s]] = e
    if s > 0 and keys[s] == keys[wp.max(s - 1, 0)]:
        return
    low = int(keys[s] / wp.int64(4294967296))
    high = int(keys[s] % wp.int64(4294967296))
    edges[e] = wp.vec2i(low, high)
    spread = wp.float64(0.0)
    shortest = wp.float64(1.0e30)
    area = wp.float64(0.0)
    across = wp.vec2i(-1, -1)
    ends = wp.vec2d(wp.float64(0.0), wp.float64(0.0))
    beside = wp.vec2d(wp.float64(0.0), wp.float64(0.0))
    share = wp.float64(0.0)
    sheet = sheets[vertex_world[low]]
    met = int(0)
    at = int(s)
    while at < keys.shape[0]:
        if keys[at] != keys[s]:
            break
        f = sides[at] // 3
        corner = sides[at] % 3
        length_sq = wp.length_sq(flat[f, (corner + 1) % 3] - flat[f, corner])
        shortest = wp.min(shortest, wp.sqrt(length_sq))
        if sheet.grained != 0:
            spread += springs_of(flat, f, sheet)[corner, corner] * flat_area(flat, f) / length_sq
        else:
            spread += flat_area(flat, f) / length_sq
        if met < 2:
            share += wp.float64(0.5) * bend_share(flat, f, corner)
            across[met] = faces[f][(corner + 2) % 3]
            here = cotangent(flat, f, corner)
            there = cotangent(flat, f, (corner + 1) % 3)
            beside[met] = -(here + there)
            if faces[f][corner] == low:
                ends += wp.vec2d(there, here)
            else:
                ends += wp.vec2d(here, there)
            area += flat_area(flat, f)
        met += 1
        at += 1
    opposite[e] = across
    spring[e] = wp.vec3(float(spread), float(shortest), wp.length(start[high] - start[low]))
    hinge[e] = wp.vec4(0.0)
    hinge_scale[e] = 0.0
    if met > 1:
        steepest = wp.max(wp.max(wp.abs(ends[0]), wp.abs(ends[1])), wp.max(wp.abs(beside[0]), wp.abs(beside[1])))
        softer = wp.min(wp.float64(LARGEST_BEND_WEIGHT) / wp.max(steepest, wp.float64(1.0e-12)), wp.float64(1.0))
        hinge[e] = wp.vec4(float(ends[0]), float(ends[1]), float(beside[0]), float(beside[1]))
        hinge_scale[e] = hinge_rigidity(sheet, share) * float(wp.float64(3.0) * softer * softer / area)


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


@wp.kernel
def key_corners(
    faces: wp.array(dtype=wp.vec3i),
    # out
    keys: wp.array(dtype=int),
    owner: wp.array(dtype=int),
):
    """The vertex and the face of every corner."""
    c = wp.tid()
    keys[c] = faces[c // 3][c % 3]
    owner[c] = c // 3


@wp.kernel
def key_ends(
    edges: wp.array(dtype=wp.vec2i),
    # out
    keys: wp.array(dtype=int),
    owner: wp.array(dtype=int),
):
    """The vertex and the edge of every end."""
    c = wp.tid()
    keys[c] = edges[c // 2][c % 2]
    owner[c] = c // 2


@wp.kernel
def find_firsts(
    keys: wp.array(dtype=int),
    count: int,
    # out
    first: wp.array(dtype=int),
):
    """Where the entries of each vertex begin among those sorted by vertex; one more row than vertices."""
    s = wp.tid()
    here = int(first.shape[0] - 1)
    before = int(-1)
    if s < count:
        here = keys[s]
    if s > 0:
        before = keys[s - 1]
    for v in range(before + 1, here + 1):
        first[v] = s


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
