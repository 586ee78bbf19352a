"""The interactive viewer: a web server on this machine whose pages turn over garments.

Each garment is shown by its self-contained page (``page``), in a frame below a bar to move and filter. Only this
machine can reach the server, and only with the token in the printed address, which its pages send as a cookie: other
users of the machine do not have it.
"""

import atexit
import contextlib
import json
import secrets
import sys
import tempfile
import threading
import webbrowser
from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import asdict
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from os import environ
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.viewer.garments import Album, Filter, Found
from gcd_dataset.viewer.notebook import asset, script_data

KEPT_PAGES = 16
LONGEST_WAIT = 1.0  # s that the reading of tags, and the end, wait for pages
HOST = "127.0.0.1"
LOCAL = (HOST, "localhost")
REFUSAL = "no token: open the address that gcd show printed, and allow its cookie"
JSON, HTML = "application/json", "text/html; charset=utf-8"
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; frame-src 'self'"
)
"""Of the bar, whose scripts are this package's; texts of the data enter them as text nodes."""

Answer = tuple[HTTPStatus, str, bytes]
"""Status, type and content."""


class Gallery:
    """Answers requests about an album. Pages are kept; those of the first and of the next garment are made ahead.

    The album reads its tags in the background, once the first page has been made.
    """

    def __init__(self, album: Album, start: int = 0) -> None:
        self._album, self._start = album, start
        self._pages: OrderedDict[tuple[int, int], Future[str]] = OrderedDict()
        self._lock = threading.Lock()
        self._makers = ThreadPoolExecutor(2, thread_name_prefix="pages")
        self._tag_reader = ThreadPoolExecutor(1, thread_name_prefix="tags")
        self._reading: Future[None] | None = None
        self._begin(album.nearest(start))  # while the browser opens

    def get(self, path: str, query: Mapping[str, str]) -> Answer:
        """The answer to ``GET path?query``. Raises ``GcdError`` for what does not exist.

        A garment that cannot be shown is answered by a page with the message.
        """
        if path == "/":
            given = {"start": self._start, "count": len(self._album), "beside": self._album.beside}
            return _html("browse.html", self._album.title, given)
        if path == "/facets":
            album, is_reading = self._album, self._reading is None or not self._reading.done()
            return _json({**asdict(album.facets()), "known": album.known, "count": len(album), "reading": is_reading})
        if path == "/find":
            return _json(self._found(query))
        if path == "/links":
            return _json(self._album.links(self._valid(_number(query, "position"))))
        if path == "/garment":
            try:
                page = self._page(_number(query, "position"), _number(query, "side"))
            except Exception as error:  # noqa: BLE001 -- the bar of the viewer shows it
                status, text = _fault(error)
                return _html("fault.html", self._album.title, {"error": text}, status)
            return HTTPStatus.OK, HTML, page.encode()
        raise ConfigError(f"no page {path!r:.80}")

    def close(self) -> None:
        """Stop the threads."""
        self._album.close()
        for threads in (self._makers, self._tag_reader):
            threads.shutdown(wait=False, cancel_futures=True)

    def has_ended(self) -> bool:
        """Whether the threads have ended, at the latest ``LONGEST_WAIT`` from now; to be called after ``close``.

        A thread that reads from a server which does not answer ends after minutes.
        """
        with self._lock:
            futures: list[Future[Any]] = list(self._pages.values())
            if self._reading is not None:
                futures.append(self._reading)
        running = [future for future in futures if not future.done()]  # ``wait`` takes cancelled ones for running
        return not wait(running, timeout=LONGEST_WAIT).not_done

    def _read_tags(self) -> None:
        """Begin to read tags, unless a thread reads them."""
        with self._lock:
            if self._reading is None or self._reading.done():
                self._reading = self._tag_reader.submit(self._album.read_tags, self._wait_for_pages)

    def _wait_for_pages(self) -> None:
        """Wait until no page is being made: it would take twice as long beside another busy thread."""
        with self._lock:
            pages = list(self._pages.values())
        wait(pages, timeout=LONGEST_WAIT)

    def _found(self, query: Mapping[str, str]) -> dict[str, Any]:
        album, where = self._album, Filter(*(query.get(name, "") for name in ("kind", "grade", "outcome")))
        if "text" in query:
            found = album.nearest(album.position_of(query["text"]), where)
        elif "position" in query:
            found = album.nearest(_number(query, "position"), where)
        else:
            found = album.found(_number(query, "rank"), where)
        self._begin(found)
        return {**asdict(found), "key": album.key(found.position) if found.count else ""}

    def _begin(self, found: Found) -> None:
        """Begin the pages of a garment; once they are made, those of the next one."""
        if found.count:
            pages = [self._begun(found.position, side) for side in range(len(self._album.beside))]
            pages[-1].add_done_callback(lambda _: self._make_ahead(found.following))

    def _make_ahead(self, position: int) -> None:
        with contextlib.suppress(RuntimeError):  # closed meanwhile
            for side in range(len(self._album.beside)):
                self._begun(position, side)

    def _begun(self, position: int, side: int) -> Future[str]:
        with self._lock:
            page = self._pages.pop((position, side), None)
            if page is None:
                page = self._makers.submit(self._album.page, position, side)
            self._pages[position, side] = page
            while len(self._pages) > KEPT_PAGES:
                self._pages.popitem(last=False)
        return page

    def _page(self, position: int, side: int) -> str:
        if not 0 <= side < len(self._album.beside):
            raise ConfigError(f"no side {side}: there are {len(self._album.beside)}")
        try:
            return self._begun(self._valid(position), side).result()
        finally:
            if self._reading is None:
                self._read_tags()

    def _valid(self, position: int) -> int:
        if not 0 <= position < len(self._album):
            raise ConfigError(f"no garment {position}: there are {len(self._album)}")
        return position


