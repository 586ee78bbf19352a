"""Items made by a thread before they are asked for."""

import atexit
import threading
import time
from collections.abc import Callable, Generator, Iterator
from queue import SimpleQueue
from typing import TypeVar

from gcd_dataset.waits import WaitClock, noted

__all__ = ["by_thread"]

Made = TypeVar("Made")


def by_thread(
    items: Iterator[Made],
    count: int,
    *,
    begin: Callable[[], None] | None = None,
    wait: bool = False,
    name: str | None = None,
) -> Generator[Made]:
    """The same items, up to ``count`` of them made by a thread while the caller is at work.

    ``begin`` is called first in the thread. Closed before its end, or with the program's, the thread ends after the
    item that it is making, which is waited for with ``wait``. An error of ``items`` comes after those before it. The
    time that it waits while ``count`` items are not taken is noted as that of ``name``, if it has one.
    """
    room, made, closed = threading.Semaphore(count), SimpleQueue[tuple[Made | None, BaseException | None]](), False

    def make() -> None:
        try:
            if begin is not None:
                begin()
            clock = WaitClock()
            while _entered(room, clock) and not closed:
                made.put((next(items), None))
                if name is not None:
                    noted(name, clock.taken())
        except BaseException as error:  # noqa: BLE001 - raised where the items are taken
            made.put((None, error))

    thread = threading.Thread(target=make, daemon=True)

    def close() -> None:
        nonlocal closed
        closed = True
        room.release()
        if wait:
            thread.join()

    thread.start()
    # One that is stopped by the end of the interpreter, in the midst of torch, aborts the process.
    atexit.register(close)
    try:
        while True:
            item, error = made.get()
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            room.release()
            yield item  # type: ignore[misc]
    finally:
        error = None  # its traceback has this frame, and those of all who called
        atexit.unregister(close)
        close()


def _entered(room: threading.Semaphore, clock: WaitClock) -> bool:
    """Wait for room."""
    begun = time.perf_counter()
    room.acquire()
    clock.idle(time.perf_counter() - begun)
    return True
