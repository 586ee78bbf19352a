"""PDF files, read back from their content streams: areas, scale, pages that fit together."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from pypdf import PdfReader
from pypdf.generic import ContentStream

from gcd_dataset.curves import Arc, Cubic, Curve, Quadratic, curve_points
from gcd_dataset.errors import ConfigError
from gcd_dataset.exports import pdf
from gcd_dataset.exports.pdf_file import PAPERS, Page, bezier_pieces, paper_named, tile
from gcd_dataset.records import Pattern, Sample
from tests.exports.patterns import NAMES, exact_area, named, quarter_circle, squares
from tests.generator.mesh.shapes import panel
from tests.pleats import pleated_square

CM = 2.54 / 72
STEPS = np.linspace(0.0, 1.0, 65)[1:, None]


@dataclass
class Path2D:
    """A painted path [cm on the page]."""

    points: np.ndarray
    curves: int
    dashed: bool
    closed: bool


def painted(page: Any, reader: PdfReader) -> Iterator[Path2D]:
    """The stroked paths of a page."""
    matrix, stack, dashed = np.eye(3), [], False
    points: list[np.ndarray] = []
    curves, closed = 0, False
    for operands, operator in ContentStream(page.get_contents(), reader).operations:
        numbers = [float(value) for value in operands if not isinstance(value, list | str)]
        match operator.decode():
            case "q":
                stack.append((matrix, dashed))
            case "Q":
                matrix, dashed = stack.pop()
            case "cm":
                a, b, c, d, e, f = numbers
                matrix = np.array([[a, b, 0], [c, d, 0], [e, f, 1]]) @ matrix
            case "d":
                dashed = bool(operands[0])
            case "m":
                points, curves, closed = [on_page(numbers, matrix)], 0, False
            case "l":
                points.append(on_page(numbers, matrix))
            case "c":
                p1, p2, p3 = (on_page(numbers[i : i + 2], matrix) for i in (0, 2, 4))
                p0 = points[-1]
                at = (1 - STEPS) ** 3 * p0 + 3 * STEPS * (1 - STEPS) ** 2 * p1 + 3 * STEPS**2 * (1 - STEPS) * p2
                points += list(at + STEPS**3 * p3)
                curves += 1
            case "re":
                x, y, w, h = numbers
                corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
                points, curves, closed = [on_page(corner, matrix) for corner in corners], 0, True
            case "h":
                closed = True
            case "S" | "s":
                yield Path2D(CM * np.array(points), curves, dashed, closed or operator == b"s")
            case _:
                pass


def on_page(point: Any, matrix: np.ndarray) -> np.ndarray:
    return (np.array([*point, 1.0]) @ matrix)[:2]


def sew_lines(page: Any, reader: PdfReader) -> list[Path2D]:
    return [path for path in painted(page, reader) if path.dashed and path.closed]


def label(page: Any) -> Page:
    found = re.search(r"([A-Z])(\d+)\s+page \d+ of", page.extract_text())
    assert found
    return Page(ord(found[1]) - ord("A"), int(found[2]) - 1)


def read(pattern: Pattern | Sample, path: Path, **options: Any) -> PdfReader:
    pdf(pattern, path / "read.pdf", **options)
    return PdfReader(path / "read.pdf")


def test_sew_lines_have_the_areas_of_the_panels(patterns: tuple[Pattern, ...], tmp_path: Path) -> None:
    for pattern in patterns:
        reader, found = read(pattern, tmp_path, seam_allowance=1.2, paper="a0"), {}
        for page in reader.pages:
            for line in sew_lines(page, reader):
                found[round(shapely.Polygon(line.points).area, 3)] = line
        exact = np.array([exact_area(panel) for panel in pattern.panels])
        error = np.abs(np.array(sorted(found))[:, None] / exact - 1)
        assert error.min(axis=1).max() < 3e-4  # each line is a panel
        assert error.min(axis=0).max() < 3e-4  # each panel has a line


def test_curves_are_bezier_curves(tmp_path: Path) -> None:
    reader = read(quarter_circle(), tmp_path)
    line = sew_lines(reader.pages[1], reader)[0]
    assert line.curves == 3  # 30° each


def test_folds_are_dashed_and_other_lines_are_not(tmp_path: Path) -> None:
    pressed, (skirt, band) = pleated_square(), pleated_square().panels
    flat = replace(skirt, lines=tuple(replace(line, angle=0.0) for line in skirt.lines))

    def dashed(pattern: Pattern) -> int:
        reader = read(pattern, tmp_path, paper="a0")
        return sum(path.dashed for page in reader.pages for path in painted(page, reader))

    sewn = pressed.seams[:2]  # layers of a stack are none without folds
    assert dashed(pressed) == dashed(replace(pressed, panels=(flat, band), seams=sewn)) + 2


@pytest.mark.long
def test_pages_fit_together(worn: Sample, tmp_path: Path) -> None:
    """On all pages that show a piece it has one place on the sheet, to 0.02 mm, and the pages show all of it."""
    reader = read(worn, tmp_path)
    (across, down), (width, height) = PAPERS["a4"].cell, PAPERS["a4"].window
    places: list[tuple[np.ndarray, Path2D]] = []
    windows, shown = [], 0
    for page in reader.pages[1:]:
        at = label(page)
        shift = np.array([at.column * across, -at.row * down])
        windows.append(shapely.affinity.translate(shapely.box(1.0, 1.0, 1.0 + width, 1.0 + height), *shift))
        for line in sew_lines(page, reader):
            line.points += shift
            middle = 0.5 * (line.points.min(axis=0) + line.points.max(axis=0))
            shown += 1
            distances = [np.abs(middle - known).max() for known, _ in places]
            assert not any(0.002 < distance < 1.0 for distance in distances)
            if not any(distance <= 0.002 for distance in distances):
                places.append((middle, line))
    assert len(places) == len(worn.pattern.panels) < shown
    printed = shapely.union_all(windows)
    assert all(printed.covers(shapely.LineString(line.points)) for _, line in places)


@pytest.mark.parametrize("paper", ["a4", "letter", "a0"])
def test_the_test_square_has_sides_of_ten_centimetres(paper: str, tmp_path: Path) -> None:
    reader = read(squares(), tmp_path, paper=paper)
    page = reader.pages[0]
    size = PAPERS[paper]
    assert [float(page.mediabox.width) * CM, float(page.mediabox.height) * CM] == pytest.approx(
        [size.width, size.height]
    )
    boxes = [np.ptp(path.points, axis=0) for path in painted(page, reader) if len(path.points) == 4]
    assert any(box == pytest.approx([10.0, 10.0], abs=1e-4) for box in boxes)
    assert bool(sew_lines(page, reader)) == (paper == "a0")  # a large sheet holds the legend beside the pieces


def test_three_squares_lie_in_two_rows_on_narrow_cloth_and_in_one_on_wide(tmp_path: Path) -> None:
    """Squares of 42 cm with their allowance: 110 cm has room for two of them, 140 cm for three."""
    text = read(named("a", "b", "c"), tmp_path).pages[0].extract_text()
    assert "in one layer: 84 cm at 110 cm, 42 cm at 140 cm, 42 cm at 150 cm" in text
    wide = Pattern("wide", (panel("wide", [(0, 0), (120, 0), (120, 20), (0, 20)]),), ())
    text = read(wide, tmp_path).pages[0].extract_text()
    assert "too narrow at 110 cm, 22 cm at 140 cm" in text


def test_pages_name_pieces_neighbours_and_seams(tmp_path: Path) -> None:
    reader = read(squares(), tmp_path)
    texts = [page.extract_text() for page in reader.pages]
    assert "2 pieces on" in texts[0]
    assert "one: 42.0 × 42.0 cm" in texts[0]
    assert "glue A2 here" in texts[1]
    assert "to A1" in texts[2]
    assert any("cut 1, right side up" in text for text in texts[1:])


def test_names_in_any_script_are_drawn_or_numbered_and_all_are_bookmarks(tmp_path: Path) -> None:
    reader = read(named(*NAMES, title="连衣裙 👗"), tmp_path, paper="a0")
    assert {entry.title for entry in reader.outline if not isinstance(entry, list)} == set(NAMES)
    assert reader.metadata is not None and reader.metadata.title == "连衣裙 👗"
    text = "\n".join(page.extract_text() for page in reader.pages)
    listed = [line.partition(": 42.0")[0].strip() for line in text.splitlines() if ": 42.0 × 42.0 cm" in line]
    assert len(set(listed)) == len(NAMES)
    drawn = ("Cós esquerdo", "piece_5 (前片)", "piece_7 (перед)", "piece_9 (앞판)", "piece_10", "piece_11")
    assert set(drawn) <= set(listed)
    assert "?" not in text


def test_a_long_name_stays_in_its_piece(tmp_path: Path) -> None:
    assert "x" * 58 + "_1" in read(named("x" * 300, "y"), tmp_path, paper="a0").pages[0].extract_text()


def test_every_page_shows_cloth_and_no_cloth_is_missing() -> None:
    """An L of cloth leaves the pages of its open side out."""
    cloth = shapely.box(0, 0, 100, 100) - shapely.box(30, 30, 100, 100)
    found = tile(np.array([[100.0, 100.0]]), [cloth], paper_named("a4"))
    across, down = found.paper.cell
    width, height = found.paper.window
    cells = {}
    for page in found.pages:
        x, y = found.origin(page)
        cells[page] = shapely.box(x, y - height, x + width, y)
    placed = shapely.affinity.translate(cloth, *found.corners[0])
    assert shapely.union_all(list(cells.values())).buffer(1e-6).covers(placed)
    assert all(cell.intersects(placed) for cell in cells.values())
    assert len(found.pages) < found.rows * found.columns
    assert (found.columns - 1) * across < 100 and (found.rows - 1) * down < 100


def test_a_piece_as_wide_as_the_window_takes_one_column() -> None:
    width, height = PAPERS["a4"].window
    found = tile(np.array([[width, height]]), [shapely.box(0, 0, width, height)], paper_named("A4"))
    assert found.pages == (Page(0, 0),)


@pytest.mark.parametrize(
    "curve",
    [
        Quadratic((0.4, 0.3)),
        Cubic((0.2, 0.4), (0.7, -0.3)),
        Arc(60.0, large=False, right=True),
        Arc(60.0, large=True, right=False),
    ],
)
def test_bezier_pieces_follow_the_curve(curve: Curve) -> None:
    """To 0.01 mm for arcs of 60 cm."""
    start, end = (3.0, 4.0), (53.0, 14.0)
    exact = shapely.LineString(curve_points(start, end, curve, np.linspace(0, 1, 20001)))
    pieces = bezier_pieces(start, end, curve)
    for (p0, *_), (c0, c1, p3) in zip([(start,), *((piece[2],) for piece in pieces)], pieces, strict=False):
        points = [np.array(p) for p in (p0, c0, c1, p3)]
        for t in np.linspace(0, 1, 21):
            level = points
            while len(level) > 1:
                level = [(1 - t) * a + t * b for a, b in pairwise(level)]
            assert exact.distance(shapely.Point(level[0])) < 1e-3
    assert pieces[-1][2] == end


def test_errors_name_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"end its name in \.pdf"):
        pdf(squares(), tmp_path / "a.dxf")
    with pytest.raises(ConfigError, match="no paper a44: choose from a4, letter, a3, a1, a0: did you mean a4"):
        pdf(squares(), tmp_path / "a.pdf", paper="a44")
    assert not list(tmp_path.iterdir())
