"""The draping process: drapes the requests of any number of clients on one device.

    python -m gcd_dataset.generator.drapers.process FOLDER DEVICE [--detached]

The garments of all clients share one batch. The process ends when the owner of ``FOLDER`` ends. See the package's
docstring for how requests travel.
"""

import contextlib
import fcntl
import os
import resource
import shutil
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from queue import SimpleQueue

from gcd_dataset.errors import GcdError
from gcd_dataset.generator.drape import DrapeJob, batch_capacity, resolve_device
from gcd_dataset.generator.drape.batches import PreparedJob, drape_unordered
from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drapers.address import DRAPERS_PER_GPU, READY, owner_file, receive_object, socket_file
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest
from gcd_dataset.generator.drapers.pictures import PictureQueue

CONFIG = DrapeConfig()


def main(folder: Path, device: str) -> None:
    """Listen on the socket in ``folder`` and drape until the owner of the folder ends."""
    threading.Thread(target=_end_with_owner, args=(folder,), daemon=True).start()
    _raise_file_limit()
    try:
        device = resolve_device(device)
    except GcdError as error:
        print(error, flush=True)
        return
    requests = RequestQueue()
    socket_file(folder).unlink(missing_ok=True)  # left by a killed process
    listener = Listener(str(socket_file(folder)), "AF_UNIX", backlog=128)
    threading.Thread(target=_accept, args=(listener, requests), daemon=True).start()
    _report_ready()
    try:
        while True:
            requests.drape(device)
    except Exception as error:
        listener.close()  # the next client starts a new process
        reason = " ".join(str(error).split()) or type(error).__name__
        # Errors of other types come from the device, such as a lost GPU.
        requests.fail(
            reason if isinstance(error, GcdError) else f"{reason}; start again, on other devices if the error repeats"
        )
        raise


class ClientConnection:
    """A connection with a reader and a writer thread, so that a client that does not read delays no other."""

    def __init__(self, connection: Connection, requests: "RequestQueue") -> None:
        self._connection, self._requests = connection, requests
        self._replies: SimpleQueue[DrapeReply | str | None] = SimpleQueue()
        self.connected = True
        """Whether the client still waits for replies."""
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._writer.start()
        threading.Thread(target=self._read, daemon=True).start()

    def reply(self, reply: DrapeReply | str) -> None:
        """Have the writer send a reply, or the error that ended the draping."""
        self._replies.put(reply)

    def finish(self) -> None:
        """Wait until all replies are sent, at most five seconds."""
        self._replies.put(None)
        self._writer.join(timeout=5.0)  # a stopped client reads nothing

    def _read(self) -> None:
        try:
            # A worker killed while it sends leaves half a request, which raises too.
            with contextlib.suppress(EOFError, OSError):
                while True:
                    self._requests.put(self, receive_object(self._connection))
        finally:
            self.connected = False
            self._replies.put(None)
            self._writer.join()
            # Close in the reader thread: the OS reuses the descriptor.
            self._connection.close()

    def _write(self) -> None:
        with contextlib.suppress(OSError):
            while (reply := self._replies.get()) is not None:
                self._connection.send(reply)
                del reply  # the next renderings use the memory of its pictures
        self.connected = False


class RequestQueue:
    """Waiting requests, and the requests of the garments in the batch."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[ClientConnection, DrapeRequest]] = deque()
        self._arrived = threading.Condition()
        self._connections: set[ClientConnection] = set()
        self._draping: dict[int, tuple[ClientConnection, DrapeRequest]] = {}
        """Client and request of each garment in the batch, by the number of its job."""

    def put(self, client: ClientConnection, request: DrapeRequest) -> None:
        """Add a request; a retry goes first."""
        with self._arrived:
            if request.retry:
                self._waiting.appendleft((client, request))
            else:
                self._waiting.append((client, request))
            self._arrived.notify()

    def register(self, connection: ClientConnection) -> None:
        """Add a connection that ``fail`` informs, and drop closed ones."""
        with self._arrived:
            self._connections = {known for known in self._connections if known.connected} | {connection}

    def fail(self, reason: str) -> None:
        """Send the error that ended the draping to all clients."""
        for connection in list(self._connections):
            connection.reply(reason)
        for connection in list(self._connections):
            connection.finish()

    def drape(self, device: str) -> None:
        """Wait for a request, then drape until no request is left."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._waiting))
        pictures = PictureQueue(device)
        drapes = drape_unordered(
            self._jobs(),
            CONFIG,
            device=device,
            at_once=batch_capacity(device, sharers=DRAPERS_PER_GPU),
            arrived=self._waiting.__len__,
            between=pictures.advance,
        )
        for number, drape in drapes:
            client, request = self._draping.pop(number)
            if client.connected:
                pictures.add(request, drape, client.reply)
        pictures.flush()

    def _jobs(self) -> Iterator[DrapeJob | PreparedJob | None]:
        """The jobs of waiting requests, without end; ``None`` whenever no request waits."""
        number = 0
        while True:
            with self._arrived:
                while self._waiting and not self._waiting[0][0].connected:
                    self._waiting.popleft()
                entry = self._waiting.popleft() if self._waiting else None
            if entry is None:
                yield None
            else:
                _, request = self._draping[number] = entry
                number += 1
                yield request.prepared or request.job


def _raise_file_limit() -> None:
    """Raise the limit of open files: each waiting request holds one open, and the soft limit is often 1024."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(ValueError, OSError):  # macOS reports no hard limit, but enforces one
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _report_ready() -> None:
    """Print ``READY`` for the process that started this one, and close the start lock, inherited as stdin."""
    with contextlib.suppress(BrokenPipeError):  # the starter was killed; other clients connect
        os.write(1, f"{READY}\n".encode())
    os.dup2(2, 1)  # nothing reads the pipe from now on
    with open(os.devnull) as devnull:  # noqa: PTH123
        os.dup2(devnull.fileno(), 0)


def _accept(listener: Listener, requests: RequestQueue) -> None:
    while True:
        try:
            connection = listener.accept()
            connection.send(READY)
        except OSError:  # the client has gone, or the listener is closed
            time.sleep(0.05)
            continue
        requests.register(ClientConnection(connection, requests))


def _end_with_owner(folder: Path) -> None:
    """End this process when the lock of the folder's owner is released."""
    try:
        file = os.open(owner_file(folder), os.O_RDWR)
        fcntl.lockf(file, fcntl.LOCK_EX)
    except FileNotFoundError:
        pass
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


if __name__ == "__main__":
    if "--detached" in sys.argv and os.fork():
        os._exit(0)
    main(Path(sys.argv[1]), sys.argv[2])
