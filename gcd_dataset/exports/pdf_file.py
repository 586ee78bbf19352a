"""Patterns as PDF at true scale, tiled on pages with marks: print, trim, glue, cut.

Sew lines are drawn as Bézier curves; cut lines are polylines within 0.1 mm. The first page, or on large paper a block
on the sheet, is the legend: a square of 10 cm to check the scale, the map of the pages, the pieces, the kinds of lines.

No font is embedded. A name beyond Latin letters is drawn in a font that readers substitute, if one has its letters;
a plain name stands beside it. Bookmarks hold all names.
"""

import contextlib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from string import ascii_uppercase
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Point, Quadratic, arc_centre, from_frame
from gcd_dataset.errors import ConfigError, did_you_mean, shown
from gcd_dataset.exports.inputs import Graded, optional, patterns_of, require_suffix
from gcd_dataset.exports.pieces import CutPiece, cut_pieces
from gcd_dataset.files import plain_names, write_whole
from gcd_dataset.generator.lay_plan import FOLDED, RGB, boxes_by_name, pack, seam_colour
from gcd_dataset.records import Panel, Pattern, Sample

MARGIN = 1.0  # cm that printers leave blank
OVERLAP = 1.0  # cm
GAP = 0.6  # cm between pieces on the sheet
MOST_COLUMNS = 12


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper size, upright [cm]."""

    name: str
    width: float
    height: float

    @property
    def window(self) -> tuple[float, float]:
        """Width and height of the printed area [cm]."""
        return self.width - 2 * MARGIN, self.height - 2 * MARGIN

    @property
    def cell(self) -> tuple[float, float]:
        """Distance of neighbouring pages on the sheet, across and down [cm]."""
        return self.width - 2 * MARGIN - OVERLAP, self.height - 2 * MARGIN - OVERLAP

    @property
    def is_large(self) -> bool:
        """Whether the legend is placed on the sheet, since a page of its own would be wasted."""
        return self.width > 40.0


PAPERS = {
    paper.name: paper
    for paper in (
        Paper("a4", 21.0, 29.7),
        Paper("letter", 21.59, 27.94),
        Paper("a3", 29.7, 42.0),
        Paper("a1", 59.4, 84.1),
        Paper("a0", 84.1, 118.9),
    )
}


def paper_named(name: str) -> Paper:
    """The paper of that name. Raises ``ConfigError`` with the known names."""
    if name.lower() not in PAPERS:
        raise ConfigError(f"no paper {name}: choose from {', '.join(PAPERS)}{did_you_mean(name.lower(), PAPERS)}")
    return PAPERS[name.lower()]


@dataclass(frozen=True, slots=True)
class Page:
    """A page of the sheet."""

    row: int
    column: int

    @property
    def label(self) -> str:
        """Letters of the row and number of the column: ``B3``."""
        high, low = divmod(self.row, len(ascii_uppercase))
        return f"{ascii_uppercase[high - 1] if high else ''}{ascii_uppercase[low]}{self.column + 1}"


@dataclass(frozen=True, eq=False)
class Tiling:
    """Positions of the pieces on a sheet, and the pages that print it."""

    paper: Paper
    corners: Float[np.ndarray, "p 2"]
    """Lower left corner of each rectangle on the sheet, y up [cm]."""
    height: float
    """Height of the sheet [cm]."""
    rows: int
    columns: int
    pages: tuple[Page, ...] = ()
    """The pages with a piece, row by row."""

    def origin(self, page: Page) -> tuple[float, float]:
        """Upper left corner of a page's cell on the sheet [cm]."""
        across, down = self.paper.cell
        return page.column * across, self.height - page.row * down

    def cell(self, page: Page) -> tuple[float, float, float, float]:
        """Left, bottom, right and top of a page's cell on the sheet [cm]; the last ones include their overlap."""
        (left, top), (across, down) = self.origin(page), self.paper.cell
        right = left + (across if page.column + 1 < self.columns else across + OVERLAP)
        return left, top - (down if page.row + 1 < self.rows else down + OVERLAP), right, top


