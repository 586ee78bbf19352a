"""Partial point clouds: depth cameras round a figure, and what they measure of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render.cameras import Camera, look_at
from gcd_dataset.generator.render.depth_noise import KINECT, DepthNoise, measure
from gcd_dataset.generator.render.range_images import RangeImage, Ranger
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.records import Record

DEPTH_PIXELS = 480  # rows of a Kinect's depth image; the picture here is square
FOCAL = 580.0 / DEPTH_PIXELS  # picture widths; a Kinect's focal length is 580 pixels of 640 x 480
FILL = 0.92  # largest share of the picture's height or width that the figure takes


@dataclass(frozen=True)
class ScanRanges:
    """Ranges of drawn cameras; all of a scan stand on one circle round the garment, evenly spaced."""

    yaw: tuple[float, float] = (-180.0, 180.0)
    """Angle of the first camera [degrees]: 0 in front, 90 at the wearer's left."""
    distance: tuple[float, float] = (180.0, 260.0)
    """From the middle of the figure [cm]; more where it would not fit into the picture."""
    height: tuple[float, float] = (90.0, 150.0)
    """Of the cameras above the floor [cm]."""


@dataclass(frozen=True, eq=False)
class PointScan(Record):
    """Points that depth cameras measured, in random order. All NaN, with panel -1, where they measured nothing."""

    points: Float[np.ndarray, "n 3"]
    """[cm]"""
    normals: Float[np.ndarray, "n 3"]
    """True unit normals, towards the camera."""
    panel_id: Int[np.ndarray, " n"]
    """True panel: row of ``Scene.panel_names``; -1 on the body."""
    camera: Int[np.ndarray, " n"]
    """The camera that measured each point."""
    extrinsics: Float[np.ndarray, "k 3 4"]
    """True [R | t] of each camera, world to camera [1, cm]."""
    intrinsics: Float[np.ndarray, "3 3"]
    """K of all cameras [pixels]."""
    measured: int
    """Number of different points measured, before sampling."""


def scan_cameras(scene: Scene, n: int, *, yaw: float = 0.0, distance: float = 220.0, height: float = 120.0,
                 body: bool = False) -> list[Camera]:  # fmt: skip
    """``n`` cameras on a circle, evenly spaced, the first at ``yaw`` [degrees]; a turntable stops so.

    They look at the garment, with ``body`` at the whole figure, from ``distance`` [cm] or as far as it takes to see it.
    """
    if n < 1:
        raise ConfigError(f"a scan of {n} views: give 1 or more")
    low, high = scene.bounds() if body else (scene.vertices.min(axis=0), scene.vertices.max(axis=0))
    middle = 0.5 * (low + high)
    depth = 0.5 * float(np.hypot(high[0] - low[0], high[2] - low[2]))
    needed = FOCAL * max(float(high[1] - low[1]), 2 * depth) / FILL + depth
    radius = max(distance, needed)
    cameras = []
    for k in range(n):
        angle = math.radians(yaw + 360.0 * k / n)
        eye = middle + radius * np.array([math.sin(angle), 0.0, math.cos(angle)])
        eye[1] = height
        cameras.append(look_at(eye, middle, focal=FOCAL))
    return cameras


def draw_scan_cameras(
    rng: np.random.Generator, scene: Scene, n: int, *, ranges: ScanRanges | None = None, body: bool = False
) -> list[Camera]:
    """``n`` evenly spaced cameras at a random angle, distance and height."""
    ranges = ranges or ScanRanges()
    yaw, distance, height = (float(rng.uniform(*r)) for r in (ranges.yaw, ranges.distance, ranges.height))
    return scan_cameras(scene, n, yaw=yaw, distance=distance, height=height, body=body)


def scan(
    scene: Scene,
    cameras: Sequence[Camera],
    rng: np.random.Generator,
    *,
    points: int = 8192,
    noise: DepthNoise = KINECT,
    body: bool = False,
    size: int = DEPTH_PIXELS,
    device: str = "auto",
) -> PointScan:
    """``points`` points of the cloth, with ``body`` of the skin too, measured by all cameras.

    The body hides cloth in any case. With fewer pixels than points, some points repeat. Raises ``ConfigError`` for no
    camera, and for a number of points below 1.
    """
    if points < 1 or not cameras:
        raise ConfigError(f"a scan of {points} points by {len(cameras)} cameras: give 1 or more of both")
    with Ranger(scene, device=device) as ranger:
        images = ranger.images(cameras, size)
        parts = [_measured(ranger, image, k, noise, rng, body=body) for k, image in enumerate(images)]
    position, normal, panel, camera = (np.concatenate(column) for column in zip(*parts, strict=True))
    rows = _choice(rng, len(position), points)
    if not len(position):
        position = normal = np.full((1, 3), np.nan)
        panel, camera = np.full(1, -1), np.full(1, -1)
    return PointScan(
        points=position[rows],
        normals=normal[rows],
        panel_id=panel[rows],
        camera=camera[rows],
        extrinsics=np.stack([one.extrinsics() for one in cameras]),
        intrinsics=cameras[0].intrinsics(size),
        measured=sum(len(part[0]) for part in parts),
    )


# ------------------------------------------------------------------------------------------------------------- helpers


def _measured(
    ranger: Ranger, image: RangeImage, number: int, noise: DepthNoise, rng: np.random.Generator, *, body: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals, panels and the camera's number, of all pixels with a depth."""
    seen = measure(image, noise, rng, lit=ranger.lit)
    turn, shift = rng.standard_normal((2, 3))
    panel = image.panel.ravel()[seen.source]
    kept = np.isfinite(seen.depth) & ((panel >= 0) | body)
    points = image.positions(np.where(kept, seen.depth, 0.0))[kept]
    if number:
        rotation = _rotation(np.radians(noise.rotation) * turn)
        middle = image.scene.vertices.mean(axis=0)
        points = (points - middle) @ rotation.T + middle + noise.shift * shift
    normals = image.normals.reshape(-1, 3)[seen.source[kept]]
    return points, normals, panel[kept], np.full(len(points), number)


def _rotation(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation about a vector by its length [rad]: Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def _choice(rng: np.random.Generator, available: int, wanted: int) -> Int[np.ndarray, " n"]:
    """``wanted`` rows at random: different ones if there are enough, else every row and some again."""
    if not available:
        return np.zeros(wanted, int)
    if available >= wanted:
        return rng.choice(available, wanted, replace=False)
    return rng.permutation(np.concatenate([np.arange(available), rng.choice(available, wanted - available)]))
