"""Poses: a body's bones turned from the A-pose, and the skin moved with them.

``rig.npz``, made by ``tools/body_model/rig.py``, names the vertices that carry each joint, and the bones that move each
vertex. Vertices move by blended dual quaternions (Kavan et al., 2008), which keep the girth of bent limbs; creases
whose sides would intersect are smoothed, as on other bodies.
"""

import functools
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from gcd_dataset.errors import BodyError, shown
from gcd_dataset.generator.body.asset import body_model, checked_data, refinement, stored_half
from gcd_dataset.generator.body.repair import ROUNDS, skin_normals
from gcd_dataset.generator.body.shape import body_skin, stand
from gcd_dataset.jsonfile import read_json, read_toml
from gcd_dataset.records import BONES, Body, Pose, Record

TREE = {  # bone: its parent, and the bone to whose joint it points, or where it points
    "pelvis": ("", "up"),
    "lower_spine": ("pelvis", "up"),
    "upper_spine": ("lower_spine", "up"),
    "neck": ("upper_spine", "up"),
    "head": ("neck", "up"),
    "shoulder": ("upper_spine", "upper_arm"),
    "upper_arm": ("shoulder", "forearm"),
    "forearm": ("upper_arm", "hand"),
    "hand": ("forearm", "hand"),  # as the forearm
    "thigh": ("pelvis", "shin"),
    "shin": ("thigh", "foot"),
    "foot": ("shin", "down"),  # bends as the shin does
    "toes": ("foot", "down"),
}
TRUNK = tuple(TREE)[:5]
LIMBS = tuple(TREE)[5:]

LIMITS = {  # least and largest bend, spread and twist off the A-pose, in which the arms are 45° off the body [degrees]
    "pelvis": ((-180, 180), (-180, 180), (-180, 180)),
    "lower_spine": ((-15, 45), (-20, 20), (-20, 20)),
    "upper_spine": ((-15, 35), (-20, 20), (-30, 30)),
    "neck": ((-30, 30), (-25, 25), (-40, 40)),
    "head": ((-30, 30), (-20, 20), (-40, 40)),
    "shoulder": ((-15, 20), (-10, 35), (-20, 20)),
    "upper_arm": ((-60, 135), (-50, 110), (-90, 90)),
    "forearm": ((-13, 140), (-10, 10), (-85, 85)),
    "hand": ((-75, 75), (-30, 30), (-10, 10)),
    "thigh": ((-30, 120), (-30, 45), (-45, 45)),
    "shin": ((-135, 10), (-10, 10), (-30, 30)),
    "foot": ((-50, 25), (-25, 25), (-30, 30)),
    "toes": ((-40, 70), (-10, 10), (-10, 10)),
}
"""After the ranges of motion of the American Academy of Orthopaedic Surgeons (Joint Motion, 1965), those of the spine
divided among its bones. Elbows and knees have slack aside, since their axes are not quite level in all bodies."""

POSES = {  # bend, spread and twist [degrees] of both sides; of the left, then of the right, where they differ
    "a-pose": {},
    "t-pose": {"shoulder": (0, 8, 0), "upper_arm": (0, 37, 0)},
    "arms-forward": {"shoulder": (10, 0, 0), "upper_arm": (55, 1, 0)},  # 20° below the horizontal
    "arms-down": {"shoulder": (0, 8, 0), "upper_arm": (0, -28, 0), "forearm": (5, 0, 0)},
    "stride": {
        "left_thigh": (22, 5, 0), "left_shin": (-5, 0, 0), "left_foot": (-15, -5, 0), "left_upper_arm": (-20, -12, 0),
        "right_thigh": (-18, 5, 0), "right_shin": (-15, 0, 0), "right_foot": (10, -5, 0),
        "right_upper_arm": (20, -12, 0), "forearm": (15, 0, 0),
    },
}  # fmt: skip
STANDING = "standing"
"""Drawn standing poses, see ``generator.standing.draw_pose``."""
ANGLES = ("bend", "spread", "twist")
BODIES = "a name such as neutral or female:7, or a model file"
JOINT = "smpl:"  # prefix of a joint of a model file, beside our bones
ROUNDING = 1e-6  # degrees beyond a limit, by conversion from radians


