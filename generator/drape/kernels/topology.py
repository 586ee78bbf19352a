"""Edges and hinges of a batch from its triangles, computed on the device of the batch.

Rest lengths and hinges come from the flat corner coordinates, whatever the placement of the panels. Sides
(``3 face + corner``, from that corner to the next) are sorted by their two vertices, so the sides of an edge are
adjacent. Where more than two panels meet along an edge, its first two faces form the hinge. Where panels are sewn to
each other along lines, each panel has an edge of its own between the same two vertices, with its own hinge.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.sheet import Sheet, bend_share, hinge_rigidity, springs_of

wp.set_module_options({"enable_backward": False})

LARGEST_BEND_WEIGHT = 8.0  # of a hinge with two corners of about 14°; hinges of sharper slivers are softened


@wp.struct
class ClothSurface:
    """The triangles of a batch, their edges, and the edges and faces of each vertex."""

    faces: wp.array(dtype=wp.vec3i)
    flat: wp.array2d(dtype=wp.vec2d)  # (f, 3) flat coordinates of the corners [cm]
    edges: wp.array(dtype=wp.vec2i)  # (e) lower and higher vertex, sorted by both
    opposite: wp.array(dtype=wp.vec2i)  # (e) opposite vertices in the first and second face; -1 for no second face
    side_edge: wp.array(dtype=int)  # (3 f) edge of each side
    vertex_faces: wp.array(dtype=int)  # faces of vertex v: entries first_face[v] to first_face[v + 1]
    first_face: wp.array(dtype=int)
    vertex_edges: wp.array(dtype=int)
    first_edge: wp.array(dtype=int)


@wp.struct
class Hinges:
    """Springs and hinges of the edges of a batch."""

    spring: wp.array(dtype=wp.vec3)  # (e) stiffness over the membrane stiffness; flat length; start length [1, cm, cm]
    weights: wp.array(dtype=wp.vec4)  # (e) weights of both ends and both opposite vertices in the bending vector
    scale: wp.array(dtype=float)  # (e) factor of the squared bending vector in the energy [g/s²]


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
    """Sort key of every side: lower vertex * 2^32 + higher vertex."""
    side = wp.tid()
    i = faces[side // 3][side % 3]
    j = faces[side // 3][(side + 1) % 3]
    keys[side] = wp.int64(wp.min(i, j)) * wp.int64(4294967296) + wp.int64(wp.max(i, j))
    sides[side] = side


@wp.kernel
def mark_firsts(
    panel: wp.array(dtype=int),
    keys: wp.array(dtype=wp.int64),
    # in and out
    sides: wp.array(dtype=int),
    # out
    firsts: wp.array(dtype=int),
):
    """1 at the first side of each edge among the sorted sides, else 0; ``panel``: the panel of each face.

    Of more than two sides between two vertices, two of one panel are an edge of their own, and are moved to the front.
    """
    s = wp.tid()
    if s > 0 and keys[s] == keys[wp.max(s - 1, 0)]:
        return
    end = int(s)
    while end < keys.shape[0]:
        if keys[end] != keys[s]:
            break
        firsts[end] = 0
        end += 1
    placed = int(s)
    if end > s + 2:
        for i in range(s, end):
            for j in range(i + 1, end):
                if i >= placed and panel[sides[i] // 3] == panel[sides[j] // 3]:
                    for k in range(2):
                        at = wp.where(k == 0, i, j)
                        side = sides[at]
                        sides[at] = sides[placed + k]
                        sides[placed + k] = side
                    firsts[placed] = 1
                    placed += 2
    if placed < end:
        firsts[placed] = 1


@wp.kernel
def count_edges(
    first_sides: wp.array(dtype=int),
    number: wp.array(dtype=int),
    # out
    edge_offset: wp.array(dtype=int),
):
    """First edge of each garment, from its first side and the scanned edge numbers of the sorted sides."""
    w = wp.tid()
    edge_offset[w] = 0
    if first_sides[w] > 0:
        edge_offset[w] = number[first_sides[w] - 1]


@wp.func
def cotangent(flat: wp.array2d(dtype=wp.vec2d), f: int, corner: int) -> wp.float64:
    """Cotangent of a face's angle at one of its corners."""
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
    # model
    start: wp.array(dtype=wp.vec3),
    vertex_world: wp.array(dtype=int),
    sheets: wp.array(dtype=Sheet),
    # sides by their edges
    keys: wp.array(dtype=wp.int64),
    sides: wp.array(dtype=int),
    number: wp.array(dtype=int),
    # in and out
    surface: ClothSurface,
    # out
    hinges: Hinges,
):
    """Fill the edges, opposite vertices and side edges of ``surface``, and the springs and hinges.

    Spring stiffness: the sum over the faces of area / length², times the face's spring factor (``springs_of``). Flat
    length: where a gathered seam joins edges of different length, the shorter length. Hinges: Bergou et al. (A
    Quadratic Bending Model for Inextensible Surfaces, 2006).
    """
    s = wp.tid()
    e = number[s] - 1
    surface.side_edge[sides[s]] = e
    if s > 0 and number[s] == number[wp.max(s - 1, 0)]:
        return
    low = int(keys[s] / wp.int64(4294967296))
    high = int(keys[s] % wp.int64(4294967296))
    surface.edges[e] = wp.vec2i(low, high)
    stiffness = wp.float64(0.0)
    shortest = wp.float64(1.0e30)
    area = wp.float64(0.0)
    across = wp.vec2i(-1, -1)
    ends = wp.vec2d(wp.float64(0.0), wp.float64(0.0))
    beside = wp.vec2d(wp.float64(0.0), wp.float64(0.0))
    share = wp.float64(0.0)
    sheet = sheets[vertex_world[low]]
    met = int(0)
    at = int(s)
    while at < number.shape[0]:
        if number[at] != number[s]:
            break
        f = sides[at] // 3
        corner = sides[at] % 3
        length_sq = wp.length_sq(surface.flat[f, (corner + 1) % 3] - surface.flat[f, corner])
        shortest = wp.min(shortest, wp.sqrt(length_sq))
        if sheet.grained != 0:
            stiffness += springs_of(surface.flat, f, sheet)[corner, corner] * flat_area(surface.flat, f) / length_sq
        else:
            stiffness += flat_area(surface.flat, f) / length_sq
        if met < 2:
            share += wp.float64(0.5) * bend_share(surface.flat, f, corner)
            across[met] = surface.faces[f][(corner + 2) % 3]
            here = cotangent(surface.flat, f, corner)
            there = cotangent(surface.flat, f, (corner + 1) % 3)
            beside[met] = -(here + there)
            if surface.faces[f][corner] == low:
                ends += wp.vec2d(there, here)
            else:
                ends += wp.vec2d(here, there)
            area += flat_area(surface.flat, f)
        met += 1
        at += 1
    surface.opposite[e] = across
    hinges.spring[e] = wp.vec3(float(stiffness), float(shortest), wp.length(start[high] - start[low]))
    hinges.weights[e] = wp.vec4(0.0)
    hinges.scale[e] = 0.0
    if met > 1:
        steepest = wp.max(wp.max(wp.abs(ends[0]), wp.abs(ends[1])), wp.max(wp.abs(beside[0]), wp.abs(beside[1])))
        softer = wp.min(wp.float64(LARGEST_BEND_WEIGHT) / wp.max(steepest, wp.float64(1.0e-12)), wp.float64(1.0))
        hinges.weights[e] = wp.vec4(float(ends[0]), float(ends[1]), float(beside[0]), float(beside[1]))
        hinges.scale[e] = hinge_rigidity(sheet, share) * float(wp.float64(3.0) * softer * softer / area)


