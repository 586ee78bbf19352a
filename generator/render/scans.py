"""Scans: point clouds of depth cameras about a figure, their range images, and the noise of real sensors.

Scans are made of range images. Conventions are those of ``pictures``.

Sources, by the names used below:

- Khoshelham and Elberink: Accuracy and resolution of Kinect depth data for indoor mapping applications. Sensors 12(2),
  2012: depth noise and resolution grow with the square of the distance, since the sensor measures disparity in steps.
- Nguyen, Izadi and Lovell: Modeling Kinect sensor noise for improved 3D reconstruction and tracking. 3DIMPVT 2012:
  noise across the line of sight in pixels, and its growth at grazing angles.
- Handa, Whelan, McDonald and Davison: A benchmark for RGB-D visual odometry, 3D reconstruction and SLAM. ICRA 2014:
  the order of the steps; shifted pixels at edges, then noise of the disparity, then rounding.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Self

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Float32, Int, Int32
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.device import launch_lock, to_host
from gcd_dataset.generator.drape import load_kernels, resolve_device
from gcd_dataset.generator.render.cameras import Camera, look_at
from gcd_dataset.generator.render.figure import vertex_normals
from gcd_dataset.generator.render.kernels import truths
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.records import Record


@dataclass(frozen=True, eq=False)
class RangeImage(Record):
    """The surface that one camera sees; pixels of the background hold face -1 and depth 0."""

    scene: Scene
    vertex_normals: Float[np.ndarray, "n 3"]
    """Unit normals of the vertices of garment and body."""
    camera: Camera
    face: Int32[np.ndarray, "h w"]
    """Faces of the garment, then those of the body."""
    weights: Float32[np.ndarray, "h w 2"]
    """Barycentric weights of the first two corners."""
    depth: Float32[np.ndarray, "h w"]
    """Along the optical axis [cm]."""

    @property
    def size(self) -> int:
        return len(self.face)

    @property
    def covered(self) -> Bool[np.ndarray, "h w"]:
        """Pixels of any surface."""
        return self.face >= 0

    @property
    def garment(self) -> Bool[np.ndarray, "h w"]:
        """Pixels of cloth."""
        return (self.face >= 0) & (self.face < len(self.scene.faces))

    @property
    def panel(self) -> Int[np.ndarray, "h w"]:
        """Panel of each pixel; -1 where there is no cloth."""
        own = self.garment
        return np.where(own, self.scene.panel_id[np.where(own, self.face, 0)], -1)

    @cached_property
    def normals(self) -> Float32[np.ndarray, "h w 3"]:
        """Unit normals towards the camera, in world axes, interpolated over the faces; 0 on the background."""
        normals = np.zeros((*self.face.shape, 3), np.float32)
        seen = self.covered
        corner = self.vertex_normals[_faces(self.scene)[self.face[seen]]]
        first_two = self.weights[seen]
        weights = np.column_stack([first_two, 1.0 - first_two.sum(axis=1)])
        own = np.einsum("nk,nkc->nc", weights, corner)
        own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-12)
        facing = np.einsum("nc,nc->n", own, self.positions()[seen] - self.camera.eye)
        normals[seen] = np.where(facing[:, None] > 0, -own, own)
        return normals

    def positions(self, depth: Float[np.ndarray, "h w"] | None = None) -> Float[np.ndarray, "h w 3"]:
        """Points in the world [cm] at the depths of the pixels, or at other depths."""
        K = self.camera.intrinsics(self.size)
        z = self.depth.astype(float) if depth is None else depth
        column, row = np.meshgrid(np.arange(z.shape[1]), np.arange(z.shape[0]))
        seen = np.stack([(column - K[0, 2]) / K[0, 0] * z, (row - K[1, 2]) / K[1, 1] * z, z], axis=-1)
        return seen @ self.camera.rotation + self.camera.eye


class Ranger:
    """A scene on a device, for range images of it; a context manager, which frees the scene's memory there.

    Raises ``ConfigError`` for a garment with NaN positions.
    """

    def __init__(self, scene: Scene, *, device: str = "auto") -> None:
        self.scene, self.device = scene, resolve_device(device)
        load_kernels("scanner", truths, device=self.device)
        vertices, faces = np.concatenate([scene.vertices, scene.body.vertices]), _faces(scene)
        if not np.isfinite(vertices).all():
            raise ConfigError("a garment with NaN positions, of a diverged drape: select samples by their outcome")
        self._normals = vertex_normals(vertices, faces)
        with launch_lock:
            points = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device=self.device)
            corners = wp.array(faces.astype(np.int32).ravel(), dtype=int, device=self.device)
            self._mesh = wp.Mesh(points=points, indices=corners)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with launch_lock:  # freeing memory would break the capture of a graph in another thread
            del self._mesh

    def images(self, cameras: Sequence[Camera], size: int) -> list[RangeImage]:
        """A range image of ``size`` × ``size`` pixels for each camera."""
        if size < 1:
            raise ConfigError(f"a range image of {size} pixels: give a size of 1 or more")
        shape = (len(cameras), size, size)
        with launch_lock:
            face = wp.full(shape, -1, dtype=int, device=self.device)
            weights = wp.zeros(shape, dtype=wp.vec2, device=self.device)
            depth = wp.zeros(shape, dtype=float, device=self.device)
            inputs = [
                self._mesh.id,
                self._array([camera.eye for camera in cameras], wp.vec3),
                self._array([camera.rotation for camera in cameras], wp.mat33),
                self._array([camera.intrinsics(size) for camera in cameras], wp.mat33),
            ]
            wp.launch(truths.first_surface, shape, inputs=inputs, outputs=[face, weights, depth], device=self.device)
            arrays = zip(cameras, to_host(face), to_host(weights), to_host(depth), strict=True)
            return [RangeImage(self.scene, self._normals, *entry) for entry in arrays]

    def lit(self, lamp: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether light of a lamp [cm] reaches each point [cm]."""
        with launch_lock:
            lit = wp.zeros(len(points), dtype=wp.uint8, device=self.device)
            inputs = [self._mesh.id, wp.vec3(*map(float, lamp)), self._array(points, wp.vec3)]
            wp.launch(truths.lit_points, len(points), inputs=inputs, outputs=[lit], device=self.device)
            return to_host(lit) == 1

    def _array(self, values: object, dtype: type) -> wp.array:
        return wp.array(np.asarray(values, np.float32), dtype=dtype, device=self.device)


