"""Reads files of a web server, whole or by byte range, with retries.

Proxies and certificates come from the environment: ``HTTPS_PROXY``, ``SSL_CERT_FILE`` and so on. Declared sizes
are not allocated in advance: memory grows with the received bytes, up to a limit given by the caller.
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
    """The files below one base URL. May be pickled, forked, and used by several threads.

    ``headers`` is called once, at the first request; its headers are sent to the base URL's origin only, not to
    redirect targets. ``patience``: seconds of waiting since the last received byte before a read is given up.
    ``retry_unreachable=False``: no second attempt if there is no connection. Redirects are remembered, so that the next
    range of the same file costs one request; an expired target is looked up again.
    """

    def __init__(
        self,
        base: str,
        *,
        headers: Callable[[], Mapping[str, str]] = dict,
        patience: float | None = None,
        retry_unreachable: bool = True,
    ) -> None:
        self.base, self.patience = base.rstrip("/"), patience
        self._make_headers, self._retry_unreachable = headers, retry_unreachable
        self._headers: Mapping[str, str] | None = None
        self._redirects: dict[str, str] = {}
        self.etags: dict[str, str] = {}
        """File to its ETag; for a redirect of the Hub, the ETag of the large file behind it."""

    def address(self, path: str) -> str:
        """The URL of a file."""
        return f"{self.base}/{quote(path, errors='surrogatepass')}" if path else self.base

    def get(self, path: str, limit: int) -> bytes:
        """A whole file.

        Raises ``MissingError`` for a missing file, ``RemoteError`` for over ``limit`` bytes and any other failure.
        """
        content = bytearray()
        for piece in self.pieces(path, limit=limit):
            content += piece
        return bytes(content)

    def read(self, path: str, start: int, end: int) -> memoryview:
        """Bytes ``start`` to ``end`` of a file, in a new writable buffer.

        Raises as ``get`` does, and ``RemoteError`` for a server that ignores ranges and sends whole files.
        """
        content = bytearray()
        for piece in self.pieces(path, start, end, require_range=True):
            content += piece
        return memoryview(content)

    def pieces(
        self,
        path: str,
        start: int = 0,
        end: int | None = None,
        *,
        require_range: bool = False,
        limit: int | None = None,
    ) -> Iterator[bytes]:
        """The bytes from ``start`` to ``end``, by default the end of the file, as received; resumes lost connections.

        ``require_range``: refuse a server that sends other bytes too. Raises ``RemoteError`` for a declared or actual
        size over ``limit`` bytes.
        """
        offset, backoff = start, Backoff(self.patience)
        while True:
            before = offset
            try:
                for piece in self._request(path, offset, end, require_range, limit):
                    offset += len(piece)
                    if limit is not None and offset > limit:
                        raise self._too_long(path, f"more than {limit} bytes", limit)
                    yield piece
                if end is None or offset == end:
                    return
                retryable = RetryableError(f"ends at byte {offset} of {end}")
            except RetryableError as error:
                retryable = error
            if offset > before:
                backoff = Backoff(self.patience)
            backoff.wait(self.address(path), retryable, retry_unreachable=self._retry_unreachable)

    def _request(
        self, path: str, start: int, end: int | None, require_range: bool, limit: int | None
    ) -> Iterator[bytes]:
        """One attempt of ``pieces``. Raises ``RetryableError`` for an error that may pass."""
        whole = start == 0 and end is None
        if end is not None and start >= end:
            return
        # Ranges of a compressed response could not be counted.
        headers = {"Accept-Encoding": "identity"}
        if not whole:
            headers["Range"] = f"bytes={start}-{'' if end is None else end - 1}"
        with self._response(path, headers) as response:
            if response.status_code == 416 and end is None:
                return  # ``start`` is the end of the file
            self._require(path, response, ranged=not whole)
            declared = response.headers.get("Content-Length", "")
            if limit is not None and declared.isdecimal() and int(declared) > limit:
                raise self._too_long(path, f"{declared} bytes", limit)
            skip = 0 if whole else _skip(response, start, self.address(path))
            left = None if end is None else end - start
            if require_range:
                _require_range(response, left, self.address(path))
            for piece in response.iter_raw():  # unbuffered: a buffer would be lost with the connection
                part = piece[skip:] if left is None else piece[skip : skip + left]
                skip -= min(skip, len(piece))
                if left is not None:
                    left -= len(part)
                if part:
                    yield part
                if left == 0:
                    return

    @contextmanager
    def _response(self, path: str, headers: Mapping[str, str]) -> Iterator["httpx2.Response"]:
        """The server's response. Raises ``RetryableError`` for a lost connection, also while the body is read."""
        import httpx2
        from huggingface_hub import constants

        address = self.address(path)
        if constants.HF_HUB_OFFLINE:
            raise RemoteError(
                f"{address}: HF_HUB_OFFLINE is set, and this file is not in the cache: unset the variable"
            )
        url = self._redirects.get(path, address)
        if self._headers is None:
            self._headers = self._make_headers()
        headers = {**headers, **(self._headers if _origin(url) == _origin(address) else {})}
        try:
            with _client(os.getpid()).stream("GET", url, headers=headers) as response:
                if url != address and response.status_code in REFUSED | GONE:
                    self._redirects.pop(path, None)
                    raise RetryableError(f"its redirect has expired ({response.status_code})", wait=0.0)
                if response.is_success:
                    self._remember(path, response)
                yield response
        except (httpx2.UnsupportedProtocol, httpx2.TooManyRedirects) as error:
            raise RemoteError(
                f"{address}: redirects to {shown(str(error.request.url))} ({first_line(error)}): up to "
                f"{MOST_REDIRECTS} redirects to http and https are followed: check the address, or tell its publisher"
            ) from error
        except httpx2.TransportError as error:
            self._redirects.pop(path, None)
            is_unreachable = isinstance(error, httpx2.ConnectError | httpx2.ConnectTimeout)
            raise RetryableError(f"no connection ({first_line(error)})", is_unreachable=is_unreachable) from error
        except httpx2.HTTPError as error:
            raise RemoteError(f"{address}: cannot be read ({first_line(error)}): check the address") from error
        except httpx2.InvalidURL as error:
            raise RemoteError(f"{address}: not a valid URL ({error}): check it") from error

    def _too_long(self, path: str, size: str, limit: int) -> RemoteError:
        return RemoteError(
            f"{self.address(path)}: has {size}, over the limit of {limit} for this kind of file: check the address, "
            "or tell its publisher"
        )

    def _remember(self, path: str, response: "httpx2.Response") -> None:
        """Store the file's ETag and redirect target."""
        first = response.history[0] if response.history else response
        etag = first.headers.get("X-Linked-Etag") or first.headers.get("ETag")
        if etag:
            self.etags[path] = etag.removeprefix("W/").strip('"')
        if response.history:
            self._redirects[path] = str(response.url)

    def _require(self, path: str, response: "httpx2.Response", *, ranged: bool) -> None:
        """Raise ``RetryableError`` or ``RemoteError`` unless the response fits the request."""
        status, address = response.status_code, self.address(path)
        if status in BUSY:
            raise RetryableError(f"the server is busy ({status})", wait=_retry_after(response.headers))
        if status in GONE:
            raise MissingError(f"{address}: not found ({status}): check the name, and the token if it is private")
        if status in REFUSED:
            raise RefusedError(f"{address}: refused ({status}): ask for access, then run hf auth login or set HF_TOKEN")
        if status == 416:
            raise RemoteError(f"{address}: shorter than in its index: tell its publisher, or pin another revision")
        if not response.is_success:
            raise RemoteError(f"{address}: answered with status {status}: check the address")
        if status == 206 and not ranged:
            raise RemoteError(f"{address}: sent a part of the file, but the whole was requested: try another server")
        if (encoding := response.headers.get("Content-Encoding", "identity")) != "identity":
            raise RemoteError(
                f"{address}: sent compressed ({encoding}), without a request for compression: turn it off on the server"
            )


