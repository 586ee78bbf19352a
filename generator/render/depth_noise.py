"""Noise of depth cameras: what a sensor measures of a range image.

Sources, by the names used below:

- Khoshelham and Elberink: Accuracy and resolution of Kinect depth data for indoor mapping applications. Sensors 12(2),
  2012: depth noise and resolution grow with the square of the distance, since the sensor measures disparity in steps.
- Nguyen, Izadi and Lovell: Modeling Kinect sensor noise for improved 3D reconstruction and tracking. 3DIMPVT 2012:
  noise across the line of sight in pixels, and its growth at grazing angles.
- Handa, Whelan, McDonald and Davison: A benchmark for RGB-D visual odometry, 3D reconstruction and SLAM. ICRA 2014:
  the order of the steps; shifted pixels at edges, then noise of the disparity, then rounding.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render.range_images import RangeImage
from gcd_dataset.records import Record


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


@dataclass(frozen=True, eq=False)
class Measured(Record):
    """What a sensor measures of a range image, and where it got it from."""

    depth: Float[np.ndarray, "h w"]
    """[cm]; NaN where nothing is measured."""
    source: Int[np.ndarray, "h w"]
    """Pixel, as a row of the flattened image, whose surface is measured."""


def measure(
    image: RangeImage,
    noise: DepthNoise,
    rng: np.random.Generator,
    *,
    lit: Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]] | None = None,
) -> Measured:
    """The depths that a camera with ``noise`` measures; ``lit(lamp, points)`` tells what the projector reaches.

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
    return Measured(depth + noise.sigma * axial, source)


# ------------------------------------------------------------------------------------------------------------- helpers


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
