"""Contact of cloth with the body, by the body's signed distance field."""

import warp as wp

from gcd_dataset.generator.drape.kernels.field import ON_CLOTH
from gcd_dataset.generator.drape.kernels.push import add_pressure, add_push, add_weight
from gcd_dataset.generator.drape.kernels.world import ClothArrays, World

wp.set_module_options({"enable_backward": False})

# The slope from hips to waist, (hips - waist) / (2 pi hips_line), is 0.15 on the neutral body, and 0.3 times the usual
# friction is as large: rings that fit do not ride up, and stretched bodices lift tight skirts.
SMOOTHED = 0.3  # friction factor of a held garment, which is being smoothed into place
GRIP = 2.0  # friction factor of keepers: the edges that keep a garment up are faced with grip tape
FAR = wp.constant(1.0e3)  # cm, distance from a body part that a vertex passes through
BAND = wp.constant(4.0)  # cm outside the skin in which distances are exact, ``body_field.BAND``
BEYOND = 3.9  # cm: a field has no gradient where it ends, ``body_field.BAND``
LEFT_ARM, RIGHT_ARM = wp.constant(1), wp.constant(2)  # columns of ``ClothArrays.axes``
FIELD_ERROR = 0.5  # cm, of the field beside worn cloth
OUTSIDE_CLOTH = 0.3  # cm: where the field is larger, points lie outside all worn cloth
DEEPEST = 1.5  # cm: the inside of a long edge that is deeper in a skin that moves is left to its ends
SAME_PLACE = wp.constant(0.02)  # cm between two places with the same nearest skin
SLIDE = 0.3  # cm that a vertex slides over a moving skin at most until its plane is found again
FASTEST = 500.0  # cm/s, of skin that moves: a foot in a brisk walk
MIDDLE_SHARE = 0.5  # share of ``body_gap`` that the inside of a long edge keeps


@wp.func
def skin_distance(skin: wp.uint64, x: wp.vec3, reach: float) -> wp.vec4:
    """Unit gradient and value of the signed distance from a skin [cm]; ``reach`` at least that far from it."""
    near = wp.mesh_query_point_sign_normal(skin, x, reach)
    if not near.result:
        return wp.vec4(0.0, 1.0, 0.0, reach)
    return distance_from(skin, near, x)


@wp.func
def distance_from(skin: wp.uint64, near: wp.MeshQueryPoint, x: wp.vec3) -> wp.vec4:
    """Unit gradient and value of the signed distance at ``x`` [cm], whose nearest point of a skin is ``near``."""
    away = near.sign * (x - wp.mesh_eval_position(skin, near.face, near.u, near.v))
    distance = wp.length(away)
    normal = wp.mesh_eval_face_normal(skin, near.face)
    if distance > 1.0e-4:
        normal = away / distance
    return wp.vec4(normal[0], normal[1], normal[2], near.sign * distance)


@wp.func
def moving_skin(world: World, x: wp.vec3, lag: float, last: wp.vec3):
    """The skin nearest to ``x``: unit gradient and value of its signed distance [cm], velocity [cm/s] and body part.

    ``lag``: time since the skin was where its mesh is [s], more than a frame for one that has arrived and stands still.
    Nearest to ``x`` is what is nearest on the mesh to where ``x`` was in the frame of that skin: found from the
    ``last`` velocity, and again where the skin has another one. Further than ``BAND`` off, the velocity is zero.
    """
    moves = wp.where(lag > 1.5 * world.frame, 0.0, 1.0)
    behind = moves * lag
    velocity = moves * last
    there = x - behind * velocity
    near = wp.mesh_query_point_sign_normal(world.skin, there, BAND + behind * FASTEST)
    if near.result:
        velocity = moves * wp.mesh_eval_velocity(world.skin, near.face, near.u, near.v)
        if wp.length(x - behind * velocity - there) > SAME_PLACE:
            there = x - behind * velocity
            near = wp.mesh_query_point_sign_normal(world.skin, there, BAND + behind * FASTEST)
    if near.result:
        velocity = moves * wp.mesh_eval_velocity(world.skin, near.face, near.u, near.v)
        skin = distance_from(world.skin, near, there)
        skin[3] += wp.dot(wp.vec3(skin[0], skin[1], skin[2]), x - behind * velocity - there)
        if skin[3] <= BAND:
            return skin, velocity, int(world.face_parts[near.face]) & (ON_CLOTH - 1)
    return wp.vec4(0.0, 1.0, 0.0, BAND), wp.vec3(0.0), 0


