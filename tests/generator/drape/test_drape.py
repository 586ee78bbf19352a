"""Whole drapes: outcomes, and independence of batch, order and device sharing."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import warp as wp
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.device import launch_lock
from gcd_dataset.generator.drape import FABRICS, DrapeConfig, DrapeJob, Fabric, Tensile, drape_all, drape_batch
from gcd_dataset.generator.drape.batches import Lane, drape_unordered
from gcd_dataset.generator.drape.holds import fell, holds, off_body
from gcd_dataset.generator.drape.kernels.world import DONE
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.outcome import FINISHES, best_of, collect, crosses, slid_off
from gcd_dataset.generator.drape.slots import CoarseEnd, Slots, room_for, rooms_of
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.mesh import coarse_start, coarsen
from gcd_dataset.generator.pipeline import prepare, sample_fabric
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Body, BodyPart, BoxMesh, Drape, Outcome
from tests.generator.drape.garments import wear
from tests.generator.drape.reference import segments_cross
from tests.helpers import SIZE, body_from, far_ball, joined, patch, tube, waited

LYING = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]])  # the patch's right side looks up


def on_a_ball(columns: int, *, labels: dict[str, np.ndarray] | None = None) -> DrapeJob:
    """A square cloth above a ball with its top at the waist of ``SIZE``."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=12.0)
    ball.apply_translation([0.0, SIZE.waist_level - 12.0, 0.0])
    corner = (-columns, SIZE.waist_level + 1.0, columns)
    mesh = patch(columns, columns, spacing=2.0, place=LYING, origin=corner, labels=labels)
    return DrapeJob(mesh, body_from(ball), SIZE)


def test_a_cloth_over_a_ball_settles_on_it() -> None:
    [drape] = drape_batch([on_a_ball(8)], device="cpu")
    assert drape.outcome is Outcome.SETTLED
    assert (drape.self_crossings, drape.body_crossings) == (0, 0)
    assert np.linalg.norm(drape.vertices - [0.0, SIZE.waist_level - 12.0, 0.0], axis=1).min() > 12.0
    assert drape.vertices[:, 1].min() < SIZE.waist_level - 2.0


def test_a_garment_gets_the_same_drape_alone_and_in_any_batch() -> None:
    """Of any size and fabric, orthotropic and isotropic."""
    fabrics = [FABRICS["default"], FABRICS["denim"], FABRICS["gcd_soft"], sample_fabric(1, 0, "random")]
    sizes = (5, 7, 6, 6)
    jobs = [replace(on_a_ball(size), fabric=fabric) for size, fabric in zip(sizes, fabrics, strict=True)]
    config = DrapeConfig(max_frames=25)
    together = drape_batch(jobs, config, device="cpu")
    for job, drape in zip(jobs, together, strict=True):
        assert drape_batch([job], config, device="cpu") == [drape]
    assert drape_batch(jobs[::-1], config, device="cpu") == together[::-1]
    assert len({drape.vertices.tobytes() for drape in together}) == len(jobs)


def test_the_threshold_of_rest_rises_in_the_second_half() -> None:
    """A slow garment that never comes fully to rest counts as settled in the second half of the frames."""
    never_still = DrapeConfig(still_speed=1e-9, max_frames=60)
    [slow] = drape_batch([on_a_ball(5)], never_still, device="cpu")
    assert slow.outcome is Outcome.SETTLED
    assert 30 < slow.frames <= 60
    [too_fast] = drape_batch([on_a_ball(5)], replace(never_still, calm_speed=1e-6), device="cpu")
    assert (too_fast.outcome, too_fast.frames) == (Outcome.NOT_SETTLED, 60)


