"""Openings: the boundary of the sewn surface, for shapes with a known boundary."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.generator.dressing.openings import openings_of
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam


def rectangle(name: str, wide: float, tall: float, *, z: float, y: float = 0.0, back: bool = False) -> Panel:
    """A panel in the plane ``z``; its edges are bottom, right, top, left as seen from the front."""
    corners = np.array([[-wide / 2, 0], [wide / 2, 0], [wide / 2, tall], [-wide / 2, tall]], float)
    loop = [(0, 1), (1, 2), (2, 3), (3, 0)]
    edges = tuple(Edge(b, a) for a, b in reversed(loop)) if back else tuple(Edge(a, b) for a, b in loop)
    return Panel(name, corners, edges, Placement(np.array([0.0, y, z]), np.zeros(3)))


def tube(wide: float, tall: float, *, y: float = 0.0) -> Pattern:
    """Two rectangles sewn at their sides; the back's edges are left, top, right, bottom."""
    front, back = rectangle("front", wide, tall, z=20.0, y=y), rectangle("back", wide, tall, z=-20.0, y=y, back=True)
    seams = (Seam(EdgeRef("front", 1), EdgeRef("back", 2)), Seam(EdgeRef("front", 3), EdgeRef("back", 0)))
    return Pattern("tube", (front, back), seams)


def test_a_tube_has_two_openings_of_its_girth() -> None:
    top, bottom = openings_of(tube(50.0, 30.0, y=60.0))
    assert {ref.edge for ref in top.edges if ref.panel == "front"} == {2}
    assert [top.length, bottom.length] == pytest.approx([100.0, 100.0])
    assert np.allclose(top.centre, [0.0, 90.0, 0.0])
    assert np.allclose(bottom.centre, [0.0, 60.0, 0.0])


def test_a_closed_bag_has_one_opening_and_a_lone_panel_its_outline() -> None:
    pattern = tube(50.0, 30.0)
    bag = replace(pattern, seams=(*pattern.seams, Seam(EdgeRef("front", 0), EdgeRef("back", 3))))
    assert len(openings_of(bag)) == 1
    [outline] = openings_of(Pattern("cloth", pattern.panels[:1], ()))
    assert outline.length == pytest.approx(2 * (50.0 + 30.0))
    assert len(outline.edges) == 4


def test_a_seam_of_right_to_wrong_side_reverses_the_walk() -> None:
    """A ribbon sewn to itself with a half twist has one edge, a plain ring two."""
    ribbon = rectangle("ribbon", 40.0, 5.0, z=0.0)
    ends = (EdgeRef("ribbon", 1), EdgeRef("ribbon", 3))
    assert len(openings_of(Pattern("ring", (ribbon,), (Seam(*ends),)))) == 2
    assert len(openings_of(Pattern("moebius", (ribbon,), (Seam(*ends, right_wrong=True),)))) == 1
