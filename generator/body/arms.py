"""Arms laid where our bodies hold them: shoulder and arm are measured in the A-pose, whatever the pose of a scan."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.register import ARMS, PIVOT, Alignment, Registration, joints_of, registration_at
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.records import Record

__all__ = ["A_POSE_TOLERANCE", "Arms", "model_mesh_in_a_pose", "turn_off_a_pose"]

A_POSE_TOLERANCE = np.radians(20.0)
"""Turn of an arm from the A-pose beyond which it is laid back to be measured; drawn bodies have up to 15°."""

A_POSE = np.radians(47.0)  # arm_pose_angle of the mean body


@dataclass(frozen=True, eq=False)
class Arms(Record):
    """Both arms of a registered model: from the A-pose to where they are held, and back."""

    held: Registration
    """The model as it lies."""
    hanging: Registration
    """The same one in the A-pose."""

    @classmethod
    def of(cls, surface: SkinSurface, held: Registration) -> Self:
        """The arms of a model as it lies on a surface."""
        return cls(held, registration_at(surface, held.guess.in_a_pose()))

    @property
    def turn(self) -> float:
        """How far the arm is from the A-pose that is further from it [rad]."""
        return float(np.linalg.norm(self._guess.arm_turns, axis=1).max())

    def laid(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the surface that the model lies on, moved to where they are in the A-pose."""
        still, share, turns = self._still(points), _shares(points, self.held), self._turns()
        blend = np.eye(3) + np.einsum("na,aij->nij", share, turns)
        ahead = still + np.einsum("na,aij,aj->ni", share, turns, self._joints())
        return self._placed(np.linalg.solve(blend, ahead[..., None])[..., 0])

    def held_at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The other way: points in the A-pose, moved to where they are."""
        still, share = self._still(points), _shares(points, self.hanging)
        arms = still[:, None] - self._joints()
        return self._placed(still + np.einsum("na,aij,naj->ni", share, self._turns(), arms))

    @property
    def _guess(self) -> Alignment:
        return self.held.guess

    def _turns(self) -> Float[np.ndarray, "2 3 3"]:
        return Rotation.from_rotvec(self._guess.arm_turns.copy()).as_matrix() - np.eye(3)

    def _joints(self) -> Float[np.ndarray, "2 3"]:
        return joints_of(self._guess)[list(ARMS)]

    def _still(self, points: np.ndarray) -> np.ndarray:
        """Points in the frame of the model that has not been turned and shifted as a whole."""
        return (points - PIVOT - self._guess.place[:3]) @ self._guess.turn + PIVOT

    def _placed(self, points: np.ndarray) -> np.ndarray:
        return (points - PIVOT) @ self._guess.turn.T + PIVOT + self._guess.place[:3]


def turn_off_a_pose(arm_pose_angle: float) -> float:
    """By how much an arm is held off the A-pose, where it has to be laid there to be measured, or 0 [rad]."""
    off = abs(arm_pose_angle - A_POSE)
    return off if off > A_POSE_TOLERANCE else 0.0


def model_mesh_in_a_pose(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    """A body of our own mesh with its arms in the A-pose, wherever they are.

    The shape is that of the trunk, which follows no joint; the turn of an arm is that of what follows it altogether.
    """
    model = body_model()
    trunk = np.flatnonzero(model.skin.sum(axis=1) == 0)[::5]
    shift = np.tile(np.eye(3), (len(trunk), 1))
    slopes = np.concatenate([model.components[:, trunk].reshape(len(model.components), -1).T, shift], axis=1)
    found = np.linalg.lstsq(slopes, (vertices - model.mean)[trunk].ravel(), rcond=None)[0]
    weights, moved = found[:-3], found[-3:]
    laid = vertices.copy()
    for joint in ARMS:
        share = model.skin[:, joint]
        outer, all_of_it = np.flatnonzero(share > 0), np.flatnonzero(share > 0.999)
        centre = model.joints[joint] + weights @ model.joint_components[:, joint] + moved
        still = (model.mean + np.einsum("k,kvi->vi", weights, model.components) + moved)[all_of_it] - centre
        turn = Rotation.align_vectors(vertices[all_of_it] - centre, still)[0].as_matrix()
        blend = np.eye(3) + share[outer, None, None] * (turn - np.eye(3))
        laid[outer] = centre + np.linalg.solve(blend, (vertices[outer] - centre)[..., None])[..., 0]
    return laid


def _shares(points: np.ndarray, model: Registration) -> Float[np.ndarray, "n 2"]:
    """How much of each arm's turn the points follow: as the model's skin beside them does."""
    faces = body_model().faces
    near = SkinSurface.of(model.vertices, faces).nearest(points)
    triangles = faces[near.faces]
    weights = trimesh.triangles.points_to_barycentric(model.vertices[triangles], near.points)
    return np.einsum("nc,nca->na", np.clip(weights, 0.0, 1.0), body_model().skin[triangles][:, :, list(ARMS)])
