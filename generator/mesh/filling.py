"""The kernels that fill an outline with points and triangles, on one thread of the CPU.

A triangle's sides are 0, 1 and 2; side ``k`` runs from corner ``k`` to the next one. ``beside[f, k]`` is the triangle
beyond side ``k`` of triangle ``f``, ``OUTSIDE`` at the outline. Triangles and outline are counter-clockwise.
"""

import warp as wp

from gcd_dataset.generator.mesh.triangulate import PITCH, ROW

f64 = wp.float64
OUTSIDE = wp.constant(-1)
ROUNDS = wp.constant(10)  # of refinement, at most; a seam gathered to a third of the spacing takes four
ZERO, HALF, TWO = wp.constant(f64(0.0)), wp.constant(f64(0.5)), wp.constant(f64(2.0))
PITCH_64, ROW_64 = wp.constant(f64(PITCH)), wp.constant(f64(ROW))
CLEAR = wp.constant(f64(0.60))  # pitches: least distance of a lattice point from border points and middles of segments
APART = wp.constant(f64(0.80))  # circumradii: least distance of a seed of the refinement from all points
FLAT = wp.constant(f64(1.0e-10))  # square spacings: twice the area of a triangle of points on a line, but for rounding
THIN = wp.constant(f64(1.0e-9))  # spacings: where a triangle is less high, the outline touches itself
CLEARLY = wp.constant(f64(1.0e-9))  # square spacings: twice the area between a side and a point that is not on it
EQUAL = wp.constant(f64(1.0e-12))  # relative: a point so near to a circle lies on it
LONGEST_WALK = wp.constant(64)  # triangles; then all are searched

Points = wp.array(dtype=wp.vec2d)
Numbers = wp.array(dtype=wp.int32)
Rows = wp.array2d(dtype=wp.int32)
Reals = wp.array(dtype=wp.float64)

wp.set_module_options({"enable_backward": False})


