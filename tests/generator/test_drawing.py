"""Drawings of patterns, as pictures and as SVG."""

import io
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, pairwise
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from jaxtyping import Float
from PIL import Image

from gcd_dataset.curves import Arc, Cubic, Curve, Quadratic, sample_curve
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drawing import contact_sheet, design_sheet, draw_pattern, jpeg_bytes, picture_of, png_bytes
from gcd_dataset.generator.lay_plan import PAPER, lay_out
from gcd_dataset.generator.svg import LINE_WIDTH, pattern_svg
from gcd_dataset.records import Edge, Panel, Pattern, Placement
from tests.exports.patterns import lined
from tests.helpers import napkins


def is_paper(picture: np.ndarray) -> np.ndarray:
    return np.abs(picture.astype(int) - PAPER).max(axis=2) <= 1


def test_a_pattern_is_drawn_to_scale() -> None:
    """Two panels of 20 × 10 cm cover the same area, side by side, without touching."""
    picture = draw_pattern(napkins(), size=200)
    drawn = [(~is_paper(picture)).any(axis=axis) for axis in (0, 1)]
    columns, rows = (np.diff(np.flatnonzero(np.diff(np.r_[0, one.astype(int), 0])))[::2] for one in drawn)
    assert max(columns.max(), rows.max()) > 80
    assert sorted([len(columns), len(rows)]) == [1, 2]


def test_names_beyond_ascii_are_numbered() -> None:
    """Pillow's font has no other letters: all would be the same box."""
    first, second = napkins().panels

    def drawn(*names: str) -> bytes:
        panels = (replace(first, name=names[0]), replace(second, name=names[1]))
        return draw_pattern(replace(napkins(), panels=panels, seams=()), size=64).tobytes()

    assert drawn("前片", "спинка") == drawn("piece_1", "piece_2")


def test_contact_sheets_place_pictures_and_files_decode_to_them() -> None:
    pictures = [np.full((4, 6, 3), shade, np.uint8) for shade in (10, 20, 30)]
    sheet = contact_sheet(pictures, columns=2, gap=2)
    assert sheet.shape == (10, 14, 3)
    assert [sheet[1, 1, 0], sheet[1, 9, 0], sheet[7, 1, 0], sheet[7, 9, 0]] == [10, 20, 30, 255]
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(png_bytes(sheet)))), sheet)
    assert picture_of(jpeg_bytes(sheet), 5).shape == (5, 5, 3)
    with pytest.raises(ConfigError, match="pictures of one size"):
        contact_sheet([pictures[0], sheet], columns=1)


def test_a_sheet_of_designs_shows_each_under_its_name() -> None:
    patterns = [replace(napkins(), name=name) for name in ("first", "second", "third")]
    sheet = design_sheet(patterns, columns=2, size=64)
    height, width = sheet.shape[0] // 2, sheet.shape[1] // 2
    cells = [sheet[:height, :width], sheet[:height, -width:], sheet[-height:, :width]]
    captions = [cell[:14] for cell in cells]
    assert not any(is_paper(caption).all() for caption in captions)
    assert not np.array_equal(captions[0][:, :64], captions[1][:, -64:])
    assert np.array_equal(sheet[-64:, :64], draw_pattern(patterns[2], size=64))


SVG = "{http://www.w3.org/2000/svg}"
TOLERANCE = 2e-6  # cm: numbers have six decimals
NOWHERE = Placement(np.zeros(3), np.zeros(3))


class Piece(NamedTuple):
    """A panel parsed from a drawing."""

    name: str
    cloth: str
    edges: tuple[ElementTree.Element, ...]
    texts: tuple[ElementTree.Element, ...]
    grain: str
    matrix: tuple[float, ...]


def read_back(pattern: Pattern) -> tuple[ElementTree.Element, list[Piece]]:
    root = ElementTree.fromstring(pattern_svg(pattern))
    return root, [_piece(group) for group in root.findall(f"{SVG}g")]


def _piece(group: ElementTree.Element) -> Piece:
    paths = group.findall(f"{SVG}path")
    [cloth] = [path.get("d", "") for path in paths if path.get("fill")]
    [grain] = [path.get("d", "") for path in paths if path.get("class") == "grain"]
    edges = tuple(path for path in paths if path.get("data-edge"))
    texts = tuple(group.findall(f"{SVG}text"))
    return Piece(group.get("data-panel", ""), cloth, edges, texts, grain, matrix(group))


