"""Motions: sequences of poses, read from files of BVH and AMASS, or walked by formula."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from gcd_dataset.errors import BodyError, ConfigError, shown
from gcd_dataset.files import read_whole
from gcd_dataset.generator.body.pose import (
    JOINT,
    LIMBS,
    LIMITS,
    ROUNDING,
    TRUNK,
    parent_of,
    pose_of,
    require_possible,
    rig,
    side_and_kind,
)
from gcd_dataset.generator.body.smpl import BONE_OF, JOINTS, PARENT, ModelBody, read_turns, t_pose
from gcd_dataset.records import BONES, FPS, Body, Pose

log = logging.getLogger(__name__)

MOTION_FILES = (".bvh", ".npz")
LARGEST_BVH = 1 << 28  # bytes; a minute of CMU's has 7 MB
CAPTURE_ERROR = 20.0  # degrees beyond a limit, to which captured angles are set
LOWEST_FPS, HIGHEST_FPS = 1.0, 1000.0  # poses a second
CMU = dict(zip((*TRUNK, *LIMBS), (
    "Hips", "Spine", "Spine1", "Neck1", "Head", "Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase",
), strict=True))  # fmt: skip
"""Kind of bone to CMU's name of its joint, without ``Left`` and ``Right``."""
UNUSED = {"LowerBack", "Neck"} | {
    name
    for side in ("Left", "Right")
    for name in (f"{side[0]}HipJoint", f"{side[0]}Thumb", f"{side}FingerBase", f"{side}HandIndex1", f"{side[0]}Fingers")
}
"""CMU's joints without a bone of ours; their rotations count for the joints after them."""


@dataclass
class _Joint:
    name: str
    parent: "_Joint | None"
    offset: Sequence[float] = ()
    channels: Sequence[str] = ()
    tip: Sequence[float] = ()
    """Offset of the first joint after it."""

    @property
    def at(self) -> Float[np.ndarray, "3"]:
        """Its position in the rest pose."""
        return np.asarray(self.offset) + (self.parent.at if self.parent else 0.0)


def read_motion(path: str | Path, *, fps: float = FPS, body: Body | None = None) -> list[Pose]:
    """The poses of a BVH or AMASS file, ``fps`` a second, interpolated between its frames.

    The motion starts facing z, and the body keeps its own lengths and stands on the floor at its place: the translation
    of the root is not read.

    BVH names its joints as CMU does (``Hips``, ``LeftUpLeg``, …) or as ``BONES`` does. Its y axis points up, and its
    rest pose faces z, with straight limbs in any direction; units do not matter. CMU's files begin with a T-pose: the
    first frame is left out if its root is unrotated while the last frame's root is rotated.

    ``body`` of a model file takes all joints of an AMASS file (NPZ) as they are. Other bodies take those of trunk and
    limbs, as if the zero pose were their ``t-pose``; hands keep to the forearm, and the spine has two bones.

    Raises ``BodyError`` for a damaged file, unknown or missing joints, numbers that are none, and poses outside
    ``LIMITS``; it names the frame, from 1.
    """
    _require_rate(fps)
    if Path(path).suffix.lower() == ".npz":
        turns, seconds = read_turns(Path(path))
        if body is not None and isinstance(body.posed, ModelBody):
            return _model_poses(turns, seconds, fps, body.posed, str(path))
        return _poses(_own_turns(_as_ours(turns)), seconds, fps, str(path))
    text = read_whole(path, "BVH file", limit=LARGEST_BVH, error=BodyError).decode("utf-8", "replace")
    head, mark, numbers = text.partition("MOTION")
    if not mark or not head.split() or head.split()[0] != "HIERARCHY":
        raise BodyError(f"{path}: no HIERARCHY and MOTION: give the path of a BVH file")
    joints = _joints(head, str(path))
    bones = _bones(joints, str(path))
    frames, seconds = _frames(numbers, joints, str(path))
    upright = [_turns(frames[[row]], joints[:1])[joints[0].name].magnitude()[0] == 0.0 for row in (0, -1)]
    first = int(upright == [True, False])
    own = _own_turns(_whole_turns(_turns(frames[first:], joints), bones))
    return _poses(own, seconds, fps, str(path), first)


