"""Drawn views: appearance, camera, light and place as a pure function of (seed, index, epoch)."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.render.appearance import RGB, Appearance
from gcd_dataset.generator.render.cameras import Camera, CameraRanges, draw_camera
from gcd_dataset.generator.render.environment import Environment, EnvironmentKind, EnvironmentRanges, draw_environment
from gcd_dataset.generator.render.lights import LightRanges, Lights, draw_lights, white_balance
from gcd_dataset.generator.render.materials import AppearanceRanges, draw_appearance
from gcd_dataset.generator.render.pictures import View
from gcd_dataset.generator.render.scene import HairStyle, Scene
from gcd_dataset.seeding import Stage, rng

VIEWS_PER_EPOCH = 1 << 16  # stream numbers of one epoch
HAIR_SHARES = (0.06, 0.24, 0.35, 0.35)  # of ``HairStyle``: none, cropped, short, full


@dataclass(frozen=True)
class Ranges:
    """All ranges that views are drawn from."""

    appearance: AppearanceRanges = field(default_factory=AppearanceRanges)
    camera: CameraRanges = field(default_factory=CameraRanges)
    lights: LightRanges = field(default_factory=LightRanges)
    environment: EnvironmentRanges = field(default_factory=EnvironmentRanges)


def draw_hair(seed: int, index: int, *, epoch: int = 0) -> HairStyle:
    """The shape of the hair for the scene of sample ``index``; views of one scene share it."""
    stream = rng(seed, index, Stage.VIEW, epoch * VIEWS_PER_EPOCH + VIEWS_PER_EPOCH - 1)
    return HairStyle(int(stream.choice(len(HairStyle), p=HAIR_SHARES)))


def draw_views(
    seed: int,
    index: int,
    scene: Scene,
    n: int,
    *,
    epoch: int = 0,
    row: int = 0,
    fabric: str | None = None,
    ranges: Ranges | None = None,
) -> list[View]:
    """``n`` views of sample ``index`` in one appearance; view k is the same for every ``n`` above k.

    ``row`` is the scene's row in the list to be rendered.
    """
    ranges = ranges or Ranges()
    appearance = draw_appearance(
        rng(seed, index, Stage.APPEARANCE, epoch), scene, fabric=fabric, ranges=ranges.appearance
    )
    streams = (rng(seed, index, Stage.VIEW, epoch * VIEWS_PER_EPOCH + k) for k in range(n))
    return [draw_view(stream, scene, appearance, row=row, ranges=ranges) for stream in streams]


def draw_view(
    rng: np.random.Generator, scene: Scene, appearance: Appearance, *, row: int = 0, ranges: Ranges | None = None
) -> View:
    """A view of a scene in a given appearance: camera, light and place are drawn.

    Lights have the colours that the camera records after its white balance, see ``LightRanges.cast``.
    """
    ranges = ranges or Ranges()
    camera = draw_camera(rng, scene, ranges=ranges.camera)
    lights = draw_lights(rng, camera, ranges=ranges.lights)
    environment = draw_environment(rng, ranges=ranges.environment)
    lights, environment = _balanced(lights, environment, camera, left=float(rng.random()), cast=ranges.lights.cast)
    return View(row, appearance, camera, lights, environment, seed=int(rng.integers(1 << 31)))


# ------------------------------------------------------------------------------------------------------------- helpers


def _balanced(
    lights: Lights, environment: Environment, camera: Camera, *, left: float, cast: float
) -> tuple[Lights, Environment]:
    """Lights and surroundings by the camera's white balance for cloth that faces it.

    A user's panorama keeps its colours, and counts as white.
    """
    is_panorama = environment.kind is EnvironmentKind.PANORAMA
    around = (1.0, 1.0, 1.0) if is_panorama else environment.light[1]
    gains, _ = white_balance(lights.arriving(around, -camera.rotation[2]), left=left, cast=cast)
    lights = replace(lights, key=_times(lights.key, gains), fill=_times(lights.fill, gains))
    above, sides, below = (_times(light, gains) for light in environment.light)
    return lights, environment if is_panorama else replace(environment, light=(above, sides, below))


def _times(colour: RGB, gains: Float[np.ndarray, "3"]) -> RGB:
    red, green, blue = (np.array(colour) * gains).tolist()
    return red, green, blue
