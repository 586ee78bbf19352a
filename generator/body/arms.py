"""Moves the arms of a body to the A-pose, in which shoulders and arms are measured, and back."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.register import ARMS, PIVOT, Alignment, Registration, joints_of, registration_at
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.records import BodyPart, Record

A_POSE_TOLERANCE = np.radians(20.0)
"""Arms rotated from the A-pose by less are measured without moving them [rad]; drawn bodies have up to 15°."""

A_POSE_ANGLE = np.radians(47.0)  # arm_pose_angle of the mean body


@dataclass(frozen=True, eq=False)
class ArmPose(Record):
    """The pose of a body's arms, from the registered body model: maps points to the A-pose and back."""

    posed: Registration
    """The model in the pose of the body."""
    in_a_pose: Registration
    """The same model with its arms in the A-pose."""

    @classmethod
    def of(cls, surface: SkinSurface, posed: Registration) -> Self:
        """The arm pose of a model that is registered to a surface."""
        return cls(posed, registration_at(surface, posed.alignment.in_a_pose()))

    @property
    def turn(self) -> float:
        """Rotation of an arm from the A-pose, the larger of both arms [rad]."""
        return float(np.linalg.norm(self._alignment.arm_turns, axis=1).max())

    def to_a_pose(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points on the posed surface, moved to the A-pose: inverse linear blend skinning."""
        local, weights, turns = self._to_model_frame(points), _arm_weights(points, self.posed), self._turns()
        blend = np.eye(3) + np.einsum("na,aij->nij", weights, turns)
        right = local + np.einsum("na,aij,aj->ni", weights, turns, self._joints())
        return self._from_model_frame(np.linalg.solve(blend, right[..., None])[..., 0])

    def from_a_pose(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points on the surface in the A-pose, moved to the body's pose: linear blend skinning."""
        local, weights = self._to_model_frame(points), _arm_weights(points, self.in_a_pose)
        arms = local[:, None] - self._joints()
        return self._from_model_frame(local + np.einsum("na,aij,naj->ni", weights, self._turns(), arms))

    @property
    def _alignment(self) -> Alignment:
        return self.posed.alignment

    def _turns(self) -> Float[np.ndarray, "2 3 3"]:
        """Rotation matrix minus identity of each arm."""
        return Rotation.from_rotvec(self._alignment.arm_turns.copy()).as_matrix() - np.eye(3)

    def _joints(self) -> Float[np.ndarray, "2 3"]:
        return joints_of(self._alignment)[list(ARMS)]

    def _to_model_frame(self, points: np.ndarray) -> np.ndarray:
        """Points with the rigid motion of the whole model undone."""
        return (points - PIVOT - self._alignment.pose[:3]) @ self._alignment.turn + PIVOT

    def _from_model_frame(self, points: np.ndarray) -> np.ndarray:
        return (points - PIVOT) @ self._alignment.turn.T + PIVOT + self._alignment.pose[:3]


def turn_off_a_pose(arm_pose_angle: float) -> float:
    """Rotation of an arm from the A-pose [rad]; 0 within ``A_POSE_TOLERANCE``.

    >>> turn_off_a_pose(np.radians(47.0)), float(np.degrees(turn_off_a_pose(np.radians(2.0))).round())
    (0.0, 45.0)
    """
    off = abs(arm_pose_angle - A_POSE_ANGLE)
    return off if off > A_POSE_TOLERANCE else 0.0


def model_mesh_in_a_pose(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    """The vertices of a body with the model's mesh, with its arms moved from any pose to the A-pose [cm].

    Shape weights are fitted to the trunk, where skinning weights are 0, and the rotation of an arm to its vertices with
    skinning weight 1. Then the linear blend skinning of all vertices of the arm is inverted.
    """
    model = body_model()
    trunk = np.flatnonzero(model.skin.sum(axis=1) == 0)[::5]
    shift_columns = np.tile(np.eye(3), (len(trunk), 1))
    jacobian = np.concatenate([model.components[:, trunk].reshape(len(model.components), -1).T, shift_columns], axis=1)
    solution = np.linalg.lstsq(jacobian, (vertices - model.mean)[trunk].ravel(), rcond=None)[0]
    weights, shift = solution[:-3], solution[-3:]
    in_a_pose = vertices.copy()
    for joint in ARMS:
        weight = model.skin[:, joint]
        partial, rigid = np.flatnonzero(weight > 0), np.flatnonzero(weight > 0.999)
        centre = model.joints[joint] + weights @ model.joint_components[:, joint] + shift
        rest = (model.mean + np.einsum("k,kvi->vi", weights, model.components) + shift)[rigid] - centre
        turn = Rotation.align_vectors(vertices[rigid] - centre, rest)[0].as_matrix()
        blend = np.eye(3) + weight[partial, None, None] * (turn - np.eye(3))
        in_a_pose[partial] = centre + np.linalg.solve(blend, (vertices[partial] - centre)[..., None])[..., 0]
    return in_a_pose


def _arm_weights(points: np.ndarray, model: Registration) -> Float[np.ndarray, "n 2"]:
    """Skinning weights of both arms at points, interpolated on the nearest faces of the model.

    Of an arm, or of the rest of the body, as is the nearest vertex: the flank may be nearer to a hanging arm's faces.
    """
    from trimesh.triangles import points_to_barycentric  # imported here: see SkinSurface.nearest

    body, found = body_model(), np.zeros((len(points), len(ARMS)))
    on_arm = np.isin(body.parts, [part.value for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.HANDS)])
    of_arm = on_arm[cKDTree(model.vertices).query(points)[1]]
    for rows, faces in (
        (of_arm, body.faces[on_arm[body.faces].any(axis=1)]),
        (~of_arm, body.faces[~on_arm[body.faces].any(axis=1)]),
    ):
        if not rows.any():
            continue
        near = SkinSurface.of(model.vertices, faces).nearest(points[rows])
        triangles = faces[near.faces]
        shares = np.clip(points_to_barycentric(model.vertices[triangles], near.points), 0.0, 1.0)
        found[rows] = np.einsum("nc,nca->na", shares, body.skin[triangles][:, :, list(ARMS)])
    return found
