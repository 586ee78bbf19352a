"""Outlines are drawn edge by edge, and edges are found by name."""

import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern import Outline, Stroke


def rectangle() -> Outline:
    return Outline.start(0, 0).line(30, 0, name="hem").line(30, 20, name="side").line(0, 20).close(name="centre")


def test_edges_by_name() -> None:
    assert rectangle().edge("side").length == 20.0
    assert rectangle().closed


def test_the_error_of_an_unknown_edge_lists_the_known_edges() -> None:
    with pytest.raises(PatternError, match="no edge named sleeve: there are hem, side, centre"):
        rectangle().edge("sleeve")


def test_drawing_returns_a_new_outline() -> None:
    begun = Outline.start(0, 0).line(10, 0)
    begun.line(10, 10)
    assert begun.pen == (10.0, 0.0)


def test_strokes_must_join() -> None:
    with pytest.raises(PatternError, match=r"begins at \(11.00, 0.00\), but the pen is at \(10.00, 0.00\)"):
        Outline.start(0, 0).line(10, 0).then(Stroke((11.0, 0.0), (12.0, 0.0)))


def test_the_sign_of_the_area_is_the_direction_of_the_loop() -> None:
    assert rectangle().area == pytest.approx(600.0)
    assert rectangle().mirrored().area == pytest.approx(-600.0)


def test_a_divided_edge_cannot_be_looked_up_as_one() -> None:
    hem = rectangle().edge("hem")
    divided = rectangle().with_strokes((hem,), hem.split([0.5]))
    assert [piece.length for piece in divided.run("hem")] == pytest.approx([15.0, 15.0])
    with pytest.raises(PatternError, match="divided into 2 pieces"):
        divided.edge("hem")
