"""Files of a web server, whole or in part, with patience for one that is busy, or gone for a while.

Proxies and certificates are those of the environment: ``HTTPS_PROXY``, ``SSL_CERT_FILE`` and their like. Nothing is
allocated because a server declares a size: memory grows with the bytes that come, up to a limit of the caller's.
"""

import atexit
import functools
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import TYPE_CHECKING
from urllib.parse import quote, urlsplit

from gcd_dataset.errors import MissingError, RefusedError, RemoteError, shown
from gcd_dataset.hub.retry import Backoff, RetryableError, first_line

if TYPE_CHECKING:
    import httpx2

__all__ = ["Web"]

TIMEOUT = 30.0  # s without a byte
MOST_REDIRECTS = 8  # the Hub and its storage take three

BUSY = frozenset({408, 425, 429, 500, 502, 503, 504})
REFUSED = frozenset({401, 403})
GONE = frozenset({404, 410})


class Web:
    """The files below one address. May be pickled, forked, and used by several threads.

    What ``headers`` gives goes to that address alone, not to where it redirects; it is called once, when the first
    request is made. ``patience``: seconds of waits, counted anew from each byte that comes, before a read is given up.
    Not ``patient``: where nobody answers at all, there is no second attempt. A redirect is remembered, so that the next
    part of the same file costs one request; an address that has expired is asked for again.
    """

    def __init__(
        self,
        base: str,
        *,
        headers: Callable[[], Mapping[str, str]] = dict,
        patience: float | None = None,
        patient: bool = True,
    ) -> None:
        self.base, self.patience = base.rstrip("/"), patience
        self._make_headers, self._patient = headers, patient
        self._headers: Mapping[str, str] | None = None
        self._moved: dict[str, str] = {}
        self.etags: dict[str, str] = {}
        """ETag of each file that was answered for: that of the large file behind a redirect of the Hub."""

    def address(self, path: str) -> str:
        """The URL of a file."""
        return f"{self.base}/{quote(path, errors='surrogatepass')}" if path else self.base

    def get(self, path: str, most: int) -> bytes:
        """A whole file of ``most`` bytes at most.

        Raises ``MissingError`` where there is none, ``RemoteError`` for a longer one and any other trouble.
        """
        content = bytearray()
        for piece in self.pieces(path, most=most):
            content += piece
        return bytes(content)

    def read(self, path: str, start: int, end: int) -> memoryview:
        """Bytes ``start`` to ``end`` of a file, writable and the caller's own.

        Raises as ``get`` does, and ``RemoteError`` for a server that would send the whole file for every part of it.
        """
        content = bytearray()
        for piece in self.pieces(path, start, end, only=True):
            content += piece
        return memoryview(content)

    def pieces(
        self, path: str, start: int = 0, end: int | None = None, *, only: bool = False, most: int | None = None
    ) -> Iterator[bytes]:
        """The bytes from ``start`` to ``end``, or to the end of the file, as they come; goes on where a line breaks.

        ``only`` these: a server that sends others with them is not read. Raises ``RemoteError`` for a file that is
        declared to have, or has, more than ``most`` bytes.
        """
        place, outage = start, Backoff(self.patience)
        while True:
            before = place
            try:
                for piece in self._once(path, place, end, only, most):
                    place += len(piece)
                    if most is not None and place > most:
                        raise self._too_long(path, f"more than {most} bytes", most)
                    yield piece
                if end is None or place == end:
                    return
                trouble = RetryableError(f"ends at byte {place} of {end}")
            except RetryableError as error:
                trouble = error
            if place > before:
                outage = Backoff(self.patience)
            outage.rest(self.address(path), trouble, patient=self._patient)

    def _once(self, path: str, start: int, end: int | None, only: bool, most: int | None) -> Iterator[bytes]:
        """One attempt. Raises ``RetryableError`` where another may do better."""
        whole = start == 0 and end is None
        if end is not None and start >= end:
            return
        # Packed bytes could be neither counted nor cut.
        wanted = {"Accept-Encoding": "identity"}
        if not whole:
            wanted["Range"] = f"bytes={start}-{'' if end is None else end - 1}"
        with self._answer(path, wanted) as response:
            if response.status_code == 416 and end is None:
                return  # all of it is there
            self._require(path, response, ranged=not whole)
            declared = response.headers.get("Content-Length", "")
            if most is not None and declared.isdecimal() and int(declared) > most:
                raise self._too_long(path, f"{declared} bytes", most)
            skip = 0 if whole else _skip(response, start, self.address(path))
            left = None if end is None else end - start
            if only:
                _require_part(response, left, self.address(path))
            for piece in response.iter_raw():  # as it comes: what is gathered first is lost where the line breaks
                part = piece[skip:] if left is None else piece[skip : skip + left]
                skip -= min(skip, len(piece))
                if left is not None:
                    left -= len(part)
                if part:
                    yield part
                if left == 0:
                    return

    @contextmanager
    def _answer(self, path: str, wanted: Mapping[str, str]) -> Iterator["httpx2.Response"]:
        """The server's answer. Raises ``RetryableError`` for a line that breaks, now or while the answer is read."""
        import httpx2
        from huggingface_hub import constants

        own = self.address(path)
        if constants.HF_HUB_OFFLINE:
            raise RemoteError(f"{own}: HF_HUB_OFFLINE is set, and this is not in the cache: unset it")
        url = self._moved.get(path, own)
        if self._headers is None:
            self._headers = self._make_headers()
        headers = {**wanted, **(self._headers if _origin(url) == _origin(own) else {})}
        try:
            with _client(os.getpid()).stream("GET", url, headers=headers) as response:
                if url != own and response.status_code in REFUSED | GONE:
                    self._moved.pop(path, None)
                    raise RetryableError(f"its address has expired ({response.status_code})", wait=0.0)
                if response.is_success:
                    self._remember(path, response)
                yield response
        except (httpx2.UnsupportedProtocol, httpx2.TooManyRedirects) as error:
            raise RemoteError(
                f"{own}: leads to {shown(str(error.request.url))} ({first_line(error)}): up to {MOST_REDIRECTS} redirects "
                "to http and https are followed: check the address, or tell its publisher"
            ) from error
        except httpx2.TransportError as error:
            self._moved.pop(path, None)
            nobody = isinstance(error, httpx2.ConnectError | httpx2.ConnectTimeout)
            raise RetryableError(f"no connection ({first_line(error)})", is_unreachable=nobody) from error
        except httpx2.HTTPError as error:
            raise RemoteError(f"{own}: cannot be read ({first_line(error)}): check the address") from error
        except httpx2.InvalidURL as error:
            raise RemoteError(f"{own}: no address ({error}): check it") from error

    def _too_long(self, path: str, size: str, most: int) -> RemoteError:
        return RemoteError(
            f"{self.address(path)}: has {size}, and up to {most} are read of a file of this kind: check the address, "
            "or tell its publisher"
        )

    def _remember(self, path: str, response: "httpx2.Response") -> None:
        """What the answer tells of the file: its ETag, and where it lies."""
        first = response.history[0] if response.history else response
        etag = first.headers.get("X-Linked-Etag") or first.headers.get("ETag")
        if etag:
            self.etags[path] = etag.removeprefix("W/").strip('"')
        if response.history:
            self._moved[path] = str(response.url)

    def _require(self, path: str, response: "httpx2.Response", *, ranged: bool) -> None:
        """Raise ``RetryableError`` or ``RemoteError`` unless the answer holds what was asked for."""
        status, own = response.status_code, self.address(path)
        if status in BUSY:
            raise RetryableError(f"the server is busy ({status})", wait=_retry_after(response.headers))
        if status in GONE:
            raise MissingError(f"{own}: not there ({status}): check the name, and the token if it is private")
        if status in REFUSED:
            raise RefusedError(f"{own}: refused ({status}): ask for access, then run hf auth login or set HF_TOKEN")
        if status == 416:
            raise RemoteError(f"{own}: shorter than its index tells: tell its publisher, or pin another revision")
        if not response.is_success:
            raise RemoteError(f"{own}: answered with {status}: check the address")
        if status == 206 and not ranged:
            raise RemoteError(f"{own}: sent a part of what was asked for whole: try another server")
        if (packed := response.headers.get("Content-Encoding", "identity")) != "identity":
            raise RemoteError(f"{own}: comes packed ({packed}), unasked: have its server send files as they are")


