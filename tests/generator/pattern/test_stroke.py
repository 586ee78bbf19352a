"""Strokes, tangents of curves, and cubics fitted to them."""

from math import cos, hypot, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic, curve_points
from gcd_dataset.errors import FitError, PatternError
from gcd_dataset.generator.pattern import Stroke, rotate, smooth_cubic, tangent_quadratic

CURVES: list[Curve] = [
    LINE,
    Quadratic((0.3, 0.4)),
    Cubic((0.2, -0.35), (0.5, -0.2)),
    Arc(20.0, large=False, right=True),
    Arc(20.0, large=True, right=False),
]


@pytest.mark.parametrize("curve", CURVES)
def test_parts_add_up_to_the_whole(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve, "side", "held")
    pieces = stroke.split([0.2, 0.75])
    assert [piece.length / stroke.length for piece in pieces] == pytest.approx([0.2, 0.55, 0.25], abs=1e-7)
    assert {(piece.name, piece.label) for piece in pieces} == {("side", "held")}
    assert pieces[0].end == pieces[1].start
    assert pieces[-1].end == stroke.end


@pytest.mark.parametrize("curve", CURVES)
def test_parts_lie_on_the_whole(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve)
    first, second = stroke.split_at([0.4])
    assert first.at(0.5) == pytest.approx(stroke.at(0.2))
    assert second.at(0.5) == pytest.approx(stroke.at(0.7))


@pytest.mark.parametrize("curve", CURVES)
def test_rotation_keeps_the_length_and_rotates_the_points(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve)
    turned = stroke.rotated(0.5 * np.pi, about=(1.0, 2.0))
    x, y = stroke.at(0.3)
    assert turned.length == pytest.approx(stroke.length)
    assert turned.at(0.3) == pytest.approx((1.0 - (y - 2.0), 2.0 + (x - 1.0)))


@pytest.mark.parametrize("curve", CURVES)
def test_reversal_and_mirroring_map_points(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve)
    x, y = stroke.at(0.3)
    assert stroke.reversed().at(0.7) == pytest.approx((x, y))
    assert stroke.mirrored().at(0.3) == pytest.approx((-x, y))


def test_an_arc_has_no_control_points() -> None:
    with pytest.raises(PatternError, match="hem: an arc has no control points"):
        Stroke((0.0, 0.0), (1.0, 0.0), Arc(1.0, large=False, right=True), "hem").control_points()


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


DOWN = (0.0, -1.0)


@pytest.mark.parametrize("size", [0.5, 1.0, 1.5])
@pytest.mark.parametrize("angle", [0.2, 0.6, 0.9])
def test_tangents_and_length_are_met(size: float, angle: float) -> None:
    end = (-23 * size * sin(angle), -23 * size * cos(angle))
    towards = (-sin(0.9 * angle), -cos(0.9 * angle))
    fitted = smooth_cubic((0.0, 0.0), end, start_tangent=DOWN, end_tangent=towards, length=26 * size)
    first, last = fitted.velocity(0.0), fitted.velocity(1.0)
    assert fitted.length == pytest.approx(26 * size, abs=1e-4)
    assert np.array(first) / hypot(*first) == pytest.approx(DOWN, abs=1e-9)
    assert np.array(last) / hypot(*last) == pytest.approx(towards, abs=1e-9)


def test_the_end_slides_along_the_chord_only() -> None:
    fitted = smooth_cubic((0.0, 0.0), (-12.0, -20.0), start_tangent=DOWN, end_tangent=(-0.6, -0.8), length=26.0)
    x, y = fitted.end
    assert x * 20.0 == pytest.approx(y * 12.0)


def test_the_fit_to_tangents_of_a_quarter_circle_is_nearly_circular() -> None:
    # Of all curves of a given length that turn by a right angle, the circle has the least peak curvature.
    radius = 15.0
    fitted = smooth_cubic(
        (radius, 0.0), (0.0, radius), start_tangent=(0.0, 1.0), end_tangent=(-1.0, 0.0), length=0.5 * pi * radius
    )
    points = curve_points(fitted.start, fitted.end, fitted.curve, np.linspace(0, 1, 50))
    assert np.linalg.norm(points, axis=1) == pytest.approx(np.full(50, radius), abs=0.15)


def test_an_impossible_length_is_an_error() -> None:
    with pytest.raises(FitError, match=r"a smooth curve of 1\.00 cm over 20\.00 cm: .* cm are missing"):
        smooth_cubic((0.0, 0.0), (0.0, -20.0), start_tangent=(1.0, 0.0), end_tangent=(1.0, 0.0), length=1.0)
