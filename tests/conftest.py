"""Fixtures for all tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Deterministic and without deadlines; make test-extras takes "many", and --hypothesis-profile=default explores.
settings.register_profile("same", derandomize=True, deadline=None, max_examples=20)
settings.register_profile("many", derandomize=True, deadline=None, max_examples=60)
settings.load_profile("same")

EXAMPLES = Path(__file__).resolve().parent.parent.parent / "shared" / "examples"


@pytest.fixture(scope="session", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache of columns and shards that ends with the tests, also for processes that they start."""
    before = os.environ.get("GCD_CACHE")
    os.environ["GCD_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield
    os.environ.pop("GCD_CACHE")
    if before is not None:
        os.environ["GCD_CACHE"] = before


@pytest.fixture(scope="session")
def examples() -> Path:
    """Patterns, meshes and bodies of the reference system, from outside this repository.

    ``published`` holds its patterns in the published layout, draped by another solver (Newton): no drape is ETH's.
    """
    if not EXAMPLES.is_dir():
        pytest.skip("the reference examples are not beside this checkout")
    return EXAMPLES
