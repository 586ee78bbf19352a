"""Paths that begin with ``~`` are expanded for every folder and file argument."""

from pathlib import Path

import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ShardError
from gcd_dataset.files import user_path
from gcd_dataset.hub.remote import Remote
from gcd_dataset.hub.source import Folder, parse_source
from gcd_dataset.loaders import (
    BodyDataset,
    GarmentDataset,
    GeneratedGarments,
    Hdf5Garments,
    PublishedBodies,
    PublishedGarmentCodeData,
)
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.folder import splits_in
from gcd_dataset.shards.hdf5 import write_hdf5
from tests.hub.conftest import no_long_waits  # noqa: F401 - a fixture for every test here
from tests.hub.server import running_hub
from tests.release import published
from tests.shards import people
from tests.shards.folders import fill

COUNT = 3


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_name_that_begins_with_a_tilde_stays() -> None:
    assert user_path("~nobody-is-called-so/data") == Path("~nobody-is-called-so/data")
    assert user_path("data~") == Path("data~")


def test_folders_of_shards(home: Path) -> None:
    fill(Path("~/data"), range(COUNT))
    assert parse_source("~/data") == Folder(home / "data")
    assert len(GarmentDataset("~/data")) == len(GarmentDataset(Path("~/data"))) == COUNT
    assert len(ShardReader("~/data")) == COUNT
    assert splits_in("~/data") == ("train",)


def test_hdf5_files(home: Path) -> None:
    list(write_hdf5(ShardReader(fill(home / "data", range(COUNT))), "~/train.h5"))
    assert len(Hdf5Garments("~/train.h5")) == COUNT


def test_bodies(home: Path) -> None:
    people.fill(home / "bodies", range(2))
    assert len(BodyDataset("~/bodies")) == 2
    with pytest.raises(ShardError, match=str(home / "people")):
        PublishedBodies("~/people")


def test_the_published_folders_and_their_cache(home: Path) -> None:
    published.pack(published.publish(home / "release"))
    assert len(PublishedGarmentCodeData("~/release", cache_dir="~/kept"))
    assert (home / "kept").is_dir()


def test_caches(home: Path) -> None:
    assert Remote(cache_dir="~/cache").folder == home / "cache"
    kept = GeneratedGarments(1, drape=None, cache_dir="~/garments").cache
    assert kept is not None
    assert kept.parent == home / "garments"


def test_downloads(home: Path) -> None:
    with running_hub() as hub:
        hub.publish("org/garments", fill(home / "data", range(COUNT)))
        ds = GarmentDataset("org/garments", root="~/here", cache_dir="~/cache", endpoint=hub.endpoint)
    assert len(ds) == len(GarmentDataset(home / "here")) == COUNT


def test_the_command_line(home: Path) -> None:
    published.fill(home / "data")
    assert main(["info", "~/data"]) == 0
    assert main(["export", "~/data", "--hdf5=~/train.h5", "--quiet"]) == 0
    assert main(["export", "~/data", "--layout", "published", "~/folders", "--quiet"]) == 0
    assert {"train.h5", "folders"} <= {path.name for path in home.iterdir()}
    assert not Path("~").exists()