@wp.func
def turn(a: wp.vec2d, b: wp.vec2d, c: wp.vec2d) -> f64:
    """Twice the area of a triangle, positive if it is counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@wp.func
def corner(points: Points, faces: Rows, face: int, k: int) -> wp.vec2d:
    return points[faces[face, k % 3]]


@wp.func
def in_circle(a: wp.vec2d, b: wp.vec2d, c: wp.vec2d, p: wp.vec2d) -> bool:
    """Whether a point lies inside the circumcircle of a triangle; rounding puts no point of the circle inside."""
    a = a - p
    b = b - p
    c = c - p
    aa = wp.dot(a, a)
    bb = wp.dot(b, b)
    cc = wp.dot(c, c)
    inside = aa * (b[0] * c[1] - b[1] * c[0]) - bb * (a[0] * c[1] - a[1] * c[0]) + cc * (a[0] * b[1] - a[1] * b[0])
    return inside > EQUAL * (aa * (bb + cc) + bb * cc)


@wp.func
def set_face(faces: Rows, face: int, a: int, b: int, c: int):
    faces[face, 0] = a
    faces[face, 1] = b
    faces[face, 2] = c


@wp.func
def is_convex(points: Points, a: int, k: int, b: int, slack: f64) -> int:
    return wp.where(turn(points[a], points[k], points[b]) > slack, 1, 0)


@wp.func
def clip_ears(
    points: Points,
    faces: Rows,
    beside: Rows,
    before: Numbers,
    after: Numbers,
    convex: Numbers,
    over: Numbers,
    n: int,
    spacing: f64,
) -> int:
    """Triangulate the outline of the first ``n`` points by clipping ears (Meisters, 1975); returns their number.

    If the outline touches itself, -1 - k, where point k is on a side of the last ear tried or in it. ``over``: the
    triangle over the segment from each point of what is left.
    """
    for k in range(n):
        before[k] = (k + n - 1) % n
        after[k] = (k + 1) % n
        over[k] = OUTSIDE
    slack = FLAT * spacing * spacing
    for k in range(n):
        convex[k] = is_convex(points, before[k], k, after[k], slack)
    count = int(0)
    left = int(n)
    missed = int(0)
    in_the_way = int(0)
    k = int(0)
    while count < n - 2:
        a = before[k]
        b = after[k]
        is_ear = convex[k] == 1
        q = int(after[b])
        while is_ear and q != a:
            # Only a point where the outline is not convex can be the first inside an ear.
            if convex[q] == 0:
                p = points[q]
                # Most points lie beyond the diagonal. Nested, since all operands of ``and`` are computed. Without slack
                # points on a line with the diagonal may be left over, and no triangle joins them.
                if turn(points[b], points[a], p) >= -slack:
                    if turn(points[a], points[k], p) >= -slack:
                        if turn(points[k], points[b], p) >= -slack:
                            is_ear = False
                            in_the_way = q
            q = after[q]
        if is_ear:
            set_face(faces, count, a, k, b)
            set_face(beside, count, over[a], over[k], OUTSIDE)
            if left == 3:
                beside[count, 2] = over[b]
            for side in range(3):
                if beside[count, side] >= 0:
                    beside[beside[count, side], 2] = count
            over[a] = count
            after[a] = b
            before[b] = a
            convex[a] = is_convex(points, before[a], a, b, slack)
            convex[b] = is_convex(points, a, b, after[b], slack)
            count += 1
            left -= 1
            missed = 0
            k = after[b]
        else:
            k = b
            missed += 1
            if missed > left:
                return -1 - in_the_way
    return count


@wp.func
def relink(beside: Rows, face: int, old: int, new: int):
    if face >= 0:
        for side in range(3):
            if beside[face, side] == old:
                beside[face, side] = new


@wp.func
def flip_sides(points: Points, faces: Rows, beside: Rows, stack: Numbers, waiting: Numbers, count: int):
    """Flip sides until the triangles are constrained Delaunay (Lawson, 1977).

    ``waiting``: 1 for triangles on the stack, which therefore never holds more than all; 0 for all afterwards.
    """
    for face in range(count):
        stack[face] = face
        waiting[face] = 1
    top = int(count)
    while top > 0:
        top -= 1
        f = stack[top]
        waiting[f] = 0
        side = int(0)
        while side < 3:
            g = beside[f, side]
            if g >= 0:
                back = wp.where(beside[g, 1] == f, 1, wp.where(beside[g, 2] == f, 2, 0))
                a = faces[f, side]
                b = faces[f, (side + 1) % 3]
                c = faces[f, (side + 2) % 3]
                d = faces[g, (back + 2) % 3]
                if (
                    in_circle(points[a], points[b], points[c], points[d])
                    and turn(points[a], points[d], points[c]) > ZERO
                    and turn(points[d], points[b], points[c]) > ZERO
                ):
                    bc = beside[f, (side + 1) % 3]
                    ca = beside[f, (side + 2) % 3]
                    ad = beside[g, (back + 1) % 3]
                    db = beside[g, (back + 2) % 3]
                    set_face(faces, f, a, d, c)
                    set_face(beside, f, ad, g, ca)
                    set_face(faces, g, d, b, c)
                    set_face(beside, g, db, bc, f)
                    relink(beside, ad, g, f)
                    relink(beside, bc, f, g)
                    stack[top] = f
                    waiting[f] = 1
                    top += 1
                    if waiting[g] == 0:
                        stack[top] = g
                        waiting[g] = 1
                        top += 1
                    side = 3
            side += 1


@wp.func
def mark_lattice(points: Points, cells: Numbers, n: int, rows: int, columns: int, origin: wp.vec2d, pitch: f64):
    """Set ``cells`` to 1 for the lattice points inside the outline and clear of it, to 0 for the others.

    A point is inside if the outline crosses its row an odd number of times before it.
    """
    for cell in range(rows * columns):
        cells[cell] = 0
    for k in range(n):
        a = points[k] - origin
        b = points[(k + 1) % n] - origin
        row = a[1] / pitch / ROW_64
        column = a[0] / pitch
        next_row = b[1] / pitch / ROW_64
        next_column = b[0] / pitch
        for j in range(int(wp.ceil(wp.min(row, next_row))), int(wp.ceil(wp.max(row, next_row)))):
            at = column + (f64(j) - row) / (next_row - row) * (next_column - column)
            cell = j * columns + int(wp.ceil(at - HALF * f64(j % 2)))
            cells[cell] = cells[cell] ^ 1
        for middle in range(2):
            near_row = row + HALF * f64(middle) * (next_row - row)
            near_column = column + HALF * f64(middle) * (next_column - column)
            for j in range(int(wp.rint(near_row)) - 1, int(wp.rint(near_row)) + 2):
                shift = HALF * f64(j % 2)
                i = int(wp.rint(near_column - shift))
                for k_i in range(i - 1, i + 2):
                    away = wp.vec2d(f64(k_i) + shift - near_column, ROW_64 * (f64(j) - near_row))
                    if wp.dot(away, away) < CLEAR * CLEAR:
                        cells[j * columns + k_i] = cells[j * columns + k_i] | 2
    for j in range(rows):
        inside = int(0)
        for i in range(columns):
            cell = j * columns + i
            inside = inside ^ (cells[cell] & 1)
            cells[cell] = wp.where(inside == 1 and cells[cell] < 2, 1, 0)


@wp.func
def walk_to(points: Points, faces: Rows, beside: Rows, start: int, p: wp.vec2d) -> int:
    """The triangle that holds a point, by a walk from ``start``; ``OUTSIDE`` if the walk ends at the outline."""
    face = int(start)
    for _step in range(LONGEST_WALK):
        onward = int(-2)
        for side in range(3):
            if onward < 0:
                if turn(corner(points, faces, face, side), corner(points, faces, face, side + 1), p) < ZERO:
                    onward = beside[face, side]
        if onward == -2:
            return face
        if onward == OUTSIDE:
            return OUTSIDE
        face = onward
    return OUTSIDE


@wp.func
def clearance(points: Points, faces: Rows, face: int, p: wp.vec2d) -> f64:
    """Twice the least area between a point and a side of a triangle, negative outside of it."""
    a = corner(points, faces, face, 0)
    b = corner(points, faces, face, 1)
    c = corner(points, faces, face, 2)
    return wp.min(wp.min(turn(a, b, p), turn(b, c, p)), turn(c, a, p))


@wp.func
def first_of_two(points: Points, faces: Rows, beside: Rows, face: int, least: f64, p: wp.vec2d) -> int:
    """The triangle that ``search`` finds for a point in a triangle: on a side, the first of the two beside it."""
    first = int(face)
    if face >= 0:
        for side in range(3):
            if turn(corner(points, faces, face, side), corner(points, faces, face, side + 1), p) <= least:
                g = beside[face, side]
                if g >= 0 and g < first:
                    if clearance(points, faces, g, p) >= ZERO:
                        first = g
    return first


@wp.func
def search(points: Points, faces: Rows, count: int, p: wp.vec2d) -> int:
    """The first triangle that holds a point, its sides included; for a point outside all triangles ``OUTSIDE``."""
    for face in range(count):
        if clearance(points, faces, face, p) >= ZERO:
            return face
    return OUTSIDE


@wp.func
def insert(
    points: Points,
    faces: Rows,
    beside: Rows,
    touching: Numbers,
    seen: Numbers,
    fresh: Numbers,
    cavity: Numbers,
    ring: Rows,
    first: int,
    count: int,
    m: int,
    stamp: int,
    least: f64,
) -> int:
    """Insert point ``m``, inside the circumcircle of triangle ``first`` (Bowyer, 1981; Watson, 1981).

    Returns the new number of triangles; ``count`` if the point is refused, since it lies outside, nearer than ``least``
    to another point or, for a positive ``least``, encroaches on the outline: it sees a segment under more than a right
    angle (Ruppert, 1995). ``touching``: a triangle at each point. ``seen``: the stamp of the last insertion that
    removed a triangle, or would have. ``fresh``: 1 for new triangles.
    """
    p = points[m]
    cavity[0] = first
    seen[first] = stamp
    size = int(1)
    sides = int(0)
    i = int(0)
    while i < size:
        for side in range(3):
            g = beside[cavity[i], side]
            if g >= 0 and seen[wp.max(g, 0)] != stamp:
                if in_circle(corner(points, faces, g, 0), corner(points, faces, g, 1), corner(points, faces, g, 2), p):
                    seen[g] = stamp
                    cavity[size] = g
                    size += 1
        i += 1
    for i in range(size):
        for side in range(3):
            g = beside[cavity[i], side]
            if g < 0 or seen[wp.max(g, 0)] != stamp:
                a = faces[cavity[i], side]
                b = faces[cavity[i], (side + 1) % 3]
                to_a = points[a] - p
                to_b = points[b] - p
                if turn(points[a], points[b], p) <= ZERO or wp.dot(to_a, to_a) < least * least:
                    return count
                if g < 0 and least > ZERO and wp.dot(to_a, to_b) < ZERO:
                    return count
                set_face(ring, sides, a, b, g)
                sides += 1
    if sides != size + 2:
        return count
    for i in range(sides):
        face = count + i - size
        if i < size:
            face = cavity[i]
        seen[face] = stamp
        fresh[face] = 1
        touching[ring[i, 0]] = face
    for i in range(sides):
        a = ring[i, 0]
        b = ring[i, 1]
        g = ring[i, 2]
        face = touching[a]
        onward = touching[b]
        set_face(faces, face, a, b, m)
        beside[face, 0] = g
        beside[face, 1] = onward
        beside[onward, 2] = face
        if g >= 0:
            for side in range(3):
                if faces[g, side] == b and faces[g, (side + 1) % 3] == a:
                    beside[g, side] = face
    touching[m] = touching[ring[0, 0]]
    return count + 2


@wp.func
def number_by_rows(
    points: Points,
    faces: Rows,
    touching: Numbers,
    number: Numbers,
    cells: Numbers,
    moved: Points,
    n: int,
    m: int,
    count: int,
    size: int,
):
    """Number the inserted lattice points row by row: neighbours have near numbers, which makes stored meshes small."""
    for k in range(n):
        number[k] = k
    after = int(n)
    for cell in range(size):
        if cells[cell] > 1:
            number[cells[cell]] = after
            moved[after] = points[cells[cell]]
            cells[cell] = after
            after += 1
    for k in range(n, m):
        points[k] = moved[k]
    for face in range(count):
        for k in range(3):
            faces[face, k] = number[faces[face, k]]
            touching[faces[face, k]] = face


@wp.kernel
def fill(
    points: Points,
    faces: Rows,
    beside: Rows,
    touching: Numbers,
    seen: Numbers,
    fresh: Numbers,
    work: Numbers,
    ring: Rows,
    cells: Numbers,
    poor: Numbers,
    radius: Reals,
    centre: Points,
    size: Numbers,
    option: Reals,
):
    """Fill an outline: triangles of its points, then lattice points, then refinement, the largest circles first.

    ``size``: number of points of the outline, rows and columns of the lattice, rows again, number of queries;
    afterwards numbers of points and triangles in place of the first two, or -1 - k triangles if the outline touches
    itself near point k. ``option``: origin of the lattice, spacing, longest side [spacings], sharpest angle [rad].
    Arrays, since arguments that change make a launch slow.
    """
    n = size[0]
    rows = size[1]
    columns = size[2]
    origin = wp.vec2d(option[0], option[1])
    spacing = option[2]
    longest = option[3] * spacing
    sine = TWO * wp.sin(option[4])
    count = clip_ears(points, faces, beside, touching, seen, fresh, work, n, spacing)
    size[1] = count
    if count < 0:
        return
    flip_sides(points, faces, beside, work, seen, count)
    for face in range(count):
        fresh[face] = 1
        for k in range(3):
            touching[faces[face, k]] = face
    pitch = PITCH_64 * spacing
    mark_lattice(points, cells, n, rows, columns, origin, pitch)
    m = int(n)
    stamp = int(0)
    last = int(0)
    # Every sixteenth lattice point of every sixteenth row first, then those between: row by row a point would remove
    # twice as many triangles, since the last row is joined to the far side of the outline.
    stride = int(16)
    while stride > 0:
        for every_j in range((rows - 1) // stride + 1):
            for every_i in range((columns - 1) // stride + 1):
                j = every_j * stride
                i = every_i * stride
                if cells[j * columns + i] == 1:
                    points[m] = origin + pitch * wp.vec2d(f64(i) + HALF * f64(j % 2), ROW_64 * f64(j))
                    near = cells[(j - j % (2 * stride)) * columns + i - i % (2 * stride)]
                    start = last
                    if near > 1:
                        start = touching[near]
                    face = walk_to(points, faces, beside, start, points[m])
                    for other in range(1, 4):  # round a corner of the outline: from the other lattice points beside it
                        near_j = j - j % (2 * stride) + 2 * stride * (other % 2)
                        near_i = i - i % (2 * stride) + 2 * stride * (other // 2)
                        if face < 0 and near_j < rows and near_i < columns:
                            near = cells[near_j * columns + near_i]
                            if near > 1:
                                face = walk_to(points, faces, beside, touching[near], points[m])
                                face = first_of_two(points, faces, beside, face, CLEARLY * spacing * spacing, points[m])
                    if face < 0:
                        face = search(points, faces, count, points[m])
                    if face >= 0:
                        stamp += 1
                        grown = insert(
                            points, faces, beside, touching, seen, fresh, work, ring, face, count, m, stamp, ZERO
                        )
                        if grown > count:
                            count = grown
                            last = touching[m]
                            cells[j * columns + i] = m
                            m += 1
        stride = stride // 2
    number_by_rows(points, faces, touching, work, cells, centre, n, m, count, rows * columns)
    for _round in range(ROUNDS):
        found = int(0)
        for face in range(count):
            if fresh[face] == 1:
                fresh[face] = 0
                a = corner(points, faces, face, 0)
                b = corner(points, faces, face, 1) - a
                c = corner(points, faces, face, 2) - a
                bb = wp.dot(b, b)
                cc = wp.dot(c, c)
                across = wp.dot(c - b, c - b)
                to_centre = wp.vec2d(c[1] * bb - b[1] * cc, b[0] * cc - c[0] * bb) / (TWO * (b[0] * c[1] - b[1] * c[0]))
                around = wp.length(to_centre)
                long = wp.sqrt(wp.max(wp.max(bb, cc), across)) > longest
                if long or sine * around > wp.sqrt(wp.min(wp.min(bb, cc), across)):
                    k = int(found)
                    while k > 0 and radius[wp.max(k - 1, 0)] < around:
                        poor[k] = poor[k - 1]
                        radius[k] = radius[k - 1]
                        centre[k] = centre[k - 1]
                        k -= 1
                    poor[k] = face
                    radius[k] = around
                    centre[k] = a + to_centre
                    found += 1
        before = m
        for k in range(found):
            if fresh[poor[k]] == 0 and m < points.shape[0]:
                points[m] = centre[k]
                stamp += 1
                least = APART * radius[k]
                grown = insert(
                    points, faces, beside, touching, seen, fresh, work, ring, poor[k], count, m, stamp, least
                )
                if grown > count:
                    count = grown
                    m += 1
        if m == before:
            break
    size[0] = m
    size[1] = count
    for face in range(count):
        a = corner(points, faces, face, 0)
        b = corner(points, faces, face, 1)
        c = corner(points, faces, face, 2)
        base = wp.sqrt(wp.max(wp.max(wp.length_sq(b - a), wp.length_sq(c - b)), wp.length_sq(a - c)))
        if turn(a, b, c) < THIN * spacing * base:
            size[1] = -1 - wp.min(wp.min(faces[face, 0], faces[face, 1]), faces[face, 2])


@wp.func
def near_face(cells: Numbers, touching: Numbers, rows: int, columns: int, row: f64, column: f64, otherwise: int) -> int:
    """A triangle at an inserted lattice point next to a position in the lattice, if there is any."""
    for up in range(3):
        j = int(wp.rint(row)) + wp.where(up == 2, -1, up)
        i = int(wp.rint(column - HALF * f64(wp.abs(j) % 2)))
        for along in range(3):
            at = i + wp.where(along == 2, -1, along)
            if j >= 0 and j < rows and at >= 0 and at < columns:
                m = cells[j * columns + at]
                if m > 1:
                    return touching[m]
    return otherwise


@wp.kernel
def find(
    points: Points,
    faces: Rows,
    beside: Rows,
    touching: Numbers,
    cells: Numbers,
    size: Numbers,
    option: Reals,
    queries: Points,
    found: Numbers,
):
    """The triangle that holds each query point; for a point outside all of them, the one that it lies least beyond."""
    count = size[1]
    pitch = PITCH_64 * option[2]
    last = int(0)
    for k in range(size[4]):
        p = queries[k]
        start = near_face(
            cells, touching, size[3], size[2], (p[1] - option[1]) / pitch / ROW_64, (p[0] - option[0]) / pitch, last
        )
        face = walk_to(points, faces, beside, start, p)
        if face < 0:
            face = search(points, faces, count, p)
        if face < 0:
            best = f64(-1.0e30)
            for other in range(count):
                a = corner(points, faces, other, 0)
                b = corner(points, faces, other, 1)
                c = corner(points, faces, other, 2)
                inside = clearance(points, faces, other, p) / turn(a, b, c)
                if inside > best:
                    best = inside
                    face = other
        found[k] = face
        last = face
