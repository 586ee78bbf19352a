"""Keyed random streams."""

import itertools

import numpy as np
import pytest

from gcd_dataset.seeding import Stage, rng


def test_the_same_key_gives_the_same_numbers() -> None:
    assert np.array_equal(rng(7, 12, Stage.DESIGN, 1).random(5), rng(7, 12, Stage.DESIGN, 1).random(5))


def test_every_key_has_its_own_stream() -> None:
    names = list(itertools.product((0, 1), (0, 1), (Stage.BODY, Stage.DESIGN), (0, 1)))
    first = {rng(seed, index, stage, attempt).integers(2**63) for seed, index, stage, attempt in names}
    assert len(first) == len(names)


def test_the_numbers_of_a_release_stay() -> None:
    """A change here would change every sample of every published seed."""
    assert rng(0, 0, Stage.BODY).integers(1000, size=3).tolist() == [199, 964, 836]


def test_neighbours_are_uncorrelated() -> None:
    draws = np.array([rng(3, index, Stage.DESIGN).standard_normal(4) for index in range(500)])
    assert np.abs(np.corrcoef(draws[:-1, 0], draws[1:, 0])[0, 1]) < 0.15
    assert np.abs(draws.mean(axis=0)).max() < 0.2


def test_keys_are_natural_numbers() -> None:
    with pytest.raises(ValueError, match="index is -1"):
        rng(0, -1, Stage.BODY)