def tile(sizes: Float[np.ndarray, "p 2"], shapes: Sequence[shapely.Geometry], paper: Paper) -> Tiling:
    """The tiling with the fewest pages.

    ``sizes``: bounding boxes of the pieces [cm]; ``shapes``: their cloth, relative to the lower left corners of the
    boxes. A page that shows no cloth is not printed.
    """
    widest = float(sizes[:, 0].max()) - OVERLAP  # the last page may use its overlap
    least = max(1, int(np.ceil(widest / paper.cell[0] - 1e-9)))
    found = [_tiling(sizes, shapes, paper, columns) for columns in range(least, max(MOST_COLUMNS, least) + 1)]
    return min(found, key=lambda tiling: (len(tiling.pages), tiling.rows * tiling.columns))


def _tiling(sizes: Float[np.ndarray, "p 2"], shapes: Sequence[shapely.Geometry], paper: Paper, columns: int) -> Tiling:
    across, down = paper.cell
    corners, height = pack(sizes, width=columns * across + OVERLAP, gap=GAP)
    rows = max(1, int(np.ceil((height - OVERLAP) / down - 1e-9)))
    placed = [
        shapely.affinity.translate(shape, *corner) for shape, corner in zip(shapes, corners.tolist(), strict=True)
    ]
    tree, tiling = shapely.STRtree(placed), Tiling(paper, corners, height, rows, columns)
    pages = [Page(row, column) for row in range(rows) for column in range(columns)]
    found, _ = tree.query([shapely.box(*tiling.cell(page)) for page in pages], predicate="intersects")
    return replace(tiling, pages=tuple(pages[k] for k in np.unique(found)))


POINTS = 72 / 2.54  # of a PDF in a centimetre
CUT_WIDTH, SEW_WIDTH, GRAIN_WIDTH, FRAME_WIDTH = 0.035, 0.02, 0.025, 0.01  # cm
DASH = (0.4, 0.2)  # cm, of the sew line
GREY, PALE = 0.45, 0.85
BLACK: RGB = (0, 0, 0)
ARC_STEP = np.radians(30.0)  # an arc of 30° differs from its Bézier curve by 4e-7 of the radius
NAME, SMALL, TINY = 0.8, 0.42, 0.32  # cm, sizes of letters
NAME_SHARE, NAME_HEIGHT = 0.8, 0.12  # size of a name, at most: share of its room, of the height of the piece
ARROW = (0.5, 0.18)  # cm, length and half width of an arrow head
DRILL = 0.25  # cm, radius of a drill hole's circle
MARK = 0.5  # cm, half the diagonal of a registration mark
TEST_SQUARE = 10.0  # cm
LEGEND = (18.0, 25.0)  # cm, width and height
MAP = (17.0, 8.5)  # cm, of the map of pages
CLOTH_WIDTHS = (110, 140, 150)  # cm, as cloth is sold
FONT, BOLD = "Helvetica", "Helvetica-Bold"
ASIAN_FONTS = {"gbk": "STSong-Light", "euc_kr": "HYSMyeongJo-Medium"}
"""Encoding to a font of ISO 32000-1, 9.7.5.2, with its letters; GBK includes Cyrillic."""
LONGEST_NAME = 60  # letters of a name that is drawn


