"""Assemble the rows of springs, bending weights and corners of each vertex, on the device of the batch."""

import warp as wp

from gcd_dataset.generator.drape.kernels.elastic import USUAL, Bend, Corner, Rows, Spring, entry
from gcd_dataset.generator.drape.kernels.sheet import Sheet, springs_of
from gcd_dataset.generator.drape.kernels.topology import ClothSurface, Hinges, flat_area

wp.set_module_options({"enable_backward": False})

TAPE = 10.0  # stiffness factor of edges between keepers (``find_keepers``): tailors tape or face such borders


@wp.func
def corner_stiffness(flat: wp.array2d(dtype=wp.vec2d), f: int, corner: int) -> float:
    """Largest eigenvalue of a face's two springs at one of its corners, for membrane stiffness 1."""
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
    """``corner_stiffness`` for a fabric with a grain: the larger of the bounds for coupled and uncoupled springs.

    The factor 3/2 is for the coupled case: three corners move together, instead of two ends of a spring.
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
    surface: ClothSurface, hinges: Hinges, f: int, corner: int, springs: wp.mat33d, membrane: float
) -> Corner:
    """Coupling between the edges of a face, for one of its corners."""
    across = (corner + 1) % 3
    last = (corner + 2) % 3
    scale = wp.float64(membrane) * flat_area(surface.flat, f)
    to_next = wp.length(surface.flat[f, across] - surface.flat[f, corner])
    to_last = wp.length(surface.flat[f, last] - surface.flat[f, corner])
    between = wp.length(surface.flat[f, last] - surface.flat[f, across])
    return Corner(
        surface.faces[f][across],
        surface.faces[f][last],
        wp.vec3(
            hinges.spring[surface.side_edge[3 * f + corner]][1],
            hinges.spring[surface.side_edge[3 * f + last]][1],
            hinges.spring[surface.side_edge[3 * f + across]][1],
        ),
        float(scale * springs[corner, last] / (to_next * to_last)),
        float(scale * springs[corner, across] / (to_next * between)),
        float(scale * springs[last, across] / (to_last * between)),
    )


@wp.func
def corner_at(face: wp.vec3i, i: int) -> int:
    """The corner of a face at which vertex ``i`` lies."""
    if face[1] == i:
        return 1
    if face[2] == i:
        return 2
    return 0


@wp.func
def side_across(opposite: wp.vec2i, i: int) -> int:
    """The face of a hinge, 0 or 1, with vertex ``i`` opposite the edge; -1 if neither, or for an edge of one face."""
    if opposite[1] >= 0:
        if opposite[0] == i:
            return 0
        if opposite[1] == i:
            return 1
    return -1


@wp.func
def spring_to(i: int, j: int, surface: ClothSurface) -> int:
    """Position of the spring from ``i`` to ``j`` in the row of ``i``."""
    for at in range(surface.first_edge[i], surface.first_edge[i + 1]):
        ends = surface.edges[surface.vertex_edges[at]]
        if ends[0] == j or ends[1] == j:
            return at - surface.first_edge[i]
    return -1


@wp.func
def end_weight(e: int, i: int, surface: ClothSurface, hinges: Hinges) -> float:
    """Weight of end ``i`` of a hinge in its bending vector."""
    if surface.edges[e][0] == i:
        return hinges.weights[e][0]
    return hinges.weights[e][1]


@wp.func
def fill_springs(
    i: int, sheet: Sheet, surface: ClothSurface, hinges: Hinges, keeper: wp.array(dtype=wp.uint8), rows: Rows
):
    """Write the springs of a vertex, without bending; returns the stiffness added by ``TAPE`` over the membrane's."""
    stiffer = float(0.0)
    for row in range(surface.first_edge[i + 1] - surface.first_edge[i]):
        e = surface.vertex_edges[surface.first_edge[i] + row]
        j = surface.edges[e][0] + surface.edges[e][1] - i
        k = sheet.membrane * hinges.spring[e][0]
        if keeper[i] != wp.uint8(0) and keeper[j] != wp.uint8(0):
            stiffer += (TAPE - 1.0) * hinges.spring[e][0]
            k *= TAPE
        rows.springs[entry(rows, i, row)] = Spring(j, k, hinges.spring[e][1], 0.0)
        rows.start_length[entry(rows, i, row)] = hinges.spring[e][2]
    return stiffer


