"""The hash differs between patterns and agrees between machines."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.patternhash import STEP, PatternHash, hash_pattern
from gcd_dataset.tensors import EdgeColumn, PanelColumn, PatternTensor, encode_pattern
from tests.helpers import napkins

NAPKINS = encode_pattern(napkins())


def changed(array: str, row: int, column: int, by: float) -> PatternTensor:
    """The napkins with ``by`` added to one entry."""
    moved = getattr(NAPKINS, array).copy()
    moved[row, column] += by
    return replace(NAPKINS, **{array: moved})


def text(*patterns: PatternTensor) -> str:
    return PatternHash.of(enumerate(patterns)).text


@pytest.mark.parametrize("column", [PanelColumn.X, PanelColumn.QUATERNION_X, PanelColumn.CENTROID_Y, PanelColumn.LABEL])
def test_another_panel_is_another_pattern(column: PanelColumn) -> None:
    assert text(changed("panels", 1, column, 1.0)) != text(NAPKINS)


@pytest.mark.parametrize("column", [EdgeColumn.START_X, EdgeColumn.KIND, EdgeColumn.CONTROL0_X, EdgeColumn.RIGHT])
def test_another_edge_or_curve_is_another_pattern(column: EdgeColumn) -> None:
    assert text(changed("edges", 2, column, 1.0)) != text(NAPKINS)


def test_another_stitch_name_or_index_is_another_pattern() -> None:
    assert text(changed("stitches", 0, 2, 1)) != text(NAPKINS)
    assert text(replace(NAPKINS, panel_names=("one", "three"))) != text(NAPKINS)
    assert hash_pattern(1, NAPKINS).text != hash_pattern(0, NAPKINS).text


def test_the_last_digits_do_not_matter_nor_the_sign_of_nothing() -> None:
    assert text(changed("edges", 1, EdgeColumn.START_X, 2e-11)) == text(NAPKINS)
    assert text(changed("edges", 0, EdgeColumn.CONTROL0_X, -0.0)) == text(NAPKINS)
    assert text(changed("edges", 0, EdgeColumn.CONTROL0_X, -2e-11)) == text(NAPKINS)


def test_half_a_turn_is_one_rotation() -> None:
    """For a rotation by 180 degrees W is 0 up to rounding, so its sign is arbitrary."""
    panels = NAPKINS.panels.copy()
    panels[0, PanelColumn.QUATERNION_W : PanelColumn.QUATERNION_Z + 1] = [6e-17, 0.0, 1.0, 0.0]
    other = panels.copy()
    other[0, PanelColumn.QUATERNION_W : PanelColumn.QUATERNION_Z + 1] = [6e-17, 0.0, -1.0, 0.0]
    assert text(replace(NAPKINS, panels=panels)) == text(replace(NAPKINS, panels=other))


def test_angles_and_radii_do_not_count() -> None:
    """At 90 degrees about y only the sum of the angles about x and z is determined (gimbal lock)."""
    assert text(changed("panels", 0, PanelColumn.ANGLE_X, 0.5)) == text(NAPKINS)
    assert text(changed("edges", 0, EdgeColumn.RADIUS, 10.0)) == text(NAPKINS)


def test_the_order_does_not_matter() -> None:
    parts = [hash_pattern(index, NAPKINS) for index in range(5)]
    assert sum(parts, PatternHash()).text == sum(parts[::-1], PatternHash()).text == text(*[NAPKINS] * 5)
    assert sum(parts, PatternHash()).count == 5


def test_a_number_between_two_steps_may_be_rounded_either_way() -> None:
    """The coordinates of two machines differ by 2e-12 cm, across a rounding tie."""
    place = 0.5 * STEP - NAPKINS.edges[1, EdgeColumn.START_X] % STEP
    below = changed("edges", 1, EdgeColumn.START_X, place - 1e-12)
    above = changed("edges", 1, EdgeColumn.START_X, place + 1e-12)
    one, other = (PatternHash.of([(0, NAPKINS), (1, moved)]) for moved in (below, above))
    assert one.text != other.text
    assert one.agrees(other.text)
    assert other.agrees(one.text)
    assert not one.agrees(text(NAPKINS, changed("edges", 1, EdgeColumn.START_X, 1e-3)))


def test_two_patterns_and_mirrored_numbers_may_be_rounded_otherwise() -> None:
    """Mirrored panels hold a coordinate with both signs; another machine rounds both the other way."""

    def napkins_at(offset: float) -> PatternTensor:
        edges = NAPKINS.edges.copy()
        for row, sign in ((1, 1), (5, -1)):
            edges[row, EdgeColumn.START_X] = sign * (10.0 + 0.5 * STEP + offset)
        return replace(NAPKINS, edges=edges)

    one, other = (PatternHash.of(enumerate([napkins_at(offset)] * 2)) for offset in (-1e-12, 1e-12))
    assert one.text != other.text
    assert one.agrees(other.text)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300])
def test_numbers_that_cannot_be_rounded_are_rejected(wrong: float) -> None:
    with pytest.raises(PatternError, match="a number is NaN"):
        hash_pattern(0, changed("edges", 0, EdgeColumn.START_X, wrong))


def test_no_hash_agrees_with_a_text_that_is_no_hash() -> None:
    assert not hash_pattern(0, NAPKINS).agrees("")
    assert not hash_pattern(0, NAPKINS).agrees("not a hash")
