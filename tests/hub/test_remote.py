"""Data sets on servers: what is requested, what is cached, what is refused."""

import json
import multiprocessing
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.errors import ConfigError, MissingError, RefusedError, RemoteError, ShardError
from gcd_dataset.hub.remote import MOST_SAMPLES, PARALLEL, Remote, RemoteStore, open_store
from gcd_dataset.hub.source import Repo, Url
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.manifest import MANIFEST, parse_manifest
from tests.hub.server import Fault, Hub
from tests.hub.sets import COUNT, ensure, read, write_set

REPO = Repo("org/garments")


def opened(hub: Hub, tmp_path: Path, source: Repo | Url = REPO, **options: Any) -> RemoteStore:
    return RemoteStore(source, Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache", **options))


def url_of(hub: Hub) -> Url:
    return Url(f"{hub.endpoint}/files/garments")


@pytest.fixture(scope="session")
def here(folder: Path) -> FolderStore:
    return FolderStore(folder)


# ------------------------------------------------------------------------------------------------------------- requests


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


def test_several_samples_are_requested_together(hub: Hub, commit: str, here: FolderStore, tmp_path: Path) -> None:
    store = opened(hub, tmp_path)
    index = store.index("train")
    spans = [(index.record.shards[index.shard[n]], int(index.start[n]), int(index.end[n]), False) for n in (8, 1, 1)]
    assert list(store.parts("train", spans)) == [read(here, number) for number in (8, 1, 1)]


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_store_may_be_pickled_and_forked(hub: Hub, commit: str, here: FolderStore, tmp_path: Path) -> None:
    store = opened(hub, tmp_path)
    read(store, 0)  # a connection is open when the process is forked
    with multiprocessing.get_context("fork").Pool(1) as pool:
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


# ------------------------------------------------------------------------------------------------------------ revisions


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


def test_the_hub_must_name_a_commit(hub: Hub, commit: str, tmp_path: Path) -> None:
    body = hub.static["garments/manifest.json"]
    hub.static["datasets/org/garments/resolve/main/manifest.json"] = body
    with pytest.raises(RemoteError, match=r"'' is not a commit of the Hub: check endpoint"):
        RemoteStore(REPO, Remote(endpoint=f"{hub.endpoint}/files", cache_dir=tmp_path))


def test_missing_data_sets_and_options_out_of_place_are_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="refused"):
        opened(hub, tmp_path, Repo("org/nothing"))
    with pytest.raises(MissingError, match=r"not found .* a data set becomes visible"):
        opened(hub, tmp_path, replace(REPO, revision="v9"))
    with pytest.raises(MissingError, match=r"not found .* becomes visible when its upload is complete"):
        opened(hub, tmp_path, Url(f"{hub.endpoint}/files/none"))
    with pytest.raises(ShardError, match="no samples of split test: choose from train"):
        opened(hub, tmp_path).index("test")
    options: list[tuple[str, Any]] = [("max_cache_size", "lots"), ("patience", -1), ("patience", float("nan"))]
    for option, value in options:
        with pytest.raises(ConfigError, match=f"{option}=.*: give"):
            opened(hub, tmp_path, **{option: value})
    with pytest.raises(ConfigError, match="endpoint and token are for the Hub, not for memory://x"):
        opened(hub, tmp_path, Url("memory://x"))
    with pytest.raises(ConfigError, match="patience is for URLs and the Hub"):
        open_store(tmp_path, Remote(patience=3.0))


def test_garments_without_pictures_have_no_tar_of_them(hub: Hub, tmp_path: Path) -> None:
    hub.publish("org/garments", write_set(tmp_path, views=False))
    store = opened(hub, tmp_path)
    with pytest.raises(ShardError, match=r"views/train-00000\.tar: these garments have no pictures"):
        store.path("train", store.manifest().splits["train"].shards[0], views=True)


# -------------------------------------------------------------------------------------------------------------- damaged


