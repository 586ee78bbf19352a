"""Data sets on servers: revisions, requests, damage, eviction; downloads: whole, without pictures, interrupted."""

import multiprocessing
import pickle
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import fsspec
import pytest

from gcd_dataset.errors import ConfigError, GcdError, MissingError, OutputError, RefusedError, RemoteError, ShardError
from gcd_dataset.hub import fetch
from gcd_dataset.hub.download import download
from gcd_dataset.hub.remote import MOST_SAMPLES, PARALLEL, Remote, RemoteStore, open_store
from gcd_dataset.hub.source import Folder, Repo, Url, parse_source
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards.index import SplitIndex
from gcd_dataset.shards.layout import is_picture
from gcd_dataset.shards.manifest import MANIFEST, Manifest, parse_manifest, read_manifest
from gcd_dataset.shards.store import DOWNLOAD_FILE, FolderStore
from tests.helpers import flip
from tests.hub.conftest import COUNT, ensure, read, write_set
from tests.hub.server import Fault, Hub, read_folder

REPO = Repo("org/garments")


def remote(hub: Hub, tmp_path: Path, **options: Any) -> Remote:
    return Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache", **options)


def opened(hub: Hub, tmp_path: Path, source: Repo | Url = REPO, **options: Any) -> RemoteStore:
    return RemoteStore(source, remote(hub, tmp_path, **options))


def url_of(hub: Hub) -> Url:
    return Url(f"{hub.endpoint}/files/garments")


@pytest.fixture(scope="session")
def here(folder: Path) -> FolderStore:
    return FolderStore(folder)


@pytest.mark.parametrize("from_url", [False, True])
def test_opening_and_the_first_sample_take_three_requests(
    hub: Hub, commit: str, here: FolderStore, folder: Path, tmp_path: Path, from_url: bool
) -> None:
    store = opened(hub, tmp_path, url_of(hub) if from_url else REPO)
    assert read(store, 7) == read(here, 7)
    answered = [request for request in hub.asked() if request.status != 302]
    assert len(answered) == 3
    assert answered[-1].size == len(read(here, 7))
    assert store.manifest().to_bytes() == (folder / MANIFEST).read_bytes()


def test_a_window_takes_a_request_for_each_shard_and_nothing_is_requested_twice(
    hub: Hub, commit: str, here: FolderStore, folder: Path, tmp_path: Path
) -> None:
    store = opened(hub, tmp_path, url_of(hub))
    for views in (False, True):
        ensure(store, views=views)
        assert len(hub.asked(r"views/.*tar" if views else r"garments/train.*tar")) == 3
    store.index("train")
    hub.log.clear()
    assert [read(store, number) for number in range(COUNT)] == [read(here, number) for number in range(COUNT)]
    assert read(store, 9, views=True) == read(here, 9, views=True)
    ensure(store)
    assert not hub.log
    shards = store.manifest().splits["train"].shards
    assert [(store.cache / shard.sha256 / "tar").read_bytes() for shard in shards] == [
        (folder / shard.name("train")).read_bytes() for shard in shards
    ]


