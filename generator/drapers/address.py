"""The address of a draping process, and the transport of its requests and replies.

Arrays travel in shared memory files: through the socket, the draping process would need ten milliseconds to read and
unpack a request of five megabytes, and would launch no kernels meanwhile.

The process that creates an address owns it. It holds a record lock in the folder: a fork does not inherit such a lock,
and any end of the process releases it. So the draping process ends with the owner, not with the worker that started it.
"""

import atexit
import contextlib
import fcntl
import mmap
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from multiprocessing.connection import Client, Connection
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from typing import IO, Any, Self

from gcd_dataset.errors import ConfigError, DrapeError
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest

ALIGNMENT = 64  # bytes


def send_object(connection: Connection, content: object) -> None:
    """Send an object; its arrays are copied once. Raises ``OSError`` if the receiver has gone."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(content, protocol=5, buffer_callback=buffers.append)
    arrays = [buffer.raw() for buffer in buffers]
    offsets = _offsets([array.nbytes for array in arrays])
    with _memory_file() as file:
        os.truncate(file.fileno(), offsets[-1])
        for array, offset in zip(arrays, offsets, strict=False):
            file.seek(offset)
            file.write(array)
        file.flush()
        connection.send((head, [array.nbytes for array in arrays]))
        send_handle(connection, file.fileno(), None)


def receive_object(connection: Connection) -> Any:
    """Wait for the next object. Raises ``EOFError`` or ``OSError`` if the sender has gone."""
    head, sizes = connection.recv()
    offsets = _offsets(sizes)
    try:
        file = recv_handle(connection)
    except RuntimeError as error:  # the sender ended between the two messages
        raise EOFError from error
    try:
        memory = memoryview(mmap.mmap(file, offsets[-1], mmap.MAP_PRIVATE))
    finally:
        os.close(file)
    # Unpickling is safe as in ``Connection.recv``: only this user can reach the socket's folder.
    return pickle.loads(
        head, buffers=[memory[offset : offset + size] for offset, size in zip(offsets, sizes, strict=False)]
    )


def _offsets(sizes: list[int]) -> list[int]:
    """Aligned offset of each array, then the total size [bytes]."""
    return [0, *accumulate(-(-max(size, 1) // ALIGNMENT) * ALIGNMENT for size in sizes)] if sizes else [0, ALIGNMENT]


def _memory_file() -> IO[bytes]:
    """An unnamed file, in memory on systems with ``memfd_create``."""
    if hasattr(os, "memfd_create"):
        return open(os.memfd_create("gcd-request"), "wb")  # noqa: PTH123 - it has no path
    return tempfile.TemporaryFile()


READY = "ready"
DRAPERS_PER_GPU = 2  # processes: one prepares its next batch, or renders pictures, while the other simulates
MAX_SOCKET_PATH = 90  # characters: systems allow 104 to 108

_addresses: dict[tuple[str, int], "DraperAddress"] = {}
_owner_locks: list[int] = []
"""File descriptors of the owner's locks, open until the process ends."""
_processes: list[subprocess.Popen[str]] = []
"""Draping processes that this process has started."""


