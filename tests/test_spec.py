"""Specification files: a pattern survives writing and reading."""

import errno
import json
import os
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic
from gcd_dataset.errors import SpecError
from gcd_dataset.records import Closure, Edge, EdgeRef, InnerLine, LineRole, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import (
    euler_angles,
    panel_order,
    pattern_from_spec,
    read_pattern,
    spec_from_pattern,
    write_pattern,
)
from tests.generator.mesh import shapes
from tests.pleats import pleated_square
from tests.test_tensors import outline


def square(name: str, *, x: float = 0.0, z: float = 0.0, curves: tuple[Curve, ...] = (LINE,) * 4) -> Panel:
    bent = shapes.panel(name, shapes.rectangle(20, 30), curves=dict(enumerate(curves)), at=(x, 60.0, z))
    return replace(bent, label="leg")


def tube() -> Pattern:
    """Two panels with every kind of curve and label, one seam turned over."""
    curves = (Quadratic((0.5, -0.1)), Cubic((0.3, 0.02), (0.7, -0.03)), Arc(25.0, False, True), LINE)
    front = square("front", z=12.0, curves=curves)
    front = replace(front, edges=(replace(front.edges[0], label="lower_interface"), *front.edges[1:]))
    seams = (Seam(EdgeRef("front", 1), EdgeRef("back", 3)), Seam(EdgeRef("front", 3), EdgeRef("back", 1), True))
    return Pattern("tube", (square("back", z=-12.0), front), seams, {"parameters": {"a": 1}, "parameter_order": ["a"]})


def parsed(pattern: Pattern) -> dict[str, Any]:
    spec: dict[str, Any] = json.loads(json.dumps(spec_from_pattern(pattern)))
    return spec


def closing(pattern: Pattern, *closures: tuple[Closure | str, tuple[float, float]]) -> Pattern:
    """The pattern with closures of its first seams."""
    named = [replace(s, closure=how, closed=part) for s, (how, part) in zip(pattern.seams, closures, strict=False)]
    return replace(pattern, seams=(*named, *pattern.seams[len(named) :]))


CLOSURES = [(Closure.ZIP, (0.25, 1.0)), (Closure.OPEN, (0.0, 1.0)), ("velcro", (0.0, 1.0)), (Closure.SEWN, (0.0, 0.2))]


@pytest.mark.parametrize("first", CLOSURES)
def test_closures_survive_writing_and_reading(first: tuple[Closure | str, tuple[float, float]]) -> None:
    pattern = closing(tube(), first, (Closure.BUTTONS, (0.1, 0.9)))
    assert pattern_from_spec(parsed(pattern), "tube").seams == pattern.seams
    spec = parsed(pattern)
    del spec["properties"]["normalized_edge_loops"]  # loops begin elsewhere, and the edges have other numbers
    for panel in spec["pattern"]["panels"].values():
        panel["edges"] = panel["edges"][1:] + panel["edges"][:1]
    moved = pattern_from_spec(spec, "tube").seams
    assert [(seam.closure, seam.closed) for seam in moved] == [first, (Closure.BUTTONS, (0.1, 0.9))]


roles = st.sampled_from([*LineRole, "pleat"])
ends = st.integers(0, 5)