@functools.cache
def _client(process: int) -> "httpx2.Client":
    """The client of a process: a forked one must not send on its parent's lines."""
    import httpx2

    client = httpx2.Client(follow_redirects=True, max_redirects=MOST_REDIRECTS, timeout=TIMEOUT)
    atexit.register(client.close)
    return client


def _skip(response: "httpx2.Response", start: int, where: str) -> int:
    """How many bytes of the answer lie before ``start``: all, from a server that knows no ranges."""
    if response.status_code == 200:
        return start
    span = response.headers.get("Content-Range", "")
    if not span.startswith(f"bytes {start}-"):
        raise RemoteError(f"{where}: sent {span or 'an unnamed part'}, asked for byte {start}: try another server")
    return 0


def _require_part(response: "httpx2.Response", size: int | None, where: str) -> None:
    """Raise ``RemoteError`` for an answer that holds all of a file for the sake of ``size`` bytes of it."""
    if response.status_code == 200 and response.headers.get("Content-Length") != str(size):
        raise RemoteError(
            f"{where}: this server sends whole files only, all of a shard for every garment: bring the data set here "
            "with gcd download, without --fields, or read it with streaming=True"
        )


def _retry_after(headers: Mapping[str, str]) -> float | None:
    """Seconds that the server asks to wait; ``None`` where it does not say."""
    text = headers.get("Retry-After", "").strip()
    if text.isdecimal():
        return float(text)
    try:
        return max(0.0, (parsedate_to_datetime(text) - datetime.now(UTC)).total_seconds())
    except (ValueError, TypeError):
        return None


def _origin(url: str) -> tuple[str, str]:
    parts = urlsplit(url)
    return parts.scheme, parts.netloc
