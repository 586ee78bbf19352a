"""Motions: BVH files move our bones as their own, damaged ones are named; gaits are possible and periodic."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.generator.body import GAITS, build_body, named_motion, named_shape, pose_body, read_motion, walk
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.motion import CMU
from gcd_dataset.generator.body.pose import parent_of, require_possible, rig
from gcd_dataset.generator.drape.self_contact import skin_crossings
from gcd_dataset.records import BONES, Body, Pose

A_POSE = {"": ("", (0, 0, 0))} | {
    bone: (parent_of(bone), tuple(at)) for bone, at in zip(BONES, rig().carriers @ body_model().mean, strict=True)
}
"""Bone to its parent and its place."""
LEFT = {  # joint of CMU: its parent and its place; the legs stand 20° off the vertical
    "LHipJoint": ("Hips", (0, 0, 0)), "LeftUpLeg": ("LHipJoint", (1.5, -1.7, 0.8)),
    "LeftLeg": ("LeftUpLeg", (3.9, -8.3, 0.8)), "LeftFoot": ("LeftLeg", (6.5, -15.3, 0.8)),
    "LeftToeBase": ("LeftFoot", (6.6, -15.7, 2.9)), "LeftShoulder": ("Spine1", (0, 4, -0.2)),
    "LeftArm": ("LeftShoulder", (3.3, 5, 0)), "LeftForeArm": ("LeftArm", (8.3, 5, 0)),
    "LeftHand": ("LeftForeArm", (11.6, 5, 0)), "LThumb": ("LeftHand", (11.6, 5, 0)),
}  # fmt: skip
T_POSE = {
    "Hips": ("", (0, 0, 0)), "LowerBack": ("Hips", (0, 0, 0)), "Spine": ("LowerBack", (0, 2, -0.1)),
    "Spine1": ("Spine", (0, 4, -0.2)), "Neck": ("Spine1", (0, 4, -0.2)), "Neck1": ("Neck", (0, 5, 0)),
    "Head": ("Neck1", (0, 6.5, 0)), **LEFT,
    **{
        joint.replace("Left", "Right").replace("LH", "RH").replace("LT", "RT"): (
            parent.replace("Left", "Right").replace("LH", "RH"), (-x, y, z)
        )
        for joint, (parent, (x, y, z)) in LEFT.items()
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def body() -> Body:
    return build_body(named_shape("neutral"))


def bvh(rest: dict, frames: Sequence[dict[str, Rotation]], *, seconds: float = 1 / 30, order: str = "ZYX") -> str:
    """A BVH file of a rest pose and, for each frame, the rotations of its joints."""
    lines, order_of_joints = ["HIERARCHY"], []

    def add(joint: str, kind: str) -> None:
        order_of_joints.append(joint)
        parent, at = rest[joint]
        offset = np.subtract(at, rest[parent][1] if parent else at)
        lines.extend([f"{kind} {joint}", "{", "OFFSET " + " ".join(map(str, offset))])
        moved = "6 Xposition Yposition Zposition" if kind == "ROOT" else "3"
        lines.append(f"CHANNELS {moved} " + " ".join(f"{axis}rotation" for axis in order))
        for child, (above, _) in rest.items():
            if above == joint and child:
                add(child, "JOINT")
        if joint not in {above for above, _ in rest.values()}:
            lines.extend(["End Site", "{", "OFFSET 0 1 0", "}"])
        lines.append("}")

    add(next(joint for joint, (parent, _) in rest.items() if joint and not parent), "ROOT")
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {seconds}"]
    for turns in frames:
        angles = [turns.get(joint, Rotation.identity()).as_euler(order, degrees=True) for joint in order_of_joints]
        lines.append(" ".join(f"{angle:.9f}" for angle in (7.0, 90.0, -3.0, *np.concatenate(angles))))
    return "\n".join(lines)


def turns_of(pose: Pose) -> dict[str, Rotation]:
    return {bone: Rotation.from_rotvec(rig().axes[BONES.index(bone)] @ turn) for bone, turn in pose.turns.items()}


def angles(poses: Sequence[Pose]) -> np.ndarray:
    return np.degrees([[pose.turns.get(bone, (0.0, 0.0, 0.0)) for bone in BONES] for pose in poses])


def test_a_motion_comes_back_from_a_file_of_our_bones(tmp_path: Path) -> None:
    """In other axes and units too; the wearer of the file walks sideways, that of the motion straight on."""
    poses = walk(GAITS["brisk-walk"])[:40]
    aside = Rotation.from_euler("Y", 70.0, degrees=True)
    frames = [turns_of(pose) for pose in poses]
    frames = [{**turns, "pelvis": aside * turns["pelvis"]} for turns in frames]
    inches = {bone: (parent, tuple(np.divide(at, 2.54))) for bone, (parent, at) in A_POSE.items()}
    (tmp_path / "walk.bvh").write_text(bvh(inches, frames, order="XYZ"))
    read = read_motion(tmp_path / "walk.bvh")
    np.testing.assert_allclose(angles(read), angles(poses), atol=1e-3)
    assert read[1].name == f"{tmp_path / 'walk.bvh'}, frame 2"


def test_limbs_point_where_cmus_do(tmp_path: Path, body: Body) -> None:
    """From a T-pose with the legs apart, which CMU's files have as their first frame; elbows bend about any hinge."""
    hinge = np.array([0.0, -np.cos(0.6), np.sin(0.6)])
    turns = {
        "Hips": Rotation.from_rotvec([0.02, 0.0, 0.0]),
        "LeftArm": Rotation.from_euler("ZX", [-60.0, 10.0], degrees=True),
        "LeftForeArm": Rotation.from_rotvec(0.9 * hinge),
        "RightArm": Rotation.from_euler("ZY", [50.0, -30.0], degrees=True),
        "LeftUpLeg": Rotation.from_euler("ZX", [-17.0, -25.0], degrees=True),
        "RightUpLeg": Rotation.from_euler("Z", 18.0, degrees=True),
    }
    upright = {"Hips": Rotation.identity(), "LeftUpLeg": Rotation.from_euler("Z", -20.0, degrees=True)}
    (tmp_path / "cmu.bvh").write_text(bvh(T_POSE, [upright, turns]))
    [pose] = read_motion(tmp_path / "cmu.bvh")
    bend, spread, _ = angles([pose])[0, BONES.index("left_forearm")]
    assert bend > 40.0 and abs(spread) < 6.0
    whole: dict[str, Rotation] = {"": Rotation.identity()}
    for joint, (parent, _) in T_POSE.items():
        whole[joint] = whole[parent] * turns.get(joint, Rotation.identity())
    facing = whole["Hips"].apply([0.0, 0.0, 1.0])
    straight = Rotation.from_rotvec([0.0, -np.arctan2(facing[0], facing[2]), 0.0])
    places = rig().carriers @ pose_body(body, pose).vertices
    for side, prefix in (("left_", "Left"), ("right_", "Right")):
        for bone, tip in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shin"), ("shin", "foot")):
            (_, at), (_, end) = T_POSE[prefix + CMU[bone]], T_POSE[prefix + CMU[tip]]
            theirs = (straight * whole[prefix + CMU[bone]]).apply(np.subtract(end, at))
            ours = places[BONES.index(side + tip)] - places[BONES.index(side + bone)]
            cosine = ours @ theirs / np.linalg.norm(ours) / np.linalg.norm(theirs)
            assert np.degrees(np.arccos(cosine)) < (5.0 if "arm" in bone else 9.0)


