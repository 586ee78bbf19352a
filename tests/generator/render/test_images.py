"""Pictures are read as linear light, whatever their file."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import read_picture


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
