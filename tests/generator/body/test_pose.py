"""Posed bodies keep their bones and their volume, follow the root rigidly, and do not touch themselves."""

import hashlib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from gcd_dataset.errors import BodyError
from gcd_dataset.generator import standing
from gcd_dataset.generator.body import build_body, draw_shape, named_pose, named_shape, pose_body, walk
from gcd_dataset.generator.body.pose import POSES, TREE, TRUNK, pose_of, read_poses, rig, side_and_kind
from gcd_dataset.generator.body.shape import ARM_ROOM, arm_clearance
from gcd_dataset.generator.drape.self_contact import skin_crossings
from gcd_dataset.generator.standing import draw_pose, with_room
from gcd_dataset.records import BONES, Body, Pose
from gcd_dataset.seeding import Stage, rng


@pytest.fixture(scope="module", params=["female", "male"])
def body(request: pytest.FixtureRequest) -> Body:
    return build_body(named_shape(request.param))


@pytest.fixture(scope="module")
def woman() -> Body:
    return build_body(named_shape("female"))


def volume(body: Body) -> float:
    return float(trimesh.Trimesh(body.vertices, body.faces, process=False).volume)


def joint(body: Body, bone: str) -> np.ndarray:
    return np.asarray((rig().carriers @ body.vertices)[BONES.index(bone)])


def test_body_and_rig_are_small_and_match_their_checksums() -> None:
    folder = files("gcd_dataset.generator") / "data"
    for name, most in (("body.npz", 2e6), ("rig.npz", 25e3)):
        content = (folder / name).read_bytes()
        assert len(content) < most
        assert hashlib.sha256(content).hexdigest() == (folder / f"{name}.sha256").read_text().split()[0]
    assert len(BONES) <= 60
    assert list(dict.fromkeys(side_and_kind(bone)[1] for bone in BONES)) == list(TREE)
    assert BONES[: len(TRUNK)] == TRUNK


def test_joints_lie_inside_the_body(body: Body) -> None:
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    assert mesh.contains(rig().carriers @ body.vertices).all()


def test_without_rotations_a_body_stays_in_the_a_pose(woman: Body) -> None:
    still = pose_body(woman, Pose(dict.fromkeys(BONES, (0.0, 0.0, 0.0))))
    np.testing.assert_allclose(still.vertices, woman.vertices, atol=1e-6)
    assert pose_body(woman, named_pose("a-pose")).vertices is woman.vertices


BENT = {"forearm": (90, 0, 0), "thigh": (45, 0, 0), "shin": (-90, 0, 0)}


def test_bones_keep_their_length(woman: Body) -> None:
    posed = pose_body(woman, pose_of({bone: 0.5 * np.array(turn) for bone, turn in BENT.items()}, "bent"))
    for bone in ("left_upper_arm", "left_forearm", "right_thigh", "right_shin"):
        own = rig().skin[:, [BONES.index(bone)]].toarray().ravel() > 1.0 - 1e-9
        assert own.sum() > 30
        np.testing.assert_allclose(pdist(posed.vertices[own]), pdist(woman.vertices[own]), atol=1e-6)


def test_bent_limbs_keep_their_volume(body: Body) -> None:
    for turns in (BENT, POSES["arms-forward"], POSES["t-pose"]):
        assert volume(pose_body(body, pose_of(turns, "bent"))) == pytest.approx(volume(body), rel=0.015)


@pytest.mark.parametrize(("bone", "tip", "bend"), [("forearm", "hand", 90.0), ("shin", "foot", -90.0)])
def test_elbows_and_knees_do_not_collapse(body: Body, bone: str, tip: str, bend: float) -> None:
    """The section halfway between both limbs grows toward that of a mitre, the straight one over cos 45°."""
    centre, along = joint(body, f"left_{bone}"), joint(body, f"left_{tip}") - joint(body, f"left_{bone}")
    posed = pose_body(body, Pose({f"left_{bone}": (np.radians(bend), 0.0, 0.0)}))
    centre_now = centre + posed.vertices[0] - body.vertices[0]  # the head moves with the floor alone
    half = Rotation.from_rotvec(np.radians(bend / 2) * rig().axes[BONES.index(f"left_{bone}"), :, 0])
    straight, mitre = section_area(body, centre, along), section_area(posed, centre_now, half.apply(along))
    assert 1.1 * straight < mitre < 1.5 * straight


