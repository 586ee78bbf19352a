"""Fixtures that every folder of tests shares."""

from pathlib import Path

import pytest
from hypothesis import settings

# Every run tries the same; --hypothesis-profile=default explores; and nothing is timed.
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")

EXAMPLES = Path(__file__).resolve().parent.parent.parent / "shared" / "examples"


@pytest.fixture(scope="session")
def examples() -> Path:
    """Patterns, meshes and bodies by the reference system, which live outside this tree."""
    if not EXAMPLES.is_dir():
        pytest.skip("the reference examples are not beside this checkout")
    return EXAMPLES
