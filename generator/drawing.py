"""Flat drawings of patterns, sheets of pictures, and their files."""

import colorsys
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from gcd_dataset.curves import LINE, sample_curve
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import EdgeRef, Panel, Pattern, Sample

__all__ = ["PALETTE", "PAPER", "contact_sheet", "draw_pattern", "jpeg_bytes", "picture_of", "png_bytes", "sample_sheet"]

JPEG_QUALITY = 92
PAPER = (250, 250, 248)
HUES = (
    (0.33, 0.47, 0.66), (0.85, 0.55, 0.36), (0.45, 0.62, 0.47), (0.76, 0.42, 0.44), (0.58, 0.49, 0.69),
    (0.87, 0.73, 0.43), (0.38, 0.63, 0.66), (0.80, 0.58, 0.67), (0.55, 0.55, 0.50), (0.62, 0.72, 0.42),
)  # fmt: skip
PALETTE = (*HUES, *((0.5 * r + 0.42, 0.5 * g + 0.42, 0.5 * b + 0.42) for r, g, b in HUES))
SUPERSAMPLING = 3  # of the flat drawing
NAME_HEIGHTS = (0.5, 0.42, 0.58, 0.34, 0.66, 0.26, 0.74)  # of a panel, from the middle outwards


def draw_pattern(pattern: Pattern, *, size: int = 800) -> UInt8[np.ndarray, "h w 3"]:
    """The panels side by side at one scale, in the colours of the renders; edges sewn together share a colour."""
    places, width, height = _lay_out([_extent(panel) for panel in pattern.panels])
    pixels = size * SUPERSAMPLING
    scale = 0.94 * pixels / max(width, height)
    image = Image.new("RGB", (pixels, pixels), PAPER)
    canvas = ImageDraw.Draw(image)
    seam_of = {side: number for number, seam in enumerate(pattern.seams) for side in (seam.left, seam.right)}
    shift = 0.5 * (pixels - scale * np.array([width, height]))

    def to_pixels(points: Float[np.ndarray, "n 2"], place: Float[np.ndarray, "2"], low: np.ndarray) -> list[tuple]:
        x, y = (scale * (points - low + place) + shift).T
        return list(zip(x.tolist(), (pixels - y).tolist(), strict=True))

    for number, (panel, place) in enumerate(zip(pattern.panels, places, strict=True)):
        low, _ = _extent(panel)
        edges = [_edge_points(panel, index) for index in range(len(panel.edges))]
        outline = np.concatenate([points[:-1] for points in edges])
        canvas.polygon(to_pixels(outline, place, low), fill=_rgb(PALETTE[number % len(PALETTE)], lighten=0.55))
        for index, points in enumerate(edges):
            seam = seam_of.get(EdgeRef(panel.name, index))
            colour = (70, 70, 70) if seam is None else _seam_colour(seam)
            canvas.line(to_pixels(points, place, low), fill=colour, width=pixels // 350, joint="curve")
        middle, room = _widest_place(outline)
        font = _font(panel.name, scale * room, pixels / 48)
        canvas.text(to_pixels(middle[None], place, low)[0], panel.name, fill=(40, 40, 40), font=font, anchor="mm")
    return np.asarray(image.resize((size, size), Image.Resampling.LANCZOS))


def contact_sheet(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]], *, columns: int, gap: int = 6
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures of one size in rows of ``columns``. Raises ``ConfigError`` for pictures of several sizes, or none."""
    if not pictures or columns < 1 or len({picture.shape for picture in pictures}) > 1:
        raise ConfigError("a contact sheet needs pictures of one size, and a column or more")
    height, width, _ = pictures[0].shape
    rows = -(-len(pictures) // columns)
    sheet = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, np.uint8)
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        top, left = row * (height + gap), column * (width + gap)
        sheet[top : top + height, left : left + width] = picture
    return sheet


def sample_sheet(sample: Sample, *, size: int = 512) -> UInt8[np.ndarray, "h w 3"]:
    """What there is to see of a sample, side by side: front, back, pattern."""
    views = [picture_of(jpeg, size) for jpeg in (sample.front, sample.back) if jpeg]
    pictures = [*views, draw_pattern(sample.pattern, size=size)]
    return contact_sheet(pictures, columns=len(pictures))


def picture_of(encoded: bytes, size: int) -> UInt8[np.ndarray, "h w 3"]:
    """A JPEG or PNG as pixels, scaled to ``size``."""
    image = Image.open(io.BytesIO(encoded)).convert("RGB")
    return np.asarray(image if image.size == (size, size) else image.resize((size, size), Image.Resampling.LANCZOS))


def png_bytes(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """The picture as a PNG file."""
    return _encoded(picture, format="PNG", optimize=True)


def jpeg_bytes(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """The picture as a JPEG file."""
    return _encoded(picture, format="JPEG", quality=JPEG_QUALITY)


# ------------------------------------------------------------------------------------------------------------- helpers


def _edge_points(panel: Panel, index: int) -> Float[np.ndarray, "n 2"]:
    edge = panel.edges[index]
    return sample_curve(*panel.edge_ends(index), edge.curve, 2 if edge.curve == LINE else 33)


def _extent(panel: Panel) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower left and upper right of a panel's outline [cm]."""
    points = np.concatenate([_edge_points(panel, index) for index in range(len(panel.edges))])
    return points.min(axis=0), points.max(axis=0)