def test_an_error_ends_all_requests_of_a_window(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.publish("org/garments", write_set(tmp_path / "set", {"train": 4 * 20}))
    store = opened(hub, tmp_path)
    hub.faults = [Fault(r"storage/.*tar", status=403, times=99)]
    with pytest.raises(RefusedError, match=r"train-000\d\d\.tar: refused \(403\)"):
        ensure(store)
    assert len(hub.asked("storage/")) <= PARALLEL
    hub.faults = [Fault(r"garments/.*\.tar", status=403, times=99)]
    stream = GarmentDataset(url_of(hub).url, streaming=True, cache_dir=tmp_path / "cache")
    with pytest.raises(RefusedError, match=r"^http://[^ ]*/train-00000\.tar: refused \(403\)"):
        next(iter(stream))


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_several_samples_are_requested_together_and_a_store_may_be_pickled_and_forked(
    hub: Hub, commit: str, here: FolderStore, tmp_path: Path
) -> None:
    store = opened(hub, tmp_path)
    index = store.index("train")
    spans = [(index.record.shards[index.shard[n]], int(index.start[n]), int(index.end[n]), False) for n in (8, 1, 1)]
    assert list(store.parts("train", spans)) == [read(here, number) for number in (8, 1, 1)]
    with multiprocessing.get_context("fork").Pool(1) as pool:  # a connection is open
        assert pool.apply(read, (store, 5)) == read(here, 5)
    assert read(pickle.loads(pickle.dumps(store)), 6) == read(here, 6)


def test_a_private_repository_needs_a_token_that_no_other_host_gets(
    hub: Hub, here: FolderStore, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "netrc").write_text("default login me password secret\n")
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    hub.publish("org/garments", folder, private=True)
    with pytest.raises(RefusedError, match=r"refused .* run hf auth login or set HF_TOKEN"):
        opened(hub, tmp_path)
    store = opened(hub, tmp_path, token=hub.token)
    assert read(store, 1) == read(here, 1)
    ensure(store)
    assert all(request.authorization == f"Bearer {hub.token}" for request in hub.asked("resolve")[1:])
    assert hub.asked("storage")
    assert not any(request.authorization for request in hub.asked("storage"))


def test_a_branch_is_looked_up_once(hub: Hub, commit: str, here: FolderStore, folder: Path, tmp_path: Path) -> None:
    store = opened(hub, tmp_path)
    assert (store.revision, store.source) == (commit, f"hf://datasets/org/garments@{commit}")
    hub.publish("org/garments", {"README.md": b"all else is gone"})
    assert read(store, 3) == read(here, 3)
    assert read(opened(hub, tmp_path, replace(REPO, revision=commit)), 4) == read(here, 4)
    with pytest.raises(MissingError, match="not found"):
        opened(hub, tmp_path)


@pytest.mark.parametrize("from_url", [False, True])
def test_what_is_cached_is_read_without_a_server(
    hub: Hub, commit: str, here: FolderStore, tmp_path: Path, from_url: bool
) -> None:
    source = url_of(hub) if from_url else REPO
    shard = opened(hub, tmp_path, source).index("train").record.shards[1]
    opened(hub, tmp_path, source).path("train", shard)
    hub.stop()
    pinned = [] if from_url else [replace(REPO, revision=commit)]
    for store in (
        opened(hub, tmp_path, source),
        opened(hub, tmp_path, source, allowed=False),
        *(opened(hub, tmp_path, one) for one in pinned),
    ):
        assert read(store, 5) == read(here, 5)
        with pytest.raises(RemoteError, match=r"train-00000\.tar is not in the cache, and download=False|no answer"):
            read(store, 0)
    with pytest.raises(RemoteError, match=r"manifest\.json is not in the cache, and download=False"):
        opened(hub, tmp_path / "other", source, allowed=False)


def test_missing_data_sets_and_options_out_of_place_are_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    sources: list[tuple[Repo | Url, dict[str, Any], type[GcdError], str]] = [
        (Repo("org/nothing"), {}, RefusedError, "refused"),
        (replace(REPO, revision="v9"), {}, MissingError, r"not found .* a data set becomes visible"),
        (Url(f"{hub.endpoint}/files/none"), {}, MissingError, r"not found .* visible when its upload is complete"),
        (Url("memory://x"), {}, ConfigError, "endpoint and token are for the Hub, not for memory://x"),
        (REPO, {"max_cache_size": "lots"}, ConfigError, "max_cache_size=.*: give"),
        (REPO, {"patience": -1}, ConfigError, "patience=.*: give"),
        (REPO, {"patience": float("nan")}, ConfigError, "patience=.*: give"),
    ]
    for source, options, error, message in sources:
        with pytest.raises(error, match=message):
            opened(hub, tmp_path, source, **options)
    with pytest.raises(ShardError, match="no samples of split test: choose from train"):
        opened(hub, tmp_path).index("test")
    hub.static["datasets/org/garments/resolve/main/manifest.json"] = hub.static["garments/manifest.json"]
    with pytest.raises(RemoteError, match=r"'' is not a commit of the Hub: check endpoint"):
        RemoteStore(REPO, Remote(endpoint=f"{hub.endpoint}/files", cache_dir=tmp_path / "other"))
    hub.publish("org/garments", write_set(tmp_path / "bare", views=False))
    store = opened(hub, tmp_path)
    with pytest.raises(ShardError, match=r"views/train-00000\.tar: these garments have no pictures"):
        store.path("train", store.manifest().splits["train"].shards[0], views=True)


@pytest.mark.parametrize("name", ["manifest.json", "train.index"])
def test_small_files_that_are_damaged_on_the_way_or_in_the_cache_are_fetched_again(
    hub: Hub, commit: str, here: FolderStore, tmp_path: Path, name: str
) -> None:
    hub.faults = [Fault(name, flip=70, times=2)]
    with pytest.raises(ShardError, match=rf"{name}: (not a manifest|received bytes do not match)"):
        read(opened(hub, tmp_path), 2)
    assert not list(tmp_path.rglob(name))
    hub.faults = [Fault(name, flip=70)]
    assert read(opened(hub, tmp_path), 2) == read(here, 2)
    (cached,) = (tmp_path / "cache").rglob(name)
    whole = cached.read_bytes()
    for damaged in (b"", whole[:-9], bytes([*whole[:50], whole[50] ^ 1, *whole[51:]])):
        cached.write_bytes(damaged)
        assert read(opened(hub, tmp_path, replace(REPO, revision=commit)), 2) == read(here, 2)
        assert cached.read_bytes() == whole


def hostile(hub: Hub, change: Any) -> Url:
    """The URL of the data set with another manifest, whose digest is right."""
    manifest = parse_manifest(hub.static["garments/manifest.json"], "")
    record = change(manifest.splits["train"])
    hub.static |= {f"evil/{name.partition('/')[2]}": data for name, data in hub.static.items()}
    hub.static["evil/manifest.json"] = replace(manifest, splits={"train": record}).to_bytes()
    return Url(f"{hub.endpoint}/files/evil")


def test_hostile_manifests_are_one_sentence(hub: Hub, commit: str, tmp_path: Path) -> None:
    def first(**changes: Any) -> Any:
        return lambda record: replace(record, shards=(replace(record.shards[0], **changes), *record.shards[1:]))

    with pytest.raises(RemoteError, match=f"over the limit of {MOST_SAMPLES}"):
        opened(hub, tmp_path, hostile(hub, first(count=1 << 30))).index("train")
    store = opened(hub, tmp_path, hostile(hub, first(size=1 << 39)))
    with pytest.raises(ConfigError, match=f"{1 << 39} bytes at once exceed the limit of {50 * 10**9}"):
        store.path("train", store.manifest().splits["train"].shards[0])
    with pytest.raises(RemoteError, match=f"a sample of {1 << 39} bytes, over the limit"):
        store.part("train", store.manifest().splits["train"].shards[0], 0, 1 << 39)
    with pytest.raises(ShardError, match="not the index of these shards"):
        opened(hub, tmp_path, hostile(hub, first(size=2048))).index("train")


def test_the_shard_used_longest_ago_is_evicted_with_its_columns(
    hub: Hub, commit: str, here: FolderStore, tmp_path: Path
) -> None:
    store = opened(hub, tmp_path, max_cache_size=100_000)  # two of three shards, of 42 kB at most
    first, second, third = store.manifest().splits["train"].shards
    store.cache.mkdir(parents=True)
    (store.cache / f".{'0' * 64}.tar.part").write_bytes(bytes(90_000))  # a download that nobody continues
    (store.cache / ".evicted-0").mkdir()
    for shard in (first, second):
        (store.path("train", shard).parent / "verts").write_bytes(b"a column")
    store.path("train", first)  # used again
    store.path("train", third)
    assert {path.name for path in store.cache.iterdir()} == {first.sha256, third.sha256}
    (store.cache / first.sha256 / "tar").write_bytes(b"cut")  # not read
    assert read(store, 1) == read(here, 1)
    shutil.rmtree(store.cache / first.sha256)
    assert read(store, 1) == read(here, 1)


def test_any_store_of_fsspec_is_read(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec.filesystem("memory").pipe({f"/{tmp_path.name}/{name}": data for name, data in read_folder(folder).items()})
    store = RemoteStore(Url(f"memory://{tmp_path.name}"), Remote(cache_dir=tmp_path / "cache"))
    ensure(store)
    assert read(store, 3) == read(FolderStore(folder), 3)
    assert read(store, 3, views=True) == read(FolderStore(folder), 3, views=True)
    monkeypatch.setattr(fetch, "_store", Mock(side_effect=ImportError("Install s3fs to access S3")))
    with pytest.raises(ConfigError, match=r"S3 needs the package s3fs: pip install 'gcd-dataset\[s3\]'"):
        RemoteStore(Url("s3://bucket/set"), Remote(cache_dir=tmp_path))


def test_sources_are_parsed(tmp_path: Path) -> None:
    assert parse_source("s3://bucket/set/") == Url("s3://bucket/set")
    assert parse_source(tmp_path.as_uri()) == parse_source(tmp_path) == Folder(tmp_path)
    for source in ("no folder", "nothing://a", "simplecache::s3://a/b", "org/a@b c", "s3://a\nb"):
        with pytest.raises(ConfigError, match=r"no such folder, and neither a URL|is not a revision"):
            parse_source(source)
    for url in ("http://[bad/x", "http://host:99999999/x", "https:///x", "https://exa mple/x"):
        with pytest.raises(ConfigError, match="not a server address"):
            parse_source(url)
    with pytest.raises(ConfigError, match="revision='main' is for repositories"):
        parse_source("https://example.org/set", "main")
    (tmp_path / "train.h5").touch()
    with pytest.raises(ConfigError, match=r"train\.h5: a file, not a folder of shards.*Hdf5Garments"):
        parse_source(tmp_path / "train.h5")
    with pytest.raises(ShardError, match="cannot be read"):
        parse_source("x" * 5000)


def bring(hub: Hub, tmp_path: Path, source: Repo | Url = REPO, **options: Any) -> Path:
    download(source, tmp_path / "data", remote(hub, tmp_path), **options)
    return tmp_path / "data"


def put_up(hub: Hub, folder: Path) -> Url:
    hub.static = {f"garments/{name}": data for name, data in read_folder(folder).items()}
    return url_of(hub)


def without_record(folder: Path) -> dict[str, bytes]:
    return {name: data for name, data in read_folder(folder).items() if name != DOWNLOAD_FILE}


@pytest.mark.parametrize("from_url", [False, True])
def test_a_download_equals_the_published_folder(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, from_url: bool
) -> None:
    reports: list[tuple[int, int]] = []
    source = url_of(hub) if from_url else REPO
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
        return open_store(source, remote(hub, tmp_path, **options), root=tmp_path / "data", splits=["train"])

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
    with pytest.raises(ShardError, match=r"the download of hf://.* is incomplete: run gcd download again"):
        open_store(data).manifest()
    hub.faults.clear()
    hub.log.clear()
    assert without_record(bring(hub, tmp_path)) == read_folder(folder)
    assert not hub.asked(r"storage/[^/]+/train-0000[01]")
    (rest,) = hub.asked(r"storage/[^/]+/train-00002")
    assert int(rest.span.removeprefix("bytes=").partition("-")[0]) >= 10_000
    assert not list((tmp_path / "data").rglob(".*"))


def test_damaged_cut_and_missing_tars_are_downloaded_again(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    data = bring(hub, tmp_path)
    flip(data / "train-00002.tar", 0)
    (data / "train-00001.tar").unlink()
    (data / "views" / "train-00000.tar").write_bytes(b"cut")
    hub.log.clear()
    assert without_record(bring(hub, tmp_path)) == read_folder(folder)
    assert len(hub.asked(r"storage/.*tar")) == 3


def test_a_disk_without_room_is_reported_before_anything_is_sent(
    hub: Hub, commit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(9, 8, 1))
    with pytest.raises(OutputError, match=r"data: \d+ bytes are needed, and 1 are free: make room"):
        bring(hub, tmp_path)
    assert not hub.asked(r"\.tar")


def test_a_data_set_that_grew_or_shrank_is_updated(hub: Hub, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    source = put_up(hub, write_set(theirs, {"train": 10}))
    bring(hub, tmp_path, source)
    put_up(hub, write_set(theirs, {"train": 14}))
    hub.log.clear()
    assert without_record(bring(hub, tmp_path, source)) == read_folder(theirs)
    assert not hub.asked(r"train-0000[01]\.tar")  # full shards that are here already
    put_up(hub, write_set(theirs, {"train": 4}))
    assert without_record(bring(hub, tmp_path, source)) == read_folder(theirs)


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