def _sampled(
    own: Sequence[Rotation], seconds: float, fps: float
) -> tuple[Float[np.ndarray, "k b 3"], Float[np.ndarray, " k"]]:
    """Rotation vectors of bones whose frames are ``seconds`` apart, ``fps`` a second, and their times in frames."""
    last = len(own[0]) - 1
    times = np.arange(int(last * seconds * fps + 1e-6) + 1) / (fps * seconds)
    return np.stack([(Slerp(np.arange(last + 1), turn)(times) if last else turn).as_rotvec() for turn in own], 1), times


def _poses(own: Sequence[Rotation], seconds: float, fps: float, path: str, first: int = 0) -> list[Pose]:
    """Poses of the rotations of ``BONES`` relative to their parents, ``first`` frames after the first of a file."""
    vectors, times = _sampled(own, seconds, fps)
    turns = (vectors[:, :, None] @ rig().axes)[:, :, 0]
    limits = np.radians([LIMITS[side_and_kind(bone)[1]] for bone in BONES])
    within = np.clip(turns, *np.moveaxis(limits, 2, 0))
    beyond = np.degrees(np.abs(turns - within))
    turns = np.where(beyond < CAPTURE_ERROR, within, turns)
    if beyond.max() > ROUNDING:
        bone = BONES[int(np.unravel_index(beyond.argmax(), beyond.shape)[1])]
        log.info("%s: up to %.0f° beyond the limits of a joint (%s)", path, beyond.max(), bone)
    poses = []
    for time, turn in zip(times.tolist(), turns.tolist(), strict=True):
        name = f"{path}, frame {first + round(time) + 1}"
        poses.append(Pose({bone: tuple(angles) for bone, angles in zip(BONES, turn, strict=True)}, name))
        require_possible(poses[-1])
    return poses


def _require_rate(fps: float) -> None:
    if not LOWEST_FPS <= fps <= HIGHEST_FPS:
        raise ConfigError(f"{fps:g} poses a second: give from {LOWEST_FPS:g} to {HIGHEST_FPS:g}")


def _joints(head: str, source: str) -> list[_Joint]:
    """The joints of a hierarchy, parents first."""
    words = ((word, number) for number, text in enumerate(head.splitlines(), 1) for word in text.split())
    joints: list[_Joint] = []
    open_joints: list[_Joint] = []
    joint = _Joint("", None)
    line = 1
    try:
        for word, line in islice(words, 1, None):  # noqa: B007 - named in the error
            if word in ("ROOT", "JOINT", "End"):
                joint = _Joint(next(words)[0], open_joints[-1] if open_joints else None)
                if word != "End":
                    joints.append(joint)
            elif word == "OFFSET":
                joint.offset = [float(next(words)[0]) for _ in range(3)]
                if not np.isfinite(joint.offset).all():
                    raise ValueError(f"{joint.name} has an offset that is not a number")
                if joint.parent and not joint.parent.tip:
                    joint.parent.tip = joint.offset
            elif word == "CHANNELS":
                joint.channels = [next(words)[0] for _ in range(int(next(words)[0]))]
                axes = [channel[0] for channel in joint.channels if channel[1:] == "rotation"]
                if len(axes) != 3 or set(axes) != set("XYZ"):
                    raise ValueError(f"{joint.name} needs an Xrotation, a Yrotation and a Zrotation")
            elif word == "{":
                open_joints.append(joint)
            elif word == "}":
                open_joints.pop()
            else:
                raise ValueError(f"{shown(word)} is no word of a hierarchy")
        if open_joints or not joints:
            raise ValueError("the hierarchy is cut off")
        if bare := [each.name for each in joints if not each.channels or not each.offset]:
            raise ValueError(f"{bare[0]} has no offset or no channels")
    except (ValueError, IndexError, StopIteration) as error:
        reason = str(error) or "the hierarchy is cut off"
        raise BodyError(f"{source}: line {line}: {reason}: give a whole BVH file") from error
    return joints


