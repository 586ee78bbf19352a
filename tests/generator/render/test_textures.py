"""Users' images: read as linear light, whatever their file, and laid on panels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import read_picture, render, with_textures
from tests.generator.render.scenes import ahead, hung_patch, patch_scene, view_of

CORNERS = np.array([[[230, 20, 20], [20, 200, 20]], [[20, 20, 230], [230, 230, 230]]], np.uint8)
"""Red at the upper left, green, blue, white."""


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize("origin", [(0.0, 0.0), (-13.0, 37.0)])
def test_an_image_covers_its_panel_upright_and_unmirrored(turned: float, origin: tuple[float, float]) -> None:
    """Wherever the origin of the panel lies; ``turned`` -1: of a panel drawn from the inside too."""
    scene = patch_scene(hung_patch(10, 5))  # 20 cm × 10 cm
    scene = replace(scene, uv=scene.uv * [turned, 1.0] + origin)
    image = Image.fromarray(np.kron(CORNERS, np.ones((32, 32, 1), np.uint8)))
    view = view_of(scene, camera=ahead(100.0, focal=4.0))
    view = replace(view, appearance=with_textures(view.appearance, scene, {"patch": image}))
    [picture] = render([scene], [view], size=64, maps=("panel_id",))
    for row, y in enumerate((26, 37)):
        for column, x in enumerate((15, 48)):
            assert picture.maps["panel_id"][y, x] == 0
            expected = CORNERS[row, column].astype(float)
            found = picture.rgb[y, x].astype(float)
            assert np.corrcoef(found, expected)[0, 1] > 0.9 if np.ptp(expected) else np.ptp(found) < 8


def test_a_panel_that_is_not_there_is_named() -> None:
    scene = patch_scene()
    with pytest.raises(ConfigError, match="gcd_7 has no panel skirt for a texture: it has patch"):
        with_textures(view_of(scene).appearance, scene, {"skirt": Image.new("RGB", (2, 2))}, garment="gcd_7")


def test_srgb_is_made_linear(tmp_path: Path) -> None:
    """Byte 188 is half of the light of byte 255 (IEC 61966-2-1)."""
    Image.fromarray(np.array([[[0, 188, 255]]], np.uint8)).save(tmp_path / "a.png")
    assert read_picture(tmp_path / "a.png") == pytest.approx(np.array([[[0.0, 0.5, 1.0]]]), abs=0.005)


def test_missing_and_foreign_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none.png: not a picture"):
        read_picture(tmp_path / "none.png")
    (tmp_path / "text.png").write_text("text")
    with pytest.raises(ConfigError, match=r"text.png: not a picture"):
        read_picture(tmp_path / "text.png")
