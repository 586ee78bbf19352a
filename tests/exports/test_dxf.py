"""DXF files, read back by a reader of tags and by ezdxf."""

import re
import sys
from datetime import date
from pathlib import Path
from typing import Any

import ezdxf.filemanagement
import numpy as np
import pytest
import shapely

from gcd_dataset.errors import ConfigError, ExtraMissing
from gcd_dataset.exports import dxf, pdf
from gcd_dataset.records import Pattern, Sample
from tests.exports.dxf_reader import Block, layers_of, read_dxf
from tests.exports.patterns import NAMES, SIDE, darted, exact_area, lined, named, square, squares
from tests.generator.mesh import shapes

ALLOWED = {
    "1": {"POLYLINE", "TEXT"},
    "2": {"POINT"},
    "3": {"POINT"},
    "4": {"POINT"},
    "6": {"LINE"},
    "7": {"LINE"},
    "13": {"POINT"},
    "14": {"POLYLINE"},
    "15": {"TEXT"},
}
"""Layer to entities: D6673 forbids polylines on layers 5, 6, 7, 9, 10 and 13."""


def test_sew_lines_have_the_areas_of_the_panels(patterns: tuple[Pattern, ...], tmp_path: Path) -> None:
    for pattern in patterns:
        dxf(pattern, tmp_path / "a.dxf", seam_allowance=1.2)
        blocks = read_dxf(tmp_path / "a.dxf")
        assert len(blocks) == len(pattern.panels) + 1
        for panel, block in zip(pattern.panels, list(blocks.values())[: len(pattern.panels)], strict=True):
            [sew] = block.of("14", "POLYLINE")
            [cut] = block.of("1", "POLYLINE")
            assert sew.tags[70] == cut.tags[70] == "1"  # closed
            sewn, cloth = shapely.Polygon(sew.vertices), shapely.Polygon(cut.vertices)
            assert sewn.area / 100 == pytest.approx(exact_area(panel), rel=1e-3)
            assert cloth.buffer(0.02).contains(sewn)
            assert set(layers_of(block)) <= set(ALLOWED)
            assert all(kinds <= ALLOWED[layer] for layer, kinds in layers_of(block).items())


def test_every_vertex_is_a_turn_or_a_curve_point(patterns: tuple[Pattern, ...], tmp_path: Path) -> None:
    for pattern in patterns:
        dxf(pattern, tmp_path / "a.dxf")
        for block in read_dxf(tmp_path / "a.dxf").values():
            if block.name:
                vertices = {v for layer in ("1", "14") for v in block.of(layer, "POLYLINE")[0].vertices}
                points = {tuple(e.at.tolist()) for layer in ("2", "3") for e in block.of(layer, "POINT")}
                assert points == vertices
    square_block = read_of(squares(), tmp_path)["one"]
    assert len(square_block.of("2", "POINT")) == 8
    assert not square_block.of("3", "POINT")


def read_of(pattern: Pattern | Sample, folder: Path) -> dict[str, Block]:
    dxf(pattern, folder / "read.dxf")
    return read_dxf(folder / "read.dxf")


def test_marks_of_a_piece(tmp_path: Path) -> None:
    block = read_of(darted(), tmp_path)["front"]
    [cut] = block.of("1", "POLYLINE")
    ring, cloth = shapely.LinearRing(cut.vertices), shapely.Polygon(cut.vertices)
    notches = block.of("4", "POINT")
    assert len(notches) == 2
    for notch in notches:
        angle = np.radians(float(notch.tags[50]))
        assert ring.distance(shapely.Point(notch.at)) < 0.02
        assert cloth.contains(shapely.Point(notch.at + [np.cos(angle), np.sin(angle)]))
        assert float(notch.tags[30]) == 5.0  # mm: half the allowance
    [grain] = block.of("7", "LINE")
    assert grain.at[0] == grain.end[0]  # along the y axis
    assert grain.end[1] - grain.at[1] > 100
    assert len(block.of("13", "POINT")) == 1
    assert "Piece Name:front" in block.texts("1")
    assert {"front", "cut 1"} <= set(block.texts("15"))


def test_a_fold_is_a_mirror_line(tmp_path: Path) -> None:
    block = read_of(Pattern("folded", (square("half", fold=3),), ()), tmp_path)["half"]
    [line] = block.of("6", "LINE")
    assert {tuple(line.at.tolist()), tuple(line.end.tolist())} == {(0.0, 0.0), (0.0, 10 * SIDE)}
    [cut] = block.of("1", "POLYLINE")
    assert np.array(cut.vertices)[:, 0].min() == 0.0