@wp.func
def is_over_same_skin(x: wp.vec3, velocity: wp.vec3, asked: wp.vec4, lag: float, frame: float) -> bool:
    """Whether a vertex may keep the plane of a moving skin: it was found in this frame, and the vertex hardly slid.

    ``velocity``: of the skin there [cm/s]. ``asked``: where the vertex was when the plane was found [cm], and ``lag``
    then [s]. A skin of radius R departs from the plane by SLIDE² / 2 R: 0.02 cm on an arm.
    """
    slid = x - wp.vec3(asked[0], asked[1], asked[2]) - (lag - asked[3]) * velocity
    return asked[3] < lag and lag <= frame and wp.length_sq(slid) <= SLIDE * SLIDE


@wp.func
def sample_field(world: World, x: wp.vec3) -> wp.vec4:
    """Unit gradient and value [cm] of the signed distance at ``x``, trilinear; 1000 cm beyond the grid.

    From the mesh of a skin that moves, up to ``BAND`` from it: no field is rebuilt.
    """
    if world.skin != wp.uint64(0):
        return skin_distance(world.skin, x, BAND)
    g = (x - world.field_origin) / world.field_cell
    nx = world.field_size[0]
    ny = world.field_size[1]
    nz = world.field_size[2]
    i = int(wp.floor(g[0]))
    j = int(wp.floor(g[1]))
    k = int(wp.floor(g[2]))
    if i < 0 or j < 0 or k < 0 or i >= nx - 1 or j >= ny - 1 or k >= nz - 1:
        return wp.vec4(0.0, 1.0, 0.0, 1.0e3)
    a = g[0] - float(i)
    b = g[1] - float(j)
    c = g[2] - float(k)
    at = (i * ny + j) * nz + k
    dy = nz
    dx = ny * nz
    f000 = world.field[at]
    f001 = world.field[at + 1]
    f010 = world.field[at + dy]
    f011 = world.field[at + dy + 1]
    f100 = world.field[at + dx]
    f101 = world.field[at + dx + 1]
    f110 = world.field[at + dx + dy]
    f111 = world.field[at + dx + dy + 1]
    f00 = wp.lerp(f000, f001, c)
    f01 = wp.lerp(f010, f011, c)
    f10 = wp.lerp(f100, f101, c)
    f11 = wp.lerp(f110, f111, c)
    f0 = wp.lerp(f00, f01, b)
    f1 = wp.lerp(f10, f11, b)
    gx = f1 - f0
    gy = wp.lerp(f01 - f00, f11 - f10, a)
    gz = wp.lerp(wp.lerp(f001 - f000, f011 - f010, b), wp.lerp(f101 - f100, f111 - f110, b), a)
    slope = wp.vec3(gx, gy, gz) / world.field_cell
    steep = wp.length(slope)
    if steep > 1.0e-6:
        slope = slope / steep
    return wp.vec4(slope[0], slope[1], slope[2], wp.lerp(f0, f1, a))


@wp.func
def voxel_at(world: World, x: wp.vec3) -> int:
    """The body part nearest to the voxel that contains ``x``; with ``ON_CLOTH`` where worn cloth is nearer."""
    if world.skin != wp.uint64(0):
        near = wp.mesh_query_point_no_sign(world.skin, x, 2.0 * BAND)
        if not near.result:
            return 0
        return int(world.face_parts[near.face]) & (ON_CLOTH - 1)
    g = (x - world.field_origin) / world.field_cell
    i = wp.clamp(int(wp.round(g[0])), 0, world.field_size[0] - 1)
    j = wp.clamp(int(wp.round(g[1])), 0, world.field_size[1] - 1)
    k = wp.clamp(int(wp.round(g[2])), 0, world.field_size[2] - 1)
    return int(world.field_parts[(i * world.field_size[1] + j) * world.field_size[2] + k])


@wp.func
def nearest_part(world: World, x: wp.vec3) -> int:
    """The body part nearest to ``x``, from the voxel that contains ``x``."""
    return voxel_at(world, x) & (ON_CLOTH - 1)


@wp.func
def is_ignored(parts: int, part: int) -> bool:
    """Whether a bit set of body parts contains ``part``."""
    return ((parts >> part) & 1) != 0


@wp.func
def skin_friction(world: World, held: int, keeps: bool) -> float:
    """Coulomb coefficient of cloth on skin; ``keeps``: of the edge that keeps the garment up.

    Little friction while waist or collar are held: a dress that is put on is smoothed into place. Patterns place a
    skirt lower than it is worn; with full friction, a skirt tight on the hips stayed there and stretched the bodice.
    """
    friction = world.friction
    if held != 0 and world.holds > 0:
        friction *= SMOOTHED
    if keeps:
        friction *= GRIP
    return friction