def pdf(
    garment: Sample | Pattern | Graded, path: Path | str, *, seam_allowance: float = 1.0, paper: str = "a4"
) -> None:
    """Write the pattern as PDF, or of a graded garment those of all sizes, pieces of one name over one another.

    ``seam_allowance``: cloth beyond the sew line [cm]; ``paper``: a name of ``PAPERS``. Raises ``ConfigError`` for a
    name that does not end in ``.pdf``, an unknown paper or an allowance out of range, ``PatternError`` for a pattern
    that cannot be sewn, ``ExtraMissing`` without reportlab, ``OutputError``. Equal patterns give equal bytes.
    """
    path = require_suffix(path, ".pdf")
    canvas_class = optional("reportlab.pdfgen.canvas").Canvas
    metrics, fonts = (optional(f"reportlab.pdfbase.{module}") for module in ("pdfmetrics", "cidfonts"))
    for font in ASIAN_FONTS.values():
        metrics.registerFont(fonts.UnicodeCIDFont(font))
    size, patterns = paper_named(paper), patterns_of(garment)
    sheet = _sheet(patterns, size, seam_allowance)
    file = io.BytesIO()
    canvas = canvas_class(file, pagesize=(size.width * POINTS, size.height * POINTS), invariant=1, pageCompression=1)
    canvas.setTitle(shown(next(iter(patterns.values())).name))
    canvas.setCreator("gcd_dataset")
    if not size.is_large:
        _begin(canvas)
        _draw_legend(canvas, sheet, (size.width - LEGEND[0]) / 2, (size.height + LEGEND[1]) / 2)
        canvas.showPage()
    for number, page in enumerate(sheet.tiling.pages):
        _begin(canvas)
        _draw_page(canvas, sheet, page, number)
        canvas.showPage()
    for name in sheet.names:
        canvas.addOutlineEntry(name, name)
    canvas.save()
    write_whole(path, file.getvalue())


@dataclass(frozen=True)
class _PaperSheet:
    """All that is drawn: the pieces, in their places, and the legend."""

    name: str
    sizes: Mapping[str, tuple[CutPiece, ...]]
    """The pieces of each size."""
    names: Mapping[str, tuple[str, str]]
    """Name of a piece: as drawn, and in Latin letters."""
    cloth: Mapping[str, Float[np.ndarray, "2"]]
    """Name of a piece: width and height of its cloth, in all sizes [cm]."""
    shifts: Mapping[str, Float[np.ndarray, "2"]]
    """Name of a piece: from its panel's plane to the sheet, y up [cm]."""
    tiling: Tiling
    legend_at: tuple[float, float] | None
    """Upper left corner of the legend on the sheet; ``None``: on a page of its own."""
    allowance: float

    def drawn(self) -> Iterator[tuple[CutPiece, str, RGB, bool]]:
        """Each piece, its size, the colour of the size, and whether no smaller size has the piece."""
        known: set[str] = set()
        for number, (size, pieces) in enumerate(self.sizes.items()):
            for piece in pieces:
                yield piece, size, seam_colour(number) if len(self.sizes) > 1 else BLACK, piece.name not in known
                known.add(piece.name)


def _sheet(patterns: Graded, paper: Paper, allowance: float) -> _PaperSheet:
    labels = [label for label, _ in _names(list(patterns), "size")]
    cut = (cut_pieces(pattern, seam_allowance=allowance) for pattern in patterns.values())
    pieces = dict(zip(labels, cut, strict=True))
    every = [piece for found in pieces.values() for piece in found]
    boxes = boxes_by_name((piece.name, piece.box) for piece in every)
    low, high = np.stack(list(boxes.values()), axis=1)
    sizes, lows = high - low + CUT_WIDTH, low - 0.5 * CUT_WIDTH
    cloth = [
        shapely.union_all([shapely.Polygon(piece.cut - low) for piece in every if piece.name == name])
        for name, low in zip(boxes, lows, strict=True)
    ]
    if paper.is_large:
        sizes, cloth = np.vstack([sizes, LEGEND]), [*cloth, shapely.box(0, 0, *LEGEND)]
    tiling = tile(sizes, cloth, paper)
    legend_at = None
    if paper.is_large:
        x, y = tiling.corners[-1].tolist()
        legend_at = (x, y + LEGEND[1])
    [pattern, *_] = patterns.values()
    [(name, _)], names = _names([pattern.name], "pattern"), dict(zip(boxes, _names(list(boxes), "piece"), strict=True))
    shifts = dict(zip(boxes, tiling.corners[: len(boxes)] - lows, strict=True))
    return _PaperSheet(
        name, pieces, names, dict(zip(boxes, high - low, strict=True)), shifts, tiling, legend_at, allowance
    )