@dataclass(frozen=True, eq=False)
class Rig(Record):
    """Bones of the body model, in the order of ``BONES``."""

    carriers: csr_matrix
    """(b, v): maps the vertices of a body to its joints."""
    skin: csr_matrix
    """(v, b): skinning weights, which add up to 1."""
    axes: Float[np.ndarray, "b 3 3"]
    """The axes of bend, spread and twist of each bone in the A-pose, as columns."""


@functools.cache
def rig() -> Rig:
    """The rig of the body model. Raises ``BodyError`` for a damaged file."""
    with np.load(io.BytesIO(checked_data("rig.npz"))) as file, np.load(io.BytesIO(checked_data("body.npz"))) as body:
        mirror = body["mirror"].astype(int)
        finer, _, _ = refinement(body["faces"].astype(int), body["parts"])
        left = {name: file[name] for name in file.files}
    swapped = np.array([BONES.index(_across(bone)) for bone in BONES])
    stored, weights = stored_half(mirror), np.zeros((len(left["bones"]), len(BONES)))
    np.add.at(weights, (np.arange(len(weights))[:, None], left["bones"]), left["weights"])
    whole = np.zeros((len(mirror), len(BONES)))
    whole[stored] += weights
    whole[mirror[stored]] += weights[:, swapped]  # vertices in the middle get the mean of both sides
    joint, vertex = np.repeat(np.arange(len(left["counts"])), left["counts"]), left["carriers"].astype(int)
    shares = np.where(joint < len(TRUNK), 0.5, 1.0) * left["shares"]
    both = np.concatenate([joint, swapped[joint]]), np.concatenate([vertex, mirror[vertex]])
    carriers = csr_matrix((np.tile(shares, 2), both), (len(BONES), len(body_model().mean)))
    skin = csr_matrix(finer @ (whole / whole.sum(axis=1, keepdims=True)))
    return Rig(carriers, skin, _axes(carriers @ body_model().mean))


def _axes(joints: Float[np.ndarray, "b 3"]) -> Float[np.ndarray, "b 3 3"]:
    """Axes of bend, spread and twist: bend moves the tip of a bone forward, spread away from the other side."""
    axes = np.empty((len(BONES), 3, 3))
    for number, bone in enumerate(BONES):
        side, kind = side_and_kind(bone)
        parent, tip = TREE[kind]
        if tip in TREE:
            start = side + (parent if tip == kind else kind)
            along = joints[BONES.index(side + tip)] - joints[BONES.index(start)]
        else:
            along = np.array([0.0, 1.0 if tip == "up" else -1.0, 0.0])
        along = along / np.linalg.norm(along)
        forward = np.array([0.0, 0.0, 1.0]) - along[2] * along
        forward /= np.linalg.norm(forward)
        outward = 1.0 if side == "left_" else -1.0
        axes[number] = np.stack([np.cross(along, forward), outward * forward, -outward * along], axis=1)
    return axes


def side_and_kind(bone: str) -> tuple[str, str]:
    side = next((side for side in ("left_", "right_") if bone.startswith(side)), "")
    return side, bone.removeprefix(side)


def parent_of(bone: str) -> str:
    """The bone on which a bone turns; empty for the root."""
    side, kind = side_and_kind(bone)
    parent = TREE[kind][0]
    return parent if parent in ("", *TRUNK) else side + parent


PARENTS = tuple(BONES.index(parent) if (parent := parent_of(bone)) else -1 for bone in BONES)
"""The number of the bone that carries each bone; -1 for the root."""


def _across(bone: str) -> str:
    """The bone of the other side; a bone of the trunk itself."""
    side, kind = side_and_kind(bone)
    return kind if not side else ("right_" if side == "left_" else "left_") + kind


