"""Reads and writes objects below one prefix of an object store through ``fsspec``: S3, Google Cloud Storage, Azure, ….

Credentials, endpoints and proxies come from the environment and the store's own library: ``AWS_ACCESS_KEY_ID``,
``AWS_ENDPOINT_URL``, ``FSSPEC_S3='{"anon": true}'`` and so on.
"""

import contextlib
import errno
import functools
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gcd_dataset.errors import ConfigError, MissingError, RefusedError, RemoteError
from gcd_dataset.hub.retry import Backoff, RetryableError, first_line

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

__all__ = ["Objects", "is_store"]

T = TypeVar("T")

S3 = ("s3://", "s3a://")
PIECE = 1 << 24  # bytes of one request of a stream
TIMEOUT = 30  # s without a byte
NO_CREDENTIALS = re.compile("Credential|NoAuth")
"""Matches the class names of errors about missing credentials in botocore, google.auth and azure.identity."""
INVALID = (ValueError, TypeError, NotImplementedError, FileExistsError, NotADirectoryError, IsADirectoryError)
"""Errors of ``fsspec`` back ends for an invalid request; not retried."""
PERMANENT = frozenset({errno.EINVAL, errno.ENOSYS, errno.EPERM, errno.ENAMETOOLONG, errno.EREMCHG, errno.EMSGSIZE})
"""``errno`` of errors that are not retried: s3fs sets them for HTTP status 301, 400, 405, 416 and 501."""


def is_store(protocol: str) -> bool:
    """Whether ``fsspec`` knows the protocol; its package may be missing."""
    import fsspec

    return protocol in fsspec.available_protocols()