@wp.func
def leave_body(depth: float, approach: float, world: World) -> float:
    """Displacement along the normal that keeps a point off the skin [cm].

    Undoes this substep's ``approach`` in full and older penetration at ``World.leaving_speed`` at most.
    """
    return wp.min(wp.max(depth, 0.0), wp.max(approach, 0.0) + world.leaving_speed * world.dt)


@wp.func
def find_inside_planes(
    edge: wp.vec2i,
    first: int,
    world: World,
    cloth: ClothArrays,
    x: wp.array(dtype=wp.vec3),
    planes: wp.array(dtype=wp.vec4),
):
    """Store the planes that stand for a moving skin at the three points of a long edge's inside: normal, offset [cm].

    A point ``p`` is ``dot(normal, p) + offset`` outside.
    """
    i = edge[0]
    j = edge[1]
    for quarter in range(3):
        t = 0.25 * float(quarter + 1)
        p = wp.lerp(x[i], x[j], t)
        last = wp.lerp(cloth.skin_velocity[i], cloth.skin_velocity[j], t)
        near, _along, part = moving_skin(world, p, cloth.skin_lag[cloth.vertex_world[i]], last)
        if is_ignored(cloth.ignored_parts[i] & cloth.ignored_parts[j], part) or near[3] < -DEEPEST:
            near[3] = FAR
        near[3] -= wp.dot(wp.vec3(near[0], near[1], near[2]), p)
        planes[first + quarter] = near


@wp.func
def push_long_edge(
    edge: wp.vec2i,
    first: int,
    planes: wp.array(dtype=wp.vec4),
    world: World,
    cloth: ClothArrays,
    contact_weight: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    push: wp.array2d(dtype=int),
):
    """Push a long edge off the body at three points of its inside.

    All points within ``body_gap`` share the push, pushed in this substep or not: weights count one substep later. If
    pushed points alone had weights, tight coarse cloth rattled, since the few points that touched it anew pushed it
    with all the weight, and friction did not act on it between two impacts.

    Friction acts at the vertices, in ``keep_off_body``, on velocities that include the forces of this substep; without
    these, cloth would creep by one substep's acceleration in each substep.

    ``planes``: three from ``first`` on stand for a skin that moves, and move with it.
    """
    i = edge[0]
    j = edge[1]
    for quarter in range(3):
        t = 0.25 * float(quarter + 1)
        before = wp.lerp(x[i], x[j], t)
        here = before + world.dt * wp.lerp(v[i], v[j], t)
        near = wp.vec4(0.0)
        if world.skin != wp.uint64(0):
            near = planes[first + quarter]
            carried = world.dt * wp.lerp(cloth.skin_velocity[i], cloth.skin_velocity[j], t)
            near[3] -= wp.dot(wp.vec3(near[0], near[1], near[2]), carried)
            planes[first + quarter] = near
            near[3] += wp.dot(wp.vec3(near[0], near[1], near[2]), here)
            before += carried
        else:
            near = sample_field(world, here)
        if near[3] >= world.body_gap:
            continue
        if world.skin == wp.uint64(0):
            if is_ignored(cloth.ignored_parts[i] & cloth.ignored_parts[j], nearest_part(world, here)):
                continue
        add_weight(push, i, 1.0 - t)
        add_weight(push, j, t)
        depth = MIDDLE_SHARE * world.body_gap - near[3]
        if depth <= 0.0:
            continue
        normal = wp.vec3(near[0], near[1], near[2])
        out = leave_body(depth, wp.dot(before - here, normal), world)
        share = out / (((1.0 - t) * (1.0 - t) + t * t) * wp.max(contact_weight[i], contact_weight[j]))
        add_push(push, i, ((1.0 - t) * share) * normal)
        add_push(push, j, (t * share) * normal)
        add_pressure(push, i, (1.0 - t) * share)
        add_pressure(push, j, t * share)


