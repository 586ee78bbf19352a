"""Contacts of cloth with bodies and with cloth: distances, friction, momentum, crossings and their removal."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float

from gcd_dataset.generator.body import build_body, neutral_shape
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, Fabric
from gcd_dataset.generator.drape.body_field import body_fields, host_field
from gcd_dataset.generator.drape.kernels import untangling as kernels
from gcd_dataset.generator.drape.model import INERTIA_GAIN, build_model
from gcd_dataset.generator.drape.outcome import untangle
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.records import Body, BodyPart, EdgeRole, Measurements
from tests.generator.drape.probes import crossing_kernel, nearest_kernel
from tests.generator.drape.reference import segments_cross
from tests.generator.drape.test_drape import LYING, on_a_table
from tests.helpers import SIZE, body_from, far_ball, joined, patch, tube, waited

SLOPE = trimesh.transformations.rotation_matrix(np.radians(25.0), [0, 0, 1])
INTERNAL = BodyPart.INTERNAL.value
# No garment comes to rest in these tests.
QUICK = DrapeConfig(sewing_time=0.002, held_time=10.0, max_frames=10_000, braking=0.0)


def test_nearest_point_of_a_triangle() -> None:
    points = np.random.default_rng(0).standard_normal((100, 4, 3)).astype(np.float32)
    weights = wp.zeros(len(points), dtype=wp.vec3, device="cpu")
    wp.launch(nearest_kernel, len(points), [wp.array(points, dtype=wp.vec3, device="cpu"), weights], device="cpu")
    found = np.einsum("nk,nkd->nd", weights.numpy(), points[:, 1:])
    expected = trimesh.triangles.closest_point(points[:, 1:].astype(float), points[:, 0].astype(float))
    assert np.abs(found - expected).max() < 1e-3


def test_segment_through_a_triangle() -> None:
    points = np.random.default_rng(1).standard_normal((200, 5, 3)).astype(np.float32)
    crosses = wp.zeros(len(points), dtype=wp.bool, device="cpu")
    wp.launch(crossing_kernel, len(points), [wp.array(points, dtype=wp.vec3, device="cpu"), crosses], device="cpu")
    expected = segments_cross(*points.astype(float).transpose(1, 0, 2))
    assert 8 < sum(expected) < 192
    assert np.array_equal(crosses.numpy(), expected)


@settings(max_examples=3, deadline=None)
@given(radius=st.floats(6.0, 15.0))
def test_the_field_of_a_ball_is_the_distance_to_it(radius: float) -> None:
    field = body_fields([body_from(trimesh.creation.icosphere(subdivisions=4, radius=radius))], "cpu")[0]
    values = field.distance.numpy()
    voxels = np.stack(np.meshgrid(*(np.arange(n) for n in values.shape), indexing="ij"), axis=-1)
    expected = np.linalg.norm(voxels * field.cell + field.origin, axis=-1) - radius
    near = expected < 3.0
    assert np.abs(values - expected)[near].max() < 0.02 * radius
    assert (values[~near] > 2.5).all()


def test_a_body_without_a_field_fails_every_time() -> None:
    body = body_from(trimesh.creation.icosphere(subdivisions=1, radius=5.0))
    flat = replace(body, faces=np.zeros((0, 3), int))
    for _ in range(2):
        with pytest.raises(ValueError, match="zero-size"):
            host_field(flat)


def test_internal_parts_do_not_change_the_field_of_a_body() -> None:
    """Outside a ball, an eye in it or an open socket does not change the distance field."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=12.0)
    eye = trimesh.creation.icosphere(subdivisions=2, radius=4.0)
    parts = np.repeat([0, INTERNAL], [len(ball.vertices), len(eye.vertices)]).astype(np.uint8)
    with_eye = replace(body_from(trimesh.util.concatenate([ball, eye])), parts=parts)
    pole = ball.vertices[:, 2] > 11.5
    socket = replace(
        body_from(ball),
        vertices=np.where(pole[:, None], ball.vertices * [0.8, 0.8, 0.3], ball.vertices),
        parts=np.where(pole, INTERNAL, 0).astype(np.uint8),
    )
    alone = body_fields([body_from(ball)], "cpu")[0]
    for body in (with_eye, socket):
        field = body_fields([body], "cpu")[0]
        assert not (field.part.numpy() == INTERNAL).any()
        off = np.abs(field.distance.numpy() - alone.distance.numpy()[:, :, : field.distance.shape[2]])
        assert off.max() < 0.7  # the lid over the socket is flat
        assert np.median(off) < 1e-5


