"""Limits on memory, redirects and waits that a server can cause."""

import json
import math
import socket
import subprocess
import sys
import threading
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from gcd_dataset.hub.web import Web

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, RemoteError
from gcd_dataset.hub import remote, site, web
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards.index import ShardIndex
from tests.hub.server import Fault, Hub

REPOSITORY = Path(__file__).resolve().parent.parent.parent


def opened(hub: Hub, tmp_path: Path, name: str = "garments", **options: Any) -> GarmentDataset:
    return GarmentDataset(f"{hub.endpoint}/files/{name}", cache_dir=tmp_path / "cache", **options)


# --------------------------------------------------------------------------------------------------------------- sizes


@pytest.mark.parametrize(
    ("path", "most"), [("manifest.json", site.LARGEST_MANIFEST), ("index-train.npz", site.LARGEST_INDEX)]
)
def test_a_file_declared_over_the_limit_is_not_read(
    hub: Hub, commit: str, tmp_path: Path, path: str, most: int
) -> None:
    hub.faults = [Fault(path, status=200, headers={"Content-Length": str(10**13)}, times=99)]
    with pytest.raises(
        RemoteError, match=rf"garments/{path}: has {10**13} bytes, over the limit of {most} .*publisher"
    ):
        opened(hub, tmp_path)
    assert len(hub.asked(path)) == 1


def test_a_file_list_declared_over_the_limit_is_not_read(hub: Hub, commit: str, tmp_path: Path) -> None:
    hub.faults = [Fault("/api/", status=200, headers={"Content-Length": str(10**13)}, times=99)]
    with pytest.raises(RemoteError, match=rf"api/.*: has {10**13} bytes, over the limit of {site.LARGEST_LISTING} "):
        GarmentDataset("org/garments", endpoint=hub.endpoint, cache_dir=tmp_path)


@pytest.mark.parametrize("answer", [b"[" * 100_000, b'{"sha": 3}', b"[]", b"null"])
def test_an_invalid_file_list_is_reported(hub: Hub, tmp_path: Path, answer: bytes) -> None:
    with (
        served(answer) as url,
        pytest.raises(RemoteError, match=r"is not a commit|the answer is not .* Hub.*: check"),
    ):
        GarmentDataset("org/garments", endpoint=url, cache_dir=tmp_path)


def test_an_endless_file_is_read_up_to_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    with served(None) as url:
        tracemalloc.start()
        with pytest.raises(
            RemoteError, match=r"manifest\.json: has more than 1000000 bytes, over the limit of 1000000 "
        ):
            Web(url).get("manifest.json", 1_000_000)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 10_000_000


def served(answer: bytes | None) -> "_Served":
    return _Served(answer)


class _Served:
    """A server that sends the same bytes for every request, without Content-Length; endless for ``None``."""

    def __init__(self, answer: bytes | None) -> None:
        self._answer, self._socket = answer, socket.create_server(("127.0.0.1", 0))

    def __enter__(self) -> str:
        threading.Thread(target=self._serve, daemon=True).start()
        return f"http://127.0.0.1:{self._socket.getsockname()[1]}"

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def _serve(self) -> None:
        while True:
            try:
                line, _ = self._socket.accept()
            except OSError:
                return
            with line:
                line.recv(1 << 16)
                try:
                    line.sendall(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + (self._answer or b""))
                    while self._answer is None:
                        line.sendall(bytes(1 << 16))
                except OSError:
                    pass


def test_a_member_declared_over_the_limit_is_not_requested(hub: Hub, commit: str, tmp_path: Path) -> None:
    url = f"{hub.endpoint}/files/evil"
    hub.static |= {f"evil/{name.partition('/')[2]}": data for name, data in hub.static.items()}
    index = ShardIndex.parse(hub.static["evil/index-train.npz"], "index")
    size = index.table.size.copy()
    size[0, -1] = remote.LARGEST_MEMBER + 1  # back.jpg
    offset = index.table.offset.copy()
    offset[0, -1] = 2**33
    length = index.length.copy()
    length[0] = 2**40
    table = replace(index.table, size=size, offset=offset)
    hub.static["evil/index-train.npz"] = replace(index, table=table, length=length).to_bytes()
    manifest = json.loads(hub.static["evil/manifest.json"])
    manifest["splits"]["train"]["shards"][0]["size"] = 2**40
    hub.static["evil/manifest.json"] = json.dumps(manifest).encode()
    told = (
        rf"{url}@.*/train-00000\.tar: sample gcd_000000000, member back\.jpg: has {remote.LARGEST_MEMBER + 1} bytes "
        rf"according to its index, over the limit of {remote.LARGEST_MEMBER} for servers"
    )
    with pytest.raises(RemoteError, match=told):
        opened(hub, tmp_path, "evil", fields=["back"])[0]
    assert opened(hub, tmp_path, "evil", fields=["body"])[5]["body"].shape  # samples with correct entries are read
    assert main(["download", url, "--out", str(tmp_path / "out"), "--fields", "back", "--quiet"]) == 1


