"""Users' pictures as linear colours: image tiles, photographs, panoramas."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32
from PIL import Image, UnidentifiedImageError

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import open_regular

Linear = Float32[np.ndarray, "h w 3"]
MOST_PIXELS = 1 << 28


def read_picture(path: Path | str) -> Linear:
    """A picture as linear colours: JPEG, PNG and the like in sRGB, or Radiance ``.hdr``.

    Raises ``ConfigError`` with the file for one that cannot be read.
    """
    path = Path(path)
    try:
        if path.suffix.lower() in (".hdr", ".pic"):
            return _radiance(path)
        with open_regular(path) as file, Image.open(file) as image:
            return linear_light(np.asarray(image.convert("RGB"), np.float32) / 255.0).astype(np.float32)
    except (OSError, UnidentifiedImageError, ValueError) as error:
        raise ConfigError(
            f"{path}: not a picture that can be read ({error}): give JPEG, PNG or Radiance .hdr"
        ) from error


def linear_light(srgb: np.ndarray) -> np.ndarray:
    """sRGB to linear light, 0 to 1; IEC 61966-2-1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


# ------------------------------------------------------------------------------------------------------------- helpers


def _radiance(path: Path) -> Linear:
    """A Radiance picture: text header, then rows of RGBE, run-length coded or flat (Ward, Graphics Gems II, 1991)."""
    with open_regular(path) as file:
        data = file.read()
    head, blank, rest = data.partition(b"\n\n")
    if not head.startswith(b"#?") or not blank:
        raise ValueError("no Radiance header")
    resolution, _, body = rest.partition(b"\n")
    words = resolution.split()
    if len(words) != 4 or words[0] != b"-Y" or words[2] != b"+X":
        raise ValueError("only pictures with rows from the top are read")
    height, width = int(words[1]), int(words[3])
    if not 0 < height * width <= MOST_PIXELS:
        raise ValueError(f"{height} × {width} pixels")
    rows = np.empty((height, 4, width), np.uint8)
    if len(body) == 4 * height * width and body[:2] != b"\x02\x02":
        rows[...] = np.frombuffer(body, np.uint8).reshape(height, width, 4).swapaxes(1, 2)
    else:
        _unpack(body, rows)
    scale = np.exp2(rows[:, 3].astype(np.float32) - 136.0) * (rows[:, 3] > 0)
    return np.ascontiguousarray((rows[:, :3] * scale[:, None]).transpose(0, 2, 1), np.float32)


def _unpack(body: bytes, rows: np.ndarray) -> None:
    """Decode the run-length code into ``rows`` (h, 4, w). Raises ``ValueError`` for another code or a short file."""
    width, at = rows.shape[2], 0
    for row in rows:
        if body[at : at + 2] != b"\x02\x02" or int.from_bytes(body[at + 2 : at + 4], "big") != width:
            raise ValueError("rows in the code of before 1991, or a damaged file")
        at += 4
        for channel in row:
            column = 0
            while column < width:
                if at + 1 >= len(body):
                    raise ValueError("the file ends early")
                count = body[at]
                run = count > 128
                length = count - 128 if run else count
                if not 0 < length <= width - column:
                    raise ValueError("a run is longer than its row")
                kept = body[at + 1 : at + 2] * length if run else body[at + 1 : at + 1 + length]
                if len(kept) < length:
                    raise ValueError("the file ends early")
                channel[column : column + length] = np.frombuffer(kept, np.uint8)
                column += length
                at += 2 if run else 1 + length