# --------------------------------------------------------------------------------------------------------------- pages


def _begin(canvas: Any) -> None:
    """A page whose unit is a centimetre."""
    canvas.scale(POINTS, POINTS)
    canvas.setLineCap(1)
    canvas.setLineJoin(1)


def _draw_page(canvas: Any, sheet: _PaperSheet, page: Page, number: int) -> None:
    paper, tiling = sheet.tiling.paper, sheet.tiling
    (width, height), (x, y) = paper.window, tiling.origin(page)
    canvas.saveState()
    clip = canvas.beginPath()
    clip.rect(MARGIN, MARGIN, width, height)
    canvas.clipPath(clip, stroke=0, fill=0)
    canvas.translate(MARGIN - x, MARGIN + height - y)  # the sheet, y up
    window = shapely.box(x, y - height, x + width, y)
    for piece, size_name, ink, is_first in sheet.drawn():
        shift = sheet.shifts[piece.name]
        if shapely.Polygon(piece.cut + shift).intersects(window):
            canvas.saveState()
            canvas.translate(*shift.tolist())
            _ink(canvas, ink)
            _draw_piece(canvas, piece, size_name)
            if is_first:
                _ink(canvas, BLACK)
                _write_texts(canvas, piece, *sheet.names[piece.name])
            canvas.bookmarkPage(piece.name)
            canvas.restoreState()
    if sheet.legend_at is not None:
        _draw_legend(canvas, sheet, *sheet.legend_at)
    canvas.restoreState()
    _draw_marks(canvas, sheet, page)
    canvas.setFillGray(GREY)
    text = f"{page.label}   page {number + 1} of {len(tiling.pages)}   {sheet.name}"
    _text(canvas, text, MARGIN + 0.2, 0.4 * MARGIN, TINY, centred=False, room=paper.width - 2 * MARGIN - 2.5)
    canvas.drawRightString(paper.width - MARGIN - 0.2, 0.4 * MARGIN, "print at 100 %")
    canvas.setFillGray(0)


def _draw_marks(canvas: Any, sheet: _PaperSheet, page: Page) -> None:
    """The borders of the page's cell, with half of a registration mark towards each neighbour.

    Solid: the border at which the page is trimmed; dashed: the border to which the neighbour is glued.
    """
    paper, tiling = sheet.tiling.paper, sheet.tiling
    (width, height), (across, down) = paper.window, paper.cell
    left, top = MARGIN, MARGIN + height
    right, bottom = left + across, top - down
    labels = {(other.row, other.column): other.label for other in tiling.pages}
    canvas.saveState()
    canvas.setStrokeGray(GREY)
    canvas.setFillGray(GREY)
    canvas.setLineWidth(FRAME_WIDTH)
    middle, level = 0.5 * (left + right), 0.5 * (bottom + top)
    sides = (
        ((0, -1), (left, level), False),
        ((-1, 0), (middle, top), False),
        ((0, 1), (right, level), True),
        ((1, 0), (middle, bottom), True),
    )
    for (down_by, right_by), (x, y), is_glued in sides:
        neighbour = labels.get((page.row + down_by, page.column + right_by))
        if neighbour is None:
            continue
        canvas.setDash([0.1, 0.2] if is_glued else [])
        if right_by:
            canvas.line(x, MARGIN, x, top)
        else:
            canvas.line(left, y, left + width, y)
        canvas.setDash([])
        # A registration mark: the half on each page complete each other.
        _polygon(canvas, np.array([[x - MARK, y], [x, y + MARK], [x + MARK, y], [x, y - MARK]]))
        _cross(canvas, x, y, MARK)
        if is_glued:
            canvas.saveState()
            canvas.translate(x + (0.5 * OVERLAP if right_by else 2.2), y - (0.5 * OVERLAP if down_by else -2.2))
            if right_by:
                canvas.rotate(90)
            _text(canvas, f"glue {neighbour} here", 0.0, -0.35 * TINY, TINY)
            canvas.restoreState()
        else:
            inside = (0.35, 1.4) if right_by else (1.4, -0.6)
            _text(canvas, f"to {neighbour}", x + inside[0], y + inside[1], TINY, centred=False)
    canvas.restoreState()