def test_declared_sizes_allocate_nothing(hub: Hub, commit: str) -> None:
    hub.faults = [Fault("body.bin", drop=True, times=99)]
    tracemalloc.start()
    with pytest.raises(RemoteError):
        Web(f"{hub.endpoint}/files").read("body.bin", 0, 200_000_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000


# ----------------------------------------------------------------------------------------------------------- redirects


@pytest.mark.parametrize("to", ["file:///etc/passwd", "ftp://127.0.0.1/passwd", "gopher://127.0.0.1/"])
def test_a_redirect_to_another_protocol_is_refused_at_once(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str
) -> None:
    monkeypatch.setattr(time, "sleep", lambda seconds: pytest.fail("waited for"))
    hub.faults = [Fault("manifest", status=302, headers={"Location": to}, times=99)]
    with pytest.raises(
        RemoteError, match=rf"garments/manifest\.json: redirects to {to[:4]}.* redirects to http and https"
    ):
        opened(hub, tmp_path)
    assert len(hub.asked("manifest")) == 1


def test_circular_redirects_are_an_error(hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", lambda seconds: pytest.fail("waited for"))
    round_ = f"{hub.endpoint}/files/garments/manifest.json"
    hub.faults = [Fault("manifest", status=302, headers={"Location": round_}, times=99)]
    with pytest.raises(RemoteError, match=rf"up to {web.MOST_REDIRECTS} redirects"):
        opened(hub, tmp_path)
    assert len(hub.asked("manifest")) == web.MOST_REDIRECTS + 1


# ------------------------------------------------------------------------------------------------------------ patience


@pytest.fixture
def slept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds of each call of ``sleep``, which returns at once."""
    monkeypatch.setattr("gcd_dataset.hub.retry.FIRST_WAIT", 0.5)
    monkeypatch.setattr("gcd_dataset.hub.retry.LAST_WAIT", 60.0)
    monkeypatch.setattr("gcd_dataset.hub.retry.PATIENCE", 30.0)
    seconds: list[float] = []
    monkeypatch.setattr("gcd_dataset.hub.retry.time.sleep", seconds.append)
    return seconds


@pytest.mark.parametrize(("patience", "total"), [(None, 30.0), (0.0, 0.0), (7.0, 7.0), (600.0, 600.0)])
def test_patience_limits_the_total_wait(
    hub: Hub, commit: str, tmp_path: Path, slept: list[float], patience: Any, total: float
) -> None:
    ds = opened(hub, tmp_path, fields=["body"], patience=patience)
    hub.faults = [Fault(r"\.tar", drop=True, times=999)]
    with pytest.raises(RemoteError, match=rf"{total:.0f} s of waiting: try again later, or with more patience"):
        ds[0]
    assert sum(slept) == pytest.approx(total)
    assert max(slept, default=0.0) <= 60.0


def test_infinite_patience_waits_out_hours(hub: Hub, commit: str, tmp_path: Path, slept: list[float]) -> None:
    ds = opened(hub, tmp_path, fields=["body"], patience=math.inf)
    hub.faults = [Fault(r"\.tar", drop=True, times=200)]
    assert ds[0]["body"].shape
    assert sum(slept) > 10_000


@pytest.mark.parametrize("patience", [-1, math.nan])
def test_an_invalid_patience_is_refused(hub: Hub, tmp_path: Path, patience: float) -> None:
    with pytest.raises(ConfigError, match=r"patience=.*: give seconds, 0 or more"):
        opened(hub, tmp_path, patience=patience)
    assert main(["download", f"{hub.endpoint}/files/garments", f"--patience={patience}"]) == 2


def test_patience_with_a_folder_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"patience=3.* is for URLs and the Hub"):
        GarmentDataset(folder, patience=3.0)


# ------------------------------------------------------------------------------------------------------------- the end


def test_a_program_exits_without_warnings(hub: Hub, commit: str, tmp_path: Path) -> None:
    url = f"{hub.endpoint}/files/garments"
    program = f"""
import json
from gcd_dataset.hub.opening import open_store
from gcd_dataset.hub.site import Remote
from gcd_dataset.shards.reader import ShardReader
reader = ShardReader(open_store({url!r}, Remote(cache_dir={str(tmp_path)!r})), "train")
reader.read(0, ("body.npy",))
json.kept = reader  # freed after the modules that are imported later
"""
    for _ in range(2):  # the second reads the cache
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True)
        assert done.stderr == ""


@pytest.mark.parametrize("url", ["http://[bad/x", "http://host:99999999/x", "https:///x", "https://exa mple/x"])
def test_a_url_without_a_server_is_refused_at_once(url: str) -> None:
    with pytest.raises(ConfigError, match="not a server address"):
        GarmentDataset(url)
