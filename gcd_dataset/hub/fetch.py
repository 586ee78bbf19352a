"""Fetches files through ``fsspec``: into memory, or as whole verified tars into a folder.

    .train-00012.tar.part   a download in progress, or stopped: locked while a process fills it, continued by the next

``fsspec`` knows the protocols, credentials and proxies. Added here: continuation, retries for a limited time, limits on
what a server may send, hashes.
"""

import asyncio
import contextlib
import errno
import logging
import math
import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

from gcd_dataset.errors import ConfigError, GcdError, MissingError, RefusedError, RemoteError, shown
from gcd_dataset.files import make_folder
from gcd_dataset.shards.access import lock_file, unlock, writing
from gcd_dataset.shards.notes import hashed

Headers = Mapping[str, str]
Take = Callable[[bytes], None]  # called with the bytes of a file in order
Count = Callable[..., None]  # called as ``Take``, with the number of other bytes that were received with them

PATIENCE = 300.0  # s of attempts without a received byte
UNRESOLVED = 3.0  # s of attempts at a server whose name is unknown, and that this process has not reached before
FIRST_WAIT, DOUBLINGS = 0.5, 7  # s between attempts: each wait is twice the last, up to 64 s
ANSWER = 10.0  # s until an answer begins, and between its pieces
LITTLE = 1 << 16  # bytes: attempts that bring fewer do not renew the patience
LOOK = 0.05  # s between looks at another process's lock
MOST_REDIRECTS = 5  # the Hub and its storage take three
PIECE = 1 << 26  # bytes of one request to an object store

WEB, S3 = ("http://", "https://"), ("s3://", "s3a://")
BUSY, REFUSED, GONE = frozenset({408, 425, 429, 500, 502, 503, 504}), frozenset({401, 403}), frozenset({404, 410})
NO_CREDENTIALS = re.compile("Credential|NoAuth")  # in names of errors of botocore, google.auth, azure.identity
INVALID = (ValueError, TypeError, NotImplementedError, FileExistsError, NotADirectoryError, IsADirectoryError)
"""Errors of fsspec's file systems for requests that no repetition helps."""
# s3fs sets these for HTTP status 301, 400, 405, 416 and 501.
PERMANENT = frozenset({errno.EINVAL, errno.ENOSYS, errno.EPERM, errno.ENAMETOOLONG, errno.EREMCHG, errno.EMSGSIZE})

log = logging.getLogger(__name__)
_reached: set[str] = set()
"""Protocol and host of the servers that have answered this process."""


class Passing(Exception):  # noqa: N818 -- a state of the server
    """An error that may pass; ``wait``: seconds that the server asks for."""

    def __init__(self, message: str, wait: float = 0.0) -> None:
        super().__init__(message)
        self.wait = wait


class Span(NamedTuple):
    """Bytes of a file, up to ``end`` or its last one.

    ``limit``: most bytes of the whole file; ``None``, or no ``end``: the server may send bytes before ``start``, which
    are skipped.
    """

    address: str
    start: int
    end: int | None
    limit: int | None

    @property
    def root(self) -> str:
        """Protocol and host, or bucket."""
        return "/".join(self.address.split("/")[:3])

    def too_long(self, size: str) -> RemoteError:
        """The error about a file of more than ``limit`` bytes."""
        told = f"{self.address}: has {size} bytes, over the limit of {self.limit} for this kind of file"
        return RemoteError(f"{told}: check the address, or tell its publisher")