def _faces(scene: Scene) -> Int[np.ndarray, "m 3"]:
    return np.concatenate([scene.faces, scene.body.faces + len(scene.vertices)])


@dataclass(frozen=True)
class DepthNoise:
    """Errors of a depth camera; the default has none. Raises ``ConfigError`` for a negative value."""

    sigma: float = 0.0
    """Standard deviation of the depth at any distance [cm]."""
    disparity_step: float = 0.0
    """Change of 1 / depth between two values of the disparity [1/cm]; 0: the sensor measures no disparity."""
    disparity_sigma: float = 0.0
    """Standard deviation of the disparity, rounding included [steps]."""
    rounded: bool = False
    """Whether the disparity is rounded to whole steps: depths lie in layers."""
    lateral: float = 0.0
    """Standard deviation of the places of depth edges [pixels]."""
    flying: float = 0.0
    """Share of the pixels at depth edges that measure a depth between front and back: flying pixels."""
    grazing: float = 90.0
    """Largest angle between the line of sight and the normal at which a surface is measured [degrees]."""
    baseline: float = 0.0
    """Distance of the projector from the camera, to its right [cm]; places in its shadow are not measured."""
    holes: float = 0.0
    """Share of the surface that is lost in random patches."""
    hole_size: float = 6.0
    """Width of such patches [pixels]."""
    rotation: float = 0.0
    """Standard deviation of each camera's calibration but the first's: turn about each axis [degrees]."""
    shift: float = 0.0
    """Standard deviation of each camera's calibration but the first's: place along each axis [cm]."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise ConfigError(f"{field.name} of depth noise is {value}: give 0 or more")
        for name in ("flying", "holes"):
            if getattr(self, name) > 1:
                raise ConfigError(f"{name} of depth noise is {getattr(self, name)}: give a share from 0 to 1")

    def deviation(self, depth: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Standard deviation of the depth at a depth [cm]: Khoshelham and Elberink, and ``sigma``."""
        return np.hypot(self.sigma, self.disparity_step * self.disparity_sigma * depth**2)


