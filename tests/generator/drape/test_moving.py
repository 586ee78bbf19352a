"""Bodies that move under their garments: carried by friction, without crossings, each world on its own."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from jaxtyping import Float

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body import named_pose, pose_body
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch, drape_motion, fabric_named
from gcd_dataset.generator.drape import moving as moving_module
from gcd_dataset.generator.drape.batches import PreparedJob
from gcd_dataset.generator.drape.body_field import AXES
from gcd_dataset.generator.drape.drape import drape_on
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.moving import Motion
from gcd_dataset.generator.drape.slots import WIDTH, Slots, rooms_of
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.records import Body, Drape, Outcome, Pose
from tests.generator.drape.garments import Worn, job_of, neutral
from tests.generator.drape.probes import same_skin_kernel
from tests.generator.drape.test_drape import SHEET, on_a_ball, on_a_table, table


def shifted(body: Body, by: Float[np.ndarray, "3"]) -> Body:
    return replace(body, vertices=body.vertices + by)


def slots_of(*jobs: DrapeJob) -> Slots:
    """A batch with a world for each job, after five frames."""
    model = build_model(jobs, config := DrapeConfig(coarse_start=False), "cpu")
    slots = Slots(sum(rooms_of(model)), len(jobs), config, "cpu")
    assert slots.place(model, [None] * len(jobs)) == list(range(len(jobs)))
    step(slots, 5)
    return slots


def step(slots: Slots, frames: int) -> None:
    for _ in range(frames):
        slots.solver.frame()


def cloth(slots: Slots, w: int) -> Float[np.ndarray, "v 3"]:
    return np.array(slots.solver.state.x.numpy()[slots.solver.model.vertices[w]])


@pytest.mark.parametrize(("speed", "way"), [(12.0, (12.0, 3.0, 0.0)), (400.0, (0.0, 200.0, 0.0))])
def test_a_table_carries_its_cloth(speed: float, way: tuple[float, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Sideways by friction against the moving skin; up and down as well, and without a crossing.

    Also as fast as a shin in a walk, by more than the reach of the search in a frame.
    """
    monkeypatch.setattr(moving_module, "SPEED", speed)
    slots = slots_of(on_a_table(SHEET))
    step(slots, 30)
    before, by = cloth(slots, 0), np.array(way)
    slots.move(0, Motion.of([table(), shifted(table(), by)]))
    step(slots, slots.solver.moving[0].frames + 5)
    x, y, z = (cloth(slots, 0) - before).mean(axis=0) - by
    assert (x, z) == pytest.approx((0.0, 0.0), abs=0.3)
    assert -0.3 < y < 0.3 + 10.0 * (speed > 100.0)  # fast cloth flies on
    assert slots.solver.body_crossings()[0] == slots.solver.body_through()[0] == 0


def test_a_plane_is_kept_while_cloth_rides_with_the_skin_that_it_was_found_on() -> None:
    """Skin of 3 m/s: cloth with it, cloth that slid by 0.4 cm, cloth that stayed behind; a plane of a past frame."""
    x = wp.array([[1.5, 0, 0.2], [1.5, 0, 0.4], [0, 0, 0], [-1.5, 0, 0]], dtype=wp.vec3, device="cpu")
    asked = wp.array([[0, 0, 0, lag] for lag in (0.005, 0.005, 0.005, 0.015)], dtype=wp.vec4, device="cpu")
    kept = wp.empty(4, dtype=wp.bool, device="cpu")
    wp.launch(same_skin_kernel, 4, [x, wp.vec3(300.0, 0.0, 0.0), asked, 0.01, kept], device="cpu")
    assert list(kept.numpy()) == [True, False, False, False]


