"""The viewer's server: pages, filters and errors as answers, and requests that it refuses."""

import json
import queue
import re
import socket
import struct
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from http.server import ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.viewer.garments import Album, ShardAlbum
from gcd_dataset.viewer.server import Gallery, serve


class Running:
    """A server in a thread."""

    def __init__(self, site: Gallery) -> None:
        found: list[Any] = []
        ready = threading.Event()

        def started(server: ThreadingHTTPServer) -> None:
            found.append(server)
            ready.set()

        options = {"show": found.append, "started": started}
        self.thread = threading.Thread(target=serve, args=(site,), kwargs=options, daemon=True)
        self.thread.start()
        assert ready.wait(30)
        self.address, self.server = found
        self.port, self.first = urlsplit(self.address).port, self.address.partition(str(urlsplit(self.address).port))[2]
        self.cookie = ""
        self.ask(self.first)

    def ask(self, path: str, **headers: str) -> tuple[int, str, str]:
        """Status, type and text of an answer to a browser that keeps the cookie, unless ``Cookie`` is given."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request("GET", path, headers={"Cookie": self.cookie, **headers})
        answer = connection.getresponse()
        self.cookie = answer.getheader("Set-Cookie", self.cookie).partition(";")[0]
        found = answer.status, answer.headers.get_content_type(), answer.read().decode()
        connection.close()
        return found

    def close(self) -> None:
        self.server.shutdown()
        self.thread.join(30)
        assert not self.thread.is_alive()


class Observed(Album):
    """Three empty pages; it tells which one is made."""

    title = "observed"
    known = 3

    def __init__(self) -> None:
        self.made: queue.Queue[int] = queue.Queue()

    def __len__(self) -> int:
        return 3

    def key(self, position: int) -> str:
        return str(position)

    def page(self, position: int, side: int = 0) -> str:
        self.made.put(position)
        return ""

    def picture(self, position: int, size: int) -> np.ndarray:
        raise NotImplementedError


def test_the_first_page_and_the_next_are_made_before_a_request() -> None:
    album = Observed()
    gallery = Gallery(album, 2)
    try:
        assert [album.made.get(timeout=30) for _ in range(2)] == [2, 0]
    finally:
        gallery.close()


def test_a_gallery_has_ended_once_its_threads_have() -> None:
    class Waiting(Observed):
        def page(self, position: int, side: int = 0) -> str:
            self.made.put(position)
            answered.wait(30)
            return ""

    answered, album = threading.Event(), Waiting()
    gallery = Gallery(album)
    assert album.made.get(timeout=30) == 0
    gallery.get("/find", {"position": "1"})
    gallery.get("/find", {"position": "2"})  # waits for one of the two threads, and is cancelled
    gallery.close()
    assert not gallery.has_ended()
    answered.set()
    assert gallery.has_ended()


@pytest.fixture(scope="module")
def gallery(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    where = tmp_path_factory.mktemp("shards")
    with ShardWriter(where, seed=0, recipe={}) as writer:
        for index in range(3):
            writer.write(fake_sample(0, index))
    running = Running(Gallery(ShardAlbum(ShardReader(where), "<script>alert(1)</script>"), 1))
    yield running
    running.close()


def test_the_bar_starts_at_the_asked_garment_and_escapes_the_title(gallery: Running) -> None:
    status, kind, text = gallery.ask("/")
    assert (status, kind) == (200, "text/html")
    assert '"start":1' in text
    assert "alert(1)</script>" not in text


def test_garments_are_found_by_rank_and_by_index(gallery: Running) -> None:
    found = json.loads(gallery.ask("/find?rank=4")[2])
    assert found == {"position": 1, "rank": 1, "count": 3, "following": 2, "key": "gcd_000000001"}
    assert json.loads(gallery.ask("/find?text=2")[2])["position"] == 2
    status, kind, text = gallery.ask("/garment?position=2")
    assert (status, kind) == (200, "text/html")
    assert "gcd_000000002" in text


@pytest.mark.parametrize(
    "path", ["/nowhere", "/links?position=3", "/find?position=x", "/find?text=77", "/find?rank=" + "9" * 50]
)
def test_what_does_not_exist_is_an_error_in_one_line(path: str, gallery: Running) -> None:
    status, kind, text = gallery.ask(path)
    assert (status, kind) == (404, "application/json")
    error = json.loads(text)["error"]
    assert error and "\n" not in error


@pytest.mark.parametrize("query", ["position=3", "position=x", "position=0&side=1", "position=x</script>"])
def test_a_garment_that_cannot_be_shown_is_a_page_with_the_message(query: str, gallery: Running) -> None:
    status, kind, text = gallery.ask(f"/garment?{query}")
    assert (status, kind) == (404, "text/html")
    data = text.partition('id="fault">')[2].partition("</script>")[0]
    assert re.search("no garment|whole number|no side", json.loads(data)["error"])


def test_a_page_that_is_closed_early_leaves_no_message(gallery: Running, capsys: pytest.CaptureFixture[str]) -> None:
    request = b"GET /facets HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with socket.create_connection(("127.0.0.1", gallery.port)) as connection:
        connection.send(request)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset when closed
    assert gallery.ask("/facets")[0] == 200  # the request before has its thread by now
    for thread in threading.enumerate():
        if "process_request" in thread.name:
            thread.join(30)
    assert not capsys.readouterr().err


def test_another_host_name_is_refused(gallery: Running) -> None:
    """A page of another site whose name resolves to this machine must not read the data."""
    assert gallery.ask("/facets", Host="evil.example")[0] == 403


PAGES = ("/", "/facets", "/find?rank=0", "/links?position=0", "/garment?position=0", "/nowhere", "//[")


@pytest.mark.parametrize("path", PAGES)
def test_nothing_is_answered_without_the_token(path: str, gallery: Running) -> None:
    """Other users of the machine reach the port, too."""
    wrong = gallery.cookie[:-1] + ("a" if gallery.cookie[-1] != "a" else "b")
    for cookie in ("", wrong, gallery.cookie.partition("=")[2], "é"):
        status, _, text = gallery.ask(path, Cookie=cookie)
        assert status == 403 and "printed" in json.loads(text)["error"]
    between = "&" if "?" in path else "?"
    assert gallery.ask(f"{path}{between}token={wrong}", Cookie="")[0] == 403


def test_the_token_in_the_address_or_the_cookie_opens_every_page(gallery: Running) -> None:
    for path in ("/", "/facets", "/garment?position=0"):
        token = gallery.first.partition("?")[2]
        assert gallery.ask(f"{path}{'&' if '?' in path else '?'}{token}", Cookie="")[0] == 200
        assert gallery.ask(path, Cookie=f"other=1; {gallery.cookie}")[0] == 200


def test_a_port_in_use_is_refused(gallery: Running) -> None:
    with pytest.raises(ConfigError, match="--port"):
        serve(Gallery(Observed()), port=gallery.port or 0, show=lambda _: None)
