"""Edges are divided so that every seam joins one edge with one edge."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.generator.pattern.piece import shared_breaks

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