def test_a_stream_tells_the_error_of_the_server(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.faults = [Fault(r"garments/.*\.tar", status=403, times=99)]
    stream = GarmentDataset(url_of(hub).url, streaming=True, cache_dir=tmp_path / "cache")
    with pytest.raises(RefusedError, match=r"^http://[^ ]*/train-00000\.tar: refused \(403\)"):
        next(iter(stream))


@pytest.mark.parametrize("name", ["manifest.json", "train.index"])
def test_small_files_that_are_damaged_on_the_way_are_asked_for_again(
    hub: Hub, commit: str, here: FolderStore, tmp_path: Path, name: str
) -> None:
    hub.faults = [Fault(name, flip=70)]
    assert read(opened(hub, tmp_path), 2) == read(here, 2)
    hub.faults = [Fault(name, flip=70, times=2)]
    with pytest.raises(ShardError, match=rf"{name}: (not a manifest|received bytes do not match)"):
        read(opened(hub, tmp_path / "other"), 2)
    assert not list((tmp_path / "other").rglob(name))


@pytest.mark.parametrize("name", ["manifest.json", "train.index"])
def test_small_files_that_are_damaged_in_the_cache_are_fetched_again(
    hub: Hub, commit: str, here: FolderStore, tmp_path: Path, name: str
) -> None:
    read(opened(hub, tmp_path), 2)
    (cached,) = (tmp_path / "cache").rglob(name)
    whole = cached.read_bytes()
    pinned = replace(REPO, revision=commit)
    for damaged in (b"", whole[:-9], bytes([*whole[:50], whole[50] ^ 1, *whole[51:]])):
        cached.write_bytes(damaged)
        assert read(opened(hub, tmp_path, pinned), 2) == read(here, 2)
        assert cached.read_bytes() == whole


def test_a_truncated_tar_in_the_cache_is_not_read(hub: Hub, commit: str, here: FolderStore, tmp_path: Path) -> None:
    store = opened(hub, tmp_path)
    shard = store.index("train").record.shards[1]
    path = store.path("train", shard)
    path.write_bytes(path.read_bytes()[:1000])
    assert read(store, 7) == read(here, 7)


def test_a_shard_that_differs_from_its_hash_is_never_cached(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.faults = [Fault(r"storage/.*tar", flip=300, times=10**6)]
    store = opened(hub, tmp_path)
    with pytest.raises(RemoteError, match=r"train-0000\d\.tar: received bytes do not match the published hash"):
        ensure(store)
    assert not list(store.cache.rglob("tar"))


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
    evil = json.loads(hub.static["garments/manifest.json"])
    for name in ("../escaped", "a/b", ""):
        hub.static["evil/manifest.json"] = json.dumps({**evil, "splits": {name: evil["splits"]["train"]}}).encode()
        with pytest.raises(ShardError, match=r"manifest\.json: not a manifest"):
            opened(hub, tmp_path, Url(f"{hub.endpoint}/files/evil"))
    for body in (b"<html>", b"[" * 100_000, b'{"schema": 2, "generator": "0.9"}'):
        hub.static["evil/manifest.json"] = body
        with pytest.raises(ShardError, match=r"manifest\.json: (not a manifest|a data set of schema 2)"):
            opened(hub, tmp_path, Url(f"{hub.endpoint}/files/evil"))
    assert not list(tmp_path.rglob("*escaped*"))


# ------------------------------------------------------------------------------------------------------------- eviction


def test_the_shard_used_longest_ago_is_evicted_with_its_columns(
    hub: Hub, commit: str, here: FolderStore, tmp_path: Path
) -> None:
    store = opened(hub, tmp_path, max_cache_size=100_000)  # two of three shards, of 42 kB at most
    first, second, third = store.manifest().splits["train"].shards
    for shard in (first, second):
        (store.path("train", shard).parent / "verts").write_bytes(b"a column")
    store.path("train", first)  # used again
    store.path("train", third)
    assert {path.name for path in store.cache.iterdir()} == {first.sha256, third.sha256}
    shutil.rmtree(store.cache / first.sha256)
    assert read(store, 1) == read(here, 1)


def test_a_download_that_nobody_continues_is_evicted(hub: Hub, commit: str, tmp_path: Path) -> None:
    store = opened(hub, tmp_path, max_cache_size=100_000)
    store.cache.mkdir(parents=True)
    (store.cache / f".{'0' * 64}.tar.part").write_bytes(bytes(90_000))
    (store.cache / ".evicted-0").mkdir()
    store.path("train", store.manifest().splits["train"].shards[0])
    assert len(list(store.cache.iterdir())) == 1


# -------------------------------------------------------------------------------------------------------------- the end


def test_a_program_exits_without_warnings(hub: Hub, commit: str, tmp_path: Path) -> None:
    program = f"""
import json
from gcd_dataset.hub.remote import Remote, RemoteStore
from gcd_dataset.hub.source import Url
store = RemoteStore(Url({url_of(hub).url!r}), Remote(cache_dir={str(tmp_path)!r}))
shard = store.index("train").record.shards[0]
store.part("train", shard, 0, 1000)
json.kept = store  # freed after the modules that are imported later
"""
    command = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True)
    assert done.stderr == ""
