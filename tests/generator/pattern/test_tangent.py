"""Curves with given tangents at their ends."""

from math import cos, hypot, radians, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern import Stroke, rotate, tangent_quadratic

START, END = (3.0, -2.0), (5.0, 38.0)
UP = (0.0, 1.0)


def direction(stroke: Stroke, t: float) -> tuple[float, float]:
    x, y = stroke.velocity(t)
    return (x / hypot(x, y), y / hypot(x, y))


@given(st.floats(-95, 95))
def test_a_start_tangent_is_met(angle: float) -> None:
    wanted = (cos(radians(90 + angle)), sin(radians(90 + angle)))
    curve = tangent_quadratic(START, END, start_tangent=wanted)
    assert direction(Stroke(START, END, curve), 0.0) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("at", [0.75, 0.3])
@given(angle=st.floats(-95, 95))
def test_an_end_tangent_is_met(at: float, angle: float) -> None:
    wanted = (cos(radians(90 + angle)), sin(radians(90 + angle)))
    curve = tangent_quadratic(START, END, end_tangent=wanted, at=at)
    assert direction(Stroke(START, END, curve), 1.0) == pytest.approx(wanted, abs=1e-9)


def test_a_slight_angle_keeps_the_control_point_near_its_start_on_the_chord() -> None:
    for at in (0.75, 0.3):
        control = tangent_quadratic(START, END, end_tangent=UP, at=at).control
        assert control[0] == pytest.approx(at, abs=0.005)


def test_both_tangents_of_a_quarter_circle_cross_at_the_corner_of_its_square() -> None:
    curve = tangent_quadratic((10.0, 0.0), (0.0, 10.0), start_tangent=UP, end_tangent=(-1.0, 0.0))
    corner = Stroke((10.0, 0.0), (0.0, 10.0), curve).control_points()[1]
    assert corner == pytest.approx((10.0, 10.0))


@given(st.floats(-3, 3))
def test_a_curve_turns_with_its_ends_and_tangent(angle: float) -> None:
    turned = tangent_quadratic(rotate(START, angle), rotate(END, angle), start_tangent=rotate(UP, angle))
    assert turned.control == pytest.approx(tangent_quadratic(START, END, start_tangent=UP).control, abs=1e-9)


def test_a_mirrored_tangent_gives_the_mirror_image() -> None:
    left = tangent_quadratic((0.0, 0.0), (0.0, 30.0), start_tangent=(-0.2, 1.0))
    right = tangent_quadratic((0.0, 0.0), (0.0, 30.0), start_tangent=(0.2, 1.0))
    assert (left.control[0], -left.control[1]) == pytest.approx(right.control)


def test_control_points_equal_the_references() -> None:
    """Control points of GarmentCode's jumpsuit: the back's hip (one tangent) and the crotch (two)."""
    hip = tangent_quadratic((-5.0, 68.231), (-2.771, 94.063), start_tangent=UP)
    assert hip.control == pytest.approx((0.498, 0.043), abs=0.003)
    crotch = tangent_quadratic((22.412, 79.855), (29.795, 59.417), start_tangent=(0.0, -1.0), end_tangent=(1.0, 0.0))
    assert crotch.control == pytest.approx((0.8846, -0.3195), abs=1e-4)


def test_tangents_that_do_not_cross_are_refused() -> None:
    with pytest.raises(PatternError, match="do not cross"):
        tangent_quadratic((0.0, 0.0), (0.0, 10.0), start_tangent=(1.0, 1.0), end_tangent=(1.0, 1.0))
    with pytest.raises(PatternError, match="one point twice"):
        tangent_quadratic(START, START, start_tangent=UP)
    with pytest.raises(PatternError, match="needs one"):
        tangent_quadratic(START, END)
