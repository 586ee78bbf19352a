"""Outlines of pieces and the seams between them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern import Outline, Stroke
from gcd_dataset.generator.pattern.piece import shared_breaks


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


LENGTHS = st.lists(st.floats(0.1, 100.0), min_size=1, max_size=5)


def positions(lengths: list[float], divisions: list[list[float]]) -> list[float]:
    """All breaks of a divided interface, as shares of its length."""
    total, reached, found = sum(lengths), 0.0, []
    for length, shares in zip(lengths, divisions, strict=True):
        found += [(reached + share * length) / total for share in shares]
        reached += length
        found.append(reached / total)
    return found


def test_nearly_equal_edges_are_sewn_edge_by_edge() -> None:
    assert shared_breaks([10.0, 10.0], [10.9, 10.0]) == ([[], []], [[], []])


def test_an_edge_sewn_to_two_edges_is_divided() -> None:
    left, right = shared_breaks([30.0], [10.0, 20.0])
    assert left == [[pytest.approx(1 / 3)]]
    assert right == [[], []]


def test_breaks_closer_than_a_hundredth_are_merged() -> None:
    left, right = shared_breaks([50.0, 50.0], [50.4, 30.0, 19.6])
    assert left == [[], [pytest.approx((0.804 - 0.5) / 0.5)]]
    assert right == [[], [], []]


def test_a_break_in_the_middle_of_a_short_edge_is_sewn_to_one_of_its_ends() -> None:
    left, right = shared_breaks([50.0, 50.0], [49.75, 0.5, 49.75])
    assert sum(map(len, left)) + 2 == sum(map(len, right)) + 3


@given(LENGTHS, LENGTHS)
def test_both_sides_end_with_equally_many_edges_and_the_same_breaks(left: list[float], right: list[float]) -> None:
    ours, theirs = (positions(*side) for side in zip((left, right), shared_breaks(left, right), strict=True))
    assert len(ours) == len(theirs)
    assert ours == pytest.approx(theirs, abs=0.051)
    assert ours == sorted(ours)
