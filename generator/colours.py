"""The colours of drawings and renders: one for each panel, one for each seam."""

import colorsys
from typing import TypeAlias

RGB: TypeAlias = tuple[int, int, int]

PAPER: RGB = (250, 250, 248)
INK: RGB = (40, 40, 40)
PLAIN_EDGE: RGB = (70, 70, 70)
"""The colour of edges without a seam."""
HUES = (
    (0.33, 0.47, 0.66), (0.85, 0.55, 0.36), (0.45, 0.62, 0.47), (0.76, 0.42, 0.44), (0.58, 0.49, 0.69),
    (0.87, 0.73, 0.43), (0.38, 0.63, 0.66), (0.80, 0.58, 0.67), (0.55, 0.55, 0.50), (0.62, 0.72, 0.42),
)  # fmt: skip
PALETTE = (*HUES, *((0.5 * r + 0.42, 0.5 * g + 0.42, 0.5 * b + 0.42) for r, g, b in HUES))
"""Panel colours by panel index, in renders and flat drawings; RGB, each 0 to 1."""
FLAT_LIGHTENING = 0.55  # share of white mixed in, so that edges and names stand out
GOLDEN_RATIO = 0.618034


def cloth_colour(number: int) -> RGB:
    """The fill colour of panel ``number`` in a flat drawing."""
    red, green, blue = PALETTE[number % len(PALETTE)]
    return _rgb(*(channel + FLAT_LIGHTENING * (1 - channel) for channel in (red, green, blue)))


def seam_colour(number: int | None) -> RGB:
    """The colour of both edges of seam ``number``; ``None``: an edge without a seam.

    Hues step by the golden ratio, so that consecutive seams differ clearly.
    """
    if number is None:
        return PLAIN_EDGE
    return _rgb(*colorsys.hsv_to_rgb(number * GOLDEN_RATIO % 1.0, 0.85, 0.55 + 0.35 * (number % 3) / 2))


def _rgb(red: float, green: float, blue: float) -> RGB:
    return round(255 * red), round(255 * green), round(255 * blue)