@given(st.lists(st.builds(InnerLine, ends, ends, st.sampled_from([LINE, Quadratic((0.5, 0.2))]), roles), max_size=3))
def test_lines_and_their_seams_survive(lines: list[InnerLine]) -> None:
    """The stitches that other readers see name edges alone."""
    pattern = closing(tube(), (Closure.SEWN, (0.0, 0.5)))
    back = replace(pattern.panel("back"), lines=tuple(lines))
    back = replace(back, vertices=np.concatenate([back.vertices, [[5.0, 5.0], [9.0, 9.0]]]))
    joins = [Seam(EdgeRef("back", 4 + i), EdgeRef("front", 0), i == 1, Closure.BUTTONS) for i in range(len(lines))]
    seams = (*joins[:1], *pattern.seams, *joins[1:])
    pattern = replace(pattern, panels=(back, pattern.panels[1]), seams=seams)
    spec = parsed(pattern)
    assert pattern_from_spec(spec, "tube", source="") == replace(pattern, extra=pattern_from_spec(spec, "tube").extra)
    assert all(side["edge"] < 4 for stitch in spec["pattern"]["stitches"] for side in stitch[:2])
    assert ("line_stitches" in spec["pattern"]) == bool(lines)
    del spec["properties"]["normalized_edge_loops"]
    for entry in spec["pattern"]["panels"].values():
        entry["edges"] = entry["edges"][1:] + entry["edges"][:1]
    assert pattern_from_spec(spec, "tube").panel("back").lines == back.lines


def test_a_stitch_to_a_missing_edge_sews_no_line() -> None:
    """An edge number beyond the loop, as of a file that counts from 1, is not the number of a line."""
    pattern = tube()
    back = replace(pattern.panel("back"), lines=(InnerLine(0, 2),))
    spec = parsed(replace(pattern, panels=(back, pattern.panel("front"))))
    spec["pattern"]["stitches"].append([{"panel": "back", "edge": 4}, {"panel": "front", "edge": 0}])
    with pytest.raises(SpecError, match=r"stitch \d: panel back has no edge 4: correct panel or edge"):
        pattern_from_spec(spec, "tube")


def test_a_reader_of_stitches_alone_sews_every_seam() -> None:
    """pygarment takes panel and edge of the first two entries of a stitch, and a third one for the word right_wrong."""
    plain, closed = parsed(tube())["pattern"], parsed(closing(tube(), (Closure.OPEN, (0.0, 1.0))))["pattern"]
    for stitch in closed["stitches"]:
        assert [set(side) for side in stitch[:2]] == [{"panel", "edge"}] * 2
        assert all(side["edge"] < len(closed["panels"][side["panel"]]["edges"]) for side in stitch[:2])
        assert stitch[2:] in ([], ["right_wrong"])
    assert closed.pop("closures") == [{"panel": "front", "edge": 1, "closure": "open", "closed": [0.0, 1.0]}]
    assert closed == plain  # nothing of it is in a file of a pattern that is sewn


def test_written_and_read_is_the_same(tmp_path: Path) -> None:
    """The folder names a file without a name."""
    write_pattern(tube(), tmp_path / "tube_specification.json")
    back = read_pattern(tmp_path / "tube_specification.json")
    assert back.name == "tube"
    assert back.panels == tube().panels
    assert back.seams == tube().seams
    assert back.extra["parameters"] == {"a": 1}
    write_pattern(tube(), tmp_path / "specification.json")
    assert read_pattern(tmp_path / "specification.json").name == tmp_path.name


finite = st.floats(-200, 200, allow_nan=False)


@given(st.lists(st.tuples(finite, finite), min_size=3, max_size=8), st.tuples(finite, finite, finite), st.booleans())
def test_any_polygon_survives(corners: list[tuple[float, float]], place: tuple[float, ...], turned: bool) -> None:
    placement = Placement(np.array(place), np.radians(place) * 0.9)
    pattern = Pattern("p", (replace(shapes.panel("one", corners), placement=placement),), ())
    back = pattern_from_spec(parsed(pattern), "p")
    assert np.allclose(back.panels[0].vertices, pattern.panels[0].vertices, atol=1e-12)
    assert np.allclose(back.panels[0].placement.rotation, placement.rotation, atol=1e-12)


