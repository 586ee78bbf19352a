"""Real garments: sewing patterns generated for the tests."""

from functools import cache

from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Sample

PATTERNS = MakeConfig(stage="pattern")


@cache
def patterns(count: int) -> tuple[Sample, ...]:
    """Sewing patterns of all kinds on random bodies."""
    return tuple(produce(3, range(count), PATTERNS))
