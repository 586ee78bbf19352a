"""A garment with everything that exports need, and patterns as users have them."""

import pytest

from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Pattern, Sample
from tests.exports.patterns import darted, quarter_circle, squares
from tests.helpers import as_draped


@pytest.fixture(scope="session")
def worn() -> Sample:
    """A generated garment; its box mesh stands for its drape."""
    return as_draped(make(3, 0, MakeConfig(bodies="neutral", stage="mesh", resolution=4.0, points=16)))


@pytest.fixture(scope="session")
def patterns(worn: Sample) -> tuple[Pattern, ...]:
    """Shapes with known areas, and a sampled garment."""
    return squares(), darted(), quarter_circle(), worn.pattern