def test_real_patterns_survive(examples: Path) -> None:
    for path in sorted((examples / "patterns").rglob("*_specification.json")):
        spec = json.loads(path.read_text())
        again = parsed(read_pattern(path))
        assert again["pattern"]["stitches"] == spec["pattern"]["stitches"]
        for name, panel in spec["pattern"]["panels"].items():
            ours = again["pattern"]["panels"][name]
            assert np.allclose(ours["vertices"], panel["vertices"], atol=1e-9)
            assert np.allclose(ours["translation"], panel["translation"], atol=1e-9)
            assert np.allclose(ours["rotation"], panel["rotation"], atol=1e-9)
            assert ours["edges"] == panel["edges"]
            assert ours.get("label") == panel.get("label")


def test_panel_order_is_that_of_the_reference(examples: Path) -> None:
    for path in sorted((examples / "patterns").glob("*/default_body/*_specification.json")):
        written = json.loads(path.read_text())["pattern"]["panel_order"]
        assert list(panel_order(read_pattern(path).panels)) == written


def test_metres_become_centimetres() -> None:
    spec = parsed(tube())
    for panel in spec["pattern"]["panels"].values():
        panel["vertices"] = (np.array(panel["vertices"]) / 100).tolist()
        panel["translation"] = (np.array(panel["translation"]) / 100).tolist()
    spec["pattern"]["panels"]["front"]["edges"][2]["curvature"]["params"][0] /= 100
    spec["properties"]["units_in_meter"] = 1
    read = pattern_from_spec(spec, "tube")
    for panel in tube().panels:
        assert np.allclose(outline(read.panel(panel.name)), outline(panel))
    assert read.extra["properties"]["original_units_in_meter"] == 1
    assert spec_from_pattern(read)["properties"]["units_in_meter"] == 100


def test_first_version_of_the_format_has_one_control_point() -> None:
    spec = parsed(tube())
    spec["pattern"]["panels"]["front"]["edges"][0]["curvature"] = [0.5, -0.1]
    assert pattern_from_spec(spec, "tube").panel("front").edges[0].curve == Quadratic((0.5, -0.1))


def test_absolute_control_points_draw_the_same_curve() -> None:
    spec = parsed(tube())
    edges = spec["pattern"]["panels"]["front"]["edges"]
    edges[0]["curvature"]["params"] = [[10.0, -2.0]]  # (0, 0) to (20, 0): half way, a tenth of the length to the right
    edges[1]["curvature"]["params"] = [[20 - 0.02 * 30, 9.0], [20 + 0.03 * 30, 21.0]]
    spec["properties"]["curvature_coords"] = "absolute"
    assert np.allclose(outline(pattern_from_spec(spec, "tube").panel("front")), outline(tube().panel("front")))


def test_loops_that_start_anywhere_hang_where_they_hung() -> None:
    """As in old files, the loop starts at its third edge and runs clockwise; the seams still join the same points."""
    clockwise = np.array([[20.0, 30.0], [20.0, 0.0], [0.0, 0.0], [0.0, 30.0]])
    edges = tuple(Edge(i, (i + 1) % 4, Quadratic((0.5, 0.1 * i)), str(i)) for i in range(4))
    panel = Panel("old", clockwise, edges, Placement(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3])))
    spec = parsed(Pattern("old", (panel,), (Seam(EdgeRef("old", 1), EdgeRef("old", 3)),)))
    spec["properties"]["normalized_edge_loops"] = False
    read = pattern_from_spec(spec, "old")
    new = read.panels[0]
    x, y = new.vertices[[edge.start for edge in new.edges]].T
    assert np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0
    assert new.edges[0].start == np.argmin(new.vertices.sum(axis=1))
    assert [new.edges[side.edge].label for side in (read.seams[0].left, read.seams[0].right)] == ["1", "3"]
    shift = next(i for i, edge in enumerate(new.edges) if edge.label == "0")
    assert np.allclose(np.roll(outline(new).reshape(4, 9, 3), -shift, axis=0).reshape(-1, 3), outline(panel))


