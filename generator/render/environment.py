"""Places: what lies behind and around the figure, and the light that it gives."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from jaxtyping import Float

from gcd_dataset.records import Record

__all__ = ["Environment", "EnvironmentKind", "EnvironmentRanges", "draw_environment"]

RGB = tuple[float, float, float]
Photograph = Float[np.ndarray, "h w 3"]


class EnvironmentKind(IntEnum):
    """What fills the pixels beside the figure."""

    PLAIN = 0
    """A gradient across the picture; nothing to stand on."""
    SWEEP = 1
    """A studio's paper sweep: floor and wall in one curve, with the figure's shadow."""
    ROOM = 2
    """A room with floor boards or tiles, walls, a window and simple furniture."""
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
    """sRGB, 0 to 1. Gradient: top and bottom. Sweep: wall, floor. Room: walls, floor, furniture. Noise: all three."""
    light: tuple[RGB, RGB, RGB] = ((1.0, 1.0, 1.0), (0.9, 0.9, 0.9), (0.55, 0.55, 0.55))
    """Linear light from above, from the sides and from below; a panorama's own light replaces it."""
    size: float = 320.0
    """Radius of the sweep's floor, half width of the room, or size of the blobs [cm]."""
    turn: float = 0.0
    """Rotation about the vertical [rad]."""
    image: Photograph | None = field(default=None)
    """Linear colours of a photograph or panorama, row by row from the top."""
    seed: int = 0
    """Key of boards, furniture and blobs."""


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
    """A place drawn by the weights of its kinds."""
    raise NotImplementedError
