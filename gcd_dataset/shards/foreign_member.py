"""Decodes members of foreign samples by the ending of their names; never executes pickles."""

from typing import TYPE_CHECKING, Any

import numpy as np

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.meta import decode_json
from gcd_dataset.shards.npy import read_any_npy
from gcd_dataset.shards.picture import opened_picture

if TYPE_CHECKING:
    from PIL import ImageFile

__all__ = ["decode_member"]

PICTURES = ("jpg", "jpeg", "png", "webp", "ppm", "pgm", "tif", "tiff", "bmp")
FORMATS = ("JPEG", "PNG", "WEBP", "PPM", "TIFF", "BMP")  # Pillow's names
LONGEST_NUMBER = 20  # digits of a class label
NUMBERS = "biufc"  # dtype.kind
DEEP_GREY = {"I": np.int32, "F": np.float32}  # Pillow's mode, up to a semicolon, to the type of its values
PICKLES = ("pkl", "pickle", "pyd", "pth", "pt", "joblib", "dill")


def decode_member(member: str, data: Bytes) -> Any:
    """A number array, parsed JSON, text, a class number, a picture as u8 [3, height, width]; anything else as bytes.

    A grey picture of more than 8 bits, such as a depth map, keeps its values, as int32 or f32 [1, height, width].
    Raises ``ShardError`` for content that does not match the ending, for colours of more than 8 bits a channel, and for
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
        raise ShardError(f"member {name}: does not match its ending ({error}): get it again from its maker") from error
    return bytes(data)


def _class(data: Bytes) -> int:
    if len(data) > LONGEST_NUMBER:
        raise ShardError(f"{len(data)} bytes, expected a number")
    return int(bytes(data))


def _pixels(image: "ImageFile.ImageFile") -> np.ndarray:
    """The pixels, unchanged. Raises ``ShardError`` where Pillow would reduce their bits."""
    deep = DEEP_GREY.get(image.mode.partition(";")[0])
    if _is_scaled(image, deep is not None):
        raise ShardError("a picture of more than 8 bits a channel, which would be reduced: store it as .npy")
    if deep is not None:
        return np.asarray(image).astype(deep)[None]
    return np.ascontiguousarray(np.asarray(image.convert("RGB")).transpose(2, 0, 1))


def _is_scaled(image: "ImageFile.ImageFile", is_grey: bool) -> bool:
    """Whether Pillow rescales the values in the file: 16-bit colours, and PPM with unusual numbers of levels."""
    arguments = [tile[3] for tile in image.tile]  # decoder arguments: bits a channel, or number of levels
    if image.format == "PPM":
        levels = [argument[-1] for argument in arguments if isinstance(argument, tuple)]
        return any(level > 255 and not (is_grey and level == 65535) for level in levels)
    return not is_grey and any(";16" in str(argument) for argument in arguments)
