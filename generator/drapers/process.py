"""The draper: a process that drapes on one device what any number of others ask for.

    python -m gcd_dataset.generator.drapers.process FOLDER DEVICE

Garments of all askers share the device, and take turns there as they come. It ends with the owner of ``FOLDER``.
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
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from queue import SimpleQueue
from typing import Protocol

from gcd_dataset.errors import GcdError
from gcd_dataset.generator.drape import DrapeJob, places_on, resolve_device
from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.device import memory_kept
from gcd_dataset.generator.drape.queue import Readied, drape_in_turn
from gcd_dataset.generator.drapers.address import DRAPERS, READY, owner_file, socket_file
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest
from gcd_dataset.generator.drapers.parcel import receive_parcel
from gcd_dataset.generator.drapers.studio import Studio
from gcd_dataset.waits import WaitClock

__all__ = ["Inbox", "main"]

CONFIG = DrapeConfig()


def main(folder: Path, device: str) -> None:
    """Listen, and drape until the owner of the folder has ended."""
    threading.Thread(target=_end_with_owner, args=(folder,), daemon=True).start()
    _allow_many_files()
    try:
        device = resolve_device(device)
    except GcdError as error:
        print(error, flush=True)
        return
    inbox = Inbox()
    socket_file(folder).unlink(missing_ok=True)  # of a draper that was killed
    listener = Listener(str(socket_file(folder)), "AF_UNIX", backlog=128)
    threading.Thread(target=_accept, args=(listener, inbox), daemon=True).start()
    _tell_ready()
    try:
        while True:
            inbox.drape(device)
    except Exception as error:
        listener.close()  # whoever calls from here on begins the next draper
        reason = " ".join(str(error).split()) or type(error).__name__
        # Others are of the device, such as a GPU that is lost.
        inbox.fail(
            reason if isinstance(error, GcdError) else f"{reason}; start again, on other devices if it comes back"
        )
        raise


class Caller(Protocol):
    """Where an order comes from."""

    there: bool
    """Whether anybody waits for the answer."""

    def tell(self, answer: DrapeReply) -> None:
        """Take the answer."""


class Asker:
    """One connection: read by a thread, written by another, so that one which does not read holds up no other."""

    def __init__(self, connection: Connection, inbox: "Inbox") -> None:
        self._connection, self._inbox = connection, inbox
        self._answers: SimpleQueue[DrapeReply | str | None] = SimpleQueue()
        self.there = True
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._writer.start()
        threading.Thread(target=self._read, daemon=True).start()

    def tell(self, answer: DrapeReply | str) -> None:
        """Send an answer, if somebody is there to take it."""
        self._answers.put(answer)

    def finish(self) -> None:
        """Wait until all that was told is sent, as long as that may take for one that is alive."""
        self._answers.put(None)
        self._writer.join(timeout=5.0)  # one that was stopped reads nothing

    def _read(self) -> None:
        try:
            # A worker that was killed while it sent leaves half an order: that is an error too.
            with contextlib.suppress(EOFError, OSError):
                while True:
                    self._inbox.put(self, receive_parcel(self._connection))
        finally:
            self.there = False
            self._answers.put(None)
            self._writer.join()
            # Close in the reader thread: the OS reuses the descriptor.
            self._connection.close()

    def _write(self) -> None:
        with contextlib.suppress(OSError):
            while (answer := self._answers.get()) is not None:
                self._connection.send(answer)
        self.there = False


class Inbox:
    """Garments that wait to be draped, and those in work."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[Caller, DrapeRequest, DrapeJob | Readied]] = deque()
        self._some = threading.Condition()
        self._askers: set[Asker] = set()
        self._at_work: dict[int, tuple[Caller, DrapeRequest]] = {}
        self._clock = WaitClock()

    def put(self, asker: Caller, order: DrapeRequest) -> None:
        """Add a garment."""
        ready = _readied(order.job)
        with self._some:
            if order.again:
                self._waiting.appendleft((asker, order, ready))
            else:
                self._waiting.append((asker, order, ready))
            self._some.notify()

    def enter(self, asker: Asker) -> None:
        """Know somebody who asks, and forget those who have gone."""
        with self._some:
            self._askers = {known for known in self._askers if known.there} | {asker}

    def fail(self, reason: str) -> None:
        """Tell everybody that nothing is draped any more."""
        for asker in list(self._askers):
            asker.tell(reason)
        for asker in list(self._askers):
            asker.finish()

    def drape(self, device: str) -> None:
        """Wait for a garment, then drape until none is left."""
        begun = time.perf_counter()
        with self._some:
            self._some.wait_for(lambda: bool(self._waiting))
        self._clock.add_idle(time.perf_counter() - begun)
        at_once, arrived, studio = places_on(device, sharers=DRAPERS), self._waiting.__len__, Studio(device)
        drapes = drape_in_turn(
            self._jobs(), CONFIG, device=device, at_once=at_once, arrived=arrived, between=studio.go_on
        )
        with memory_kept(device):
            for number, drape in drapes:
                asker, order = self._at_work.pop(number)
                if asker.there:
                    studio.take(order, drape, partial(self._answer, asker, device))
            studio.finish()

    def _answer(self, asker: Caller, device: str, answer: DrapeReply) -> None:
        """Send an answer, and how long this process has waited since the one before."""
        asker.tell(replace(answer, waits={device: self._clock.lap()}))

    def _jobs(self) -> Iterator[DrapeJob | Readied | None]:
        """Those that wait, whenever asked; ``None`` where there is none at this moment."""
        number = 0
        while True:
            taken = self._taken()
            if taken is None:
                yield None
            else:
                asker, order, ready = taken
                self._at_work[number] = asker, order
                number += 1
                yield ready

    def _taken(self) -> tuple[Caller, DrapeRequest, DrapeJob | Readied] | None:
        """The next whose asker is still there."""
        with self._some:
            while self._waiting:
                taken = self._waiting.popleft()
                if taken[0].there:
                    return taken
        return None


def _readied(job: DrapeJob) -> DrapeJob | Readied:
    """The job made ready. On failure return the job itself: the drape reports the error."""
    try:
        return Readied.of(job)
    except Exception:  # noqa: BLE001 - it comes again in the drape
        return job


def _allow_many_files() -> None:
    """As many as the system lets us have: each garment that waits is one, and 1024 is a common soft limit."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(ValueError, OSError):  # macOS tells of no limit, and has one
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _tell_ready() -> None:
    """Tell whoever has begun this process, and let go of the lock that it has given along."""
    with contextlib.suppress(BrokenPipeError):  # killed meanwhile: then the next
        os.write(1, f"{READY}\n".encode())
    os.dup2(2, 1)  # nobody reads on; whatever is printed goes where errors go
    with open(os.devnull) as nothing:  # noqa: PTH123
        os.dup2(nothing.fileno(), 0)


def _accept(listener: Listener, inbox: Inbox) -> None:
    while True:
        try:
            connection = listener.accept()
            connection.send(READY)
        except OSError:  # the caller has gone, or the listener is closed
            time.sleep(0.05)
            continue
        inbox.enter(Asker(connection, inbox))


def _end_with_owner(folder: Path) -> None:
    """End this process when the owner of the folder has ended, however it did."""
    try:
        file = os.open(owner_file(folder), os.O_RDWR)
        fcntl.lockf(file, fcntl.LOCK_EX)
    except FileNotFoundError:
        pass
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
