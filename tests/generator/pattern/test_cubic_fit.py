"""Curves fitted to tangents and a length."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest

from gcd_dataset.curves import curve_points
from gcd_dataset.errors import FitError
from gcd_dataset.generator.pattern import smooth_cubic

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