@wp.func
def find_skin(i: int, p: wp.vec3, near: wp.vec4, part: int, world: World, cloth: ClothArrays) -> wp.vec4:
    """The plane that stands for the skin at vertex ``i`` until the next search: normal, and distance of ``p`` [cm].

    ``near``: the signed distance at ``p``. ``part``: the body part nearest to it; -1: that of its voxel. A vertex moves
    by about ``World.travel`` = 0.1 cm between two searches, and a skin of radius R departs from the plane by
    travel² / 2 R: 0.005 cm on a finger.
    """
    most = world.sleeve
    if cloth.own_part[i] != LEFT_ARM and cloth.own_part[i] != RIGHT_ARM:
        most = wp.where(p[1] < world.tucked_below, world.tuck, wp.inf)
    if near[3] > 0.5 * (world.body_gap + most):
        return tuck_in(i, p, near, most, world, cloth)
    if near[3] >= world.clear:
        return near
    voxel = part
    if part < 0:
        voxel = voxel_at(world, p)
    if is_ignored(cloth.ignored_parts[i], voxel & (ON_CLOTH - 1)):
        return wp.vec4(near[0], near[1], near[2], FAR)
    if (voxel & ON_CLOTH) != 0 and near[3] > -FIELD_ERROR:
        return find_cloth(p, near, world)
    return near


@wp.func
def tuck_in(i: int, p: wp.vec3, near: wp.vec4, most: float, world: World, cloth: ClothArrays) -> wp.vec4:
    """A plane that keeps a vertex within ``most`` of the skin: normal, and distance of ``p`` [cm]."""
    inward = -wp.vec3(near[0], near[1], near[2])
    if near[3] > BEYOND:
        inward = toward_part(i, cloth, p)
    return wp.vec4(inward[0], inward[1], inward[2], world.body_gap + most - near[3])


@wp.func
def toward_part(i: int, cloth: ClothArrays, p: wp.vec3) -> wp.vec3:
    """Unit vector from ``p`` to the axis of the body part that a vertex covers."""
    w = cloth.vertex_world[i]
    start = cloth.axes[2 * w, cloth.own_part[i]]
    along = cloth.axes[2 * w + 1, cloth.own_part[i]] - start
    share = wp.clamp(wp.dot(p - start, along) / wp.max(wp.length_sq(along), 1.0e-6), 0.0, 1.0)
    return wp.normalize(start + share * along - p)


@wp.func
def find_cloth(p: wp.vec3, near: wp.vec4, world: World) -> wp.vec4:
    """As ``near``, the field at ``p``, from the triangles of the worn garments: voxels are wider than their folds."""
    exact = near
    exact[3] = near[3] + FIELD_ERROR
    for k in range(world.worn.shape[0]):
        cloth = world.worn[k]
        found = mesh_distance(cloth, p, exact[3] + world.worn_gap, near[3] > OUTSIDE_CLOTH)
        if found[3] - world.worn_gap < exact[3]:
            exact = wp.vec4(found[0], found[1], found[2], found[3] - world.worn_gap)
    if exact[3] < near[3] + FIELD_ERROR:
        return exact
    return near


@wp.func
def mesh_distance(mesh: wp.uint64, p: wp.vec3, reach: float, is_outside: bool) -> wp.vec4:
    """Unit gradient and value of the signed distance from an open mesh [cm]; ``FAR`` if beyond ``reach``."""
    sign = float(1.0)
    if is_outside:
        found = wp.mesh_query_point_no_sign(mesh, p, reach)
    else:
        found = wp.mesh_query_point_sign_winding_number(mesh, p, reach)
        sign = found.sign
    if not found.result:
        return wp.vec4(0.0, 1.0, 0.0, FAR)
    away = sign * (p - wp.mesh_eval_position(mesh, found.face, found.u, found.v))
    distance = wp.length(away)
    normal = wp.mesh_eval_face_normal(mesh, found.face)
    if distance > 1.0e-4:
        normal = away / distance
    return wp.vec4(normal[0], normal[1], normal[2], sign * distance)


@wp.func
def keep_off_body(
    here: wp.vec3,
    before: wp.vec3,
    pressure: float,
    friction: float,
    world: World,
    skin: wp.vec4,
    searched_at: wp.vec3,
) -> wp.vec3:
    """Displacement of a vertex by body contact and friction [cm].

    Coulomb friction undoes sliding up to ``friction`` times the displacement off the skin: of the vertex, and
    ``pressure`` of its long edges. ``skin``: from ``find_skin`` at ``searched_at``.
    """
    normal = wp.vec3(skin[0], skin[1], skin[2])
    step = here - before
    inward = wp.dot(step, normal)
    out = leave_body(world.body_gap - skin[3] - wp.dot(normal, here - searched_at), -inward, world)
    sliding = step - inward * normal
    slid = wp.length(sliding)
    moved = out * normal
    if slid > 0.0:
        moved -= wp.min(friction * (out + pressure) / slid, 1.0) * sliding
    return moved
