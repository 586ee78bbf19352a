"""Tiling of a sheet with pages: which part of the sheet each page shows, and which pages are printed.

Pages overlap: each shows its cell of the sheet, and beyond the cell's right and lower border a strip that the
neighbouring page covers when both are glued. Rows have letters from the top, columns have numbers from the left.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.errors import ConfigError, did_you_mean
from gcd_dataset.exports.packing import pack

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
    name: Paper(name, width, height)
    for name, width, height in (
        ("a4", 21.0, 29.7),
        ("letter", 21.59, 27.94),
        ("a3", 29.7, 42.0),
        ("a1", 59.4, 84.1),
        ("a0", 84.1, 118.9),
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
    width: float
    height: float
    """Size of the sheet [cm]."""
    rows: int
    columns: int
    pages: tuple[Page, ...]
    """The pages with a piece, row by row."""

    def origin(self, page: Page) -> tuple[float, float]:
        """Upper left corner of a page's cell on the sheet [cm]."""
        across, down = self.paper.cell
        return page.column * across, self.height - page.row * down


def tile(sizes: Float[np.ndarray, "p 2"], shapes: Sequence[shapely.Geometry], paper: Paper) -> Tiling:
    """The tiling with the fewest pages.

    ``sizes``: bounding boxes of the pieces [cm]; ``shapes``: their cloth, relative to the lower left corners of the
    boxes. A page that shows no cloth is not printed.
    """
    least = _columns(float(sizes[:, 0].max()), paper)
    found = [_tiling(sizes, shapes, paper, columns) for columns in range(least, max(MOST_COLUMNS, least) + 1)]
    return min(found, key=lambda tiling: (len(tiling.pages), tiling.rows * tiling.columns))


def _columns(width: float, paper: Paper) -> int:
    """Number of columns for a sheet of this width: the last page may use its overlap."""
    return max(1, int(np.ceil((width - OVERLAP) / paper.cell[0] - 1e-9)))


def _tiling(sizes: Float[np.ndarray, "p 2"], shapes: Sequence[shapely.Geometry], paper: Paper, columns: int) -> Tiling:
    across, down = paper.cell
    width = columns * across + OVERLAP
    corners, height = pack(sizes, width=width, gap=GAP)
    rows = max(1, int(np.ceil((height - OVERLAP) / down - 1e-9)))
    placed = [
        shapely.affinity.translate(shape, *corner) for shape, corner in zip(shapes, corners.tolist(), strict=True)
    ]
    tree = shapely.STRtree(placed)
    pages = []
    for row in range(rows):
        for column in range(columns):
            right = column * across + (across if column + 1 < columns else across + OVERLAP)
            top = height - row * down
            bottom = top - (down if row + 1 < rows else down + OVERLAP)
            if len(tree.query(shapely.box(column * across, bottom, right, top), predicate="intersects")):
                pages.append(Page(row, column))
    return Tiling(paper, corners, width, height, rows, columns, tuple(pages))
