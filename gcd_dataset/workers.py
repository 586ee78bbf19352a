"""Work shared out over processes that end with this one."""

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import chain, islice
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar

from gcd_dataset.errors import GcdError

__all__ = ["side_by_side", "side_by_side_in_parts", "streams", "without_program"]

Task = TypeVar("Task")
Result = TypeVar("Result")

KILLED = "a worker process was killed, by lack of memory perhaps: go on with fewer --workers"
UNSTARTED = (
    "a worker process could not start, see above: a script that asks for workers begins its work under "
    'if __name__ == "__main__":'
)
AHEAD = 2  # tasks in work for each process, so that none waits for the writer


def side_by_side(work: Callable[[Task], Result], tasks: Iterable[Task], workers: int) -> Iterator[Result]:
    """The results of the tasks, in order, from ``workers`` processes, or from this one where one would be alone.

    Raises ``GcdError`` where one is killed.
    """
    if workers < 2:
        yield from map(work, tasks)
        return
    waiting = iter(tasks)
    with _processes(workers) as pool:

        def submitted(count: int) -> Iterator[Future[Result]]:
            return (_submitted(pool, work, task) for task in islice(waiting, count))

        at_work = deque(submitted(AHEAD * workers))
        while at_work:
            yield _result(at_work.popleft())
            at_work.extend(submitted(1))


def side_by_side_in_parts(
    work: Callable[[Sequence[int]], Iterable[Result]], numbers: Sequence[int], workers: int, *, at_once: int
) -> Iterator[Result]:
    """The results for all numbers, in order; ``work`` gives those of ``at_once`` of them. Else as ``side_by_side``."""
    tasks = (numbers[i : i + at_once] for i in range(0, len(numbers), at_once))
    return chain.from_iterable(side_by_side(work, tasks, workers))


@contextmanager
def streams(work: Callable[[Task], Iterable[Result]], tasks: Sequence[Task]) -> Iterator[list[Iterator[Result]]]:
    """The results of each task as a stream, each from a process of its own, which goes on while others are read.

    The processes end with the block. The streams raise what ``work`` raises, and ``GcdError`` where one is killed.
    """
    context = _spawning()
    lifeline, held = context.Pipe(duplex=False)
    processes, streamed = [], []
    try:
        for task in tasks:
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(target=_stream, args=(work, task, theirs, lifeline), daemon=True)
            with _no_program_from_standard_input():
                process.start()
            theirs.close()
            processes.append(process)
            streamed.append(_received(ours, process))
        yield streamed
    finally:
        held.close()
        for process in processes:
            process.terminate()


@contextmanager
def without_program() -> Iterator[None]:
    """Have processes of the block started without the main program: for work that needs nothing of it.

    Each would run the top level of a script again, which had to be guarded by ``if __name__ == "__main__":``.
    """
    program = sys.modules["__main__"]
    file = vars(program).pop("__file__", None)
    try:
        yield
    finally:
        if file is not None:
            program.__file__ = file


def _stream(work: Callable[[Task], Iterable[Result]], task: Task, results: Connection, lifeline: Connection) -> None:
    """In a process: send the results, then what ended them."""
    _begin(lifeline)
    try:
        for result in work(task):
            results.send((result, None))
        results.send((None, StopIteration()))
    except Exception as error:  # noqa: BLE001 -- raised where the results are read
        results.send((None, error))


@contextmanager
def _no_program_from_standard_input() -> Iterator[None]:
    """Have processes started without the main program where it has no file that they could import, as ``python -``."""
    program = sys.modules["__main__"]
    file = getattr(program, "__file__", None)
    if file is None or Path(file).exists():
        yield
        return
    del program.__file__
    try:
        yield
    finally:
        program.__file__ = file


def _received(connection: Connection, process: BaseProcess) -> Iterator[Any]:
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


def _submitted(pool: ProcessPoolExecutor, work: Callable[[Task], Result], task: Task) -> Future[Result]:
    """The result of a task to come. Raises ``GcdError`` where a process of the pool has died."""
    try:
        with _no_program_from_standard_input():  # the pool starts its processes here
            return pool.submit(work, task)
    except BrokenProcessPool as error:
        raise GcdError(f"{KILLED}; or {UNSTARTED}") from error


def _result(task: Future[Result]) -> Result:
    try:
        return task.result()
    except BrokenProcessPool as error:
        raise GcdError(f"{KILLED}; or {UNSTARTED}") from error


def _spawning() -> SpawnContext:
    """How processes are started: not forked, since threads of Warp or torch would not live on in them."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")  # of each worker: there is one a core
    return multiprocessing.get_context("spawn")


@contextmanager
def _processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that leave Ctrl-C to this one, and that end with the block, or with this process however it ends."""
    context = _spawning()
    lifeline, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(lifeline,))
    try:
        yield pool
    finally:
        held.close()
        pool.shutdown(wait=False, cancel_futures=True)


def _begin(lifeline: Connection) -> None:
    """In a worker: leave interrupts to the parent, and end when it lets go of its end of the lifeline."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    lifeline.poll(None)
    os._exit(1)