NOISELESS = DepthNoise()

KINECT = DepthNoise(
    disparity_step=2.85e-5,  # 1/cm; Khoshelham and Elberink, calibrated m / (f b)
    disparity_sigma=0.5,  # steps; the same
    rounded=True,
    lateral=0.8,  # pixels; Nguyen et al., for a surface seen from its front
    flying=0.15,  # our estimate
    grazing=80.0,  # our estimate; noise grows without limit towards 90 degrees in Nguyen et al.
    baseline=7.5,  # cm; Khoshelham and Elberink
    holes=0.02,  # our estimate
    rotation=0.15,  # our estimate
    shift=0.3,  # our estimate
)
"""A first-generation Kinect: 0.9 cm at a distance of 2.5 m, rounded to steps of 1.8 cm."""

EDGE = 3.0  # cm; neighbours further apart in depth lie on two sides of a depth edge
TRAIL = 12.0  # cm; flying pixels hang up to this far behind the front


def measure(
    image: RangeImage,
    noise: DepthNoise,
    rng: np.random.Generator,
    *,
    lit: Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]] | None = None,
) -> tuple[Float[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """The depths that a camera with ``noise`` measures [cm], NaN for none, and the pixels of the image that they show.

    Pixels are rows of the flattened image; ``lit(lamp, points)`` tells what the projector reaches.
    Numbers are drawn for every pixel and in a fixed order, so a kind of noise leaves the others as they are.
    """
    shape = image.face.shape
    shifts = rng.standard_normal((2, *shape))
    trail, side, flies = rng.random(shape), rng.integers(4, size=shape), rng.random(shape)
    disparity, axial = rng.standard_normal((2, *shape))
    patches = rng.standard_normal(shape)
    kept = image.covered & _well_lit(image, noise, lit) & _steep_enough(image, noise)
    kept &= ~_holes(kept, noise, patches)
    true = np.where(image.covered, image.depth.astype(float), np.inf)
    source = _shifted(true, noise.lateral * shifts)
    depth = np.where(kept, true, np.nan).ravel()[source]
    depth = _flown(depth, true.ravel()[source], noise.flying, trail, side, flies)
    if noise.disparity_step:
        depth = _through_disparity(depth, noise, disparity)
    return depth + noise.sigma * axial, source


def _well_lit(
    image: RangeImage,
    noise: DepthNoise,
    lit: Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]] | None,
) -> Bool[np.ndarray, "h w"]:
    reached = np.ones(image.face.shape, bool)
    if noise.baseline and lit is not None:
        lamp = image.camera.eye + noise.baseline * image.camera.rotation[0]
        reached[image.covered] = lit(lamp, image.positions()[image.covered])
    return reached


def _steep_enough(image: RangeImage, noise: DepthNoise) -> Bool[np.ndarray, "h w"]:
    if noise.grazing >= 90.0:
        return np.ones(image.face.shape, bool)
    towards = image.camera.eye - image.positions()  # 0 on the background
    along = np.einsum("hwc,hwc->hw", image.normals, towards)
    return along >= math.cos(math.radians(noise.grazing)) * np.linalg.norm(towards, axis=2)


