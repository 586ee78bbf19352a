"""Downloads into folders: whole, without pictures, and after interruptions."""

import multiprocessing
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.errors import ConfigError, OutputError, RemoteError, ShardError
from gcd_dataset.hub.download import download
from gcd_dataset.hub.remote import Remote, open_store
from gcd_dataset.hub.source import Repo, Url
from gcd_dataset.shards.folder import DOWNLOAD_FILE, FolderStore
from gcd_dataset.shards.index import SplitIndex
from gcd_dataset.shards.layout import is_picture
from gcd_dataset.shards.manifest import Manifest, read_manifest
from tests.hub.server import Fault, Hub, read_folder
from tests.hub.sets import read, write_set

REPO = Repo("org/garments")


def remote(hub: Hub, tmp_path: Path) -> Remote:
    return Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache")


def bring(hub: Hub, tmp_path: Path, source: Repo | Url = REPO, **options: Any) -> Path:
    download(source, tmp_path / "data", remote(hub, tmp_path), **options)
    return tmp_path / "data"


def put_up(hub: Hub, folder: Path) -> Url:
    hub.static = {f"garments/{name}": data for name, data in read_folder(folder).items()}
    return Url(f"{hub.endpoint}/files/garments")


def without_record(folder: Path) -> dict[str, bytes]:
    return {name: data for name, data in read_folder(folder).items() if name != DOWNLOAD_FILE}


@pytest.mark.parametrize("from_url", [False, True])
def test_a_download_equals_the_published_folder(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, from_url: bool
) -> None:
    reports: list[tuple[int, int]] = []
    source = Url(f"{hub.endpoint}/files/garments") if from_url else REPO
    data = bring(hub, tmp_path, source, on_progress=lambda received, total: reports.append((received, total)))
    assert without_record(data) == read_folder(folder)
    total = sum(len(content) for name, content in read_folder(folder).items() if name.endswith(".tar"))
    assert reports[0] == (0, total) and reports[-1] == (total, total)
    assert not list(data.rglob(".*"))
    hub.log.clear()
    bring(hub, tmp_path, source)
    assert len(hub.asked()) == 1  # the current revision