def test_poses_between_frames_are_interpolated(tmp_path: Path) -> None:
    """A file of 10 frames a second read at 20, and at 5."""
    lifted = [{"left_thigh": Rotation.from_rotvec([-0.1 * frame, 0.0, 0.0])} for frame in range(5)]
    (tmp_path / "lift.bvh").write_text(bvh(A_POSE, lifted, seconds=0.1))
    thigh = BONES.index("left_thigh")
    for fps, count in ((20.0, 9), (5.0, 3)):
        bends = np.linalg.norm(angles(read_motion(tmp_path / "lift.bvh", fps=fps))[:, thigh], axis=1)
        np.testing.assert_allclose(bends, np.degrees(np.linspace(0.0, 0.4, count)), atol=1e-6)
    with pytest.raises(ConfigError, match="0 poses a second"):
        read_motion(tmp_path / "lift.bvh", fps=0.0)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda text: text.replace("left_hand", "tail"), "no bone for joint tail: name joints as CMU does"),
        (lambda text: text.replace("left_hand", "left_foot"), "joint left_foot occurs twice"),
        (lambda text: text.replace("left_hand", "LThumb"), "no joint LeftHand or left_hand"),
        (lambda text: text[: text.index("MOTION") - 4] + text[text.index("MOTION") :], "the hierarchy is cut off"),
        (lambda text: text.rsplit("\n", 1)[0], "1 frames instead of 2"),
        (lambda text: text.rsplit(" ", 1)[0], "frame 2: 65 numbers instead of 66"),
        (lambda text: text.rsplit(" ", 1)[0] + " nan", "frame 2: the Xrotation of .* is nan"),
        (lambda text: text.rsplit(" ", 1)[0] + " 1,5", "frame 2: the Xrotation of .* is 1,5"),
        (lambda text: text.replace("OFFSET", "OFSET", 1), "line 4: OFSET is no word of a hierarchy"),
        (lambda text: text.replace("Xrotation", "Yrotation", 1), "line 5: pelvis needs an Xrotation"),
        (lambda text: text.replace("Frame Time", "Time", 1).replace("Frames: 2", "Frames: two"), "no Frames and Frame"),
        (lambda text: "\x7fELF", "give the path of a BVH file"),
    ],
)  # fmt: skip
def test_damaged_files_are_named(tmp_path: Path, spoil: Callable[[str], str], told: str) -> None:
    path = tmp_path / "wave.bvh"
    path.write_text(spoil(bvh(A_POSE, [{}, {}])))
    with pytest.raises(BodyError, match=told) as error:
        read_motion(path)
    assert str(error.value).startswith(str(path))