@wp.func
def add_end_bending(i: int, surface: ClothSurface, hinges: Hinges, rows: Rows):
    """Add the bending weights of the hinges at a vertex to its springs; returns their sum for the diagonal."""
    diagonal = float(0.0)
    for row in range(surface.first_edge[i + 1] - surface.first_edge[i]):
        e = surface.vertex_edges[surface.first_edge[i] + row]
        own = hinges.scale[e] * end_weight(e, i, surface, hinges)
        if own == 0.0:
            continue
        j = surface.edges[e][0] + surface.edges[e][1] - i
        diagonal += own * end_weight(e, i, surface, hinges)
        rows.springs[entry(rows, i, row)].bend += own * end_weight(e, j, surface, hinges)
        for side in range(2):
            to = spring_to(i, surface.opposite[e][side], surface)
            rows.springs[entry(rows, i, to)].bend += own * hinges.weights[e][2 + side]
    return diagonal


@wp.func
def pad_row(i: int, springs: int, bends: int, rows: Rows):
    """Pad the row of a vertex to ``USUAL`` entries with zero weights."""
    for row in range(springs, USUAL):
        rows.springs[entry(rows, i, row)] = Spring(i, 0.0, 0.0, 0.0)
        rows.start_length[entry(rows, i, row)] = 0.0
    for row in range(bends, USUAL):
        rows.bends[entry(rows, i, row)] = Bend(i, 0.0)


@wp.func
def bending_bound(i: int, springs: int, bends: int, diagonal: float, rows: Rows) -> float:
    """Sum of the absolute bending weights in the row of a vertex (Gershgorin)."""
    bending = wp.abs(diagonal)
    for row in range(springs):
        bending += wp.abs(rows.springs[entry(rows, i, row)].bend)
    for row in range(bends):
        bending += wp.abs(rows.bends[entry(rows, i, row)].weight)
    return bending


@wp.kernel
def weigh_rows(
    # model
    surface: ClothSurface,
    hinges: Hinges,
    vertex_world: wp.array(dtype=int),
    keeper: wp.array(dtype=wp.uint8),
    sheets: wp.array(dtype=Sheet),
    # out
    mass: wp.array(dtype=float),
    stiffness: wp.array(dtype=float),
    rows: Rows,
):
    """Assemble the row of each vertex from the fabric of its garment; also its mass and stiffness bound.

    Spring stiffness after Van Gelder (1998): membrane stiffness × area / length², summed over the faces of the edge;
    ``TAPE`` times as much between keepers. In a fabric with a grain it is the diagonal of the face's energy
    (``springs_of``), whose other entries couple the edges.

    ``stiffness`` over inertia bounds the squared angular frequencies at any orientation of the faces: a spring's energy
    is at most twice the sum of its energies with one end moving alone, and the springs of a face lie in its plane.
    """
    i = wp.tid()
    sheet = sheets[vertex_world[i]]
    first_face = surface.first_face[i]
    springs = surface.first_edge[i + 1] - surface.first_edge[i]
    bends = int(0)
    area = wp.float64(0.0)
    stretching = float(0.0)
    stretching += fill_springs(i, sheet, surface, hinges, keeper, rows)
    diagonal = float(0.0)
    diagonal += add_end_bending(i, surface, hinges, rows)
    for at in range(first_face, surface.first_face[i + 1]):
        f = surface.vertex_faces[at]
        area += flat_area(surface.flat, f)
        corner = corner_at(surface.faces[f], i)
        if sheet.grained != 0:
            springs_here = springs_of(surface.flat, f, sheet)
            stretching += grained_stiffness(surface.flat, f, corner, springs_here)
            rows.corners[entry(rows, i, at - first_face)] = corner_of(
                surface, hinges, f, corner, springs_here, sheet.membrane
            )
        else:
            stretching += corner_stiffness(surface.flat, f, corner)
        e = surface.side_edge[3 * f + (corner + 1) % 3]
        own_side = side_across(surface.opposite[e], i)
        if own_side < 0:
            continue
        own = hinges.scale[e] * hinges.weights[e][2 + own_side]
        diagonal += own * hinges.weights[e][2 + own_side]
        for end in range(2):
            to = spring_to(i, surface.edges[e][end], surface)
            rows.springs[entry(rows, i, to)].bend += own * hinges.weights[e][end]
        rows.bends[entry(rows, i, bends)] = Bend(
            surface.opposite[e][1 - own_side], own * hinges.weights[e][3 - own_side]
        )
        bends += 1
    pad_row(i, springs, bends, rows)
    mass[i] = sheet.mass * float(area / wp.float64(3.0))
    if rows.coupled != 0:
        rows.corner_count[i] = sheet.grained * (surface.first_face[i + 1] - first_face)
    rows.bend_diagonal[i] = diagonal
    rows.count[i] = wp.vec2i(springs, bends)
    stiffness[i] = 2.0 * sheet.membrane * stretching + bending_bound(i, springs, bends, diagonal, rows)


