"""Patterns as DXF for pattern CAD, in the layers of AAMA and ASTM.

The layers and the ``Identifier:value`` texts are those of ASTM D6673-10, *Standard Practice for Sewn Products Pattern
Data Interchange—Data Format*, §4.3, which was withdrawn in 2019 without a replacement; ANSI/AAMA-292 has the same
layers 1 to 14. The encoding of a notch, a point with its depth in group 30, its width in 39 and its angle in 50, is
that of the ePattern guide to the standard by DH Patterns and Fit. ``Units:METRIC`` means millimetres with two decimals.

The file is DXF R12 without tables and without layouts, which the readers of pattern CAD expect: see ``ezdxf``'s
``gerber_D6673``. Each piece is a block, inserted once on one sheet. In a graded garment each size of a piece is a
block, and the sizes are inserted at one point, each on a layer of its own.
"""

import io
import math
import re
from collections.abc import Iterable, Mapping
from datetime import date
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from gcd_dataset import __version__
from gcd_dataset.exports.inputs import Graded, optional, patterns_of, require_suffix
from gcd_dataset.exports.pieces import CutPiece, cut_pieces
from gcd_dataset.files import plain_names, write_whole
from gcd_dataset.generator.lay_plan import boxes_by_name, pack
from gcd_dataset.records import Pattern, Sample

MM = 10.0  # millimetres in a centimetre
DECIMALS = 2  # of a millimetre
STANDARD = "ASTM/D13Proposal 1 Version:D6673-10"
TEXT, NUMBER, SYSTEM = 5.0, 3.5, 2.5  # mm, heights of texts
NAME_SHARE = 0.8  # share of the room that texts may take
LINE = 1.6  # distance of lines of text, in heights
LETTER = 0.7  # mean width of a letter, in heights
GAP = 2.0  # cm between pieces on the sheet
ASPECT = 1.6  # width over height of the sheet, about
LONGEST_NAME = 31  # letters of a block's name in R12
LONGEST_TEXT = 36  # letters: R12 limits a text to 255 bytes, and \U+XXXX takes 7
BASE_SIZE = "BASE"
SIZE_LAYER = "SIZE_"  # of a graded garment, before the name of a size: the layer on which its pieces are inserted
LONGEST_SIZE = LONGEST_NAME - len(SIZE_LAYER)
SAME = 0.02  # mm between a point of the sew line and one of the cut line that are one


class DxfLayer(StrEnum):
    """Layers of ASTM D6673-10, §4.3, that an export uses."""

    CUT = "1"
    """Piece boundary; also the texts about style and piece."""
    TURN = "2"
    CURVE = "3"
    NOTCH = "4"
    MIRROR = "6"
    """Line at which the cloth is folded."""
    GRAIN = "7"
    INTERNAL = "8"
    """Lines inside a piece."""
    DRILL = "13"
    SEW = "14"
    ANNOTATION = "15"


