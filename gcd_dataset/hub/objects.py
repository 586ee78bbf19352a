"""Objects below one prefix of a store that ``fsspec`` opens: S3, Google Cloud Storage, Azure and others.

Credentials, addresses and proxies are those of the environment and of the store's own library, as for any program:
``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, ``FSSPEC_S3='{"anon": true}'`` and their like.
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
PIECE = 1 << 24  # bytes of a stream that are asked for at a time
TIMEOUT = 30  # s without a byte
NO_CREDENTIALS = re.compile("Credential|NoAuth")
"""Names of the errors by which libraries tell that they have none: botocore, google.auth, azure.identity."""
WRONG = (ValueError, TypeError, NotImplementedError, FileExistsError, NotADirectoryError, IsADirectoryError)
NEVER = frozenset({errno.EINVAL, errno.ENOSYS, errno.EPERM, errno.ENAMETOOLONG, errno.EREMCHG, errno.EMSGSIZE})
"""What a store refuses of which another attempt makes nothing better: 400, 301, 405, 416, 501."""


def is_store(protocol: str) -> bool:
    """Whether ``fsspec`` knows stores of that name, though their package may be missing."""
    import fsspec

    return protocol in fsspec.available_protocols()


class Objects:
    """The objects below one URL, read and written whole or not at all. May be pickled, forked, and used by threads.

    ``patience``: seconds of waits after which an attempt is given up, counted anew from each that has brought
    something. Not ``patient``: there is no second attempt. ``sleep`` waits, and gives true to end all waiting.

    Its methods raise ``MissingError`` for what is not there, ``RefusedError`` for what these credentials may not do,
    ``RemoteError`` for any other trouble, ``ConfigError`` where the store's package is not installed.
    """

    def __init__(
        self,
        base: str,
        *,
        patience: float | None = None,
        patient: bool = True,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        self.base, self.patience = base.rstrip("/"), patience
        self._patient, self._sleep = patient, sleep
        self.etags: dict[str, str] = {}
        """Of each object, where the store tells a hash; none does that this package could check."""

    def address(self, path: str) -> str:
        """The URL of an object."""
        return f"{self.base}/{path}" if path else self.base

    # --------------------------------------------------------------------------------------------------------- reading

    def size(self, path: str) -> int:
        """Bytes of an object."""
        return self._patiently(path, lambda store, name: int(_info(store, name)["size"]))

    def get(self, path: str, most: int) -> bytes:
        """A whole object of ``most`` bytes at most. Raises ``RemoteError`` for a longer one before it is read."""
        size = self.size(path)
        if size > most:
            raise RemoteError(
                f"{self.address(path)}: has {size} bytes, and up to {most} are read of a file of this kind: check the "
                "address, or tell its publisher"
            )
        return self._range(path, 0, size)

    def read(self, path: str, start: int, end: int) -> memoryview:
        """Bytes ``start`` to ``end`` of an object, writable and the caller's own."""
        return memoryview(bytearray(self._range(path, start, end)))

    def _range(self, path: str, start: int, end: int) -> bytes:
        if start >= end:
            return b""
        content: bytes = self._patiently(path, lambda store, name: store.cat_file(name, start=start, end=end))
        if len(content) != end - start:
            raise RemoteError(
                f"{self.address(path)}: {len(content)} bytes come from byte {start}, where {end - start} were asked "
                "for: shorter than its index tells: tell its publisher"
            )
        return content

    def pieces(self, path: str, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """The bytes from ``start`` to ``end``, or to the end of the object, as they come."""
        end = self.size(path) if end is None else end
        for place in range(start, end, PIECE):
            yield self._range(path, place, min(place + PIECE, end))

    # --------------------------------------------------------------------------------------------------------- writing

    def put(self, path: str, content: bytes) -> None:
        """Store an object, in the place of the one that is there."""
        self._patiently(path, lambda store, name: store.pipe_file(name, content))

    def put_new(self, path: str, content: bytes) -> bool:
        """Store an object unless one is there; whether there was none.

        On S3 one of several writers succeeds; of a store without conditional writes two at the same instant may.
        """

        def created(store: "AbstractFileSystem", name: str) -> bool:
            try:
                store.pipe_file(name, content, mode="create")
            except FileExistsError:
                return False
            return True

        return self._patiently(path, created)

    def put_file(self, path: str, file: Path) -> None:
        """Store a file as an object. Raises ``RemoteError`` too where fewer bytes have arrived than there are."""
        with file.open("rb") as opened:
            size = os.fstat(opened.fileno()).st_size
        self._patiently(path, lambda store, name: store.put_file(str(file), name))
        if (there := self.size(path)) != size:
            raise RemoteError(f"{self.address(path)}: holds {there} of {size} bytes after its upload: start again")

    def remove(self, path: str) -> None:
        """Remove an object, or all below a name that ends in a slash; nothing where there is none."""

        def removed(store: "AbstractFileSystem", name: str) -> None:
            if path.endswith("/"):
                store.invalidate_cache()
                store.rm(name, recursive=True)
            else:
                store.rm_file(name)

        with contextlib.suppress(MissingError):
            self._patiently(path, removed)

    def _patiently(self, path: str, ask: "Callable[[AbstractFileSystem, str], T]") -> T:
        """What ``ask`` gets from the store for an object, tried again where that may help."""
        outage = Backoff(self.patience)
        while True:
            try:
                store = _store(os.getpid(), "/".join(self.base.split("/")[:3]))
                return ask(store, store._strip_protocol(self.address(path.rstrip("/"))))
            # Each store raises the errors of a library of its own, which is not even installed everywhere.
            except Exception as error:  # noqa: BLE001
                trouble = self._trouble(path, error)
            outage.rest(self.address(path), trouble, patient=self._patient, sleep=self._sleep)

    def _trouble(self, path: str, error: Exception) -> RetryableError:
        """What may pass of an error. Raises what will not."""
        own, told = self.address(path), first_line(error)
        kinds = " ".join(kind.__name__ for kind in type(error).__mro__)
        if isinstance(error, ImportError):
            raise ConfigError(f"{own}: {_package(self.base, told)}") from error
        if isinstance(error, FileNotFoundError):
            raise MissingError(f"{own}: not there ({told}): check bucket and name") from error
        if NO_CREDENTIALS.search(kinds):
            raise RefusedError(
                f"{own}: no credentials ({told}): set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or what else this "
                """store takes; for a public bucket FSSPEC_S3='{"anon": true}'"""
            ) from error
        if isinstance(error, PermissionError):
            raise RefusedError(
                f"{own}: refused ({told}): ask for the rights to read, write and list there, or set other credentials"
            ) from error
        if isinstance(error, WRONG) or "Validation" in kinds or getattr(error, "errno", None) in NEVER:
            raise RemoteError(f"{own}: the store does not take this ({told}): check the address") from error
        return RetryableError(f"no answer ({told})", is_unreachable=True)


def _info(store: "AbstractFileSystem", name: str) -> Any:
    """What the store tells of an object now. Raises ``FileNotFoundError`` for a prefix of others."""
    store.invalidate_cache()
    info = store.info(name)
    if info["type"] != "file":
        raise FileNotFoundError(f"no object, but a {info['type']}")
    return info


def _package(url: str, told: str) -> str:
    """What to install for the store of a URL."""
    if url.startswith(S3):
        return "S3 takes the package s3fs: pip install 'gcd-dataset[s3]'"
    return f"a package is missing: {told}"


@functools.cache
def _store(process: int, root: str) -> "AbstractFileSystem":
    """A process's way to a bucket, or a host: a forked process must not send on its parent's lines."""
    from fsspec.config import conf
    from fsspec.core import url_to_fs

    options: dict[str, Any] = {}
    if root.startswith(S3):
        # One attempt, by s3fs and by the library below it, since it is this module that has patience.
        ours = {"retries": {"total_max_attempts": 1}, "connect_timeout": TIMEOUT, "read_timeout": TIMEOUT}
        options["config_kwargs"] = ours | dict(conf.get("s3", {}).get("config_kwargs", {}))
    store = url_to_fs(root, skip_instance_cache=True, **options)[0]
    if root.startswith(S3):
        store.retries = 1
    return store
