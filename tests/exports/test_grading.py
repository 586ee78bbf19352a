"""Graded garments: each size is the pattern of its body, and nests hold the pieces of the single exports."""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from pypdf import PdfReader
from pypdf.generic import ContentStream

from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.exports import dxf, pdf
from gcd_dataset.generator import build_pattern, grade, read_chart
from gcd_dataset.generator.garments import Reject, design_from_dict
from gcd_dataset.generator.svg import nest_svg, pattern_svg
from gcd_dataset.records import Pattern
from gcd_dataset.spec import write_pattern
from tests.exports.dxf_reader import read_dxf
from tests.exports.patterns import exact_area, squares
from tests.generator.garments.measured import lengths
from tests.test_cli import run

SHIRT = {"meta": {"upper": "FittedShirt", "bottom": None}}
TROUSERS = {"meta": {"upper": None, "wb": "StraightWB", "bottom": "Pants"}, "waistband": {"waist": 1.3, "width": 0.2}}
CHART = read_chart("women")
SIZES = ("76", "88", "116")  # the first has darts that the others lack


@pytest.fixture(scope="module")
def shirt() -> dict[str, Pattern]:
    return {size: build_pattern(CHART.body(size), design_from_dict(SHIRT), name="shirt") for size in SIZES}


def test_a_size_is_the_pattern_of_its_body_and_a_rule_rejects_the_others() -> None:
    design = design_from_dict(TROUSERS)
    graded = grade(design, CHART, name="trousers")
    assert list(graded) == list(CHART.bodies)
    for size, found in graded.items():
        body = CHART.body(size)
        if 1.3 * body.waist > body.hips:  # wider at the top than the trunk
            assert isinstance(found, Reject) and found.rule == "slides_off"
        else:
            assert found == build_pattern(body, design, name="trousers")
    assert {type(found) for found in graded.values()} == {Pattern, Reject}


def test_a_body_that_cannot_be_is_named_with_chart_and_size() -> None:
    chart = replace(CHART, bodies={**CHART.bodies, "88": replace(CHART.body("88"), waist=1.0)})
    with pytest.raises(BodyError, match=r"sizes_women\.toml: size 88: waist_back_width is .* correct these measures"):
        grade(design_from_dict(TROUSERS), chart)


def test_the_girth_of_the_waistband_grows_by_the_step_of_the_chart() -> None:
    design = design_from_dict({**TROUSERS, "waistband": {"waist": 1.05, "width": 0.2}})
    girths = []
    for pattern in grade(design, CHART).values():
        assert isinstance(pattern, Pattern)
        girths.append(lengths(pattern, "top", ("wb_front", "wb_back")))
    assert girths[0] == pytest.approx(1.05 * CHART.body("76").waist)
    assert np.diff(girths) == pytest.approx(1.05 * 4.0)


def test_the_layers_of_a_dxf_are_the_sizes_with_their_single_pieces(shirt: dict[str, Pattern], tmp_path: Path) -> None:
    dxf(shirt, tmp_path / "nest.dxf", seam_allowance=1.2)
    nest = read_dxf(tmp_path / "nest.dxf")
    assert len(nest) == sum(len(pattern.panels) for pattern in shirt.values()) + 1
    assert {"Style Name:shirt", "Sample Size:88"} <= set(nest[""].texts("1"))
    inserted = [entity for entity in nest[""].entities if entity.kind == "INSERT"]
    assert list(dict.fromkeys(entity.layer for entity in inserted)) == [f"SIZE_{size}" for size in SIZES]
    places: dict[str, set[tuple[float, float]]] = {}
    for size, pattern in shirt.items():
        dxf(pattern, tmp_path / "single.dxf", seam_allowance=1.2)
        single = read_dxf(tmp_path / "single.dxf")
        of_size = [entity for entity in inserted if entity.layer == f"SIZE_{size}"]
        assert len(of_size) == len(pattern.panels)
        for panel, insert in zip(pattern.panels, of_size, strict=True):
            block, alone = nest[insert.tags[2]], single[panel.name]
            assert {f"Piece Name:{panel.name}", f"Size Name:{size}"} <= set(block.texts("1"))
            [sew] = block.of("14", "POLYLINE")
            assert shapely.Polygon(sew.vertices).area / 100 == pytest.approx(exact_area(panel), rel=1e-3)
            lines = [e for e in block.entities if e.kind != "TEXT"]
            assert lines == [e for e in alone.entities if e.kind != "TEXT"]  # cut, sew, notches, drills, grain
            places.setdefault(panel.name, set()).add(tuple(insert.at.tolist()))
    assert all(len(points) == 1 for points in places.values())  # sizes lie over one another
    assert len(set.union(*places.values())) == len(places)


def test_names_of_sizes_become_layers_in_ascii_and_stay_different(tmp_path: Path) -> None:
    dxf({"M/L": squares(), "m-l": squares(), "大": squares()}, tmp_path / "a.dxf")
    blocks = read_dxf(tmp_path / "a.dxf")
    layers = {entity.layer for entity in blocks[""].entities if entity.kind == "INSERT"}
    assert len(layers) == 3 and len(blocks) == 7
    assert all(re.fullmatch(r"SIZE_[A-Za-z0-9_-]{1,26}", layer) for layer in layers)


def paths_of(node: ElementTree.Element) -> dict[str, list[str]]:
    """Panel to its paths: outline, edges, grain line."""
    tag = "{http://www.w3.org/2000/svg}"
    panels = [group for group in node.iter(f"{tag}g") if "data-panel" in group.attrib]
    return {group.attrib["data-panel"]: [path.attrib["d"] for path in group.iter(f"{tag}path")] for group in panels}