def check_closed_to_cloth(body: Body) -> None:
    field = body_fields([body], "cpu")[0]
    skin = trimesh.Trimesh(field.mesh.points.numpy(), field.mesh.indices.numpy().reshape(-1, 3), process=False)
    assert skin.is_watertight
    assert skin.is_winding_consistent
    distance = field.distance.numpy()
    inside = body.vertices[body.parts == INTERNAL]
    voxel = np.round((inside - field.origin) / field.cell).astype(int)
    deep = inside[:, 2] < inside[:, 2].max() - 3.0  # behind the lips
    assert distance[tuple(voxel[deep].T)].max() < 0.3  # within half a voxel of a lid it may be outside
    assert not (field.part.numpy() == INTERNAL).any()


def test_eyes_and_mouth_of_our_body_are_closed_to_cloth() -> None:
    check_closed_to_cloth(build_body(neutral_shape()))


def test_eyes_and_mouth_of_a_published_body_are_closed_to_cloth(published: tuple[Body, Measurements]) -> None:
    check_closed_to_cloth(published[0])


@pytest.mark.parametrize(("friction", "stays"), [(0.52, True), (0.42, False)])
def test_cloth_on_a_slope_slides_where_friction_is_too_small(friction: float, stays: bool) -> None:
    """On a slope of 25° cloth stays for friction above tan 25° = 0.47; else it slides, later for its added inertia."""
    acceleration = 981.0 * (np.sin(np.radians(25.0)) - friction * np.cos(np.radians(25.0)))
    travel = slid_down(on_a_slope(friction), QUICK)
    assert (travel < 0.1) if stays else (travel > 0.4 * 0.5 * acceleration / INERTIA_GAIN * 0.4**2)


def test_held_cloth_has_little_friction_until_it_is_released() -> None:
    """On a slope that holds it later, cloth with a collar slides while the collar is held, which limits it nowhere."""
    job = on_a_slope(0.7)
    upper = np.flatnonzero(job.box_mesh.vertices[:, 0] > 0.0)
    held = replace(job, box_mesh=replace(job.box_mesh, labels={EdgeRole.RIGHT_COLLAR: upper}))
    assert slid_down(held, QUICK) > 3.0
    released = replace(QUICK, held_time=0.02, longest_hold=0.02, moving_share=-1.0)  # nor does it come to rest
    assert slid_down(held, released) < 0.5


def on_a_slope(friction: float) -> DrapeJob:
    """A cloth on a slope of 25° that falls towards the wearer's right."""
    slope = trimesh.creation.box(extents=[60.0, 10.0, 60.0])
    slope.apply_transform(SLOPE)
    slope.apply_translation([0.0, 50.0, 0.0])
    origin = SLOPE[:3, :3] @ np.array([-4.0, 5.4, 4.0]) + [0.0, 50.0, 0.0]
    mesh = patch(8, 8, place=SLOPE[:3, :3] @ LYING, origin=tuple(origin))
    return DrapeJob(mesh, body_from(slope), SIZE, Fabric(friction=friction))


def slid_down(job: DrapeJob, config: DrapeConfig) -> float:
    """Distance by which cloth slides down ``on_a_slope`` in 0.4 s [cm]."""
    solver = Solver(build_model([job], config, "cpu"), config)
    solver.run_for(0.4)
    return float((job.box_mesh.vertices.mean(axis=0) - solver.state.x.numpy().mean(axis=0)) @ SLOPE[:3, 0])


@pytest.mark.parametrize(("spacing", "friction"), [(2.0, 0.5), (5.7, 0.1)])
def test_a_tight_band_holds_on_a_pillar_at_any_spacing(spacing: float, friction: float) -> None:
    """A band stretched by e = 5 % round a radius r presses on the pillar with k e / r.

    Friction holds it above density · g · r / (k e) = 0.05. The sides of a coarse band touch the pillar in their middle.
    """
    radius = 12.0
    pillar = trimesh.creation.cylinder(radius=radius, segment=[[0.0, 0.0, 0.0], [0.0, 120.0, 0.0]], sections=96)
    body = body_from(pillar.subdivide().subdivide())
    girth = 2 * np.pi * (radius + QUICK.body_gap) / 1.05
    columns = round(girth / spacing)
    band = tube(columns, round(12.0 / spacing), radius=radius + 0.5, spacing=girth / columns, height=60.0)
    solver = Solver(build_model([DrapeJob(band, body, SIZE, Fabric(friction=friction))], QUICK, "cpu"), QUICK)
    solver.run_for(0.4)
    assert abs(float((solver.state.x.numpy() - band.vertices)[:, 1].mean())) < 0.3