def _ink(canvas: Any, colour: RGB) -> None:
    shares = [channel / 255 for channel in colour]
    canvas.setStrokeColorRGB(*shares)
    canvas.setFillColorRGB(*shares)


def _cross(canvas: Any, x: float, y: float, reach: float) -> None:
    canvas.line(x - reach, y, x + reach, y)
    canvas.line(x, y - reach, x, y + reach)


# -------------------------------------------------------------------------------------------------------------- pieces


def _draw_piece(canvas: Any, piece: CutPiece, size: str) -> None:
    """The lines of a piece in the panel's plane [cm]; the name of its size at the corner furthest from the origin."""
    canvas.setLineWidth(CUT_WIDTH)
    _polygon(canvas, piece.cut)
    canvas.setLineWidth(SEW_WIDTH)
    canvas.setDash(list(DASH))
    _sew_line(canvas, piece.panel)
    canvas.setDash([])
    canvas.setLineWidth(CUT_WIDTH)
    for notch in piece.notches:
        canvas.line(*notch.point.tolist(), *(notch.point + notch.depth * notch.inward).tolist())
    canvas.setLineWidth(SEW_WIDTH)
    for x, y in piece.drills.tolist():
        canvas.circle(x, y, DRILL)
        _cross(canvas, x, y, DRILL)
    for fold in piece.folds:
        _draw_fold(canvas, fold)
    canvas.setLineWidth(GRAIN_WIDTH)
    for line, points in zip(piece.panel.lines, piece.lines, strict=True):
        canvas.setDash(list(FOLDED[line.angle > 0.0]) if line.angle else [])
        for start, end in pairwise(points.tolist()):
            canvas.line(*start, *end)
    canvas.setDash([])
    _arrow(canvas, *piece.grain)
    _arrow(canvas, *piece.grain[::-1])
    x, y = (0.98 * piece.cut[np.linalg.norm(piece.cut, axis=1).argmax()]).tolist()
    _text(canvas, size, x, y, TINY)


def _write_texts(canvas: Any, piece: CutPiece, name: str, latin: str) -> None:
    """Name of a piece and numbers of its seams."""
    notes = f"{'' if name == latin else f'{latin}: '}cut 1, right side up"
    room = NAME_SHARE * piece.name_room
    x, y = piece.name_at.tolist()
    largest = min(NAME, NAME_HEIGHT * float(np.ptp(piece.cut[:, 1])))
    _text(canvas, name, x, y, largest, font=BOLD, room=room)
    small = min(SMALL, 0.7 * largest)
    _text(canvas, notes, x, y - 1.4 * small, small, room=room)
    canvas.setFillGray(GREY)
    for number in piece.numbers:
        size = min(SMALL, 0.3 * number.room)
        x, y = (number.point + 1.4 * size * number.inward).tolist()
        _text(canvas, number.text, x, y - 0.35 * size, size)
    canvas.setFillGray(0)


