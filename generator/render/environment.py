"""Places behind and around the figure, and its lights: key, fill, and the sky or room that surrounds it."""

import colorsys
import math
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.render.appearance import RGB
from gcd_dataset.generator.render.cameras import Camera
from gcd_dataset.records import Record

Photograph = Float[np.ndarray, "h w 3"]


class EnvironmentKind(IntEnum):
    """What fills the pixels beside the figure."""

    PLAIN = 0
    """A gradient across the picture; nothing to stand on."""
    SWEEP = 1
    """A studio's paper sweep: floor and wall in one curve, with the figure's shadow."""
    ROOM = 2
    """A room with a tiled floor, and walls with windows and pictures."""
    NOISE = 3
    """Blurred blobs of colour, as a place out of focus."""
    PHOTOGRAPH = 4
    """A user's photograph behind the figure."""
    PANORAMA = 5
    """A user's equirectangular picture all around, which also lights the figure."""


@dataclass(frozen=True, eq=False)
class Environment(Record):
    """A place: background and light from all around."""

    kind: EnvironmentKind = EnvironmentKind.SWEEP
    colours: tuple[RGB, RGB, RGB] = ((0.86, 0.86, 0.86), (0.80, 0.80, 0.80), (0.7, 0.7, 0.7))
    """sRGB, 0 to 1. Gradient: top and bottom. Sweep: wall, floor. Room: walls, floor, pictures. Noise: all three."""
    light: tuple[RGB, RGB, RGB] = ((1.0, 1.0, 1.0), (0.9, 0.9, 0.9), (0.55, 0.55, 0.55))
    """Linear light from above, from the sides and from below; a panorama's own light replaces it."""
    size: float = 320.0
    """Radius of the sweep's floor, half width of the room, or size of the blobs [cm]."""
    turn: float = 0.0
    """Rotation about the vertical [rad]."""
    image: Photograph | None = field(default=None)
    """Linear colours of a photograph or panorama, row by row from the top."""
    seed: int = 0
    """Key of tiles, windows and blobs."""


@dataclass(frozen=True)
class EnvironmentRanges:
    """Shares of the kinds of places, and the users' pictures among them."""

    weights: tuple[float, float, float, float] = (0.25, 0.4, 0.25, 0.1)
    """Of gradient, sweep, room and noise."""
    photographs: tuple[Photograph, ...] = ()
    """Linear colours."""
    panoramas: tuple[Photograph, ...] = ()
    """Linear colours."""
    images: float = 0.5
    """Share of pictures in front of a photograph or panorama, if there are any."""


def draw_environment(rng: np.random.Generator, *, ranges: EnvironmentRanges | None = None) -> Environment:
    """A place drawn by the weights of its kinds, or one of the users' pictures."""
    ranges = ranges or EnvironmentRanges()
    pictures = [(EnvironmentKind.PHOTOGRAPH, image) for image in ranges.photographs]
    pictures += [(EnvironmentKind.PANORAMA, image) for image in ranges.panoramas]
    # All numbers are drawn in any case, so that the other choices do not depend on the users' pictures.
    kind = EnvironmentKind(int(rng.choice(4, p=np.array(ranges.weights) / sum(ranges.weights))))
    of_user, which = rng.random() < ranges.images, int(rng.integers(1 << 30))
    seed, turn = int(rng.integers(1 << 20)), float(rng.uniform(0.0, 2 * np.pi))
    own = PLACES[kind](rng)
    if pictures and of_user:
        kind, image = pictures[which % len(pictures)]
        return replace(own, kind=kind, image=image, turn=turn, seed=seed)
    return replace(own, turn=turn, seed=seed)


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


RED_PER_MIRED, BLUE_PER_MIRED = 0.0036, -0.0075


def _direction(azimuth: float, elevation: float) -> Float[np.ndarray, "3"]:
    flat = math.cos(elevation)
    return np.array([flat * math.sin(azimuth), math.sin(elevation), flat * math.cos(azimuth)])


def _colour(rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]) -> RGB:
    """A colour of any hue; saturation is drawn low more often than high."""
    low, high = saturation
    return colorsys.hsv_to_rgb(rng.random(), low + (high - low) * rng.random() ** 2, rng.uniform(*value))


def _shifted(rng: np.random.Generator, colour: RGB, amount: float) -> RGB:
    factor = 1.0 + rng.uniform(-amount, amount)
    red, green, blue = (min(1.0, max(0.0, channel * factor)) for channel in colour)
    return red, green, blue


def _gradient(rng: np.random.Generator) -> Environment:
    bottom = _colour(rng, (0.0, 0.4), (0.35, 0.97))
    top = _shifted(rng, bottom, 0.3)
    return Environment(EnvironmentKind.PLAIN, (top, bottom, bottom), _light(top, bottom))


def _sweep(rng: np.random.Generator) -> Environment:
    wall = _colour(rng, (0.0, 0.35), (0.5, 0.97))
    floor = _shifted(rng, wall, 0.06)
    size = float(rng.uniform(180.0, 420.0))
    return Environment(EnvironmentKind.SWEEP, (wall, floor, floor), _light(wall, floor), size=size)


def _room(rng: np.random.Generator) -> Environment:
    wall = _colour(rng, (0.0, 0.25), (0.55, 0.95))
    wood = colorsys.hsv_to_rgb(rng.uniform(0.04, 0.11), rng.uniform(0.15, 0.6), rng.uniform(0.3, 0.8))
    accent = _colour(rng, (0.05, 0.4), (0.25, 0.8))
    size = float(rng.uniform(230.0, 420.0))
    return Environment(EnvironmentKind.ROOM, (wall, wood, accent), _light(wall, wood), size=size)


def _blurred(rng: np.random.Generator) -> Environment:
    first, second, third = (_colour(rng, (0.05, 0.6), (0.15, 0.85)) for _ in range(3))
    return Environment(EnvironmentKind.NOISE, (first, second, third), _light(first, second))


PLACES = {
    EnvironmentKind.PLAIN: _gradient,
    EnvironmentKind.SWEEP: _sweep,
    EnvironmentKind.ROOM: _room,
    EnvironmentKind.NOISE: _blurred,
}


def _light(wall: RGB, floor: RGB) -> tuple[RGB, RGB, RGB]:
    """Light from white lamps above, and from walls and floor, which lend it some of their colour."""

    def tinted(colour: RGB, strength: float, share: float) -> RGB:
        red, green, blue = (strength * (1.0 - share + share * channel**2.2) for channel in colour)
        return red, green, blue

    return (1.0, 1.0, 1.0), tinted(wall, 0.9, 0.4), tinted(floor, 0.7, 0.7)
