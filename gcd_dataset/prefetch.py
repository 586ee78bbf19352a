"""Prefetching by a thread: items are made before the consumer asks for them."""

import atexit
import threading
import time
from collections.abc import Callable, Generator, Iterator
from queue import SimpleQueue
from typing import TypeVar

from gcd_dataset.waits import WaitClock, record_wait

Item = TypeVar("Item")


def prefetch(
    items: Iterator[Item],
    count: int,
    *,
    begin: Callable[[], None] | None = None,
    wait: bool = False,
    name: str | None = None,
) -> Generator[Item]:
    """The same items, up to ``count`` of them made ahead by a daemon thread.

    ``begin`` is called first, in the thread. When the generator is closed, or the interpreter exits, the thread ends
    after the item it is making; ``wait`` joins it. An error of ``items`` is raised after the items before it. With
    ``name``, the time that the thread is blocked by a full buffer is recorded under that name
    (``gcd_dataset.waits``).
    """
    room = threading.Semaphore(count)
    ready = SimpleQueue[tuple[Item | None, BaseException | None]]()
    closed = False

    def make() -> None:
        try:
            if begin is not None:
                begin()
            clock = WaitClock()
            while _acquire(room, clock) and not closed:
                ready.put((next(items), None))
                if name is not None:
                    record_wait(name, clock.lap())
        except BaseException as error:  # noqa: BLE001 - raised in the consumer
            ready.put((None, error))

    thread = threading.Thread(target=make, daemon=True)

    def close() -> None:
        nonlocal closed
        closed = True
        room.release()
        if wait:
            thread.join()

    thread.start()
    # A daemon thread that is still inside torch when the interpreter exits aborts the process.
    atexit.register(close)
    unregister = atexit.unregister  # a name of the module is gone when a generator is closed at interpreter exit
    try:
        while True:
            item, error = ready.get()
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            room.release()
            yield item  # type: ignore[misc]
    finally:
        error = None  # break a cycle: its traceback refers to this frame and to the frames of all callers
        unregister(close)
        close()


def _acquire(room: threading.Semaphore, clock: WaitClock) -> bool:
    """Acquire ``room``, counting the wait as idle; always true."""
    begin = time.perf_counter()
    room.acquire()
    clock.add_idle(time.perf_counter() - begin)
    return True
