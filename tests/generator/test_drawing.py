"""Flat drawings are to scale; sheets hold their pictures; files decode to the same pixels."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drawing import contact_sheet, design_sheet, draw_pattern, jpeg_bytes, picture_of, png_bytes
from gcd_dataset.generator.lay_plan import PAPER
from tests.helpers import napkins


def is_paper(picture: np.ndarray) -> np.ndarray:
    return np.abs(picture.astype(int) - PAPER).max(axis=2) <= 1


def test_a_pattern_is_drawn_to_scale() -> None:
    """Two panels of 20 × 10 cm cover the same area, side by side, without touching."""
    picture = draw_pattern(napkins(), size=200)
    columns = (~is_paper(picture)).any(axis=0)
    rows = (~is_paper(picture)).any(axis=1)
    runs = np.diff(np.flatnonzero(np.diff(np.r_[0, columns.astype(int), 0])))[::2]
    height = np.diff(np.flatnonzero(np.diff(np.r_[0, rows.astype(int), 0])))[::2]
    widest = max(runs.max(), height.max())
    assert widest > 80
    assert sorted([len(runs), len(height)]) == [1, 2]


@pytest.mark.parametrize("name", ["", " ", "\u200b"])
def test_a_panel_with_any_name_is_drawn(name: str) -> None:
    pattern = napkins()
    drawn = draw_pattern(replace(pattern, panels=(replace(pattern.panels[0], name=name), pattern.panels[1])), size=64)
    assert not is_paper(drawn).all()


def test_names_beyond_ascii_are_numbered() -> None:
    """Pillow's font has no other letters: all would be the same box."""
    first, second = napkins().panels

    def drawn(*names: str) -> bytes:
        panels = (replace(first, name=names[0]), replace(second, name=names[1]))
        return draw_pattern(replace(napkins(), panels=panels, seams=()), size=64).tobytes()

    assert drawn("前片", "спинка") == drawn("piece_1", "piece_2")


def test_contact_sheets_place_pictures_and_files_decode_to_them() -> None:
    pictures = [np.full((4, 6, 3), shade, np.uint8) for shade in (10, 20, 30)]
    sheet = contact_sheet(pictures, columns=2, gap=2)
    assert sheet.shape == (10, 14, 3)
    assert [sheet[1, 1, 0], sheet[1, 9, 0], sheet[7, 1, 0], sheet[7, 9, 0]] == [10, 20, 30, 255]
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(png_bytes(sheet)))), sheet)
    assert picture_of(jpeg_bytes(sheet), 5).shape == (5, 5, 3)
    with pytest.raises(ConfigError, match="pictures of one size"):
        contact_sheet([pictures[0], sheet], columns=1)


def test_a_sheet_of_designs_shows_each_under_its_name() -> None:
    patterns = [replace(napkins(), name=name) for name in ("first", "second", "third")]
    sheet = design_sheet(patterns, columns=2, size=64)
    height, width = sheet.shape[0] // 2, sheet.shape[1] // 2
    cells = [sheet[:height, :width], sheet[:height, -width:], sheet[-height:, :width]]
    captions = [cell[:14] for cell in cells]
    assert not any(is_paper(caption).all() for caption in captions)
    assert not np.array_equal(captions[0][:, :64], captions[1][:, -64:])
    drawn = draw_pattern(patterns[2], size=64)
    assert np.array_equal(sheet[-64:, :64], drawn)