class Objects:
    """The objects below one URL; writes are atomic. May be pickled, forked, and used by several threads.

    ``patience``: seconds of waiting before a request is given up. ``retry_unreachable=False``: no second attempt if the
    store does not answer. ``sleep``: function that waits a number of seconds; it returns true to give up.

    Methods raise ``MissingError`` for a missing object, ``RefusedError`` where the credentials lack the right,
    ``RemoteError`` for any other failure, ``ConfigError`` where the store's package is not installed.
    """

    def __init__(
        self,
        base: str,
        *,
        patience: float | None = None,
        retry_unreachable: bool = True,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        self.base, self.patience = base.rstrip("/"), patience
        self._retry_unreachable, self._sleep = retry_unreachable, sleep
        self.etags: dict[str, str] = {}
        """Always empty: the ETags of object stores are not hashes of the content."""

    def address(self, path: str) -> str:
        """The URL of an object."""
        return f"{self.base}/{path}" if path else self.base

    # --------------------------------------------------------------------------------------------------------- reading

    def size(self, path: str) -> int:
        """Size of an object [bytes]."""
        return self._retry(path, lambda store, name: int(_info(store, name)["size"]))

    def get(self, path: str, limit: int) -> bytes:
        """A whole object. Raises ``RemoteError`` for more than ``limit`` bytes, before any is read."""
        size = self.size(path)
        if size > limit:
            raise RemoteError(
                f"{self.address(path)}: has {size} bytes, over the limit of {limit} for this kind of file: check the "
                "address, or tell its publisher"
            )
        return self._range(path, 0, size)

    def read(self, path: str, start: int, end: int) -> memoryview:
        """Bytes ``start`` to ``end`` of an object, in a new writable buffer."""
        return memoryview(bytearray(self._range(path, start, end)))

    def _range(self, path: str, start: int, end: int) -> bytes:
        if start >= end:
            return b""
        content: bytes = self._retry(path, lambda store, name: store.cat_file(name, start=start, end=end))
        if len(content) != end - start:
            raise RemoteError(
                f"{self.address(path)}: {len(content)} of {end - start} bytes received from byte {start} on: the "
                "object is shorter than in its index: tell its publisher"
            )
        return content

    def pieces(self, path: str, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """The bytes from ``start`` to ``end``, by default the end of the object, in pieces."""
        end = self.size(path) if end is None else end
        for offset in range(start, end, PIECE):
            yield self._range(path, offset, min(offset + PIECE, end))

    # --------------------------------------------------------------------------------------------------------- writing

    def put(self, path: str, content: bytes) -> None:
        """Store an object, replacing an existing one."""
        self._retry(path, lambda store, name: store.pipe_file(name, content))

    def put_new(self, path: str, content: bytes) -> bool:
        """Store an object unless it exists; whether it was stored.

        On S3 exactly one of several writers succeeds; in a store without conditional writes two may.
        """

        def created(store: "AbstractFileSystem", name: str) -> bool:
            try:
                store.pipe_file(name, content, mode="create")
            except FileExistsError:
                return False
            return True

        return self._retry(path, created)

    def put_file(self, path: str, file: Path) -> None:
        """Store a file as an object. Raises ``RemoteError`` also where the stored size differs."""
        with file.open("rb") as opened:
            size = os.fstat(opened.fileno()).st_size
        self._retry(path, lambda store, name: store.put_file(str(file), name))
        if (stored := self.size(path)) != size:
            raise RemoteError(f"{self.address(path)}: holds {stored} of {size} bytes after its upload: start again")

    def remove(self, path: str) -> None:
        """Remove an object, or all objects below a path that ends in a slash. Missing ones are ignored."""

        def removed(store: "AbstractFileSystem", name: str) -> None:
            if path.endswith("/"):
                store.invalidate_cache()
                store.rm(name, recursive=True)
            else:
                store.rm_file(name)

        with contextlib.suppress(MissingError):
            self._retry(path, removed)

    def _retry(self, path: str, request: "Callable[[AbstractFileSystem, str], T]") -> T:
        """The result of ``request(store, name)``, retried after errors that may pass."""
        backoff = Backoff(self.patience)
        while True:
            try:
                store = _store(os.getpid(), "/".join(self.base.split("/")[:3]))
                return request(store, store._strip_protocol(self.address(path.rstrip("/"))))
            # Each store raises errors of its own library, which may not be installed.
            except Exception as error:  # noqa: BLE001
                retryable = self._retryable(path, error)
            backoff.wait(self.address(path), retryable, retry_unreachable=self._retry_unreachable, sleep=self._sleep)

    def _retryable(self, path: str, error: Exception) -> RetryableError:
        """The error as a retryable one. Raises permanent errors as ``RemoteError`` or ``ConfigError``."""
        address, message = self.address(path), first_line(error)
        kinds = " ".join(kind.__name__ for kind in type(error).__mro__)
        if isinstance(error, ImportError):
            raise ConfigError(f"{address}: {_missing_package(self.base, message)}") from error
        if isinstance(error, FileNotFoundError):
            raise MissingError(f"{address}: not found ({message}): check bucket and name") from error
        if NO_CREDENTIALS.search(kinds):
            raise RefusedError(
                f"{address}: no credentials ({message}): set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the "
                """variables of your store; for a public bucket FSSPEC_S3='{"anon": true}'"""
            ) from error
        if isinstance(error, PermissionError):
            raise RefusedError(
                f"{address}: refused ({message}): ask for the rights to read, write and list there, or set other "
                "credentials"
            ) from error
        if isinstance(error, INVALID) or "Validation" in kinds or getattr(error, "errno", None) in PERMANENT:
            raise RemoteError(f"{address}: the store rejects the request ({message}): check the address") from error
        return RetryableError(f"no answer ({message})", is_unreachable=True)


def _info(store: "AbstractFileSystem", name: str) -> Any:
    """The store's current information on an object. Raises ``FileNotFoundError`` for a prefix."""
    store.invalidate_cache()
    info = store.info(name)
    if info["type"] != "file":
        raise FileNotFoundError(f"a {info['type']}, not an object")
    return info


def _missing_package(url: str, message: str) -> str:
    """Message and remedy for a missing package of a store."""
    if url.startswith(S3):
        return "S3 needs the package s3fs: pip install 'gcd-dataset[s3]'"
    return f"a package is missing: {message}"


@functools.cache
def _store(process: int, root: str) -> "AbstractFileSystem":
    """The file system of a bucket or host, one per process: a forked child must not use its parent's connections."""
    from fsspec.config import conf
    from fsspec.core import url_to_fs

    options: dict[str, Any] = {}
    if root.startswith(S3):
        # No retries in s3fs and botocore: this module retries.
        config = {"retries": {"total_max_attempts": 1}, "connect_timeout": TIMEOUT, "read_timeout": TIMEOUT}
        options["config_kwargs"] = config | dict(conf.get("s3", {}).get("config_kwargs", {}))
    store = url_to_fs(root, skip_instance_cache=True, **options)[0]
    if root.startswith(S3):
        store.retries = 1
    return store
