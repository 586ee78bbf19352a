"""Colours of cloth: what is worn most, and combinations for prints."""

import colorsys
from collections.abc import Sequence

import numpy as np

RGB = tuple[float, float, float]

NEUTRALS: tuple[RGB, ...] = (
    (0.95, 0.95, 0.94), (0.93, 0.91, 0.86), (0.86, 0.80, 0.70), (0.72, 0.66, 0.58), (0.62, 0.62, 0.63),
    (0.35, 0.35, 0.37), (0.16, 0.16, 0.18), (0.09, 0.09, 0.10), (0.13, 0.17, 0.28), (0.30, 0.25, 0.21),
)  # fmt: skip
HUED: tuple[RGB, ...] = (
    (0.70, 0.12, 0.15), (0.48, 0.10, 0.18), (0.85, 0.40, 0.33), (0.90, 0.62, 0.60), (0.93, 0.75, 0.74),
    (0.84, 0.50, 0.20), (0.80, 0.62, 0.22), (0.94, 0.83, 0.50), (0.45, 0.47, 0.26), (0.25, 0.36, 0.27),
    (0.55, 0.67, 0.58), (0.72, 0.82, 0.76), (0.12, 0.42, 0.44), (0.35, 0.58, 0.72), (0.66, 0.78, 0.88),
    (0.18, 0.30, 0.58), (0.30, 0.38, 0.68), (0.45, 0.32, 0.55), (0.74, 0.67, 0.82), (0.78, 0.30, 0.50),
)  # fmt: skip
INDIGOS: tuple[RGB, ...] = (
    (0.15, 0.20, 0.32), (0.22, 0.31, 0.46), (0.34, 0.45, 0.60), (0.55, 0.65, 0.76), (0.13, 0.13, 0.15),
)  # fmt: skip


def luminance(colour: RGB) -> float:
    """Relative luminance of an sRGB colour (IEC 61966-2-1, with a gamma of 2.2)."""
    red, green, blue = (channel**2.2 for channel in colour)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def nudged(rng: np.random.Generator, colour: RGB, amount: float = 0.04) -> RGB:
    """A colour near another: hue, saturation and value move."""
    hue, saturation, value = colorsys.rgb_to_hsv(*colour)
    turn, fade, lift = rng.normal(size=3).tolist()
    return colorsys.hsv_to_rgb(
        (hue + turn * (0.5 * amount)) % 1.0,
        min(max(saturation + fade * amount, 0.0), 1.0),
        min(max(value + lift * amount, 0.04), 0.97),
    )


def draw_cloth_colour(rng: np.random.Generator, *, blue: bool = False) -> RGB:
    """A colour for plain cloth: neutral in two of five garments; any saturated hue in one of seven."""
    choice, wild = rng.random(), (rng.random(), rng.uniform(0.2, 0.9), rng.uniform(0.15, 0.95))
    palette = NEUTRALS if choice < 0.4 else HUED
    if blue and choice < 0.85:
        palette = INDIGOS
    colour = palette[int(rng.integers(len(palette)))]
    if choice > 0.86 and not blue:
        return colorsys.hsv_to_rgb(*wild)
    return nudged(rng, colour)


def draw_print_colours(rng: np.random.Generator) -> tuple[RGB, RGB, RGB, RGB]:
    """A ground and three colours of a motif; the first stands out from the ground."""
    ground = draw_cloth_colour(rng)
    others = [draw_cloth_colour(rng) for _ in range(5)]
    first = max(others, key=lambda colour: _contrast(ground, colour))
    rest = [colour for colour in others if colour is not first]
    second, third = sorted(rest, key=lambda colour: -min(_contrast(ground, colour), _contrast(first, colour)))[:2]
    return ground, first, second, third


# ------------------------------------------------------------------------------------------------------------- helpers


def _contrast(one: RGB, other: RGB) -> float:
    pair: Sequence[float] = sorted((luminance(one) + 0.05, luminance(other) + 0.05))
    return pair[1] / pair[0]