@wp.kernel
def free_hinges(
    folds: wp.array(dtype=wp.vec2i),
    surface: ClothSurface,
    # out
    hinges: Hinges,
):
    """No bending back at folds; of several edges between two vertices the first is that of two layers of a panel."""
    fold = folds[wp.tid()]
    for at in range(surface.first_edge[fold[0]], surface.first_edge[fold[0] + 1]):
        e = surface.vertex_edges[at]
        if surface.edges[e][0] + surface.edges[e][1] == fold[0] + fold[1]:
            hinges.scale[e] = 0.0
            return


@wp.kernel
def press_folds(
    apexes: wp.array(dtype=wp.vec2i),
    springs: wp.array(dtype=wp.vec3),
    # out
    stiffness: wp.array(dtype=float),
    rows: Rows,
):
    """Add the springs across folds, stiffness, rest and start length, to the rows of both ends; by one thread."""
    for k in range(apexes.shape[0]):
        for end in range(2):
            i = apexes[k][end]
            count = rows.count[i]
            at = entry(rows, i, count[0])
            rows.springs[at] = Spring(apexes[k][1 - end], springs[k][0], springs[k][1], 0.0)
            rows.start_length[at] = springs[k][2]
            rows.count[i] = wp.vec2i(count[0] + 1, count[1])
            stiffness[i] += 2.0 * springs[k][0]


@wp.kernel
def sample_scales(
    rows: wp.array(dtype=int),
    of_vertices: int,
    mass: wp.array(dtype=float),
    stiffness: wp.array(dtype=float),
    spring: wp.array(dtype=wp.vec3),
    # out
    scales: wp.array(dtype=wp.vec2),
):
    """Mass and stiffness of the first ``of_vertices`` rows, which are vertices; flat length of the others, edges."""
    k = wp.tid()
    if k < of_vertices:
        scales[k] = wp.vec2(mass[rows[k]], stiffness[rows[k]])
    else:
        scales[k] = wp.vec2(spring[rows[k]][1], 0.0)


@wp.kernel
def add_inertia(
    vertex_world: wp.array(dtype=int),
    mass: wp.array(dtype=float),
    stiffness: wp.array(dtype=float),
    step_sq: wp.array(dtype=float),
    # out
    inertia: wp.array(dtype=float),
):
    """Inertial mass: the mass, or more where the time step would be unstable."""
    i = wp.tid()
    inertia[i] = wp.max(mass[i], stiffness[i] * step_sq[vertex_world[i]])