def _bones(joints: Sequence[_Joint], source: str) -> dict[str, _Joint]:
    """Bone to its joint. Raises ``BodyError`` for unknown and missing joints, and a rest pose in other axes."""
    names = {_cmu_name(bone): bone for bone in BONES} | dict(zip(BONES, BONES, strict=True))
    if unknown := [joint.name for joint in joints if joint.name not in names and joint.name not in UNUSED]:
        known = ", ".join(_cmu_name(bone) for bone in BONES)
        raise BodyError(f"{source}: no bone for joint {shown(unknown[0])}: name joints as CMU does: {known}")
    every = [joint.name for joint in joints]
    if twice := [name for name in every if every.count(name) > 1]:
        raise BodyError(f"{source}: joint {twice[0]} occurs twice: give each joint its name")
    bones = {names[joint.name]: joint for joint in joints if joint.name in names}
    if missing := [bone for bone in BONES if bone not in bones]:
        raise BodyError(
            f"{source}: no joint {_cmu_name(missing[0])} or {missing[0]}: give a file with one for each bone"
        )
    height = bones["head"].at - bones["pelvis"].at
    width = bones["left_thigh"].at - bones["right_thigh"].at
    if height[1] < 0.7 * np.linalg.norm(height) or width[0] < 0.7 * np.linalg.norm(width):
        raise BodyError(
            f"{source}: its rest pose does not stand along y, its left along x: export it with y up, facing z"
        )
    return bones


def _cmu_name(bone: str) -> str:
    side, kind = side_and_kind(bone)
    return side[:-1].capitalize() + CMU[kind]


def _frames(text: str, joints: Sequence[_Joint], source: str) -> tuple[Float[np.ndarray, "t c"], float]:
    """The numbers of all frames, and the time between two [s]."""
    lines = text.split("\n")[1:]
    facts = [line.partition(":")[2].strip() for line in lines[:2]]
    width = sum(len(joint.channels) for joint in joints)
    try:
        count, seconds = int(facts[0]), float(facts[1])
        if count < 1 or not 1e-4 <= seconds <= 10.0:
            raise ValueError
    except (ValueError, IndexError) as error:
        raise BodyError(f"{source}: no Frames and Frame Time after MOTION: give a whole BVH file") from error
    rows = [row for line in lines[2:] if (row := line.split())]
    if len(rows) != count:
        raise BodyError(f"{source}: {len(rows)} frames instead of {count}: give a whole BVH file")
    names = [f"{channel} of {joint.name}" for joint in joints for channel in joint.channels]
    numbers = np.empty((count, width))
    for number, row in enumerate(rows):
        if len(row) != width:
            raise BodyError(
                f"{source}: frame {number + 1}: {len(row)} numbers instead of {width}: give a whole BVH file"
            )
        numbers[number] = [_number(word) for word in row]
        if (bad := np.flatnonzero(~np.isfinite(numbers[number]))).size:
            told = f"the {names[bad[0]]} is {shown(row[bad[0]])}"
            raise BodyError(f"{source}: frame {number + 1}: {told}: give a number, or leave the frame out")
    return numbers, seconds


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan


def _turns(frames: Float[np.ndarray, "t c"], joints: Sequence[_Joint]) -> dict[str, Rotation]:
    """The rotation of each joint relative to its parent, by name, in each frame."""
    turns, column = {}, 0
    for joint in joints:
        chosen = [k for k, channel in enumerate(joint.channels) if channel.endswith("rotation")]
        order = "".join(joint.channels[k][0] for k in chosen)
        turns[joint.name] = Rotation.from_euler(order, frames[:, [column + k for k in chosen]], degrees=True)
        column += len(joint.channels)
    return turns


def _whole_turns(turns: Mapping[str, Rotation], bones: Mapping[str, _Joint]) -> dict[str, Rotation]:
    """The rotation of each bone of ``BONES`` from the A-pose, in each frame."""
    whole: dict[str, Rotation] = {}
    for bone, joint in bones.items():
        turn, above = turns[joint.name], joint.parent
        while above:
            turn, above = turns[above.name] * turn, above.parent
        whole[bone] = turn * _to_rest(bone, bones)
    if bones["neck"].name != "neck":
        _bend_as_ours(whole)
        nod = (whole["upper_spine"].inv() * whole["head"]).as_rotvec()
        whole["neck"] = whole["upper_spine"] * Rotation.from_rotvec(0.5 * nod)
    return whole


def _as_ours(turns: Mapping[str, Rotation]) -> dict[str, Rotation]:
    """The rotation of each bone of ``BONES`` from the A-pose, of joints of the SMPL family from a T-pose."""
    rest = zip(JOINTS, BONE_OF, Rotation.from_matrix(t_pose()), strict=True)
    whole = {bone: turns[joint] * turn for joint, bone, turn in rest}
    _bend_as_ours(whole)
    return whole


