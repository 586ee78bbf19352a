"""Pictures of limited size, by a decoder that is named: Pillow would try all that it has."""

import contextlib
import io
from collections.abc import Iterator

from PIL import Image, ImageFile

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.limits import MOST_PIXELS

__all__ = ["opened_picture"]

BROKEN = (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError, Image.DecompressionBombWarning)


@contextlib.contextmanager
def opened_picture(data: Bytes, formats: tuple[str, ...]) -> Iterator[ImageFile.ImageFile]:
    """The picture in a member, whose pixels are decoded in the block; ``formats``: Pillow's names of those allowed.

    Raises ``ShardError`` for one that is broken, in another format, or has more than ``MOST_PIXELS``.
    """
    try:
        with Image.open(io.BytesIO(data), formats=formats) as image:
            if image.width * image.height > MOST_PIXELS:
                raise ShardError(f"a picture of {image.width} x {image.height} pixels, where {MOST_PIXELS} are read")
            yield image
    except BROKEN as error:
        raise ShardError(f"not a picture ({error})") from error
