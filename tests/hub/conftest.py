"""A server and a published data set for every test."""

from collections.abc import Iterator
from pathlib import Path

import aiohttp  # noqa: F401 -- its import takes longer than the patience of these tests
import pytest

from gcd_dataset.hub import fetch
from tests.hub.server import Hub, read_folder, running_hub
from tests.hub.sets import write_set


@pytest.fixture(autouse=True)
def no_long_waits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Waits of milliseconds, and neither the user's token nor the user's cache."""
    for name, value in (("FIRST_WAIT", 0.001), ("DOUBLINGS", 0), ("PATIENCE", 0.8)):
        monkeypatch.setattr(fetch, name, value)
    monkeypatch.setattr("huggingface_hub.constants.HF_TOKEN_PATH", str(tmp_path / "no-token"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of ten samples in three shards, with pictures."""
    return write_set(tmp_path_factory.mktemp("published") / "set")


@pytest.fixture
def hub() -> Iterator[Hub]:
    with running_hub() as server:
        yield server


@pytest.fixture
def commit(hub: Hub, folder: Path) -> str:
    """Publish the data set as ``org/garments`` and below ``/files/garments``; the commit's hash."""
    hub.static |= {f"garments/{name}": data for name, data in read_folder(folder).items()}
    return hub.publish("org/garments", folder)