class Files:
    """The files below a URL. May be pickled, forked and used by several threads.

    ``headers`` makes the headers of requests to a web server; ``Authorization`` is not sent on to other hosts.
    ``patience``: seconds since the last received byte after which a request is given up, whatever the server asks for.

    Methods raise ``MissingError`` for a missing file, ``RefusedError`` where the credentials lack the right,
    ``RemoteError`` for any other failure, and ``ConfigError`` where the package of an object store is not installed.
    """

    def __init__(self, url: str, *, headers: Callable[[], Headers] = dict, patience: float | None = None) -> None:
        self.url, self.patience, self._headers = url.rstrip("/"), PATIENCE if patience is None else patience, headers
        self.stopped = False
        """Set by another thread: running requests raise ``RemoteError`` soon."""

    def address(self, name: str) -> str:
        """The URL of a file."""
        return f"{self.url}/{name}"

    def read(self, name: str, start: int = 0, end: int | None = None, *, limit: int) -> tuple[bytes, Headers]:
        """Bytes ``start`` to ``end`` of a file, by default all, and the headers of the answer.

        Raises ``RemoteError`` for more than ``limit`` bytes, and for a part from a server that sends whole files only.
        """
        content = bytearray()
        headers = self._receive(Span(self.address(name), start, end, limit), content.extend)
        return bytes(content), headers

    def complete(self, name: str, part: Path, size: int, sha256: str, on_progress: Callable[[int], None]) -> None:
        """Append the missing bytes of a file of known size and hash to ``part``; with a wrong hash, all of them once.

        ``on_progress`` is called with the bytes that are there. Raises ``OutputError`` too.
        """
        for _ in range(2):
            with writing(part), part.open("ab") as file:

                def take(piece: bytes, file: BinaryIO = file) -> None:
                    with writing(part):  # not in the loop of fsspec, whose OSErrors are those of servers
                        file.write(piece)
                    on_progress(file.tell())

                if (start := file.tell()) < size:
                    self._receive(Span(self.address(name), start, size, None), take)
                file.flush()
                os.fsync(file.fileno())
            if hashed(part) == (size, sha256):
                return
            with writing(part):
                os.truncate(part, 0)
        part.unlink()
        raise RemoteError(
            f"{self.address(name)}: received bytes do not match the published hash; none are kept: try again later, or "
            "tell its publisher"
        )

    def _receive(self, span: Span, take: Take) -> Headers:
        """Pass the bytes to ``take``, and continue after a lost connection; the headers of the last answer."""
        offset, attempts, progress = span.start, 0, time.monotonic()
        received, since = 0, progress

        def counted(piece: bytes, skipped: int = 0) -> None:
            nonlocal offset, received, since
            take(piece)
            offset, received = offset + len(piece), received + len(piece) + skipped
            self.require_wanted(span.address)
            if received >= LITTLE:
                received, since = 0, time.monotonic()
            elif time.monotonic() - since > self.patience + ANSWER:
                raise Passing(f"sent {received} bytes in {time.monotonic() - since:.0f} s")

        while True:
            before, received, since = offset, 0, time.monotonic()
            try:
                rest = span._replace(start=offset)
                is_web = self.url.startswith(WEB)
                headers = _from_web(rest, counted, self._headers()) if is_web else _from_store(rest, counted)
            except Passing as error:
                if offset - before >= LITTLE:
                    attempts, progress = 0, time.monotonic()
                attempts += 1
                self._wait(span, error, attempts, progress)
            else:
                _reached.add(span.root)
                return headers

    def _wait(self, span: Span, error: Passing, attempts: int, progress: float) -> None:
        """Sleep after ``attempts`` attempts since ``progress``. Raises ``RemoteError`` when the patience is over."""
        is_unknown = span.root not in _reached and _is_unresolved(error)
        left = progress + (min(self.patience, UNRESOLVED) if is_unknown else self.patience) - time.monotonic()
        if left <= 0 and is_unknown:
            raise RemoteError(f"{span.address}: {error}: check the address and the network")
        if left <= 0:
            raise RemoteError(
                f"{span.address}: {error}, {attempts} times in {self.patience:.0f} s: try again later, or with more "
                "patience (--patience, patience=); received data are kept"
            )
        if not is_unknown:
            log.log(logging.WARNING if attempts == 1 else logging.INFO, "%s: %s: trying again", span.address, error)
        until = time.monotonic() + min(max(error.wait, FIRST_WAIT * 2 ** min(attempts - 1, DOUBLINGS)), left)
        while (left := until - time.monotonic()) > 0:
            self.require_wanted(span.address)
            time.sleep(min(left, FIRST_WAIT))

    def require_wanted(self, address: str) -> None:
        """Raise ``RemoteError`` if the requests are stopped."""
        if self.stopped:
            raise RemoteError(f"{address}: stopped: start again to continue")


def _is_unresolved(error: BaseException) -> bool:
    """Whether an error comes from a host name that could not be resolved."""
    cause = error.__cause__ or error.__context__
    return isinstance(error, socket.gaierror) or (cause is not None and _is_unresolved(cause))


