"""Users' images on single panels, each laid over the box round its panel, its upper edge at the top of the grain."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageOps

from gcd_dataset.errors import ConfigError, shown
from gcd_dataset.generator.render.appearance import Appearance, Print, PrintKind
from gcd_dataset.generator.render.images import linear_light
from gcd_dataset.generator.render.scene import Scene

MOST_TEXELS = 1024  # along the longer side of a panel


def require_panels(textures: Iterable[str], panels: Iterable[str], garment: str) -> None:
    """Raise ``ConfigError`` for a texture of a panel that a garment lacks."""
    known = list(panels)
    if unknown := [name for name in textures if name not in known]:
        raise ConfigError(f"{garment} has no panel {shown(unknown[0])} for a texture: it has {', '.join(known)}")


def with_textures(
    look: Appearance, scene: Scene, textures: Mapping[str, Image.Image], *, garment: str = "the garment"
) -> Appearance:
    """The appearance with images on the panels of these names, as seen from the outside; weave and stitches stay.

    Raises ``ConfigError`` with the name of the ``garment`` for a panel that it lacks.
    """
    require_panels(textures, scene.panel_names, garment)
    cloths, rows = list(look.cloths), np.array(look.cloth_of_panel)
    for name, image in textures.items():
        panel = scene.panel_names.index(name)
        motif = _laid(image, scene.uv[scene.corners[scene.panel_id == panel]])
        cloths.append(replace(cloths[rows[panel]], print=motif))
        rows[panel] = len(cloths) - 1
    return replace(look, cloths=tuple(cloths), cloth_of_panel=rows)


def _laid(image: Image.Image, triangles: Float[np.ndarray, "f 3 2"]) -> Print:
    """A square tile as long as the panel, that shows the image over the box round its triangles [cm]."""
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    period = float((high - low).max())
    side = min(MOST_TEXELS, max(image.size))
    width, height = np.maximum(1, np.rint(side * (high - low) / period)).astype(int).tolist()
    (a, b), (c, d) = (triangles[:, k].T - triangles[:, 0].T for k in (1, 2))
    if float((a * d - b * c).sum()) < 0.0:  # drawn from the inside
        image = ImageOps.mirror(image)
    colours = linear_light(np.asarray(image.resize((width, height), Image.Resampling.LANCZOS), np.float32) / 255.0)
    tile = np.pad(colours, ((0, side - height), (0, side - width), (0, 0)), mode="edge")
    right, up = np.rint(side * np.array([low[0], high[1]]) / period).astype(int).tolist()
    mean = tuple((np.asarray(image.resize((1, 1), Image.Resampling.BOX))[0, 0] / 255.0).tolist())
    tile = np.roll(tile, (-up, right), axis=(0, 1)).astype(np.float32)
    return Print(PrintKind.IMAGE, (mean,) * 4, period, matched=True, image=tile)
