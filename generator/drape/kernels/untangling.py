"""Kernels of the untangling phase: implicit steps that move crossing layers of cloth apart.

Each step solves ``(M / h² + K + D) u = f`` for every garment with self-crossings. ``u`` are the displacements of the
vertices, ``h`` is the step length and ``M`` are the masses. ``K`` is the stiffness of springs and hinges, without the
compressive part of the springs, so that the matrix is positive definite. ``D`` is the diagonal stiffness of contacts
and crossings, in multiples of the garment's own stiffness (``World.stiffness``). ``f`` are the elastic forces, the
weight, and the forces of contacts and crossings. Contact forces are summed as integers (see ``push``) and dot products
in a fixed order, so a garment gets the same bytes alone and in any batch.
"""

import warp as wp

from gcd_dataset.generator.drape.kernels.body_contact import is_ignored, nearest_part, sample_field
from gcd_dataset.generator.drape.kernels.crossing import contour_direction
from gcd_dataset.generator.drape.kernels.elastic import Rows, elastic_force, entry
from gcd_dataset.generator.drape.kernels.geometry import (
    closest_on_edges,
    closest_on_triangle,
    has_vertex,
    segment_crosses,
)
from gcd_dataset.generator.drape.kernels.push import PUSH_SCALE, WEIGHT_SCALE, add_push, add_weight
from gcd_dataset.generator.drape.kernels.world import ClothArrays, Contacts, World, entries

wp.set_module_options({"enable_backward": False})

PARTIAL_SUMS = wp.constant(256)  # partial sums of a dot product over a garment, equally many on every device


@wp.struct
class Untangling:
    """Parameters of the phase. Stiffnesses and ``body_grip`` are multiples of ``World.stiffness``."""

    step: float  # s, length of a step
    crossing_stiffness: float  # of the spring by which a crossing displaces its edge and its face
    crossing_move: float  # cm, rest displacement of that spring: of the edge one way, of the face the other way
    point_stiffness: float  # point-triangle contacts
    edge_stiffness: float  # edge-edge contacts
    body_stiffness: float  # contact with the skin, in ``f``
    body_grip: float  # contact with the skin, in ``D``: resists displacements in every direction, sliding included
    max_move: float  # cm, largest displacement of a vertex in a step


@wp.struct
class Solve:
    """The linear system of a step, and the vectors of the conjugate gradient method."""

    residual: wp.array(dtype=wp.vec3)  # (v) [g cm/s²]
    diagonal: wp.array(dtype=float)  # (v) ``M / h² + D`` [g/s²]
    inverse: wp.array(dtype=wp.mat33)  # (v) inverse of the vertex's 3 × 3 diagonal block: the preconditioner [s²/g]
    move: wp.array(dtype=wp.vec3)  # (v) the solution [cm]
    direction: wp.array(dtype=wp.vec3)  # (v) search direction
    image: wp.array(dtype=wp.vec3)  # (v) matrix times search direction
    product: wp.array(dtype=float)  # (v) the vertices' terms of the current dot product
    partial: wp.array2d(dtype=float)  # (w, PARTIAL_SUMS) partial sums of ``product``
    norm: wp.array(dtype=float)  # (w) residual · inverse · residual
    factor: wp.array(dtype=float)  # (w) step length; after that, share of the old direction in the next