def test_lines_inside_a_piece_have_a_layer_of_their_own(tmp_path: Path) -> None:
    block = read_of(lined(), tmp_path)["one"]
    diagonal, half_circle = (shapely.LineString(line.vertices) for line in block.of("8", "POLYLINE"))
    assert diagonal.equals(shapely.LineString([(0, 0), (10 * SIDE, 10 * SIDE)]))
    assert half_circle.length == pytest.approx(50 * np.pi, rel=1e-3)
    assert "1" in block.texts("15")  # the number of the seam on the diagonal
    assert len(block.of("4", "POINT")) == len(read_of(squares(), tmp_path)["one"].of("4", "POINT"))  # none on a line


def test_style_and_size_are_those_of_the_sample(worn: Sample, tmp_path: Path) -> None:
    dxf(worn, tmp_path / "a.dxf", created=date(2026, 11, 23))
    blocks = read_dxf(tmp_path / "a.dxf")
    style = blocks[""].texts("1")
    assert {
        f"Style Name:{worn.pattern.name}",
        "Creation Date:23-11-2026",
        "Units:METRIC",
        "Sample Size:neutral",
    } <= set(style)
    assert all("Size Name:neutral" in block.texts("1") for name, block in blocks.items() if name)
    inserted = [entity.tags[2] for entity in blocks[""].of("1", "INSERT")]
    assert inserted == [name for name in blocks if name]


def test_ezdxf_finds_no_fault_and_the_pieces_lie_apart(worn: Sample, tmp_path: Path) -> None:
    dxf(worn, tmp_path / "a.dxf")
    document = ezdxf.filemanagement.readfile(tmp_path / "a.dxf")
    assert document.dxfversion == "AC1009"
    assert not document.audit().errors
    cloth = []
    inserted: list[Any] = list(document.modelspace().query("INSERT"))
    for insert in inserted:
        [cut] = [e for e in insert.virtual_entities() if e.dxftype() == "POLYLINE" and e.dxf.layer == "1"]
        cloth.append(shapely.Polygon([(p.x, p.y) for p in cut.points()]))
    assert len(cloth) == len(worn.pattern.panels)
    assert all(a.distance(b) > 19.0 for i, a in enumerate(cloth) for b in cloth[:i])  # mm


def test_names_are_plain_and_different_and_notes_hold_the_own_ones(tmp_path: Path) -> None:
    blocks = read_of(named(*NAMES, title="Größe 38"), tmp_path)
    names = [name for name in blocks if name]
    pieces = [text for name in names for text in blocks[name].texts("1") if text.startswith("Piece Name:")]
    assert len({name.upper() for name in names}) == len({text.upper() for text in pieces}) == len(NAMES)
    assert all(len(name) <= 31 and name.isascii() for name in names)
    assert all(re.search("[A-Za-z]", text.partition(":")[2]) for text in pieces)
    assert "Piece Name:Cos esquerdo" in blocks["Cos_esquerdo"].texts("1")
    assert "Style Name:Grosse 38" in blocks[""].texts("1")
    assert blocks["piece_5"].texts("15")[2] == r"\U+524D\U+7247"
    notes = {decoded(text) for name in names for text in blocks[name].texts("15")}
    assert {name[:36] for name in NAMES} <= notes


def decoded(text: str) -> str:
    """The text with UTF-16 units in place of \\U+XXXX, as CAD programs show it."""
    units = re.sub(r"\\U\+([0-9A-F]{4})", lambda found: chr(int(found[1], 16)), text)
    return units.encode("utf-16-le", "surrogatepass").decode("utf-16-le")


def test_equal_patterns_give_equal_bytes(tmp_path: Path) -> None:
    for write, ending in ((dxf, "dxf"), (pdf, "pdf")):
        files = [tmp_path / f"{name}.{ending}" for name in "ab"]
        for file in files:
            write(squares(), file)
        assert files[0].read_bytes() == files[1].read_bytes()


def test_small_pieces_keep_their_texts_small(tmp_path: Path) -> None:
    corners = [(0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0)]
    tab = Pattern("tab", (square("cloth"), shapes.panel("tab_of_the_left_front_pocket", corners)), ())
    block = read_of(tab, tmp_path)["tab_of_the_left_front_pocket"]
    [name] = [entity for entity in block.of("15", "TEXT") if entity.tags[1].startswith("tab")]
    assert float(name.tags[40]) * 0.6 * len(name.tags[1]) < 60.0


def test_errors_name_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"a\.pdf: the file is DXF: end its name in \.dxf"):
        dxf(squares(), tmp_path / "a.pdf")
    monkeypatch.setitem(sys.modules, "ezdxf.document", None)
    with pytest.raises(ExtraMissing, match=r"ezdxf is not installed: run pip install 'gcd-dataset\[export\]'"):
        dxf(squares(), tmp_path / "a.dxf")
    assert not list(tmp_path.iterdir())