def test_centred_panels_move_by_their_middle() -> None:
    spec = parsed(tube())
    spec["properties"]["normalize_panel_translation"] = True
    read = pattern_from_spec(spec, "tube")
    assert np.allclose(read.panel("back").vertices.mean(axis=0), 0)
    assert np.allclose(outline(read.panel("front")), outline(tube().panel("front")))
    assert spec_from_pattern(read)["properties"]["normalize_panel_translation"] is False


@given(st.tuples(finite, finite, finite))
def test_angles_give_their_matrix_back(angles: tuple[float, float, float]) -> None:
    matrix = Placement(np.zeros(3), np.array(angles)).matrix
    assert np.allclose(Placement(np.zeros(3), euler_angles(matrix)).matrix, matrix, atol=1e-6)


def test_null_is_absent_and_a_whole_float_is_an_index() -> None:
    """As pydantic writes absent values, and JavaScript or pandas whole numbers."""
    spec = parsed(tube())
    for entry in (*spec["pattern"]["panels"].values(), *spec["pattern"]["panels"]["front"]["edges"]):
        entry.pop("label", None)
    spec["pattern"]["panels"]["back"] |= {"translation": None, "rotation": None, "label": None}
    spec["pattern"]["panel_order"] = spec["parameters"] = None
    spec["properties"] |= {"units_in_meter": None, "curvature_coords": None}
    for edge in spec["pattern"]["panels"]["back"]["edges"]:
        edge |= {"curvature": None, "label": None, "endpoints": [float(end) for end in edge["endpoints"]]}
    spec["pattern"]["stitches"] = [[{"panel": "front", "edge": 1.0}, {"panel": "back", "edge": 3.0}, None]]
    read = pattern_from_spec(spec, "tube")
    back = replace(square("back"), placement=Placement(np.zeros(3), np.zeros(3)), label="")
    assert {panel.name: panel for panel in read.panels}["back"] == back
    assert read.seams == tube().seams[:1]
    assert pattern_from_spec(parsed(read), "tube").panels == read.panels
    assert pattern_from_spec({**spec, "properties": None}, "tube").seams == read.seams
    assert not pattern_from_spec({"pattern": {**spec["pattern"], "stitches": None}}, "tube").seams


def nested(levels: int) -> list[Any]:
    inner: list[Any] = []
    for _ in range(levels):
        inner = [inner]
    return inner