def test_equal_bodies_move_on_their_own() -> None:
    """Equal bodies move two ways in a batch, and a third stays: each garment is as it is alone."""
    job = on_a_ball(7)
    motions = [Motion.of([job.body, shifted(job.body, np.array(by))]) for by in ([6.0, 0.0, 0.0], [0.0, 5.0, -3.0])]

    def drape(*ways: Motion | None) -> list[np.ndarray]:
        slots = slots_of(*(job for _ in ways))
        for w, motion in enumerate(ways):
            if motion:
                slots.move(w, motion)
        step(slots, 12)
        return [cloth(slots, w) for w in range(len(ways))]

    together = drape(motions[0], None, motions[1])
    for way, there in zip((motions[0], None, motions[1]), together, strict=True):
        np.testing.assert_array_equal(drape(way)[0], there)
    assert len({x.tobytes() for x in together}) == 3


def test_points_go_back_with_the_trunk() -> None:
    body, _ = neutral()
    motion = Motion.to_pose(body, Pose({"pelvis": (1.2, 0.0, 0.0), "left_thigh": (0.5, 0.0, 0.0)}))
    trunk = motion.trunk[: len(body.vertices)] & (body.vertices[:, 1] > 100.0)
    np.testing.assert_allclose(motion.undone(motion.body.vertices[trunk]), body.vertices[trunk], atol=2.0)
    assert len(motion.keys) == 10  # 69° in steps of 8° at most


@pytest.fixture(scope="module")
def tee() -> DrapeJob:
    return job_of({"meta": {"upper": "Shirt"}, "sleeve": {"sleeveless": False, "length": 0.5}}, spacing=4.0)


def test_sleeves_go_up_with_the_arms(tee: DrapeJob) -> None:
    """Of a shirt on a body that moves to the T-pose: at rest, without crossings, each sleeve still round its arm."""
    pose = named_pose("t-pose")
    [drape] = drape_batch([replace(tee, pose=pose)], DrapeConfig(most_drapes=1), device="cpu")
    assert drape.outcome is Outcome.SETTLED
    assert drape.self_crossings + drape.body_crossings + drape.body_through == 0
    worn = Worn(tee.box_mesh, drape, pose_body(tee.body, pose))
    for side, sign in (("left arm", 1.0), ("right arm", -1.0)):
        [cuff] = [rim for rim in worn.openings(side) if sign * drape.vertices[rim, 0].mean() > 30.0]
        assert np.ptp(drape.vertices[cuff, 0]) < 8.0  # a vertical ring, as the arm is level
        assert drape.vertices[cuff, 1].min() > 120.0


def test_the_axes_of_the_parts_move_with_the_body(tee: DrapeJob) -> None:
    """Crossing cloth is pulled toward the axis of its own part: in the T-pose, toward a level arm."""
    slots, arm = slots_of(tee), list(AXES).index("left arm")
    solver = slots.solver
    upper, hand = solver.model.cloth.axes.numpy()[:2, arm]
    assert upper[1] - hand[1] > 25.0
    slots.move(0, Motion.to_pose(tee.body, named_pose("t-pose")))
    for _ in range(solver.moving[0].frames + 2):
        solver.moving[0].advance(solver.state, solver.model.cloth)
    upper, hand = solver.model.cloth.axes.numpy()[:2, arm]
    assert abs(upper[1] - hand[1]) < 6.0
    assert hand[0] - upper[0] > 30.0


def test_impossible_poses_cost_no_other_garment(tee: DrapeJob) -> None:
    broken = replace(tee, pose=Pose({"left_shin": (2.0, 0.0, 0.0)}, "knee to the front"))
    scan = replace(on_a_table(SHEET), pose=named_pose("t-pose"))
    drapes = drape_batch([broken, scan, on_a_ball(5)], DrapeConfig(max_frames=5), device="cpu")
    assert [drape.outcome is Outcome.REFUSED for drape in drapes] == [True, True, False]
    assert "left_shin has a bend of 114.6°" in drapes[0].reason
    assert "not a mesh of the body model" in drapes[1].reason
    worn = WornCloth.of(tee.box_mesh, tee.box_mesh.vertices)
    with pytest.raises(ConfigError, match="cannot move"):
        replace(tee, pose=named_pose("t-pose"), under=(worn,))