@pytest.mark.parametrize("grained", [1, 3])
def test_a_garment_gets_the_same_drape_as_others_leave_and_join_its_batch(
    grained: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Garments continue from coarse drapes. One fabric with a grain: others join it, or it needs other buffers."""
    monkeypatch.setattr("gcd_dataset.generator.mesh.coarse.FEW", 1)
    jobs = [on_a_ball(columns) for columns in (10, 4, 7, 3)]
    jobs[grained] = replace(jobs[grained], fabric=Fabric(tensile=Tensile(60.0, 30.0, 12.0)))
    config = DrapeConfig(max_frames=50)
    alone = [drape for job in jobs for _, drape in drape_unordered([job], config, device="cpu", at_once=1)]
    in_turn = dict(drape_unordered(iter(jobs), config, device="cpu", at_once=3))
    in_two_batches = dict(drape_unordered(iter(jobs), config, device="cpu", at_once=3, lanes=2))
    assert [in_turn[number] for number in range(len(jobs))] == alone
    assert [in_two_batches[number] for number in range(len(jobs))] == alone
    assert len({drape.frames for drape in alone}) > 2  # drapes end at different times


def test_jobs_may_wait_for_threads_that_launch_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread that meshes panels launches kernels; a lane on a GPU holds the lock of launches while it works."""
    monkeypatch.setattr(Lane, "_on_stream", lambda _lane, **_options: launch_lock)

    def launch() -> bool:
        if taken := launch_lock.acquire(blocking=False):
            launch_lock.release()
        return taken

    def jobs(pool: ThreadPoolExecutor) -> Iterator[DrapeJob]:
        for columns in (4, 5, 4):
            assert pool.submit(launch).result()
            yield on_a_ball(columns)

    with ThreadPoolExecutor(1) as pool:
        drapes = drape_unordered(jobs(pool), DrapeConfig(max_frames=2), device="cpu", at_once=2)
        assert len(list(drapes)) == 3


@pytest.mark.parametrize("at_once", [1, 3])
def test_an_error_of_the_jobs_is_raised_after_the_drapes_before_it(at_once: int) -> None:
    def jobs() -> Iterator[DrapeJob]:
        yield from (on_a_ball(4), on_a_ball(5), on_a_ball(4))
        raise OSError("the disk is gone")

    config = DrapeConfig(max_frames=4)
    drapes: list[Drape] = []
    with pytest.raises(OSError, match="the disk is gone"):
        drapes.extend(drape_all(jobs(), config, device="cpu", at_once=at_once))
    assert len(drapes) == 3
    in_turn = []
    with pytest.raises(OSError, match="the disk is gone"):
        for number, _ in drape_unordered(jobs(), config, device="cpu", at_once=at_once):
            in_turn.append(number)
    assert sorted(in_turn) == [0, 1, 2]


def on_a_spike() -> DrapeJob:
    """A cloth that starts pierced by a spike on a ball, which is thinner than the voxels of the body's field."""
    job = on_a_ball(6)
    ends = np.array([1.3, SIZE.waist_level - 1.0, 0.7]) + [[0.0, -8.0, 0.0], [0.0, 8.0, 0.0]]
    spike = trimesh.creation.cylinder(radius=0.2, segment=ends, sections=6)
    ball = trimesh.Trimesh(job.body.vertices, job.body.faces, process=False)
    return replace(job, body=body_from(trimesh.util.concatenate([ball, spike])))


def test_a_garment_with_crossings_at_rest_is_draped_again() -> None:
    """Sewn at half the speed; it keeps the drape with fewer crossings, alone and beside others."""
    once = DrapeConfig(exact_finish=False, most_drapes=1)
    jobs = [on_a_spike(), on_a_ball(6)]
    first, clean = drape_batch(jobs, once, device="cpu")
    second, _ = drape_batch(jobs, replace(once, sewing_time=2.0 * once.sewing_time), device="cpu")
    assert (crosses(first), crosses(clean)) == (True, False)
    twice = replace(once, most_drapes=2)
    best = best_of([first, second])
    assert first.vertices.tobytes() != second.vertices.tobytes()
    assert drape_batch(jobs, twice, device="cpu") == [best, clean]
    together = dict(drape_unordered(jobs[::-1], twice, device="cpu", at_once=2))
    assert [together[1], together[0]] == [best, clean]


def test_pierced_cloth_leaves_the_skin_in_several_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pass moves cloth by a share of its distance from other cloth; the spike is too thin for any number of them."""
    passes = list[int]()
    leave_skin = Solver.leave_skin

    def counted(solver: Solver, chosen: wp.array, pierced: wp.array | None) -> None:
        passes.append(int(chosen.numpy()[0]))
        leave_skin(solver, chosen, pierced)

    monkeypatch.setattr(Solver, "leave_skin", counted)
    once = DrapeConfig(most_drapes=1, coarse_start=False)
    drapes = dict(drape_unordered([on_a_spike()], once, device="cpu", at_once=1))
    assert passes == FINISHES * [1]
    assert crosses(drapes[0])
    passes.clear()
    [clean] = drape_batch([on_a_ball(6)], once, device="cpu")
    assert passes == [1]
    assert not crosses(clean)


def test_the_finish_of_a_garment_keeps_the_counts_of_the_others() -> None:
    """A cloth that no pass takes off a spike, beside two sheets that cross each other, far from a body."""
    lying = patch(4, 4, spacing=2.0, place=LYING, origin=(0.0, SIZE.waist_level, 0.0))
    standing = patch(4, 4, spacing=2.0, place=np.eye(3)[:, :2], origin=(1.0, SIZE.waist_level - 3.0, -3.5))
    jobs = [on_a_spike(), DrapeJob(joined(lying, standing), far_ball(), SIZE)]
    found, config = list[Drape](), DrapeConfig(untangling_steps=0)
    for some in (jobs, jobs[:1], jobs[1:]):
        solver = Solver(build_model(some, config, "cpu"), config)
        solver.state.status.fill_(DONE)
        found += waited(collect(solver, some, range(len(some))))
    assert found[:2] == found[2:]
    assert found[0].body_through > 0
    assert found[1].self_crossings > 0


def test_the_best_drape_settles_with_the_fewest_crossings() -> None:
    [drape] = drape_batch([on_a_ball(4)], device="cpu")
    first, fewer, pierced, fallen = (
        replace(drape, outcome=outcome, self_crossings=own, body_through=through)
        for outcome, own, through in (
            (Outcome.SETTLED, 5, 0),
            (Outcome.SETTLED, 0, 4),
            (Outcome.THROUGH_BODY, 0, 3),
            (Outcome.SLID_OFF, 0, 0),
        )
    )
    assert best_of([first, fewer, pierced, fallen]) is fewer
    assert best_of([fallen, pierced]) is pierced
    assert best_of([fewer, replace(fewer, frames=1)]) is fewer
    assert not crosses(fallen)  # sewing more slowly holds nothing up


def test_a_coarse_start_ends_in_the_same_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.generator.mesh.coarse.FEW", 1)
    job = on_a_ball(9)
    [with_start], [without] = (
        drape_batch([job], DrapeConfig(coarse_start=coarse), device="cpu") for coarse in (True, False)
    )
    assert with_start.vertices != pytest.approx(without.vertices, abs=1e-6)
    assert with_start.vertices == pytest.approx(without.vertices, abs=1.0)


def test_a_garment_starts_from_its_panels_where_its_coarse_mesh_slid_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.generator.mesh.coarse.FEW", 1)
    plain = on_a_ball(8, labels={"lower_interface": np.arange(81)})
    coarse = coarse_start(plain.box_mesh)
    assert coarse is not None
    beside = replace(plain, coarse=coarse, start=coarse.mesh.vertices + [60.0, 0.0, 0.0])
    config = DrapeConfig(held_time=0.1)
    [drape, held] = drape_batch([beside, plain], config, device="cpu")
    [from_panels] = drape_batch([plain], replace(config, coarse_start=False), device="cpu")
    assert drape.outcome is Outcome.SETTLED
    assert drape.vertices.tobytes() == from_panels.vertices.tobytes()
    assert drape.frames > from_panels.frames  # frames of the coarse mesh included
    assert held.vertices.tobytes() != drape.vertices.tobytes()


def test_a_dress_hangs_from_its_shoulders() -> None:
    """A garment with a neckline cannot slide off, however low its waist hangs; a skirt can."""
    skirt = on_a_ball(5, labels={"lower_interface": np.arange(6)})
    dress = on_a_ball(5, labels={"lower_interface": np.arange(6), "left_collar": np.arange(6, 9)})
    lying_low = np.array(skirt.box_mesh.vertices) - [0.0, 40.0, 0.0]
    assert slid_off(skirt, lying_low)
    assert not slid_off(dress, lying_low)
    assert np.flatnonzero(holds(skirt)[0].any(axis=1)).tolist() == list(range(6))  # at the waist
    assert np.flatnonzero(holds(dress)[0].any(axis=1)).tolist() == list(range(6, 9))  # at the neck alone


def folded(job: DrapeJob) -> DrapeJob:
    """A job whose cloth lies in a heap."""
    heap = np.array(job.box_mesh.vertices)
    heap[:, 1] = SIZE.waist_level + 5.0 + 0.001 * heap[:, 0]
    heap[:, [0, 2]] *= 0.05
    return DrapeJob(replace(job.box_mesh, vertices=heap), job.body, SIZE)


def test_a_garment_with_more_contacts_than_room_is_draped_with_more_room() -> None:
    """It drapes as it does with that room from the start; others in the batch drape as they do alone."""
    jobs = [on_a_ball(6), folded(on_a_ball(6)), on_a_ball(5)]
    config = DrapeConfig(contact_capacity=12, max_frames=3, most_drapes=1)
    drapes = dict(drape_unordered(jobs, config, device="cpu", at_once=3))
    heap = drapes.pop(1)
    assert heap.outcome is not Outcome.OVERFULL
    [roomy] = drape_batch(jobs[1:2], replace(config, contact_capacity=128), device="cpu")
    assert np.array_equal(heap.vertices, roomy.vertices)
    assert [drapes[0], drapes[2]] == drape_batch(jobs[::2], config, device="cpu")


def test_an_overfull_contact_list_of_the_coarse_pass_is_reported() -> None:
    job, config = on_a_ball(9), DrapeConfig()
    coarse = coarsen(job.box_mesh)
    first = Solver(build_model([replace(job, box_mesh=coarse.mesh)], config, "cpu", coarse=[0]), config)
    end = CoarseEnd.of(coarse, first.state, first.model.vertices[0], time=0.0, held=1, overfull=1)
    slots = Slots(room_for(job.box_mesh), 1, config, "cpu")
    assert slots.place(build_model([job], config, "cpu"), [end]) == [0]
    [drape] = waited(collect(slots.solver, [job], [0]))
    assert drape.outcome is Outcome.OVERFULL


def test_no_work_for_a_garment_is_recorded_in_the_graph_of_another() -> None:
    """On a CPU each garment has a thread, and Warp records the launches of all threads while one captures."""
    job, config = on_a_ball(9), DrapeConfig()
    slots = Slots(room_for(job.box_mesh), 1, config, "cpu")
    slots.place(build_model([job], config, "cpu"), [None])
    coarse, state, at = coarsen(job.box_mesh), slots.solver.state, slots.solver.model.vertices[0]
    positions = state.x.numpy()[at].copy()
    with ThreadPoolExecutor(2) as pool:
        with launch_lock, wp.ScopedCapture(device="cpu"):
            end = pool.submit(CoarseEnd.of, coarse, state, at, time=0.0, held=1, overfull=0)
            freed = pool.submit(slots.free, [0])
            assert not wait((end,), timeout=0.5).done
            assert not wait((freed,), timeout=0.5).done
        assert np.array_equal(end.result().x.numpy(), positions)
        freed.result()
    assert slots.solver.model.worlds.numpy()["size"][0] == 0


def test_garments_enter_and_leave_a_batch_without_a_change_for_others() -> None:
    """A garment moves as it does alone, whichever garments enter or leave the batch."""
    jobs, config = [on_a_ball(size) for size in (9, 13, 7, 11)], DrapeConfig()
    models = [build_model([job], config, "cpu") for job in jobs]
    slots = Slots(2 * max(rooms_of(model)[0] for model in models), 2, config, "cpu")

    def frames(count: int) -> None:
        for _ in range(count):
            slots.solver.frame()

    def require_same(number: int, world: int, count: int) -> None:
        alone = Solver(models[number], config)
        for _ in range(count):
            alone.frame()
        positions = slots.solver.state.x.numpy()[slots.solver.model.vertices[world]]
        np.testing.assert_array_equal(positions, alone.state.x.numpy())

    assert slots.place(models[0], [None]) == [0]
    frames(1)
    assert slots.place(models[1], [None]) == [1]
    assert slots.place(models[2], [None]) == []  # a third garment has no place
    frames(1)
    slots.free([0])
    assert slots.solver.state.status.numpy()[0] == DONE  # else its contacts go on, with a skin that is freed
    assert slots.place(models[2], [None]) == [0]
    frames(2)
    require_same(1, 1, 3)
    require_same(2, 0, 2)
    slots.free([0, 1])
    assert slots.place(build_model(jobs[:3:2], config, "cpu"), [None, None]) == [0, 1]
    frames(2)
    require_same(0, 0, 2)
    require_same(2, 1, 2)


def test_a_band_cut_too_small_is_overstretched() -> None:
    """A ring cut for half the girth of its body is stretched to twice its length."""
    barrel = trimesh.creation.cylinder(radius=12.0, segment=[[0.0, 60.0, 0.0], [0.0, 120.0, 0.0]], sections=48)
    body = body_from(barrel.subdivide().subdivide())
    for share, outcome in ((0.5, Outcome.OVERSTRETCHED), (0.97, Outcome.SETTLED)):
        band = tube(round(share * 2 * np.pi * 12.5 / 2.0), 4, radius=13.0, spacing=2.0, height=90.0)
        [drape] = drape_batch([DrapeJob(band, body, SIZE, Fabric(friction=3.0))], device="cpu")
        assert drape.outcome is outcome


def test_start_positions_of_another_mesh_are_refused() -> None:
    job = on_a_ball(4)
    with pytest.raises(ConfigError, match=r"3 start positions for the \d+ vertices of the box mesh"):
        replace(job, start=job.box_mesh.vertices[:3])


def test_a_job_that_cannot_be_draped_costs_no_other() -> None:
    good, config = on_a_ball(4), DrapeConfig(max_frames=1)
    mesh = good.box_mesh
    empty = replace(mesh, faces=mesh.faces[:0], corners=mesh.corners[:0], panel_id=mesh.panel_id[:0])
    beyond = replace(mesh, faces=mesh.faces + len(mesh.vertices))
    jobs = [replace(good, box_mesh=empty), good, replace(good, box_mesh=beyond)]
    first, drape, last = drape_batch(jobs, config, device="cpu")
    assert [drape] == drape_batch([good], config, device="cpu")
    assert first.outcome is last.outcome is Outcome.REFUSED
    assert "no faces" in first.reason
    assert "faces: numbers 25 to 49, but there are 25 rows" in last.reason
    assert drape_batch([], device="cpu") == []


@pytest.mark.parametrize("upper", ["Cape", "Poncho"])
def test_an_overgarment_settles_without_crossings_and_covers_both_shoulders(upper: str) -> None:
    worn = wear(design_from_dict({"meta": {"upper": upper}}), spacing=5.0)
    assert worn.drape.outcome is Outcome.SETTLED
    assert (worn.drape.self_crossings, worn.drape.body_crossings) == (0, 0)
    top = worn.drape.vertices[:, 1].max()
    for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM):
        arm = worn.body.vertices[worn.body.parts == part.value]
        assert arm[:, 1].max() < top < worn.body.vertices[:, 1].max()
        assert worn.drape.vertices[:, 0].min() < arm[:, 0].mean() < worn.drape.vertices[:, 0].max()


@pytest.mark.parametrize("sleeveless", [True, False], ids=["vest", "cardigan"])
def test_an_open_front_settles_on_both_shoulders_without_crossings(sleeveless: bool) -> None:
    sleeve = {"sleeveless": sleeveless, "length": 0.8}
    worn = wear(design_from_dict({"meta": {"upper": "Shirt"}, "front": {"closure": "open"}, "sleeve": sleeve}))
    assert worn.drape.outcome is Outcome.SETTLED
    assert (worn.drape.self_crossings, worn.drape.body_crossings, worn.drape.body_through) == (0, 0, 0)
    right, left = (worn.vertices_of(f"{side}_ftorso") for side in ("right", "left"))
    assert not set(right) & set(left)
    assert worn.drape.vertices[right, 0].mean() < -5.0 < 5.0 < worn.drape.vertices[left, 0].mean()


HOOD = MakeConfig(
    bodies="pooled",
    stage="mesh",
    resolution=3.0,
    design=Overlay.from_dict(
        {"meta": {"upper": {"options": ["Shirt", "FittedShirt"]}}, "collar": {"component": {"style": "Hood2Panels"}}}
    ),
)
EARS_OUT = (5, 7)  # seed and number of a design: ears pierce its hood


def table() -> Body:
    top = trimesh.creation.box(extents=[40.0, 20.0, 40.0])
    top.apply_translation([0.0, 60.0, 0.0])
    return body_from(top)


def on_a_table(mesh: BoxMesh) -> DrapeJob:
    return DrapeJob(mesh, table(), SIZE)


SHEET = patch(16, 16, place=LYING, origin=(-8.0, 72.0, 8.0))


def test_a_garment_beside_the_body_falls_below_the_floor() -> None:
    """Equally alone and in a batch; the drape ends as soon as every vertex is below the floor."""
    falls, stays = on_a_table(replace(SHEET, vertices=SHEET.vertices + [80.0, 0.0, 0.0])), on_a_table(SHEET)
    together = drape_batch([stays, falls], device="cpu")
    assert [drape.outcome for drape in together] == [Outcome.SETTLED, Outcome.FELL]
    assert drape_batch([falls], device="cpu") == [together[1]]
    assert -30.0 < together[1].vertices[:, 1].max() < 0.0
    assert together[1].frames < DrapeConfig().max_frames


def test_a_loose_component_falls_alone() -> None:
    scrap = patch(4, 4, place=LYING, origin=(80.0, 66.0, 1.0))
    [drape] = drape_batch([on_a_table(joined(SHEET, scrap))], DrapeConfig(max_frames=100), device="cpu")
    assert drape.outcome is Outcome.FELL
    assert drape.vertices[0, 1] > 70.0


def test_a_row_without_a_face_joins_no_pieces() -> None:
    """Sewing may collapse the faces of a corner; its row belongs to no panel."""
    mesh = joined(patch(4, 4, origin=(0.0, 90.0, 0.0)), patch(4, 4, origin=(0.0, -20.0, 0.0)))
    last = len(mesh.vertices) - 1
    bare = replace(mesh, uv=np.concatenate([mesh.uv, mesh.uv[-1:]]), uv_vertex=np.append(mesh.uv_vertex, last))
    assert fell(DrapeJob(mesh, far_ball(), SIZE), mesh.vertices)
    assert fell(DrapeJob(bare, far_ball(), SIZE), mesh.vertices)


def test_cloth_below_the_floor_is_a_fall_unless_it_hangs_from_above() -> None:
    mesh = patch(4, 30, origin=(0.0, -5.0, 0.0))
    assert not fell(DrapeJob(mesh, far_ball(), SIZE), mesh.vertices)
    assert fell(DrapeJob(mesh, far_ball(), SIZE), mesh.vertices - [0.0, 20.0, 0.0])
    heap, train = patch(4, 40, origin=(0.0, -20.0, 0.0)), patch(4, 140, origin=(0.0, -50.0, 0.0))
    said = fell(DrapeJob(heap, far_ball(), SIZE), heap.vertices)
    assert said == "51% of the cloth lies below the floor; it hangs from 20 to -20 cm"
    assert not fell(DrapeJob(train, far_ball(), SIZE), train.vertices)


def test_a_ring_round_both_ankles_has_slid_off_and_a_sock_has_not() -> None:
    """Also if the panels were placed there."""
    ring = tube(36, 3, radius=11.5, spacing=2.0, height=10.0)
    sock = replace(ring, vertices=ring.vertices * [0.4, 1.0, 0.4] + [10.0, 0.0, 0.0])
    said = off_body(DrapeJob(ring, far_ball(), SIZE), ring.vertices)
    assert said == "its top lies at 16 cm, below the knees at 43 cm"
    assert not off_body(DrapeJob(sock, far_ball(), SIZE), sock.vertices)


def test_a_ring_at_rest_round_the_feet_has_slid_off() -> None:
    """Without labels: a wide ring drops from the waist onto the foot of a post and rests there."""
    post = trimesh.creation.cylinder(radius=6.0, segment=[[0.0, -62.0, 0.0], [0.0, 68.0, 0.0]], sections=24)
    foot = trimesh.creation.cylinder(radius=40.0, segment=[[0.0, 0.0, 0.0], [0.0, 6.0, 0.0]], sections=48)
    shape = trimesh.util.concatenate([post, foot])
    shape = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(shape.vertices, shape.faces, 8.0))
    ring = tube(36, 3, radius=11.5, spacing=2.0, height=95.0)
    [drape] = drape_batch([DrapeJob(ring, body_from(shape), SIZE)], device="cpu")
    assert np.ptp(drape.vertices[:, 1]) < 8.0
    assert 6.0 < drape.vertices[:, 1].min() < drape.vertices[:, 1].max() < 20.0
    assert drape.outcome is Outcome.SLID_OFF
    assert "below the knees" in drape.reason


def test_a_neckline_belongs_above_the_armpits() -> None:
    """At 131 cm for this size; and its mean above the waist, at 107 cm."""
    labels, origin = {"left_collar": np.arange(30, 36)}, (0.0, SIZE.waist_level + 20.0, 0.0)
    dress = patch(5, 5, spacing=2.0, origin=origin, labels=labels)
    for lower, said in (
        (0.0, ""),
        (10.0, "its neckline lies at 127 cm, below the armpits at 131 cm"),
        (40.0, "its neckline lies at 97 cm, below the waist at 107 cm"),
    ):
        assert off_body(DrapeJob(dress, far_ball(), SIZE), dress.vertices - [0.0, lower, 0.0]) == said


@pytest.mark.parametrize("labels", [{}, {"left_collar": np.arange(36)}, {"lower_interface": np.arange(36)}])
def test_every_piece_of_an_outfit_belongs_on_the_body(labels: dict[str, np.ndarray]) -> None:
    """A top that stays up, and a skirt that is not sewn to it and has dropped to the ankles."""
    waist = SIZE.waist_level
    top = replace(tube(36, 3, radius=15.0, spacing=2.0, height=waist + 30.0), labels=labels)
    dress = joined(top, tube(36, 20, radius=15.0, spacing=2.0, height=waist - 42.0))
    job, of_skirt = DrapeJob(dress, far_ball(), SIZE), np.arange(len(dress.vertices)) >= len(top.vertices)
    dropped = dress.vertices - np.outer(of_skirt, [0.0, 70.0, 0.0])
    dropped[of_skirt, 1] = np.maximum(dropped[of_skirt, 1], 1.0)
    assert not off_body(job, dress.vertices)
    assert off_body(job, dropped)
    assert not fell(job, dropped)


def test_edges_of_a_spike_through_cloth_are_counted() -> None:
    """The tip pierces the inside of a face: no cloth edge segments_cross, but three edges of the body do."""
    spike = trimesh.Trimesh(
        [[50.0, 105.0, -25.0], [40.0, 60.0, -20.0], [60.0, 60.0, -20.0], [50.0, 60.0, -40.0]],
        [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]],
    )
    cloth = patch(1, 1, spacing=100.0, place=LYING, origin=(0.0, 100.0, 0.0))
    jobs = [DrapeJob(cloth, far_ball(), SIZE), DrapeJob(cloth, body_from(spike), SIZE)]
    solver = Solver(build_model(jobs, DrapeConfig(), "cpu"), DrapeConfig())
    assert solver.body_crossings().tolist() == [0, 0]
    assert solver.body_through().tolist() == [0, 3]


def test_internal_parts_and_lids_do_not_count_as_skin_through_cloth() -> None:
    """The top of a ball as an eye: neither the eye nor the lid over its opening counts."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    ball.apply_translation([0.0, 100.0, 0.0])
    inside = ball.vertices[:, 1] > 106.0
    parts = np.where(inside, BodyPart.INTERNAL.value, 0).astype(np.uint8)
    body = replace(body_from(ball), parts=parts)
    sheet = patch(1, 1, spacing=100.0, place=LYING, origin=(-31.0, 106.5, 52.0))
    counts = [
        Solver(build_model([DrapeJob(sheet, one, SIZE)], DrapeConfig(), "cpu"), DrapeConfig()).body_through()[0]
        for one in (body_from(ball), body)
    ]
    above = ball.vertices[ball.edges_unique][:, :, 1] > 106.5
    assert counts == [int((above[:, 0] != above[:, 1]).sum()), 0]


@pytest.fixture(scope="module")
def hooded() -> tuple[DrapeJob, Float[np.ndarray, "v 3"]]:
    """A draped hood, which covers the ears."""
    [worn] = prepare(*EARS_OUT, HOOD).dressed
    assert worn.box_mesh is not None
    job = DrapeJob(worn.box_mesh, worn.body, worn.size)
    [drape] = drape_batch([job], DrapeConfig(max_body_crossings=10), device="cpu")
    assert drape.body_through == len(piercing(job, drape.vertices))
    return job, drape.vertices


def test_ears_do_not_pierce_a_hood(hooded: tuple[DrapeJob, Float[np.ndarray, "v 3"]]) -> None:
    """A narrower hood they would pierce."""
    job, vertices = hooded
    assert len(piercing(job, vertices)) == 0
    ears = piercing(job, vertices * (0.9, 1.0, 1.0))
    assert (job.body.parts[ears] == BodyPart.HEAD.value).all(axis=1).sum() > 20


@pytest.mark.parametrize("shift", [(0.0, 0.0, 3.0), (0.0, -12.0, 0.0)])
def test_crossings_agree_with_exact_arithmetic(
    hooded: tuple[DrapeJob, Float[np.ndarray, "v 3"]], shift: tuple[float, float, float]
) -> None:
    """A garment moved through its body: every skin edge against all near triangles, by signs of volumes."""
    job, vertices = hooded
    solver = Solver(build_model([job], DrapeConfig(), "cpu"), DrapeConfig())
    moved = (vertices + shift).astype(np.float32)
    solver.state.x.assign(moved)
    expected = len(piercing(job, moved))
    assert expected > 100
    assert solver.body_through()[0] == expected


def piercing(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, "n 2"]:
    """The edges of the skin that cross the cloth."""
    body = job.body
    points = body.vertices.astype(np.float32).astype(float)
    skin = body.faces[(body.parts[body.faces] != BodyPart.INTERNAL.value).all(axis=1)]
    edges = np.unique(np.sort(skin[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    ends, triangles = points[edges], np.asarray(vertices, float)[job.box_mesh.faces]
    tree = cKDTree(triangles.mean(axis=1))
    reach = np.linalg.norm(triangles - triangles.mean(axis=1, keepdims=True), axis=2).max()
    half = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    near = tree.query_ball_point(ends.mean(axis=1), reach + half)
    edge = np.repeat(np.arange(len(edges)), [len(one) for one in near])
    face = np.concatenate([np.asarray(one, int) for one in near])
    hit = segments_cross(*ends[edge].transpose(1, 0, 2), *triangles[face].transpose(1, 0, 2))
    return edges[np.unique(edge[hit])]
