"""Real garments: sewing patterns generated for the tests, and data sets written by an earlier version."""

import tarfile
from functools import cache
from pathlib import Path

from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Sample

__all__ = ["first_schema", "patterns"]

FIRST_SCHEMA = Path(__file__).parent / "data" / "schema1.tar.xz"
PATTERNS = MakeConfig(stage="pattern")


@cache
def patterns(count: int) -> tuple[Sample, ...]:
    """Sewing patterns of all kinds on random bodies."""
    return tuple(produce(3, range(count), PATTERNS))


def first_schema(folder: Path) -> Path:
    """A folder with data sets of schema 1: three ``patterns``, one of ``drapes`` at 10 cm, three ``bodies``."""
    with tarfile.open(FIRST_SCHEMA) as archive:
        archive.extractall(folder, filter="data")
    return folder / "schema1"