@dataclass(frozen=True)
class DraperAddress:
    """The address of a draping process; may be pickled and used in any process of this machine."""

    folder: Path
    device: str
    detached: bool = False
    """Whether the process is no child of the one that starts it: Ray kills the children of a worker that ends."""

    def connect(self) -> Connection:
        """A connection to the draping process; starts it if it does not run.

        Raises ``DrapeError``, with the reason that the process prints, if it cannot be started.
        """
        with self._start_lock() as lock:
            connection = self._try_connect()
            if connection is None:
                self._start(lock)
                connection = self._try_connect()
        if connection is None:
            raise DrapeError(f"the process that drapes on {self.device} has ended right after its start: see above")
        return connection

    def _try_connect(self) -> Connection | None:
        """A connection after its ``READY`` message; ``None`` if there is no process.

        A process that is about to end may still accept the connection, but sends no ``READY``.
        """
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
    def _start_lock(self) -> Iterator[int]:
        """Hold the lock that prevents a second start; yields its file descriptor."""
        try:
            file = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o600)
        except FileNotFoundError as error:
            raise DrapeError(
                f"{self.folder}: removed at the end of the process that created its GeneratedGarments: create a new one"
            ) from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield file
        finally:
            os.close(file)

    def _start(self, lock: int) -> None:
        """Start the process and wait until it listens. It inherits the lock, in case this process is killed."""
        # Not by ``multiprocessing``: a spawned child would import the user's main module, and daemonic workers may have
        # no children.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}  # noqa: PTH109
        command = [sys.executable, "-P", "-m", "gcd_dataset.generator.drapers.process", str(self.folder), self.device]
        command += ["--detached"] if self.detached else []
        process = subprocess.Popen(
            command, env=environment, stdin=lock, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        _processes.append(process)
        assert process.stdout is not None
        with process.stdout as output:
            line = output.readline().strip()
        if line != READY:
            raise DrapeError(line or f"the process that drapes on {self.device} could not be started: see above")


def address_for(device: str, number: int = 0) -> DraperAddress:
    """The address of a draping process, one for this process and its forks; starts nothing.

    ``number``: index among several draping processes on the device.
    """
    key = device, number
    if key not in _addresses or not _addresses[key].folder.is_dir():  # removed by its owner, a parent process
        _addresses[key] = _create(device)
    return _addresses[key]


def addresses_for(devices: Sequence[str]) -> tuple[DraperAddress | None, ...]:
    """The addresses among which workers are distributed: two for each GPU; ``None`` if workers drape by themselves.

    >>> addresses_for(["cpu"])
    (None,)
    """
    gpus = [device for device in devices if device != "cpu"]
    return tuple(address_for(device, number) for number in range(DRAPERS_PER_GPU) for device in gpus) or (None,)


def socket_file(folder: Path) -> Path:
    """The socket on which the draping process listens."""
    return folder / "socket"


def owner_file(folder: Path) -> Path:
    """The file that the owner keeps locked."""
    return folder / "owner"


def _create(device: str) -> DraperAddress:
    folder = Path(tempfile.mkdtemp(prefix="gcd-draper-"))
    if len(str(socket_file(folder))) > MAX_SOCKET_PATH:
        folder.rmdir()
        raise ConfigError(f"{folder}: too long for a socket's path: set TMPDIR to a shorter folder, such as /tmp")
    file = os.open(owner_file(folder), os.O_RDWR | os.O_CREAT, 0o600)
    fcntl.lockf(file, fcntl.LOCK_EX)
    _owner_locks.append(file)
    atexit.register(_remove, folder, os.getpid())
    return DraperAddress(folder, device)


def _remove(folder: Path, owner: int) -> None:
    if os.getpid() != owner:
        return
    while _processes:  # processes that workers have started end when this process releases its lock
        process = _processes.pop()
        process.kill()
        process.wait()
    shutil.rmtree(folder, ignore_errors=True)


AT_ONCE = 24  # requests of each client: eleven clients fill both batches of a GPU, 2 x 128


class SharedDraper:
    """A connection to the draping process at an address, for one thread; starts the process if there is none.

    Raises ``DrapeError`` if the process cannot be started; the methods raise it if the process fails or has ended.
    """

    def __init__(self, address: DraperAddress, *, at_once: int = AT_ONCE) -> None:
        self._address = address
        self.at_once = at_once
        self._connection: Connection = address.connect()

    def send(self, request: DrapeRequest) -> None:
        from gcd_dataset.generator.drape.batches import PreparedJob
        from gcd_dataset.generator.drape.moving import Motion

        request.job.require_drapeable()
        if request.prepared is None:
            with contextlib.suppress(Exception):  # raised again in the drape
                request = replace(request, prepared=PreparedJob.of(request.job))
                if request.motion:
                    request = replace(request, way=Motion.through(request.job.body, request.motion))
        try:
            send_object(self._connection, request)
        except OSError as error:
            raise self._closed() from error

    def poll(self) -> bool:
        try:
            return self._connection.poll()
        except OSError as error:
            raise self._closed() from error

    def receive(self) -> DrapeReply:
        try:
            reply = self._connection.recv()
        except (EOFError, OSError) as error:
            raise self._closed() from error
        if isinstance(reply, str):
            raise self._failed(reply)
        return reply

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def _closed(self) -> DrapeError:
        """The error that the draping process sent last; if it sent none, an error that says that it has ended."""
        with contextlib.suppress(EOFError, OSError):
            while self._connection.poll():
                if isinstance(last := self._connection.recv(), str):
                    return self._failed(last)
        return DrapeError(
            f"the process that drapes on {self._address.device} has ended, perhaps killed for lack of memory: start "
            "again, with other programs off that device"
        )

    def _failed(self, reason: str) -> DrapeError:
        return DrapeError(f"while draping on {self._address.device}: {reason}")
