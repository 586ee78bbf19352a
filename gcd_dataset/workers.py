"""Worker processes that end with this process, even if it is killed; and threads that make items ahead."""

import atexit
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import chain, islice
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from gcd_dataset.errors import GcdError

Task = TypeVar("Task")
Result = TypeVar("Result")
Item = TypeVar("Item")

KILLED = "a worker process was killed, perhaps for lack of memory: continue with fewer --workers"
UNSTARTED = (
    "a worker process could not start, see above: a script that uses workers must start them under "
    'if __name__ == "__main__":'
)
SIGNALS = (signal.SIGINT, signal.SIGTERM)  # Ctrl-C, timeout and Slurm send them to the whole process group
AHEAD = 2  # tasks submitted for each process, so that none is idle while the consumer is busy


@dataclass(frozen=True)
class Pool:
    """Processes that several calls of ``parallel_map`` share."""

    executor: ProcessPoolExecutor
    workers: int


def parallel_map(work: Callable[[Task], Result], tasks: Iterable[Task], workers: int | Pool) -> Iterator[Result]:
    """The results of the tasks, in order, from ``workers`` processes; with fewer than 2, from this process.

    ``workers``: their number, or those of ``process_pool``. Raises ``GcdError`` if a worker is killed.
    """
    if isinstance(workers, int) and workers < 2:
        yield from map(work, tasks)
        return
    waiting = iter(tasks)
    in_flight = deque[Future[Result]]()
    with nullcontext(workers) if isinstance(workers, Pool) else process_pool(workers) as pool:

        def submit(count: int) -> None:
            for task in islice(waiting, count):
                with _starting():  # the pool starts its processes here
                    in_flight.append(pool.executor.submit(work, task))

        try:
            submit(AHEAD * pool.workers)
            while in_flight:
                yield in_flight.popleft().result()
                submit(1)
        except BrokenProcessPool as error:
            raise GcdError(f"{KILLED}; or {UNSTARTED}") from error


def parallel_map_chunks(
    work: Callable[[Sequence[int]], Iterable[Result]], numbers: Sequence[int], workers: int, *, chunk: int
) -> Iterator[Result]:
    """The results for all numbers, in order; one call of ``work`` computes ``chunk`` of them. See ``parallel_map``."""
    tasks = (numbers[i : i + chunk] for i in range(0, len(numbers), chunk))
    return chain.from_iterable(parallel_map(work, tasks, workers))


@contextmanager
def streams(work: Callable[[Task], Iterable[Result]], tasks: Sequence[Task]) -> Iterator[list[Iterator[Result]]]:
    """One iterator of results for each task; each task runs in its own process, whether its results are read or not.

    The processes end with the block. The iterators raise the errors of ``work``, and ``GcdError`` if a process is
    killed.
    """
    context = _spawn_context()
    lifeline, parent_end = context.Pipe(duplex=False)
    processes, results = [], []
    try:
        for task in tasks:
            receiver, sender = context.Pipe(duplex=False)
            process = context.Process(target=_run_stream, args=(work, task, sender, lifeline), daemon=True)
            with _starting():
                process.start()
            sender.close()
            processes.append(process)
            results.append(_receive(receiver, process))
        yield results
    finally:
        parent_end.close()
        for process in processes:
            process.kill()


@contextmanager
def without_main_module() -> Iterator[None]:
    """Start the processes of the block without the main module, for work that needs nothing from it.

    Otherwise each process would import the script again, which would need an ``if __name__ == "__main__":`` guard.
    """
    program = sys.modules["__main__"]
    file = vars(program).pop("__file__", None)
    try:
        yield
    finally:
        if file is not None:
            program.__file__ = file


def _run_stream(
    work: Callable[[Task], Iterable[Result]], task: Task, results: Connection, lifeline: Connection
) -> None:
    """Main function of a stream's process: send the results, then ``StopIteration`` or the error."""
    _start_worker(lifeline)
    try:
        for result in work(task):
            results.send((result, None))
        results.send((None, StopIteration()))
    except Exception as error:  # noqa: BLE001 -- raised where the results are read
        results.send((None, error))


@contextmanager
def _starting() -> Iterator[None]:
    """Start processes with ``SIGNALS`` blocked, which they inherit until ``_start_worker`` ignores them.

    Without the main module if it has no file that they could import, as with ``python -``.
    """
    program = sys.modules["__main__"]
    file = getattr(program, "__file__", None)
    is_missing = file is not None and not Path(file).exists()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        if is_missing:
            del program.__file__
        yield
    finally:
        if is_missing:
            program.__file__ = file
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _receive(connection: Connection, process: BaseProcess) -> Iterator[Any]:
    while True:
        try:
            result, error = connection.recv()
        except (EOFError, OSError) as gone:
            process.join(timeout=5.0)
            raise GcdError(KILLED if (process.exitcode or -1) < 0 else UNSTARTED) from gone
        if isinstance(error, StopIteration):
            return
        if error is not None:
            raise error
        yield result


def _spawn_context() -> SpawnContext:
    """The start method of workers: spawn, since a forked process lacks the threads of Warp and torch."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")  # there is one worker for each core
    return multiprocessing.get_context("spawn")


@contextmanager
def process_pool(workers: int) -> Iterator[Pool]:
    """Processes that ignore Ctrl-C and end with the block, or with this process, even if it is killed."""
    context = _spawn_context()
    lifeline, parent_end = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker, initargs=(lifeline,))
    try:
        yield Pool(pool, workers)
    finally:
        parent_end.close()
        pool.shutdown(wait=False, cancel_futures=True)


def _start_worker(lifeline: Connection) -> None:
    """Called first in a worker: ignore ``SIGNALS``, and exit when the parent closes its end of the lifeline or dies."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    threading.Thread(target=_exit_with_parent, args=(lifeline,), daemon=True).start()


def _exit_with_parent(lifeline: Connection) -> None:
    lifeline.poll(None)  # returns at the end of file
    os._exit(1)


def prefetch(
    items: Iterator[Item], count: int, *, begin: Callable[[], None] | None = None, wait: bool = False
) -> Generator[Item]:
    """The same items, up to ``count`` of them made ahead by a daemon thread.

    ``begin`` is called first, in the thread. When the generator is closed, or the interpreter exits, the thread ends
    after the item it is making; ``wait`` joins it. An error of ``items`` is raised after the items before it.
    """
    room = threading.Semaphore(count)
    ready = SimpleQueue[tuple[Item | None, BaseException | None]]()
    closed = False

    def make() -> None:
        try:
            if begin is not None:
                begin()
            while room.acquire() and not closed:
                ready.put((next(items), None))
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
