"""Shards on a server are examined as those in a folder."""

from pathlib import Path

import pytest

from gcd_dataset.verbs import doctor
from tests.hub.server import Hub


@pytest.mark.parametrize("source", ["{}/files/garments", "org/garments"])
def test_the_report_of_a_server_is_that_of_its_folder(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, source: str
) -> None:
    there = doctor(source.format(hub.endpoint), endpoint=hub.endpoint, cache_dir=tmp_path / "cache")
    here = doctor(folder)
    assert (there.splits, there.findings) == (here.splits, here.findings)
    assert not hub.asked("front.jpg")
