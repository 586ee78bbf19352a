"""Scenes and views as the flat arrays of the kernels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render.appearance import RGB, Appearance, ClothLook
from gcd_dataset.generator.render.environment import EnvironmentKind
from gcd_dataset.generator.render.images import linear_light
from gcd_dataset.generator.render.kernels import records
from gcd_dataset.generator.render.pictures import PlainView, View
from gcd_dataset.generator.render.scene import Scene

CLOTH: Any = np.dtype(records.ClothRow.numpy_dtype())  # type: ignore[attr-defined]
SHOT: Any = np.dtype(records.Shot.numpy_dtype())  # type: ignore[attr-defined]
# A swatch is the colour of skin as seen, highlights and all: as albedos, tones would be chalk and coal.
SKIN_GAIN, SKIN_GAMMA = np.array([0.75, 0.65, 0.57]), 0.76
# By eye, in sheets of all tones: real skin is neither chalk nor coal, and warm at both ends of the scale.
SKIN_FLOOR, SKIN_SPAN = 0.028, 0.80  # luminance of the albedo: floor, and factor of the tone's own
LEAST_RED, RED_OF_DARK, DARK = 1.32, 0.5, 0.06  # least red over green, and how much more dark skin has
MOST_BLUE = 0.70  # largest blue over green
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB, IEC 61966-2-1
SHEER = 1e-3  # translucency below this is none


@dataclass(frozen=True, eq=False)
class Materials:
    """All views of a rendering, with their materials."""

    shots: np.ndarray
    """Of dtype ``SHOT``."""
    cloths: np.ndarray
    """Of dtype ``CLOTH``."""
    cloth_of_panel: Int[np.ndarray, " n"]
    texels: Float[np.ndarray, "t 3"]
    glow: Float[np.ndarray, "n 9 3"]
    """Light from all around: factors of 1, x, y, z, xy, yz, zx, y² and x² - z² of the normal."""


class _Texels:
    """Pictures one after the other; a picture that is used twice is stored once."""

    def __init__(self) -> None:
        self._first: dict[int, int] = {}
        self._kept: list[np.ndarray] = [np.zeros((1, 3), np.float32)]
        self._count = 1

    def add(self, picture: Float[np.ndarray, "h w 3"] | None) -> tuple[int, int, int]:
        """Row of the first texel, width and height."""
        if picture is None:
            return 0, 1, 1
        height, width = picture.shape[:2]
        if id(picture) not in self._first:
            self._first[id(picture)] = self._count
            self._kept.append(np.asarray(picture, np.float32).reshape(-1, 3))
            self._count += height * width
        return self._first[id(picture)], width, height

    def rows(self) -> Float[np.ndarray, "t 3"]:
        return np.concatenate(self._kept)


def pack_views(views: Sequence[View], scenes: Sequence[Scene], rows: dict[int, int]) -> Materials:
    """The structs of all views; ``rows`` gives the place of each scene among those that are rendered together.

    Raises ``ConfigError`` for an appearance that does not suit its scene.
    """
    texels = _Texels()
    shots = np.zeros(len(views), SHOT)
    glow = np.zeros((len(views), 9, 3))
    cloths: dict[int, tuple[int, ClothLook]] = {}
    panels: list[np.ndarray] = []
    known: dict[int, int] = {}
    _pack_plain(shots, views)
    for view, shot, around in zip(views, shots, glow, strict=True):
        look, scene = view.appearance, scenes[view.scene]
        if id(look) not in known:
            known[id(look)] = sum(map(len, panels))
            at = [cloths.setdefault(id(cloth), (len(cloths), cloth))[0] for cloth in look.cloths]
            panels.append(np.array(at, int)[_cloth_rows(look, scene)])
        elif len(look.cloth_of_panel) != len(scene.panel_names):
            _cloth_rows(look, scene)
        if isinstance(view, PlainView):
            shot["plain"] = 1
        else:
            _pack_drawn(shot, view, texels)
            around[...] = _glow(view)
        shot["scene"], shot["first_panel"] = rows[view.scene], known[id(look)]
        shot["sheer"] = int(any(cloth.translucency > SHEER for cloth in look.cloths))
    packed = np.zeros(max(1, len(cloths)), CLOTH)
    for row, cloth in cloths.values():
        _pack_cloth(packed[row], cloth, texels)
    return Materials(shots, packed, np.concatenate([*panels, [0]]), texels.rows(), glow)


def skin_albedo(colour: RGB) -> Float[np.ndarray, "3"]:
    """Linear albedo of skin that looks like a swatch (sRGB) in pictures."""
    albedo = SKIN_GAIN * linear_light(np.array(colour)) ** SKIN_GAMMA
    luminance = float(LUMINANCE @ albedo)
    red = max(albedo[0] / albedo[1], LEAST_RED + RED_OF_DARK * float(np.exp(-luminance / DARK)))
    warm = np.array([red, 1.0, min(albedo[2] / albedo[1], MOST_BLUE)])
    return warm * ((SKIN_FLOOR + SKIN_SPAN * luminance) / float(LUMINANCE @ warm))


def _cloth_rows(look: Appearance, scene: Scene) -> Int[np.ndarray, " p"]:
    if len(look.cloth_of_panel) != len(scene.panel_names):
        raise ConfigError(
            f"an appearance of {len(look.cloth_of_panel)} panels for a garment of {len(scene.panel_names)}: "
            "draw it for the scene that it is rendered with"
        )
    if len(look.cloth_of_panel) and not 0 <= look.cloth_of_panel.min() <= look.cloth_of_panel.max() < len(look.cloths):
        raise ConfigError(f"cloth_of_panel names a cloth that is not there: there are {len(look.cloths)}")
    return np.asarray(look.cloth_of_panel)


def _pack_plain(shots: np.ndarray, views: Sequence[View]) -> None:
    """What all pictures and maps need: cameras, directions of the key lights, walls and underwear."""
    cameras, underwear = [view.camera for view in views], [view.appearance.underwear for view in views]
    shots["right"], shots["down"], shots["forward"] = np.stack([camera.rotation for camera in cameras], axis=1)
    for name in ("eye", "focal", "shift"):
        shots[name] = [getattr(camera, name) for camera in cameras]
    shots["key_direction"] = [view.lights.key_direction for view in views]
    shots["wall"] = linear_light(np.array([view.environment.colours[0] for view in views]))
    shots["underwear"] = linear_light(np.array([worn.colour if worn else (0.0, 0.0, 0.0) for worn in underwear]))
    shots["top"] = [worn is not None and worn.top for worn in underwear]


def _pack_drawn(shot: np.void, view: View, texels: _Texels) -> None:
    """The rest of lights, place and figure."""
    look, lights, place = view.appearance, view.lights, view.environment
    shot["seed"], shot["key"], shot["key_size"] = view.seed, lights.key, lights.key_size
    fill = lights.fill_direction
    shot["fill_direction"] = lights.key_direction if fill is None else fill
    shot["fill"] = np.zeros(3) if fill is None else lights.fill
    shot["exposure"] = lights.exposure
    shot["place"], shot["place_size"], shot["place_seed"] = int(place.kind), place.size, place.seed
    shot["floor"], shot["accent"] = linear_light(np.array(place.colours[1:]))
    shot["turn"] = np.cos(place.turn), np.sin(place.turn)
    shot["texels"], shot["width"], shot["height"] = texels.add(place.image)
    shot["skin"], shot["gloss"] = skin_albedo(look.skin.colour), look.skin.gloss
    shot["hair"], shot["eyes"] = linear_light(np.array([look.hair.colour, look.eyes]))
    shot["bare"] = int(look.underwear is None)


def _pack_cloth(row: np.void, cloth: ClothLook, texels: _Texels) -> None:
    motif, weave, stitching = cloth.print, cloth.weave, cloth.stitching
    row["print_kind"] = int(motif.kind)
    row["ground"], row["first"], row["second"], row["third"] = linear_light(np.array(motif.colours))
    row["across"] = np.cos(motif.angle), np.sin(motif.angle)
    row["texels"], row["width"], row["height"] = texels.add(motif.image)
    for name in ("period", "fill", "jitter", "matched", "seed"):
        row[name] = getattr(motif, name)
    row["weave_kind"] = int(weave.kind)
    for name in ("pitch", "depth", "roughness", "specular", "sheen", "mottle", "wrinkles"):
        row[name] = getattr(weave, name)
    row["stitch_colour"] = linear_light(np.array(stitching.colour))
    row["stitch_length"], row["stitch_seam"], row["stitch_hem"] = stitching.length, stitching.seam, stitching.hem
    for name in ("wrong_side", "translucency", "transmission", "thickness"):
        row[name] = getattr(cloth, name)


def _glow(view: View) -> Float[np.ndarray, "9 3"]:
    place = view.environment
    if place.kind is EnvironmentKind.PANORAMA and place.image is not None:
        return view.lights.sky * panorama_glow(place.image, place.turn)
    above, around, below = np.array(place.light)
    glow = np.zeros((9, 3))
    glow[0], glow[2], glow[7] = around, 0.5 * (above - below), 0.5 * (above + below) - around
    return view.lights.sky * glow


def panorama_glow(image: Float[np.ndarray, "h w 3"], turn: float) -> Float[np.ndarray, "9 3"]:
    """The least-squares quadratic through the light that a panorama sends on to surfaces of 256 directions."""
    small = _shrunk(np.asarray(image, float), 16, 32)
    height, width = small.shape[:2]
    polar = (np.arange(height) + 0.5) / height * np.pi
    azimuth = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi - turn
    sine = np.sin(polar)[:, None]
    towards = np.stack(
        [sine * np.sin(azimuth), np.cos(polar)[:, None] + 0 * azimuth, -sine * np.cos(azimuth)], axis=-1
    ).reshape(-1, 3)
    area = np.repeat(np.sin(polar), width)
    normals = _sphere(256)
    weights = np.maximum(normals @ towards.T, 0.0) * area
    arriving = weights @ small.reshape(-1, 3) / weights.sum(axis=1, keepdims=True)
    x, y, z = normals.T
    factors = np.stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, y * y, x * x - z * z], axis=1)
    return np.linalg.lstsq(factors, arriving, rcond=None)[0]


def _sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Directions spread evenly: a spiral."""
    y = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    angle = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - y * y)
    return np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1)


def _shrunk(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """The mean colours of a grid of ``height`` × ``width`` fields; a smaller picture as it is."""
    if image.shape[0] < height or image.shape[1] < width:
        return image
    rows = np.linspace(0, image.shape[0], height + 1).astype(int)[:-1]
    columns = np.linspace(0, image.shape[1], width + 1).astype(int)[:-1]
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1)
    high = np.diff(np.append(rows, image.shape[0]))[:, None, None]
    wide = np.diff(np.append(columns, image.shape[1]))[None, :, None]
    return sums / (high * wide)