def _draw_fold(canvas: Any, fold: Float[np.ndarray, "2 2"]) -> None:
    """The mark of a fold: a bracket with two arrows towards the edge, on the cloth."""
    along = (fold[1] - fold[0]) / np.linalg.norm(fold[1] - fold[0])
    inward = np.array([-along[1], along[0]])
    for share in (0.25, 0.75):
        tip = fold[0] + share * (fold[1] - fold[0])
        _arrow(canvas, tip + 1.2 * inward, tip)
    start, end = fold[0] + 0.25 * (fold[1] - fold[0]), fold[0] + 0.75 * (fold[1] - fold[0])
    canvas.line(*(start + 1.2 * inward).tolist(), *(end + 1.2 * inward).tolist())
    x, y = (0.5 * (start + end) + 1.6 * inward).tolist()
    _text(canvas, "fold", x, y, SMALL)


def _arrow(canvas: Any, tail: Float[np.ndarray, "2"], tip: Float[np.ndarray, "2"]) -> None:
    canvas.line(*tail.tolist(), *tip.tolist())
    length = float(np.linalg.norm(tip - tail))
    along = (tip - tail) / max(length, 1e-9)
    base = tip - min(ARROW[0], 0.4 * length) * along
    across = ARROW[1] * np.array([-along[1], along[0]])
    _polygon(canvas, np.stack([tip, base + across, base - across]), filled=True)


def _polygon(canvas: Any, points: Float[np.ndarray, "n 2"], *, filled: bool = False) -> None:
    path = canvas.beginPath()
    path.moveTo(*points[0].tolist())
    for point in points[1:].tolist():
        path.lineTo(*point)
    path.close()
    canvas.drawPath(path, stroke=not filled, fill=filled)


def _sew_line(canvas: Any, panel: Panel) -> None:
    path = canvas.beginPath()
    path.moveTo(*panel.edge_ends(0)[0])
    for index, edge in enumerate(panel.edges):
        start, end = panel.edge_ends(index)
        if edge.curve == LINE:
            path.lineTo(*end)
        for control0, control1, to in bezier_pieces(start, end, edge.curve):
            path.curveTo(*control0, *control1, *to)
    path.close()
    canvas.drawPath(path, stroke=1, fill=0)


def bezier_pieces(start: Point, end: Point, curve: Curve) -> list[tuple[Point, Point, Point]]:
    """A curve as cubic Bézier curves, each as two control points and the end [cm]; none for a line.

    Exact for Bézier curves; of an arc each piece spans 30° at most.
    """
    match curve:
        case Quadratic(control):
            x, y = from_frame(start, end, control)
            inner = [(x0 + 2 * (x - x0) / 3, y0 + 2 * (y - y0) / 3) for x0, y0 in (start, end)]
            return [(inner[0], inner[1], end)]
        case Cubic(control0, control1):
            return [(from_frame(start, end, control0), from_frame(start, end, control1), end)]
        case Arc(radius):
            centre, first, sweep = arc_centre(start, end, curve)
            count = max(1, int(np.ceil(abs(sweep) / ARC_STEP - 1e-9)))
            angles = first + sweep * np.arange(count + 1) / count
            radial = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            on_arc = centre + radial
            reach = 4 / 3 * np.tan(sweep / count / 4) * np.stack([-radial[:, 1], radial[:, 0]], axis=1)
            on_arc[-1] = end
            ends = zip((centre + radial + reach)[:-1], (centre + radial - reach)[1:], on_arc[1:], strict=True)
            return [tuple((x, y) for x, y in np.array(piece).tolist()) for piece in ends]  # type: ignore[misc]
        case _:
            return []


# -------------------------------------------------------------------------------------------------------------- legend


