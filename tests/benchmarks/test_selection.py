"""``Shift``: ``moved`` is the share of values that moved; for random changes ``noise`` is its expected value."""

import numpy as np
import pytest

from benchmarks.cases.design_space import UNUSED, shift
from gcd_dataset.generator.garments.parameter import Choice, Real
from gcd_dataset.generator.garments.space import Leaf

LENGTH = Leaf("skirt.length", Real(0.0, 0.4, 0.0, 1.0))
CUT = Leaf("skirt.cut", Choice("plain", None, ("plain", "flared")))


def test_nothing_moves_without_selection() -> None:
    values = list(np.linspace(0, 1, 101))
    assert shift(LENGTH, values, values, paired=True).moved == 0
    assert shift(LENGTH, values, values, paired=True).noise == 0


def test_a_limit_moves_the_share_above_it() -> None:
    values = [0.01 + 0.98 * k / 999 for k in range(1000)]
    within = [value if value < 0.75 else value - 0.75 for value in values]
    found = shift(LENGTH, values, within, paired=True)
    assert found.moved == pytest.approx(0.25, abs=0.02)
    assert found.rare == ("0.75 to 1",)


def test_options_are_compared_by_share() -> None:
    found = shift(CUT, ["plain", "flared"] * 100, ["plain"] * 100, paired=False)
    assert found.moved == pytest.approx(0.5)
    assert found.rare == ("flared",)


def test_designs_without_the_parameter_do_not_count() -> None:
    assert shift(CUT, ["plain", UNUSED, "flared"], ["plain", "plain", "flared"], paired=True).moved == pytest.approx(
        1 / 6
    )


def test_chance_moves_as_much_as_the_noise() -> None:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(60):
        values = list(rng.uniform(0.001, 1, 3000))
        replaced = [
            value if keep else rng.uniform(0.001, 1) for value, keep in zip(values, rng.random(3000) < 0.8, strict=True)
        ]
        accepted = list(rng.choice(values, 1000, replace=False))
        found.append((shift(LENGTH, values, replaced, paired=True), shift(LENGTH, values, accepted, paired=False)))
    for column in zip(*found, strict=True):
        moved, noise = np.mean([s.moved for s in column]), np.mean([s.noise for s in column])
        assert moved == pytest.approx(noise, rel=0.1)
