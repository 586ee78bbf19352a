"""Files of a server: continued, verified, fetched once, within bounds of time and memory."""

import fcntl
import hashlib
import multiprocessing
import socket
import threading
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import MissingError, OutputError, RefusedError, RemoteError
from gcd_dataset.hub import fetch as fetching
from gcd_dataset.hub.fetch import Files, fetch
from tests.hub.server import Fault, Hub

DATA = np.random.default_rng(0).bytes(200_000)
SHA256 = hashlib.sha256(DATA).hexdigest()


@pytest.fixture
def files(hub: Hub) -> Files:
    hub.static["a.tar"] = DATA
    return Files(f"{hub.endpoint}/files")


def brought(files: Files, folder: Path, sha256: str = SHA256) -> bytes:
    fetch(files, "a.tar", folder / "a.tar", len(DATA), sha256)
    return (folder / "a.tar").read_bytes()


@pytest.fixture
def short_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent server is given up after .3 s."""
    monkeypatch.setattr(fetching, "ANSWER", 0.3)
    fetching._web.cache_clear()
    monkeypatch.setattr(fetching, "_web", fetching._web.__wrapped__)


# ------------------------------------------------------------------------------------------------------------ continued


def test_no_byte_is_sent_twice_after_cuts(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=50_000), Fault("a.tar", cut=600, times=3), Fault("a.tar", drop=True)]
    assert brought(files, tmp_path) == DATA
    assert [request.size for request in hub.asked()] == [50_000, 600, 600, 600, 0, len(DATA) - 51_800]
    assert [path.name for path in tmp_path.iterdir()] == ["a.tar"]


def test_a_stopped_download_continues_where_it_ended(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=50_000), Fault("a.tar", drop=True, times=10**6)]
    with pytest.raises(RemoteError, match="received data are kept"):
        brought(files, tmp_path)
    hub.faults.clear()
    hub.log.clear()
    assert brought(files, tmp_path) == DATA
    assert [request.span for request in hub.asked()] == [f"bytes=50000-{len(DATA) - 1}"]


def test_a_server_without_ranges_is_read_from_the_start(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=50_000, whole=True), Fault("a.tar", whole=True, times=9)]
    assert brought(files, tmp_path) == DATA
    with pytest.raises(RemoteError, match=r"a\.tar: this server sends whole files only.*gcd download"):
        files.read("a.tar", 1000, 2000, limit=1000)
    assert files.read("a.tar", 0, 1000, limit=1000)[0] == DATA[:1000]


def test_the_proxy_of_the_environment_is_used(hub: Hub, files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", hub.endpoint)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    assert Files("http://data.invalid/files").read("a.tar", limit=len(DATA))[0] == DATA
    assert files.read("a.tar", limit=len(DATA))[0] == DATA
    assert [request.path for request in hub.asked()] == ["http://data.invalid/files/a.tar", "/files/a.tar"]


def test_an_outage_is_waited_out(hub: Hub, tmp_path: Path) -> None:
    hub.static["a.tar"] = DATA
    hub.stop()
    threading.Timer(0.3, hub.start).start()
    assert brought(Files(f"{hub.endpoint}/files", patience=30), tmp_path) == DATA


@pytest.mark.usefixtures("short_answers")
def test_a_silent_server_is_asked_again(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=70_000, hold=True)]
    assert brought(files, tmp_path) == DATA
    assert hub.asked()[-1].span.startswith("bytes=70000-")


def test_a_full_disk_loses_nothing(hub: Hub, files: Files, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hub.faults = [Fault("a.tar", cut=50_000), Fault("a.tar", drop=True, times=10**6)]
    with pytest.raises(RemoteError):
        brought(files, tmp_path)
    hub.faults.clear()
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(OutputError, match=r"\.a\.tar\.part: cannot be written \(File too large\)"):
            brought(files, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert (tmp_path / ".a.tar.part").stat().st_size == 100_000
    assert brought(files, tmp_path) == DATA


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_killed_download_continues(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=70_000, hold=True)]
    child = multiprocessing.get_context("fork").Process(target=brought, args=(files, tmp_path))
    child.start()
    part = tmp_path / ".a.tar.part"
    while not part.exists() or part.stat().st_size < 70_000:
        assert child.is_alive()
        time.sleep(0.01)
    child.kill()
    child.join()
    assert brought(files, tmp_path) == DATA
    assert hub.asked()[-1].span.startswith("bytes=70000-")


# ------------------------------------------------------------------------------------------------------------- verified


def test_wrong_bytes_are_refused_and_nothing_is_left(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", flip=1234)]
    assert brought(files, tmp_path) == DATA  # asked for again once
    hub.faults = [Fault("a.tar", flip=1234, times=2)]
    with pytest.raises(RemoteError, match=r"a\.tar: received bytes do not match the published hash; none are kept"):
        brought(files, tmp_path / "other")
    assert not list((tmp_path / "other").iterdir())


def test_a_part_of_another_file_is_replaced(hub: Hub, files: Files, tmp_path: Path) -> None:
    for stale in (b"x" * 1000, b"x" * (len(DATA) + 1)):
        (tmp_path / ".a.tar.part").write_bytes(stale)
        assert brought(files, tmp_path) == DATA
        (tmp_path / "a.tar").unlink()


# ----------------------------------------------------------------------------------------------------------------- once


def test_four_threads_share_a_download(hub: Hub, files: Files, tmp_path: Path) -> None:
    threads = [threading.Thread(target=brought, args=(files, tmp_path)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (tmp_path / "a.tar").read_bytes() == DATA
    assert len(hub.asked()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.tar"]


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_two_processes_share_a_download(hub: Hub, files: Files, tmp_path: Path) -> None:
    files.read("a.tar", limit=len(DATA))  # a connection is open when the processes are forked
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.starmap(brought, 2 * [(files, tmp_path)]) == 2 * [DATA]
    assert len(hub.asked()) == 2


# -------------------------------------------------------------------------------------------------------------- bounded


@pytest.mark.parametrize("after", ["86400", "0", "Thu, 01 Jan 1970 00:00:00 GMT"])
def test_patience_bounds_the_wait_that_a_server_asks_for(hub: Hub, after: str) -> None:
    hub.faults = [Fault("a.tar", status=429, headers={"Retry-After": after}, times=10**6)]
    begun = time.monotonic()
    with pytest.raises(RemoteError, match=r"the server is busy \(429\), .* try again later, or with more"):
        Files(f"{hub.endpoint}/files", patience=0.3).read("a.tar", limit=10)
    assert 0.3 <= time.monotonic() - begun < 5


@pytest.mark.usefixtures("short_answers")
@pytest.mark.parametrize("cut", [0, 1])
def test_a_server_that_stalls_is_given_up(hub: Hub, files: Files, cut: int) -> None:
    hub.faults = [Fault("a.tar", cut=cut, hold=True, times=10**6)]
    begun = time.monotonic()
    with pytest.raises(RemoteError, match="no answer"):
        files.read("a.tar", limit=len(DATA))
    assert time.monotonic() - begun < 5


def test_a_file_declared_over_the_limit_is_not_read(hub: Hub, files: Files) -> None:
    hub.faults = [Fault("a.tar", status=200, headers={"Content-Length": str(4 << 30)})]
    with pytest.raises(RemoteError, match=rf"a\.tar: has {4 << 30} bytes, over the limit of 1000 "):
        files.read("a.tar", limit=1000)
    assert len(hub.asked()) == 1


class Endless:
    """A server that sends zeros without an end, or a byte now and then."""

    def __init__(self, *, slow: bool = False) -> None:
        self._slow, self._socket = slow, socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=self._serve, daemon=True).start()
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}"

    def _serve(self) -> None:
        while True:
            line, _ = self._socket.accept()
            threading.Thread(target=self._send, args=(line,), daemon=True).start()

    def _send(self, line: socket.socket) -> None:
        with line:
            line.recv(1 << 16)
            try:
                line.sendall(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n")
                while True:
                    line.sendall(bytes(1 if self._slow else 1 << 16))
                    time.sleep(0.1 if self._slow else 0)
            except OSError:
                pass


def test_an_endless_file_is_read_up_to_the_limit() -> None:
    tracemalloc.start()
    with pytest.raises(RemoteError, match="has more than 1000000 bytes, over the limit of 1000000 "):
        Files(Endless().url).read("a", limit=1_000_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10_000_000


@pytest.mark.usefixtures("short_answers")
def test_a_file_that_comes_byte_by_byte_is_given_up() -> None:
    begun = time.monotonic()
    with pytest.raises(RemoteError, match=r"sent \d+ bytes in"):
        Files(Endless(slow=True).url).read("a", limit=1_000_000)
    assert time.monotonic() - begun < 5


@pytest.mark.parametrize("to", ["file:///etc/passwd", "ftp://127.0.0.1/passwd", "{}/files/a.tar"])
def test_redirects_to_other_protocols_and_in_circles_are_refused_at_once(hub: Hub, files: Files, to: str) -> None:
    hub.faults = [Fault("a.tar", status=302, headers={"Location": to.format(hub.endpoint)}, times=99)]
    with pytest.raises(RemoteError, match=r"cannot be read .*: check the address; up to 5 redirects to http and https"):
        files.read("a.tar", limit=1000)
    assert len(hub.asked()) <= fetching.MOST_REDIRECTS + 1


@pytest.mark.parametrize(
    ("fault", "error", "told"),
    [
        (Fault("", status=404), MissingError, r"not found \(404\)"),
        (Fault("", status=403), RefusedError, r"refused \(403\): ask for access, then run hf auth login"),
        (Fault("", status=418), RemoteError, "answered with status 418"),
        (Fault("", status=206, headers={"Content-Range": "bytes 5-9/10"}), RemoteError, "status 206 bytes 5-9/10"),
    ],
)
def test_answers_are_told_in_one_line(hub: Hub, files: Files, fault: Fault, error: type[Exception], told: str) -> None:
    hub.faults = [fault]
    with pytest.raises(error, match=told) as caught:
        files.read("a.tar", limit=1000)
    assert "\n" not in str(caught.value) and len(hub.asked()) == 1


def test_a_file_shorter_than_its_size_is_reported(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.static["a.tar"] = DATA[:1000]
    with pytest.raises(RemoteError, match=r"a\.tar: shorter than in its manifest"):
        brought(files, tmp_path)


def test_a_stop_ends_the_wait_for_another_process(files: Files, tmp_path: Path) -> None:
    with (tmp_path / ".a.tar.part").open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        threading.Timer(0.2, setattr, (files, "stopped", True)).start()
        with pytest.raises(RemoteError, match="stopped"):
            brought(files, tmp_path)


def test_a_stop_ends_a_wait(files: Files, hub: Hub) -> None:
    patient: Any = Files(files.url, patience=600)
    hub.faults = [Fault("a.tar", status=503, headers={"Retry-After": "600"}, times=99)]
    threading.Timer(0.2, setattr, (patient, "stopped", True)).start()
    with pytest.raises(RemoteError, match="stopped"):
        patient.read("a.tar", limit=1000)