def test_the_groups_of_an_svg_are_the_sizes_with_their_single_panels(shirt: dict[str, Pattern]) -> None:
    root = ElementTree.fromstring(nest_svg(shirt))
    groups = [child for child in root if "data-size" in child.attrib]
    assert [group.attrib["data-size"] for group in groups] == list(SIZES)
    for group, pattern in zip(groups, shirt.values(), strict=True):
        assert paths_of(group) == paths_of(ElementTree.fromstring(pattern_svg(pattern)))
    shown = [node.text for node in root.iter("{http://www.w3.org/2000/svg}text")]
    assert all(shown.count(panel.name) == 1 for panel in shirt["76"].panels)
    assert set(SIZES) <= set(shown)
    transforms = {
        (panel.attrib["data-panel"], panel.attrib["transform"])
        for group in groups
        for panel in group
        if "data-panel" in panel.attrib
    }
    assert len(transforms) == len({panel.name for pattern in shirt.values() for panel in pattern.panels})


def strokes(pattern: Pattern | Mapping[str, Pattern], path: Path) -> list[tuple[bytes, ...]]:
    """The closed, stroked paths of all pieces in a PDF, in the panels' planes: their operators with numbers."""
    pdf(pattern, path, paper="a0", seam_allowance=1.2)
    found, path_now = [], list[bytes]()
    reader = PdfReader(path)
    for page in reader.pages:
        for operands, operator in ContentStream(page.get_contents(), reader).operations:
            if operator in (b"m", b"l", b"c", b"h"):
                path_now = [] if operator == b"m" else path_now
                path_now.append(b" ".join([*(str(value).encode() for value in operands), operator]))
            elif operator == b"S" and len(path_now) > 4:
                found.append(tuple(path_now))
    return found


def test_a_pdf_holds_cut_and_sew_lines_of_every_size(shirt: dict[str, Pattern], tmp_path: Path) -> None:
    nest = set(strokes(shirt, tmp_path / "nest.pdf"))
    for pattern in shirt.values():
        single = set(strokes(pattern, tmp_path / "single.pdf"))
        assert len(single & nest) >= 2 * len(pattern.panels)  # the others are the small map of the pages
    text = "\n".join(page.extract_text() for page in PdfReader(tmp_path / "nest.pdf").pages)
    assert all(text.count(size) >= len(shirt[size].panels) + 1 for size in SIZES)
    assert f"{len(shirt['76'].panels)} pieces on" in text


def test_names_of_sizes_that_no_font_has_are_plain_in_a_pdf(tmp_path: Path) -> None:
    pdf(dict.fromkeys(["كبير", "M", "大", "x" * 500], squares()), tmp_path / "a.pdf")
    text = "\n".join(page.extract_text() for page in PdfReader(tmp_path / "a.pdf").pages)
    assert {"size_1", "M", "大"} <= set(text.split())
    assert "■" not in text and max(map(len, text.split())) <= 60


def test_a_nest_has_a_size(tmp_path: Path) -> None:
    for write, name in ((dxf, "a.dxf"), (pdf, "a.pdf")):
        with pytest.raises(ConfigError, match="a graded garment without sizes: give the pattern of one size"):
            write({}, tmp_path / name)


# ---------------------------------------------------------------------------------------------------------- gcd grade


def design_file(folder: Path, design: Mapping[str, Any]) -> Path:
    (folder / "trousers_design_params.yaml").write_text(json.dumps({"design": design}))
    return folder / "trousers_design_params.yaml"


def test_rejected_sizes_are_named_and_the_others_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "graded"
    assert run("grade", design_file(tmp_path, TROUSERS), "--chart", "women", "--out", out) == 1
    said = capsys.readouterr()
    assert re.findall(r"size (\d+): slides_off: a bottom of", said.err) == list(CHART.bodies)[3:]
    assert said.out == f"{out}: 3 of 12 sizes: specifications, and nests as PDF, DXF and SVG\n"
    specs = [f"trousers_{size}_specification.json" for size in ("76", "80", "84")]
    nests = ["trousers.dxf", "trousers.pdf", "trousers_pattern.svg"]
    assert sorted(path.name for path in out.iterdir()) == sorted([*specs, *nests])
    for size, spec in zip(("76", "80", "84"), specs, strict=True):
        write_pattern(build_pattern(CHART.body(size), design_from_dict(TROUSERS)), tmp_path / "drawn.json")
        assert (out / spec).read_bytes() == (tmp_path / "drawn.json").read_bytes()


def test_a_design_that_no_size_can_wear_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wide = {**TROUSERS, "waistband": {"waist": 2.0}}
    assert run("grade", design_file(tmp_path, wide), "--chart", "men", "--out", tmp_path / "out") == 1
    assert "yaml: rejected in all sizes of " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_specification_without_its_design_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, again = tmp_path / "out", tmp_path / "again"
    assert run("grade", design_file(tmp_path, TROUSERS), "--chart", "women", "--out", out, "--seam-allowance", 2) == 1
    spec = out / "trousers_84_specification.json"
    capsys.readouterr()
    assert run("grade", spec, "--chart", "women", "--out", again) == 1
    error = capsys.readouterr().err
    assert f"{spec}: a specification without its design" in error and "give the design_params.yaml" in error
    assert not again.exists()
    spec.write_text(json.dumps({**json.loads(spec.read_text()), "design": TROUSERS}))
    assert run("grade", spec, "--chart", "women", "--out", again) == 1  # nine sizes are rejected
    assert capsys.readouterr().out.startswith(f"{again}: 3 of 12 sizes")
