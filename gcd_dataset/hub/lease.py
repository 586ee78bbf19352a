"""A lease in an object store: one writer at a time below a URL, where the store has conditional writes."""

import contextlib
import json
import logging
import os
import secrets
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gcd_dataset.errors import MissingError, OutputError, RemoteError, ShardError
from gcd_dataset.files import write_whole
from gcd_dataset.hub.objects import Objects
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.limits import LARGEST_JSON
from gcd_dataset.shards.meta import decode_json

__all__ = ["leased", "require_free"]

LEASE = ".writing.json"

log = logging.getLogger(__name__)


@contextlib.contextmanager
def leased(files: Objects, local: Path) -> Iterator[None]:
    """Hold the lease, the object ``.writing.json``, while the block runs.

    ``local``: file with a copy of the lease, which identifies this run after a kill. Raises ``OutputError`` where
    another run holds the lease. On S3 exactly one writer gets it. In a store without conditional writes two writers
    that start at the same instant may both get it, unless the check after the write finds the other lease.
    """
    if not local.exists():
        lease = {"run": secrets.token_hex(16), "host": socket.gethostname(), "process": os.getpid()}
        write_whole(local, json.dumps(lease).encode())
    with reading(local):
        content = local.read_bytes()
    files.put_new(
        LEASE, content
    )  # also false if the lease is ours: left by a killed run, or stored although the reply was lost
    require_free(files, local)
    try:
        yield
    finally:
        _release(files, local)


def require_free(files: Objects, local: Path) -> None:
    """Raise ``OutputError`` where another run holds the lease; ``local``: local copy of this run's lease."""
    try:
        content = files.get(LEASE, LARGEST_JSON)
    except MissingError:
        return
    with reading(local):
        if local.exists() and local.read_bytes() == content:
            return
    raise OutputError(
        f"{files.base}: another run{_describe(content)} is writing there: wait for it; if it was killed and cannot "
        f"continue, remove {files.address(LEASE)} and start again"
    )


def _describe(content: bytes) -> str:
    """Process and host of a lease, if readable."""
    with contextlib.suppress(ShardError, ValueError, KeyError, TypeError):
        lease: Any = decode_json(content)
        return f" (process {lease['process']} on {lease['host']})"[:200]
    return ""


def _release(files: Objects, local: Path) -> None:
    """Remove the lease. If the store does not answer, keep ``local``: this machine can still continue."""
    try:
        Objects(files.base, retry_unreachable=False).remove(LEASE)
    except RemoteError as error:
        log.warning("%s; until the lease is removed, only this machine can continue", error)
        return
    with writing(local):
        local.unlink(missing_ok=True)
