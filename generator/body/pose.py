"""Poses the arms and legs: linear blend skinning about six joints, with all rotations about the z axis."""

import numpy as np
from jaxtyping import Float

LEGS_APART = np.radians(3.0)
"""Rotation of each thigh with legs apart [rad]: moves the feet from 15 to 19 cm off the midplane."""

T_POSE = np.radians(45.0)
"""``arm_angle`` from the A-pose to horizontal upper arms [rad]."""

LEFT_ARM, LEFT_LEG, LEFT_FOOT, RIGHT_ARM, RIGHT_LEG, RIGHT_FOOT = range(6)


def set_pose(
    vertices: Float[np.ndarray, "v 3"],
    joints: Float[np.ndarray, "6 3"],
    skin: Float[np.ndarray, "v 6"],
    *,
    arm: float = 0.0,
    leg: float = 0.0,
) -> Float[np.ndarray, "v 3"]:
    """The vertices with both arms raised by ``arm`` and both legs spread by ``leg`` [rad]; the soles stay level.

    ``joints`` [cm] and the columns of ``skin``, the skinning weights, are ordered as ``LEFT_ARM`` to ``RIGHT_FOOT``.
    """
    posed = vertices.copy()
    for side, shoulder, hip, ankle in ((1, LEFT_ARM, LEFT_LEG, LEFT_FOOT), (-1, RIGHT_ARM, RIGHT_LEG, RIGHT_FOOT)):
        if arm:
            _blend_rotation(posed, joints[shoulder], side * arm, skin[:, shoulder])
        if leg:
            foot = _rotated(joints[ankle, :2], joints[hip], side * leg)
            _blend_rotation(posed, joints[hip], side * leg, skin[:, hip])
            _blend_rotation(posed, foot, -side * leg, skin[:, ankle])
    return posed


def stand(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    """The vertices with the lowest of them on y = 0."""
    standing = vertices.copy()
    standing[:, 1] -= vertices[:, 1].min()
    return standing


def _blend_rotation(
    points: Float[np.ndarray, "v 3"], centre: np.ndarray, angle: float, weights: Float[np.ndarray, " v"]
) -> None:
    """Move points in place towards their rotated positions, linearly by weight (linear blend skinning)."""
    rows = np.flatnonzero(weights)
    share, (x, y) = weights[rows], points[rows, :2].T
    turned = _rotated(np.stack([x, y], axis=-1), centre, angle)
    points[rows, 0] = x + share * (turned[:, 0] - x)
    points[rows, 1] = y + share * (turned[:, 1] - y)


def _rotated(points: Float[np.ndarray, "*n 2"], centre: np.ndarray, angle: float) -> Float[np.ndarray, "*n 2"]:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., 0] - centre[0], points[..., 1] - centre[1]
    return np.stack([cos * x - sin * y + centre[0], sin * x + cos * y + centre[1]], axis=-1)
