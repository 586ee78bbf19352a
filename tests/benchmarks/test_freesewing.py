"""Patterns from FreeSewing drawings. The drawings here are made by hand; none is FreeSewing's."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from benchmarks.reconstruction.freesewing.__main__ import HERE, draw, requests
from benchmarks.reconstruction.freesewing.designs import DESIGNS, Cut, Design, Piece, Side
from benchmarks.reconstruction.freesewing.sewing import pattern_of_drawing
from gcd_dataset.errors import ConfigError, PatternError
from gcd_dataset.faults import require_valid
from gcd_dataset.metrics import PanelShape
from gcd_dataset.records import Pattern

MEASUREMENTS = {"waistToFloor": 1000.0, "hpsToWaistBack": 420.0, "shoulderToShoulder": 400.0}


def part(path: list[list[Any]], **points: tuple[float, float]) -> dict[str, Any]:
    return {"path": path, "points": {name: list(point) for name, point in points.items()}}


def polygon(**corners: tuple[float, float]) -> dict[str, Any]:
    """A part whose outline is the polygon of its corners [mm, y down]."""
    (first, *rest) = corners.values()
    return part([["move", *first], *(["line", *corner] for corner in rest), ["close"]], **corners)


def bodice(width: float, *, shoulder: float = 100.0) -> dict[str, Any]:
    """The right half of a sleeveless front or back, as FreeSewing draws it."""
    return polygon(
        neck=(60, 0), shoulder=(60 + shoulder, 30), armhole=(width, 200), hem=(width, 600), cHem=(0, 600), cNeck=(0, 80)
    )


HALF = Piece("top.front", Cut.FOLD, Side.FRONT, ("cNeck", "cHem"))
TOP = Design(
    "top",
    ("anyone",),
    {"front": HALF, "back": Piece("top.back", Cut.FOLD, Side.BACK, ("cNeck", "cHem"))},
    (("front:shoulder>neck", "back:shoulder>neck"), ("front:hem>armhole", "back:hem>armhole")),
    (),
)


def top(**sizes: float) -> Pattern:
    parts = {"top.front": bodice(250.0), "top.back": bodice(250.0, **sizes)}
    return pattern_of_drawing("top", TOP, {"parts": parts, "measurements": MEASUREMENTS})


def test_half_becomes_a_symmetrical_panel_of_twice_its_area() -> None:
    front = top().panel("front")
    corners = {(round(x, 6), round(y, 6)) for x, y in front.vertices.tolist()}
    assert corners == {(-x, y) for x, y in corners}
    half = shapely.Polygon([(6, 0), (16, 3), (25, 20), (25, 60), (0, 60), (0, 8)])
    assert PanelShape.of(front).polygon.area == pytest.approx(2 * half.area, rel=1e-9)


def test_shoulders_and_sides_are_sewn_on_either_side() -> None:
    pattern = require_valid(top(), source="top")
    assert len(pattern.seams) == 4
    middles = []
    for seam in pattern.seams:
        ends = [pattern.panel(ref.panel) for ref in (seam.left, seam.right)]
        (a, b), (c, d) = (
            panel.placement.apply(np.array(panel.edge_ends(ref.edge)))
            for panel, ref in zip(ends, (seam.left, seam.right), strict=True)
        )
        assert a[:2] == pytest.approx(d[:2])  # the start of one edge lies before the end of the other
        assert b[:2] == pytest.approx(c[:2])
        middles.append(round(float(a[0] + b[0]), 6))
    assert sorted(middles) == sorted(-x for x in middles)


def test_placed_panels_hang_at_the_height_of_the_shoulder() -> None:
    pattern = top()
    for panel in pattern.panels:
        assert panel.placement.apply(panel.vertices)[:, 1].max() == pytest.approx(142.0)


def test_edge_is_divided_where_the_other_side_has_a_corner() -> None:
    """A band of 80 cm is sewn to four edges of 10, 30, 30 and 10 cm: it is divided at 1/8, 1/2 and 7/8."""
    design = Design(
        "band",
        ("anyone",),
        {
            "cloth": Piece("cloth", Cut.FOLD, Side.FRONT, ("cNeck", "cHem")),
            "band": Piece("band", Cut.ONE, Side.FRONT),
        },
        (("band:topLeft>bottomLeft", "cloth:right>top cloth:top>cNeck ~cloth:cNeck>top ~cloth:top>right"),),
        (),
    )
    cloth = polygon(top=(300, 0), cNeck=(0, 0), cHem=(0, 500), low=(300, 500), right=(300, 100))
    band = polygon(topLeft=(0, 0), bottomLeft=(0, 800), bottomRight=(60, 800), topRight=(60, 0))
    drawing = {"parts": {"cloth": cloth, "band": band}, "measurements": MEASUREMENTS}
    pattern = pattern_of_drawing("band", design, drawing)
    lengths = pattern.panel("band").edge_lengths()
    sewn = sorted(lengths[ref.edge] for seam in pattern.seams for ref in (seam.left, seam.right) if ref.panel == "band")
    assert sewn == pytest.approx([10.0, 10.0, 30.0, 30.0])
    assert pattern.gather_ratios() == pytest.approx([1.0] * 4, abs=1e-4)


def test_halved_ring_has_two_seams() -> None:
    design = Design(
        "tube",
        ("anyone",),
        {"tube": Piece("tube", Cut.ONE, Side.FRONT), "cuff": Piece("cuff", Cut.ONE, Side.FRONT)},
        (("tube:a>b /2", "cuff:c>d"),),
        (),
    )
    parts = {
        "tube": polygon(a=(0, 300), b=(200, 300), e=(200, 0), f=(0, 0)),
        "cuff": polygon(g=(0, 400), h=(200, 400), d=(200, 350), c=(0, 350)),
    }
    pattern = pattern_of_drawing("tube", design, {"parts": parts, "measurements": MEASUREMENTS})
    assert [len(panel.edges) for panel in pattern.panels] == [5, 5]
    assert len(pattern.seams) == 2


def test_curves_keep_their_length_and_points_without_length_vanish() -> None:
    """A quarter circle of 100 mm as FreeSewing's cubic, with a corner drawn twice."""
    k = 55.22847498
    path: list[list[Any]] = [
        ["move", 0, 0],
        ["line", 100, 0],
        ["line", 100, 0],
        ["curve", 100, k, k, 100, 0, 100],
        ["close"],
    ]
    design = Design("quarter", ("anyone",), {"piece": Piece("piece", Cut.ONE, Side.FRONT)}, (), ())
    drawing = {"parts": {"piece": part(path)}, "measurements": MEASUREMENTS}
    panel = pattern_of_drawing("quarter", design, drawing).panel("piece")
    assert sorted(panel.edge_lengths()) == pytest.approx([10.0, 10.0, np.pi / 2 * 10.0], rel=3e-4)