def _holes(
    kept: Bool[np.ndarray, "h w"], noise: DepthNoise, patches: Float[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Patches that cover a share of the pixels kept: the highest values of smoothed noise."""
    if not noise.holes or not kept.any():
        return np.zeros(kept.shape, bool)
    smooth = gaussian_filter(patches, 0.5 * noise.hole_size)
    return smooth > np.quantile(smooth[kept], 1.0 - noise.holes)


def _shifted(true: Float[np.ndarray, "h w"], shifts: Float[np.ndarray, "2 h w"]) -> Int[np.ndarray, "h w"]:
    """The pixel that each pixel measures: one nearby across a depth edge, else itself.

    Inside a surface a shift would add the slope to the depth's noise, which Nguyen et al. did not find.
    """
    height, width = true.shape
    row, column = np.indices(true.shape)
    row = np.clip(row + np.rint(shifts[0]).astype(int), 0, height - 1)
    column = np.clip(column + np.rint(shifts[1]).astype(int), 0, width - 1)
    return np.where(_apart(true[row, column], true), row * width + column, np.arange(true.size).reshape(true.shape))


def _apart(a: Float[np.ndarray, "h w"], b: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Whether two depths lie on two sides of an edge; infinity is the background."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(a) | np.isinf(b), np.isinf(a) != np.isinf(b), np.abs(a - b) > EDGE)


def _flown(
    depth: Float[np.ndarray, "h w"],
    true: Float[np.ndarray, "h w"],
    share: float,
    trail: Float[np.ndarray, "h w"],
    side: Int[np.ndarray, "h w"],
    flies: Float[np.ndarray, "h w"],
) -> Float[np.ndarray, "h w"]:
    """A share of the pixels in front of an edge moved back, up to the surface behind."""
    if not share:
        return depth
    padded = np.pad(true, 1, constant_values=np.inf)
    neighbours = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    behind = np.take_along_axis(neighbours, side[None], axis=0)[0]
    front = np.isfinite(true) & _apart(behind, true) & (behind > true)
    gap = np.where(front, np.minimum(behind, np.where(front, true, 0.0) + TRAIL) - np.where(front, true, 0.0), 0.0)
    return np.where(front & (flies < share), depth + trail * gap, depth)


def _through_disparity(
    depth: Float[np.ndarray, "h w"], noise: DepthNoise, draws: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Depth by way of a noisy, rounded disparity. Rounding has a variance of 1/12 of a step, which the noise lacks."""
    variance = noise.disparity_sigma**2 - (1.0 / 12.0 if noise.rounded else 0.0)
    disparity = 1.0 / (noise.disparity_step * depth) + math.sqrt(max(variance, 0.0)) * draws
    if noise.rounded:
        disparity = np.rint(disparity)
    return 1.0 / (noise.disparity_step * np.maximum(disparity, 1.0))


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


def _measured(
    ranger: Ranger, image: RangeImage, number: int, noise: DepthNoise, rng: np.random.Generator, *, body: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals, panels and the camera's number, of all pixels with a depth."""
    depth, source = measure(image, noise, rng, lit=ranger.lit)
    turn, shift = rng.standard_normal((2, 3))
    panel = image.panel.ravel()[source]
    kept = np.isfinite(depth) & ((panel >= 0) | body)
    points = image.positions(np.where(kept, depth, 0.0))[kept]
    if number:
        rotation = Rotation.from_rotvec(np.radians(noise.rotation) * turn).as_matrix()
        middle = image.scene.vertices.mean(axis=0)
        points = (points - middle) @ rotation.T + middle + noise.shift * shift
    normals = image.normals.reshape(-1, 3)[source[kept]]
    return points, normals, panel[kept], np.full(len(points), number)


def _choice(rng: np.random.Generator, available: int, wanted: int) -> Int[np.ndarray, " n"]:
    """``wanted`` rows at random: different ones if there are enough, else every row and some again."""
    if not available:
        return np.zeros(wanted, int)
    if available >= wanted:
        return rng.choice(available, wanted, replace=False)
    return rng.permutation(np.concatenate([np.arange(available), rng.choice(available, wanted - available)]))
