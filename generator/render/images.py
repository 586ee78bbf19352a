"""Users' pictures as linear colours: image tiles, photographs, panoramas."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32
from PIL import Image, UnidentifiedImageError

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import open_regular

Linear = Float32[np.ndarray, "h w 3"]


def read_picture(path: Path | str) -> Linear:
    """A picture as linear colours, read as ``read_image`` does."""
    return linear_light(np.asarray(read_image(path), np.float32) / 255.0).astype(np.float32)


def read_image(path: Path | str) -> Image.Image:
    """An RGB image: JPEG, PNG and the like in sRGB.

    Raises ``ConfigError`` with the file for one that cannot be read.
    """
    try:
        with open_regular(path) as file, Image.open(file) as image:
            return image.convert("RGB")
    except (OSError, UnidentifiedImageError, ValueError) as error:
        raise ConfigError(f"{path}: not a picture that can be read ({error}): give JPEG or PNG") from error


def linear_light(srgb: np.ndarray) -> np.ndarray:
    """sRGB to linear light, 0 to 1; IEC 61966-2-1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
