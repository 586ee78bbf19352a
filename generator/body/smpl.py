"""Bodies and motions of the SMPL family: the user's own model file, and the joint angles of AMASS.

SMPL, SMPL-H and SMPL-X may not be redistributed, so nothing of them is in this package, and no code of theirs: the
formulas are those of Loper et al., 2015. The template is shaped by betas, corrected by the pose, and skinned linearly.
Files are read as plain arrays: a pickle may run code, and is refused.
"""

import io
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from gcd_dataset.bodyfiles import read_body_file
from gcd_dataset.errors import BodyError, shown
from gcd_dataset.generator.body.pose import JOINT, named_pose, whole_turns
from gcd_dataset.records import BONES, Pose, Record

JOINTS = (
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle"),
    *("spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder"),
    *("right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
)
"""The joints that all models of the family begin with."""
FINGERS = tuple(f"finger{number}" for number in range(30))
MORE = {22: (), 24: ("left_hand", "right_hand"), 52: FINGERS, 55: ("jaw", "left_eye", "right_eye", *FINGERS)}
"""Number of joints, of SMPL (24), SMPL-H (52), SMPL-X (55), or of trunk and limbs alone, to those after ``JOINTS``."""
_ABOVE = (0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
PARENT = {
    **dict(zip(JOINTS[1:], (JOINTS[above] for above in _ABOVE), strict=True)),
    **{f"{side}_hand": f"{side}_wrist" for side in ("left", "right")},
    **dict.fromkeys(("jaw", "left_eye", "right_eye"), "head"),
    **{
        finger: FINGERS[number - 1] if number % 3 else f"{'left' if number < 15 else 'right'}_wrist"
        for number, finger in enumerate(FINGERS)
    },
}
"""Joint to the one on which it turns; the pelvis has none."""
BONE = {"hip": "thigh", "knee": "shin", "ankle": "foot", "foot": "toes", "collar": "shoulder", "shoulder": "upper_arm",
        "elbow": "forearm", "wrist": "hand", "spine1": "lower_spine", "spine2": "upper_spine", "spine3": "upper_spine",
        }  # fmt: skip
BONE_OF = tuple("_".join(BONE.get(word, word) for word in joint.split("_")) for joint in JOINTS)
"""The bone of ours that moves as a joint of ``JOINTS``. The spine has three joints, and two bones at the first two."""
EXPRESSIONS = {20: 10, 400: 100}
"""Number of SMPL-X's ``shapedirs`` to how many of them, the last ones, are expressions of the face."""
SHAPES = {
    "v_template": "v 3", "f": "f 3", "shapedirs": "v 3 betas", "posedirs": "v 3 correctives", "J_regressor": "joints v",
    "weights": "v joints", "kintree_table": "2 joints",
}  # fmt: skip
MODEL = "the NPZ file of an SMPL, SMPL-H or SMPL-X model"
AMASS = "an NPZ file of AMASS, with poses and mocap_framerate"
Betas = Sequence[float] | str | Path
"""Shape parameters: numbers, text of numbers with commas, or an NPZ file with ``betas``, such as one of AMASS."""
LOWEST_RATE, HIGHEST_RATE = 0.1, 10_000.0  # frames a second
RATES = ("mocap_framerate", "mocap_frame_rate")  # of AMASS for SMPL-H, and for SMPL-X
UPRIGHT = 0.7  # share of the pelvis' axis along y, on average, from which a motion stands along y


@dataclass(frozen=True, eq=False)
class ModelBody(Record):
    """A body of a model file, which turns a pose into the positions of its vertices."""

    template: Float[np.ndarray, "v 3"]
    """Vertices of the shaped body at the model's zero pose, a T-pose [m]."""
    faces: Int[np.ndarray, "f 3"]
    joints: Float[np.ndarray, "j 3"]
    weights: Float[np.ndarray, "v j"]
    correctives: Float[np.ndarray, "v 3 c"]
    """Offsets for each entry of the rotation matrices of all joints but the first [m]."""
    points: csr_matrix | None = None
    """(w, v): maps to the vertices of the closed body [cm]; None: the model's own [m]."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the joints, in their order."""
        return joint_names(len(self.joints))

    @property
    def parents(self) -> list[int]:
        """The number of the joint on which each turns; -1 for the root."""
        return parents_of(self.names)

    @property
    def home(self) -> Float[np.ndarray, "j 3 3"]:
        """Rotation of each joint from the zero pose, a T-pose, to the A-pose."""
        home = np.empty((len(self.joints), 3, 3))
        home[: len(JOINTS)] = np.swapaxes(t_pose(), 1, 2)
        for number in range(len(JOINTS), len(home)):
            home[number] = home[self.parents[number]]
        return home

    def __call__(self, pose: Pose) -> Float[np.ndarray, "w 3"]:
        """Vertices in a pose of our bones, or of the model's joints: see ``read_motion``."""
        turned = self._turned(pose) @ self.home
        above = [turned[parent] if parent >= 0 else np.eye(3) for parent in self.parents]
        own = np.swapaxes(above, 1, 2) @ turned
        at = self.joints.copy()
        for number, parent in enumerate(self.parents):  # parents come first
            if parent >= 0:
                at[number] = at[parent] + turned[parent] @ (self.joints[number] - self.joints[parent])
        vertices = self.template + self.correctives @ (own[1:] - np.eye(3)).ravel()
        shifts = at - (turned @ self.joints[:, :, None])[:, :, 0]
        blended = (self.weights @ turned.reshape(-1, 9)).reshape(-1, 3, 3)
        moved = (blended @ vertices[:, :, None])[:, :, 0] + self.weights @ shifts
        return moved if self.points is None else np.asarray(self.points @ moved)

    def _turned(self, pose: Pose) -> Float[np.ndarray, "j 3 3"]:
        """The rotation of each joint from the A-pose."""
        bones, turned = whole_turns(pose), np.empty((len(self.joints), 3, 3))
        by_joint = any(name.startswith(JOINT) for name in pose.turns)
        for number, (name, parent) in enumerate(zip(self.names, self.parents, strict=True)):
            if by_joint:
                own = Rotation.from_rotvec(pose.turns.get(JOINT + name, (0.0, 0.0, 0.0))).as_matrix()
                turned[number] = turned[parent] @ own if parent >= 0 else own
            else:
                turned[number] = bones[BONES.index(BONE_OF[number])] if number < len(JOINTS) else turned[parent]
        return turned

    def closed(
        self, kept: Bool[np.ndarray, " v"], faces: Int[np.ndarray, "f 3"], size: int, unit: float
    ) -> "ModelBody":
        """The same with ``points`` for a mesh of the ``kept`` vertices, then the centres of holes, ``size`` in all.

        ``unit``: the length of a metre [cm], another one for a body that was scaled.
        """
        count = int(kept.sum())
        rims = [np.setdiff1d(faces[(faces == centre).any(axis=1)], centre) for centre in range(count, size)]
        columns = np.flatnonzero(kept)[np.concatenate([np.arange(count), *rims]).astype(int)]
        rows = np.repeat(np.arange(size), [1] * count + [len(rim) for rim in rims])
        shares = unit / np.bincount(rows, minlength=size)[rows]
        return replace(self, points=csr_matrix((shares, (rows, columns)), (size, len(kept))))


def joint_names(count: int) -> tuple[str, ...]:
    """The names of the joints of a model, or of a file, with so many."""
    return (*JOINTS, *MORE[count])


def parents_of(names: Sequence[str]) -> list[int]:
    """The number of the joint on which each turns; -1 for the root."""
    return [names.index(PARENT[name]) if name in PARENT else -1 for name in names]


def read_model(path: Path, betas: Betas | None = None) -> ModelBody:
    """The body of a model file of the SMPL family with these shape parameters, the first ones if they are fewer.

    Raises ``BodyError`` for a file of another layout, for pickled content, and for more betas than the model has.
    """
    model, numbers = _arrays(path, SHAPES, MODEL), _read_betas(() if betas is None else betas)
    count, faces, template = len(model["J_regressor"]), model["f"].astype(int), model["v_template"].astype(float)
    parents = parents_of(joint_names(count)) if MORE.get(count) else []
    if parents[1:] != model["kintree_table"][0, 1:].tolist():
        raise BodyError(f"{path}: kintree_table has {count} joints in another order than the SMPL family: give {MODEL}")
    if (entries := model["posedirs"].shape[2]) != 9 * (count - 1):
        raise BodyError(f"{path}: posedirs has {entries} columns, not {9 * (count - 1)}: give {MODEL}")
    if not 0 <= faces.min(initial=0) <= faces.max(initial=0) < len(template):
        raise BodyError(f"{path}: f names a vertex beyond the {len(template)} of v_template: give {MODEL}")
    held = model["shapedirs"].shape[2]
    held -= EXPRESSIONS.get(held, 0) if count == 55 else 0
    if len(numbers) > held:
        raise BodyError(f"{path}: {len(numbers)} betas, the model takes {held}: give the first {held} as numbers")
    template = template + model["shapedirs"][:, :, : len(numbers)] @ numbers
    return ModelBody(template, faces, model["J_regressor"] @ template, model["weights"], model["posedirs"])


def t_pose() -> Float[np.ndarray, "22 3 3"]:
    """The rotation of the bones ``BONE_OF`` from the A-pose to the T-pose, which stands for the family's zero pose."""
    return whole_turns(named_pose("t-pose"))[[BONES.index(bone) for bone in BONE_OF]]


def _read_betas(given: Betas) -> Float[np.ndarray, " k"]:
    if isinstance(given, str | Path) and Path(given).suffix.lower() == ".npz":
        return _arrays(Path(given), {"betas": "betas"}, "an NPZ file with betas")["betas"].astype(float)
    try:
        numbers = np.array(str(given).split(",") if isinstance(given, str | Path) else given, float)
    except ValueError:
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        raise BodyError(f"betas {shown(str(given))}: give numbers with commas, or an NPZ file with betas")
    return numbers


def read_turns(path: Path) -> tuple[dict[str, Rotation], float]:
    """The rotation of each joint of a file of AMASS from the zero pose, y up, in each frame, and the time between two
    [s]. Raises ``BodyError``."""
    found = _arrays(path, {"poses": "frames angles", "|".join(RATES): ""}, AMASS)
    poses, rate = found["poses"].astype(float), float(found["|".join(RATES)])
    count, rest = divmod(poses.shape[1], 3)
    if not len(poses) or rest or count not in MORE:
        sizes = ", ".join(str(3 * count) for count in MORE)
        raise BodyError(f"{path}: poses has the shape {poses.shape}: give frames of {sizes} angles")
    if not LOWEST_RATE <= rate <= HIGHEST_RATE:
        raise BodyError(f"{path}: {RATES[0]} is {rate:g}: give frames a second")
    turns = [Rotation.from_rotvec(turn) for turn in poses.reshape(-1, count, 3).transpose(1, 0, 2)]
    if turns[0].apply([0.0, 1.0, 0.0])[:, 1].mean() > UPRIGHT:
        raise BodyError(f"{path}: its wearer stands along y, and AMASS has z up: turn the first joint by 90° about x")
    whole = {"": Rotation.from_euler("x", -90.0, degrees=True)}
    for name, turn in zip(joint_names(count), turns, strict=True):
        whole[name] = whole[PARENT.get(name, "")] * turn
    return whole, 1.0 / rate


def _arrays(path: Path, shapes: Mapping[str, str], remedy: str) -> dict[str, np.ndarray]:
    """Arrays of numbers in an NPZ file: key, or keys with ``|``, to the names or sizes of their axes."""
    content, found, sizes, key = read_body_file(path), {}, dict[str, int](), "the archive"
    if content.startswith(b"\x80"):
        raise BodyError(f"{path}: a pickle, which may run code: save its arrays as NPZ (docs/guides/own-body.md)")
    if not content.startswith(b"PK"):
        raise BodyError(f"{path}: no NPZ file: give {remedy}")
    try:
        with np.load(io.BytesIO(content)) as file:
            for keys, axes in shapes.items():
                key = next((each for each in keys.split("|") if each in file), "")
                if not key:
                    raise BodyError(f"{path}: has no {keys.replace('|', ' or ')}: give {remedy}")
                found[keys] = array = file[key]
                if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
                    raise BodyError(f"{path}: {key} holds something else than numbers: give {remedy}")
                names, shape = axes.split(), array.shape
                wanted = [int(name) if name.isdigit() else sizes.get(name, -1) for name in names]
                if len(shape) != len(names) or any(w not in (-1, n) for w, n in zip(wanted, shape, strict=True)):
                    told = ", ".join(name if w < 0 else str(w) for name, w in zip(names, wanted, strict=True))
                    raise BodyError(f"{path}: {key} has the shape {shape}, not ({told}): give {remedy}")
                sizes |= zip(names, shape, strict=True)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:  # ValueError: pickled objects
        reason = shown(str(error).partition("\n")[0])
        raise BodyError(f"{path}: {key} cannot be read ({reason}): give {remedy}") from error
    return found