@wp.kernel
def push_crossings(
    # model
    cloth: ClothArrays,
    bvh: wp.uint64,
    roots: wp.array(dtype=int),
    phase: Untangling,
    # state in
    active: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    crossings: wp.array(dtype=int),
    push: wp.array2d(dtype=int),
):
    """Push crossing edges and faces along the gradient of the intersection contour; count the crossing edges.

    ``push`` accumulates displacements times relative stiffness, and relative stiffnesses.
    """
    e = wp.tid()
    i = cloth.edges[e][0]
    j = cloth.edges[e][1]
    w = cloth.vertex_world[i]
    if active[w] == 0:
        return
    p = x[i]
    q = x[j]
    query = wp.bvh_query_aabb(bvh, wp.min(p, q), wp.max(p, q), roots[w])
    f = int(0)
    crosses = int(0)
    while wp.bvh_query_next(query, f):
        face = cloth.faces[f]
        if has_vertex(face, i) or has_vertex(face, j):
            continue
        a = x[face[0]]
        b = x[face[1]]
        c = x[face[2]]
        if not segment_crosses(p, q, a, b, c):
            continue
        crosses = 1
        normal = wp.cross(b - a, c - a)
        t = wp.clamp(wp.dot(a - p, normal) / wp.dot(q - p, normal), 0.0, 1.0)
        weights = closest_on_triangle(wp.lerp(p, q, t), a, b, c)
        stiffness = phase.crossing_stiffness
        move = (stiffness * phase.crossing_move) * contour_direction(e, face, cloth, x)
        add_push(push, i, (1.0 - t) * move)
        add_push(push, j, t * move)
        add_weight(push, i, (1.0 - t) * stiffness)
        add_weight(push, j, t * stiffness)
        for corner in range(3):
            add_push(push, face[corner], -weights[corner] * move)
            add_weight(push, face[corner], weights[corner] * stiffness)
    if crosses != 0:
        wp.atomic_add(crossings, w, 1)


@wp.kernel
def push_contacts_apart(
    # model
    worlds: wp.array(dtype=World),
    contacts: Contacts,
    phase: Untangling,
    threads: int,
    # state in
    active: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    push: wp.array2d(dtype=int),
):
    """Push apart contact pairs that are nearer than the thickness; each element stays on its present side."""
    w, thread = wp.tid()
    if active[w] == 0:
        return
    world = worlds[w]
    start = contacts.room * world.first
    for k in range(thread, entries(contacts.point_count, w, world, contacts), threads):
        pair = contacts.points[start + k]
        a = x[pair[1]]
        b = x[pair[2]]
        c = x[pair[3]]
        weights = closest_on_triangle(x[pair[0]], a, b, c)
        away = x[pair[0]] - (weights[0] * a + weights[1] * b + weights[2] * c)
        gap = wp.length(away)
        if gap >= world.thickness or gap < 1.0e-6:
            continue
        stiffness = phase.point_stiffness
        move = (stiffness * (world.thickness - gap) / gap) * away
        add_push(push, pair[0], move)
        add_weight(push, pair[0], stiffness)
        for corner in range(3):
            add_push(push, pair[corner + 1], -weights[corner] * move)
            add_weight(push, pair[corner + 1], weights[corner] * stiffness)
    for k in range(thread, entries(contacts.edge_count, w, world, contacts), threads):
        pair = contacts.edges[start + k]
        st = closest_on_edges(x[pair[0]], x[pair[1]], x[pair[2]], x[pair[3]])
        between = wp.lerp(x[pair[2]], x[pair[3]], st[1]) - wp.lerp(x[pair[0]], x[pair[1]], st[0])
        gap = wp.length(between)
        if gap >= world.thickness or gap < 1.0e-6:
            continue
        stiffness = phase.edge_stiffness
        move = (stiffness * (world.thickness - gap) / gap) * between
        shares = wp.vec4(1.0 - st[0], st[0], 1.0 - st[1], st[1])
        for end in range(4):
            along = wp.where(end < 2, -shares[end], shares[end])
            add_push(push, pair[end], along * move)
            add_weight(push, pair[end], shares[end] * stiffness)


@wp.func
def spring_block(stiffness: float, length: float, edge: wp.vec3) -> wp.mat33:
    """Stiffness matrix of a spring at one of its ends, without the compressive part [g/s²]; ``length``: rest length."""
    distance = wp.max(wp.length(edge), 1.0e-6)
    along = edge / distance
    across = stiffness * wp.max(1.0 - length / distance, 0.0)
    return (stiffness - across) * wp.outer(along, along) + across * wp.identity(n=3, dtype=float)


