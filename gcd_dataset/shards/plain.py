"""Members of foreign samples as values: by the ending of their names, and never as code."""

import io
import json
from typing import Any

import numpy as np
from PIL import Image

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.layout import Bytes

__all__ = ["decode_member"]

PICTURES = ("jpg", "jpeg", "png", "webp", "ppm", "pgm", "tif", "tiff", "bmp")
NUMBERS = "biufc"  # NumPy's letters
PICKLES = ("pkl", "pickle", "pyd", "pth", "pt", "joblib", "dill")


def decode_member(member: str, data: Bytes) -> Any:
    """A number array, parsed JSON, text, a class number, a picture as u8 [3, height, width]; anything else as bytes.

    Raises ``ShardError`` for content that is not what its name says, and for a pickle, which could run code.

    >>> decode_member("caption.txt", b"a shirt"), decode_member("cls", b"3")
    ('a shirt', 3)
    """
    ending = member.rpartition(".")[2].lower()
    if ending in PICKLES:
        raise ShardError(f"member {member} is a pickle, which could run code, and is not read: leave it out of fields")
    try:
        if ending == "npy":
            return _numbers(np.load(io.BytesIO(data), allow_pickle=False))
        if ending == "json":
            return json.loads(bytes(data))
        if ending == "txt":
            return bytes(data).decode()
        if ending in ("cls", "index"):
            return int(bytes(data))
        if ending in PICTURES:
            with Image.open(io.BytesIO(data)) as image:
                return np.ascontiguousarray(np.asarray(image.convert("RGB")).transpose(2, 0, 1))
    except (ValueError, OSError, EOFError, SyntaxError, Image.DecompressionBombError) as error:
        raise ShardError(f"member {member}: not what its name says ({error}): get it anew from its maker") from error
    return bytes(data)


def _numbers(array: Any) -> np.ndarray:
    """The array in this machine's byte order. Raises ``ValueError`` for anything but numbers."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in NUMBERS:
        raise ValueError(f"{getattr(array, 'dtype', 'several arrays')}, where numbers are read")
    return array.astype(array.dtype.newbyteorder("="), copy=False)
