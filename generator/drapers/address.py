"""Where the draper of a device is met: a folder with a socket, and its start by the first that needs it.

The process that names the place owns it. It holds a record lock there, which no fork inherits and any end of the
process frees, so that the draper ends with it and not with the worker that has started it.
"""

import atexit
import contextlib
import fcntl
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Client, Connection
from pathlib import Path

from gcd_dataset.errors import ConfigError, DrapeError

__all__ = ["DRAPERS", "READY", "DraperAddress", "address_for", "addresses_for", "owner_file", "socket_file"]

READY = "ready"
DRAPERS = 2  # processes on each GPU: one prepares its next batch, or takes pictures, while another simulates
LONGEST = 90  # characters of a socket's path: systems allow 104 to 108

_places: dict[tuple[str, int], "DraperAddress"] = {}
_held: list[int] = []
"""The owner's locks: open until the process ends."""
_started: list[subprocess.Popen[str]] = []


@dataclass(frozen=True)
class DraperAddress:
    """Where the draper of a device is met; may be pickled, and used in any process of this machine."""

    folder: Path
    device: str

    def connect(self) -> Connection:
        """A connection to the draper, which is started where there is none.

        Raises ``DrapeError`` where it cannot be started, with the reason that it gives.
        """
        with self._starting() as lock:
            connection = self._greeted()
            if connection is None:
                self._start(lock)
                connection = self._greeted()
        if connection is None:
            raise DrapeError(f"the process that drapes on {self.device} ended as soon as it had begun: see above")
        return connection

    def _greeted(self) -> Connection | None:
        """A connection to a draper that has greeted; one that is about to end may still be called, and says nothing."""
        try:
            connection = Client(str(socket_file(self.folder)), "AF_UNIX")
        except (FileNotFoundError, ConnectionRefusedError):
            return None
        try:
            connection.recv()
        except (EOFError, OSError):
            connection.close()
            return None
        return connection

    @contextlib.contextmanager
    def _starting(self) -> Iterator[int]:
        """One process at a time, so that no two drapers are started; the lock, as an open file."""
        try:
            file = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o600)
        except FileNotFoundError as error:
            raise DrapeError(
                f"{self.folder}: gone with the process that made these garments: make GeneratedGarments anew"
            ) from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield file
        finally:
            os.close(file)

    def _start(self, lock: int) -> None:
        """Begin a draper and wait until it listens; it holds the lock until then, though this process is killed."""
        # A program of its own, not a child made by ``multiprocessing``: that would run the user's script again, and a
        # worker may have none.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}  # noqa: PTH109
        command = [sys.executable, "-P", "-m", "gcd_dataset.generator.drapers.process", str(self.folder), self.device]
        draper = subprocess.Popen(
            command,
            env=environment,
            stdin=lock,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        _started.append(draper)
        assert draper.stdout is not None
        with draper.stdout as said:
            line = said.readline().strip()
        if line != READY:
            raise DrapeError(line or f"the process that drapes on {self.device} could not be started: see above")


def address_for(device: str, number: int = 0) -> DraperAddress:
    """The place of a draper, the same for all in this process and those forked from it; starts nothing.

    ``number``: which of several on the device.
    """
    key = device, number
    if key not in _places or not _places[key].folder.is_dir():  # left by a process that has ended
        _places[key] = _made(device)
    return _places[key]


def addresses_for(devices: Sequence[str]) -> tuple[DraperAddress | None, ...]:
    """Where workers have their garments draped, by turns: two processes on each GPU; ``None``: in the worker itself.

    >>> addresses_for(["cpu"])
    (None,)
    """
    gpus = [device for device in devices if device != "cpu"]
    return tuple(address_for(device, number) for number in range(DRAPERS) for device in gpus) or (None,)


def socket_file(folder: Path) -> Path:
    """Where the draper listens."""
    return folder / "socket"


def owner_file(folder: Path) -> Path:
    """What the owner holds locked while it lives."""
    return folder / "owner"


def _made(device: str) -> DraperAddress:
    folder = Path(tempfile.mkdtemp(prefix="gcd-draper-"))
    if len(str(socket_file(folder))) > LONGEST:
        folder.rmdir()
        raise ConfigError(f"{folder}: too long for a socket's path: set TMPDIR to a shorter one, such as /tmp")
    file = os.open(owner_file(folder), os.O_RDWR | os.O_CREAT, 0o600)
    fcntl.lockf(file, fcntl.LOCK_EX)
    _held.append(file)
    atexit.register(_remove, folder, os.getpid())
    return DraperAddress(folder, device)


def _remove(folder: Path, owner: int) -> None:
    if os.getpid() != owner:
        return
    while _started:  # those of the owner's workers end by themselves
        draper = _started.pop()
        draper.kill()
        draper.wait()
    shutil.rmtree(folder, ignore_errors=True)