def test_a_download_without_pictures_is_a_whole_data_set(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    data = bring(hub, tmp_path, views=False)
    assert not hub.asked("views/") and not (data / "views").exists()
    record = Manifest(**vars(read_manifest(data))).splits["train"]
    assert not any(map(is_picture, record.members))
    index = SplitIndex.from_bytes((data / "train.index").read_bytes(), record, "")
    assert not index.has_views and len(index.views_blocks) == 0
    hub.log.clear()
    assert without_record(bring(hub, tmp_path)) == read_folder(folder)
    assert {request.path.split("/")[-2] for request in hub.asked("resolve.*tar")} == {"views"}


def test_splits_are_downloaded_one_by_one(hub: Hub, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    whole = write_set(tmp_path / "whole", {"train": 9, "test": 3})
    hub.publish("org/garments", whole)
    store = open_store(bring(hub, tmp_path, splits=["test"]))
    assert list(store.manifest().splits) == ["test"]
    assert store.unfinished("test") is None
    assert not list((tmp_path / "data").glob("train*"))
    assert without_record(bring(hub, tmp_path, splits=["train"])) == read_folder(whole)
    with pytest.raises(ShardError, match="no samples of split val: choose from"):
        bring(hub, tmp_path, splits=["val"])


def test_root_downloads_first(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    def opened(source: str = "org/garments", **options: Any) -> Any:
        options = {"endpoint": hub.endpoint, "cache_dir": tmp_path / "cache", **options}
        return open_store(source, Remote(**options), root=tmp_path / "data", splits=["train"])

    opened()
    hub.stop()
    for options in ({}, {"allowed": False}, {"revision": commit}):
        store = opened(**options)
        assert (store.source, store.remedy) == (
            f"hf://datasets/org/garments@{commit}",
            "delete it, and run gcd download again",
        )
        assert read(store, 0) == read(FolderStore(folder), 0)
    for source, revision in (("org/others", None), ("org/garments", "0" * 40)):
        with pytest.raises(ConfigError, match=rf"holds hf://datasets/org/garments@{commit}, asked for .*{source}"):
            opened(source, allowed=False, revision=revision)


# ------------------------------------------------------------------------------------------------------------- stopped


def test_a_stopped_download_continues(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    hub.faults = [
        Fault(r"storage/[^/]+/train-00001", cut=20_000),
        Fault(r"storage/[^/]+/train-0000[12]", drop=True, times=10**6),
    ]
    with pytest.raises(RemoteError, match="received data are kept"):
        bring(hub, tmp_path)
    with pytest.raises(ShardError, match=r"the download of hf://.* is incomplete: run gcd download again"):
        open_store(tmp_path / "data").manifest()
    hub.faults.clear()
    hub.log.clear()
    assert without_record(bring(hub, tmp_path)) == read_folder(folder)
    assert not hub.asked(r"storage/[^/]+/train-00000")
    (rest,) = hub.asked(r"storage/[^/]+/train-00001")
    assert rest.span.startswith("bytes=20000-")


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_killed_download_continues(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    hub.faults = [Fault(r"storage/[^/]+/train-00002", cut=10_000, hold=True, times=99)]
    child = multiprocessing.get_context("fork").Process(target=bring, args=(hub, tmp_path))
    child.start()
    data = tmp_path / "data"
    part, others = data / ".train-00002.tar.part", [data / f"train-0000{number}.tar" for number in (0, 1)]
    while not (part.exists() and part.stat().st_size >= 10_000 and all(path.exists() for path in others)):
        assert child.is_alive()
        time.sleep(0.01)
    child.kill()
    child.join()
    hub.faults.clear()
    hub.log.clear()
    assert without_record(bring(hub, tmp_path)) == read_folder(folder)
    assert not hub.asked(r"storage/[^/]+/train-0000[01]")
    assert not list((tmp_path / "data").rglob(".*"))


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_two_processes_share_a_download(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    children = [multiprocessing.get_context("fork").Process(target=bring, args=(hub, tmp_path)) for _ in range(2)]
    for child in children:
        child.start()
    for child in children:
        child.join()
    assert without_record(tmp_path / "data") == read_folder(folder)
    assert len(hub.asked(r"storage/.*tar")) <= 6


def test_damaged_cut_and_missing_tars_are_downloaded_again(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    data = bring(hub, tmp_path)
    content = (data / "train-00002.tar").read_bytes()
    (data / "train-00002.tar").write_bytes(bytes([content[0] ^ 1]) + content[1:])  # of the right length
    (data / "train-00001.tar").unlink()
    (data / "views" / "train-00000.tar").write_bytes(b"cut")
    hub.log.clear()
    assert without_record(bring(hub, tmp_path)) == read_folder(folder)
    assert len(hub.asked(r"storage/.*tar")) == 3


def test_a_wrong_hash_leaves_nothing(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.faults = [Fault(r"storage/[^/]+/train-00001", flip=300, times=99)]
    with pytest.raises(RemoteError, match=r"train-00001\.tar: received bytes do not match the published hash"):
        bring(hub, tmp_path)
    assert not list((tmp_path / "data").glob("*train-00001*"))
    assert read_manifest(tmp_path / "data") is None


def test_a_disk_without_room_is_reported_before_anything_is_sent(
    hub: Hub, commit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(9, 8, 1))
    with pytest.raises(OutputError, match=r"data: \d+ bytes are needed, and 1 are free: make room"):
        bring(hub, tmp_path)
    assert not hub.asked(r"\.tar")


# ------------------------------------------------------------------------------------------------------------- changed


def test_a_grown_data_set_is_updated(hub: Hub, tmp_path: Path) -> None:
    source = put_up(hub, write_set(tmp_path / "theirs", {"train": 10}))
    bring(hub, tmp_path, source)
    put_up(hub, write_set(tmp_path / "theirs", {"train": 14}))
    hub.log.clear()
    assert without_record(bring(hub, tmp_path, source)) == read_folder(tmp_path / "theirs")
    assert not hub.asked(r"train-0000[01]\.tar")  # full shards that are here already


def test_a_shrunk_data_set_leaves_no_stale_shards(hub: Hub, tmp_path: Path) -> None:
    bring(hub, tmp_path, put_up(hub, write_set(tmp_path / "more", {"train": 10})))
    source = put_up(hub, write_set(tmp_path / "less", {"train": 4}))
    assert without_record(bring(hub, tmp_path, source)) == read_folder(tmp_path / "less")


def test_another_data_set_is_refused(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    before = read_folder(folder)
    for data in (
        folder,
        shutil.copytree(folder, tmp_path / "tars", ignore=lambda _, names: {*names} - {"train-00000.tar"}),
    ):
        with pytest.raises(ConfigError, match="holds a data set that was not downloaded"):
            download(REPO, data, remote(hub, tmp_path))
    assert read_folder(folder) == before
    bring(hub, tmp_path)
    later = hub.publish("org/garments", {**read_folder(folder), "README.md": b"words"})
    with pytest.raises(ConfigError, match=rf"holds hf://datasets/org/garments@{commit}, asked for .*@{later}"):
        bring(hub, tmp_path, Repo("org/garments", later))
    data, source = tmp_path / "other", put_up(hub, folder)
    download(source, data, remote(hub, tmp_path))
    put_up(hub, write_set(tmp_path / "seed", seed=1))
    with pytest.raises(ConfigError, match="made with seed=0, asked for seed=1"):
        download(source, data, remote(hub, tmp_path))
    assert without_record(data) == read_folder(folder)
