"""Pictures are read as linear light, whatever their file."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import read_picture

HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 10\n"


def test_srgb_is_made_linear(tmp_path: Path) -> None:
    """Byte 188 is half of the light of byte 255 (IEC 61966-2-1)."""
    Image.fromarray(np.array([[[0, 188, 255]]], np.uint8)).save(tmp_path / "a.png")
    assert read_picture(tmp_path / "a.png") == pytest.approx(np.array([[[0.0, 0.5, 1.0]]]), abs=0.005)


def runs(*values: int) -> bytes:
    """Rows of 10 equal values."""
    return b"".join(bytes([128 + 10, value]) for value in values)


def test_radiance_pictures_flat_and_in_runs(tmp_path: Path) -> None:
    """Exponent 129 is a factor of 2 on mantissas of 256ths: (128, 64, 0, 129) is (1, 0.5, 0)."""
    pixel, dark = bytes([128, 64, 0, 129]), bytes([0, 0, 0, 0])
    (tmp_path / "flat.hdr").write_bytes(HEADER + pixel * 10 + dark * 10)
    literal = bytes([4, 128, 128, 128, 128]) + bytes([128 + 6, 128])
    first = b"\x02\x02\x00\x0a" + literal + runs(64, 0, 129)
    (tmp_path / "runs.hdr").write_bytes(HEADER + first + b"\x02\x02\x00\x0a" + runs(0, 0, 0, 0))
    expected = np.zeros((2, 10, 3))
    expected[0] = (1.0, 0.5, 0.0)
    for name in ("flat.hdr", "runs.hdr"):
        assert np.array_equal(read_picture(tmp_path / name), expected.astype(np.float32)), name


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"GIF", "no Radiance header"),
        (HEADER + b"\x02\x02\x00\x0a\x8a", "ends early"),
        (HEADER + b"\x02\x02\x00\x0a\xff\x00", "longer than its row"),
        (HEADER + b"\x01\x01\x01\x05", "damaged"),
        (HEADER.replace(b"-Y 2 +X 10", b"+Y 2 +X 10"), "rows from the top"),
        (HEADER.replace(b"-Y 2", b"-Y 99999999999"), "pixels"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, content: bytes, fault: str) -> None:
    (tmp_path / "bad.hdr").write_bytes(content)
    with pytest.raises(ConfigError, match=f"bad.hdr.*{fault}"):
        read_picture(tmp_path / "bad.hdr")


def test_missing_and_foreign_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none.png: not a picture"):
        read_picture(tmp_path / "none.png")
    (tmp_path / "text.png").write_text("text")
    with pytest.raises(ConfigError, match=r"text.png: not a picture"):
        read_picture(tmp_path / "text.png")