def test_a_frame_beyond_the_limits_is_named(tmp_path: Path) -> None:
    """Captured angles are set to a limit that they pass by less than 20°."""
    path = tmp_path / "kick.bvh"
    bend = rig().axes[BONES.index("left_shin"), :, 0]
    path.write_text(bvh(A_POSE, [{"left_shin": Rotation.from_rotvec(angle * bend)} for angle in (0.0, 0.4, 0.9)]))
    message = r"kick.bvh, frame 3: left_shin has a bend of 51.6°: give one from -135° to 10°"
    with pytest.raises(BodyError, match=message):
        read_motion(path)
    path.write_text(bvh(A_POSE, [{"left_shin": Rotation.from_rotvec(0.4 * bend)}]))
    assert angles(read_motion(path))[0, BONES.index("left_shin"), 0] == pytest.approx(10.0)
    lying = {bone: (parent, (x, -z, y)) for bone, (parent, (x, y, z)) in A_POSE.items()}
    path.write_text(bvh(lying, [{}]))
    with pytest.raises(BodyError, match="does not stand along y"):
        read_motion(path)


def test_gaits_alternate_the_legs_and_touch_nothing(body: Body) -> None:
    """From standing; the second cycle ends as the first, and half a cycle on, left and right have changed places."""
    for name in GAITS:
        poses = named_motion(name)
        for pose in poses:
            require_possible(pose)
        assert max(skin_crossings(pose_body(body, pose)) for pose in poses[4::9]) == 0
    walked = walk(fps=28 * 112 / 120)  # 28 frames a cycle
    np.testing.assert_allclose(angles(walked)[28], angles(walked)[56], atol=1e-9)
    left, right = (angles(walked)[:, [BONES.index(f"{side}_{bone}") for bone in ("thigh", "shin", "foot")]]
                   for side in ("left", "right"))  # fmt: skip
    np.testing.assert_allclose(left[20:40], right[34:54], atol=1e-9)
    feet = [(rig().carriers @ pose_body(body, pose).vertices)[BONES.index("left_foot"), 2] for pose in walked[28:56:7]]
    assert max(feet) - min(feet) > 40.0
    with pytest.raises(BodyError, match="no motion named lotus: there are walk, walk-cycle, stroll"):
        named_motion("lotus")
