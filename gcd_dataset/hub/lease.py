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
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.limits import LARGEST_JSON
from gcd_dataset.shards.meta import read_json

__all__ = ["leased", "require_free"]

log = logging.getLogger(__name__)


@contextlib.contextmanager
def leased(files: Objects, split: str, own: Path) -> Iterator[None]:
    """Hold the object ``.writing-SPLIT.json`` while the block runs; ``own`` keeps its content over a kill.

    Raises ``OutputError`` where another run holds it. On S3, Google Cloud Storage and Azure one of any number of
    writers gets it; of a store without conditional writes two that begin at the same instant may, and are told apart
    by reading it again.
    """
    name = _name(split)
    if not own.exists():
        lease = {"run": secrets.token_hex(16), "host": socket.gethostname(), "process": os.getpid()}
        write_whole(own, json.dumps(lease).encode())
    with reading(own):
        content = own.read_bytes()
    files.put_new(name, content)  # ours may be there: of a run that was killed, or of an answer that was lost
    require_free(files, split, own)
    try:
        yield
    finally:
        _release(files, name, own)


def require_free(files: Objects, split: str, own: Path) -> None:
    """Raise ``OutputError`` where another run holds the lease than the one that ``own`` tells of."""
    try:
        content = files.get(_name(split), LARGEST_JSON)
    except MissingError:
        return
    with reading(own):
        if own.exists() and own.read_bytes() == content:
            return
    raise OutputError(
        f"{files.base}: another run{_told(content)} writes split {split}: wait for it; if it was killed, and cannot go "
        f"on there, remove {files.address(_name(split))} and start again"
    )


def _name(split: str) -> str:
    return f".writing-{require_name(split, 'split')}.json"


def _told(content: bytes) -> str:
    """Who holds a lease, if that can be read."""
    with contextlib.suppress(ShardError, ValueError, KeyError, TypeError):
        lease: Any = read_json(content)
        return f" (process {lease['process']} on {lease['host']})"[:200]
    return ""


def _release(files: Objects, name: str, own: Path) -> None:
    """Let others write. Where the store cannot be asked, only the run that ``own`` tells of goes on."""
    try:
        Objects(files.base, patient=False).remove(name)
    except RemoteError as error:
        log.warning("%s; until it is removed, only this machine goes on", error)
        return
    with writing(own):
        own.unlink(missing_ok=True)
