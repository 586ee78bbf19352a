"""Items made by a thread before they are asked for."""

import atexit
import threading
from collections.abc import Callable, Generator, Iterator
from queue import SimpleQueue
from typing import TypeVar

__all__ = ["by_thread"]

Made = TypeVar("Made")


def by_thread(
    items: Iterator[Made], count: int, *, begin: Callable[[], None] | None = None, wait: bool = False
) -> Generator[Made]:
    """The same items, up to ``count`` of them made by a thread while the caller is at work.

    ``begin`` is called first in the thread. Closed before its end, or with the program's, the thread ends after the
    item that it is making, which is waited for with ``wait``. An error of ``items`` comes after those before it.
    """
    room, made, closed = threading.Semaphore(count), SimpleQueue[tuple[Made | None, BaseException | None]](), False

    def make() -> None:
        try:
            if begin is not None:
                begin()
            while room.acquire() and not closed:
                made.put((next(items), None))
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