def dxf(
    garment: Sample | Pattern | Graded, path: Path | str, *, seam_allowance: float = 1.0, created: date | None = None
) -> None:
    """Write a pattern as DXF, or all sizes of a graded garment: pieces of one name lie over one another.

    ``seam_allowance``: cloth beyond the sew line [cm]; ``created``: date of creation in the file. Raises
    ``ConfigError`` for a name that does not end in ``.dxf`` or an allowance out of range, ``PatternError`` for a
    pattern that cannot be sewn, ``ExtraMissing`` without ezdxf, ``OutputError``. Equal patterns give equal bytes.
    """
    path = require_suffix(path, ".dxf")
    drawing = optional("ezdxf.document").Drawing  # ``ezdxf.new`` warns of units, which R12 has not
    exporter = optional("ezdxf.addons.gerber_D6673")
    patterns = patterns_of(garment)
    pieces = [
        (size, piece)
        for size, pattern in patterns.items()
        for piece in cut_pieces(pattern, seam_allowance=seam_allowance)
    ]
    sample_size, material = _size_and_material(garment)
    sizes, size_layers = {"": sample_size}, {"": DxfLayer.CUT.value}
    if isinstance(garment, Mapping):
        sizes = dict(zip(patterns, plain_names(list(patterns), longest=LONGEST_SIZE, stem="size"), strict=True))
        size_layers = {size: f"{SIZE_LAYER}{_identifier(name)}" for size, name in sizes.items()}
        sample_size = list(sizes.values())[len(sizes) // 2]
    document = drawing.new("R12")
    space = document.modelspace()
    boxes = boxes_by_name((piece.name, piece.box) for _, piece in pieces)
    names = dict(zip(boxes, plain_names(list(boxes), longest=LONGEST_NAME), strict=True))
    places = dict(zip(boxes, _places(np.stack(list(boxes.values()))), strict=True))
    labels = [f"{names[piece.name]} {sizes[size] if size else ''}".rstrip() for size, piece in pieces]
    for (size, piece), label in zip(pieces, plain_names(labels, longest=LONGEST_NAME), strict=True):
        block = document.blocks.new(_identifier(label))
        facts = [f"Size Name:{sizes[size]}", *([f"Material:{material}"] if material else [])]
        _draw_piece(block, piece, names[piece.name], facts)
        space.add_blockref(block.name, _mm(places[piece.name]), dxfattribs={"layer": size_layers[size]})
    [pattern, *_] = patterns.values()
    style = [
        f"Style Name:{_plain(pattern.name, 'style')}",
        *([] if created is None else [f"Creation Date:{created:%d-%m-%Y}"]),
        f"Author:gcd_dataset;gcd_dataset;{__version__}",
        f"Sample Size:{sample_size}",
        "Grade Rule Table:",
        "Units:METRIC",
        STANDARD,
    ]
    _write_lines(space, style, np.array([0.0, -GAP * MM]), SYSTEM, DxfLayer.CUT)
    stream = io.StringIO()
    exporter.export_stream(document, stream)
    write_whole(path, stream.getvalue().encode("ascii"))


# -------------------------------------------------------------------------------------------------------------- pieces


def _draw_piece(block: Any, piece: CutPiece, name: str, facts: Iterable[str]) -> None:
    """Add the entities of a piece to its block, in the panel's plane [mm]."""
    _write_texts(block, piece, name, facts)
    for line, layer in ((piece.cut, DxfLayer.CUT), (piece.sew, DxfLayer.SEW)):
        points = [_mm(point) for point in line]
        block.add_polyline2d(points, close=True, dxfattribs={"layer": layer.value})
    _draw_points(block, piece.cut, piece.cut_corner)
    if len(piece.cut) != len(piece.sew) or np.abs(piece.cut - piece.sew).max() * MM > SAME:
        _draw_points(block, piece.sew, piece.sew_corner)
    for notch in piece.notches:
        x, y = _mm(notch.point)
        angle = round(math.degrees(math.atan2(notch.inward[1], notch.inward[0])) % 360, 3)
        block.add_point(
            (x, y, round(MM * notch.depth, DECIMALS)), dxfattribs={"layer": DxfLayer.NOTCH.value, "angle": angle}
        )
    for hole in piece.drills:
        block.add_point(_mm(hole), dxfattribs={"layer": DxfLayer.DRILL.value})
    for fold in piece.folds:
        block.add_line(_mm(fold[0]), _mm(fold[1]), dxfattribs={"layer": DxfLayer.MIRROR.value})
    for line in piece.lines:
        points = [_mm(point) for point in line]
        block.add_polyline2d(points, dxfattribs={"layer": DxfLayer.INTERNAL.value})
    block.add_line(_mm(piece.grain[0]), _mm(piece.grain[1]), dxfattribs={"layer": DxfLayer.GRAIN.value})
    for number in piece.numbers:
        height = min(NUMBER, 0.3 * MM * number.room)
        at = (
            MM * number.point + 1.3 * height * number.inward - 0.5 * height * np.array([LETTER * len(number.text), 1.0])
        )
        _write_lines(block, [number.text], at, height, DxfLayer.ANNOTATION)


def _write_texts(block: Any, piece: CutPiece, name: str, facts: Iterable[str]) -> None:
    """The plain name and system texts of a piece, in the middle of its room for the name; below, its own name."""
    notes = [name, "cut 1", *([piece.name[:LONGEST_TEXT]] if name != piece.name else [])]
    system = [f"Piece Name:{name}", "Quantity:1,0", *facts]
    room = MM * NAME_SHARE * piece.name_room
    heights = [
        min(largest, room / (LETTER * max(map(len, lines)))) for largest, lines in ((TEXT, notes), (SYSTEM, system))
    ]
    width = LETTER * max(height * max(map(len, lines)) for height, lines in zip(heights, (notes, system), strict=True))
    tall = LINE * (heights[0] * len(notes) + heights[1] * len(system))
    at = MM * piece.name_at + [-0.5 * width, 0.5 * tall - heights[0]]
    _write_lines(block, notes, at, heights[0], DxfLayer.ANNOTATION)
    _write_lines(block, system, at - [0.0, LINE * heights[0] * len(notes)], heights[1], DxfLayer.CUT)


def _draw_points(block: Any, points: Float[np.ndarray, "n 2"], corner: Bool[np.ndarray, " n"]) -> None:
    """The turn and curve points of a closed line: all of its points."""
    for point, is_corner in zip(points, corner.tolist(), strict=True):
        layer = DxfLayer.TURN if is_corner else DxfLayer.CURVE
        block.add_point(_mm(point), dxfattribs={"layer": layer.value})


def _write_lines(space: Any, lines: Iterable[str], at: Float[np.ndarray, "2"], height: float, layer: DxfLayer) -> None:
    """Lines of text, the first at ``at`` [mm]."""
    x, y = np.round(at, DECIMALS).tolist()
    for number, line in enumerate(lines):
        text = space.add_text(_escaped(line), height=round(height, DECIMALS), dxfattribs={"layer": layer.value})
        text.set_placement((x, round(y - number * LINE * height, DECIMALS)))


# --------------------------------------------------------------------------------------------------------------- sheet


def _places(boxes: Float[np.ndarray, "p 2 2"]) -> Float[np.ndarray, "p 2"]:
    """Insertion points of pieces on one sheet, from their boxes [cm]."""
    sizes = boxes[:, 1] - boxes[:, 0]
    area = float((sizes + GAP).prod(axis=1).sum())
    corners, _ = pack(sizes, width=max(float(sizes[:, 0].max()), math.sqrt(ASPECT * area)), gap=GAP)
    return corners - boxes[:, 0]


def _identifier(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9-]", "_", name)


def _plain(name: str, stem: str) -> str:
    return plain_names([name], longest=LONGEST_NAME, stem=stem)[0] if name else ""


def _escaped(text: str) -> str:
    r"""The text in ASCII: other letters as ``\U+XXXX``, one for each UTF-16 unit, which CAD programs display."""
    units = np.frombuffer(text.encode("utf-16-be", "surrogatepass"), ">u2").tolist()
    return "".join(chr(unit) if unit < 128 else f"\\U+{unit:04X}" for unit in units)


def _size_and_material(garment: Sample | Pattern | Graded) -> tuple[str, str]:
    """Name of the size, the body for which a sample was cut, and of the fabric."""
    if not isinstance(garment, Sample):
        return BASE_SIZE, ""
    fabric = "" if garment.fabric is None else garment.fabric.name
    return _plain(garment.provenance.body_name or BASE_SIZE, "size"), _plain(fabric, "material")


def _mm(point: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """A point in millimetres, rounded as the standard wants."""
    x, y = np.round(MM * np.asarray(point), DECIMALS).tolist()
    return x, y
