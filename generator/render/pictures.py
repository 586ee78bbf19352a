"""What the renderer takes and returns besides scenes: views, and pictures with their truths.

Conventions are OpenCV's: camera axes x right, y down, z forward; a point X [cm] of the world is at x = K (R X + t); the
centre of the upper left pixel is (0, 0), so that a picture of size n covers -0.5 … n - 0.5.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from gcd_dataset.generator.render.appearance import Appearance
from gcd_dataset.generator.render.cameras import Camera
from gcd_dataset.generator.render.environment import Environment
from gcd_dataset.generator.render.lights import Lights
from gcd_dataset.records import Record

MapName = Literal["depth", "normals", "part", "panel_id", "seam", "uv", "silhouette", "lit"]
MAPS: tuple[MapName, ...] = get_args(MapName)
"""The maps that ``render`` can return; each describes the surface at the centre of a pixel."""
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
    """A picture and its truths. Pixels of the background hold 0 depth, 0 normal, -1 panel and seam, NaN uv."""

    rgb: UInt8[np.ndarray, "h w 3"]
    """sRGB."""
    intrinsics: Float[np.ndarray, "3 3"]
    """K [pixels]."""
    extrinsics: Float[np.ndarray, "3 4"]
    """[R | t], world to camera [1, cm]."""
    maps: Mapping[str, Shaped[np.ndarray, "h w *channels"]] = field(default_factory=dict)
    """By the names in ``MAPS``:

    ``depth`` float32, along the optical axis [cm]; ``normals`` float32 (h, w, 3), in camera axes, towards the camera;
    ``part`` uint8, ``BodyPart`` value, ``GARMENT``, ``HAIR`` or ``BACKGROUND``; ``panel_id`` int16; ``seam`` int16, row
    of the pattern's seams on pixels that a seam line covers, -2 on hems; ``uv`` float32 (h, w, 2), panel plane [cm];
    ``silhouette`` uint8, 255 where the pixel's centre is covered by garment, hair or body; ``lit`` uint8, 255 where
    that point sees the middle of the key light, whatever the cloth between them.
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
