"""Pinhole cameras in OpenCV's convention, and their random ranges."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.records import Record

FILM = 24.0  # mm; height of a frame of 35 mm film, for which focal lengths are stated
FIXED_DISTANCE = 520.0  # cm from a fixed camera to the centre of the scene
FACING = {"front": (0.0, 0.0, 1.0), "side": (1.0, 0.0, 0.0), "back": (0.0, 0.0, -1.0)}
"""Direction to each fixed camera; the side is the wearer's left."""
EYE_ABOVE_FLOOR = 10.0  # cm; a camera on the floor would look through it
FIXED_MARGIN = 1.04  # width of its field of view over the larger side of the box round the scene


@dataclass(frozen=True, eq=False)
class Camera(Record):
    """A pinhole camera without distortion, for square pictures."""

    rotation: Float[np.ndarray, "3 3"]
    """World to camera; rows are the camera's right, down and forward axes."""
    eye: Float[np.ndarray, "3"]
    """Centre of projection [cm]."""
    focal: float
    """Focal length as a multiple of the picture's width."""
    shift: tuple[float, float] = (0.0, 0.0)
    """Offset of the principal point from the picture's centre, right and down, as multiples of its width: a crop."""

    @staticmethod
    def of(intrinsics: Float[np.ndarray, "3 3"], extrinsics: Float[np.ndarray, "3 4"], size: int) -> "Camera":
        """The camera of a picture of ``size`` pixels. Raises ``ConfigError`` for another kind of camera."""
        focal, rotation = float(intrinsics[0, 0]), extrinsics[:, :3]
        (x, y), pinhole = intrinsics[:2, 2], np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
        off = np.abs(intrinsics - [[0.0, 0.0, x], [0.0, 0.0, y], [0.0, 0.0, 1.0]] - focal * pinhole).max()
        if focal <= 0.0 or off > 0.01 * focal:
            raise ConfigError("k is not [[f, 0, x], [0, f, y], [0, 0, 1]] in pixels: rectify the picture")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(rotation) < 0.0:
            raise ConfigError("rt does not begin with a rotation: give [R | t], world to camera, y down, z forward")
        right, down = ((at + 0.5) / size - 0.5 for at in (float(x), float(y)))
        return Camera(rotation, -rotation.T @ extrinsics[:, 3], focal / size, (right, down))

    def intrinsics(self, size: int) -> Float[np.ndarray, "3 3"]:
        """K for a picture of ``size`` pixels; pixel centres have whole coordinates."""
        middle = 0.5 * (size - 1)
        x, y = (middle + size * part for part in self.shift)
        return np.array([[self.focal * size, 0.0, x], [0.0, self.focal * size, y], [0.0, 0.0, 1.0]])

    def extrinsics(self) -> Float[np.ndarray, "3 4"]:
        """[R | t], world to camera."""
        return np.column_stack([self.rotation, -self.rotation @ self.eye])

    def project(self, points: Float[np.ndarray, "n 3"], size: int) -> Float[np.ndarray, "n 2"]:
        """Column and row of points [cm] in a picture of ``size`` pixels; NaN behind the camera."""
        seen = (points - self.eye) @ self.rotation.T
        depth = np.where(seen[:, 2:] > 1e-6, seen[:, 2:], np.nan)
        K = self.intrinsics(size)
        return seen[:, :2] / depth * K[0, 0] + K[:2, 2]


@dataclass(frozen=True)
class CameraRanges:
    """Ranges of drawn cameras; the camera stands on a circle round the figure and looks at it."""

    yaw: tuple[float, float] = (-180.0, 180.0)
    """Angle of the camera round the figure [degrees]: 0 in front, 90 at the wearer's left."""
    pitch: tuple[float, float] = (-8.0, 18.0)
    """Height of the camera, as its angle above the point it looks at [degrees]."""
    roll: tuple[float, float] = (-3.0, 3.0)
    """[degrees]"""
    focal: tuple[float, float] = (35.0, 105.0)
    """Focal length as on 35 mm film [mm]; the distance follows from the crop."""
    fill: tuple[float, float] = (0.72, 0.97)
    """Height of the framed part, as a share of the picture's."""
    crop: float = 0.3
    """Share of pictures that frame the garment rather than the whole figure."""
    offset: tuple[float, float] = (-0.03, 0.03)
    """Offset of the framed part from the middle, as a share of the picture's width."""


def look_at(
    eye: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "3"],
    *,
    focal: float,
    roll: float = 0.0,
    shift: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """A camera at ``eye`` that looks at ``target`` [cm], upright but for ``roll`` [rad, clockwise picture].

    Raises ``ConfigError`` where the direction is not defined.
    """
    forward = np.asarray(target, float) - np.asarray(eye, float)
    across = np.array([-forward[2], 0.0, forward[0]])  # the cross product with the vertical
    length = math.sqrt(forward @ forward)
    if math.sqrt(across @ across) < 1e-6 * max(1.0, length):
        raise ConfigError(f"a camera at {eye} looks along the vertical at {target}: move it aside")
    forward, right = forward / length, across / math.sqrt(across @ across)
    down = _cross(forward, right)
    c, s = math.cos(roll), math.sin(roll)
    rotation = np.array([c * right - s * down, s * right + c * down, forward])
    return Camera(rotation, np.asarray(eye, float), focal, shift)


def draw_camera(rng: np.random.Generator, scene: Scene, *, ranges: CameraRanges | None = None) -> Camera:
    """A camera that frames the figure, or the garment alone."""
    ranges = ranges or CameraRanges()
    yaw, pitch, roll = (math.radians(rng.uniform(*bounds)) for bounds in (ranges.yaw, ranges.pitch, ranges.roll))
    # Logarithmic: 35 to 50 mm changes the perspective as much as 70 to 100 mm.
    focal = math.exp(rng.uniform(*np.log(ranges.focal))) / FILM
    fill, (right, down) = rng.uniform(*ranges.fill), rng.uniform(*ranges.offset, size=2)
    whole = rng.random() >= ranges.crop
    points = scene.figure_points if whole or not len(scene.vertices) else scene.garment_points
    middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
    away = np.array([math.cos(pitch) * math.sin(yaw), math.sin(pitch), math.cos(pitch) * math.cos(yaw)])
    axes = look_at(middle + away, middle, focal=focal, roll=roll).rotation
    aside, below, along = axes @ (points - middle[:, None])
    across = np.maximum(np.abs(aside), np.abs(below))
    # A point at (x, z) from the middle is drawn at focal · x / (distance + z), at most half of the filled part.
    distance = float((2.0 * focal / fill * across - along).max())
    eye = middle + distance * away
    eye[1] = max(float(eye[1]), EYE_ABOVE_FLOOR)
    return look_at(eye, middle, focal=focal, roll=roll, shift=(float(right), float(down)))


def fixed_camera(scene: Scene, side: str = "front") -> Camera:
    """The camera of a plain picture, from a side of ``FACING``. Raises ``ConfigError`` for another side."""
    if side not in FACING:
        raise ConfigError(f"a fixed camera at {side!r}: choose {', '.join(FACING)}")
    (low, high), facing = scene.bounds(), np.array(FACING[side])
    width = FIXED_MARGIN * float(max(high[0] - low[0], high[1] - low[1]))
    # The nearest side of the box needs the widest angle.
    focal = (FIXED_DISTANCE - 0.5 * float(np.abs(facing) @ (high - low))) / width
    middle = 0.5 * (low + high)
    return look_at(middle + FIXED_DISTANCE * facing, middle, focal=focal)


def _cross(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """``np.cross`` of two vectors, in a tenth of its time."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