def _draw_legend(canvas: Any, sheet: _PaperSheet, left: float, top: float) -> None:
    """Title, test square, meaning of the lines, pieces and map of the pages, below a corner [cm]."""
    canvas.saveState()
    canvas.translate(left, top)
    _text(canvas, sheet.name, 0, -0.9, 0.9, font=BOLD, centred=False, room=LEGEND[0])
    tiling = sheet.tiling
    pages = f"{len(tiling.pages)} page{'s' if len(tiling.pages) > 1 else ''} {tiling.paper.name.upper()}"
    facts = f"{len(sheet.names)} pieces on {pages}; seam allowance {sheet.allowance:g} cm, included"
    _text(canvas, facts, 0, -1.7, SMALL, centred=False)
    _text(canvas, _cloth_lengths(sheet), 0, -2.2, TINY, centred=False, room=LEGEND[0])
    column = LEGEND[0] / len(sheet.sizes)
    for number, size in enumerate(sheet.sizes):
        _ink(canvas, seam_colour(number))
        _text(canvas, size, number * column, -12.85, SMALL, font=BOLD, centred=False, room=0.9 * column)
    _ink(canvas, BLACK)
    canvas.setLineWidth(FRAME_WIDTH)
    canvas.rect(0, -2.4 - TEST_SQUARE, TEST_SQUARE, TEST_SQUARE)
    _text(canvas, "10 cm × 10 cm", 5.0, -7.2, 0.6, font=BOLD)
    _text(canvas, "Measure both sides. Print at 100 %,", 5.0, -8.2, TINY)
    _text(canvas, "without “fit to page”.", 5.0, -8.7, TINY)
    _draw_key(canvas, 10.8, -2.6)
    _list_pieces(canvas, sheet, -13.3)
    _draw_map(canvas, sheet, -LEGEND[1] + MAP[1])
    canvas.restoreState()


def _cloth_lengths(sheet: _PaperSheet) -> str:
    """Cloth to buy in each of ``CLOTH_WIDTHS``: the pieces side by side along the grain; of all sizes, the largest."""
    sizes = np.stack(list(sheet.cloth.values()))
    lengths = ((width, pack(sizes, width=width, gap=0.0)[1]) for width in CLOTH_WIDTHS)
    texts = (
        f"{int(np.ceil(length - 1e-6))} cm at {width} cm" if sizes[:, 0].max() <= width else f"too narrow at {width} cm"
        for width, length in lengths
    )
    return f"cloth length, along the grain in one layer: {', '.join(texts)}"


def _draw_key(canvas: Any, x: float, y: float) -> None:
    middle, end = x + 0.75, x + 1.5
    texts = (
        "cut line",
        "sew line",
        "notch: matches one on the other edge",
        "double notch: tells both ends apart",
        "grain (warp)",
        "drill hole of a dart",
        "seam: sew equal numbers together",
        "mountain fold: a ridge on the right side",
        "valley fold",
    )
    levels = [y - 0.75 * row for row in range(len(texts))]
    cut, sew, single, double, grain, drill, number, *folds = levels
    canvas.setLineWidth(CUT_WIDTH)
    canvas.line(x, cut, end, cut)
    for level, slits in ((single, (0.75,)), (double, (0.55, 0.95))):
        canvas.line(x, level + 0.2, end, level + 0.2)
        for at in slits:
            canvas.line(x + at, level + 0.2, x + at, level - 0.2)
    canvas.setLineWidth(SEW_WIDTH)
    canvas.setDash(list(DASH))
    canvas.line(x, sew, end, sew)
    canvas.setDash([])
    canvas.circle(middle, drill, DRILL)
    _cross(canvas, middle, drill, DRILL)
    canvas.setLineWidth(GRAIN_WIDTH)
    for ends in ((x, end), (end, x)):
        _arrow(canvas, *(np.array([at, grain]) for at in ends))
    for fold, dashes in zip(folds, FOLDED.values(), strict=True):
        canvas.setDash(list(dashes))
        canvas.line(x, fold, end, fold)
    canvas.setDash([])
    canvas.setFillGray(GREY)
    _text(canvas, "7", middle, number - 0.15, SMALL)
    canvas.setFillGray(0)
    for level, text in zip(levels, texts, strict=True):
        _text(canvas, text, x + 1.8, level - 0.12, TINY, centred=False)
    steps = (
        "Trim each page at its solid border. Glue",
        "it to the dashed border of the page at its",
        "left or above; the diamonds must meet.",
    )
    for row, step in enumerate(steps):
        _text(canvas, step, x, y - 7.0 - 0.5 * row, TINY, centred=False)


