"""Files of a server: continued, verified, fetched once, within bounds of time and memory."""

import fcntl
import gzip
import hashlib
import multiprocessing
import resource
import socket
import threading
import time
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from gcd_dataset.errors import MissingError, OutputError, RefusedError, RemoteError
from gcd_dataset.hub import fetch as fetching
from gcd_dataset.hub.fetch import Files, fetch
from tests.hub.server import Fault, Hub

DATA = np.random.default_rng(0).bytes(200_000)


@pytest.fixture
def files(hub: Hub) -> Files:
    hub.static["a.tar"] = DATA
    return Files(f"{hub.endpoint}/files")


def brought(files: Files, folder: Path) -> bytes:
    fetch(files, "a.tar", folder / "a.tar", len(DATA), hashlib.sha256(DATA).hexdigest())
    return (folder / "a.tar").read_bytes()


@pytest.fixture
def short_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent server is given up after .3 s."""
    monkeypatch.setattr(fetching, "ANSWER", 0.3)
    fetching._web.cache_clear()
    monkeypatch.setattr(fetching, "_web", fetching._web.__wrapped__)


def test_no_byte_is_sent_twice_after_cuts(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=50_000), Fault("a.tar", cut=600, times=3), Fault("a.tar", drop=True)]
    assert brought(files, tmp_path) == DATA
    assert [request.size for request in hub.asked()] == [50_000, 600, 600, 600, 0, len(DATA) - 51_800]
    assert [path.name for path in tmp_path.iterdir()] == ["a.tar"]


def test_a_stopped_download_continues_where_it_ended_also_on_a_full_disk(
    hub: Hub, files: Files, tmp_path: Path
) -> None:
    hub.faults = [Fault("a.tar", cut=50_000), Fault("a.tar", drop=True, times=10**6)]
    with pytest.raises(RemoteError, match="received data are kept"):
        brought(files, tmp_path)
    hub.faults.clear()
    hub.log.clear()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(OutputError, match=r"\.a\.tar\.part: cannot be written \(File too large\)"):
            brought(files, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert (tmp_path / ".a.tar.part").stat().st_size == 100_000
    assert brought(files, tmp_path) == DATA
    assert [request.span for request in hub.asked()] == [f"bytes={k}-{len(DATA) - 1}" for k in (50_000, 100_000)]


@pytest.mark.usefixtures("short_answers")
def test_a_silent_server_is_asked_again_and_an_outage_waited_out(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=70_000, hold=True)]
    assert brought(files, tmp_path) == DATA
    assert hub.asked()[-1].span.startswith("bytes=70000-")
    hub.stop()
    threading.Timer(0.3, hub.start).start()
    assert brought(Files(files.url, patience=30), tmp_path / "again") == DATA


def test_servers_without_ranges_or_lengths_and_compressed_files(hub: Hub, files: Files, tmp_path: Path) -> None:
    hub.faults = [Fault("a.tar", cut=50_000, whole=True), Fault("a.tar", whole=True, times=9)]
    assert brought(files, tmp_path) == DATA
    with pytest.raises(RemoteError, match=r"a\.tar: this server sends whole files only.*gcd download"):
        files.read("a.tar", 1000, 2000, limit=1000)
    assert files.read("a.tar", 0, 1000, limit=1000)[0] == DATA[:1000]
    hub.faults = [Fault("a.tar", chunked=True), zipped(gzip.compress), zipped(gzip.compress)]
    assert brought(files, tmp_path / "again") == DATA
    assert files.read("a.tar", 1000, 2000, limit=1000)[0] == DATA[1000:2000]
    assert files.read("a.tar", limit=2 * len(DATA))[0] == DATA


def test_the_proxy_of_the_environment_is_used(hub: Hub, files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", hub.endpoint)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    assert Files("http://data.invalid/files").read("a.tar", limit=len(DATA))[0] == DATA
    assert files.read("a.tar", limit=len(DATA))[0] == DATA
    assert [request.path for request in hub.asked()] == ["http://data.invalid/files/a.tar", "/files/a.tar"]


def test_wrong_bytes_are_refused_and_nothing_is_left(hub: Hub, files: Files, tmp_path: Path) -> None:
    for stale in (b"x" * 1000, b"x" * (len(DATA) + 1)):  # a part of another file
        (tmp_path / ".a.tar.part").write_bytes(stale)
        assert brought(files, tmp_path) == DATA
        (tmp_path / "a.tar").unlink()
    hub.faults = [Fault("a.tar", flip=1234)]
    assert brought(files, tmp_path) == DATA  # asked for again once
    hub.faults = [Fault("a.tar", flip=1234, times=2)]
    with pytest.raises(RemoteError, match=r"a\.tar: received bytes do not match the published hash; none are kept"):
        brought(files, tmp_path / "other")
    assert not list((tmp_path / "other").iterdir())
    hub.static["a.tar"] = DATA[:1000]
    with pytest.raises(RemoteError, match=r"a\.tar: shorter than in its manifest"):
        brought(files, tmp_path / "short")


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_threads_and_processes_share_a_download(hub: Hub, files: Files, tmp_path: Path) -> None:
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(lambda _: brought(files, tmp_path), range(4))) == 4 * [DATA]
    assert len(hub.asked()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.tar"]
    with multiprocessing.get_context("fork").Pool(2) as pool:  # the parent has an HTTP client
        assert pool.starmap(brought, 2 * [(files, tmp_path / "other")]) == 2 * [DATA]
    assert len(hub.asked()) == 2


def answer(status: int, **headers: str) -> Fault:
    return Fault(
        "a.tar", 9999, status=status, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )


def zipped(change: Callable[[bytes], bytes], times: int = 1) -> Fault:
    return Fault("a.tar", times, headers={"Content-Encoding": "gzip"}, change=change)


HUGE = str(4 << 30)
REFUSED = {
    "missing": (answer(404), MissingError, r"not found \(404\)"),
    "forbidden": (answer(403), RefusedError, r"refused \(403\): ask for access, then run hf auth login"),
    "unknown": (answer(418), RemoteError, "answered with status 418"),
    "another range": (answer(206, Content_Range="bytes 5-9/10"), RemoteError, "status 206 bytes 5-9/10"),
    "no range": (answer(206, Content_Range="x" * 5000), RemoteError, "status 206 x{50}: check the address"),
    "4 GiB": (answer(200, Content_Length=HUGE), RemoteError, f"has {HUGE} bytes, over the limit of 1000 "),
    "to a file": (answer(302, Location="file:///etc/passwd"), RemoteError, "file:///etc/passwd.*: check the address"),
    "in a circle": (answer(302, Location="/files/a.tar"), RemoteError, "up to 5 redirects"),
    "to nowhere": (answer(302, Location="http:///a"), RemoteError, "cannot be read .*: check the address"),
    "longer": (Fault("a.tar"), RemoteError, "has 200000 bytes, over the limit of 1000 "),
    "longer, in chunks": (Fault("a.tar", chunked=True), RemoteError, "has more than 1000 bytes, over the limit"),
    "expanding": (zipped(lambda data: gzip.compress(bytes(1 << 28), 1)[:900]), RemoteError, "has more than 1000 bytes"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_hostile_answers_are_one_sentence(hub: Hub, files: Files, case: str) -> None:
    fault, error, told = REFUSED[case]
    hub.faults = [Fault(**vars(fault))]
    with pytest.raises(error, match=told) as caught:
        files.read("a.tar", limit=1000)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400
    assert len(hub.asked()) <= fetching.MOST_REDIRECTS + 1


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (answer(429, Retry_After="86400"), r"the server is busy \(429\), .* try again later, or with more"),
        (answer(503, Retry_After="Thu, 01 Jan 1970 00:00:00 GMT"), "the server is busy"),
        (Fault("a.tar", 999, cut=1, hold=True), "no answer for"),
        (Fault("a.tar", 9999, cut=0), "the connection was lost|no answer"),
        (zipped(lambda data: b"no gzip", 999), "connection was lost"),
    ],
)
@pytest.mark.usefixtures("short_answers")
def test_patience_bounds_all_waits(hub: Hub, files: Files, fault: Fault, told: str) -> None:
    hub.faults = [Fault(**vars(fault))]
    begun = time.monotonic()
    with pytest.raises(RemoteError, match=told) as caught:
        Files(files.url, patience=0.3).read("a.tar", limit=len(DATA))
    assert 0.3 <= time.monotonic() - begun < 5
    assert "\n" not in str(caught.value)


def test_a_name_that_is_unknown_is_given_up_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    unknown = socket.gaierror(socket.EAI_NONAME, "Name or service not known")
    monkeypatch.setattr(socket, "getaddrinfo", Mock(side_effect=unknown))
    monkeypatch.setattr(fetching, "UNRESOLVED", 0.2)
    with pytest.raises(RemoteError, match=r"http://x\.invalid/a: no answer \(.* not known.*\): check the address and"):
        Files("http://x.invalid", patience=60).read("a", limit=1000)
    monkeypatch.setattr(fetching, "_reached", {"http://x.invalid"})
    with pytest.raises(RemoteError, match="try again later, or with more patience"):
        Files("http://x.invalid", patience=0.5).read("a", limit=1000)


def sends(body: Callable[[socket.socket], None]) -> str:
    """The URL of a server that answers every request with bytes."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve(line: socket.socket) -> None:
        with line:
            line.recv(1 << 16)
            try:
                while True:
                    body(line)
            except OSError:
                pass

    def accept() -> None:
        while True:
            threading.Thread(target=serve, args=(server.accept()[0],), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return f"http://127.0.0.1:{server.getsockname()[1]}"


HEAD = b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n"


def test_an_endless_file_is_read_up_to_the_limit() -> None:
    tracemalloc.start()
    with pytest.raises(RemoteError, match="has more than 1000000 bytes, over the limit of 1000000 "):
        Files(sends(lambda line: line.sendall(HEAD + bytes(1 << 16)))).read("a", limit=1_000_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10_000_000


def slowly(line: socket.socket, first: int = 0) -> None:
    line.sendall(HEAD + bytes(first))
    while True:
        time.sleep(0.1)
        line.sendall(b"x")


@pytest.mark.usefixtures("short_answers")
@pytest.mark.parametrize(
    ("body", "told"),
    [
        (slowly, r"sent \d+ bytes in"),
        (lambda line: slowly(line, fetching.LITTLE), r"sent \d+ bytes in"),
        (lambda line: line.sendall(b"HTTP/1.1 100 Continue\r\n\r\n"), "no answer for"),
        (lambda line: line.sendall(bytes(range(256)) * 100), "no answer .*: try again later"),
        (lambda line: line.sendall(b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 10**5), "no answer .*: try again later"),
    ],
)
def test_bytes_that_are_no_answer_are_given_up(body: Callable[[socket.socket], None], told: str) -> None:
    begun = time.monotonic()
    with pytest.raises(RemoteError, match=told) as caught:
        Files(sends(body), patience=0.3).read("a", limit=1_000_000)
    assert time.monotonic() - begun < 5
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_a_stop_ends_all_waits(files: Files, hub: Hub, tmp_path: Path) -> None:
    patient = Files(files.url, patience=600)
    hub.faults = [answer(503, Retry_After="600")]
    threading.Timer(0.2, setattr, (patient, "stopped", True)).start()
    with pytest.raises(RemoteError, match="stopped"):
        patient.read("a.tar", limit=1000)
    with (tmp_path / ".a.tar.part").open("wb") as other, pytest.raises(RemoteError, match="stopped"):
        fcntl.flock(other, fcntl.LOCK_EX)
        brought(patient, tmp_path)
