"""Bodies of model files of the SMPL family, and motions of AMASS; the files are of that layout, made here.

No real model file was at hand: they may not be redistributed.
"""

import pickle
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gcd_dataset.cli import main
from gcd_dataset.errors import BodyError
from gcd_dataset.generator import MakeConfig
from gcd_dataset.generator.body import (
    GAITS,
    build_body,
    measure,
    named_body,
    named_pose,
    named_shape,
    pose_body,
    read_motion,
    walk,
)
from gcd_dataset.generator.body.pose import rig, whole_turns
from gcd_dataset.generator.body.smpl import BONE_OF, JOINTS, PARENT, ModelBody, joint_names, parents_of, read_model
from gcd_dataset.generator.drape.moving import Motion
from gcd_dataset.records import BONES, Body, Pose

Turns = Mapping[str, Rotation]
ROOT = Rotation.from_euler("x", 90.0, degrees=True)
"""From y up, as in models, to AMASS's z up."""


def arrays_of(vertices: np.ndarray, faces: np.ndarray, regressor: np.ndarray, weights: np.ndarray) -> dict[str, Any]:
    """The arrays of a model file without shapes and correctives."""
    names = joint_names(len(regressor))
    return {
        "v_template": vertices,
        "f": faces.astype(np.uint32),
        "shapedirs": np.zeros((len(vertices), 3, 10)),
        "posedirs": np.zeros((len(vertices), 3, 9 * (len(names) - 1))),
        "J_regressor": regressor,
        "weights": weights,
        "kintree_table": np.array([[2**32 - 1, *parents_of(names)[1:]], range(len(names))], np.uint32),
        "joint2num": np.array({"pelvis": 0}, object),
    }


def beads(count: int, seed: int = 0) -> dict[str, Any]:
    """A model of four vertices round each joint, with drawn joints, weights, shapes and correctives."""
    draw = np.random.default_rng(seed)
    joints = draw.normal(size=(count, 3))
    arrays = arrays_of(
        np.concatenate([joints + corner for corner in (np.eye(3) - 1 / 3).tolist()] + [joints]),
        np.arange(3 * count).reshape(3, count).T,
        np.tile(np.eye(count), 4) / 4,
        draw.dirichlet(np.ones(count), size=4 * count),
    )
    for key in ("shapedirs", "posedirs"):
        arrays[key] = 0.1 * draw.normal(size=arrays[key].shape)
    return arrays