def test_cloth_keeps_its_gap_from_the_skin() -> None:
    mesh = patch(10, 10, place=LYING, origin=(-5.0, 72.0, 5.0))
    solver = Solver(build_model([on_a_table(mesh)], QUICK, "cpu"), QUICK)
    solver.run_for(0.5)
    heights = solver.state.x.numpy()[:, 1] - 70.0
    assert np.abs(heights - QUICK.body_gap).max() < 0.05
    assert solver.body_crossings()[0] == 0


def test_cloth_lies_on_cloth_at_its_thickness() -> None:
    lower = patch(10, 10, place=LYING, origin=(-5.0, 70.4, 5.0))
    upper = patch(6, 6, spacing=1.1, place=LYING, origin=(-3.2, 72.5, 3.1))
    fabric = Fabric(thickness=0.3)
    job = replace(on_a_table(joined(lower, upper)), fabric=fabric)
    solver = Solver(build_model([job], QUICK, "cpu"), QUICK)
    solver.run_for(0.6)
    heights = solver.state.x.numpy()[:, 1]
    between = heights[len(lower.vertices) :].mean() - heights[: len(lower.vertices)].mean()
    assert between == pytest.approx(fabric.thickness, abs=0.05)
    assert solver.self_crossings()[0] == 0


def test_layers_that_touch_exchange_momentum() -> None:
    """Two sheets that meet in the air keep the velocity of their common centre of mass."""
    lower = patch(8, 8, place=LYING, origin=(-4.0, 100.0, 4.0))
    upper = patch(7, 7, spacing=1.05, place=LYING, origin=(-3.7, 100.25, 3.6))
    config = DrapeConfig(sewing_time=1e6, sewing_damping=0.0, braking=0.0)
    solver = Solver(build_model([DrapeJob(joined(lower, upper), far_ball(), SIZE)], config, "cpu"), config)
    speed = np.zeros((solver.model.n_vertices, 3), np.float32)
    speed[len(lower.vertices) :, 1] = -40.0
    solver.state.v.assign(speed)
    inertia = solver.model.cloth.inertia.numpy()[:, None]
    before = (inertia * speed).sum(axis=0)
    for _ in range(3):
        solver.frame()
    after = (inertia * solver.state.v.numpy()).sum(axis=0)
    first = (inertia * solver.state.v.numpy())[: len(lower.vertices)].sum(axis=0)
    assert first[1] < 0.2 * before[1] < 0, "the sheets did not touch"
    assert np.abs(after - before).max() < 0.02 * abs(before[1])


def test_the_contact_search_lists_all_near_pairs() -> None:
    """Points and faces of two crumpled sheets nearer than the margin, compared with a brute-force search."""
    rng = np.random.default_rng(3)
    lower = patch(6, 6, place=LYING, origin=(0.0, 100.0, 0.0))
    mesh = joined(lower, patch(5, 5, spacing=1.05, place=LYING, origin=(0.3, 100.35, -0.2)))
    mesh = replace(mesh, vertices=mesh.vertices + 0.12 * rng.standard_normal(mesh.vertices.shape))
    config = DrapeConfig(sewing_time=1e6)
    solver = Solver(build_model([DrapeJob(mesh, far_ball(), SIZE)], config, "cpu"), config)
    solver.state.search.searching.fill_(1)
    solver._search()
    contacts = solver.state.contacts
    found = {tuple(pair) for pair in contacts.points.numpy()[: contacts.point_count.numpy()[0]].tolist()}
    assert len(found) == contacts.point_count.numpy()[0], "a pair is listed twice"
    sheet = np.arange(len(mesh.vertices)) >= len(lower.vertices)
    point, face = np.nonzero(sheet[:, None] != sheet[mesh.faces[:, 0]])
    nearest = trimesh.triangles.closest_point(mesh.vertices[mesh.faces[face]], mesh.vertices[point])
    close = np.linalg.norm(mesh.vertices[point] - nearest, axis=1) < config.contact_margin - 1e-4
    near = set(map(tuple, np.column_stack([point, mesh.faces[face]])[close].tolist()))
    assert len(near) > 40
    assert near <= found