def matrix(node: ElementTree.Element) -> tuple[float, ...]:
    found = re.fullmatch(r"matrix\((.*)\)", node.get("transform", ""))
    assert found
    return tuple(float(number) for number in found[1].split())


def flattened(path: str, count: int = 400) -> Float[np.ndarray, "n 2"]:
    """Points along a path of M, L, Q, C, A and Z, by the rules of the SVG specification."""
    return np.concatenate(list(_strokes(path, count)))


def _strokes(path: str, count: int) -> Iterator[Float[np.ndarray, "n 2"]]:
    pen, t = np.zeros(2), np.linspace(0, 1, count)[:, None]
    for letter, text in re.findall(r"([MLQCAZ])([^MLQCAZ]*)", path):
        numbers = np.array([float(number) for number in text.split()])
        match letter:
            case "M":
                yield numbers[None]
            case "L":
                yield pen + t * (numbers - pen)
            case "Q" | "C":
                points = [pen, *numbers.reshape(-1, 2)]
                while len(points) > 1:
                    points = [(1 - t) * a + t * b for a, b in pairwise(points)]
                yield points[0]
            case "A":
                yield _arc(pen, numbers, t)
        pen = numbers[-2:] if len(numbers) else pen


def _arc(pen: Float[np.ndarray, "2"], numbers: Float[np.ndarray, "7"], t: Float[np.ndarray, "n 1"]) -> np.ndarray:
    """A circular arc: SVG 1.1, appendix F.6.5."""
    radius, same, _, large, sweep = numbers[:5]
    assert radius == same
    half = 0.5 * (pen - numbers[5:])
    square = max(radius**2 / (half @ half) - 1, 0.0)
    offset = np.sqrt(square) * (1 if large != sweep else -1) * np.array([half[1], -half[0]])
    centre = offset + 0.5 * (pen + numbers[5:])
    first, last = (np.arctan2(*(side - offset)[::-1]) for side in (half, -half))
    turn = (last - first) % (2 * np.pi) - (0 if sweep else 2 * np.pi)
    angles = first + t * turn
    return centre + radius * np.concatenate([np.cos(angles), np.sin(angles)], axis=1)


def lens(curve: Curve, *, clockwise: bool = False) -> Panel:
    """A chord of 20 cm under a curve."""
    corners = np.array([[3.0, 4.0], [23.0, 4.0], [13.0, -9.0]])
    edges = (Edge(0, 2), Edge(2, 1), Edge(1, 0, curve))
    if clockwise:
        corners = corners * [-1, 1]
    return Panel("lens", corners, edges, NOWHERE)


CURVES: list[Curve] = [
    Quadratic((0.3, 0.4)),
    Cubic((0.2, 0.5), (0.9, 0.3)),
    *(Arc(radius, large, right) for radius in (10.0, 12.5) for large in (False, True) for right in (False, True)),
]


@pytest.mark.parametrize("curve", CURVES, ids=str)
@pytest.mark.parametrize("clockwise", [False, True])
def test_a_curve_is_drawn_with_its_own_command(curve: Curve, clockwise: bool) -> None:
    panel = lens(curve, clockwise=clockwise)
    _, [piece] = read_back(Pattern("one", (panel,), ()))
    path = piece.edges[2].get("d", "")
    assert {"quadratic": "Q", "cubic": "C", "circle": "A"}[curve.kind] in path
    truth = sample_curve(*panel.edge_ends(2), curve, 2000)
    drawn = flattened(path)
    assert drawn[0] == pytest.approx(truth[0], abs=TOLERANCE)
    assert drawn[-1] == pytest.approx(truth[-1], abs=TOLERANCE)
    far = shapely.hausdorff_distance(shapely.LineString(drawn), shapely.LineString(truth))
    assert far < 0.01  # both are polylines