def test_missing_part_is_named_with_those_that_were_drawn() -> None:
    drawing = {"parts": {"top.front": bodice(250.0)}, "measurements": MEASUREMENTS}
    with pytest.raises(PatternError, match=r"top: part top\.back was not drawn: there are top\.front"):
        pattern_of_drawing("top", TOP, drawing)


def test_missing_corner_is_named() -> None:
    design = Design("top", ("anyone",), dict(TOP.pieces), (("front:elbow>neck", "back:shoulder>neck"),), ())
    parts = {"top.front": bodice(250.0), "top.back": bodice(250.0)}
    with pytest.raises(PatternError, match="panel front: no corner elbow"):
        pattern_of_drawing("top", design, {"parts": parts, "measurements": MEASUREMENTS})


def test_stretch_sewn_twice_is_refused() -> None:
    seams = (("front:hem>armhole", "back:hem>armhole"), ("front:hem>armhole", "back:armhole>shoulder"))
    design = Design("top", ("anyone",), dict(TOP.pieces), seams, ())
    parts = {"top.front": bodice(250.0), "top.back": bodice(250.0)}
    with pytest.raises(PatternError, match="two seams use one stretch"):
        pattern_of_drawing("top", design, {"parts": parts, "measurements": MEASUREMENTS})


def test_request_depends_on_seed_and_number_alone() -> None:
    names = sorted(DESIGNS)
    assert requests(20, 3, names)[:5] == requests(5, 3, names)
    assert requests(5, 3, names) != requests(5, 4, names)


def test_all_designs_are_installed_by_the_package_file() -> None:
    packages = json.loads((HERE / "package.json").read_text())["dependencies"]
    assert {f"@freesewing/{design.package}" for design in DESIGNS.values()} <= set(packages)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")
def test_missing_packages_are_named_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="npm install"):
        list(draw([], packages=tmp_path))


@pytest.mark.skipif(not (HERE / "node_modules" / "@freesewing").is_dir(), reason="needs npm install")
def test_every_design_is_drawn_and_sewn() -> None:
    """Of each design one drawing: valid, and its free edges are hems, necklines and waists alone."""
    names = sorted(DESIGNS)
    for name, drawing in zip(names, draw(requests(len(names), 0, names)), strict=True):
        assert drawing["faults"] == []
        pattern = require_valid(pattern_of_drawing(name, DESIGNS[name], drawing), source=name)
        sewn = 2 * len(pattern.seams) / sum(len(panel.edges) for panel in pattern.panels)
        assert sewn > 0.6
