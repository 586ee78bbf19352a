"""The case ``ease``: its ruler."""

import pytest

from benchmarks.cases.ease import on_paper, rings_near
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.ease import planes_of
from tests.generator.test_ease import rolled, tube


def test_the_ruler_lies_straight_over_folds() -> None:
    pattern, mesh = tube(50.0)
    body = build_body(neutral_shape())
    plane = planes_of(body, measure(body))["waist"][0]
    (ring,) = rings_near(mesh, rolled(mesh, pattern, 15.0, 1.0), plane)
    assert on_paper(ring, pattern) == pytest.approx(100.0, abs=0.02)