def assert_true_to_scale(pattern: Pattern) -> None:
    """Assert scale, positions and margins of a drawing."""
    root, pieces = read_back(pattern)
    assert [piece.name for piece in pieces] == [panel.name for panel in pattern.panels]
    width, height = (float(number) for number in root.get("viewBox", "").split()[2:])
    assert (root.get("width"), root.get("height")) == (f"{width:.10g}cm", f"{height:.10g}cm")
    placed = []
    for panel, placed_panel, piece in zip(pattern.panels, lay_out(pattern).panels, pieces, strict=True):
        for index, edge in enumerate(piece.edges):
            ends = flattened(edge.get("d", ""))[[0, -1]]
            assert ends == pytest.approx(np.array(panel.edge_ends(index)), abs=TOLERANCE)
        cloth, truth = shapely.Polygon(flattened(piece.cloth)), shapely.Polygon(placed_panel.outline)
        assert cloth.area == pytest.approx(truth.area, rel=5e-3)
        assert piece.matrix[:4] == (1, 0, 0, -1)  # true to scale, upright, not mirrored
        sheet = flattened(piece.cloth) * [1, -1] + piece.matrix[4:]
        placed.append(shapely.Polygon(sheet).envelope)
        assert cloth.buffer(1e-6).contains(shapely.LineString(flattened(piece.grain.split(" M")[0])))
    margins = (1, 1, width - 1, height - 1)  # of 1 cm
    assert shapely.unary_union(placed).bounds == pytest.approx(margins, abs=0.05)
    assert not any(one.intersects(other) for one, other in combinations(placed, 2))


def test_a_pattern_is_drawn_at_true_scale_without_overlap() -> None:
    assert_true_to_scale(napkins())
    assert_true_to_scale(Pattern("one", (lens(CURVES[0]), replace(lens(CURVES[1]), name="other")), ()))


def test_both_edges_of_a_seam_carry_its_colour_and_number() -> None:
    pattern = napkins()
    _, pieces = read_back(pattern)
    marked = {
        (piece.name, int(edge.get("data-edge", ""))): (edge.get("data-seam"), edge.get("stroke"))
        for piece in pieces
        for edge in piece.edges
    }
    for number, seam in enumerate(pattern.seams):
        left, right = (marked.pop((side.panel, side.edge)) for side in (seam.left, seam.right))
        assert left == right
        assert left[0] == str(number)
    assert {seam for seam, _ in marked.values()} == {None}
    numbers = Counter(text.text for piece in pieces for text in piece.texts)
    assert all(numbers[str(number)] == 2 for number in range(len(pattern.seams)))


def test_a_line_is_drawn_thin_with_its_role_and_seam() -> None:
    pattern = lined()
    assert_true_to_scale(pattern)
    _, [piece, _] = read_back(pattern)
    line, half_circle = piece.edges[4:]
    assert (line.get("data-role"), line.get("data-seam")) == ("fold", "1")
    assert (half_circle.get("data-role"), half_circle.get("data-seam")) == ("stitch", None)
    assert float(line.get("stroke-width", "1")) < LINE_WIDTH


@pytest.mark.parametrize("clockwise", [False, True])
def test_texts_stand_upright_on_the_cloth(clockwise: bool) -> None:
    pattern = napkins()
    if clockwise:
        turned = tuple(replace(panel, vertices=panel.vertices * [-1, 1]) for panel in pattern.panels)
        pattern = replace(pattern, panels=turned)
    _, pieces = read_back(pattern)
    for piece in pieces:
        cloth = shapely.Polygon(flattened(piece.cloth))
        assert piece.texts[0].text == piece.name
        for text in piece.texts:
            assert matrix(text)[:4] == piece.matrix[:4] == (1, 0, 0, -1)  # mirrored twice
            assert cloth.contains(shapely.Point(matrix(text)[4:]))


def test_the_grain_runs_along_the_y_axis() -> None:
    _, [piece] = read_back(Pattern("one", (lens(CURVES[0]),), ()))
    (x0, y0), (x1, y1) = flattened(piece.grain.split(" M")[0])[[0, -1]]
    assert x0 == x1
    assert y1 - y0 > 2


@pytest.mark.parametrize("name", ["a<b>&\"'", "\x01\x00", "\ud800", "", "Ärmel"])
def test_a_drawing_with_any_name_can_be_parsed(name: str) -> None:
    _, [piece] = read_back(Pattern(name, (replace(lens(CURVES[0]), name=name),), ()))
    assert piece.name == (name if name.isprintable() else ascii(name))
