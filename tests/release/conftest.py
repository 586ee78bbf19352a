"""A release of fake garments."""

import shutil
from pathlib import Path

import pytest

from tests.release.published import publish


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(tmp_path_factory.mktemp("folders"))


@pytest.fixture
def own(folders: Path, tmp_path: Path) -> Path:
    """A copy that the test may damage."""
    return Path(shutil.copytree(folders, tmp_path / "own"))