def _list_pieces(canvas: Any, sheet: _PaperSheet, top: float) -> None:
    """The pieces with the size of their cloth, in columns."""
    columns = 2 if len(sheet.names) <= 10 else 3
    rows, wide = -(-len(sheet.names) // columns), LEGEND[0] / columns
    step = min(0.46, 2.9 / rows)
    size = min(TINY, 0.75 * step)
    for number, (piece, (name, latin)) in enumerate(sheet.names.items()):
        column, row = divmod(number, rows)
        width, height = sheet.cloth[piece].tolist()
        line = f"{latin}{'' if name == latin else f' ({name})'}: {width:.1f} × {height:.1f} cm"
        _text(canvas, line, column * wide, top - step * row, size, centred=False, room=wide - 0.3)


def _draw_map(canvas: Any, sheet: _PaperSheet, top: float) -> None:
    """The pages and pieces, small; pages that are not printed are grey."""
    tiling = sheet.tiling
    across, down = tiling.paper.cell
    width, height = tiling.columns * across + OVERLAP, tiling.rows * down + OVERLAP
    scale = min(MAP[0] / width, MAP[1] / height)
    canvas.saveState()
    canvas.translate(0.5 * (LEGEND[0] - scale * width), top)
    canvas.setLineWidth(FRAME_WIDTH)
    for row in range(tiling.rows):
        for column in range(tiling.columns):
            page = Page(row, column)
            box = scale * (np.array(tiling.cell(page)) - [0.0, tiling.height, 0.0, tiling.height])
            left, bottom, right, upper = box.tolist()
            canvas.setFillGray(1.0 if page in tiling.pages else PALE)
            canvas.setStrokeGray(GREY)
            canvas.rect(left, bottom, right - left, upper - bottom, fill=1)
            if page in tiling.pages:
                canvas.setFillGray(GREY)
                size = min(0.7, 0.3 * scale * min(across, down))
                _text(canvas, page.label, left + 0.5 * scale * across, upper - 0.5 * scale * down - 0.35 * size, size)
    canvas.setLineWidth(0.02)
    for piece, _, ink, _ in sheet.drawn():
        _ink(canvas, ink)
        _polygon(canvas, scale * (piece.cut + sheet.shifts[piece.name] - [0.0, tiling.height]))
    canvas.restoreState()


# --------------------------------------------------------------------------------------------------------------- texts


def _text(
    canvas: Any,
    text: str,
    x: float,
    y: float,
    size: float,
    *,
    font: str = FONT,
    centred: bool = True,
    room: float = 1e9,
) -> None:
    """A line of text with its base line at ``y``, at most ``room`` wide; ``size`` [cm]."""
    font = _font_of(text, font) or font
    size = min(size, room / max(canvas.stringWidth(text, font, 1.0), 1.0))
    canvas.setFont(font, size)
    (canvas.drawCentredString if centred else canvas.drawString)(x, y, text)


def _font_of(text: str, font: str = FONT) -> str | None:
    """``font`` for Latin letters, an Asian font for letters that it has, or ``None``."""
    for encoding, name in {"cp1252": font, **ASIAN_FONTS}.items():
        with contextlib.suppress(UnicodeEncodeError):
            text.encode(encoding)
            return name
    return None


def _names(names: list[str], stem: str) -> list[tuple[str, str]]:
    """Each name as it is drawn, and in Latin letters; plain names where no font has the letters, and for long ones."""
    found = []
    for name, plain in zip(names, plain_names(names, longest=LONGEST_NAME, stem=stem), strict=True):
        font = _font_of(name) if len(name) <= LONGEST_NAME else None
        found.append((name if font else plain, name if font == FONT else plain))
    return found
