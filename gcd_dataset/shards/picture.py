"""Opens pictures of limited size with the named decoders only; by default Pillow tries all its decoders."""

import contextlib
import io
from collections.abc import Iterator
from typing import TYPE_CHECKING

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.limits import MOST_PIXELS

if TYPE_CHECKING:
    from PIL import ImageFile

__all__ = ["opened_picture"]


@contextlib.contextmanager
def opened_picture(data: Bytes, formats: tuple[str, ...]) -> "Iterator[ImageFile.ImageFile]":
    """The picture in a member; its pixels are decoded inside the block. ``formats``: Pillow's names of allowed formats.

    Raises ``ShardError`` for a broken picture, another format, or more than ``MOST_PIXELS`` pixels.
    """
    from PIL import Image

    bombs = (Image.DecompressionBombError, Image.DecompressionBombWarning)
    try:
        with Image.open(io.BytesIO(data), formats=formats) as image:
            if image.width * image.height > MOST_PIXELS:
                raise ShardError(f"a picture of {image.width} x {image.height} pixels, over the limit of {MOST_PIXELS}")
            yield image
    except (OSError, ValueError, SyntaxError, EOFError, *bombs) as error:
        raise ShardError(f"not a picture ({error})") from error
