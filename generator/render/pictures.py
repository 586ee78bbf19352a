"""What the renderer takes and returns besides scenes: views, and pictures with their truths.

Conventions are OpenCV's: camera axes x right, y down, z forward; a point X [cm] of the world is at x = K (R X + t); the
centre of the upper left pixel is (0, 0), so that a picture of size n covers -0.5 … n - 0.5.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from gcd_dataset.generator.render.appearance import RGB, Appearance
from gcd_dataset.generator.render.cameras import Camera, CameraRanges, draw_camera
from gcd_dataset.generator.render.environment import (
    Environment,
    EnvironmentKind,
    EnvironmentRanges,
    LightRanges,
    Lights,
    draw_environment,
    draw_lights,
    white_balance,
)
from gcd_dataset.generator.render.materials import AppearanceRanges, draw_appearance
from gcd_dataset.generator.render.scene import HairStyle, Scene
from gcd_dataset.records import Record
from gcd_dataset.seeding import Stage, rng

SceneMap = Literal["depth", "normals", "part", "panel_id", "seam", "uv", "silhouette", "lit"]
VertexMap = Literal["stretch", "gap", "pressure"]
MapName = Literal[SceneMap, VertexMap]
MAPS: tuple[MapName, ...] = get_args(SceneMap)
"""The maps that ``render`` can return for any scene; each describes the surface at the centre of a pixel."""
VERTEX_MAPS: tuple[MapName, ...] = get_args(VertexMap)
"""The maps of ``Scene.values``, interpolated from the corners of the face at the centre of a pixel."""
BACKGROUND = 255
"""Value of ``part`` where there is neither body nor garment."""
GARMENT = 32
"""Value of ``part`` on the garment; on the body, ``part`` is the ``BodyPart``."""
HAIR = 33
"""Value of ``part`` on the hair."""


@dataclass(frozen=True, eq=False)
class View(Record):
    """One picture to take: a scene, and everything besides its geometry."""

    scene: int
    """Row of the scene in the list that is rendered with the view."""
    appearance: Appearance
    camera: Camera
    lights: Lights
    environment: Environment
    seed: int = 0
    """Key of the noise of shadows and pixel samples; the picture is a function of scene, view and size alone."""


@dataclass(frozen=True, eq=False)
class PlainView(View):
    """A view in flat colours under lights at the camera: of its look count the grounds and the colour of underwear."""


@dataclass(frozen=True, eq=False)
class Picture(Record):
    """A picture and its truths.

    Pixels of the background hold 0 depth, 0 normal, -1 panel and seam, NaN uv, stretch, gap and pressure.
    """

    rgb: UInt8[np.ndarray, "h w 3"]
    """sRGB."""
    intrinsics: Float[np.ndarray, "3 3"]
    """K [pixels]."""
    extrinsics: Float[np.ndarray, "3 4"]
    """[R | t], world to camera [1, cm]."""
    maps: Mapping[str, Shaped[np.ndarray, "h w *channels"]] = field(default_factory=dict)
    """By the names in ``MAPS`` and ``VERTEX_MAPS``:

    ``depth`` float32, along the optical axis [cm]; ``normals`` float32 (h, w, 3), in camera axes, towards the camera;
    ``part`` uint8, ``BodyPart`` value, ``GARMENT``, ``HAIR`` or ``BACKGROUND``; ``panel_id`` int16; ``seam`` int16, row
    of the pattern's seams on pixels that a seam line covers, -2 on hems; ``uv`` float32 (h, w, 2), panel plane [cm];
    ``silhouette`` uint8, 255 where the pixel's centre is covered by garment, hair or body; ``lit`` uint8, 255 where
    that point sees the middle of the key light, whatever the cloth between them; ``stretch`` float32 (h, w, 2), ``gap``
    [cm] and ``pressure`` [kPa] float32: ``records.Maps``.
    """
    panel_corners: Int[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2), int))
    """(panel, corner) of each row of ``corner_pixels``."""
    corner_pixels: Float[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    """Column and row of the panel corners; NaN behind the camera."""
    corner_visible: Bool[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0, bool))
    """Whether a corner lies in the picture and nothing hides it."""
    landmark_names: tuple[str, ...] = ()
    landmark_pixels: Float[np.ndarray, "l 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    """Column and row of the body's landmarks; NaN behind the camera."""
    landmark_visible: Bool[np.ndarray, " l"] = field(default_factory=lambda: np.zeros(0, bool))
    """Whether a landmark lies in the picture and nothing hides it, cloth included."""
    keypoints: Float[np.ndarray, "17 3"] = field(default_factory=lambda: np.zeros((17, 3)))
    """Column, row and visibility of ``COCO_KEYPOINTS``, as COCO has them: 0 outside the picture, at column and row 0;
    1 hidden; 2 visible, also under ``REACH`` of flesh and cloth. Zeros for a body with another mesh than the model's.
    """


REACH = np.array([*5 * [1.0], 11.0, 11.0, 8.0, 8.0, 6.0, 6.0, 15.0, 15.0, 11.0, 11.0, 8.0, 8.0])
"""How far in front of each of ``COCO_KEYPOINTS`` a surface may lie and not hide it [cm]: joints lie in the flesh."""
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
    fabric: str | Sequence[str | None] | None = None,
    ranges: Ranges | None = None,
) -> list[View]:
    """``n`` views of sample ``index`` in one appearance; view k is the same for every ``n`` above k.

    ``row`` is the scene's row in the list to be rendered; ``fabric`` as for ``draw_appearance``.
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