@functools.cache
def _client(process: int) -> "httpx2.Client":
    """The HTTP client of a process: a forked child must not use its parent's connections."""
    import httpx2

    client = httpx2.Client(follow_redirects=True, max_redirects=MOST_REDIRECTS, timeout=TIMEOUT)
    atexit.register(client.close)
    return client


def _skip(response: "httpx2.Response", start: int, address: str) -> int:
    """Number of bytes in the body before ``start``: 0, or ``start`` from a server that ignores ranges."""
    if response.status_code == 200:
        return start
    span = response.headers.get("Content-Range", "")
    if not span.startswith(f"bytes {start}-"):
        raise RemoteError(
            f"{address}: sent {span or 'an unnamed range'}, but byte {start} was requested: try another server"
        )
    return 0


def _require_range(response: "httpx2.Response", size: int | None, address: str) -> None:
    """Raise ``RemoteError`` for a response with the whole file where ``size`` bytes were requested."""
    if response.status_code == 200 and response.headers.get("Content-Length") != str(size):
        raise RemoteError(
            f"{address}: this server sends whole files only, so each garment would cost a whole shard: download the "
            "data set with gcd download, without --fields, or read it with streaming=True"
        )


def _retry_after(headers: Mapping[str, str]) -> float | None:
    """Seconds of the header Retry-After; ``None`` without a valid one."""
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
