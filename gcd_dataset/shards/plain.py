"""Members of foreign samples as values: by the ending of their names, and never as code."""

from typing import Any

import numpy as np
from PIL import ImageFile

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.meta import decode_json
from gcd_dataset.shards.npy import read_any_npy
from gcd_dataset.shards.picture import opened_picture

__all__ = ["decode_member"]

PICTURES = ("jpg", "jpeg", "png", "webp", "ppm", "pgm", "tif", "tiff", "bmp")
FORMATS = ("JPEG", "PNG", "WEBP", "PPM", "TIFF", "BMP")  # as Pillow calls those
LONGEST_NUMBER = 20  # characters of a class
NUMBERS = "biufc"  # NumPy's letters
DEEP_GREY = {"I": np.int32, "F": np.float32}  # Pillow's modes, up to a semicolon, and what holds their values
PICKLES = ("pkl", "pickle", "pyd", "pth", "pt", "joblib", "dill")


def decode_member(member: str, data: Bytes) -> Any:
    """A number array, parsed JSON, text, a class number, a picture as u8 [3, height, width]; anything else as bytes.

    A grey picture of more than 8 bits, such as a depth map, comes with its values, as int32 or f32 [1, height, width].
    Raises ``ShardError`` for content that is not what its name says, for colours of more than 8 bits a channel, and for
    a pickle, which could run code.

    >>> decode_member("caption.txt", b"a shirt"), decode_member("cls", b"3")
    ('a shirt', 3)
    """
    ending = member.rpartition(".")[2].lower()
    if ending in PICKLES:
        raise ShardError(f"member {member} is a pickle, which could run code, and is not read: leave it out of fields")
    try:
        if ending == "npy":
            return read_any_npy(data, NUMBERS)
        if ending == "json":
            return decode_json(data, constants=True)
        if ending == "txt":
            return bytes(data).decode()
        if ending in ("cls", "index"):
            return _class(data)
        if ending in PICTURES:
            with opened_picture(data, FORMATS) as image:
                return _pixels(image)
    except (ShardError, ValueError) as error:
        name = shown(member)
        raise ShardError(f"member {name}: not what its name says ({error}): get it anew from its maker") from error
    return bytes(data)


def _class(data: Bytes) -> int:
    if len(data) > LONGEST_NUMBER:
        raise ShardError(f"{len(data)} bytes, where a number is read")
    return int(bytes(data))


def _pixels(image: ImageFile.ImageFile) -> np.ndarray:
    """The picture, no value changed. Raises ``ShardError`` for one that would come with fewer bits than it has."""
    deep = DEEP_GREY.get(image.mode.partition(";")[0])
    if _is_scaled(image, deep is not None):
        raise ShardError("a picture of more than 8 bits a channel, which would be lost: store it as .npy")
    if deep is not None:
        return np.asarray(image).astype(deep)[None]
    return np.ascontiguousarray(np.asarray(image.convert("RGB")).transpose(2, 0, 1))


def _is_scaled(image: ImageFile.ImageFile, is_grey: bool) -> bool:
    """Whether Pillow reads other values than are in the file: those of 16 bits in colour, and odd numbers of levels."""
    arguments = [tile[3] for tile in image.tile]  # of the decoder: the bits in the file, or the number of levels
    if image.format == "PPM":
        levels = [given[-1] for given in arguments if isinstance(given, tuple)]
        return any(most > 255 and not (is_grey and most == 65535) for most in levels)
    return not is_grey and any(";16" in str(given) for given in arguments)