EDGES = [{"panel": "back", "edge": 0}, {"panel": "front", "edge": 0}]
ZIP = {"panel": "front", "edge": 1, "closure": "zip"}
BROKEN: dict[tuple[str | int, ...], list[tuple[Any, str]]] = {
    (): [
        ({"asset": {}, "nodes": []}, "no object named pattern, only asset, nodes: give a specification JSON"),
        ([], "the file must be a JSON object, found []"),
    ],
    ("pattern", "panels"): [(None, "pattern.panels must be a JSON object, found nothing")],
    ("pattern", "stitches", 1, 2): [
        ("wrong_right", 'stitch 1: the third word of a stitch is right_wrong, found "wrong_right"')
    ],
    ("pattern", "line_stitches"): [
        ([{"seam": -7, "sides": EDGES}], "line stitch 0: seam -7 is no"),
        ([{"seam": 77, "sides": EDGES}], "line stitch 0: seam 77 is no"),
        ([{"right_wrong": "false", "sides": EDGES}], "line stitch 0: right_wrong is nei"),
        (
            [{"seam": 0, "sides": [{"panel": "back", "line": 1}, EDGES[1]]}],
            "line stitch 0: panel back has no line 1: correct panel or line",
        ),
    ],
    ("pattern", "closures"): [
        (["zip"], "closure 0: an entry of closures must be a JSON object"),
        ([{**ZIP, "panel": "back"}], "closure 0: no stitch begins with edge 1 of panel back"),
        ([{**ZIP, "closure": 4}], "closure 0: closure must be a string"),
        ([{**ZIP, "closed": 0.5}], "closure 0: closed must be 2 numbers"),
        ([ZIP, ZIP], "an earlier closure names it: name each first side once"),
    ],
    ("pattern", "panel_order"): [
        (["front", "side"], "panel_order must name each of the 2 panels once: look at back, side")
    ],
    ("properties", "units_in_meter"): [(0, "units_in_meter is 0"), (1e-300, "units_in_meter is 1e-300")],
    ("parameters",): [(nested(100), "more than 64 levels deep: flatten it")],
    ("pattern", "panels", "two\nlines"): [({}, r"panel 'two\nlines': vertices")],
    ("front", "vertices", 1): [
        (["20", 0], 'panel front: vertex 1 must be 2 numbers, found ["20", 0]'),
        ([10**400, 0], "panel front: vertex 1 must be 2 numbers of at most 1e+12, found [1000000"),
    ],
    ("front", "translation"): [([0, 0], "panel front: translation must be 3 numbers")],
    ("front", "edges", 0, "endpoints"): [
        ([0, 10**400], "panel front, edge 0: endpoint must be a whole number of at most 1e+12, found 1000000")
    ],
    ("front", "edges", 2, "endpoints"): [
        ([2], "panel front, edge 2: endpoints must be two vertex numbers"),
        ([2.5, 3], "panel front, edge 2: endpoint must be a whole number, found 2.5"),
    ],
    ("front", "edges", 0, "curvature", "type"): [
        ("spline", "panel front, edge 0: curvature type 'spline'"),
        (["q"], 'panel front, edge 0: curvature type must be a string, found ["q"]'),
    ],
    ("front", "edges", 1, "curvature", "params"): [
        ([[0, 0]], "panel front, edge 1: a cubic curvature has 2 params, found 1")
    ],
}
"""Place in the file to values that are no content of the format, each with the error; ``front`` is a panel."""


@pytest.mark.parametrize(
    ("place", "value", "said"), [(place, *case) for place, cases in BROKEN.items() for case in cases]
)
def test_content_outside_the_format_is_named(place: tuple[str | int, ...], value: Any, said: str) -> None:
    spec: Any = parsed(tube())
    if place:
        *above, last = place if place[0] != "front" else ("pattern", "panels", *place)
        reduce(getitem, above, spec)[last] = value
    with pytest.raises(SpecError) as caught:
        pattern_from_spec(spec if place else value, "tube", source="some/tube.json")
    assert str(caught.value).startswith("some/tube.json: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named_with_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SpecError, match=r"nothing\.json: no such file: give the path of a specification JSON"):
        read_pattern(tmp_path / "nothing.json")
    with pytest.raises(SpecError, match=r"cannot be read \(Is a directory\): give the path of a specification JSON"):
        read_pattern(tmp_path)
    (tmp_path / "large.json").write_bytes(b"{}" + b" " * (4 << 20))
    with pytest.raises(SpecError, match="more than 4 MB"):  # before it is parsed
        read_pattern(tmp_path / "large.json")
    write_pattern(tube(), tmp_path / "mine.json")
    with pytest.raises(SpecError, match=r"mine\.json/x: cannot be read \(Not a directory\): give the path"):
        read_pattern(tmp_path / "mine.json" / "x")
    forbidden = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    monkeypatch.setattr(Path, "open", Mock(side_effect=forbidden))  # tests may run as root, which can read everything
    with pytest.raises(SpecError, match=r"cannot be read \(Permission denied\): ask for the right to read it"):
        read_pattern(tmp_path / "mine.json")


def test_a_reader_of_stitches_sews_each_edge_of_a_pleat_once() -> None:
    """The seams between the layers of a pleat are in ``line_stitches``."""
    spec = parsed(pleated_square())
    sides = [(side["panel"], side["edge"]) for stitch in spec["pattern"]["stitches"] for side in stitch]
    assert len(sides) == len(set(sides)) == 6
    assert [line["angle"] for line in spec["pattern"]["panels"]["skirt"]["lines"]] == [180.0, -180.0]
