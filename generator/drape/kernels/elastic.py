"""Elastic forces, stretch and bending, by one gather per vertex.

Stretch: a spring along every mesh edge. In a fabric with a grain the springs of a face are coupled, which makes the
face an orthotropic sheet. Bending: the quadratic model of Bergou et al. (2006), a constant matrix. The thread of a
vertex reads its springs, then the vertices on which only its bending force depends, then its coupled faces. On a GPU
the rows of 32 vertices are interleaved for coalesced reads (H200, 924 000 vertices: 91 µs; with one array per quantity
172 µs; with contiguous rows 188 µs); on a CPU each row is contiguous.

Forces are evaluated at ``x + theta h v``, which damps in proportion to stiffness and hardly damps slow motions. With
this damping symplectic Euler is stable for ``(omega h)² (1 + 2 theta) < 4``.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

LOOK_AHEAD = 0.3  # theta, in substeps
SPREAD_FROM = wp.constant(0.5)  # share of the sewing time after which compressed cloth spreads
USUAL = wp.constant(6)  # neighbours of a vertex in a regular mesh: the least number of entries in a row


@wp.struct
class Spring:
    """The spring from a vertex to a neighbour, and the neighbour's bending weight."""

    vertex: int
    stiffness: float  # g/s²
    length: float  # cm, flat length
    bend: float  # g/s², weight in the bending force


@wp.struct
class Bend:
    """A vertex, not a neighbour, on which the bending force depends."""

    vertex: int
    weight: float  # g/s²


@wp.struct
class Corner:
    """Coupling of the edges of a face in a fabric with a grain, as stored at one of its vertices.

    The edges: "next" and "last" from the corner to the face's next and last vertex, "across" between these two.
    """

    next: int
    last: int
    lengths: wp.vec3  # cm, flat lengths of next, last and across
    next_last: float  # g/s², force along the next edge per stretch of the last edge, and vice versa
    next_across: float  # g/s², force along the next edge per stretch of the edge across, and vice versa
    last_across: float  # g/s², force along the last edge per stretch of the edge across, and vice versa


@wp.struct
class Rows:
    """The elastic forces on each vertex as a row of entries; ``lanes`` rows are interleaved, see ``entry``."""

    lanes: int
    width: int  # entries of a row
    springs: wp.array(dtype=Spring)
    start_length: wp.array(dtype=float)  # (as springs) length before sewing [cm]
    bends: wp.array(dtype=Bend)
    coupled: int  # 1 where any garment's fabric has a grain; else there are no corners
    corners: wp.array(dtype=Corner)
    corner_count: wp.array(dtype=int)  # (v)
    count: wp.array(dtype=wp.vec2i)  # (v) springs, bends
    bend_diagonal: wp.array(dtype=float)  # (v) weight of the vertex itself in its bending force [g/s²]


@wp.func
def entry(rows: Rows, i: int, k: int) -> int:
    """Index of entry ``k`` in the row of vertex ``i``."""
    return ((i // rows.lanes) * rows.width + k) * rows.lanes + i % rows.lanes


@wp.func
def spring_force(at: int, sewn: float, x: wp.vec3, rows: Rows, ahead: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Spring and bending force by one neighbour [g cm/s²]."""
    spring = rows.springs[at]
    rest = spring.length
    if sewn < 1.0:
        start = rows.start_length[at]
        if start < rest:  # compressed cloth spreads from SPREAD_FROM on, when the seams are nearly closed
            rest = wp.lerp(start, rest, wp.max(sewn - SPREAD_FROM, 0.0) / (1.0 - SPREAD_FROM))
        else:
            rest = wp.lerp(start, rest, sewn)
    y = ahead[spring.vertex]
    edge = y - x
    length = wp.length(edge)
    return (spring.stiffness * (length - rest) / wp.max(length, 1.0e-6)) * edge - spring.bend * y


@wp.func
def coupled_force(at: int, x: wp.vec3, rows: Rows, ahead: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Coupling force by one face: the pull along each edge follows from the stretches of the other two [g cm/s²]."""
    corner = rows.corners[at]
    to_next, to_last = ahead[corner.next] - x, ahead[corner.last] - x
    next_length, last_length = wp.length(to_next), wp.length(to_last)
    next_stretch, last_stretch = next_length - corner.lengths[0], last_length - corner.lengths[1]
    across_stretch = wp.length(to_last - to_next) - corner.lengths[2]
    next_pull = corner.next_last * last_stretch + corner.next_across * across_stretch
    last_pull = corner.next_last * next_stretch + corner.last_across * across_stretch
    return (next_pull / wp.max(next_length, 1.0e-6)) * to_next + (last_pull / wp.max(last_length, 1.0e-6)) * to_last


@wp.func
def elastic_force(i: int, sewn: float, rows: Rows, ahead: wp.array(dtype=wp.vec3)) -> wp.vec3:
    """Stretching and bending force on vertex ``i`` [g cm/s²].

    Every row has at least ``USUAL`` entries, padded with zero weights, so that the first loops do not diverge.
    """
    x = ahead[i]
    force = -rows.bend_diagonal[i] * x
    first = entry(rows, i, 0)
    for k in range(USUAL):
        force += spring_force(first + k * rows.lanes, sewn, x, rows, ahead)
    for k in range(USUAL):
        bend = rows.bends[first + k * rows.lanes]
        force -= bend.weight * ahead[bend.vertex]
    count = rows.count[i]
    for k in range(USUAL, count[0]):
        force += spring_force(first + k * rows.lanes, sewn, x, rows, ahead)
    for k in range(USUAL, count[1]):
        bend = rows.bends[first + k * rows.lanes]
        force -= bend.weight * ahead[bend.vertex]
    # Not during sewing: the coupling is linear in the strain, and seam edges are far longer than flat.
    if rows.coupled != 0 and sewn >= 1.0:
        for k in range(rows.corner_count[i]):
            force += coupled_force(first + k * rows.lanes, x, rows, ahead)
    return force
