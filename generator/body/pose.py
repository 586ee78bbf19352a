"""Arms raised or lowered, legs set apart: linear blend skinning about six joints, all turns about the z axis."""

import numpy as np
from jaxtyping import Float

__all__ = ["LEGS_APART", "set_pose", "stand"]

LEGS_APART = np.radians(3.0)
"""Turn of each thigh when the legs are apart [rad]: moves the feet from 15 to 19 cm off the middle."""

LEFT_ARM, LEFT_LEG, LEFT_FOOT, RIGHT_ARM, RIGHT_LEG, RIGHT_FOOT = range(6)


def set_pose(
    vertices: Float[np.ndarray, "v 3"],
    joints: Float[np.ndarray, "6 3"],
    skin: Float[np.ndarray, "v 6"],
    *,
    arm: float = 0.0,
    leg: float = 0.0,
) -> Float[np.ndarray, "v 3"]:
    """The vertices with both arms raised by ``arm`` and both legs spread by ``leg`` [rad]; the soles stay level."""
    posed = vertices.copy()
    for side, shoulder, hip, ankle in ((1, LEFT_ARM, LEFT_LEG, LEFT_FOOT), (-1, RIGHT_ARM, RIGHT_LEG, RIGHT_FOOT)):
        if arm:
            posed += skin[:, shoulder, None] * (_turned(vertices, joints[shoulder], side * arm) - vertices)
        if leg:
            spread = _turned(vertices, joints[hip], side * leg)
            foot = _turned(joints[ankle], joints[hip], side * leg)
            posed += skin[:, hip, None] * (spread - vertices)
            posed += skin[:, ankle, None] * (_turned(spread, foot, -side * leg) - spread)
    return posed


def stand(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    """The vertices with the lowest of them on y = 0."""
    return vertices - [0.0, vertices[:, 1].min(), 0.0]


def _turned(points: np.ndarray, centre: np.ndarray, angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return (points - centre) @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + centre