def _own_turns(whole: Mapping[str, Rotation]) -> list[Rotation]:
    """The rotation of each bone of ``BONES`` relative to its parent; the pelvis faces z in the first frame."""
    whole = _facing_z(whole, "pelvis")
    return [whole[parent].inv() * whole[bone] if (parent := parent_of(bone)) else whole[bone] for bone in BONES]


def _facing_z(whole: Mapping[str, Rotation], root: str) -> dict[str, Rotation]:
    x, _, z = whole[root].apply([0.0, 0.0, 1.0])[0]
    return {bone: Rotation.from_rotvec([0.0, -np.arctan2(x, z), 0.0]) * turn for bone, turn in whole.items()}


def _model_poses(turns: Mapping[str, Rotation], seconds: float, fps: float, model: ModelBody, path: str) -> list[Pose]:
    """Poses of the joints of a model, each relative to its parent from the A-pose; those not in a file stay."""
    home = dict(zip(model.names, map(Rotation.from_matrix, model.home), strict=True))
    turns = _facing_z(turns, JOINTS[0])
    whole = {name: turn * home[name].inv() for name, turn in turns.items() if name in home}
    own = {name: whole[PARENT[name]].inv() * turn if name in PARENT else turn for name, turn in whole.items()}
    vectors, times = _sampled(list(own.values()), seconds, fps)
    return [
        Pose(
            {JOINT + name: tuple(turn) for name, turn in zip(own, row, strict=True)}, f"{path}, frame {round(time) + 1}"
        )
        for time, row in zip(times.tolist(), vectors.tolist(), strict=True)
    ]


def _bend_as_ours(whole: dict[str, Rotation]) -> None:
    """Let captured arms bend as ours do.

    They roll so that elbows bend forward, since the hinges of other skeletons differ; hands keep to the forearm.
    """
    for side in ("left_", "right_"):
        upper, lower = (rig().axes[BONES.index(side + bone)] for bone in ("upper_arm", "forearm"))
        bend, spread, _ = ((whole[side + "upper_arm"].inv() * whole[side + "forearm"]).as_rotvec() @ lower).sum(axis=0)
        roll = np.arctan2(spread, abs(bend))
        whole[side + "upper_arm"] *= Rotation.from_rotvec(roll * upper[:, 2])
        whole[side + "forearm"] *= Rotation.from_rotvec(roll * lower[:, 2])
        whole[side + "hand"] = whole[side + "forearm"]


def _to_rest(bone: str, bones: Mapping[str, _Joint]) -> Rotation:
    """The rotation of a bone from the A-pose to the file's rest pose.

    Limbs turn to the direction that they have in the file, legs only as seen from the front, since straight knees and
    level soles are so in both; hands and feet turn with the limb. The trunk is upright in both.
    """
    side, kind = side_and_kind(bone)
    limb = {"hand": "forearm", "foot": "shin", "toes": "shin"}.get(kind, kind)
    if limb not in ("upper_arm", "forearm", "thigh", "shin"):
        return Rotation.identity()
    outward = 1.0 if side == "left_" else -1.0
    ours, theirs = -outward * rig().axes[BONES.index(side + limb), :, 2], np.asarray(bones[side + limb].tip, float)
    if limb in ("thigh", "shin"):
        ours, theirs = ours * [1.0, 1.0, 0.0], theirs * [1.0, 1.0, 0.0]
    return Rotation.align_vectors(theirs, ours)[0]


@dataclass(frozen=True)
class Gait:
    """A way of walking: amplitudes of the joints [degrees]. Chosen by us, near those of normal gait."""

    cadence: float = 112.0
    """Steps a minute."""
    thigh: float = 22.0
    """Swing of a thigh, either way."""
    knee: float = 55.0
    """Bend of the knee while the leg swings."""
    arm: float = 18.0
    """Swing of an arm, either way."""
    elbow: float = 15.0
    turn: float = 5.0
    """Turn of the pelvis with the leg ahead; the chest turns as far the other way."""
    sway: float = 3.0
    """Drop of the pelvis on the side of the swinging leg."""
    lean: float = 2.0
    """Of the trunk, forward."""
    cycles: float = 2.0
    """Length; a cycle is a step of each leg."""