def test_crossed_sheets_separate() -> None:
    """Shortening the intersection contour pulls a corner back out of the sheet that it pierces."""
    config = DrapeConfig(sewing_time=1e6)
    solver = Solver(build_model([pierced()], config, "cpu"), config)
    assert solver.self_crossings()[0] > 3
    for _ in range(60):
        solver.frame()
    assert solver.self_crossings()[0] == 0


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_cloth_that_has_passed_through_returns_to_its_side(share: float) -> None:
    """Even if most of a sheet is on the wrong side: the intersection contour alone would pull the rest there."""
    lower = patch(12, 12, place=LYING, origin=(-6.0, 100.0, 6.0))
    upper = patch(7, 7, spacing=1.05, place=LYING, origin=(-3.7, 100.25, 3.6))
    config = DrapeConfig(sewing_time=1e6, braking=0.0)
    solver = Solver(build_model([DrapeJob(joined(lower, upper), far_ball(), SIZE)], config, "cpu"), config)
    solver.frame()
    x, above = solver.state.x.numpy(), np.arange(solver.model.n_vertices) >= len(lower.vertices)
    through = above & (x[:, 0] > np.quantile(x[above, 0], 1.0 - share))
    x[through, 1] -= 0.4
    solver.state.x.assign(x)
    solver.state.search.moved_far.fill_(1)
    assert solver.self_crossings()[0] > 20
    for _ in range(3):
        solver.frame()
    assert solver.self_crossings()[0] == 0
    heights = solver.state.x.numpy()[:, 1]
    assert heights[above].min() > heights[~above].mean()


def test_the_first_count_of_crossings_is_the_first_minimum() -> None:
    """Also for a garment whose hold ended before it joined its batch, as after a coarse pass."""
    mesh = joined(patch(6, 6, place=LYING, origin=(-3.0, 50.3, 3.0)), patch(6, 6, origin=(-2.7, 47.1, 0.2)))
    solver = Solver(build_model([DrapeJob(mesh, far_ball(), SIZE)], QUICK, "cpu"), QUICK)
    solver.state.held.zero_()
    found = solver.self_crossings()[0]
    solver.frame()
    assert 0 < solver.state.crossing.least.numpy()[0] <= 2 * found


def hand(body: Body) -> Float[np.ndarray, "n 3"]:
    return body.vertices[(body.parts == BodyPart.HANDS.value) & (body.vertices[:, 0] > 0.0)]


def head_above_the_mouth(body: Body) -> Float[np.ndarray, "n 3"]:
    head = body.vertices[body.parts == BodyPart.HEAD.value]
    return head[head[:, 1] > head[:, 1].max() - 0.65 * np.ptp(head[:, 1])]


@pytest.mark.parametrize("part", [hand, head_above_the_mouth])
def test_cloth_collides_with_the_convex_hull_of(part: Callable[[Body], Float[np.ndarray, "n 3"]]) -> None:
    """A point between two fingers or behind an ear is therefore inside."""
    body = build_body(neutral_shape())
    field = body_fields([body], "cpu")[0]
    points = part(body)
    hull = trimesh.convex.convex_hull(points)
    tip = points[points[:, 0].argmax()]
    distance = field.distance.numpy()
    voxels = np.argwhere(np.ones(distance.shape, bool))
    centres = np.array(field.origin) + voxels * field.cell
    near = np.linalg.norm(centres - tip, axis=1) < 5.0
    offset = (hull.face_normals * hull.triangles[:, 0]).sum(axis=1)
    outside = (centres[near] @ hull.face_normals.T - offset).max(axis=1)
    assert (outside < -0.5).sum() > 20
    assert (distance[tuple(voxels[near].T)] <= outside + 0.05).all()


CONFIG = DrapeConfig(untangling_steps=60)


