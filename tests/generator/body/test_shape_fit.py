"""Bodies fitted to measures."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import build_body, draw_shape, fit_shape, measure, neutral_shape
from gcd_dataset.records import ANGLES, MEASURES, Measurements
from gcd_dataset.seeding import Stage, rng

LENGTHS = [name for name in MEASURES if name not in ANGLES]


def values(size: Measurements, names: list[str] | tuple[str, ...] = MEASURES) -> np.ndarray:
    return np.array([getattr(size, name) for name in names])


def test_the_measures_of_a_drawn_body_are_fitted_to_a_millimetre() -> None:
    drawn = draw_shape(rng(0, 2, Stage.BODY))
    size = measure(build_body(drawn))
    found = fit_shape(size)
    assert np.abs(values(found.residual, LENGTHS)).max() < 0.1
    assert np.degrees(np.abs(values(found.residual, tuple(ANGLES)))).max() < 0.2
    assert found.shape.arm_angle == pytest.approx(drawn.arm_angle, abs=0.01)
    apart = build_body(found.shape).vertices - build_body(drawn).vertices
    assert np.linalg.norm(apart, axis=1).mean() < 0.5


def test_residuals_are_the_errors_of_the_fitted_body() -> None:
    wanted = Measurements(height=168.0, bust=92.0, waist=78.0, hips=104.0)
    found = fit_shape(wanted)
    measured = measure(build_body(found.shape))
    for name in ("height", "bust", "waist", "hips"):
        assert getattr(measured, name) == pytest.approx(getattr(wanted, name), abs=0.1)
        assert getattr(measured, name) - getattr(wanted, name) == pytest.approx(getattr(found.residual, name), abs=1e-9)
    assert np.isnan(found.residual.wrist)


def test_ten_percent_larger_measures_fit_a_ten_percent_larger_body() -> None:
    small = draw_shape(rng(0, 0, Stage.BODY))
    size = measure(build_body(small))
    larger = replace(size, **{name: 1.1 * getattr(size, name) for name in LENGTHS})
    found = fit_shape(larger)
    assert np.sqrt((values(found.residual, LENGTHS) ** 2).mean()) < 0.3
    apart = build_body(found.shape).vertices - 1.1 * build_body(small).vertices
    assert np.linalg.norm(apart, axis=1).mean() < 1.5


def test_open_measures_get_probable_values() -> None:
    neutral = measure(build_body(neutral_shape()))
    found = measure(build_body(fit_shape(Measurements(height=neutral.height)).shape))
    assert values(found, LENGTHS) == pytest.approx(values(neutral, LENGTHS), rel=0.1)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (Measurements(), "no measure is given"),
        (Measurements(height=-3.0), "height is -3 cm.*give a length in cm"),
        (Measurements(waist=np.inf), "waist is inf"),
        (Measurements(height=1.72), "height is 1.72 cm, and 17"),
    ],
)
def test_impossible_measures_are_errors_with_a_remedy(size: Measurements, message: str) -> None:
    with pytest.raises(BodyError, match=message):
        fit_shape(size)


def test_a_body_too_far_from_the_mean_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """``REACH`` is lowered, so that few iterations exceed it."""
    monkeypatch.setattr(sys.modules["gcd_dataset.generator.body.shape_fit"], "REACH", 1.0)
    with pytest.raises(BodyError, match=r"no adult has these.*standard deviations.*in cm, all of one person"):
        fit_shape(Measurements(height=215.0))