def test_a_motion_yields_a_drape_for_each_pose() -> None:
    """A skirt on a walking body keeps its waist and stays clear of the legs; a motion without poses yields nothing."""
    job = job_of({"meta": {"bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.3}}, spacing=5.0)
    steps = np.radians(4.0 * np.arange(4))
    walk = [Pose({"left_thigh": (a, 0.0, 0.0), "right_thigh": (-a, 0.0, 0.0)}) for a in steps]
    drapes = list(drape_motion(job, walk, device="cpu"))
    assert [drape.outcome for drape in drapes] == [Outcome.SETTLED] * 4
    assert max(drape.body_crossings + drape.body_through for drape in drapes) == 0  # of the body in its pose
    hems = [np.sort(drape.vertices[:, 2])[-10:].mean() for drape in drapes]
    assert hems[3] > hems[0] + 0.5  # the left thigh lifts the front
    assert list(drape_motion(job, [], device="cpu")) == []


def test_cloth_behind_a_bent_knee_does_not_cross_itself() -> None:
    trousers = {"meta": {"bottom": "Pants", "wb": "StraightWB"}, "pants": {"length": 0.9, "width": 1.3}}
    bends = [Pose({"left_thigh": (0.15 * k, 0.0, 0.0), "left_shin": (-0.3 * k, 0.0, 0.0)}) for k in range(6)]
    drapes = list(drape_motion(job_of(trousers, spacing=4.0), bends, fps=15.0, device="cpu"))
    assert [drape.self_crossings for drape in drapes] == 6 * [0]


def test_garments_in_motion_are_those_of_each_alone() -> None:
    """In a batch, of other cloth and other motions, of which one ends earlier."""
    alone, jobs, ways = list[list[Drape]](), list[DrapeJob](), list[list[Motion]]()
    skirt = {"meta": {"bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.2}}
    shirt = {"meta": {"upper": "Shirt"}}
    for design, fabric, count in ((skirt, "denim", 3), (shirt, "gcd_soft", 4)):
        job = replace(job_of(design, spacing=4.0), fabric=fabric_named(fabric))
        poses = [Pose({"left_thigh": (0.06 * k, 0.0, 0.0)}) for k in range(count)]
        alone.append(list(drape_motion(job, poses, device="cpu")))
        jobs.append(replace(job, pose=poses[0]))
        ways.append([Motion.through(job.body, poses)])
    ways[1] = [Motion.through(job.body, poses[:2]), Motion.through(job.body, poses[1:])]  # the same motion in two parts
    together = [[drapes[0]] for drapes in alone]
    prepared = [PreparedJob.of(job) for job in jobs]
    for number, drape in drape_on(prepared, [drapes[0] for drapes in alone], ways, device="cpu"):
        together[number].append(drape)
    assert [len(drapes) for drapes in together] == [3, 4]
    for one, other, apart in zip(alone, together, (0.0, 0.02), strict=True):
        for drape, same in zip(one, other, strict=True):
            np.testing.assert_allclose(drape.vertices, same.vertices, atol=apart, rtol=0.0)


def test_buffers_hold_the_garments_that_they_are_made_for() -> None:
    """Also of woven cloth, whose warp and weft are coupled, and vertices with many neighbours, as round a pocket."""
    job = job_of({"meta": {"upper": "Shirt"}, "pocket": {"chest": "both"}}, spacing=3.0)
    model = build_model([replace(job, fabric=fabric_named("denim"))], config := DrapeConfig(), "cpu")
    assert model.rows.width > WIDTH
    assert model.rows.coupled
    assert Slots.of(model, config, [None]).suits(model)
    assert not Slots(sum(rooms_of(model)), 1, config, "cpu").suits(model)
