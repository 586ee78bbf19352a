"""Downloads: whole, of some fields, and after interruptions."""

import errno
import hashlib
import multiprocessing
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, OutputError, RemoteError, ShardError
from gcd_dataset.hub.checked_shards import CheckedShards
from gcd_dataset.hub.download import download, remote_splits
from gcd_dataset.hub.site import Remote
from gcd_dataset.hub.source import Repo, Url
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, read_index, rebuild_index
from gcd_dataset.shards.download_file import DownloadRecord, read_download_record
from gcd_dataset.shards.index import scan_shard
from gcd_dataset.shards.layout import GARMENTS, MEMBERS
from gcd_dataset.shards.manifest import RecipeRecord, keep_recipe, read_manifest
from tests.hub.conftest import COUNT
from tests.hub.server import Fault, Hub, read_folder
from tests.loaders.test_shards import assert_all_same
from tests.shards.folders import fill, open_writer

REPO = Repo("org/garments")


def bring(hub: Hub, tmp_path: Path, place: Repo | Url = REPO, **options: Any) -> Path:
    download(place, tmp_path / "data", Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache"), **options)
    return tmp_path / "data"


@pytest.mark.parametrize("from_url", [False, True])
def test_a_download_equals_the_published_folder(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, from_url: bool
) -> None:
    reports: list[tuple[int, int]] = []
    place = Url(f"{hub.endpoint}/files/garments") if from_url else REPO
    data = bring(hub, tmp_path, place, on_progress=lambda come, total: reports.append((come, total)))
    there, published = read_folder(data), read_folder(folder)
    assert there.keys() == published.keys() | {"download.json"}
    assert all(there[name] == published[name] for name in published if not name.endswith(".npz"))
    assert reports[-1] == (total := sum(len(data) for name, data in published.items() if name.endswith(".tar")), total)
    assert len(ShardReader(data, verify="full")) == COUNT
    hub.log.clear()
    bring(hub, tmp_path, place)
    assert not hub.log


def test_the_published_recipe_is_downloaded(hub: Hub, tmp_path: Path) -> None:
    named, record = fill(tmp_path / "named", range(3)), RecipeRecord("tiny", "ab" * 32, "cd" * 32)
    keep_recipe(named, record)
    hub.publish("org/named", named)
    manifest = read_manifest(bring(hub, tmp_path, Repo("org/named")))
    assert manifest is not None
    assert manifest.recipe == record


def test_downloaded_fields_form_a_complete_data_set(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    fields = ["panels", "edges", "stitches", "points"]
    data = bring(hub, tmp_path, fields=fields)
    ds = GarmentDataset(data)
    assert ds.fields == ("meta", *fields)
    assert_all_same(GarmentDataset(data, fields=fields), GarmentDataset(folder, fields=fields))
    assert_all_same(GarmentDataset(data, fields=fields, streaming=True), GarmentDataset(folder, fields=fields))
    assert ds.recipe(2) == {**GarmentDataset(folder).recipe(2), "source": f"hf://datasets/org/garments@{commit}"}
    ds.verify(0)
    assert sum(path.stat().st_size for path in data.glob("*.tar")) < 0.6 * sum(
        path.stat().st_size for path in folder.glob("*.tar")
    )
    with pytest.raises(ConfigError, match="no field verts: there are meta, panels"):
        GarmentDataset(data, fields=["verts"])
    (data / "index-train.npz").unlink()
    assert_all_same(GarmentDataset(data), ds)
    rebuild_index(data)
    assert_all_same(GarmentDataset(data), ds)


def test_root_downloads_first(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {"endpoint": hub.endpoint, "cache_dir": tmp_path / "cache", "fields": ["body"]}
    ds = GarmentDataset("org/garments", root=tmp_path / "data", **options)
    hub.stop()
    assert_all_same(ds, GarmentDataset(folder, fields=["body"]))
    for download_ in (True, False):
        again = GarmentDataset("org/garments", root=tmp_path / "data", download=download_, **options)
        assert_all_same(again, ds)
    for source, revision in (("org/others", None), ("org/garments", "0" * 40)):
        with pytest.raises(ConfigError, match=rf"holds hf://datasets/org/garments@{commit}, asked for .*{source}"):
            GarmentDataset(source, root=tmp_path / "data", download=False, revision=revision, **options)


def test_a_tag_is_downloaded_once(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub.repos["org/garments"].tags["v1"] = commit
    options: dict[str, Any] = {"endpoint": hub.endpoint, "cache_dir": tmp_path / "cache", "revision": "v1"}
    GarmentDataset("org/garments", root=tmp_path / "data", **options)
    monkeypatch.setattr(DownloadRecord, "write", lambda self, folder: pytest.fail("downloaded again"))
    for download_ in (True, False):
        ds = GarmentDataset("org/garments", root=tmp_path / "data", download=download_, **options)
        assert_all_same(ds, GarmentDataset(folder))


def test_an_interrupted_download_continues(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gcd_dataset.hub.retry.PATIENCE", 0.001)
    hub.faults = [Fault(r"storage/.*train-00000", cut=20000), Fault(r"storage/.*train-00000", drop=True, times=99)]
    with pytest.raises(RemoteError, match="received data are kept"):
        bring(hub, tmp_path)
    assert (tmp_path / "data" / "train-00000.tar.part").stat().st_size == 20000
    with pytest.raises(ShardError, match="the download of split train is incomplete: run gcd download again"):
        GarmentDataset(tmp_path / "data")
    hub.faults.clear()
    hub.log.clear()
    assert_all_same(GarmentDataset(bring(hub, tmp_path)), GarmentDataset(folder))
    (rest,) = [request for request in hub.asked(r"storage/.*train-00000") if request.status == 206]
    assert rest.span == "bytes=20000-" + str((folder / "train-00000.tar").stat().st_size - 1)


def test_a_download_continues_from_a_server_without_ranges(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    hub.faults = [
        Fault(r"train-00001\.tar", whole=True, cut=20000),
        Fault(r"\.tar", whole=True, times=99),
    ]
    assert_all_same(GarmentDataset(bring(hub, tmp_path)), GarmentDataset(folder))
    with pytest.raises(RemoteError, match=r"sends whole files only.*without --fields"):
        bring(hub, tmp_path / "part", fields=["verts"])


def test_an_interrupted_download_of_fields_continues(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gcd_dataset.hub.retry.PATIENCE", 0.001)
    monkeypatch.setattr("gcd_dataset.shards.copying.BATCH", 1)
    hub.faults = [
        Fault(r"storage/.*train-00001.*", times=1, cut=10**9),
        Fault(r"storage/.*train-00001", drop=True, times=9),
    ]
    with pytest.raises(RemoteError, match="no connection"):
        bring(hub, tmp_path, fields=["verts"])
    hub.faults.clear()
    assert_all_same(GarmentDataset(bring(hub, tmp_path, fields=["verts"]), fields=["verts"]),
                    GarmentDataset(folder, fields=["verts"]))  # fmt: skip
    # The requests of both runs: one for each sample, the dropped ones, the ends of shards.
    assert len(hub.asked(r"storage/.*tar")) <= COUNT + 9 + 3


@pytest.mark.parametrize(("first", "then"), [(["verts"], None), (None, ["verts"]), (["verts"], ["faces"])])
def test_an_interrupted_download_may_be_restarted_with_other_fields(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: Any, then: Any
) -> None:
    monkeypatch.setattr("gcd_dataset.hub.retry.PATIENCE", 0.001)
    monkeypatch.setattr("gcd_dataset.shards.copying.BATCH", 1)
    hub.faults = [Fault(r"storage/.*train-0000[12]", drop=True, times=99)]
    with pytest.raises(RemoteError, match="received data are kept"):
        bring(hub, tmp_path, fields=first)
    assert list((tmp_path / "data").glob("*.tar"))
    hub.faults.clear()
    data = bring(hub, tmp_path, fields=then)
    assert_all_same(GarmentDataset(data), GarmentDataset(folder, fields=_with_meta(then)))
    assert main(["verify", "--full", str(data)]) == 0


@pytest.mark.parametrize("fields", [None, ["verts"]])
def test_a_flipped_byte_is_discarded(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fields: Any
) -> None:
    monkeypatch.setattr("gcd_dataset.hub.remote.GAP", 0)  # else the flipped byte could lie between wanted members
    hub.faults = [Fault(r"storage/.*train-00001", flip_share=0.4)]
    assert_all_same(
        GarmentDataset(bring(hub, tmp_path, fields=fields)), GarmentDataset(folder, fields=_with_meta(fields))
    )
    hub.faults = [Fault(r"storage/.*train-00001", flip_share=0.4, times=99)]
    with pytest.raises(RemoteError, match=r"train-00001\.tar.*received bytes do not match the published"):
        bring(hub, tmp_path / "elsewhere", fields=fields)
    assert not (tmp_path / "elsewhere" / "data" / "train-00001.tar").exists()
    hub.faults.clear()
    assert len(GarmentDataset(bring(hub, tmp_path / "elsewhere", fields=fields))) == COUNT


def _with_meta(fields: list[str] | None) -> list[str] | None:
    return None if fields is None else ["meta", *fields]


def test_a_shard_truncated_on_the_server_is_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    name = "garments/train-00002.tar"
    hub.static[name] = hub.static[name][:3000]
    with pytest.raises(RemoteError, match=r"train-00002\.tar: shorter than in its index"):
        bring(hub, tmp_path, Url(f"{hub.endpoint}/files/garments"))
    with pytest.raises(ShardError, match="is incomplete"):
        GarmentDataset(tmp_path / "data")


def test_a_download_continues_after_a_full_disk(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(fd: int, data: Any, place: int) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OutputError, match=r"\.tar\.part: cannot be written \(No space left on device\)"):
        bring(hub, tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr("huggingface_hub.constants.HF_TOKEN_PATH", str(tmp_path / "no-token"))
    assert_all_same(GarmentDataset(bring(hub, tmp_path)), GarmentDataset(folder))


def refreshed(hub: Hub, tmp_path: Path, fields: Any = None) -> Path:
    """Download a URL at its current revision, as ``gcd download`` does."""
    remote = Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache")
    place, splits = remote_splits(Url(f"{hub.endpoint}/files/garments"), remote)
    for split in splits:
        download(place, tmp_path / "data", remote, split=split, fields=fields)
    return tmp_path / "data"


def put_up(hub: Hub, folder: Path) -> None:
    hub.static = {f"garments/{name}": data for name, data in read_folder(folder).items()}


@pytest.mark.parametrize("fields", [None, ["verts"]])
def test_a_grown_data_set_is_updated(hub: Hub, tmp_path: Path, fields: Any) -> None:
    theirs = fill(tmp_path / "theirs", range(COUNT))
    put_up(hub, theirs)
    refreshed(hub, tmp_path, fields)
    put_up(hub, fill(theirs, range(COUNT, COUNT + 5)))
    hub.log.clear()
    data = refreshed(hub, tmp_path, fields)
    assert_all_same(GarmentDataset(data), GarmentDataset(theirs, fields=_with_meta(fields)))
    assert not hub.asked(r"train-0000[01]\.tar")  # full shards that are here already
    hub.log.clear()
    refreshed(hub, tmp_path, fields)
    assert not hub.asked(r"\.tar")


def test_another_data_set_under_the_same_url_is_reported(hub: Hub, tmp_path: Path) -> None:
    put_up(hub, fill(tmp_path / "one", range(3)))
    before = read_folder(refreshed(hub, tmp_path))
    put_up(hub, fill(tmp_path / "two", range(3), seed=1))
    with pytest.raises(ConfigError, match="the URL now has another data set, with another seed, recipe or split"):
        refreshed(hub, tmp_path)
    assert read_folder(tmp_path / "data") == before


def test_a_shrunk_data_set_leaves_no_stale_shards(hub: Hub, tmp_path: Path) -> None:
    put_up(hub, fill(tmp_path / "more", range(COUNT)))
    refreshed(hub, tmp_path)
    put_up(hub, fill(tmp_path / "less", range(4)))
    assert_all_same(GarmentDataset(refreshed(hub, tmp_path)), GarmentDataset(tmp_path / "less"))


@pytest.mark.parametrize("fields", [None, ["verts"]])
def test_a_shard_of_the_right_length_is_still_hashed(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fields: Any
) -> None:
    monkeypatch.setattr("gcd_dataset.hub.retry.PATIENCE", 0.001)
    hub.faults = [Fault(r"storage/.*train-00002", drop=True, times=99)]
    with pytest.raises(RemoteError, match="received data are kept"):
        bring(hub, tmp_path, fields=fields)
    hub.faults.clear()
    path = tmp_path / "data" / "train-00000.tar"
    layout = GARMENTS.of(MEMBERS if fields is None else ["meta.json", "verts.npy"])
    content = bytearray(path.read_bytes())
    content[int(scan_shard(path, layout).offset[1, layout.members.index("verts.npy")]) + 300] ^= 1
    path.write_bytes(content)
    assert_all_same(
        GarmentDataset(bring(hub, tmp_path, fields=fields)), GarmentDataset(folder, fields=_with_meta(fields))
    )


def test_a_shard_is_hashed_once(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest = read_manifest(folder)
    assert manifest is not None
    shard = manifest.splits["train"].shards[0]
    path = Path(shutil.copy(folder / shard.name, tmp_path))
    assert CheckedShards(tmp_path, "train").holds(shard)

    def hashed(file: Any, name: str) -> Any:
        raise AssertionError("read again")

    monkeypatch.setattr(hashlib, "file_digest", hashed)
    assert CheckedShards(tmp_path, "train").holds(shard)
    assert not CheckedShards(tmp_path, "train").holds(replace(shard, size=shard.size + 1))
    path.touch()
    with pytest.raises(AssertionError, match="read again"):
        CheckedShards(tmp_path, "train").holds(shard)


def test_a_deleted_shard_is_downloaded_again(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    (bring(hub, tmp_path) / "train-00001.tar").unlink()
    with pytest.raises(ShardError, match=r"train-00001\.tar: 0 of the .*: delete it, and run gcd download again"):
        GarmentDataset(tmp_path / "data")
    hub.log.clear()
    assert_all_same(GarmentDataset(bring(hub, tmp_path)), GarmentDataset(folder))
    assert not hub.asked(r"storage/.*train-0000[02]")


def test_splits_downloaded_in_parallel_are_both_recorded(hub: Hub, tmp_path: Path) -> None:
    theirs = fill(tmp_path / "theirs", range(4))
    with open_writer(theirs, split="test") as writer:
        writer.write(fake_sample(0, 50))
    hub.publish("org/garments", theirs)
    bring(hub, tmp_path, on_progress=lambda come, total: bring(hub, tmp_path, split="test") and None)
    assert [len(GarmentDataset(tmp_path / "data", split)) for split in ("train", "test")] == [4, 1]
    note = read_download_record(tmp_path / "data")
    assert note is not None
    assert {name: split.whole for name, split in note.splits.items()} == {"train": True, "test": True}


def test_a_folder_with_another_data_set_is_refused(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    remote = Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "cache")
    before = read_folder(folder)
    with pytest.raises(ConfigError, match="holds a data set that was not downloaded"):
        download(REPO, folder, remote)
    assert read_folder(folder) == before
    foreign = shutil.copytree(folder, tmp_path / "shards", ignore=lambda _, names: set(names) - {"train-00000.tar"})
    with pytest.raises(ConfigError, match="holds a data set that was not downloaded"):
        download(REPO, foreign, remote)
    assert list(read_folder(foreign)) == ["train-00000.tar"]
    bring(hub, tmp_path, fields=["body"])
    with pytest.raises(ConfigError, match="holds the fields meta, body of split train, asked for meta, verts"):
        bring(hub, tmp_path, fields=["verts"])
    later = hub.publish("org/garments", {**read_folder(folder), "README.md": b"words"})
    with pytest.raises(ConfigError, match=rf"holds hf://datasets/org/garments@{commit}, asked for .*@{later}"):
        bring(hub, tmp_path, Repo("org/garments", later), fields=["body"])


@pytest.mark.parametrize("fields", [None, ["verts"]])
@pytest.mark.parametrize("name", ["../escaped.tar", "escaped"])
def test_a_shard_name_cannot_point_outside(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, fields: Any, name: str
) -> None:
    index = read_index(folder)
    evil = replace(index, shards=(name, *index.shards[1:]))
    text = hub.static["garments/manifest.json"].decode().replace("train-00000.tar", name)
    hub.static |= {"evil/manifest.json": text.encode(), "evil/index-train.npz": evil.to_bytes()}
    hub.static |= {f"evil/{shard}": hub.static[f"garments/{shard}"] for shard in index.shards}
    with pytest.raises(ShardError, match=r"cannot be a file's name|lists a shard"):
        bring(hub, tmp_path, Url(f"{hub.endpoint}/files/evil"), fields=fields)
    assert not list(tmp_path.rglob("*escaped*"))


def brought(endpoint: str, folder: Path) -> int:
    """Number of garments in a folder, downloaded first if needed."""
    cache = folder.with_name("cache")
    return len(GarmentDataset("org/garments", root=folder, endpoint=endpoint, cache_dir=cache, verify="full"))


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_processes_that_download_into_one_folder_wait_for_each_other(hub: Hub, commit: str, tmp_path: Path) -> None:
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.starmap(brought, 2 * [(hub.endpoint, tmp_path / "data")]) == [COUNT, COUNT]
    assert len([request for request in hub.asked(r"storage/.*tar") if request.status == 206]) == 3


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
@pytest.mark.parametrize("fields", [None, ["verts"]])
def test_a_killed_download_continues(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fields: Any
) -> None:
    monkeypatch.setattr("gcd_dataset.shards.copying.BATCH", 1)
    hub.faults = [Fault(r"storage/.*train-00002", cut=3000, hold=True, times=99)]
    child = multiprocessing.get_context("fork").Process(target=bring, args=(hub, tmp_path), kwargs={"fields": fields})
    child.start()
    last = tmp_path / "data" / "train-00002.tar.part"
    while not (last.exists() and (last.stat().st_size >= 3000 or fields) and len(list(last.parent.glob("*.tar"))) == 2):
        assert child.is_alive()
        time.sleep(0.01)
    child.kill()
    child.join()
    hub.faults.clear()
    hub.log.clear()
    assert_all_same(
        GarmentDataset(bring(hub, tmp_path, fields=fields)), GarmentDataset(folder, fields=_with_meta(fields))
    )
    assert not hub.asked(r"storage/.*train-0000[01]")
