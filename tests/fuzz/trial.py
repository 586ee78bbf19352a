"""Trials of a reader: inputs given one by one to a child process, with limits on time and memory for each."""

import os
import pickle
import resource
import select
import signal
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from gcd_dataset.errors import GcdError

SECONDS = 10.0  # s: limit on reading one input; long, since other programs share the cores
MEGABYTES = 1024  # MB: limit on the address space that reading one input may add


class Verdict(Enum):
    """The outcome of reading an input."""

    READ = "read"
    REFUSED = "refused"
    CRASH = "crash"
    HANG = "hang"
    MEMORY = "memory"
    SILENT = "silent"


FAULTS = (Verdict.CRASH, Verdict.HANG, Verdict.MEMORY, Verdict.SILENT)


@dataclass
class Tally:
    """The verdicts on many inputs."""

    counts: Counter[Verdict] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    """For each input that was neither read nor refused: its number, verdict and cause, as one line."""

    @property
    def tried(self) -> int:
        """Number of inputs."""
        return self.counts.total()

    def add(self, number: int, verdict: Verdict, cause: str) -> None:
        """Count an input."""
        self.counts[verdict] += 1
        if verdict in FAULTS:
            self.faults.append(f"input {number}: {verdict.value}: {cause}")


class _Hang(BaseException):
    """Raised by the timer; as a ``BaseException`` it passes the ``except Exception`` of a reader."""


def try_all(read: Callable[[bytes], Any], inputs: Iterable[bytes], *, expected: object = None) -> Tally:
    """Give each input to ``read``. With ``expected``, an input that reads as anything else is ``SILENT``.

    A child process reads, so that a crash or a hang of compiled code is a verdict too; the next input then goes to a
    new child.
    """
    tally, waiting = Tally(), list(inputs)
    while tally.tried < len(waiting):
        for number, verdict, cause in _by_child(read, waiting, tally.tried, expected):
            tally.add(number, verdict, cause)
    return tally


def _by_child(
    read: Callable[[bytes], Any], inputs: list[bytes], first: int, expected: object
) -> Iterator[tuple[int, Verdict, str]]:
    """The verdicts on the inputs from ``first`` to the last, or to the input that kills the child."""
    ours, theirs = get_context("fork").Pipe(duplex=False)
    child = os.fork()
    if not child:
        _read_all(read, inputs, first, expected, theirs)
    theirs.close()
    number = first
    try:
        while number < len(inputs):
            if not select.select([ours], [], [], 3 * SECONDS)[0]:
                yield number, Verdict.HANG, f"no answer for {3 * SECONDS:.0f} s, in compiled code"
                return
            try:
                verdict, cause = ours.recv()
            except EOFError:
                yield number, Verdict.CRASH, "the process died"
                return
            yield number, verdict, cause
            number += 1
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        ours.close()


def _read_all(
    read: Callable[[bytes], Any], inputs: list[bytes], first: int, expected: object, answers: Connection
) -> None:
    """In the child: read the inputs, send the verdicts, exit."""
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGALRM, _time_is_up)
        for content in inputs[first:]:
            answers.send(_judged(read, content, expected))
    finally:
        os._exit(0)


def _judged(read: Callable[[bytes], Any], content: bytes, expected: object) -> tuple[Verdict, str]:
    try:
        with _limited():
            found = read(content)
    except GcdError as error:
        text = str(error)
        return (Verdict.REFUSED, "") if text and "\n" not in text else (Verdict.CRASH, f"message: {text!r}")
    except MemoryError as error:
        return Verdict.MEMORY, _cause(error)
    except _Hang as error:
        return Verdict.HANG, _cause(error)
    except BaseException as error:  # noqa: BLE001 -- any other exception is a crash
        return Verdict.CRASH, _cause(error)
    if expected is not None and pickle.dumps(found) != pickle.dumps(expected):
        return Verdict.SILENT, "read as other values"
    return Verdict.READ, ""


def _cause(error: BaseException) -> str:
    places = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
    where = f"{places[-1].filename}:{places[-1].lineno}" if places else "?"
    return f"{type(error).__name__}: {str(error)[:120]!r} at {where}"


@contextmanager
def _limited() -> Iterator[None]:
    with open("/proc/self/statm") as file:  # noqa: PTH123
        size = int(file.read().split()[0]) * resource.getpagesize()
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (size + MEGABYTES * 2**20, hard))
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))


def _time_is_up(*_: object) -> None:
    raise _Hang(f"over {SECONDS:.0f} s")
