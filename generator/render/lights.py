"""Lights: key, fill, and the sky or room that surrounds the figure."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.render.cameras import Camera
from gcd_dataset.records import Record

RGB = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Lights(Record):
    """A key light that casts soft shadows, a fill light without shadows, and diffuse light from all around."""

    key_direction: Float[np.ndarray, "3"]
    """Unit vector towards the light, in world axes."""
    key: RGB = (2.2, 2.2, 2.2)
    """Linear; white cloth that faces a key of 1 alone has the brightness 1."""
    key_size: float = 0.12
    """Angular radius [rad]: the sun has 0.005, a soft box 0.2."""
    fill_direction: Float[np.ndarray, "3"] | None = None
    """Unit vector towards the fill light, in world axes; ``None``: no fill light."""
    fill: RGB = (0.3, 0.3, 0.3)
    """Linear."""
    sky: float = 1.0
    """Factor of the light that the environment gives."""
    exposure: float = 1.0
    """Factor of all light."""

    def arriving(self, around: RGB, normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Linear light on a surface with ``normal``, in light of the colour ``around`` from the surroundings."""
        cosine = max(0.0, float(self.key_direction @ normal))
        return cosine * np.array(self.key) + 0.5 * np.array(self.fill) + self.sky * np.array(around)


@dataclass(frozen=True)
class LightRanges:
    """Ranges of drawn lights; azimuths are relative to the camera for which lights are drawn."""

    azimuth: tuple[float, float] = (-75.0, 75.0)
    """Of the key light round the vertical [degrees]: 0 behind the camera, 90 to its right."""
    elevation: tuple[float, float] = (12.0, 65.0)
    """Of the key light [degrees]."""
    size: tuple[float, float] = (0.02, 0.30)
    """Angular radius of the key light [rad]."""
    kelvin: tuple[float, float] = (4200.0, 7500.0)
    """Colour temperature of the key light [K]."""
    cast: float = 0.10
    """Largest cast that the white balance leaves: of red and of blue over green, as a natural logarithm."""
    contrast: tuple[float, float] = (1.0, 5.0)
    """Key light over the light of the surroundings."""
    fill: tuple[float, float] = (0.0, 0.35)
    """Fill light over key light."""
    exposure: tuple[float, float] = (-0.35, 0.35)
    """[stops]"""


WHITE = 5500.0  # K; daylight film


def draw_lights(rng: np.random.Generator, camera: Camera | None = None, *, ranges: LightRanges | None = None) -> Lights:
    """Lights of a studio or a sunny place, placed with respect to ``camera``; without it, to the figure's front."""
    ranges = ranges or LightRanges()
    front = 0.0 if camera is None else math.atan2(-camera.rotation[2, 0], -camera.rotation[2, 2])
    azimuth, elevation = rng.uniform(*ranges.azimuth), rng.uniform(*ranges.elevation)
    size = math.exp(rng.uniform(*np.log(ranges.size)))
    colour = tint(rng.uniform(*ranges.kelvin))
    contrast = math.exp(rng.uniform(*np.log(ranges.contrast)))
    key = contrast / (1.0 + 0.7 * contrast)
    fill = key * rng.uniform(*ranges.fill)
    side = -math.copysign(rng.uniform(20.0, 80.0), azimuth)
    return Lights(
        key_direction=_direction(front + math.radians(azimuth), math.radians(elevation)),
        key=(key * colour[0], key * colour[1], key * colour[2]),
        key_size=size,
        fill_direction=_direction(front + math.radians(side), math.radians(rng.uniform(0.0, 30.0))),
        fill=(fill, fill, fill),
        sky=1.0 / (1.0 + 0.7 * contrast) + 0.12,
        exposure=2.0 ** rng.uniform(*ranges.exposure),
    )


def tint(kelvin: float) -> RGB:
    """Linear sRGB of a black body, with green 1, relative to ``WHITE``.

    Fit of the Planckian locus between 2,500 and 12,000 K: the logarithm of red over green and of blue over green is
    nearly linear in 1 / T (mireds); slopes from CIE 1931 chromaticities at 3,500, 5,500 and 8,000 K.
    """
    mired = 1e6 / kelvin - 1e6 / WHITE
    return math.exp(RED_PER_MIRED * mired), 1.0, math.exp(BLUE_PER_MIRED * mired)


def white_balance(
    light: Float[np.ndarray, "3"], *, left: float, cast: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Factors of red, green and blue with which a camera photographs ``light``, and the light that it records.

    ``left``: share of a slight cast that the camera leaves, 0 to 1. Whatever the light, no cast above ``cast`` is left:
    the logarithms of red and of blue over green end at ±``cast``.
    """
    was = np.log(light / light[1])
    now = cast * np.tanh(left * was / cast) if cast > 0.0 else np.zeros(3)
    gains = np.exp(now - was)
    gains = gains * (light.sum() / (gains * light).sum())  # the brightness stays
    return gains, gains * light


# ------------------------------------------------------------------------------------------------------------- helpers

RED_PER_MIRED, BLUE_PER_MIRED = 0.0036, -0.0075


def _direction(azimuth: float, elevation: float) -> Float[np.ndarray, "3"]:
    flat = math.cos(elevation)
    return np.array([flat * math.sin(azimuth), math.sin(elevation), flat * math.cos(azimuth)])
