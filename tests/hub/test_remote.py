"""Garments read from a server: which bytes are requested, and which are cached."""

import gzip
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import webdataset as wds
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, MissingError, RefusedError, RemoteError, ShardError
from gcd_dataset.hub import remote
from gcd_dataset.loaders import GarmentDataset, collate_packed
from gcd_dataset.shards import read_index
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import MEMBERS
from tests.hub.conftest import COUNT
from tests.hub.server import Fault, Hub
from tests.loaders.test_shards import assert_all_same, same

SHARDS = r"\.tar"


def opened(hub: Hub, tmp_path: Path, **options: Any) -> GarmentDataset:
    return GarmentDataset("org/garments", endpoint=hub.endpoint, cache_dir=tmp_path / "cache", **options)


def wanted_bytes(folder: Path, samples: list[int], fields: list[str]) -> int:
    index = read_index(folder)
    return int(index.table.size[samples][:, [MEMBERS.index(f"{field}.npy") for field in fields]].sum())


def test_a_repository_yields_the_items_of_its_folder(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    ds = opened(hub, tmp_path)
    assert len(ds) == COUNT
    assert_all_same(ds, GarmentDataset(folder))
    assert ds.revision == commit
    assert ds.recipe(3) == {**GarmentDataset(folder).recipe(3), "source": f"hf://datasets/org/garments@{commit}"}


@pytest.mark.parametrize("source", ["{}/files/garments", "{}/files/garments/"])
def test_a_url_yields_the_items_of_its_folder(hub: Hub, commit: str, folder: Path, tmp_path: Path, source: str) -> None:
    ds = GarmentDataset(source.format(hub.endpoint), cache_dir=tmp_path)
    assert_all_same(ds, GarmentDataset(folder))
    ds.verify(4)
    assert GarmentDataset(folder.as_uri()).recipe(0) == GarmentDataset(folder).recipe(0)


def test_only_requested_fields_are_transferred(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "GAP", 0)
    ds = opened(hub, tmp_path, fields=["verts", "faces"])
    assert not hub.asked("storage.*tar")
    item = ds[5]
    assert set(item) == {"verts", "faces"}
    asked = [request for request in hub.asked(SHARDS) if request.status == 206]
    assert (len(asked), sum(request.size for request in asked)) == (2, wanted_bytes(folder, [5], ["verts", "faces"]))


def test_neighbouring_members_take_one_request(hub: Hub, commit: str, tmp_path: Path) -> None:
    ds = opened(hub, tmp_path, fields=["panels", "edges", "stitches", "body"])
    for index in (0, 1, 2):
        ds[index]
    answered = [request for request in hub.asked(SHARDS) if request.status == 206]
    assert len(answered) == 3
    # The first request of a shard is redirected; later requests go to the remembered target.
    assert len(hub.asked(r"resolve/.*tar")) == 1


def test_a_batch_takes_one_request_per_shard(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    ds = opened(hub, tmp_path, fields=["verts"])
    (batch,) = DataLoader(ds[:], batch_size=COUNT, collate_fn=collate_packed)
    answered = [request for request in hub.asked(SHARDS) if request.status == 206]
    # The gaps between these small members are below ``GAP``: one request per shard.
    assert len(answered) == 3
    (expected,) = DataLoader(GarmentDataset(folder, fields=["verts"]), batch_size=COUNT, collate_fn=collate_packed)
    assert same(batch, expected)


def test_items_do_not_share_memory(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    def doubled(item: Any) -> Any:
        item["verts"] *= 2
        return item

    expected = GarmentDataset(folder, fields=["verts"])[1]["verts"] * 2
    remote_one = opened(hub, tmp_path, fields=["verts"], transform=doubled)
    here = GarmentDataset(folder, fields=["verts"], transform=doubled)
    for ds in (remote_one, remote_one, here):  # from the server, from the cache, from the folder
        assert all(torch.equal(item["verts"], expected) for item in ds.__getitems__([1, 1, 1]))


def test_a_data_set_may_be_sent_to_another_process(hub: Hub, commit: str, tmp_path: Path) -> None:
    ds = opened(hub, tmp_path, fields=["verts"])
    first = ds[0]
    copy = pickle.loads(pickle.dumps(ds))
    assert same(copy[0], first)
    assert same(copy[7], ds[7])


def test_nothing_is_requested_twice(hub: Hub, commit: str, tmp_path: Path) -> None:
    items = list(opened(hub, tmp_path, revision=commit))
    hub.log.clear()
    again = opened(hub, tmp_path, revision=commit)
    assert_all_same(again, items)
    assert not hub.log


def test_a_branch_is_looked_up_once(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    ds = opened(hub, tmp_path, fields=["meta"])
    hub.publish("org/garments", {"README.md": b"all else is gone"})
    assert ds[9]["meta"]["index"] == 9
    hub.log.clear()
    assert_all_same(opened(hub, tmp_path, fields=["meta"], revision=commit), GarmentDataset(folder, fields=["meta"]))
    assert not hub.asked("/api/")
    with pytest.raises(ShardError, match=r"no tars of split train|no samples of split train"):
        opened(hub, tmp_path)


def test_cached_members_are_read_without_a_server(hub: Hub, commit: str, tmp_path: Path) -> None:
    items = [opened(hub, tmp_path, fields=["verts"])[i] for i in range(4)]
    hub.stop()
    for options in ({}, {"download": False}, {"revision": commit}):
        ds = opened(hub, tmp_path, fields=["verts"], **options)
        assert_all_same([ds[i] for i in range(4)], items)
    with pytest.raises(RemoteError, match=r"gcd_000000007, member verts\.npy is not in the cache, and download=False"):
        opened(hub, tmp_path, fields=["verts"], download=False)[7]
    with pytest.raises(RemoteError, match=r"no connection"):
        opened(hub, tmp_path, fields=["verts"])[7]
    with pytest.raises(RemoteError, match="never read before"):
        GarmentDataset("org/other", endpoint=hub.endpoint, cache_dir=tmp_path, download=False)


def test_a_cached_url_is_read_without_a_server(hub: Hub, commit: str, tmp_path: Path) -> None:
    url = f"{hub.endpoint}/files/garments"
    items = list(GarmentDataset(url, cache_dir=tmp_path, fields=["points"]))
    hub.stop()
    assert_all_same(GarmentDataset(url, cache_dir=tmp_path, fields=["points"]), items)


def test_a_private_repository_asks_for_a_token(hub: Hub, folder: Path, tmp_path: Path) -> None:
    hub.publish("org/garments", folder, private=True)
    with pytest.raises(RefusedError, match=r"refused .* run hf auth login or set HF_TOKEN"):
        opened(hub, tmp_path)
    assert opened(hub, tmp_path, token=hub.token, fields=["meta"])[1]["meta"]["index"] == 1
    assert hub.asked("storage")
    assert all(not request.authorization for request in hub.asked("storage"))  # the storage host gets no token


def test_a_missing_data_set_is_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match=r"no local folder org/nothing"):
        GarmentDataset("org/nothing", endpoint=hub.endpoint, cache_dir=tmp_path)
    with pytest.raises(MissingError, match="not found"):
        opened(hub, tmp_path, revision="v9")
    with pytest.raises(ShardError, match="no samples of split test: choose from train"):
        opened(hub, tmp_path, split="test")
    with pytest.raises(ConfigError, match="revision='main' is for repositories"):
        GarmentDataset(f"{hub.endpoint}/files/garments", revision="main")
    with pytest.raises(ConfigError, match="max_cache_size='lots'"):
        opened(hub, tmp_path, max_cache_size="lots")


def test_the_path_of_a_file_is_not_taken_for_a_repository(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "train.h5").touch()
    for source in ("data/train.h5", Path("data/train.h5")):
        with pytest.raises(ConfigError, match=r"data/train\.h5: a file, not a folder of shards.*Hdf5Garments"):
            GarmentDataset(source)
    assert not hub.asked()


def test_a_url_is_readable_once_its_files_are_complete(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    url, index = f"{hub.endpoint}/files/garments", hub.static.pop("garments/index-train.npz")
    for unfinished in (None, b"<html>soon</html>", other_index(folder)):
        hub.static |= {} if unfinished is None else {"garments/index-train.npz": unfinished}
        with pytest.raises(ShardError, match=r"index-train\.npz"):
            GarmentDataset(url, cache_dir=tmp_path)
    hub.static["garments/index-train.npz"] = index
    assert_all_same(GarmentDataset(url, cache_dir=tmp_path), GarmentDataset(folder))


def other_index(folder: Path) -> bytes:
    """The index without the last shard."""
    index = read_index(folder)
    table = dict(list(index.tables().items())[:-1])
    return ShardIndex.of(folder, table).to_bytes()


@pytest.mark.parametrize("fields", [None, ["verts"]])
def test_a_stream_of_a_repository(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, fields: list[str] | None
) -> None:
    stream = opened(hub, tmp_path, streaming=True, fields=fields)
    assert_all_same(stream, GarmentDataset(folder, fields=fields))
    assert len([request for request in hub.asked(SHARDS) if request.status in (200, 206)]) == 3


@pytest.mark.parametrize("workers", [0, 2])
def test_workers_share_a_server(hub: Hub, commit: str, folder: Path, tmp_path: Path, workers: int) -> None:
    ds = opened(hub, tmp_path, fields=["faces", "verts"])
    ds[0]  # a connection is open when the workers are forked
    batches = DataLoader(ds, batch_size=3, collate_fn=collate_packed, num_workers=workers)
    alone = DataLoader(GarmentDataset(folder, fields=["faces", "verts"]), batch_size=3, collate_fn=collate_packed)
    assert_all_same(batches, alone)


# ------------------------------------------------------------------------------------------------------------- faults


def test_a_busy_server_gets_the_wait_it_requests(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []
    monkeypatch.setattr("gcd_dataset.hub.retry.time.sleep", waits.append)
    hub.faults = [
        Fault("/api/", status=429, headers={"Retry-After": "7"}),
        Fault("storage", status=503, times=2),
        Fault("manifest", status=429, headers={"Retry-After": "Thu, 01 Jan 1970 00:00:00 GMT"}),
    ]
    assert_all_same(opened(hub, tmp_path, fields=["points"]), GarmentDataset(folder, fields=["points"]))
    assert sorted(waits) == [0.0, 0.001, 0.001, 7.0]


def test_a_server_that_requests_too_long_a_wait_is_given_up(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.faults = [Fault("/api/", status=429, headers={"Retry-After": "86400"})]
    with pytest.raises(RemoteError, match="the server is busy"):
        opened(hub, tmp_path)


@pytest.mark.parametrize("streaming", [False, True])
def test_a_broken_connection_is_resumed(hub: Hub, commit: str, folder: Path, tmp_path: Path, streaming: bool) -> None:
    ds = opened(hub, tmp_path, streaming=streaming)
    hub.faults = [Fault(r"storage/.*tar", cut=5000), Fault(r"storage/.*tar", cut=600, times=3)]
    assert_all_same(ds, GarmentDataset(folder))
    assert [request.size for request in hub.asked(r"storage/.*tar")][:4] == [5000, 600, 600, 600]
    sent = sum(request.size for request in hub.asked(r"storage/.*tar"))
    stored = sum(path.stat().st_size for path in folder.glob("*.tar"))
    assert sent == stored if streaming else sent < stored  # no byte is sent twice


def test_an_outage_is_waited_out(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ds = opened(hub, tmp_path, fields=["verts"])
    ds[0]
    hub.stop()
    waits: list[float] = []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 4:
            hub.start()

    monkeypatch.setattr("gcd_dataset.hub.retry.time.sleep", sleep)
    assert_all_same([ds[9]], [GarmentDataset(folder, fields=["verts"])[9]])
    assert len(waits) == 4


def test_an_expired_redirect_is_looked_up_again(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    ds = opened(hub, tmp_path, fields=["verts"])
    ds[0]
    hub.faults = [Fault("storage", status=403)]
    assert same(ds[1], GarmentDataset(folder, fields=["verts"])[1])
    assert len(hub.asked(r"resolve/.*tar")) == 2


@pytest.mark.parametrize("name", ["manifest.json", "index-train.npz"])
def test_a_damaged_small_file_is_requested_again(
    hub: Hub, commit: str, folder: Path, tmp_path: Path, name: str
) -> None:
    hub.faults = [Fault(rf"(storage|resolve)/.*{name}", flip=300, times=2)]
    if name == "manifest.json":
        hub.faults[0].times = 1
    assert len(opened(hub, tmp_path)) == COUNT
    hub.faults = [Fault(rf"(storage|resolve)/.*{name}", flip=300, times=99)]
    with pytest.raises(RemoteError, match=rf"{name}: received bytes do not match"):
        opened(hub, tmp_path / "elsewhere")


@pytest.mark.parametrize("verify", ["lazy", "off"])
def test_wrong_bytes_are_never_cached(hub: Hub, commit: str, folder: Path, tmp_path: Path, verify: Any) -> None:
    expected = GarmentDataset(folder, fields=["verts"])
    ds = opened(hub, tmp_path, fields=["verts"], verify=verify)
    hub.faults = [Fault(r"storage/.*tar", flip_share=0.5)]
    assert same(ds[6], expected[6])  # requested again after the single fault
    hub.faults = [Fault(r"storage/.*tar", flip_share=0.5, times=2)]
    with pytest.raises(
        RemoteError, match=r"train-00001\.tar: sample gcd_000000007, member verts\.npy: received bytes do not match"
    ):
        ds[7]
    hub.stop()
    offline = opened(hub, tmp_path, fields=["verts"], download=False)
    assert same(offline[6], expected[6])
    with pytest.raises(RemoteError, match="not in the cache"):
        offline[7]


def test_a_truncated_shard_is_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    content = hub.static["garments/train-00001.tar"]
    hub.static["garments/train-00001.tar"] = content[: len(content) // 2]
    ds = GarmentDataset(f"{hub.endpoint}/files/garments", cache_dir=tmp_path, fields=["back"])
    with pytest.raises(RemoteError, match=r"train-00001\.tar: shorter than in its index"):
        ds[7]
    stream = GarmentDataset(f"{hub.endpoint}/files/garments", cache_dir=tmp_path, fields=["back"], streaming=True)
    with pytest.raises(ShardError, match=r"train-00001\.tar"):
        list(stream)


def test_an_unfinished_run_is_known_by_its_mark(
    hub: Hub, commit: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    url, name = f"{hub.endpoint}/files/garments", "garments/.unfinished-train.json"
    for mark in (b"", b"<html>no such page</html>", b'{"count": 400, "splits": ["train"]}'):
        hub.static[name] = mark
        GarmentDataset(url, cache_dir=tmp_path / str(len(mark)), fields=["meta"])
    (message,) = caplog.messages
    assert f"split train is unfinished: {COUNT} of 400 samples" in message
    assert message.endswith("ask its publisher to finish it; partial=True opens it without this warning")
    GarmentDataset(url, cache_dir=tmp_path / "x", fields=["meta"], partial=True)
    hub.stop()
    GarmentDataset(url, cache_dir=tmp_path / "0", fields=["meta"], download=False)  # known from the cache
    assert caplog.messages == [message]


def test_a_server_without_ranges_is_refused(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    hub.faults = [Fault(SHARDS, whole=True, times=999)]
    url = f"{hub.endpoint}/files/garments"
    ds = GarmentDataset(url, cache_dir=tmp_path / "cache", fields=["verts"])
    with pytest.raises(RemoteError, match=rf"{url}/train-00001\.tar: this server sends whole files only.*gcd download"):
        ds[7]
    assert len(hub.asked(SHARDS)) == 1
    stream = GarmentDataset(url, cache_dir=tmp_path / "cache", fields=["verts"], streaming=True)
    assert_all_same(stream, GarmentDataset(folder, fields=["verts"]))
    assert_all_same(GarmentDataset(url, root=tmp_path / "data", cache_dir=tmp_path / "cache"), GarmentDataset(folder))


def test_compressed_responses_are_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.faults = [Fault(r"manifest\.json", headers={"Content-Encoding": "gzip"}, times=9)]
    hub.static["garments/manifest.json"] = gzip.compress(hub.static["garments/manifest.json"])
    with pytest.raises(RemoteError, match=r"manifest\.json: sent compressed \(gzip\), without a request"):
        GarmentDataset(f"{hub.endpoint}/files/garments", cache_dir=tmp_path)


def test_an_invalid_manifest_is_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.static["garments/manifest.json"] = b"<html>"
    with pytest.raises(ShardError, match=r"manifest\.json: not a manifest .*: try again later, or tell its publisher"):
        GarmentDataset(f"{hub.endpoint}/files/garments", cache_dir=tmp_path)


@pytest.mark.parametrize("content", [b"", b"not found", b"PK"], ids=["empty", "a page", "cut off"])
def test_an_error_about_a_broken_index_addresses_its_publisher(
    hub: Hub, commit: str, tmp_path: Path, content: bytes
) -> None:
    hub.static["garments/index-train.npz"] = content
    with pytest.raises(
        ShardError, match=r"index-train\.npz: not an index \([^()]*\): ask its publisher to run gcd index"
    ):
        GarmentDataset(f"{hub.endpoint}/files/garments", cache_dir=tmp_path)


def test_an_index_of_other_shards_is_reported(hub: Hub, commit: str, tmp_path: Path) -> None:
    manifest = hub.static["garments/manifest.json"].decode()
    size = len(hub.static["garments/train-00001.tar"])
    hub.static["garments/manifest.json"] = manifest.replace(f'"size": {size}', '"size": 4711').encode()
    with pytest.raises(RemoteError, match=r"index-train\.npz and manifest\.json differ in train-00001\.tar"):
        GarmentDataset(f"{hub.endpoint}/files/garments", cache_dir=tmp_path)


def test_damaged_cache_members_are_fetched_again(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    expected = opened(hub, tmp_path, fields=["verts"])[2]
    (cached,) = (tmp_path / "cache" / "shards").glob("*.tar")
    index = read_index(folder)
    place = int(index.table.offset[2, MEMBERS.index("verts.npy")]) + 300
    content = bytearray(cached.read_bytes())
    content[place] ^= 8
    cached.write_bytes(content)
    assert same(opened(hub, tmp_path, fields=["verts"])[2], expected)
    hub.stop()
    assert same(opened(hub, tmp_path, fields=["verts"], download=False)[2], expected)


# -------------------------------------------------------------------------------------------------------- foreign tars


@pytest.fixture
def captions(hub: Hub, tmp_path: Path) -> str:
    """Publish two tars by ``webdataset`` in a folder of a repository; the commit's hash."""
    files = {}
    for shard in (0, 1):
        with wds.TarWriter(str(tmp_path / "a.tar")) as writer:
            for i in range(3):
                number = shard * 3 + i
                writer.write({"__key__": f"k{number}", "npy": np.arange(200 + number), "txt": f"{number}"})
        files[f"data/train-{shard:06d}.tar"] = (tmp_path / "a.tar").read_bytes()
    return hub.publish("org/foreign", files)


def test_foreign_tars_of_a_repository(hub: Hub, captions: str, tmp_path: Path) -> None:
    options: dict[str, Any] = {"endpoint": hub.endpoint, "cache_dir": tmp_path / "cache"}
    ds: Any = GarmentDataset("org/foreign", **options)
    stream: Any = GarmentDataset("org/foreign", streaming=True, **options)
    assert [item["txt"] for item in ds] == [item["txt"] for item in stream] == [str(i) for i in range(6)]
    assert len(ds[5]["npy"]) == 205
    hub.stop()
    again: Any = GarmentDataset("org/foreign", revision=captions, fields=["npy"], **options)
    assert [len(item["npy"]) for item in again] == [200 + i for i in range(6)]


def test_foreign_tars_with_paths_outside_are_refused(hub: Hub, captions: str, tmp_path: Path) -> None:
    files = hub.repos["org/foreign"].commits[-1][1]
    evil = files["data/train-000000.tar"].replace(b"k0.txt\0\0\0\0\0", b"../k0.txt\0\0")
    hub.publish("org/foreign", {"data/train-000000.tar": _signed_anew(evil)})
    with pytest.raises(ShardError, match=r"data/train-000000\.tar: member \.\./k0\.txt points outside"):
        GarmentDataset("org/foreign", endpoint=hub.endpoint, cache_dir=tmp_path / "cache")


def _signed_anew(archive: bytes) -> bytes:
    """The archive with a valid checksum in the header of ``../k0.txt``."""
    place = archive.index(b"../k0.txt")
    header = archive[place : place + 512]
    total = sum(header[:148] + 8 * b" " + header[156:])
    return archive[: place + 148] + b"%06o\0 " % total + archive[place + 156 :]
