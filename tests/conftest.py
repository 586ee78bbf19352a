"""Fixtures for all tests."""

from pathlib import Path

import pytest
from hypothesis import settings

# Deterministic and without deadlines; --hypothesis-profile=default explores.
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")

EXAMPLES = Path(__file__).resolve().parent.parent.parent / "shared" / "examples"


@pytest.fixture(scope="session")
def examples() -> Path:
    """Patterns, meshes and bodies of the reference system, from outside this repository."""
    if not EXAMPLES.is_dir():
        pytest.skip("the reference examples are not beside this checkout")
    return EXAMPLES