def pierced() -> DrapeJob:
    """A sheet that the corner of another sheet pierces."""
    other = patch(6, 6, place=np.array([[0.1, 0.1], [0.7, -0.7], [0.7, 0.7]]), origin=(0.0, 100.0, -1.7))
    return DrapeJob(joined(patch(12, 12, origin=(-6.0, 94.0, 0.0)), other), far_ball(), SIZE)


def clean() -> DrapeJob:
    """Two sheets 3 cm apart."""
    lower = patch(8, 8, place=LYING, origin=(-4.0, 100.0, 4.0))
    return DrapeJob(joined(lower, patch(8, 8, place=LYING, origin=(-4.0, 103.0, 4.0))), far_ball(), SIZE)


def solver_of(*jobs: DrapeJob) -> Solver:
    return Solver(build_model(list(jobs), CONFIG, "cpu"), CONFIG)


def untangled(*jobs: DrapeJob) -> list[Float[np.ndarray, "v 3"]]:
    """The positions of each garment after the phase; garments without crossings skip it."""
    solver = solver_of(*jobs)
    waited(untangle(solver, solver.self_crossings() > 0))
    x = solver.state.x.numpy()
    return [x[span].copy() for span in solver.model.vertices]


def test_a_corner_leaves_the_sheet_that_it_pierces() -> None:
    solver = solver_of(pierced())
    assert solver.self_crossings()[0] > 3
    waited(untangle(solver, np.ones(1, bool)))
    assert solver.self_crossings()[0] == 0


def test_a_garment_gets_the_same_bytes_alone_and_in_a_batch() -> None:
    alone = untangled(pierced())[0]
    still, *moved = untangled(clean(), pierced(), pierced())
    assert still.tobytes() == np.float32(clean().box_mesh.vertices).tobytes()
    assert (alone != np.float32(pierced().box_mesh.vertices)).any()
    assert all(x.tobytes() == alone.tobytes() for x in moved)


def test_pushes_of_crossings_sum_to_zero() -> None:
    """Edge and face get opposite forces."""
    solver = solver_of(pierced())
    m, s = solver.model, solver.state
    phase = kernels.Untangling()
    phase.crossing_stiffness, phase.crossing_move = 0.5, 1.0
    bvh, roots = solver.refitted_bvh()
    counts = wp.zeros(1, dtype=int, device="cpu")
    inputs = [m.cloth, bvh, roots, phase, wp.ones(1, dtype=int, device="cpu"), s.x]
    solver.launch(kernels.push_crossings, m.n_edges, inputs, [counts, s.push])
    push = s.push.numpy()[:, :3].astype(np.int64)
    assert counts.numpy()[0] == solver.self_crossings()[0]
    assert np.abs(push).sum() > 0
    assert np.abs(push.sum(axis=0)).max() <= 5 * len(push)  # each term is rounded to units of 6e-8 cm


def test_the_matrix_is_symmetric_and_positive_definite() -> None:
    """Also with compressed springs: the conjugate gradient method needs both properties."""
    solver = solver_of(clean())
    m, s = solver.model, solver.state
    x = s.x.numpy()
    s.x.assign(x + np.random.default_rng(0).normal(0.0, 0.1, x.shape).astype(np.float32))
    phase = kernels.Untangling()
    phase.step = 1.0 / 120.0
    active = wp.ones(1, dtype=int, device="cpu")
    solve = kernels.Solve()
    for name in ("residual", "move", "direction", "image"):
        setattr(solve, name, wp.zeros(m.n_vertices, dtype=wp.vec3, device="cpu"))
    solve.diagonal, solve.product = (wp.zeros(m.n_vertices, dtype=float, device="cpu") for _ in range(2))
    solve.inverse = wp.zeros(m.n_vertices, dtype=wp.mat33, device="cpu")
    s.push.zero_()
    solver.launch(kernels.assemble, m.n_vertices, [m.worlds, m.cloth, m.rows, phase, active, s.x], [s.push, solve])
    columns = []
    for unit in np.eye(3 * m.n_vertices, dtype=np.float32):
        solve.direction.assign(unit.reshape(-1, 3))
        solver.launch(kernels.multiply, m.n_vertices, [m.cloth, m.rows, active, s.x], [solve])
        columns.append(solve.image.numpy().ravel().copy())
    matrix = np.stack(columns, axis=1).astype(float)
    assert np.abs(matrix - matrix.T).max() < 1e-4 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min() > 0.0