def _widest_place(outline: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "2"], float]:
    """Where across a panel there is most room for its name, and how much [cm]."""
    polygon = shapely.Polygon(outline)
    left, low, right, high = polygon.bounds
    best, middle = 0.0, np.array([0.5 * (left + right), 0.5 * (low + high)])
    for share in NAME_HEIGHTS:
        level = low + share * (high - low)
        across = polygon.intersection(shapely.LineString([(left - 1, level), (right + 1, level)]))
        for piece in shapely.get_parts(across):
            if piece.length > 1.05 * best:  # of nearly equal places the one nearest to the middle
                best, middle = piece.length, np.array(piece.centroid.coords[0])
    return middle, best


def _lay_out(
    extents: Sequence[tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]],
) -> tuple[list[Float[np.ndarray, "2"]], float, float]:
    """Lower left corners of panels on rows from the top down, tallest first, and the size of the whole [cm]."""
    sizes = np.array([high - low for low, high in extents])
    gap = 0.04 * float(np.sqrt((sizes[:, 0] * sizes[:, 1]).sum()))
    row_width = max(float(sizes[:, 0].max()), 1.15 * float(np.sqrt((sizes + gap).prod(axis=1).sum())))
    corners, x, y, row_height, width = np.zeros_like(sizes), 0.0, 0.0, 0.0, 0.0
    for number in np.argsort(-sizes[:, 1], kind="stable"):
        if x and x + sizes[number, 0] > row_width:
            x, y = 0.0, y - row_height - gap
        if not x:
            row_height = float(sizes[number, 1])
        corners[number] = (x, y - sizes[number, 1])
        x += float(sizes[number, 0]) + gap
        width = max(width, x - gap)
    corners[:, 1] += row_height - y
    return list(corners), width, row_height - y


def _font(text: str, room: float, largest: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """A font in which ``text`` is not wider than ``room`` [pixels], within reason."""
    wide = ImageFont.load_default(size=largest).getlength(text)
    return ImageFont.load_default(size=max(largest / 3, largest * min(1.0, 0.95 * room / max(wide, 1.0))))


def _rgb(colour: tuple[float, float, float], *, lighten: float = 0.0) -> tuple[int, int, int]:
    red, green, blue = (round(255 * (part + lighten * (1 - part))) for part in colour)
    return red, green, blue


def _seam_colour(number: int) -> tuple[int, int, int]:
    """Colours far apart for neighbours, so that partners are found by eye."""
    return _rgb(colorsys.hsv_to_rgb(number * 0.618034 % 1.0, 0.85, 0.55 + 0.35 * (number % 3) / 2))


def _encoded(picture: UInt8[np.ndarray, "h w 3"], **options: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, **options)
    return file.getvalue()