def serve(
    site: Gallery,
    *,
    port: int = 0,
    show: Callable[[str], Any] | None = None,
    started: Callable[[ThreadingHTTPServer], None] | None = None,
) -> None:
    """Serve until interrupted; ``port`` 0 takes a free one. Raises ``ConfigError`` for a port in use.

    ``show``: called with the address, which holds the token; by default prints it, and opens a browser where there is a
    display. ``started``: called with the server, to shut it down from another thread.
    """
    token = secrets.token_urlsafe()
    try:
        server = _Server((HOST, port), _handler(site, token))
    except OSError as error:
        site.close()
        raise ConfigError(f"--port {port}: {error.strerror}: give another port, or none") from error
    (show or _announce)(f"http://{HOST}:{server.server_port}/?token={token}")
    if started is not None:
        started(server)
    try:
        server.serve_forever(poll_interval=0.1)
    finally:
        server.server_close()
        site.close()


def _announce(address: str) -> None:
    print(f"{address}  (Ctrl-C ends)", flush=True)
    if sys.platform == "darwin" or environ.get("DISPLAY") or environ.get("WAYLAND_DISPLAY"):
        # By a private file: other users see the arguments of the browser's process.
        with tempfile.NamedTemporaryFile("w", prefix="gcd_show_", suffix=".html", delete=False) as file:
            file.write(f'<meta http-equiv="refresh" content="0; url={address}">')
        atexit.register(Path(file.name).unlink, missing_ok=True)
        webbrowser.open(Path(file.name).as_uri())


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report an error of a request, but for a page that was closed before its answer."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _handler(site: Gallery, token: str) -> type[BaseHTTPRequestHandler]:
    name = f"gcd_{secrets.token_hex(4)}"  # its own: browsers share the cookies of all ports of a machine

    class Handler(BaseHTTPRequestHandler):
        """Passes requests on; errors become answers, so that a page can show them."""

        def do_GET(self) -> None:
            self._answer(site.get)

        def log_message(self, *args: Any) -> None:
            """Requests are not printed."""

        def _answer(self, made: Callable[[str, dict[str, str]], Answer]) -> None:
            url = urlsplit(self.path)
            query = {key: values[-1] for key, values in parse_qs(url.query).items()}
            given = [f"{name}={query.pop('token', '')}", *self.headers.get("Cookie", "").split("; ")]
            has_token = any(secrets.compare_digest(one.encode(), f"{name}={token}".encode()) for one in given)
            # Else another user, or a foreign page whose name resolves to this machine.
            named = self.headers.get("Host", "")
            is_own = has_token and (named.rpartition(":")[0] or named) in LOCAL
            try:
                status, kind, content = made(url.path, query) if is_own else _failed(HTTPStatus.FORBIDDEN, REFUSAL)
            except Exception as error:  # noqa: BLE001 -- the page shows it, the server goes on
                status, kind, content = _failed(*_fault(error))
            self.send_response(status)
            if is_own:
                self.send_header("Set-Cookie", f"{name}={token}; Path=/; HttpOnly; SameSite=Strict")
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            self.wfile.write(content)

    return Handler


def _failed(status: HTTPStatus, text: str) -> Answer:
    return status, JSON, json.dumps({"error": text}).encode()


def _fault(error: Exception) -> tuple[HTTPStatus, str]:
    """Status and one line of text of an error."""
    is_known = isinstance(error, GcdError)
    text = str(error) if is_known else repr(error)
    return HTTPStatus.NOT_FOUND if is_known else HTTPStatus.INTERNAL_SERVER_ERROR, " ".join(text.split())


def _json(value: Mapping[str, Any]) -> Answer:
    return HTTPStatus.OK, JSON, json.dumps(value).encode()


def _html(name: str, title: str, given: Mapping[str, Any], status: HTTPStatus = HTTPStatus.OK) -> Answer:
    styled = asset(name).replace("{{policy}}", POLICY, 1).replace("{{style}}", asset("frame.css"), 1)
    styled = styled.replace("{{scale}}", asset("scale.js"), 1)
    head, _, tail = styled.partition("{{data}}")
    return status, HTML, f"{head.replace('{{title}}', escape(title))}{script_data(given)}{tail}".encode()


def _number(query: Mapping[str, str], name: str) -> int:
    text = query.get(name, "0")
    digits = text.removeprefix("-")
    if not digits.isdecimal() or len(digits) > 12:
        raise ConfigError(f"{name}={text:.40}: give a whole number")
    return int(text)
