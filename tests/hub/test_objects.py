"""Data sets in object stores."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import fsspec
import pytest

from gcd_dataset.errors import ConfigError, MissingError, RefusedError, RemoteError, ShardError
from gcd_dataset.hub import fetch
from gcd_dataset.hub.download import download
from gcd_dataset.hub.remote import Remote, RemoteStore
from gcd_dataset.hub.source import Folder, Url, parse_source
from gcd_dataset.shards.folder import DOWNLOAD_FILE, FolderStore
from tests.hub.server import Fault, Store, read_folder, running_store, s3_fault
from tests.hub.sets import ensure, read


@pytest.fixture(scope="module")
def running() -> Iterator[Store]:
    with running_store() as store:
        yield store


@pytest.fixture
def s3(running: Store) -> Store:
    running.log.clear()
    running.faults.clear()
    return running


def put(url: str, files: Mapping[str, bytes]) -> None:
    """Store objects below a URL."""
    store, path = fsspec.core.url_to_fs(url)
    for name, content in files.items():
        store.pipe_file(f"{path}/{name}", content)


@pytest.fixture
def published(s3: Store, folder: Path, request: pytest.FixtureRequest) -> str:
    """URL of a copy of the data set in the store."""
    url = f"s3://bucket/{request.node.name}/set"
    put(url, read_folder(folder))
    s3.log.clear()
    return url


def opened(url: str, tmp_path: Path, **options: float | bool) -> RemoteStore:
    return RemoteStore(Url(url), Remote(cache_dir=tmp_path / "cache", **options))  # type: ignore[arg-type]


def test_a_store_is_read_by_ranges_and_whole_shards(s3: Store, published: str, folder: Path, tmp_path: Path) -> None:
    store = opened(published, tmp_path)
    assert read(store, 7) == read(FolderStore(folder), 7)
    assert [request.method for request in s3.log] == ["GET", "GET", "GET"]
    ensure(store)
    ensure(store, views=True)
    assert len(s3.asked(r"\.tar")) == 1 + 6
    s3.faults.append(Fault(".", 999, drop=True))
    assert read(opened(published, tmp_path, allowed=False), 9, views=True) == read(FolderStore(folder), 9, views=True)
    s3.faults.clear()
    download(Url(published), tmp_path / "data", Remote(cache_dir=tmp_path / "cache"))
    there = read_folder(tmp_path / "data")
    assert {name: data for name, data in there.items() if name != DOWNLOAD_FILE} == read_folder(folder)


def test_any_store_of_fsspec_is_read(folder: Path, tmp_path: Path) -> None:
    put(f"memory://{tmp_path.name}", read_folder(folder))
    store = opened(f"memory://{tmp_path.name}", tmp_path)
    ensure(store)
    assert read(store, 3) == read(FolderStore(folder), 3)
    assert read(store, 3, views=True) == read(FolderStore(folder), 3, views=True)


def test_a_busy_store_is_retried(s3: Store, published: str, folder: Path, tmp_path: Path) -> None:
    s3.faults += [s3_fault(r"\.tar", "InternalError", 500, 2), Fault(r"\.tar", 2, drop=True)]
    assert read(opened(published, tmp_path, patience=20.0), 3) == read(FolderStore(folder), 3)


def test_changed_objects_are_refused(published: str, folder: Path, tmp_path: Path) -> None:
    content = (folder / "train-00000.tar").read_bytes()
    put(published, {"train-00000.tar": bytes([content[0] ^ 1]) + content[1:]})
    with pytest.raises(RemoteError, match=r"train-00000\.tar: received bytes do not match the published hash"):
        ensure(opened(published, tmp_path))
    put(published, {"train-00000.tar": content[:5000]})
    with pytest.raises(RemoteError, match=r"train-00000\.tar: (shorter|the store rejects the request)"):
        read(opened(published, tmp_path), 3)


def test_an_object_over_the_limit_is_refused(published: str) -> None:
    with pytest.raises(RemoteError, match=r"train-00000\.tar: has more than 100 bytes, over the limit of 100 "):
        fetch.Files(published).read("train-00000.tar", limit=100)


@pytest.mark.parametrize(
    ("fault", "error", "told"),
    [
        (s3_fault(".", "AccessDenied", 403), RefusedError, "ask for the rights to read and list there"),
        (s3_fault(".", "SlowDown", 503), RemoteError, "try again later, or with more patience"),
        (Fault(".", 999, drop=True), RemoteError, "try again later, or with more patience"),
    ],
)
def test_errors_of_a_failing_store_are_one_line(
    s3: Store, published: str, tmp_path: Path, fault: Fault, error: type[Exception], told: str
) -> None:
    s3.faults.append(fault)
    with pytest.raises(error, match=told) as caught:
        opened(published, tmp_path, patience=0.0)
    assert "\n" not in str(caught.value) and published in str(caught.value)


def test_missing_data_sets_and_credentials_are_reported(
    s3: Store, published: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for url in ("s3://bucket/none", "s3://no-bucket/set"):
        with pytest.raises(MissingError, match=f"{url}/manifest.json: not found"):
            opened(url, tmp_path)
    with pytest.raises(RemoteError, match="rejects the request"):
        opened("s3://No_Bucket!/set", tmp_path)
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.setattr(fetch, "_store", fetch._store.__wrapped__)
    with pytest.raises(RefusedError, match=r"no credentials .*: set AWS_ACCESS_KEY_ID and .* public bucket FSSPEC_S3="):
        opened(published, tmp_path)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(process: int, root: str) -> None:
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr(fetch, "_store", missing)
    with pytest.raises(ConfigError, match=r"S3 needs the package s3fs: pip install 'gcd-dataset\[s3\]'"):
        opened("s3://bucket/set", tmp_path)


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