def pose_body(body: Body, pose: Pose) -> Body:
    """A body of the body model in a pose, standing on the floor; its bones turn from where they are in ``body``.

    A body of a model file turns from its A-pose. Raises ``BodyError`` for a body with another mesh, and for a pose
    outside ``LIMITS``.
    """
    require_possible(pose, body)
    if not pose.turns:
        return body
    if body.posed is not None:
        return replace(body, vertices=stand(body.posed(pose)))
    turns, shifts = bone_moves(body, pose)
    vertices, rotations = _blended(body.vertices, _same_half_space(Rotation.from_matrix(turns).as_quat()), shifts)
    skin = body_skin()
    normals = _turned(skin_normals(body.vertices, skin.faces), rotations[:, skin.faces[:, 0]])
    reference = replace(skin, normals=normals / np.linalg.norm(normals, axis=0))
    posed = reference.smoothed(vertices, ROUNDS, resolve_creases=True).vertices
    standing = stand(posed)
    joints = (turns @ (rig().carriers @ body.vertices)[:, :, None])[:, :, 0] + shifts
    return replace(body, vertices=standing, joints=joints + (standing[0] - posed[0]))


def bone_moves(body: Body, pose: Pose) -> tuple[Float[np.ndarray, "b 3 3"], Float[np.ndarray, "b 3"]]:
    """The rotation and the shift [cm] of each of ``BONES`` from a body of the body model, not yet put on the floor."""
    joints, turns = rig().carriers @ body.vertices, whole_turns(pose)
    moved = joints.copy()
    for number, parent in enumerate(PARENTS):  # parents come first
        if parent >= 0:
            moved[number] = moved[parent] + turns[parent] @ (joints[number] - joints[parent])
    return turns, moved - (turns @ joints[:, :, None])[:, :, 0]


def whole_turns(pose: Pose) -> Float[np.ndarray, "b 3 3"]:
    """The rotation of each of ``BONES`` from the A-pose."""
    turns = Rotation.from_rotvec((rig().axes @ pose.array[:, :, None])[:, :, 0]).as_matrix()
    for number, parent in enumerate(PARENTS):  # parents come first
        if parent >= 0:
            turns[number] = turns[parent] @ turns[number]
    return turns


def _same_half_space(rotations: Float[np.ndarray, "b 4"]) -> Float[np.ndarray, "b 4"]:
    """The quaternions, each with the sign that brings it nearer to its parent's: blending takes the shorter way."""
    signed = rotations.copy()
    for number, parent in enumerate(PARENTS):
        if parent >= 0 and signed[number] @ signed[parent] < 0.0:
            signed[number] *= -1.0
    return signed


def _blended(
    vertices: Float[np.ndarray, "v 3"], rotations: Float[np.ndarray, "b 4"], shifts: Float[np.ndarray, "b 3"]
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "4 v"]]:
    """The vertices moved by blended dual quaternions (x, y, z, w), and the rotation of each.

    By coordinates, as ``skin_normals``: ``np.cross`` takes several times longer.
    """
    dual = 0.5 * _product(np.pad(shifts, ((0, 0), (0, 1))).T, rotations.T)
    blend = np.ascontiguousarray((rig().skin @ np.concatenate([rotations, dual.T], axis=1)).T)
    real, dual = (blend / np.linalg.norm(blend[:4], axis=0)).reshape(2, 4, -1)
    shift = 2.0 * _product(dual, np.concatenate([-real[:3], real[3:]]))[:3]
    return (_turned(np.ascontiguousarray(vertices.T), real) + shift).T, real


def _product(a: Float[np.ndarray, "4 n"], b: Float[np.ndarray, "4 n"]) -> Float[np.ndarray, "4 n"]:
    """Products of quaternions (x, y, z, w)."""
    (u, s), (w, t) = (a[:3], a[3]), (b[:3], b[3])
    return np.concatenate([s * w + t * u + _cross(u, w), (s * t - (u * w).sum(axis=0))[None]])


def _turned(vectors: Float[np.ndarray, "3 n"], rotations: Float[np.ndarray, "4 n"]) -> Float[np.ndarray, "3 n"]:
    """Each vector, turned by its unit quaternion (x, y, z, w)."""
    axis, w = rotations[:3], rotations[3]
    return vectors + 2.0 * _cross(axis, _cross(axis, vectors) + w * vectors)