def _from_web(span: Span, take: Count, headers: Headers) -> Headers:
    """One attempt at a web server. Raises ``Passing`` for an error that may pass."""
    import aiohttp
    from fsspec.asyn import sync

    redirected = (aiohttp.TooManyRedirects, aiohttp.RedirectClientError)
    try:
        web = _web(os.getpid())
        answered: Headers = sync(web.loop, _stream, web, span, take, headers)
    except (*redirected, aiohttp.InvalidURL, aiohttp.ClientConnectorCertificateError) as error:
        raise RemoteError(
            f"{span.address}: cannot be read ({first_line(error)}): check the address; up to {MOST_REDIRECTS} "
            "redirects to http and https are followed"
        ) from error
    except aiohttp.ClientPayloadError as error:
        raise Passing("the connection was lost") from error
    except (aiohttp.ClientError, OSError) as error:
        fault = f"for {ANSWER:.0f} s" if isinstance(error, TimeoutError) else f"({first_line(error)})"
        raise Passing(f"no answer {fault}") from error
    return answered


async def _stream(web: Any, span: Span, take: Count, headers: Headers) -> Headers:
    """Pass the bytes of one answer to ``take``; its headers."""
    (address, start, end, limit), session = span, await web.set_session()
    is_part = start > 0 or end is not None
    # The range of a compressed answer may count compressed bytes.
    asked = {**headers, "Accept-Encoding": "identity" if is_part else "gzip"}
    if is_part:
        asked["Range"] = f"bytes={start}-{'' if end is None else end - 1}"
    async with asyncio.timeout(ANSWER):
        options = {"headers": asked, "max_redirects": MOST_REDIRECTS, "proxy": _proxy(address)}
        response = await session.get(web.encode_url(address), **options)
    async with response:
        _require(span, response)
        skip, left = start if response.status == 200 else 0, None if end is None else end - start
        most = math.inf if limit is None or end is not None else limit
        if (response.content_length or 0) > most:
            raise span.too_long(str(response.content_length))
        async for piece in response.content.iter_any():
            part = piece[skip:] if left is None else piece[skip : skip + left]
            skip -= min(skip, len(piece))
            start += len(part)
            if start > most:
                raise span.too_long(f"more than {limit}")
            take(part, len(piece) - len(part))
            if left is not None and (left := left - len(part)) == 0:
                break
        if left:
            raise Passing(f"ends at byte {start} of {end}")
        return (response.history or (response,))[0].headers


def _require(span: Span, response: Any) -> None:
    """Raise ``Passing`` or ``RemoteError`` unless the answer holds the bytes of the span."""
    status, address, sent = response.status, span.address, response.headers.get("Content-Range", "")
    if status in BUSY:
        requested = response.headers.get("Retry-After", "")
        raise Passing(f"the server is busy ({status})", float(requested) if requested.isdecimal() else 0.0)
    if status in GONE:
        raise MissingError(f"{address}: not found ({status}): check the name, and the token if it is private")
    if status in REFUSED:
        raise RefusedError(f"{address}: refused ({status}): ask for access, then run hf auth login or set HF_TOKEN")
    if status == 416:
        raise RemoteError(f"{address}: shorter than in its manifest: tell its publisher, or pin another revision")
    if status not in (200, 206) or (status == 206 and not sent.startswith(f"bytes {span.start}-")):
        raise RemoteError(f"{address}: answered with status {status} {shown(sent[:50])}: check the address")
    if status == 200 and span.start and span.limit is not None and span.end is not None:
        raise RemoteError(f"{address}: this server sends whole files only, not single garments: use gcd download")


@cache
def _web(process: int) -> Any:
    """The HTTP file system of a process: a forked child must not use its parent's connections."""
    import aiohttp
    import fsspec

    timeout = aiohttp.ClientTimeout(total=None, sock_connect=ANSWER, sock_read=ANSWER)
    return fsspec.filesystem("http", client_kwargs={"timeout": timeout}, skip_instance_cache=True)


def _proxy(address: str) -> str | None:
    """The proxy that the environment names. Not by aiohttp, which would also send passwords of ``.netrc``."""
    parts = urlsplit(address)
    return None if proxy_bypass(parts.hostname or "") else getproxies().get(parts.scheme)


