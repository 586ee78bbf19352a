"""A garment with everything that exports need, and patterns as users have them."""

from dataclasses import replace

import pytest

from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Drape, Outcome, Pattern, Sample
from tests.exports.patterns import darted, quarter_circle, squares


@pytest.fixture(scope="session")
def worn() -> Sample:
    """A generated garment whose drape is faked: the vertices are the start positions, a little moved."""
    made = make(3, 0, MakeConfig(bodies="neutral", stage="mesh", resolution=4.0, points=16))
    assert made.box_mesh is not None
    moved = made.box_mesh.vertices + 1e-3 * (1 + made.box_mesh.vertices[:, :1])
    return replace(made, drape=Drape(moved, Outcome.SETTLED, 100, 1, 2, 1.0, 1.1))


@pytest.fixture(scope="session")
def patterns(worn: Sample) -> tuple[Pattern, ...]:
    """Shapes with known areas, and a sampled garment."""
    return squares(), darted(), quarter_circle(), worn.pattern