def _cross(a: Float[np.ndarray, "3 n"], b: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 n"]:
    (x, y, z), (p, q, r) = a, b
    return np.stack([y * r - z * q, z * p - x * r, x * q - y * p])


def require_possible(pose: Pose, body: Body | None = None) -> None:
    """Raise ``BodyError`` for a body with another mesh than the body model's, and for an impossible pose.

    A pose is impossible with an unknown bone, with angles that are no numbers, and with angles outside ``LIMITS``.
    """
    by_file = body is not None and body.posed is not None
    if body is not None and not by_file and not np.array_equal(body.faces, body_model().faces):
        raise BodyError(f"{body.name}: not a mesh of the body model, which alone can be posed: give {BODIES}")
    for bone, turn in pose.turns.items():
        if by_file and bone.startswith(JOINT):
            continue
        if bone not in BONES:
            raise BodyError(f"pose {shown(pose.name)}: no bone named {shown(str(bone))}: there are {', '.join(BONES)}")
        if np.shape(turn) != (3,) or not np.isfinite(turn).all():
            raise BodyError(f"pose {shown(pose.name)}: {bone} is {turn}: give bend, spread and twist as three numbers")
        for name, angle, (low, high) in zip(ANGLES, np.degrees(turn), LIMITS[side_and_kind(bone)[1]], strict=True):
            if not low - ROUNDING <= angle <= high + ROUNDING:
                raise BodyError(
                    f"pose {shown(pose.name)}: {bone} has a {name} of {angle:.1f}°: give one from {low}° to {high}°"
                )


def named_pose(name_or_path: str | Path) -> Pose:
    """The pose of a name of ``POSES``, or of a file that holds one. Raises as ``read_poses`` does."""
    poses = read_poses(name_or_path)
    if len(poses) > 1:
        raise BodyError(f"{shown(str(name_or_path))}: holds {len(poses)} poses: give a file of one")
    return poses[0]


def read_poses(name_or_path: str | Path) -> tuple[Pose, ...]:
    """The poses of a JSON or TOML file, or the one of a name of ``POSES``.

    A pose is an object of bones, each with bend, spread and twist [degrees]; several are a list, in TOML tables
    ``[[poses]]``. Raises ``BodyError`` for an unknown name and an impossible pose, ``ConfigError`` for broken TOML.
    """
    name, path = str(name_or_path), Path(name_or_path)
    found: Any = POSES.get(name)
    if found is None:
        if not path.suffix:
            known = ", ".join(POSES)
            raise BodyError(
                f"no pose named {shown(name)}: there are {known}, {STANDING} in data sets, or a JSON or TOML file"
            )
        is_toml = path.suffix == ".toml"
        found = read_toml(path) if is_toml else read_json(path, "pose", error=BodyError)
        found = found.get("poses", found) if is_toml else found
    listed, poses = found if isinstance(found, list) else [found], list[Pose]()
    if not listed:
        raise BodyError(f"{shown(name)}: an empty list: give one pose or more")
    for number, degrees in enumerate(listed, 1):
        which = f":{number}" if len(listed) > 1 else ""
        if not isinstance(degrees, dict):
            raise BodyError(
                f'{shown(name + which)}: not an object of bones: give them as {{"left_forearm": [30, 0, 0]}}'
            )
        pose = pose_of(degrees, name + which)
        require_possible(pose)
        poses.append(replace(pose, name=path.stem + which))  # wherever the file lies
    return tuple(poses)


def pose_of(degrees: Mapping[str, Any], name: str) -> Pose:
    """The pose of angles in degrees; a limb without a side stands for both."""
    whole = {side + bone: turn for bone, turn in degrees.items() if bone in LIMBS for side in ("left_", "right_")}
    whole |= {bone: turn for bone, turn in degrees.items() if bone not in LIMBS}
    return Pose({bone: _radians(turn) for bone, turn in whole.items()}, name)


def pose_degrees(pose: Pose) -> dict[str, list[float]]:
    """The angles of a pose as its JSON file has them."""
    return {bone: np.degrees(turn).round(6).tolist() for bone, turn in pose.turns.items()}


def _radians(turn: Any) -> Any:
    """The angles in radians, or what is not three numbers as it is, for ``require_possible`` to name."""
    try:
        return tuple(float(angle) for angle in np.radians(np.asarray(turn, float)))
    except (TypeError, ValueError):
        return (np.nan, np.nan, np.nan)
