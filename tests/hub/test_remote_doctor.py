"""Shards on a server are examined as those in a folder."""

from pathlib import Path

import pytest

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardWriter
from gcd_dataset.verbs import doctor
from tests.hub.conftest import COUNT
from tests.hub.server import Hub


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten garments in three shards."""
    path = tmp_path_factory.mktemp("garments")
    with ShardWriter(path, seed=0, recipe={"stage": "drape"}, shard_size=4) as writer:
        for number in range(COUNT):
            writer.write(fake_sample(0, number))
    return path


@pytest.mark.parametrize("source", ["{}/files/garments", "org/garments"])
def test_the_report_of_a_server_is_that_of_its_folder(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, source: str
) -> None:
    there = doctor(source.format(hub.endpoint), endpoint=hub.endpoint, cache_dir=tmp_path / "cache")
    here = doctor(folder)
    assert (there.splits, there.findings) == (here.splits, here.findings)
    assert not hub.asked("front.jpg")
