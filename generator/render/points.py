"""Points whose pixels are wanted: panel corners and landmarks."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.generator.render.cameras import Camera
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.records import Record


@dataclass(frozen=True, eq=False)
class Points(Record):
    """Panel corners, then landmarks, as one camera sees them."""

    positions: Float[np.ndarray, "n 3"]
    """[cm]"""
    pixels: Float[np.ndarray, "n 2"]
    """Column and row; NaN behind the camera."""
    in_picture: Bool[np.ndarray, " n"]
    corners: int
    """Number of panel corners."""
    panel_corners: Int[np.ndarray, "k 2"]
    landmark_names: tuple[str, ...]


def points_of(scene: Scene, camera: Camera, size: int) -> Points:
    """The points of a scene in a picture of ``size`` pixels."""
    corners = scene.vertices[scene.uv_vertex[scene.corner_rows]]
    marks = np.array(list(scene.landmarks.values())).reshape(-1, 3)
    positions = np.concatenate([corners, marks])
    pixels = camera.project(positions, size)
    inside = np.asarray((np.abs(pixels - 0.5 * (size - 1)) <= 0.5 * size).all(axis=1))
    return Points(positions, pixels, inside, len(corners), scene.panel_corners, tuple(scene.landmarks))