GAITS = {
    "walk": Gait(),
    "walk-cycle": Gait(cycles=1.0),
    "stroll": Gait(cadence=90.0, thigh=16.0, knee=48.0, arm=10.0, turn=3.0),
    "brisk-walk": Gait(cadence=130.0, thigh=26.0, knee=60.0, arm=26.0, elbow=35.0, turn=7.0, lean=5.0),
    "long-steps": Gait(cadence=100.0, thigh=29.0, knee=58.0, arm=24.0, turn=9.0),
    "short-steps": Gait(cadence=105.0, thigh=10.0, knee=30.0, arm=5.0, elbow=25.0, turn=2.0, sway=1.0, lean=8.0),
    "catwalk": Gait(cadence=105.0, thigh=24.0, arm=14.0, elbow=8.0, turn=9.0, sway=7.0, lean=-2.0),
    "march": Gait(cadence=116.0, thigh=30.0, knee=75.0, arm=38.0, elbow=8.0, turn=2.0, sway=1.0, lean=0.0),
    "high-knees": Gait(cadence=80.0, thigh=34.0, knee=75.0, arm=20.0, elbow=60.0, turn=3.0),
}
"""Gaits by name."""
ARM_SPREAD, LEG_SPREAD = -12.0, 5.0  # degrees off the A-pose: hands clear of the hips, thighs of each other


def walk(gait: Gait = GAITS["walk"], *, fps: float = FPS, name: str = "walk") -> list[Pose]:
    """The poses of a body that walks on the spot, ``fps`` a second, from standing."""
    _require_rate(fps)
    frames = int(gait.cycles * 120.0 / gait.cadence * fps) + 1
    return [_step(gait, frame * gait.cadence / (120.0 * fps), f"{name}, frame {frame + 1}") for frame in range(frames)]


def _step(gait: Gait, cycle: float, name: str) -> Pose:
    """The pose after so many cycles; the first half is walked with rising amplitude."""
    rise = min(2.0 * cycle, 1.0)
    rise = rise * rise * (3.0 - 2.0 * rise)
    ahead = np.cos(2.0 * np.pi * cycle)
    counter, drop = rise * gait.turn * ahead, rise * gait.sway * np.sin(2.0 * np.pi * cycle)
    turns = {
        "pelvis": (0.0, -drop, -counter),
        "lower_spine": (gait.lean / 2, drop, counter),
        "upper_spine": (gait.lean / 2, 0.0, counter),
        "head": (-gait.lean / 2, 0.0, -counter),
    }
    for side, phase in (("left_", cycle), ("right_", cycle + 0.5)):
        swing, stance = np.cos(2.0 * np.pi * phase), np.sin(2.0 * np.pi * phase)
        knee = gait.knee * (_pulse(phase, 0.72, 4.0) + 0.25 * _pulse(phase, 0.14, 6.0))
        ankle = 8.0 * _pulse(phase, 0.42, 4.0) - 18.0 * _pulse(phase, 0.62, 10.0)
        turns |= {
            f"{side}thigh": (
                rise * (6.0 + gait.thigh * swing),
                LEG_SPREAD - rise * gait.sway * stance,
                rise * gait.turn * swing,
            ),
            f"{side}shin": (-rise * (4.0 + knee), 0.0, 0.0),
            f"{side}foot": (rise * ankle, -LEG_SPREAD, 0.0),
            f"{side}toes": (rise * 25.0 * _pulse(phase, 0.57, 12.0), 0.0, 0.0),
            f"{side}upper_arm": (-rise * gait.arm * swing, ARM_SPREAD, 0.0),
            f"{side}forearm": (5.0 + rise * (gait.elbow - 5.0) * (1.0 - 0.4 * swing), 0.0, 0.0),
        }  # fmt: skip
    return pose_of(turns, name)


def _pulse(phase: float, at: float, sharpness: float) -> float:
    """A periodic bump of height 1 at a share of the cycle."""
    return float(np.exp(sharpness * (np.cos(2.0 * np.pi * (phase - at)) - 1.0)))


def named_motion(name_or_path: str | Path, *, fps: float = FPS, body: Body | None = None) -> list[Pose]:
    """The poses of a gait of ``GAITS``, or of a BVH or AMASS file.

    Raises ``BodyError`` for an unknown name, and as ``read_motion`` does.
    """
    name = str(name_or_path)
    if gait := GAITS.get(name):
        return walk(gait, fps=fps, name=name)
    if not Path(name).suffix:
        raise BodyError(f"no motion named {shown(name)}: there are {', '.join(GAITS)}, or a BVH or AMASS file")
    return read_motion(name, fps=fps, body=body)
