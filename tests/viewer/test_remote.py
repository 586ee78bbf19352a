"""Viewer and check of a data set on a server: bounded requests, and tags that are requested in parts."""

from pathlib import Path

import pytest

from gcd_dataset.check import examine
from gcd_dataset.hub.remote import Remote, open_store
from gcd_dataset.shards import ShardReader
from gcd_dataset.viewer import garments as albums
from gcd_dataset.viewer.garments import ShardAlbum
from gcd_dataset.viewer.server import Gallery
from tests.hub import conftest
from tests.hub.conftest import COUNT
from tests.hub.server import Fault, Hub

commit, folder, hub, no_long_waits = conftest.commit, conftest.folder, conftest.hub, conftest.no_long_waits


def opened(hub: Hub, tmp_path: Path) -> ShardAlbum:
    store = open_store("org/garments", Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache"))
    return ShardAlbum(ShardReader(store), "org/garments")


def test_the_first_page_requests_no_more_than_its_garment_and_a_part_of_the_tags(
    hub: Hub, commit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(albums, "REQUESTED", 4)
    album = opened(hub, tmp_path)
    assert album.facets().outcomes == {"settled": COUNT}
    assert not hub.asked(r"\.tar")
    gallery = Gallery(album)  # makes the first page in a thread
    gallery.get("/garment", {"position": "9"})
    gallery._tag_reader.shutdown(wait=True)
    assert album.known == 4
    gallery.close()


def test_more_tags_are_requested_on_demand(
    hub: Hub, commit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(albums, "REQUESTED", 4)
    album = opened(hub, tmp_path)
    assert album.waits
    for known in (4, 8, COUNT):
        album.read_tags()
        assert album.known == known


def test_reading_tags_ends_where_the_server_fails(hub: Hub, commit: str, tmp_path: Path) -> None:
    album = opened(hub, tmp_path)
    hub.faults.append(Fault(r"\.tar", times=10**6, status=503))
    album.read_tags()
    assert album.known == 0 and "503" in album.problem
    hub.faults.clear()
    album.read_tags()
    assert album.known == COUNT and not album.problem


def test_a_damaged_garment_on_the_server_does_not_end_the_reading(hub: Hub, commit: str, tmp_path: Path) -> None:
    album = opened(hub, tmp_path)
    start = int(album._reader.index.start[2])
    hub.faults.append(Fault(r"train-00000\.tar", times=10**6, flip=start + 700))
    album.read_tags()
    assert album.known == COUNT and not album.problem
    assert album.facets().outcomes == {"settled": COUNT}
    assert album._with("outcome", "settled").sum() == COUNT - 1


@pytest.mark.parametrize("source", ["{}/files/garments", "org/garments"])
def test_the_report_of_a_server_is_that_of_its_folder(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, source: str
) -> None:
    there = examine(source.format(hub.endpoint), endpoint=hub.endpoint, cache_dir=tmp_path / "cache")
    here = examine(folder)
    assert (there.splits, there.findings) == (here.splits, here.findings)
    assert not hub.asked("front.jpg")
