"""Curves against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.curves import (
    LINE,
    Arc,
    Cubic,
    Curve,
    Quadratic,
    curve_length,
    curve_points,
    curve_tangents,
    from_frame,
    mirrored,
    reversed_curve,
    sample_curve,
    to_frame,
)
from gcd_dataset.errors import PatternError

START, END = (3.0, -2.0), (11.0, 4.0)
CURVES: tuple[Curve, ...] = (
    LINE,
    Quadratic((0.4, 0.3)),
    Cubic((0.2, 0.5), (0.9, -0.4)),
    Arc(8.0, large=False, right=True),
    Arc(6.0, large=True, right=False),
)


def test_length_of_a_quarter_circle() -> None:
    assert curve_length((10, 0), (0, 10), Arc(10, large=False, right=True)) == pytest.approx(5 * np.pi)
    assert curve_length((10, 0), (0, 10), Arc(10, large=True, right=True)) == pytest.approx(15 * np.pi)


def test_an_arc_to_the_right_bulges_to_the_right() -> None:
    """Travelling along +x, right is -y."""
    middle = curve_points((0, 0), (10, 0), Arc(8, large=False, right=True), np.array([0.5]))[0]
    assert middle[0] == pytest.approx(5)
    assert middle[1] == pytest.approx(-(8 - np.sqrt(64 - 25)))


def test_a_parabola_has_its_closed_length() -> None:
    """y = x² / 2 from x = 0 to 1: (√2 + asinh 1) / 2."""
    control = to_frame((0, 0), (1, 0.5), (0.5, 0.0))
    assert curve_length((0, 0), (1, 0.5), Quadratic(control)) == pytest.approx((np.sqrt(2) + np.arcsinh(1)) / 2)


@pytest.mark.parametrize("curve", CURVES)
def test_ends_are_exact_and_steps_equal(curve: Curve) -> None:
    points = sample_curve(START, END, curve, 60)
    assert tuple(points[0]) == START
    assert tuple(points[-1]) == END
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.ptp(steps) < 0.02 * steps.mean()
    assert steps.sum() == pytest.approx(curve_length(START, END, curve), rel=2e-3)


@pytest.mark.parametrize("curve", CURVES)
def test_tangents_are_derivatives(curve: Curve) -> None:
    t, step = np.linspace(0.1, 0.9, 5), 1e-6
    ahead, behind = (curve_points(START, END, curve, t + s) for s in (step, -step))
    assert np.allclose(curve_tangents(START, END, curve, t), (ahead - behind) / (2 * step), atol=1e-5)


@pytest.mark.parametrize("curve", CURVES)
def test_walked_backwards_it_is_the_same_curve(curve: Curve) -> None:
    t = np.linspace(0, 1, 9)
    back = curve_points(END, START, reversed_curve(curve), 1 - t)
    assert np.allclose(back, curve_points(START, END, curve, t))


@pytest.mark.parametrize("curve", CURVES)
def test_mirrored_it_is_the_mirror_image(curve: Curve) -> None:
    t = np.linspace(0, 1, 9)
    flip = np.array([-1.0, 1.0])
    image = curve_points((-START[0], START[1]), (-END[0], END[1]), mirrored(curve), t)
    assert np.allclose(image, curve_points(START, END, curve, t) * flip)


finite = st.floats(-100, 100)


@given(st.tuples(finite, finite), st.tuples(finite, finite))
def test_the_edge_frame_and_back(start: tuple[float, float], control: tuple[float, float]) -> None:
    end = (start[0] + 3.0, start[1] - 4.0)
    assert from_frame(start, end, to_frame(start, end, control)) == pytest.approx(control, abs=1e-9)


def test_impossible_curves_are_rejected() -> None:
    with pytest.raises(PatternError, match=r"radius 4 cm cannot span a chord of 10 cm"):
        curve_length((0, 0), (10, 0), Arc(4.0, large=False, right=True))
    with pytest.raises(PatternError, match="no length"):
        to_frame((1, 1), (1, 1), (2, 2))
