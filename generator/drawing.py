"""Flat drawings of patterns, contact sheets, and JPEG and PNG encoding; pictures are ``uint8`` arrays (h, w, 3)."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import plain_names
from gcd_dataset.generator.lay_plan import INK, PAPER, SheetPanel, cloth_colour, lay_out, seam_colour
from gcd_dataset.outfits import joined
from gcd_dataset.records import Pattern, Sample

__all__ = [
    "captioned", "contact_sheet", "design_sheet", "draw_body", "draw_pattern", "jpeg_bytes", "picture_of", "png_bytes",
    "sample_sheet",
]  # fmt: skip

JPEG_QUALITY = 92
SUPERSAMPLING = 3  # flat drawings are drawn at this multiple of their size, then scaled down
BODY_SUPERSAMPLING = 2
SKIN = (207, 196, 184)
TINY = 1e-9  # least divisor
LONGEST_NAME = 40  # letters; Pillow's font has those of ASCII alone
CAPTION = 16  # height of the strip for a caption [pixels]


def draw_pattern(pattern: Pattern, *, size: int = 800) -> UInt8[np.ndarray, "h w 3"]:
    """The panels side by side at one scale, ``size`` × ``size`` pixels; edges sewn together share a colour."""
    plan = lay_out(pattern)
    pixels = size * SUPERSAMPLING
    scale = 0.94 * pixels / max(plan.width, plan.height)
    margin = 0.5 * (pixels - scale * np.array([plan.width, plan.height]))
    image = Image.new("RGB", (pixels, pixels), PAPER)
    canvas = ImageDraw.Draw(image)

    def to_pixels(piece: SheetPanel, points: Float[np.ndarray, "n 2"]) -> list[tuple[float, float]]:
        x, y = (scale * (points + piece.shift) + margin).T
        return list(zip(x.tolist(), (pixels - y).tolist(), strict=True))

    names = plain_names([panel.name for panel in pattern.panels], longest=LONGEST_NAME)
    for piece, name in zip(plan.panels, names, strict=True):
        canvas.polygon(to_pixels(piece, piece.outline), fill=cloth_colour(piece.number))
        for index, seam in enumerate(piece.seams):
            line = to_pixels(piece, piece.edge_points(index))
            canvas.line(line, fill=seam_colour(seam), width=pixels // 350, joint="curve")
        centre, room = piece.name_position()
        font = _font(name, scale * room, pixels / 48)
        canvas.text(to_pixels(piece, centre[None])[0], name, fill=INK, font=font, anchor="mm")
    return np.asarray(image.resize((size, size), Image.Resampling.LANCZOS))


def draw_body(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], *, height: int = 300
) -> UInt8[np.ndarray, "h w 3"]:
    """A body from the front, shaded by the slope of its surface; ``height`` pixels, as wide as the body."""
    pixels, margin = BODY_SUPERSAMPLING * height, 0.02
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    scale = (1 - 2 * margin) * pixels / max(float(high[1] - low[1]), TINY)
    width = int(np.ceil(scale * float(high[0] - low[0]) + 2 * margin * pixels))
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = normals[:, 2] / np.maximum(np.linalg.norm(normals, axis=1), TINY)
    seen = np.flatnonzero(facing > 0)
    seen = seen[np.argsort(corners[seen, :, 2].mean(axis=1))]  # painter's algorithm: far faces first
    x = scale * (corners[..., 0] - low[0]) + margin * pixels
    y = (1 - margin) * pixels - scale * (corners[..., 1] - low[1])
    shades = (np.array(SKIN) * (0.55 + 0.45 * facing[:, None])).astype(int)
    image = Image.new("RGB", (width, pixels), PAPER)
    canvas = ImageDraw.Draw(image)
    triangles = np.stack([x, y], axis=-1)[seen].reshape(-1, 6)
    for triangle, shade in zip(triangles.tolist(), shades[seen].tolist(), strict=True):
        canvas.polygon(triangle, fill=tuple(shade))
    size = (-(-width // BODY_SUPERSAMPLING), height)
    return np.asarray(image.resize(size, Image.Resampling.LANCZOS))


def contact_sheet(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]], *, columns: int, gap: int = 6
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures of one size in rows of ``columns``, ``gap`` white pixels apart.

    Raises ``ConfigError`` for no pictures, pictures of different sizes, or no columns.
    """
    if not pictures or columns < 1 or len({picture.shape for picture in pictures}) > 1:
        raise ConfigError("a contact sheet needs pictures of one size, and at least one column")
    height, width, _ = pictures[0].shape
    rows = -(-len(pictures) // columns)
    sheet = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, np.uint8)
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        top, left = row * (height + gap), column * (width + gap)
        sheet[top : top + height, left : left + width] = picture
    return sheet


def sample_sheet(sample: Sample, *, size: int = 512) -> UInt8[np.ndarray, "h w 3"]:
    """Front, back and flat pattern of a sample side by side, each ``size`` pixels, then its views in further rows.

    Pictures that it lacks are left out.
    """
    sides = [picture_of(jpeg, size) for jpeg in (sample.front, sample.back) if jpeg]
    pictures = [*sides, draw_pattern(joined(sample).pattern, size=size)]
    views = [picture_of(view.picture, size) for view in sample.views if view.picture]
    return contact_sheet([*pictures, *views], columns=len(pictures))


def captioned(picture: UInt8[np.ndarray, "h w 3"], text: str) -> UInt8[np.ndarray, "h w 3"]:
    """The picture under a line of text."""
    height, width, _ = picture.shape
    image = Image.new("RGB", (width, height + CAPTION), PAPER)
    image.paste(Image.fromarray(picture), (0, CAPTION))
    font = _font(text, width, 0.8 * CAPTION)
    ImageDraw.Draw(image).text((0.5 * width, 0.5 * CAPTION), text, fill=INK, font=font, anchor="mm")
    return np.asarray(image)


def design_sheet(patterns: Sequence[Pattern], *, columns: int, size: int = 256) -> UInt8[np.ndarray, "h w 3"]:
    """Flat drawings of patterns in rows of ``columns``, each under its name."""
    return contact_sheet([captioned(draw_pattern(p, size=size), p.name) for p in patterns], columns=columns)


def picture_of(encoded: bytes, size: int) -> UInt8[np.ndarray, "h w 3"]:
    """A JPEG or PNG decoded and scaled to ``size`` × ``size`` pixels."""
    image = Image.open(io.BytesIO(encoded)).convert("RGB")
    return np.asarray(image if image.size == (size, size) else image.resize((size, size), Image.Resampling.LANCZOS))


def png_bytes(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """The picture as a PNG file."""
    return _encoded(picture, format="PNG", optimize=True)


def jpeg_bytes(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """The picture as a JPEG file."""
    return _encoded(picture, format="JPEG", quality=JPEG_QUALITY)


def _font(text: str, room: float, largest: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """A font of ``largest`` pixels, or down to a third of it to fit ``text`` into ``room`` [pixels]."""
    width = ImageFont.load_default(size=largest).getlength(text)
    return ImageFont.load_default(size=max(largest / 3, largest * min(1.0, 0.95 * room / max(width, 1.0))))


def _encoded(picture: UInt8[np.ndarray, "h w 3"], **options: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, **options)
    return file.getvalue()
