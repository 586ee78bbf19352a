"""Viewer and check of a data set on a server: bounded requests."""

from pathlib import Path

import pytest

from gcd_dataset.check import examine
from gcd_dataset.hub.remote import Remote, open_store
from gcd_dataset.shards import ShardReader
from gcd_dataset.viewer.garments import ShardAlbum
from gcd_dataset.viewer.server import Gallery
from tests.hub import conftest
from tests.hub.conftest import COUNT
from tests.hub.server import Hub

commit, folder, hub, no_long_waits = conftest.commit, conftest.folder, conftest.hub, conftest.no_long_waits


def test_the_first_page_requests_no_more_than_its_garment(hub: Hub, commit: str, tmp_path: Path) -> None:
    store = open_store("org/garments", Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache"))
    album = ShardAlbum(ShardReader(store), "org/garments")
    assert album.facets().outcomes == {"settled": COUNT}
    assert not hub.asked(r"\.tar")
    gallery = Gallery(album)  # makes the first page in a thread
    gallery.get("/garment", {"position": "9"})
    gallery._tag_reader.shutdown(wait=True)
    assert not album.facets().kinds
    gallery.close()


@pytest.mark.parametrize("source", ["{}/files/garments", "org/garments"])
def test_the_report_of_a_server_is_that_of_its_folder(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, source: str
) -> None:
    there = examine(source.format(hub.endpoint), endpoint=hub.endpoint, cache_dir=tmp_path / "cache")
    here = examine(folder)
    assert (there.splits, there.findings) == (here.splits, here.findings)
    assert not hub.asked("front.jpg")
