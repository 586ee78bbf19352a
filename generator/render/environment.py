"""Places: what lies behind and around the figure, and the light that it gives."""

import colorsys
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from jaxtyping import Float

from gcd_dataset.records import Record

RGB = tuple[float, float, float]
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


# ------------------------------------------------------------------------------------------------------------- helpers


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