def skinned(arrays: Mapping[str, Any], betas: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Vertices by the formulas of Loper et al. (2015), joint by joint in homogeneous matrices."""
    shaped = arrays["v_template"] + arrays["shapedirs"][:, :, : len(betas)] @ betas
    joints, turns = arrays["J_regressor"] @ shaped, Rotation.from_rotvec(angles).as_matrix()
    posed = shaped + arrays["posedirs"] @ (turns[1:] - np.eye(3)).ravel()
    whole: list[np.ndarray] = []
    for number, parent in enumerate(arrays["kintree_table"][0].astype(np.int32)):
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = turns[number], joints[number] - (joints[parent] if number else 0.0)
        whole.append(whole[parent] @ own if number else own)
    at_rest = [
        matrix @ np.block([[np.eye(3), -joint[:, None]], [np.zeros(3), 1.0]])
        for matrix, joint in zip(whole, joints, strict=True)
    ]
    matrices = np.einsum("vj,jab->vab", arrays["weights"], at_rest)
    return np.einsum("vab,vb->va", matrices, np.pad(posed, ((0, 0), (0, 1)), constant_values=1.0))[:, :3]


def amass(path: Path, frames: Sequence[Turns], *, count: int = 52, fps: float = 30.0, **more: Any) -> Path:
    """A file of AMASS's layout: rotations of joints by name, the root's as if y were up."""
    rows = [angles({**turns, "pelvis": ROOT * turns.get("pelvis", Rotation.identity())}, count) for turns in frames]
    arrays = {
        "poses": np.reshape(rows, (len(frames), -1)),
        "mocap_framerate": np.array(fps),
        "betas": np.zeros(16),
        "trans": np.ones(3),
    }
    np.savez(path, **(arrays | {"gender": np.array("female")} | more))
    return path


def angles(turns: Turns, count: int) -> np.ndarray:
    return np.array([turns.get(name, Rotation.identity()).as_rotvec() for name in joint_names(count)])


def body_of(model: ModelBody) -> Body:
    """The model's mesh as a body, with the centre of its first face's corners as the patch of a hole."""
    kept, faces = np.ones(len(model.template), bool), np.append(model.faces, [[0, 1, len(model.template)]], axis=0)
    whole = model.closed(kept, faces, len(kept) + 1, 100.0)
    return Body(whole(Pose({})), faces, np.zeros(len(kept) + 1, np.uint8), posed=whole)


@pytest.fixture(scope="module")
def own() -> Body:
    return build_body(named_shape("neutral"))


@pytest.fixture(scope="module")
def model_file(own: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model in SMPL-H's layout of our neutral body in the T-pose, which one beta makes taller."""
    vertices, names = pose_body(own, named_pose("t-pose")).vertices / 100.0, joint_names(52)
    bones = dict(zip(JOINTS, BONE_OF, strict=True))
    for name in names[len(JOINTS) :]:
        bones[name] = bones[PARENT[name]]
    rows = [BONES.index(bones[name]) for name in names]
    weights = np.zeros((len(vertices), len(names)))
    for number, name in enumerate(names[: len(JOINTS)]):
        weights[:, number] = rig().skin.toarray()[:, rows[number]] * (name != "spine2")
    carriers = rig().carriers.toarray()[rows]
    arrays = arrays_of(vertices - carriers[0] @ vertices, own.faces, carriers, weights)
    arrays["shapedirs"][:, :, 0] = 0.02 * arrays["v_template"]
    path = tmp_path_factory.mktemp("models") / "model.npz"
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("count", [24, 52, 55])
def test_bodies_are_skinned_as_published(tmp_path: Path, count: int) -> None:
    """In every frame of a motion, up to the way that it faces, the floor and centimetres."""
    arrays, draw, betas = beads(count), np.random.default_rng(1), np.array([0.5, -1.0])
    np.savez(tmp_path / "model.npz", **arrays)
    model = read_model(tmp_path / "model.npz", "0.5,-1")
    body = body_of(model)
    drawn = [dict(zip(model.names, Rotation.random(count, random_state=draw), strict=True)) for _ in range(3)]
    frames = [{**turns, "pelvis": Rotation.from_euler("y", 20.0 * k, degrees=True)} for k, turns in enumerate(drawn)]
    poses = read_motion(amass(tmp_path / "a.npz", frames, count=count), body=body)
    assert len(poses) == 3
    for pose, turns in zip(poses, frames, strict=True):
        theirs = 100.0 * skinned(arrays, betas, angles(turns, count))
        found = pose_body(body, pose).vertices
        np.testing.assert_allclose(found[:-1] - found[0], theirs - theirs[0], atol=1e-9)
        np.testing.assert_allclose(found[-1], found[:2].mean(axis=0), atol=1e-9)
        assert found[:, 1].min() == 0.0


def test_the_root_turns_the_whole_and_an_elbow_its_forearm(tmp_path: Path) -> None:
    np.savez(tmp_path / "model.npz", **beads(24) | {"weights": np.tile(np.eye(24), (4, 1))})
    model = read_model(tmp_path / "model.npz")
    at_home, turn = model(Pose({})), Rotation.from_rotvec([0.3, -0.8, 0.5])
    whole = model(Pose({"smpl:pelvis": tuple(turn.as_rotvec())}))
    np.testing.assert_allclose(whole - whole[0], turn.apply(at_home - at_home[0]), atol=1e-12)
    plain = ModelBody(model.template, model.faces, model.joints, model.weights, 0.0 * model.correctives)
    for pose in (Pose({"smpl:left_elbow": (0.0, -1.2, 0.0)}), Pose({"left_forearm": (1.2, 0.0, 0.0)})):
        moved, before = (plain(each)[72:] for each in (pose, Pose({})))  # the vertices at the joints
        ends = [JOINTS.index(name) for name in ("left_elbow", "left_wrist")]
        still = [JOINTS.index(name) for name in ("pelvis", "left_shoulder", "right_wrist", "left_elbow")]
        np.testing.assert_allclose(moved[still], before[still], atol=1e-12)
        assert np.linalg.norm(np.subtract(*moved[ends])) == pytest.approx(np.linalg.norm(np.subtract(*before[ends])))
        assert np.linalg.norm(moved[ends[1]] - before[ends[1]]) > 0.1


@pytest.mark.long
def test_a_model_file_is_a_body_in_the_a_pose(model_file: Path, own: Body) -> None:
    """Its measures are those of the same body in our rig; linear blending moves the shoulders' skin somewhat."""
    body, size, shape = named_body(f"smplx:{model_file}")
    taller = named_body(model_file, betas=[1.0])[1]
    ours = measure(own)
    assert shape is None and body.name == "model"
    for key in ("height", "bust", "waist", "hips", "leg_circ", "arm_length"):
        assert getattr(size, key) == pytest.approx(getattr(ours, key), abs=0.7)
        assert getattr(taller, key) == pytest.approx(1.02 * getattr(size, key), rel=2e-3)
    with pytest.raises(BodyError, match="leave segmentation, height and betas out"):
        named_body("neutral", betas=[1.0])


def test_it_takes_our_poses_and_gaits(model_file: Path, own: Body) -> None:
    """Its T-pose is the template; bones point as ours do in the same pose, and the garment's collider arrives there."""
    body, _, _ = named_body(model_file)
    with np.load(model_file) as file:
        template = 100.0 * file["v_template"]
    t_pose = pose_body(body, named_pose("t-pose")).vertices
    np.testing.assert_allclose(t_pose - t_pose[0], template - template[0], atol=1e-9)
    pose = walk(GAITS["walk-cycle"], fps=4.0)[-1]
    assert apart(pose_body(own, pose), pose_body(body, pose)) < 2.0
    arrived = Motion.to_pose(body, pose).keys[-1][: len(own.vertices)]
    np.testing.assert_array_equal(arrived, np.float32(pose_body(body, pose).vertices))
    with pytest.raises(BodyError, match="no bone named smpl:jaw"):
        pose_body(own, Pose({"smpl:jaw": (0.1, 0.0, 0.0)}))


def apart(one: Body, other: Body) -> float:
    """Largest distance between the joints of two bodies of our topology, from the pelvis [cm]."""
    first, second = (rig().carriers @ body.vertices for body in (one, other))
    return float(np.linalg.norm((first - first[0]) - (second - second[0]), axis=1).max())


def test_frames_of_amass_drive_our_rig_as_the_model(model_file: Path, own: Body, tmp_path: Path) -> None:
    """Joint for joint, with the wearer of the file facing aside; the middle joint of the spine bends the upper bone."""
    body, _, _ = named_body(model_file)
    turn = Rotation.from_euler
    frames = [
        {
            "pelvis": turn("yx", [70.0, 4.0], degrees=True),
            "left_hip": turn("x", -25.0 * share, degrees=True),
            "left_knee": turn("x", 40.0 * share, degrees=True),
            "right_ankle": turn("x", -10.0 * share, degrees=True),
            "spine1": turn("x", 8.0 * share, degrees=True),
            "spine2": turn("y", 6.0 * share, degrees=True),
            "spine3": turn("y", 6.0 * share, degrees=True),
            "neck": turn("y", 20.0 * share, degrees=True),
            "left_collar": turn("z", -8.0 * share, degrees=True),
            "left_shoulder": turn("zy", [-45.0, -20.0 * share], degrees=True),
            "right_shoulder": turn("z", 55.0 * share, degrees=True),
            "left_elbow": turn("y", -60.0 * share, degrees=True),
            "right_elbow": turn("y", 30.0 * share, degrees=True),
        }
        for share in (0.0, 0.5, 1.0)
    ]
    path = amass(tmp_path / "wave.npz", frames, fps=60.0)
    poses, exact = read_motion(path, fps=60.0), read_motion(path, fps=60.0, body=body)
    assert [pose.name for pose in poses] == [f"{path}, frame {number}" for number in (1, 2, 3)]
    for pose, other in zip(poses, exact, strict=True):
        assert apart(pose_body(own, pose), pose_body(body, other)) < 2.0
    assert len(read_motion(path, fps=30.0)) == len(MakeConfig(poses=str(path)).motion) == 2
    facing = whole_turns(poses[0])[0] @ [0.0, 0.0, 1.0]
    assert facing[0] == pytest.approx(0.0, abs=1e-9) and facing[2] > 0.9
    still = read_motion(amass(tmp_path / "still.npz", [{}], count=55, mocap_frame_rate=np.array(120.0)))
    np.testing.assert_allclose(whole_turns(still[0]), whole_turns(named_pose("t-pose")), atol=0.1)


SPOILED: Mapping[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "missing": (lambda a: {key: a[key] for key in a if key != "weights"}, "has no weights: give the NPZ file of an"),
    "short": (lambda a: a | {"weights": a["weights"][:-1]}, r"weights has the shape \(95, 24\), not \(96, 24\)"),
    "flat": (lambda a: a | {"v_template": a["v_template"].ravel()}, r"v_template has the shape \(288,\), not \(v, 3\)"),
    "nan": (lambda a: a | {"posedirs": a["posedirs"] * np.nan}, "posedirs holds something else than numbers"),
    "text": (lambda a: a | {"f": np.array("faces")}, "f holds something else than numbers"),
    "pickled": (lambda a: a | {"J_regressor": np.array({"a": 1})}, "J_regressor cannot be read .*Object arrays"),
    "tree": (lambda a: a | {"kintree_table": a["kintree_table"][:, ::-1]}, "24 joints in another order than the SMPL"),
    "hand": (lambda a: beads(24) | {"posedirs": a["posedirs"][:, :, :9]}, "posedirs has 9 columns, not 207"),
    "face": (lambda a: a | {"f": a["f"] + 1000}, "f names a vertex beyond the 96 of v_template"),
}  # fmt: skip


@pytest.mark.parametrize("fault", SPOILED)
def test_files_of_another_layout_are_named(tmp_path: Path, fault: str) -> None:
    spoil, told = SPOILED[fault]
    np.savez(tmp_path / "model.npz", **spoil(beads(24)))
    with pytest.raises(BodyError, match=told) as error:
        read_model(tmp_path / "model.npz")
    assert str(error.value).startswith(f"{tmp_path / 'model.npz'}: ")


def test_pickles_and_impossible_betas_are_refused(tmp_path: Path) -> None:
    """A pickle, which may run code, is not opened."""
    (tmp_path / "model.pkl").write_bytes(pickle.dumps({"v_template": print}))
    (tmp_path / "text.npz").write_text("v_template")
    np.savez(tmp_path / "model.npz", **beads(24))
    np.savez(tmp_path / "amass.npz", betas=np.zeros(16))
    for name, betas, told in (
        ("model.pkl", None, "model.pkl: a pickle, which may run code: save its arrays as NPZ"),
        ("text.npz", None, "text.npz: no NPZ file: give the NPZ file of an SMPL"),
        ("model.npz", tmp_path / "amass.npz", "model.npz: 16 betas, the model takes 10: give the first 10 as numbers"),
        ("model.npz", "1,a", "betas 1,a: give numbers with commas"),
        ("model.npz", [np.inf], r"betas \[inf\]: give numbers with commas"),
        ("model.npz", tmp_path / "model.npz", "model.npz: has no betas: give an NPZ file with betas"),
    ):
        with pytest.raises(BodyError, match=told):
            named_body(f"smplx:{tmp_path / name}", betas=betas)


def test_faces_of_smplx_are_no_shapes(tmp_path: Path) -> None:
    """Of 20 directions the last ten are expressions, of 400 the last hundred."""
    np.savez(tmp_path / "x.npz", **beads(55) | {"shapedirs": np.zeros((220, 3, 20))})
    with pytest.raises(BodyError, match="11 betas, the model takes 10"):
        read_model(tmp_path / "x.npz", np.zeros(11).tolist())


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"poses": np.zeros((2, 70))}, r"poses has the shape \(2, 70\): give frames of 66, 72, 156, 165 angles"),
        ({"poses": np.zeros((0, 156))}, r"poses has the shape \(0, 156\)"),
        ({"poses": np.full((2, 156), np.nan)}, "poses holds something else than numbers"),
        ({"poses": np.zeros((2, 156))}, "its wearer stands along y, and AMASS has z up"),
        ({"mocap_framerate": np.array(0.0)}, "mocap_framerate is 0: give frames a second"),
        ({"mocap_framerate": np.array([30.0])}, r"mocap_framerate has the shape \(1,\)"),
    ],
)
def test_damaged_motions_are_named(tmp_path: Path, more: dict[str, Any], told: str) -> None:
    with pytest.raises(BodyError, match=told):
        read_motion(amass(tmp_path / "a.npz", [{}, {}], **more))
    np.savez(tmp_path / "b.npz", poses=np.zeros((2, 156)))
    with pytest.raises(BodyError, match="has no mocap_framerate or mocap_frame_rate: give an NPZ file of AMASS"):
        read_motion(tmp_path / "b.npz")


def test_the_command_line_takes_a_model_file(model_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "--shape", f"smplx:{model_file}", "--betas=1,0.5"]) == 0
    assert "taken to be in metres, 175.5 cm tall" in capsys.readouterr().out
    for words, code in ((["--shape", "neutral"], 2), ([str(model_file.with_suffix(".obj"))], 1)):
        assert main(["measure", *words, "--betas=1"]) == code
        assert "leave" in capsys.readouterr().err