@wp.kernel
def assemble(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    rows: Rows,
    phase: Untangling,
    # state in
    active: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state in and out
    push: wp.array2d(dtype=int),
    solve: Solve,
):
    """Compute the first residual and search direction and the diagonal blocks; clear ``push``."""
    i = wp.tid()
    w = cloth.vertex_world[i]
    if active[w] == 0:
        return
    world = worlds[w]
    p = x[i]
    asked = wp.vec3(float(push[i, 0]), float(push[i, 1]), float(push[i, 2])) / PUSH_SCALE
    diagonal = cloth.mass[i] / (phase.step * phase.step) + world.stiffness * float(push[i, 3]) / WEIGHT_SCALE
    for k in range(4):
        push[i, k] = 0
    force = elastic_force(i, 1.0, rows, x) + world.stiffness * asked
    force += wp.vec3(0.0, -cloth.mass[i] * world.gravity, 0.0)
    skin = sample_field(world, p)
    if skin[3] < world.body_gap and not is_ignored(cloth.ignored_parts[i], nearest_part(world, p)):
        depth = world.body_gap - skin[3]
        force += (world.stiffness * phase.body_stiffness * depth) * wp.vec3(skin[0], skin[1], skin[2])
        diagonal += world.stiffness * phase.body_grip
    block = (diagonal + rows.bend_diagonal[i]) * wp.identity(n=3, dtype=float)
    for k in range(rows.count[i][0]):
        spring = rows.springs[entry(rows, i, k)]
        block += spring_block(spring.stiffness, spring.length, x[spring.vertex] - p)
    inverse = wp.inverse(block)
    direction = inverse * force
    solve.diagonal[i] = diagonal
    solve.inverse[i] = inverse
    solve.residual[i] = force
    solve.move[i] = wp.vec3(0.0)
    solve.direction[i] = direction
    solve.product[i] = wp.dot(force, direction)


@wp.kernel
def multiply(
    # model
    cloth: ClothArrays,
    rows: Rows,
    # state in
    active: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state in and out
    solve: Solve,
):
    """Multiply the matrix by the search direction, and the result by the direction."""
    i = wp.tid()
    if active[cloth.vertex_world[i]] == 0:
        return
    own = solve.direction[i]
    image = (solve.diagonal[i] + rows.bend_diagonal[i]) * own
    count = rows.count[i]
    for k in range(count[0]):
        spring = rows.springs[entry(rows, i, k)]
        other = solve.direction[spring.vertex]
        image += spring_block(spring.stiffness, spring.length, x[spring.vertex] - x[i]) * (own - other)
        image += spring.bend * other
    for k in range(count[1]):
        bend = rows.bends[entry(rows, i, k)]
        image += bend.weight * solve.direction[bend.vertex]
    solve.image[i] = image
    solve.product[i] = wp.dot(own, image)


@wp.kernel
def sum_products(
    worlds: wp.array(dtype=World),
    # state in
    active: wp.array(dtype=int),
    # state in and out
    solve: Solve,
):
    """Sum ``product`` into ``partial``: partial sum ``k`` takes vertices ``k``, ``k + PARTIAL_SUMS`` etc."""
    w, lane = wp.tid()
    if active[w] == 0:
        return
    total = float(0.0)
    for k in range(lane, worlds[w].size, PARTIAL_SUMS):
        total += solve.product[worlds[w].first + k]
    solve.partial[w, lane] = total


@wp.func
def dot_product(w: int, solve: Solve) -> float:
    """The sum of ``product`` over a garment, from its partial sums."""
    total = float(0.0)
    for lane in range(PARTIAL_SUMS):
        total += solve.partial[w, lane]
    return total


@wp.kernel
def begin_solve(
    # state in
    active: wp.array(dtype=int),
    # state in and out
    solve: Solve,
):
    """Store the norm of the first residual."""
    w = wp.tid()
    if active[w] != 0:
        solve.norm[w] = dot_product(w, solve)


