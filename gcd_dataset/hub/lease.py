"""One writer at a time below a URL, as far as its store can tell writers apart."""

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
def leased(files: Objects, own: Path) -> Iterator[None]:
    """Hold the object ``.writing.json`` while the block runs; ``own`` keeps its content over a kill.

    Raises ``OutputError`` where another run holds it. On S3 one of any number of writers gets it; of a store without
    conditional writes two that begin at the same instant may, unless the second is seen when it is read again.
    """
    if not own.exists():
        lease = {"run": secrets.token_hex(16), "host": socket.gethostname(), "process": os.getpid()}
        write_whole(own, json.dumps(lease).encode())
    with reading(own):
        content = own.read_bytes()
    files.put_new(LEASE, content)  # ours may be there: of a run that was killed, or of an answer that was lost
    require_free(files, own)
    try:
        yield
    finally:
        _release(files, own)


def require_free(files: Objects, own: Path) -> None:
    """Raise ``OutputError`` where another run holds the lease than the one that ``own`` tells of."""
    try:
        content = files.get(LEASE, LARGEST_JSON)
    except MissingError:
        return
    with reading(own):
        if own.exists() and own.read_bytes() == content:
            return
    raise OutputError(
        f"{files.base}: another run{_told(content)} writes there: wait for it; if it was killed, and cannot go on, "
        f"remove {files.address(LEASE)} and start again"
    )


def _told(content: bytes) -> str:
    """Who holds a lease, if that can be read."""
    with contextlib.suppress(ShardError, ValueError, KeyError, TypeError):
        lease: Any = decode_json(content)
        return f" (process {lease['process']} on {lease['host']})"[:200]
    return ""


def _release(files: Objects, own: Path) -> None:
    """Let others write. Where the store cannot be asked, only the run that ``own`` tells of goes on."""
    try:
        Objects(files.base, patient=False).remove(LEASE)
    except RemoteError as error:
        log.warning("%s; until it is removed, only this machine goes on", error)
        return
    with writing(own):
        own.unlink(missing_ok=True)