@wp.kernel
def take_in(
    edges: wp.array(dtype=wp.vec2i),
    start: wp.array(dtype=wp.vec3),
    width: wp.array(dtype=float),
    # in and out
    spring: wp.array(dtype=wp.vec3),
):
    """Shorten the flat lengths across the body to the mean ``width`` of both ends, a share; panels start upright."""
    e = wp.tid()
    low = edges[e][0]
    high = edges[e][1]
    share = 0.5 * (width[low] + width[high])
    if share < 1.0:
        length = spring[e][1]
        down = wp.min(wp.abs(start[high][1] - start[low][1]), length)
        across = share * wp.sqrt(length * length - down * down)
        spring[e] = wp.vec3(spring[e][0], wp.length(wp.vec2(across, down)), spring[e][2])


@wp.kernel
def key_corners(
    faces: wp.array(dtype=wp.vec3i),
    # out
    keys: wp.array(dtype=int),
    owner: wp.array(dtype=int),
):
    """The vertex (key) and the face (owner) of every corner."""
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
    """The vertex (key) and the edge (owner) of every edge end."""
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
    """First entry of each vertex among entries sorted by vertex (CSR offsets); one more row than vertices."""
    s = wp.tid()
    here = int(first.shape[0] - 1)
    before = int(-1)
    if s < count:
        here = keys[s]
    if s > 0:
        before = keys[s - 1]
    for v in range(before + 1, here + 1):
        first[v] = s


@wp.kernel
def find_widest(
    first_edge: wp.array(dtype=int),
    first_face: wp.array(dtype=int),
    # out
    widest: wp.array(dtype=int),
):
    """The most edges, or faces, round a vertex."""
    v = wp.tid()
    most = wp.max(first_edge[v + 1] - first_edge[v], first_face[v + 1] - first_face[v])
    if most > widest[0]:
        wp.atomic_max(widest, 0, most)
