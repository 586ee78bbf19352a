"""Garments in the colours of stretch, gap and pressure, with scales and a legend; control pictures beside them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drawing import captioned, contact_sheet, png_bytes, sample_sheet
from gcd_dataset.generator.render.appearance import Print
from gcd_dataset.outfits import apart
from gcd_dataset.records import Outcome, Sample
from gcd_dataset.viewer.content import body_of

if TYPE_CHECKING:
    from gcd_dataset.generator.render import Scene

LEVELS = 1025  # colours of a scale
SHARPNESS = 2  # rays along each side of a pixel
SHEET = 512  # pixels of a picture on a sheet
BAR = 12  # height of the legend's bars [pixels]
WHITE = Print(colours=((1.0, 1.0, 1.0),) * 4)
MIDDLE = (237, 235, 227)
BLUE, RED, TEAL, VIOLET = (43, 107, 184), (214, 38, 41), (8, 112, 104), (110, 30, 140)


@dataclass(frozen=True, eq=False)
class Scale:
    """The colours of a value of the cloth, the same for all garments; values beyond an end have its colour."""

    title: str
    low: float
    high: float
    marks: tuple[str, ...]
    """Values at evenly spaced places of the scale, in words."""
    colours: UInt8[np.ndarray, "n 3"]

    def colours_of(self, values: Float[np.ndarray, " v"]) -> UInt8[np.ndarray, "v 3"]:
        """The colour of each value."""
        share = np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)
        return self.colours[np.round(share * (LEVELS - 1)).astype(int)]


def _colours(high: Sequence[int], low: Sequence[int] | None = None) -> UInt8[np.ndarray, "n 3"]:
    """From ``low``, if given, over ``MIDDLE`` to ``high``, by the square root: small values show."""
    along = np.linspace(-1.0 if low else 0.0, 1.0, LEVELS)[:, None]
    ends = np.where(along < 0.0, low or high, high)
    return np.round(MIDDLE + np.sqrt(np.abs(along)) * (ends - MIDDLE)).astype(np.uint8)


# 98 % of the vertices of garments cut one to three sizes too small lie within.
SCALES: Mapping[str, Scale] = {
    "stretch": Scale("stretch of the cloth", 0.8, 1.2, ("-20 %", "as cut", "+20 %"), _colours(RED, BLUE)),
    "gap": Scale("gap to the skin", 0.0, 20.0, ("0", "20 cm"), _colours(TEAL)),
    "pressure": Scale("pressure on the skin", 0.0, 1.0, ("0", "1 kPa"), _colours(VIOLET)),
}
"""The scales of ``Content.values``."""


def require_maps(has_maps: bool, source: str) -> None:
    """Raise ``ConfigError`` for a source without maps."""
    if not has_maps:
        raise ConfigError(f"{source} holds no maps of stretch, gap and pressure: gcd generate --maps stores them")


def map_pictures(sample: Sample, *, size: int, sides: Sequence[str] = ("front",)) -> list[UInt8[np.ndarray, "h w 3"]]:
    """For each side, square pictures of a draped sample, the first garment of an outfit, in the colours of ``SCALES``.

    Raises ``ConfigError`` for a sample without maps, on a body of another model, or whose drape diverged or was not
    made.
    """
    from gcd_dataset.generator.render import render
    from gcd_dataset.generator.render.pictures import VERTEX_MAPS
    from gcd_dataset.generator.render.plain import plain_view

    require_maps(sample.maps is not None, sample.key)
    scene = _scene(apart(sample)[0])
    views = [plain_view(scene, side) for side in sides]
    white = tuple(replace(cloth, print=WHITE) for cloth in views[0].appearance.cloths)
    views = [replace(view, appearance=replace(view.appearance, cloths=white)) for view in views]
    found = []
    for picture in render([scene], views, size=SHARPNESS * size, maps=VERTEX_MAPS):
        for name, scale in SCALES.items():
            values = picture.maps[name].reshape(*picture.rgb.shape[:2], -1)[..., 0]
            tinted, on_cloth = picture.rgb.astype(float), np.isfinite(values)
            tinted[on_cloth] *= scale.colours_of(values[on_cloth]) / 255.0
            found.append(tinted.reshape(size, SHARPNESS, size, SHARPNESS, 3).mean(axis=(1, 3)).astype(np.uint8))
    return found


def maps_sheet(sample: Sample) -> UInt8[np.ndarray, "h w 3"]:
    """Control pictures of front and back; of a sample with maps, both in each of ``SCALES`` too, above the legend.

    Raises ``ConfigError`` for a sample without a drape, on a body of another model, or whose drape diverged or was not
    made.
    """
    pictures = control_pictures(sample, size=SHEET)
    if sample.maps is None:
        return contact_sheet(pictures, columns=len(SCALES))
    pictures += map_pictures(sample, size=SHEET, sides=("front", "back"))
    return with_legend(contact_sheet(pictures, columns=len(SCALES)))


def control_pictures(sample: Sample, *, size: int) -> list[UInt8[np.ndarray, "h w 3"]]:
    """For front and back each, the plain picture, its control pictures and its key points; errors as ``maps_sheet``."""
    from gcd_dataset.generator.render import control_picture, pose_picture, render
    from gcd_dataset.generator.render.control import CONTROL_MAPS
    from gcd_dataset.generator.render.plain import plain_view

    scene = _scene(sample)
    views = [plain_view(scene, side) for side in ("front", "back")]
    maps = [name for names in CONTROL_MAPS.values() for name in names]
    found = []
    for picture in render([scene], views, size=size, maps=maps):
        controls = [control_picture(picture.maps, kind) for kind in CONTROL_MAPS]
        found += [picture.rgb, *controls, pose_picture(picture.keypoints, size)]
    return found


def textured_sheet(sample: Sample, *, textures: Mapping[str, Path | str]) -> UInt8[np.ndarray, "h w 3"]:
    """``sample_sheet`` with front and back in the cloth of image files, by panel: see ``render.with_textures``.

    Raises ``ConfigError`` as ``maps_sheet`` does, for a panel that the garment lacks, and for an unreadable image.
    """
    from gcd_dataset.generator.render import View, fixed_camera, render, with_textures
    from gcd_dataset.generator.render.environment import Lights
    from gcd_dataset.generator.render.images import read_image
    from gcd_dataset.generator.render.plain import PAGE, plain_view

    scene = _scene(sample)
    images = {name: read_image(file) for name, file in textures.items()}
    look = with_textures(plain_view(scene).appearance, scene, images, garment=sample.key)
    cameras = [fixed_camera(scene, side) for side in ("front", "back")]
    views = [View(0, look, camera, Lights(-camera.rotation[2], exposure=0.5), PAGE) for camera in cameras]
    front, back = (png_bytes(picture.rgb) for picture in render([scene], views, size=SHEET))
    return sample_sheet(replace(sample, front=front, back=back), size=SHEET)


def _scene(sample: Sample) -> "Scene":
    from gcd_dataset.generator.render import scene_of_sample

    drape, maps = sample.drape, sample.maps
    is_unknown = maps is not None and not maps.is_known
    if drape is not None and (is_unknown or drape.outcome is Outcome.CANNOT_BE_PUT_ON):
        raise ConfigError(f"{sample.key} has no maps: {drape.outcome.value}")
    if (body := body_of(sample)) is None:
        raise ConfigError(f"{sample.key} is on a body of another model: show it with --html")
    return scene_of_sample(sample, body)


def with_legend(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h+c w 3"]:
    """The picture above the scales, side by side, each with its title and range over a bar."""
    width = picture.shape[1]
    place = np.linspace(0, LEVELS - 1, width // len(SCALES)).round().astype(int)
    bars = [
        captioned(np.tile(scale.colours[place], (BAR, 1, 1)), f"{scale.title}: {scale.marks[0]} to {scale.marks[-1]}")
        for scale in SCALES.values()
    ]
    strip = np.concatenate(bars, axis=1)
    return np.concatenate([picture, np.pad(strip, ((0, 0), (0, width - strip.shape[1]), (0, 0)), mode="edge")])