@wp.kernel
def find_step_length(
    # state in
    active: wp.array(dtype=int),
    # state in and out
    solve: Solve,
):
    """The step along the search direction that minimises the energy."""
    w = wp.tid()
    if active[w] != 0:
        curvature = dot_product(w, solve)
        solve.factor[w] = 0.0
        if curvature > 0.0:
            solve.factor[w] = solve.norm[w] / curvature


@wp.kernel
def advance(
    # model
    cloth: ClothArrays,
    # state in
    active: wp.array(dtype=int),
    # state in and out
    solve: Solve,
):
    """Add the step along the search direction to the solution, and subtract its image from the residual."""
    i = wp.tid()
    w = cloth.vertex_world[i]
    if active[w] == 0:
        return
    solve.move[i] = solve.move[i] + solve.factor[w] * solve.direction[i]
    residual = solve.residual[i] - solve.factor[w] * solve.image[i]
    solve.residual[i] = residual
    solve.product[i] = wp.dot(residual, solve.inverse[i] * residual)


@wp.kernel
def find_conjugate_share(
    # state in
    active: wp.array(dtype=int),
    # state in and out
    solve: Solve,
):
    """The share of the old search direction in the next (Fletcher and Reeves)."""
    w = wp.tid()
    if active[w] != 0:
        norm = dot_product(w, solve)
        solve.factor[w] = 0.0
        if solve.norm[w] > 0.0:
            solve.factor[w] = norm / solve.norm[w]
        solve.norm[w] = norm


@wp.kernel
def update_direction(
    # model
    cloth: ClothArrays,
    # state in
    active: wp.array(dtype=int),
    # state in and out
    solve: Solve,
):
    """The next search direction."""
    i = wp.tid()
    w = cloth.vertex_world[i]
    if active[w] != 0:
        solve.direction[i] = solve.inverse[i] * solve.residual[i] + solve.factor[w] * solve.direction[i]


@wp.kernel
def move_cloth(
    # model
    worlds: wp.array(dtype=World),
    cloth: ClothArrays,
    phase: Untangling,
    # state in
    active: wp.array(dtype=int),
    solve: Solve,
    # state in and out
    x: wp.array(dtype=wp.vec3),
):
    """Move every vertex by the solution, at most by ``max_move``.

    A vertex outside ``body_gap`` stays outside; one inside does not come nearer to the skin. Body parts that the vertex
    passes through do not count.
    """
    i = wp.tid()
    w = cloth.vertex_world[i]
    if active[w] == 0:
        return
    world = worlds[w]
    move = solve.move[i]
    distance = wp.length(move)
    if distance > phase.max_move:
        move = move * (phase.max_move / distance)
    before = sample_field(world, x[i])
    p = x[i] + move
    skin = sample_field(world, p)
    allowed = wp.min(before[3], world.body_gap)
    if skin[3] < allowed and not is_ignored(cloth.ignored_parts[i], nearest_part(world, p)):
        p += (allowed - skin[3]) * wp.vec3(skin[0], skin[1], skin[2])
    x[i] = p


@wp.kernel
def compare_crossings(
    # state in
    crossings: wp.array(dtype=int),
    # state in and out
    active: wp.array(dtype=int),
    least: wp.array(dtype=int),
    # state out
    improved: wp.array(dtype=int),
):
    """Mark the worlds with fewer crossings than in all steps before; deactivate worlds without crossings."""
    w = wp.tid()
    improved[w] = 0
    if active[w] == 0:
        return
    if crossings[w] < least[w]:
        least[w] = crossings[w]
        improved[w] = 1
    if crossings[w] == 0:
        active[w] = 0


@wp.kernel
def store_improved(
    # model
    cloth: ClothArrays,
    # state in
    improved: wp.array(dtype=int),
    x: wp.array(dtype=wp.vec3),
    # state out
    best: wp.array(dtype=wp.vec3),
):
    """Store the positions of the worlds marked by ``compare_crossings``."""
    i = wp.tid()
    if improved[cloth.vertex_world[i]] != 0:
        best[i] = x[i]