def _from_store(span: Span, take: Take) -> Headers:
    """One attempt at an object store. Raises ``Passing`` for an error that may pass."""
    address, start, end, limit = span
    with _asking(address):
        store = _store(os.getpid(), span.root)
        path = store._strip_protocol(address)
        if end is None and limit is not None:
            content = store.cat_file(path, start=0, end=limit + 1)
            if len(content) > limit:
                raise span.too_long(f"more than {limit}")
            take(content)
        pieces = [] if end is None else [(begin, min(begin + PIECE, end)) for begin in range(start, end, PIECE)]
        for begin, stop in pieces:
            content = store.cat_file(path, start=begin, end=stop)
            if len(content) != stop - begin:
                raise RemoteError(f"{address}: shorter than in its manifest: tell its publisher")
            take(content)
    return {}


@contextlib.contextmanager
def _asking(address: str) -> Iterator[None]:
    """Turn errors of ``fsspec`` and of a store's library into ``Passing`` or errors of this package."""
    try:
        yield
    except (GcdError, Passing):
        raise
    except ImportError as error:
        extra = "S3 needs the package s3fs: pip install 'gcd-dataset[s3]'" if address.startswith(S3) else error
        raise ConfigError(f"{address}: a package is missing: {extra}") from error
    except FileNotFoundError as error:
        raise MissingError(f"{address}: not found ({first_line(error)}): check bucket and name") from error
    # Each store raises errors of its own library, which may not be installed.
    except Exception as error:
        kinds, message = " ".join(kind.__name__ for kind in type(error).__mro__), first_line(error)
        if NO_CREDENTIALS.search(kinds) or isinstance(error, PermissionError):
            raise RefusedError(
                f"{address}: refused, or no credentials ({message}): ask for the rights to read and list there, and "
                "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the variables of your store; for a public bucket "
                """FSSPEC_S3='{"anon": true}'"""
            ) from error
        if isinstance(error, INVALID) or "Validation" in kinds or getattr(error, "errno", None) in PERMANENT:
            raise RemoteError(f"{address}: the store rejects the request ({message}): check the address") from error
        raise Passing(f"no answer ({message})") from error


@cache
def _store(process: int, root: str) -> Any:
    """The file system of a bucket or host, one per process: a forked child must not use its parent's connections."""
    from fsspec.config import conf
    from fsspec.core import url_to_fs

    if not root.startswith(S3):
        return url_to_fs(root, skip_instance_cache=True)[0]
    # No retries in s3fs and botocore: this module retries.
    config = {"retries": {"total_max_attempts": 1}, "connect_timeout": ANSWER, "read_timeout": ANSWER}
    config |= dict(conf.get("s3", {}).get("config_kwargs", {}))
    store = url_to_fs(root, skip_instance_cache=True, config_kwargs=config)[0]
    store.retries = 1
    return store


def fetch(
    files: Files,
    name: str,
    target: Path,
    size: int,
    sha256: str,
    *,
    part: Path | None = None,
    on_progress: Callable[[int], None] = lambda size: None,
) -> None:
    """Fetch a file of known size and hash as ``target``, unless it exists: one process does, others wait for it.

    ``part``: the file for the bytes received so far, by default beside ``target``. Raises ``RemoteError`` after two
    wrong hashes and keeps nothing; ``OutputError`` where the file cannot be written.
    """
    part = part or target.with_name(f".{target.name}.part")
    make_folder(part.parent)
    while not target.exists():
        with _claimed(part, files), writing(part):
            if target.exists():
                part.unlink()  # made by this call, after another process had finished
            else:
                files.complete(name, part, size, sha256, on_progress)
                make_folder(target.parent)
                part.replace(target)


@contextlib.contextmanager
def _claimed(part: Path, files: Files) -> Iterator[None]:
    """Hold the lock of ``part``, made if missing."""
    file = None
    while file is None:
        with writing(part):
            file = lock_file(part, wait=False)
        if file is None:
            files.require_wanted(str(part))  # so that Ctrl-C ends the wait
            time.sleep(LOOK)
    try:
        yield
    finally:
        unlock(file)


def first_line(error: object) -> str:
    """The first line of an error's message, at most 200 characters; its type where the message is empty."""
    return shown(str(error).strip().partition("\n")[0][:200]) or type(error).__name__