def section_area(body: Body, centre: np.ndarray, normal: np.ndarray) -> float:
    """Area of the convex hull of a limb's section through a joint [cm²]."""
    lines = trimesh.intersections.mesh_plane(
        trimesh.Trimesh(body.vertices, body.faces, process=False), normal / np.linalg.norm(normal), centre
    )
    points = lines.reshape(-1, 3)
    points = points[np.linalg.norm(points - centre, axis=1) < 10.0] - centre
    return float(ConvexHull(points @ np.linalg.svd(normal[None])[2][1:].T).volume)


def test_the_root_turns_the_whole_body(woman: Body) -> None:
    turned = pose_body(woman, Pose({"pelvis": (0.3, 0.2, -0.5)}))
    rotation, off = Rotation.align_vectors(
        turned.vertices - turned.vertices.mean(axis=0), woman.vertices - woman.vertices.mean(axis=0)
    )
    assert off < 1e-6
    assert rotation.magnitude() == pytest.approx(np.sqrt(0.3**2 + 0.2**2 + 0.5**2))


def test_the_mirrored_pose_gives_the_mirrored_body(woman: Body) -> None:
    turn = {"upper_arm": (0.3, 0.4, -0.2), "forearm": (0.5, 0.0, 0.1), "thigh": (0.3, 0.1, 0.1), "shin": (-0.2, 0, 0)}
    left, right = (pose_body(woman, Pose({f"{side}_{k}": v for k, v in turn.items()})) for side in ("left", "right"))
    assert cKDTree(left.vertices * [-1.0, 1.0, 1.0]).query(right.vertices)[0].max() < 1e-3


def test_forward_outward_and_heel_to_the_back(woman: Body) -> None:
    before = joint(woman, "left_hand")
    forward = joint(pose_body(woman, Pose({"left_upper_arm": (0.5, 0.0, 0.0)})), "left_hand")
    outward = joint(pose_body(woman, Pose({"left_upper_arm": (0.0, 0.5, 0.0)})), "left_hand")
    assert forward[2] > before[2] + 15.0
    assert outward[1] > before[1] + 10.0
    bent = pose_body(woman, Pose({"right_shin": (-1.0, 0.0, 0.0)}))
    assert joint(bent, "right_foot")[2] < joint(woman, "right_foot")[2] - 25.0


@pytest.mark.parametrize(("name", "pitch", "heading"), [("t-pose", 0.0, 90.0), ("arms-forward", -20.0, 15.0)])
def test_arms_of_named_poses_point_forward_and_aside(body: Body, name: str, pitch: float, heading: float) -> None:
    """Degrees above the horizontal, and from the front outwards."""
    posed = pose_body(body, named_pose(name))
    x, y, z = joint(posed, "left_hand") - joint(posed, "left_upper_arm")
    assert np.degrees(np.arctan2(y, np.hypot(x, z))) == pytest.approx(pitch, abs=6.0)
    assert np.degrees(np.arctan2(x, z)) == pytest.approx(heading, abs=8.0)


def test_named_and_drawn_poses_do_not_cut_the_body() -> None:
    neutral = build_body(named_shape("neutral"))
    assert skin_crossings(pose_body(neutral, pose_of({"upper_arm": (0, -50, 0)}, "arms in the trunk"))) > 0
    assert [name for name in POSES if skin_crossings(pose_body(neutral, named_pose(name)))] == []
    for seed in range(3):
        body = build_body(draw_shape(rng(seed, 0, Stage.BODY)))
        assert skin_crossings(pose_body(body, draw_pose(rng(seed, 0, Stage.POSE), body))) == 0


def test_drawn_poses_leave_room_for_cloth_below_the_armpits() -> None:
    """A raised arm has no part in the section there."""
    for number in (4, 7, 9):
        body = build_body(draw_shape(rng(0, number, Stage.BODY)))
        assert arm_clearance(pose_body(body, draw_pose(rng(0, number, Stage.POSE), body))) >= ARM_ROOM
    raised = {"left_upper_arm": (0, 60, 0), "left_shoulder": (0, 10, 0), "right_upper_arm": (0, -25, 0)}
    assert arm_clearance(pose_body(body, pose_of(raised, "one arm up"))) < 10.0


def test_gaits_leave_room_on_any_body(woman: Body) -> None:
    """Arms, thighs or both spread further where they would touch; a body with room walks as the gait says."""
    assert with_room(walk()[:40], woman) == tuple(walk()[:40])
    for number in (1, 2):
        body, poses = build_body(draw_shape(rng(11, number, Stage.BODY))), walk()
        assert any(skin_crossings(pose_body(body, pose)) for pose in poses[::8])
        roomy = [pose_body(body, pose) for pose in with_room(poses, body)[::8]]
        assert [skin_crossings(posed) for posed in roomy] == [0] * len(roomy)
        assert min(arm_clearance(posed) for posed in roomy) > 0.9 * min(ARM_ROOM, arm_clearance(body))


def test_a_body_that_always_touches_itself_gets_a_pose_of_that_name(
    woman: Body, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drawn again, a body that touches itself in its first poses gets another."""
    found = iter([1, 1, 0])
    monkeypatch.setattr(standing, "skin_crossings", lambda body: next(found))
    assert draw_pose(rng(0, 0, Stage.POSE), woman).name == "standing"
    assert not list(found)
    monkeypatch.setattr(standing, "skin_crossings", lambda body: 1)
    assert draw_pose(rng(0, 0, Stage.POSE), woman) == Pose({}, "a-pose")


def test_poses_of_a_file(tmp_path: Path) -> None:
    one, several, table = tmp_path / "one.json", tmp_path / "several.json", tmp_path / "table.toml"
    one.write_text('{"left_forearm": [30, 0, 0]}')
    several.write_text('[{"left_forearm": [30, 0, 0]}, {"head": [0, 0, 9]}]')
    table.write_text("[[poses]]\nleft_forearm = [30, 0, 0]\n[[poses]]\nhead = [0, 0, 9]\n")
    assert [pose.name for pose in read_poses(several)] == ["several:1", "several:2"]
    assert [pose.turns for pose in read_poses(table)] == [pose.turns for pose in read_poses(several)]
    assert named_pose(one).turns == read_poses(several)[0].turns
    with pytest.raises(BodyError, match=r"several\.json: holds 2 poses: give a file of one"):
        named_pose(several)
    one.write_text('{"right_upper_arm": [0, 60, 0], "forearm": [30, 0, 0]}')
    turns = named_pose(one).turns
    assert set(turns) == {"right_upper_arm", "left_forearm", "right_forearm"}
    assert turns["right_upper_arm"] == pytest.approx((0.0, np.pi / 3, 0.0))
    with pytest.raises(BodyError, match="no pose named lotus"):
        named_pose("lotus")
    for text, told in (
        ("[]", "an empty list"),
        ("[{}, 3]", r"one.json:2: not an object"),
        ('{"tail": [0]}', "no bone"),
        ('{"forearm": "bent"}', "three numbers"),
        ("[1]", "not an object of bones"),
        ("{", "one.json"),
    ):
        one.write_text(text)
        with pytest.raises(BodyError, match=told):
            named_pose(one)


def test_standing_poses_vary_and_stand_on_both_soles(woman: Body) -> None:
    posed = [pose_body(woman, draw_pose(rng(seed, 0, Stage.POSE), woman)) for seed in range(6)]
    hands = np.array([joint(each, "left_hand") for each in posed])
    assert (hands.std(axis=0) > 3.0).all()
    for each in posed:
        soles = [each.vertices[each.vertices[:, 0] * side > 0][:, 1].min() for side in (1.0, -1.0)]
        assert max(soles) < 2.0


@pytest.mark.parametrize(
    ("turns", "told"),
    [
        ({"tail": (0.0, 0.0, 0.0)}, "no bone named tail"),
        ({"left_shin": (1.0, 0.0, 0.0)}, "left_shin has a bend of 57.3°: give one from -135° to 10°"),
        ({"head": (0.0, float("nan"), 0.0)}, "three numbers"),
    ],
)
def test_impossible_poses_are_refused(woman: Body, turns: dict, told: str) -> None:
    with pytest.raises(BodyError, match=told):
        pose_body(woman, Pose(turns))


def test_only_bodies_of_the_model_have_bones(woman: Body) -> None:
    with pytest.raises(BodyError, match="not a mesh of the body model"):
        pose_body(Body(woman.vertices, woman.faces[:-1], woman.parts, "scan.obj"), named_pose("t-pose"))
